//! The Sun's path over the plate between frames: position, speed and acceleration, each axis on its own. The acceleration is a random
//! walk, whose process noise is that of greatest likelihood.

use crate::estimation::{Gaussian, Process, Step, log_likelihood, smooth};
use nalgebra::{Matrix1, Matrix3, RowVector3, Vector1, Vector3};
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
    /// Process noise: square root of its density, mil/s^2.5. The acceleration walks by so many mil/s^2 in a second.
    pub process_noise: f64,
}

/// The process noise that gondolas may have, mil/s^2.5: from, to, and the factor between values that are tried.
const PROCESS_NOISE: [f64; 3] = [0.1, 1e5, 3.0];
/// An innovation counts no more than this, chi^2, so that no outlier raises the process noise.
const MOST_CHI2: f64 = 16.0;
/// What is known of place (mil), speed (mil/s) and acceleration (mil/s^2) before the first frame.
const FIRST_SIGMA: [f64; 3] = [1e4, 1e3, 1e3];
/// Over longer gaps nothing is said about the path.
const LONGEST_GAP_S: f64 = 10.0;

/// The smoothed path through moments in the order of time. `None` where nothing was measured.
pub fn path(moments: &[Moment]) -> Option<Path> {
    moments.iter().find(|moment| moment.measured.is_some())?;
    let process_noise = process_noise(moments)?;
    let [x, y] = Axis::both(moments, process_noise).map(|axis| axis.smoothed());
    let points = x?.into_iter().zip(y?).map(|(x, y)| PathPoint {
        place_mil: [x.mean.x, y.mean.x],
        variance_mil2: [x.covariance.m11.max(0.0), y.covariance.m11.max(0.0)],
        speed_mil_per_s: [x.mean.y, y.mean.y],
    });
    Some(Path {
        points: points.collect(),
        process_noise,
    })
}

/// How far a measurement is from what all others say, chi^2 of two.
pub fn residual_chi2(point: &PathPoint, measured: &[(f64, f64); 2]) -> f64 {
    let axis = |n: usize| {
        let (place, variance) = measured[n];
        // The smoothed place holds this measurement: without it, it would lie farther off.
        let left = (variance - point.variance_mil2[n]).max(1e-3 * variance);
        (place - point.place_mil[n]).powi(2) / left
    };
    axis(0) + axis(1)
}

/// The process noise of greatest likelihood.
fn process_noise(moments: &[Moment]) -> Option<f64> {
    let [from, to, factor] = PROCESS_NOISE;
    let count = ((to / from).ln() / factor.ln()).ceil() as i32;
    let tried: Vec<f64> = (0..=count).map(|n| from * factor.powi(n)).collect();
    let likelihood = |noise: &f64| {
        let [x, y] = Axis::both(moments, *noise).map(|axis| log_likelihood(&axis));
        Some((x? + y?, *noise))
    };
    let found: Vec<_> = tried.par_iter().filter_map(likelihood).collect();
    let best = found.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(best.1)
}

/// The path along one axis: place, speed and acceleration.
struct Axis<'a> {
    moments: &'a [Moment],
    axis: usize,
    process_noise: f64,
}

impl<'a> Axis<'a> {
    fn both(moments: &'a [Moment], process_noise: f64) -> [Self; 2] {
        [0, 1].map(|axis| Self {
            moments,
            axis,
            process_noise,
        })
    }

    fn smoothed(&self) -> Option<Vec<Gaussian<3>>> {
        let mut states = Vec::with_capacity(self.moments.len());
        smooth(self, |_, state, _| states.push(*state))?;
        states.reverse();
        Some(states)
    }
}

impl Process<3> for Axis<'_> {
    fn moments(&self) -> usize {
        self.moments.len()
    }

    fn initial(&self) -> Gaussian<3> {
        let variances = FIRST_SIGMA.map(|sigma| sigma.powi(2));
        Gaussian::new(Vector3::zeros(), &variances.into())
    }

    fn step(&self, moment: usize) -> Option<Step<3>> {
        let step_s = self.moments[moment].time_s - self.moments[moment - 1].time_s;
        let [t, t2, t3, t4, t5] = [1, 2, 3, 4, 5].map(|n| step_s.max(0.0).powi(n));
        // What a random walk of the acceleration leaves.
        let walked = Matrix3::new(
            t5 / 20.0,
            t4 / 8.0,
            t3 / 6.0, //
            t4 / 8.0,
            t3 / 3.0,
            t2 / 2.0, //
            t3 / 6.0,
            t2 / 2.0,
            t,
        );
        (step_s <= LONGEST_GAP_S).then(|| Step {
            transition: Matrix3::new(1.0, t, t2 / 2.0, 0.0, 1.0, t, 0.0, 0.0, 1.0),
            noise: walked * self.process_noise.powi(2),
        })
    }

    fn observe(&self, moment: usize, state: &mut Gaussian<3>) -> Option<f64> {
        let Some(measured) = self.moments[moment].measured else {
            return Some(0.0);
        };
        let (place, variance) = measured[self.axis];
        let residual = Vector1::new(place - state.mean.x);
        let innovation = state.update(
            &residual,
            &RowVector3::new(1.0, 0.0, 0.0),
            &Matrix1::new(variance),
        )?;
        Some(innovation.likelihood.log(MOST_CHI2))
    }
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
            let residual = point.place_mil[0] - truth;
            match moment.measured {
                Some(_) => at_frames += residual.powi(2),
                None => assert!(
                    residual.abs() < 4.0 * point.variance_mil2[0].sqrt(),
                    "{residual}"
                ),
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
        let chi2 = path.points.iter().zip(&moments);
        let chi2 = chi2.map(|(p, m)| {
            m.measured
                .map_or(0.0, |measured| residual_chi2(p, &measured))
        });
        let worst = chi2.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
        assert_eq!(worst.map(|(n, _)| n), Some(100));
    }
}
