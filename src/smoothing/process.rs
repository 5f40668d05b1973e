//! The process along an axis: a position whose acceleration is a random walk, swings, and the error shared by neighbours.

use super::kalman::{Gaussian, Process, Step, log_likelihood, smooth};
use super::{Measurement, Moment, SharedErrors};
use nalgebra::{Matrix1, Matrix2, Matrix3, SMatrix, SVector, Vector1};

/// A swing of the gondola: a damped harmonic oscillator driven by white noise, x'' + 2 x' / damping_s + rate^2 x = noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Swing {
    pub rate_rad_per_s: f64,
    /// Time in which its amplitude falls to 1/e without a drive: a period at least.
    pub damping_s: f64,
    /// Square root of the noise's density, unit/s^1.5.
    pub drive: f64,
}

impl Swing {
    pub fn period_s(&self) -> f64 {
        std::f64::consts::TAU / self.rate_rad_per_s
    }

    /// Transition of position and speed.
    fn transition(&self, step_s: f64) -> Matrix2<f64> {
        let (rate2, decay) = (self.rate_rad_per_s.powi(2), 1.0 / self.damping_s);
        let damped = (rate2 - decay * decay).sqrt();
        let (sin, cos) = (damped * step_s).sin_cos();
        let sin = sin / damped;
        Matrix2::new(cos + decay * sin, sin, -rate2 * sin, cos - decay * sin)
            * (-decay * step_s).exp()
    }

    /// Covariance of the noise after a step: the stationary covariance, minus its part that remains from before the step.
    fn noise(&self, transition: &Matrix2<f64>) -> Matrix2<f64> {
        let speed2 = self.drive.powi(2) * self.damping_s / 4.0;
        let lasting = Matrix2::new(speed2 / self.rate_rad_per_s.powi(2), 0.0, 0.0, speed2);
        lasting - transition * lasting * transition.transpose()
    }
}

/// Greatest number of swings of an axis.
pub(super) const MOST_SWINGS: usize = 3;
/// Number of states without swings: position, speed and acceleration; the shared error in units of its sigma.
const WITHOUT_SWINGS: usize = 4;
const SHARED: usize = 3;
/// Prior of position, speed (unit/s) and acceleration (unit/s^2) before the first frame.
const PRIOR_SIGMA: [f64; 3] = [1e4, 1e3, 1e3];
/// ... and of a swing's displacement.
const PRIOR_SWING: f64 = 1e2;
/// In longer gaps the path is not determined.
pub(super) const LONGEST_GAP_S: f64 = 10.0;

/// Moments in the order of time.
pub(super) enum Moments<'a> {
    /// The measured moments.
    Measured(&'a [Moment]),
    /// With additional times between them at which the motion is evaluated.
    Requested {
        measured: &'a [Moment],
        times_s: &'a [f64],
        order: Vec<MomentIndex>,
    },
}

/// Index of a moment, among the measured ones or the additional times.
#[derive(Clone, Copy)]
pub(super) enum MomentIndex {
    Measured(u32),
    Requested(u32),
}

impl<'a> Moments<'a> {
    /// Inserts times, which are in order, each after the measurements up to it.
    pub fn requested(measured: &'a [Moment], times_s: &'a [f64]) -> Self {
        let mut order = Vec::with_capacity(measured.len() + times_s.len());
        let mut next = 0;
        for (n, time_s) in (0..).zip(times_s) {
            let until = measured[next..].iter().take_while(|m| m.time_s <= *time_s);
            let until = next + until.count();
            order.extend((next..until).map(|n| MomentIndex::Measured(n as u32)));
            order.push(MomentIndex::Requested(n));
            next = until;
        }
        order.extend((next..measured.len()).map(|n| MomentIndex::Measured(n as u32)));
        Self::Requested {
            measured,
            times_s,
            order,
        }
    }

    pub fn len(&self) -> usize {
        match self {
            Self::Measured(measured) => measured.len(),
            Self::Requested { order, .. } => order.len(),
        }
    }

