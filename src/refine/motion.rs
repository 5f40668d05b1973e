//! The Sun's path over the plate between frames: position, speed and acceleration, the last a random walk (Kalman; Rauch,
//! Tung and Striebel), each axis on its own. How restless the gondola is, the frames tell.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

/// A moment of the path, with what was measured then, if anything was: place and variance in each axis, mil and mil^2.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    pub time_s: f64,
    pub measured: Option<[(f64, f64); 2]>,
}

/// The path at a moment, per axis: place (mil), its variance, and speed (mil/s).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    pub place_mil: [f64; 2],
    pub variance_mil2: [f64; 2],
    pub speed_mil_per_s: [f64; 2],
}

/// The path of a flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    pub points: Vec<PathPoint>,
    /// Random walk of the acceleration, mil/s^2 after a second.
    pub restless: f64,
}

/// How restless gondolas may be: from, to, and the factor between values that are tried.
const RESTLESS: [f64; 3] = [0.1, 1e5, 3.0];
/// A surprise counts no more than this, chi^2: a spoiled frame does not make a gondola restless.
const MOST_SURPRISE: f64 = 16.0;
/// What is known of speed and acceleration before the first frame.
const FIRST_SIGMA: [f64; 3] = [1e4, 1e3, 1e3];
/// Over longer gaps nothing is said about the path.
const LONGEST_GAP_S: f64 = 10.0;

#[derive(Clone, Copy)]
struct Estimate {
    state: Vector3<f64>,
    covariance: Matrix3<f64>,
}

/// The smoothed path through moments in the order of time. `None` where nothing was measured.
pub fn path(moments: &[Moment]) -> Option<Path> {
    moments.iter().find(|moment| moment.measured.is_some())?;
    let restless = restless(moments)?;
    let axes = [0, 1].map(|axis| smoothed(moments, axis, restless));
    let [x, y] = axes;
    let (x, y) = (x?, y?);
    let points = x.iter().zip(&y).map(|(x, y)| PathPoint {
        place_mil: [x.state.x, y.state.x],
        variance_mil2: [x.covariance.m11.max(0.0), y.covariance.m11.max(0.0)],
        speed_mil_per_s: [x.state.y, y.state.y],
    });
    Some(Path {
        points: points.collect(),
        restless,
    })
}

/// How far a measurement is from what all others say, chi^2 of two.
pub fn pull_chi2(point: &PathPoint, measured: &[(f64, f64); 2]) -> f64 {
    let axis = |n: usize| {
        let (place, variance) = measured[n];
        // The smoothed place holds this measurement: without it, it would lie farther off.
        let left = (variance - point.variance_mil2[n]).max(1e-3 * variance);
        (place - point.place_mil[n]).powi(2) / left
    };
    axis(0) + axis(1)
}

fn restless(moments: &[Moment]) -> Option<f64> {
    let [from, to, factor] = RESTLESS;
    let count = ((to / from).ln() / factor.ln()).ceil() as i32;
    let tried: Vec<f64> = (0..=count).map(|n| from * factor.powi(n)).collect();
    let likelihood = |restless: &f64| {
        let axes = [0, 1].map(|axis| forwards(moments, axis, *restless, |_| {}));
        Some((axes[0]? + axes[1]?, *restless))
    };
    let found: Vec<_> = tried.par_iter().filter_map(likelihood).collect();
    let best = found.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(best.1)
}

fn transition(step_s: f64) -> Matrix3<f64> {
    Matrix3::new(
        1.0,
        step_s,
        step_s.powi(2) / 2.0, //
        0.0,
        1.0,
        step_s, //
        0.0,
        0.0,
        1.0,
    )
}

/// Covariance that a random walk of the acceleration leaves after a time.
fn wandered(step_s: f64, restless: f64) -> Matrix3<f64> {
    let [t, t2, t3, t4, t5] = [1, 2, 3, 4, 5].map(|n| step_s.powi(n));
    Matrix3::new(
        t5 / 20.0,
        t4 / 8.0,
        t3 / 6.0, //
        t4 / 8.0,
        t3 / 3.0,
        t2 / 2.0, //
        t3 / 6.0,
        t2 / 2.0,
        t,
    ) * restless.powi(2)
}

fn first() -> Estimate {
    let [place, speed, acceleration] = FIRST_SIGMA.map(|sigma| sigma.powi(2));
    Estimate {
        state: Vector3::zeros(),
        covariance: Matrix3::from_diagonal(&Vector3::new(place, speed, acceleration)),
    }
}

