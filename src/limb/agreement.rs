//! How well crossings agree with a circle, and the circle that suits them best; eight of them side by side.

use super::chords::Crossing;
use crate::estimation::TUKEY_SIGMAS;
use crate::geometry::Circle;
use crate::lanes::{LANES, larger, smaller};
use crate::units::Measured;
use multiversion::multiversion;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Distance from the circle within which a crossing agrees with it, px.
const AGREEMENT_PX: f32 = 2.0;
/// Crossings within this part of the radius from the circle belong to the same bright patch.
const NEAR: f32 = 0.25;
/// Crossings are never better than this, px: marks, haze and the sensor's tilt see to it.
const CROSSING_SIGMA_PX: f32 = 0.1;
/// What such weights leave of the variance of normal errors.
const TUKEY_VARIANCE: f32 = 0.87;
/// Weights and circle settle within so many steps.
const STEPS: usize = 5;
/// Where the last group's empty places are: on no circle.
const NOWHERE_PX: f32 = 1e6;

/// Crossings in groups.
pub(super) struct Crossings {
    groups: Vec<Group>,
}

/// Places of crossings and unit vectors along their chords, into the disc.
struct Group {
    at: [[f32; LANES]; 2],
    inward: [[f32; LANES]; 2],
}

/// How crossings lie about a circle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Agreement {
    /// Their squared distances from it, those that disagree at the least distance of disagreement, px^2.
    pub cost_px2: f32,
    /// Those on it.
    pub on: f32,
    /// Those on it or near.
    pub near: f32,
}

/// A circle through crossings.
pub(super) struct CircleFit {
    pub circle: Circle,
    /// Of centre x, y and radius, px^2.
    covariance: Matrix3<f64>,
}

impl CircleFit {
    pub(super) fn radius_sigma_px(&self) -> f64 {
        self.covariance.m33.max(0.0).sqrt()
    }

    /// 1 sigma of the centre in the direction in which it is known least.
    pub(super) fn centre_sigma_px(&self) -> f64 {
        let centre: Matrix2<f64> = self.covariance.fixed_view::<2, 2>(0, 0).into();
        centre.symmetric_eigenvalues().max().sqrt()
    }
}

impl Crossings {
    pub(super) fn new(crossings: &[Crossing]) -> Self {
        let groups = crossings.chunks(LANES).map(Group::new).collect();
        Self { groups }
    }

    pub(super) fn agreement(&self, circle: &Circle) -> Agreement {
        agreement(&self.groups, circle)
    }

    /// Where those are that agree with a circle.
    pub(super) fn on(&self, circle: &Circle) -> impl Iterator<Item = Vector2<f64>> {
        self.groups.iter().flat_map(|group| {
            let excess = group.seen_from(circle).excess;
            let on = (0..LANES).filter(move |k| excess[*k].abs() < AGREEMENT_PX);
            on.map(|k| Vector2::new(group.at[0][k], group.at[1][k]).map(f64::from))
        })
    }

    /// The circle near another one that suits the crossings best, of a radius that is known so well before. Tukey's weights keep off
    /// marks, scratches and leaks.
    pub(super) fn fit(&self, start: Circle, radius_px: Measured) -> Option<CircleFit> {
        let mut circle = start;
        let mut limit_px = AGREEMENT_PX;
        let tightness = radius_px.sigma.powi(-2);
        let mut covariance = Matrix3::zeros();
        for _ in 0..STEPS {
            let sums = Sums::about(&self.groups, &circle, limit_px);
            let variance = sums.variance_px2();
            let mut information = sums.information / f64::from(variance);
            information.m33 += tightness;
            let mut pull = sums.pull / f64::from(variance);
            pull.z += tightness * (radius_px.value - circle.radius);
            covariance = information.try_inverse()?;
            let moved = covariance * pull;
            circle.centre += Vector2::new(moved.x, moved.y);
            circle.radius += moved.z;
            limit_px = AGREEMENT_PX.min(TUKEY_SIGMAS as f32 * variance.sqrt());
        }
        Some(CircleFit { circle, covariance })
    }
}

impl Group {
    fn new(crossings: &[Crossing]) -> Self {
        let mut group = Self {
            at: [[NOWHERE_PX; LANES]; 2],
            inward: [[0.0; LANES]; 2],
        };
        for (k, crossing) in crossings.iter().enumerate() {
            let (at, inward) = (crossing.at.vector(), crossing.inward());
            for axis in 0..2 {
                group.at[axis][k] = at[axis] as f32;
                group.inward[axis][k] = inward[axis] as f32;
            }
        }
        group
    }

    #[inline(always)]
    fn seen_from(&self, circle: &Circle) -> CircleResiduals {
        let [x, y, radius] = [circle.centre.x, circle.centre.y, circle.radius].map(|v| v as f32);
        let mut seen = CircleResiduals::default();
        for k in 0..LANES {
            let (dx, dy) = (self.at[0][k] - x, self.at[1][k] - y);
            let length = larger((dx * dx + dy * dy).sqrt(), f32::EPSILON);
            let excess = length - radius;
            let clipped = smaller(larger(excess, -AGREEMENT_PX), AGREEMENT_PX);
            let faces = dx * self.inward[0][k] + dy * self.inward[1][k] < 0.0;
            seen.distance[k] = excess.abs();
            seen.excess[k] = if faces { clipped } else { AGREEMENT_PX };
            (seen.out[0][k], seen.out[1][k]) = (dx / length, dy / length);
        }
        seen
    }
}

/// Crossings as a circle sees them.
#[derive(Default)]
struct CircleResiduals {
    /// Distance from the circle.
    distance: [f32; LANES],
    /// The same outwards and clipped; whoever has its bright side outwards disagrees.
    excess: [f32; LANES],
    /// Unit vectors outwards.
    out: [[f32; LANES]; 2],
}