    pub fn is_requested(&self, n: usize) -> bool {
        matches!(self, Self::Requested { order, .. } if matches!(order[n], MomentIndex::Requested(_)))
    }

    /// The measurement at a moment, or the time alone of an additional one.
    fn at(&self, n: usize) -> Result<&'a Moment, f64> {
        match self {
            Self::Measured(measured) => Ok(&measured[n]),
            Self::Requested {
                measured,
                times_s,
                order,
            } => match order[n] {
                MomentIndex::Measured(n) => Ok(&measured[n as usize]),
                MomentIndex::Requested(n) => Err(times_s[n as usize]),
            },
        }
    }

    pub fn time_s(&self, n: usize) -> f64 {
        self.at(n)
            .map_or_else(|time_s| time_s, |moment| moment.time_s)
    }

    fn measured(&self, n: usize) -> Option<&'a [Measurement; 2]> {
        self.at(n).ok()?.measured.as_ref()
    }
}

/// The motion along one axis.
pub(super) struct Axis<'a> {
    pub moments: &'a Moments<'a>,
    pub axis: usize,
    pub shared: &'a SharedErrors,
    pub swings: &'a [Swing],
    /// Process noise of the step to each moment: square root of the density of the acceleration's walk, unit/s^2.5.
    pub process_noise: &'a [f64],
}

/// Smoothed estimate at a moment, along an axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Smoothed {
    pub place: f64,
    pub variance: f64,
    pub speed: f64,
    /// Predicted measurement: the position plus the error shared by neighbours.
    pub predicted: f64,
    pub predicted_variance: f64,
    /// Displacement of each swing.
    pub swings: [f64; MOST_SWINGS],
}

impl Axis<'_> {
    /// Logarithm of the likelihood of all measurements up to a constant. `None` if the filter fails.
    pub fn log_likelihood(&self) -> Option<f64> {
        match self.swings.len() {
            0 => log_likelihood::<WITHOUT_SWINGS>(self),
            1 => log_likelihood::<{ WITHOUT_SWINGS + 2 }>(self),
            2 => log_likelihood::<{ WITHOUT_SWINGS + 4 }>(self),
            _ => log_likelihood::<{ WITHOUT_SWINGS + 6 }>(self),
        }
    }

    /// Smooths the motion at each moment, from the last to the first. `None` if the filter fails.
    pub fn smooth(&self, each: impl FnMut(usize, &Smoothed)) -> Option<()> {
        match self.swings.len() {
            0 => self.smooth_as::<WITHOUT_SWINGS>(each),
            1 => self.smooth_as::<{ WITHOUT_SWINGS + 2 }>(each),
            2 => self.smooth_as::<{ WITHOUT_SWINGS + 4 }>(each),
            _ => self.smooth_as::<{ WITHOUT_SWINGS + 6 }>(each),
        }
    }

    fn smooth_as<const N: usize>(&self, mut each: impl FnMut(usize, &Smoothed)) -> Option<()> {
        let place = places::<N>(0.0);
        smooth::<N>(self, |moment, state, _| {
            let variance = |of: &SVector<f64, N>| of.dot(&(state.covariance * of));
            let predicted = places::<N>(self.shared_sigma(moment));
            let speeds = (1..N).step_by(2).filter(|n| *n != SHARED);
            let swing = |k: usize| state.mean.get(WITHOUT_SWINGS + 2 * k).copied();
            let smoothed = Smoothed {
                place: place.dot(&state.mean),
                variance: variance(&place),
                speed: speeds.map(|n| state.mean[n]).sum(),
                predicted: predicted.dot(&state.mean),
                predicted_variance: variance(&predicted),
                swings: std::array::from_fn(|k| swing(k).unwrap_or(0.0)),
            };
            each(moment, &smoothed);
        })
    }

    fn shared_sigma(&self, moment: usize) -> f64 {
        let measured = self.moments.measured(moment);
        measured.map_or(0.0, |both| both[self.axis].shared_variance.max(0.0).sqrt())
    }
}

