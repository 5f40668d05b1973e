//! Checks whether the IMU's numbers are in other units. The filter may find an attitude from them, and reject only some of
//! its measurements.

use super::measurement::{DirectionObservation, Measurement};
use super::run::Flight;
use nalgebra::Vector3;

/// The median of the specific force, or that of the first samples, is this close to 1: gravity in g.
const NEAR_ONE_G: f64 = 0.1;
const FIRST_SAMPLES: usize = 200;
/// Maximum sampling interval of an IMU for inertial navigation, s.
const LONGEST_STEP_S: f64 = 1.0;
/// Maximum time between directions from which a rate is computed, s.
const LONGEST_TURN_S: f64 = 2.0;
/// Maximum relative sigma of the rates' scale from the directions, and its tolerance about the scale of a degree.
const KNOWN: f64 = 0.2;
const AGREES: f64 = 0.5;

/// The units that the IMU's numbers may be in instead of those of its columns, with the reason; empty for a valid flight.
pub fn suspected_units(runs: &[Flight]) -> Vec<String> {
    [force_in_g(runs), time_in_parts(runs), rate_in_deg(runs)]
        .into_iter()
        .flatten()
        .collect()
}

fn force_in_g(runs: &[Flight]) -> Option<String> {
    let forces = || {
        let samples = runs.iter().flat_map(|run| &run.imu);
        samples.map(|sample| sample.force_m_s2.norm())
    };
    let medians = [median(forces()), median(forces().take(FIRST_SAMPLES))];
    let near_one = |force: &f64| (force - 1.0).abs() < NEAR_ONE_G;
    let force = medians.into_iter().flatten().find(near_one)?;
    Some(format!(
        "the specific force has a median of {force:.3} m/s^2, gravity is 9.8: in g?"
    ))
}

fn time_in_parts(runs: &[Flight]) -> Option<String> {
    let steps = runs.iter().flat_map(|run| run.imu.windows(2));
    let step_s = median(steps.map(|pair| pair[1].t_s - pair[0].t_s))?;
    let unit = match step_s {
        ..LONGEST_STEP_S => return None,
        step_s if step_s < 1e3 * LONGEST_STEP_S => "ms",
        _ => "us",
    };
    Some(format!(
        "the IMU's samples are {step_s} s apart: t_s in {unit}?"
    ))
}

/// Compares the rotation of directions in the body's axes with the rate. The least-squares scale between the two is 1; for
/// rates in deg/s it is that of a degree.
fn rate_in_deg(runs: &[Flight]) -> Option<String> {
    let (mut both, mut square, mut noise) = (0.0, 0.0, 0.0);
    for run in runs {
        for (before, after) in neighbours(run) {
            let camera = &run.settings.cameras[after.camera].body_from_camera;
            let [from, to] = [before, after].map(|one| (camera * one.unit).into_inner());
            let turned = turned_rad(run, before.t_s, after.t_s);
            let said = -turned.cross(&from);
            both += said.dot(&(to - from));
            square += said.norm_squared();
            let sigma_rad = before.sigma_rad.hypot(after.sigma_rad);
            noise += said.norm_squared() * sigma_rad.powi(2);
        }
    }
    let (scale, sigma) = (both / square, noise.sqrt() / square);
    let degrees = scale / 1f64.to_radians();
    let is_known = sigma / 1f64.to_radians() < KNOWN;
    ((degrees - 1.0).abs() < AGREES && is_known).then(|| {
        format!(
            "the directions turn {:.0} times more slowly than the rates say: in deg/s?",
            scale.recip()
        )
    })
}

/// Pairs of successive directions to a target from one camera.
fn neighbours(
    run: &Flight,
) -> impl Iterator<Item = (&DirectionObservation, &DirectionObservation)> {
    let mut last: Vec<&DirectionObservation> = Vec::new();
    let observations = run.measurements.iter().filter_map(|one| match one {
        Measurement::Direction(observation) => Some(observation),
        Measurement::Fix(_) => None,
    });
    observations.filter_map(move |after| {
        let same = |one: &&mut &DirectionObservation| {
            (one.camera, one.target) == (after.camera, after.target)
        };
        let Some(place) = last.iter_mut().find(same) else {
            last.push(after);
            return None;
        };
        let before = std::mem::replace(place, after);
        let apart_s = after.t_s - before.t_s;
        (apart_s > 0.0 && apart_s < LONGEST_TURN_S).then_some((before, after))
    })
}

/// Rotation of the body about its axes, from the rates alone.
fn turned_rad(run: &Flight, from_s: f64, to_s: f64) -> Vector3<f64> {
    let [from, to] = [from_s, to_s].map(|t_s| run.imu.partition_point(|one| one.t_s <= t_s));
    let steps = run.imu[from.saturating_sub(1)..to].windows(2);
    steps
        .map(|pair| pair[1].rate_rad_s * (pair[1].t_s - pair[0].t_s))
        .sum()
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    let half = values.len().checked_sub(1)? / 2;
    let (_, median, _) = values.select_nth_unstable_by(half, f64::total_cmp);
    Some(*median)
}
