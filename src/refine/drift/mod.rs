//! The drift of the view: a random walk plus a linear dependence on the camera's temperature.
//!
//! The state is the view and, where the temperature is used, the thermal coefficients: constants that all marks of the flight
//! determine together with the walk.

mod observations;

pub(super) use observations::{MarkObservation, Observations};

use super::view::{Covariance, Reference, STATES, State, UpperTriangle, packed, unpacked};
use crate::smoothing::{Disturbance, Gaussian, Process, Step, log_likelihood, smooth};
use nalgebra::{Matrix4, SMatrix, SVector, Vector4};

/// Process noise of the view's random walk, 1 sigma after a second: square roots of the spectral density.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ProcessNoise {
    pub shift_px: f64,
    /// Rotation and stretch, px at a unit of the plate from its centre.
    pub turn_px: f64,
}

/// Process noise of the view's shear, relative to that of its rotation.
const SHEAR_PART: f64 = 0.1;
/// Uncertainty after a jump: shift; rotation and stretch, px.
const JUMP_PX: [f64; 2] = [10.0, 3.0];
/// Prior of the view before the first mark, 1 sigma from the reference: shift, rotation and shear, px; tilt.
const FIRST_SIGMA: [f64; 4] = [50.0, 50.0, 2.0, 0.01];

/// Number of view parameters that depend on temperature, the first ones: shift x and y, stretch and rotation.
const THERMAL: usize = 4;
/// Prior of the thermal coefficients, 1 sigma, px per degC: cameras on balloons shift by a tenth of a pixel, and aluminium expands by
/// 23e-6, 0.004 px.
const THERMAL_SIGMA_PX: [f64; THERMAL] = [0.2, 0.2, 0.02, 0.02];
/// Number of view parameters and thermal coefficients.
const WITH_THERMAL: usize = STATES + THERMAL;

/// Change of shift x and y, stretch and rotation per degC of the camera's temperature, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ThermalCoefficients {
    pub px_per_degc: Vector4<f64>,
    pub covariance: Matrix4<f64>,
}

/// The view at a moment with its covariance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Estimate {
    pub state: State,
    pub covariance: UpperTriangle,
}

impl Estimate {
    /// Mean and covariance of this estimate or, with a probability, another.
    pub fn or(&self, other: &Self, probability: f64) -> Self {
        let step = other.state - self.state;
        let [own, others] = [self, other].map(|one| unpacked(&one.covariance));
        let rest = 1.0 - probability;
        let apart = step * step.transpose() * probability * rest;
        Self {
            state: self.state + step * probability,
            covariance: packed(&(own * rest + others * probability + apart)),
        }
    }
}

/// A possible jump between a moment and the one before it.
#[derive(Debug, Clone, Copy)]
pub(super) struct JumpCandidate {
    pub moment: usize,
    /// Significance of the jump against process noise: chi^2 of four degrees of freedom.
    pub chi2: f64,
}

/// Smoothed estimate of the view from the whole flight.
pub(super) struct Smoothed {
    pub estimates: Vec<Estimate>,
    /// The most significant candidate for a jump.
    pub jump: Option<JumpCandidate>,
    /// None where the temperature is not used.
    pub thermal: Option<ThermalCoefficients>,
}

/// Inputs of the drift estimate.
pub(super) struct Drift<'a> {
    pub reference: &'a Reference,
    pub observations: &'a Observations,
    pub process_noise: ProcessNoise,
    /// Moments before which the view jumped, in order.
    pub jumps: &'a [usize],
    /// The camera's temperature at each moment, relative to the flight's median, degC; none where it is not used.
    pub temperature_c: Option<&'a [f64]>,
}

