//! A rough circle of the whole disc, fitted to an outline of which a part is the terminator.

use super::extremities;
use super::patch::Outline;
use crate::estimation::{LeastSquares, Linearised, Loss, Prior, Scale, TUKEY_SIGMAS};
use crate::geometry::Circle;
use nalgebra::{Rotation2, RowVector3, Vector1, Vector2, Vector3};
use std::f64::consts::PI;
use std::ops::Range;

/// A point lies on a circle if it is within this many pixels, or this share of the radius.
const ON_PX: f64 = 0.8;
const ON_SHARE: f64 = 0.015;
/// Spacings of the points through which circles are tried, as shares of the outline's points, and number of starting points
/// for each.
const APART: [f64; 4] = [0.33, 0.2, 0.12, 0.06];
const PLACES: usize = 12;
/// Maximum number of points that are used to judge a circle.
const MOST_JUDGES: usize = 160;
/// Maximum share of points farther outside, which are stars or hot pixels.
const MOST_OUTSIDE: f64 = 0.1;
/// Range of the radius of an uncut disc relative to the extent of its light: the horns of a crescent may be too dim to be
/// seen.
const WHOLE: Range<f64> = 0.45..0.75;

/// The circle on which most of an outline lies, with the rest inside it: the terminator lies within the disc. `None` if no
/// such circle has an allowed radius, or if too many points lie outside.
pub(super) fn circle(outline: &Outline, radii: &Range<f64>) -> Option<Circle> {
    let points = in_order(outline);
    let radii = match outline.is_cut {
        true => radii.clone(),
        false => {
            // This rejects a straight terminator as part of a large disc: the lit limb is half a circle, and longer than
            // the terminator.
            let extent = extent(&points);
            radii.start.max(WHOLE.start * extent)..radii.end.min(WHOLE.end * extent)
        }
    };
    let judges: Vec<Vector2<f64>> = points
        .iter()
        .step_by(points.len().div_ceil(MOST_JUDGES).max(1))
        .copied()
        .collect();
    let tried = APART
        .iter()
        .flat_map(|apart| through_points(&points, *apart));
    tried
        .chain(extremities::circle(&points))
        .filter(|circle| radii.contains(&circle.radius))
        .filter_map(|circle| Some((circle, agreeing(&circle, &judges)?)))
        .max_by_key(|(_, agreeing)| *agreeing)
        .map(|(circle, _)| refined(circle, &points))
}

/// The least-squares circle through the points near a circle.
fn refined(circle: Circle, points: &[Vector2<f64>]) -> Circle {
    let on = ON_PX.max(ON_SHARE * circle.radius);
    let near = points
        .iter()
        .filter(|point| circle.excess(**point).abs() < 2.0 * on);
    let near: Vec<Vector2<f64>> = near.copied().collect();
    let fit = LeastSquares {
        start: Vector3::new(circle.centre.x, circle.centre.y, circle.radius),
        prior: Prior::none(),
        loss: Loss::Tukey(TUKEY_SIGMAS),
        scale: Scale::Median,
        tolerance_sigmas: 0.1,
    };
    let linearise = |at: &Vector3<f64>| {
        let circle = circle_of(at);
        let row = |point: &Vector2<f64>| {
            let outwards = (point - circle.centre)
                .try_normalize(1e-9)
                .unwrap_or_default();
            Linearised {
                residual: Vector1::new(circle.excess(*point)),
                jacobian: RowVector3::new(outwards.x, outwards.y, 1.0),
            }
        };
        Some(near.iter().map(row).collect())
    };
    let fitted = fit.fit(linearise);
    fitted.map_or(circle, |fitted| circle_of(&fitted.parameters))
}

fn circle_of(at: &Vector3<f64>) -> Circle {
    Circle {
        centre: at.xy(),
        radius: at.z,
    }
}

/// The longest distance between two extremities.
fn extent(points: &[Vector2<f64>]) -> f64 {
    let span = |n: u32| {
        let axis = Rotation2::new(f64::from(n) / 8.0 * PI) * Vector2::x();
        let places = || points.iter().map(|point| axis.dot(point));
        let (low, high) = (
            places().fold(f64::INFINITY, f64::min),
            places().fold(f64::NEG_INFINITY, f64::max),
        );
        high - low
    };
    (0..8).map(span).fold(0.0, f64::max)
}

/// Number of points that lie on a circle; `None` if too many lie outside.
fn agreeing(circle: &Circle, points: &[Vector2<f64>]) -> Option<usize> {
    let on = ON_PX.max(ON_SHARE * circle.radius);
    let (mut agreeing, mut outside) = (0, 0);
    for point in points {
        let excess = circle.excess(*point);
        agreeing += usize::from(excess.abs() < on);
        outside += usize::from(excess >= on);
    }
    (outside as f64 <= MOST_OUTSIDE * points.len() as f64).then_some(agreeing)
}

/// The outline's points in order of angle around the centre of their bounding box.
fn in_order(outline: &Outline) -> Vec<Vector2<f64>> {
    let points = &outline.points;
    let lowest = points
        .iter()
        .fold(Vector2::repeat(f64::INFINITY), |a, b| a.inf(b));
    let highest = points
        .iter()
        .fold(Vector2::repeat(f64::NEG_INFINITY), |a, b| a.sup(b));
    let middle = (lowest + highest) / 2.0;
    let around = |point: &Vector2<f64>| (point.y - middle.y).atan2(point.x - middle.x);
    let mut points: Vec<_> = points.iter().map(|point| (around(point), *point)).collect();
    points.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    points.into_iter().map(|(_, point)| point).collect()
}

fn through_points(points: &[Vector2<f64>], apart: f64) -> Vec<Circle> {
    let count = points.len();
    let step = (apart * count as f64) as usize;
    if step == 0 {
        return Vec::new();
    }
    let starts = (0..count).step_by(count.div_ceil(PLACES));
    let at = |n: usize| points[n % count];
    starts
        .filter_map(|n| Circle::through(at(n), at(n + step), at(n + 2 * step)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a crescent: half a circle, and the terminator, half an ellipse of some width.
    fn crescent(circle: &Circle, width: f64) -> Outline {
        let turn = Rotation2::new(0.7);
        let points = (0..180).map(|n| {
            let (sin, cos) = (f64::from(n) / 90.0 * PI).sin_cos();
            let across = if cos > 0.0 { cos } else { cos * width };
            circle.centre + turn * Vector2::new(across, sin) * circle.radius
        });
        Outline {
            points: points.collect(),
            middle: circle.centre + turn * Vector2::x() * 0.4 * circle.radius,
            light_px: 100,
            is_cut: false,
        }
    }

    #[test]
    fn the_circle_of_a_phase_is_that_of_its_limb() {
        let circle = Circle {
            centre: Vector2::new(60.0, 45.0),
            radius: 20.0,
        };
        // A thin crescent, a half Moon, a nearly full Moon.
        for width in [-0.7, 0.0, 0.7] {
            let found = super::circle(&crescent(&circle, width), &(4.0..100.0)).unwrap();
            assert!((found.centre - circle.centre).norm() < 0.1, "{width}");
            assert!((found.radius - circle.radius).abs() < 0.1, "{width}");
        }
        assert_eq!(super::circle(&crescent(&circle, 0.7), &(30.0..40.0)), None);
    }
}
