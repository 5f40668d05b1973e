//! Checks that reject patches that are not the Moon, or not the expected one.

use super::candidate::{Candidate, View};
use super::known::MOST_SATURATED;
use super::limb::{BLUR_PX, LimbFit, LimbPoint};
use super::sector::circle_of;
use super::settle::Settled;
use super::shading::lit;
use super::{MOST_RADIUS_DEVIATION, Stage, Stopped};
use crate::estimation::regression;
use crate::geometry::Circle;
use crate::reasons::{at, moon as reasons};
use crate::units::{Reason, Rejected};
use nalgebra::{SVector, Vector2};

/// Maximum ratio of the longest to the shortest axis: an oval is not the Moon.
const MOST_AXIS_RATIO: f64 = 1.15;
/// Significance, in sigma, above which a disc counts as oval.
const OVAL_SIGMAS: f64 = 4.0;
/// Maximum difference of the lit fraction from the expected one.
const MOST_LIT_DEVIATION: f64 = 0.2;
/// Maximum share of the light's variance within and around a disc that the shading leaves unexplained.
const MOST_UNLIKE: f64 = 0.3;
/// Range around a saturated disc, in its radii: if the sky there is brighter than this share of saturation, no limb is
/// visible.
const GLARE: std::ops::Range<f64> = 1.2..1.6;
const MOST_GLARE: f64 = 0.2;
/// Maximum residual of sharp limb points about the circle beyond their sigmas, rms relative to the radius.
const MOST_ROUGHNESS: f64 = 0.02;
/// Maximum sigma of the centre, in radii.
const MOST_SIGMA: f64 = 0.03;
/// A limb point with a larger sigma, in radii, has no edge; maximum share of such points.
const MOST_POINT_SIGMA: f64 = 0.05;
const MOST_BLUNT: f64 = 0.2;

/// If no radius is stated, a limb whose blur exceeds the expected one by so many sigmas may be the edge of a cloud or a
/// corona.
const BLUR_SIGMAS: f64 = 2.0;

/// Checks that the fitted disc may be the Moon.
pub(super) fn check(candidate: &Candidate, settled: &Settled, unlike: f64) -> Result<(), Stopped> {
    let Settled { found, limb, .. } = settled;
    let circle = circle_of(&found.fitted.parameters);
    check_radius(candidate, &circle)?;
    if limb.saturated > MOST_SATURATED {
        let glare = glare(&candidate.view, &circle);
        at_most(reasons::GLARE, glare, MOST_GLARE)?;
    }
    if candidate.expected.radius.is_none() {
        let most_px = BLUR_PX.value + BLUR_SIGMAS * BLUR_PX.sigma;
        at_most(reasons::BLUNT, settled.at()[3], most_px)?;
    }
    check_lit(candidate, &circle)?;
    at_most(reasons::UNLIKE, unlike, MOST_UNLIKE)?;
    check_limb(settled)
}

/// Checks that the limb is a circle all along its lit part, and not a part of another object's outline.
fn check_limb(settled: &Settled) -> Result<(), Stopped> {
    let Settled { found, limb, .. } = settled;
    let radius = settled.at()[2];
    let covariance = settled.covariance();
    let sigma = covariance.trace().max(0.0).sqrt() / radius;
    let is_sharp = |point: &&LimbPoint| point.excess_px.sigma < MOST_POINT_SIGMA * radius;
    let sharp: Vec<&LimbPoint> = found.points.iter().filter(is_sharp).collect();
    at_most(reasons::OVAL, axis_ratio(found), MOST_AXIS_RATIO)?;
    at_most(
        reasons::ROUGH,
        roughness_px(&sharp) / radius,
        MOST_ROUGHNESS,
    )?;
    at_most(reasons::UNCERTAIN, sigma, MOST_SIGMA)?;
    at_most(
        reasons::BLUNT,
        1.0 - sharp.len() as f64 / limb.seen().max(1) as f64,
        MOST_BLUNT,
    )
}