impl Drift<'_> {
    /// Logarithm of the likelihood up to a constant. `None` where a covariance cannot be inverted.
    pub fn likelihood(&self) -> Option<f64> {
        match self.temperature_c {
            Some(_) => log_likelihood::<WITH_THERMAL>(self),
            None => log_likelihood::<STATES>(self),
        }
    }

    /// Estimates smoothed over the whole flight.
    pub fn smoothed(&self) -> Option<Smoothed> {
        match self.temperature_c {
            Some(_) => self.smoothed_as::<WITH_THERMAL>(),
            None => self.smoothed_as::<STATES>(),
        }
    }

    fn smoothed_as<const N: usize>(&self) -> Option<Smoothed> {
        let mut smoothed = Smoothed {
            estimates: Vec::with_capacity(self.observations.len()),
            jump: None,
            thermal: None,
        };
        smooth::<N>(self, |moment, state, disturbance| {
            let covariance = state.covariance.fixed_view::<STATES, STATES>(0, 0);
            smoothed.estimates.push(Estimate {
                state: state.mean.fixed_rows::<STATES>(0).into_owned(),
                covariance: packed(&covariance.into_owned()),
            });
            smoothed.thermal = thermal(state);
            let most = smoothed.jump.map_or(0.0, |jump| jump.chi2);
            let jump = disturbance.and_then(|d| self.jump_candidate(moment + 1, d));
            smoothed.jump = jump.filter(|jump| jump.chi2 > most).or(smoothed.jump);
        })?;
        smoothed.estimates.reverse();
        Some(smoothed)
    }

    /// Significance of the disturbance of shift, stretch and rotation before a moment, beyond what the process noise explains.
    fn jump_candidate<const N: usize>(
        &self,
        moment: usize,
        disturbance: &Disturbance<N>,
    ) -> Option<JumpCandidate> {
        if self.jumps.binary_search(&moment).is_ok() {
            return None;
        }
        let residual = disturbance.residual.fixed_rows::<4>(0).into_owned();
        let covariance = disturbance.covariance.fixed_view::<4, 4>(0, 0).into_owned();
        let chi2 = residual.dot(&covariance.cholesky()?.solve(&residual));
        chi2.is_finite().then_some(JumpCandidate { moment, chi2 })
    }

    fn degrees(&self, moment: usize) -> f64 {
        self.temperature_c.map_or(0.0, |degrees| degrees[moment])
    }

    /// Normal equations of a moment's marks: information, gradient and chi^2 at a view.
    fn sums(&self, moment: usize, view: &State) -> (Covariance, State, f64) {
        let (mut information, mut gradient, mut chi2) = (Covariance::zeros(), State::zeros(), 0.0);
        let marks = self.observations.at(moment).iter();
        for mark in marks.filter(|mark| mark.weight > 0.0) {
            let (picture, slopes) = self.reference.picture(mark.printed);
            let residual = mark.observed - picture - slopes * view;
            let weight = mark.information() * f64::from(mark.weight);
            let weighted = slopes.transpose() * weight;
            information += weighted * slopes;
            gradient += weighted * residual;
            chi2 += residual.dot(&(weight * residual));
        }
        (information, gradient, chi2)
    }
}

/// State transition: the coefficients move the view by a change of temperature in degrees.
fn thermal_transition<const N: usize>(degrees: f64) -> SMatrix<f64, N, N> {
    let mut transition = SMatrix::identity();
    for n in STATES..N {
        transition[(n - STATES, n)] = degrees;
    }
    transition
}

/// Variances of shift, rotation, shear and tilt assigned to the view's parameters; zero for the coefficients.
fn of_view<const N: usize>(variances: [f64; 4]) -> SVector<f64, N> {
    SVector::from_fn(|n, _| variances.get(n / 2).copied().unwrap_or(0.0))
}

fn thermal<const N: usize>(state: &Gaussian<N>) -> Option<ThermalCoefficients> {
    (N == WITH_THERMAL).then(|| ThermalCoefficients {
        px_per_degc: state.mean.fixed_rows::<THERMAL>(STATES).into_owned(),
        covariance: state
            .covariance
            .fixed_view::<THERMAL, THERMAL>(STATES, STATES)
            .into_owned(),
    })
}