/// Seconds since the moment before; after a gap the path begins anew.
fn step_s(moments: &[Moment], n: usize) -> Option<f64> {
    let step_s = moments[n].time_s - moments[n.checked_sub(1)?].time_s;
    (step_s <= LONGEST_GAP_S).then_some(step_s.max(0.0))
}

fn predicted(before: &Estimate, step_s: f64, restless: f64) -> Estimate {
    let by = transition(step_s);
    Estimate {
        state: by * before.state,
        covariance: by * before.covariance * by.transpose() + wandered(step_s, restless),
    }
}

fn forwards(
    moments: &[Moment],
    axis: usize,
    restless: f64,
    mut each: impl FnMut(Estimate),
) -> Option<f64> {
    let mut now = first();
    let mut likelihood = 0.0;
    for (n, moment) in moments.iter().enumerate() {
        now = match step_s(moments, n) {
            Some(step_s) => predicted(&now, step_s, restless),
            None => first(),
        };
        if let Some(measured) = moment.measured {
            let (place, variance) = measured[axis];
            let spread = now.covariance.m11 + variance;
            let surprise = place - now.state.x;
            likelihood -= (surprise.powi(2) / spread).min(MOST_SURPRISE) / 2.0 + spread.ln() / 2.0;
            let gain = now.covariance.column(0) / spread;
            now.state += gain * surprise;
            now.covariance -= gain * now.covariance.row(0);
            now.covariance = (now.covariance + now.covariance.transpose()) / 2.0;
        }
        each(now);
    }
    likelihood.is_finite().then_some(likelihood)
}

fn smoothed(moments: &[Moment], axis: usize, restless: f64) -> Option<Vec<Estimate>> {
    let mut estimates = Vec::with_capacity(moments.len());
    forwards(moments, axis, restless, |estimate| estimates.push(estimate))?;
    for n in (0..estimates.len().saturating_sub(1)).rev() {
        let Some(step_s) = step_s(moments, n + 1) else {
            continue;
        };
        let (now, next) = (estimates[n], estimates[n + 1]);
        let ahead = predicted(&now, step_s, restless);
        let Some(root) = ahead.covariance.cholesky() else {
            continue;
        };
        let gain = now.covariance * transition(step_s).transpose() * root.inverse();
        let covariance =
            now.covariance + gain * (next.covariance - ahead.covariance) * gain.transpose();
        estimates[n] = Estimate {
            state: now.state + gain * (next.state - ahead.state),
            covariance: (covariance + covariance.transpose()) / 2.0,
        };
    }
    Some(estimates)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A swing of 80 mil in 12 s, seen four times a second with an error of 0.1 mil.
    fn swing() -> Vec<(Moment, f64)> {
        let moment = |n: i32| {
            let time_s = f64::from(n) / 4.0;
            let truth = 80.0 * (time_s * std::f64::consts::TAU / 12.0).sin();
            let noise = 0.1 * f64::from(n * 7919 % 101 - 50) / 29.0;
            let measured = (n % 10 != 3).then_some([(truth + noise, 0.01), (5.0 + noise, 0.01)]);
            (Moment { time_s, measured }, truth)
        };
        (0..200).map(moment).collect()
    }

    #[test]
    fn the_path_passes_through_gaps_within_its_sigma_and_is_steadier_than_the_frames() {
        let (moments, truth): (Vec<_>, Vec<_>) = swing().into_iter().unzip();
        let path = path(&moments).unwrap();
        let (mut at_frames, mut sigmas) = (0.0, 0.0);
        for ((point, moment), truth) in path.points.iter().zip(&moments).zip(truth) {
            let miss = point.place_mil[0] - truth;
            match moment.measured {
                Some(_) => at_frames += miss.powi(2),
                None => assert!(miss.abs() < 4.0 * point.variance_mil2[0].sqrt(), "{miss}"),
            }
            sigmas += point.variance_mil2[0];
        }
        assert!((at_frames / 180.0_f64).sqrt() < 0.1);
        assert!((sigmas / 200.0).sqrt() < 0.1);
    }

    #[test]
    fn what_lies_off_the_path_stands_out() {
        let (mut moments, _): (Vec<_>, Vec<_>) = swing().into_iter().unzip();
        moments[100].measured = moments[100].measured.map(|[x, y]| [(x.0 + 5.0, x.1), y]);
        let path = path(&moments).unwrap();
        let pulls = path.points.iter().zip(&moments);
        let pulls = pulls.map(|(p, m)| m.measured.map_or(0.0, |measured| pull_chi2(p, &measured)));
        let worst = pulls.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
        assert_eq!(worst.map(|(n, _)| n), Some(100));
    }
}
