//! The process along an axis: a place whose acceleration is a random walk, swings, and the error that neighbours share.

use super::kalman::{Gaussian, Process, Step, log_likelihood, smooth};
use super::{Measurement, Moment, SharedErrors};
use nalgebra::{Matrix1, Matrix2, Matrix3, SMatrix, SVector, Vector1};

/// A swing of the gondola: a damped harmonic oscillator that white noise drives, x'' + 2 x' / damping_s + rate^2 x = noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Swing {
    pub rate_rad_per_s: f64,
    /// In which its amplitude falls to 1/e where nothing drives it: a period at least.
    pub damping_s: f64,
    /// Square root of the noise's density, unit/s^1.5.
    pub drive: f64,
}

impl Swing {
    pub fn period_s(&self) -> f64 {
        std::f64::consts::TAU / self.rate_rad_per_s
    }

    /// Of place and speed.
    fn transition(&self, step_s: f64) -> Matrix2<f64> {
        let (rate2, decay) = (self.rate_rad_per_s.powi(2), 1.0 / self.damping_s);
        let damped = (rate2 - decay * decay).sqrt();
        let (sin, cos) = (damped * step_s).sin_cos();
        let sin = sin / damped;
        Matrix2::new(cos + decay * sin, sin, -rate2 * sin, cos - decay * sin)
            * (-decay * step_s).exp()
    }

    /// What the noise leaves after a step: what it leaves in the long run, except for what remains of that after the step.
    fn noise(&self, transition: &Matrix2<f64>) -> Matrix2<f64> {
        let speed2 = self.drive.powi(2) * self.damping_s / 4.0;
        let lasting = Matrix2::new(speed2 / self.rate_rad_per_s.powi(2), 0.0, 0.0, speed2);
        lasting - transition * lasting * transition.transpose()
    }
}

/// At most so many swings of an axis.
pub(super) const MOST_SWINGS: usize = 3;
/// Place, speed and acceleration; the shared error in its own sigma.
const WITHOUT_SWINGS: usize = 4;
const SHARED: usize = 3;
/// Prior of place, speed (unit/s) and acceleration (unit/s^2) before the first frame.
const FIRST_SIGMA: [f64; 3] = [1e4, 1e3, 1e3];
/// ... and of a swing's place.
const FIRST_SWING: f64 = 1e2;
/// Over longer gaps nothing is said about the path.
pub(super) const LONGEST_GAP_S: f64 = 10.0;

/// Moments in the order of time.
pub(super) enum Moments<'a> {
    /// Those that were measured.
    Measured(&'a [Moment]),
    /// And between them times at which the motion is asked for.
    Asked {
        measured: &'a [Moment],
        times_s: &'a [f64],
        order: Vec<Place>,
    },
}

/// A moment's place among the measured ones, or among the times that are asked for.
#[derive(Clone, Copy)]
pub(super) enum Place {
    Measured(u32),
    Asked(u32),
}

impl<'a> Moments<'a> {
    /// Times in order, each behind what was measured until then.
    pub fn asked(measured: &'a [Moment], times_s: &'a [f64]) -> Self {
        let mut order = Vec::with_capacity(measured.len() + times_s.len());
        let mut next = 0;
        for (n, time_s) in (0..).zip(times_s) {
            let until = measured[next..].iter().take_while(|m| m.time_s <= *time_s);
            let until = next + until.count();
            order.extend((next..until).map(|n| Place::Measured(n as u32)));
            order.push(Place::Asked(n));
            next = until;
        }
        order.extend((next..measured.len()).map(|n| Place::Measured(n as u32)));
        Self::Asked {
            measured,
            times_s,
            order,
        }
    }

    pub fn len(&self) -> usize {
        match self {
            Self::Measured(measured) => measured.len(),
            Self::Asked { order, .. } => order.len(),
        }
    }

    pub fn is_asked(&self, n: usize) -> bool {
        matches!(self, Self::Asked { order, .. } if matches!(order[n], Place::Asked(_)))
    }

    /// What was measured at a moment; its time alone, where it is one that is asked for.
    fn at(&self, n: usize) -> Result<&'a Moment, f64> {
        match self {
            Self::Measured(measured) => Ok(&measured[n]),
            Self::Asked {
                measured,
                times_s,
                order,
            } => match order[n] {
                Place::Measured(n) => Ok(&measured[n as usize]),
                Place::Asked(n) => Err(times_s[n as usize]),
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
    /// Of the step to each moment: square root of the density of the acceleration's walk, unit/s^2.5.
    pub process_noise: &'a [f64],
}

/// Smoothed estimate of a moment, along an axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Smoothed {
    pub place: f64,
    pub variance: f64,
    pub speed: f64,
    /// What a frame measures there: the place with the error that neighbours share.
    pub seen: f64,
    pub seen_variance: f64,
    /// Place of each swing.
    pub swings: [f64; MOST_SWINGS],
}

impl Axis<'_> {
    /// Logarithm of the likelihood of all measurements up to a constant. `None` where the filter fails.
    pub fn log_likelihood(&self) -> Option<f64> {
        match self.swings.len() {
            0 => log_likelihood::<WITHOUT_SWINGS>(self),
            1 => log_likelihood::<{ WITHOUT_SWINGS + 2 }>(self),
            2 => log_likelihood::<{ WITHOUT_SWINGS + 4 }>(self),
            _ => log_likelihood::<{ WITHOUT_SWINGS + 6 }>(self),
        }
    }

    /// The motion at each moment, from the last to the first. `None` where the filter fails.
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
            let seen = places::<N>(self.shared_sigma(moment));
            let speeds = (1..N).step_by(2).filter(|n| *n != SHARED);
            let swing = |k: usize| state.mean.get(WITHOUT_SWINGS + 2 * k).copied();
            let smoothed = Smoothed {
                place: place.dot(&state.mean),
                variance: variance(&place),
                speed: speeds.map(|n| state.mean[n]).sum(),
                seen: seen.dot(&state.mean),
                seen_variance: variance(&seen),
                swings: std::array::from_fn(|k| swing(k).unwrap_or(0.0)),
            };
            each(moment, &smoothed);
        })
    }

    fn shared_sigma(&self, moment: usize) -> f64 {
        let measured = self.moments.measured(moment);
        measured.map_or(0.0, |seen| seen[self.axis].shared_variance.max(0.0).sqrt())
    }
}

/// The derivatives of what a frame measures by the state.
fn places<const N: usize>(shared_sigma: f64) -> SVector<f64, N> {
    SVector::from_fn(|n, _| match n {
        SHARED => shared_sigma,
        0 => 1.0,
        n if n > SHARED && n % 2 == 0 => 1.0,
        _ => 0.0,
    })
}

/// The random walk of the acceleration: place, speed and acceleration after a step, and its noise for a density of one.
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
        sigma.fixed_rows_mut::<3>(0).copy_from_slice(&FIRST_SIGMA);
        for (k, swing) in self.swings.iter().enumerate() {
            let at = WITHOUT_SWINGS + 2 * k;
            sigma[at] = FIRST_SWING;
            sigma[at + 1] = FIRST_SWING * swing.rate_rad_per_s;
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
        let kept = self.shared.kept(before, now);
        transition[(SHARED, SHARED)] = kept;
        noise[(SHARED, SHARED)] = 1.0 - kept * kept;
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