/// Implemented with and without the thermal coefficients.
impl<const N: usize> Process<N> for Drift<'_> {
    fn moments(&self) -> usize {
        self.observations.len()
    }

    fn initial(&self) -> Gaussian<N> {
        let mut variances = of_view(FIRST_SIGMA.map(|sigma| sigma.powi(2)));
        for n in STATES..N {
            variances[n] = THERMAL_SIGMA_PX[n - STATES].powi(2);
        }
        Gaussian::new(SVector::zeros(), &variances).predicted(&Step {
            transition: thermal_transition(self.degrees(0)),
            noise: SMatrix::zeros(),
        })
    }

    fn step(&self, moment: usize) -> Option<Step<N>> {
        let ProcessNoise { shift_px, turn_px } = self.process_noise;
        let step_s = self.observations.step_s(moment);
        let [mut shift, mut turn] = [shift_px, turn_px].map(|noise| noise.powi(2) * step_s);
        let shear = turn * SHEAR_PART.powi(2);
        if self.jumps.binary_search(&moment).is_ok() {
            shift += JUMP_PX[0].powi(2);
            turn += JUMP_PX[1].powi(2);
        }
        Some(Step {
            transition: thermal_transition(self.degrees(moment) - self.degrees(moment - 1)),
            noise: SMatrix::from_diagonal(&of_view([shift, turn, shear, 0.0])),
        })
    }

    fn observe(&self, moment: usize, state: &mut Gaussian<N>) -> Option<f64> {
        if !self.observations.counts(moment) {
            return Some(0.0);
        }
        let view = state.mean.fixed_rows::<STATES>(0).into_owned();
        let (of_view, gradient_of_view, chi2) = self.sums(moment, &view);
        let mut information = SMatrix::<f64, N, N>::zeros();
        let mut gradient = SVector::<f64, N>::zeros();
        information
            .fixed_view_mut::<STATES, STATES>(0, 0)
            .copy_from(&of_view);
        gradient
            .fixed_rows_mut::<STATES>(0)
            .copy_from(&gradient_of_view);
        let likelihood = state.update_by_information(&information, &gradient, chi2)?;
        Some(likelihood.log(f64::INFINITY))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Distortion;
    use crate::instrument::builtin;
    use crate::plate::MarkId;
    use crate::units::PlateMil;
    use nalgebra::{Vector2, Vector4};
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_xoshiro::Xoshiro256PlusPlus;

    #[test]
    fn one_of_two_has_the_mean_of_both_and_the_scatter_about_it() {
        let estimate = |state: f64, variance: f64| Estimate {
            state: State::from_fn(|n, _| state * (n + 1) as f64),
            covariance: packed(&(Covariance::identity() * variance)),
        };
        let both = [(estimate(1.0, 0.5), 0.75), (estimate(5.0, 2.0), 0.25)];
        let mean: State = both.iter().map(|(one, part)| one.state * *part).sum();
        let scatter = both.iter().map(|(one, part)| {
            let off = one.state - mean;
            (unpacked(&one.covariance) + off * off.transpose()) * *part
        });
        let expected: Covariance = scatter.sum();
        let found = both[0].0.or(&both[1].0, both[1].1);
        assert!((found.state - mean).norm() < 1e-12);
        assert!((unpacked(&found.covariance) - expected).norm() < 1e-5 * expected.norm());
    }

    const COUNT: usize = 600;
    const MARK_SIGMA_PX: f64 = 0.03;

    fn reference() -> Reference {
        let corner = |p: PlateMil| Vector2::new(640.0 - 0.17 * p.x, 480.0 + 0.17 * p.y);
        Reference::through(&Reference::corners().map(corner), Distortion::NONE).unwrap()
    }

    fn temperature_c() -> Vec<f64> {
        (0..COUNT).map(|n| 5.0 * (n as f64 / 40.0).sin()).collect()
    }

    /// The first moments of a flight whose view depends on the temperature by `px_per_degc`, plus a slow random walk; frames show no
    /// marks for a sixth of it. Also returns the true view.
    fn flight(moments: usize, px_per_degc: [f64; THERMAL]) -> (Observations, Vec<State>) {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(4);
        let mut noise = |sigma: f64| sigma * rng.sample::<f64, _>(StandardNormal);
        let (reference, plate) = (reference(), builtin("demo").unwrap().plate);
        let mut walk = State::zeros();
        let seen = |n: usize| !(250..350).contains(&n);
        let mut marks = Vec::new();
        let mut moment = |(n, degrees): (usize, f64)| {
            walk[0] += noise(0.002);
            walk[1] += noise(0.002);
            let mut state = walk;
            let mut thermal_transition = state.fixed_rows_mut::<THERMAL>(0);
            thermal_transition += Vector4::from(px_per_degc) * degrees;
            let observed = (0..9).filter(|_| seen(n)).map(|k| {
                let id = MarkId {
                    i: k % 3 - 1,
                    j: k / 3 - 1,
                };
                let printed = plate.position(id).unwrap();
                let (view, slopes) = reference.picture(printed);
                let error = Vector2::new(noise(MARK_SIGMA_PX), noise(MARK_SIGMA_PX));
                let information = MARK_SIGMA_PX.powi(-2) as f32;
                MarkObservation {
                    observed: view + slopes * state + error,
                    printed,
                    information: [information, 0.0, information],
                    weight: 1.0,
                }
            });
            marks.extend(observed);
            ((n as f64 / 4.0, marks.len() as u32), state)
        };
        let degrees = temperature_c().into_iter().take(moments).enumerate();
        let (moments, truth): (Vec<_>, Vec<_>) = degrees.map(&mut moment).unzip();
        (Observations::new(marks, moments.into_iter()), truth)
    }

    fn drift<'a>(
        reference: &'a Reference,
        observations: &'a Observations,
        temperature_c: Option<&'a [f64]>,
    ) -> Drift<'a> {
        // Without the temperature the walk must follow it.
        let shift_px = if temperature_c.is_some() { 0.004 } else { 0.1 };
        Drift {
            reference,
            observations,
            process_noise: ProcessNoise {
                shift_px,
                turn_px: 0.001,
            },
            jumps: &[],
            temperature_c,
        }
    }

    #[test]
    fn what_a_degree_does_is_reported_and_bridges_the_time_without_marks() {
        let truth_per_degc = [0.13, -0.08, 0.004, -0.01];
        let (observations, truth) = flight(COUNT, truth_per_degc);
        let (reference, degrees) = (reference(), temperature_c());
        let with = drift(&reference, &observations, Some(&degrees));
        let without = drift(&reference, &observations, None);
        assert!(with.likelihood().unwrap() > without.likelihood().unwrap() + 100.0);
        let (with, without) = (with.smoothed().unwrap(), without.smoothed().unwrap());
        let thermal = with.thermal.unwrap();
        for (n, truth) in truth_per_degc.iter().enumerate() {
            let sigma = thermal.covariance[(n, n)].sqrt();
            assert!((thermal.px_per_degc[n] - truth).abs() < 4.0 * sigma);
            assert!(sigma < 0.01);
        }
        let off =
            |smoothed: &Smoothed, n: usize| (smoothed.estimates[n].state[0] - truth[n][0]).abs();
        let worst = |smoothed: &Smoothed| (250..350).map(|n| off(smoothed, n)).fold(0.0, f64::max);
        assert!(worst(&with) < 0.05 && worst(&without) > 4.0 * worst(&with));
        for n in 0..COUNT {
            let sigma = f64::from(with.estimates[n].covariance[0]).sqrt();
            assert!(off(&with, n) < 4.5 * sigma, "{n}");
        }
    }

    #[test]
    fn a_temperature_that_does_nothing_is_found_to_do_nothing() {
        let (observations, _) = flight(COUNT, [0.0; THERMAL]);
        let (reference, degrees) = (reference(), temperature_c());
        let with = drift(&reference, &observations, Some(&degrees));
        let still = Drift {
            temperature_c: None,
            ..drift(&reference, &observations, Some(&degrees))
        };
        assert!(with.likelihood().unwrap() < still.likelihood().unwrap());
        let thermal = with.smoothed().unwrap().thermal.unwrap();
        for n in 0..THERMAL {
            let sigma = thermal.covariance[(n, n)].sqrt();
            assert!(thermal.px_per_degc[n].abs() < 4.0 * sigma);
        }
    }
}