fn at_most(reason: Reason, measured: f64, limit: f64) -> Result<(), Stopped> {
    Rejected::at_most(limit, measured, reason).map_err(at(Stage::Checks))
}

fn check_radius(candidate: &Candidate, circle: &Circle) -> Result<(), Stopped> {
    let Some(expected) = candidate.radius() else {
        return Ok(());
    };
    let deviation = (circle.radius / expected.value - 1.0).abs();
    at_most(reasons::RADIUS, deviation, MOST_RADIUS_DEVIATION)
}

/// Checks that the lit fraction of the disc agrees with the expected phase, and so does the position of the light.
fn check_lit(candidate: &Candidate, circle: &Circle) -> Result<(), Stopped> {
    let Some(expected) = candidate.expected.phase_angle_deg else {
        return Ok(());
    };
    let expected = lit(expected.value);
    at_most(
        reasons::LIT,
        candidate.light_area(circle) - expected,
        MOST_LIT_DEVIATION,
    )?;
    if candidate.outline.is_cut {
        return Ok(());
    }
    let seen = candidate.sphere_by_middle(circle).lit();
    at_most(reasons::LIT, (seen - expected).abs(), MOST_LIT_DEVIATION)
}

/// Brightness of the sky around a disc relative to saturation.
fn glare(view: &View, circle: &Circle) -> f64 {
    let (frame, levels) = (view.frame, view.levels);
    const PLACES: usize = 48;
    const DISTANCES: usize = 4;
    let (mut sum, mut count) = (0.0, 0);
    for n in 0..PLACES * DISTANCES {
        let angle = (n / DISTANCES) as f64 / PLACES as f64 * std::f64::consts::TAU;
        let part = (n % DISTANCES) as f64 / DISTANCES as f64;
        let distance = (GLARE.start + (GLARE.end - GLARE.start) * part) * circle.radius;
        let (sin, cos) = angle.sin_cos();
        let at = circle.centre + Vector2::new(cos, sin) * distance;
        let seen = view.plane.sensor(at);
        let (x, y) = (seen.x.round(), seen.y.round());
        if x >= 0.0 && y >= 0.0 && x < frame.width() as f64 && y < frame.height() as f64 {
            sum += f64::from(frame.dn(x as usize, y as usize)) - levels.dark_dn;
            count += 1;
        }
    }
    sum / f64::from(count.max(1)) / (levels.saturated_dn - levels.dark_dn).max(1.0)
}

/// Ratio of the longest to the shortest axis, from the limb's departures from a circle; 1 if they are not significant.
fn axis_ratio(found: &LimbFit) -> f64 {
    let terms = |angle: f64| {
        let ((sin, cos), (sin2, cos2)) = (angle.sin_cos(), (2.0 * angle).sin_cos());
        SVector::from([cos, sin, cos2, sin2])
    };
    let points = &found.points;
    let terms: Vec<SVector<f64, 4>> = points.iter().map(|p| terms(p.angle_rad)).collect();
    let excess: Vec<f64> = points.iter().map(|p| p.excess_px.value).collect();
    let sigmas: Vec<f64> = points.iter().map(|p| p.excess_px.sigma).collect();
    let Ok(fit) = regression(&terms, &excess, &sigmas) else {
        return 1.0;
    };
    let oval = fit.parameters.fixed_rows::<2>(2).norm();
    let variance = fit.covariance.fixed_view::<2, 2>(2, 2).trace();
    let radius = found.fitted.parameters[2];
    match oval > OVAL_SIGMAS * variance.max(0.0).sqrt() && oval < radius {
        true => (radius + oval) / (radius - oval),
        false => 1.0,
    }
}

/// Rms distance of the limb from the circle beyond its sigmas, px.
fn roughness_px(points: &[&LimbPoint]) -> f64 {
    let excess = points.iter().map(|point| point.excess_px);
    let squares = excess.map(|excess| excess.value.powi(2) - excess.sigma.powi(2));
    let mean = squares.sum::<f64>() / points.len().max(1) as f64;
    mean.max(0.0).sqrt()
}