/// Derivatives of a measured position by the state.
fn places<const N: usize>(shared_sigma: f64) -> SVector<f64, N> {
    SVector::from_fn(|n, _| match n {
        SHARED => shared_sigma,
        0 => 1.0,
        n if n > SHARED && n % 2 == 0 => 1.0,
        _ => 0.0,
    })
}

/// The random walk of the acceleration: transition of position, speed and acceleration, and the process noise for a density of one.
fn walk(step_s: f64) -> (Matrix3<f64>, Matrix3<f64>) {
    let [t, t2, t3, t4, t5] = [1, 2, 3, 4, 5].map(|n| step_s.powi(n));
    let transition = Matrix3::new(1.0, t, t2 / 2.0, 0.0, 1.0, t, 0.0, 0.0, 1.0);
    let noise = Matrix3::new(
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
    (transition, noise)
}

impl<const N: usize> Process<N> for Axis<'_> {
    fn moments(&self) -> usize {
        self.moments.len()
    }

    fn initial(&self) -> Gaussian<N> {
        let mut sigma = SVector::<f64, N>::from_element(1.0);
        sigma.fixed_rows_mut::<3>(0).copy_from_slice(&PRIOR_SIGMA);
        for (k, swing) in self.swings.iter().enumerate() {
            let at = WITHOUT_SWINGS + 2 * k;
            sigma[at] = PRIOR_SWING;
            sigma[at + 1] = PRIOR_SWING * swing.rate_rad_per_s;
        }
        Gaussian::new(SVector::zeros(), &sigma.component_mul(&sigma))
    }

    fn step(&self, moment: usize) -> Option<Step<N>> {
        let [before, now] = [moment - 1, moment].map(|n| self.moments.time_s(n));
        let step_s = (now - before).max(0.0);
        if step_s > LONGEST_GAP_S {
            return None;
        }
        let mut transition = SMatrix::<f64, N, N>::zeros();
        let mut noise = SMatrix::<f64, N, N>::zeros();
        let (walk, walked) = walk(step_s);
        let density = self.process_noise[moment].powi(2);
        transition.fixed_view_mut::<3, 3>(0, 0).copy_from(&walk);
        noise
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(walked * density));
        let correlation = self.shared.correlation(before, now);
        transition[(SHARED, SHARED)] = correlation;
        noise[(SHARED, SHARED)] = 1.0 - correlation * correlation;
        for (k, swing) in self.swings.iter().enumerate() {
            let at = WITHOUT_SWINGS + 2 * k;
            let swung = swing.transition(step_s);
            transition.fixed_view_mut::<2, 2>(at, at).copy_from(&swung);
            noise
                .fixed_view_mut::<2, 2>(at, at)
                .copy_from(&swing.noise(&swung));
        }
        Some(Step { transition, noise })
    }

    fn observe(&self, moment: usize, state: &mut Gaussian<N>) -> Option<f64> {
        let Some(measured) = self.moments.measured(moment) else {
            return Some(0.0);
        };
        let measured = measured[self.axis];
        let jacobian = places::<N>(self.shared_sigma(moment)).transpose();
        let residual = Vector1::new(measured.place - (jacobian * state.mean).x);
        let innovation = state.update(&residual, &jacobian, &Matrix1::new(measured.variance))?;
        Some(innovation.likelihood.log(f64::INFINITY))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_swing_is_the_same_in_one_step_and_in_ten() {
        for periods in [1.0, 10.0, 1e7] {
            let rate_rad_per_s = 0.7;
            let swing = Swing {
                rate_rad_per_s,
                damping_s: periods * std::f64::consts::TAU / rate_rad_per_s,
                drive: 0.2,
            };
            let (one, part) = (swing.transition(5.0), swing.transition(0.5));
            let (mut ten, mut noise) = (Matrix2::identity(), Matrix2::zeros());
            for _ in 0..10 {
                ten = part * ten;
                noise = part * noise * part.transpose() + swing.noise(&part);
            }
            assert!((ten - one).norm() < 1e-12);
            let once = swing.noise(&one);
            assert!((noise - once).norm() < 1e-6 * once.norm());
        }
    }
}