#[multiversion(targets("x86_64+avx2"))]
fn agreement(groups: &[Group], circle: &Circle) -> Agreement {
    let [mut costs, mut ons, mut nears] = [[0.0; LANES]; 3];
    let near_px = NEAR * circle.radius as f32;
    for group in groups {
        let CircleResiduals {
            excess, distance, ..
        } = group.seen_from(circle);
        for k in 0..LANES {
            costs[k] += excess[k] * excess[k];
            let on = excess[k].abs() < AGREEMENT_PX;
            ons[k] += if on { 1.0 } else { 0.0 };
            nears[k] += if distance[k] < near_px { 1.0 } else { 0.0 };
        }
    }
    let [cost_px2, on, near] = [costs, ons, nears].map(|lanes| lanes.iter().sum());
    Agreement { cost_px2, on, near }
}

/// Weighted sums over crossings, by how the circle moves outwards with centre x, y and radius.
struct Sums {
    information: Matrix3<f64>,
    pull: Vector3<f64>,
    squares_px2: f32,
}

impl Sums {
    fn about(groups: &[Group], circle: &Circle, limit_px: f32) -> Self {
        let [xx, xy, yy, x, y, weights, ex, ey, e, squares] =
            weighted_sums(groups, circle, limit_px);
        let [xx, xy, yy, x, y, one] = [xx, xy, yy, x, y, weights].map(f64::from);
        Self {
            information: Matrix3::new(xx, xy, x, xy, yy, y, x, y, one),
            pull: Vector3::new(ex, ey, e).map(f64::from),
            squares_px2: squares,
        }
    }

    /// Scatter of the crossings about the circle, squared.
    fn variance_px2(&self) -> f32 {
        let weights = self.information.m33 as f32;
        let variance = self.squares_px2 / (TUKEY_VARIANCE * weights.max(f32::EPSILON));
        variance.max(CROSSING_SIGMA_PX * CROSSING_SIGMA_PX)
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn weighted_sums(groups: &[Group], circle: &Circle, limit_px: f32) -> [f32; 10] {
    let mut sums = [[0.0; LANES]; 10];
    for group in groups {
        let seen = group.seen_from(circle);
        for k in 0..LANES {
            let (x, y, excess) = (seen.out[0][k], seen.out[1][k], seen.excess[k]);
            let part = excess / limit_px;
            let root = larger(1.0 - part * part, 0.0);
            let weight = root * root;
            let (wx, wy, we) = (weight * x, weight * y, weight * excess);
            let terms = [
                wx * x,
                wx * y,
                wy * y,
                wx,
                wy,
                weight,
                we * x,
                we * y,
                we,
                we * excess,
            ];
            for (sum, term) in sums.iter_mut().zip(terms) {
                sum[k] += term;
            }
        }
    }
    sums.map(|lanes| lanes.iter().sum())
}

#[cfg(test)]
mod tests {
    use super::super::chords::{Axis, Edge};
    use super::*;
    use crate::units::SensorPx;

    const TRUTH: Circle = Circle {
        centre: Vector2::new(400.3, 299.6),
        radius: 95.2,
    };

    /// Where 24 rows cross a circle, the first of them off by `off_px` in x.
    fn crossings(off_px: f64) -> Vec<Crossing> {
        let row = |n: usize| {
            let y = TRUTH.centre.y + 7.5 * (n as f64 - 11.5);
            let half = (TRUTH.radius.powi(2) - (y - TRUTH.centre.y).powi(2)).sqrt();
            [(Edge::Entering, -half), (Edge::Leaving, half)].map(|(edge, x)| Crossing {
                at: SensorPx::new(TRUTH.centre.x + x, y),
                axis: Axis::Row,
                edge,
            })
        };
        let mut crossings: Vec<Crossing> = (0..24).flat_map(row).collect();
        for crossing in crossings.iter_mut().take(6) {
            crossing.at.x += off_px;
        }
        crossings
    }

    #[test]
    fn crossings_agree_with_their_circle_and_those_that_face_the_other_way_do_not() {
        let mut some = crossings(0.0);
        some.truncate(45);
        for crossing in &mut some[20..22] {
            crossing.edge = match crossing.edge {
                Edge::Entering => Edge::Leaving,
                Edge::Leaving => Edge::Entering,
            };
        }
        let agreement = Crossings::new(&some).agreement(&TRUTH);
        assert_eq!((agreement.on, agreement.near), (43.0, 45.0));
        assert_eq!(Crossings::new(&some).on(&TRUTH).count(), 43);
    }

    #[test]
    fn a_circle_is_found_though_an_eighth_of_the_crossings_is_off() {
        let start = Circle {
            centre: TRUTH.centre + Vector2::new(0.4, -0.3),
            radius: 94.9,
        };
        for off_px in [0.0, 1.9, -30.0] {
            let anything = Measured::new(95.0, 10.0);
            let fit = Crossings::new(&crossings(off_px)).fit(start, anything);
            let circle = fit.unwrap().circle;
            assert!((circle.centre - TRUTH.centre).norm() < 0.02, "{circle:?}");
            assert!((circle.radius - TRUTH.radius).abs() < 0.02, "{circle:?}");
        }
    }

    #[test]
    fn a_radius_that_is_known_before_is_kept() {
        let known = Measured::new(95.0, 0.001);
        let fit = Crossings::new(&crossings(0.0)).fit(TRUTH, known).unwrap();
        assert!((fit.circle.radius - 95.0).abs() < 0.01);
        assert!(fit.radius_sigma_px() < 0.001);
        assert!((0.01..0.1).contains(&fit.centre_sigma_px()));
    }
}
