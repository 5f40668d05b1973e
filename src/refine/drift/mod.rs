//! How the view drifts: with the camera's temperature, and beside it as a random walk, estimated forwards and backwards in
//! time (Kalman; Rauch, Tung and Striebel).
//!
//! What a degree does is estimated together with the walk: along with the walk's state goes how this answers to each
//! coefficient, and the coefficients follow from what all frames leave unexplained (de Jong, 1991).

mod backwards;
mod sightings;
mod warmth;

pub(super) use sightings::{Sight, Sightings};
pub(super) use warmth::Warmth;

use super::view::{Covariance, Reference, State, UpperTriangle};
use backwards::Backwards;
use warmth::{Answer, Evidence, log_root, warmed};

/// How fast the view wanders, 1 sigma after a second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Wander {
    pub shift_px: f64,
    /// Turn and stretch, px at a unit of the plate from its centre.
    pub turn_px: f64,
}

/// The view's shape wanders so much less than its turn.
const SHAPE_PART: f64 = 0.1;
/// What a jump leaves uncertain, px.
const JUMP_PX: [f64; 2] = [10.0, 3.0];
/// What is known of the view before the first mark: from the reference, by group of states.
const FIRST_SIGMA: [f64; 4] = [50.0, 50.0, 2.0, 0.01];

impl Wander {
    /// Variances after a time.
    fn variance(&self, step_s: f64) -> Covariance {
        let [shift, turn] = [self.shift_px, self.turn_px].map(|v| v.powi(2) * step_s);
        diagonal([shift, turn, turn * SHAPE_PART.powi(2), 0.0])
    }
}

/// A diagonal matrix from the variances of shift, turn, shape and lean.
fn diagonal(variances: [f64; 4]) -> Covariance {
    Covariance::from_diagonal(&State::from_fn(|n, _| variances[n / 2]))
}

/// The view at a moment with its covariance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Estimate {
    pub state: State,
    pub covariance: UpperTriangle,
}

/// A jump lies between a moment and the one before it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Break {
    pub moment: usize,
    /// How unlikely it is that the view merely wandered: chi^2 of four.
    pub chi2: f64,
}

/// What the whole flight says of the view.
pub(super) struct Smoothed {
    pub estimates: Vec<Estimate>,
    /// Where a jump would explain most.
    pub sharpest: Option<Break>,
    pub warmth: Warmth,
}

/// All that estimating the drift takes.
pub(super) struct Drift<'a> {
    pub reference: &'a Reference,
    pub sightings: &'a Sightings,
    pub wander: Wander,
    /// Moments before which the view jumped, in order.
    pub jumps: &'a [usize],
    /// The camera's temperature at each moment, from the flight's middle, degC; none where it is not to count.
    pub warmth_c: Option<&'a [f64]>,
}

/// The view in the middle of the way, all coefficients of the temperature being zero.
#[derive(Debug, Clone, Copy)]
struct Passing {
    state: State,
    covariance: Covariance,
    answer: Answer,
}

/// Moments between two places from which the way forwards is gone again, which costs less memory than to keep it.
const BLOCK: usize = 256;

impl Drift<'_> {
    /// Process noise between a moment and the one before it.
    fn step(&self, moment: usize) -> Covariance {
        let wandered = self.wander.variance(self.sightings.step_s(moment));
        match self.jumps.binary_search(&moment) {
            Ok(_) => wandered + diagonal([JUMP_PX[0].powi(2), JUMP_PX[1].powi(2), 0.0, 0.0]),
            Err(_) => wandered,
        }
    }

    fn degrees(&self, moment: usize) -> f64 {
        self.warmth_c.map_or(0.0, |degrees| degrees[moment])
    }

    /// The view before the first mark.
    fn first(&self) -> Passing {
        Passing {
            state: State::zeros(),
            covariance: diagonal(FIRST_SIGMA.map(|sigma| sigma.powi(2))),
            answer: warmed(self.degrees(0)),
        }
    }

    /// From the moment before to a moment, and what its marks say. `None` where a covariance cannot be inverted.
    fn advance(&self, n: usize, now: &mut Passing, evidence: &mut Evidence) -> Option<()> {
        if n > 0 {
            now.covariance += self.step(n);
            now.answer += warmed(self.degrees(n) - self.degrees(n - 1));
        }
        if !self.sightings.counts(n) {
            return Some(());
        }
        let (information, gradient, chi2) = self.sums(n, &now.state);
        let before = now.covariance.cholesky()?;
        let root = (before.inverse() + information).cholesky()?;
        let moved = root.solve(&gradient);
        evidence.likelihood -= (chi2 - gradient.dot(&moved)) / 2.0;
        evidence.likelihood -= log_root(&root) + log_root(&before);
        now.state += moved;
        now.covariance = root.inverse();
        if self.warmth_c.is_some() {
            let seen = information * now.answer;
            let answered = now.covariance * seen;
            evidence.information += now.answer.transpose() * seen - seen.transpose() * answered;
            evidence.gradient += now.answer.transpose() * gradient - seen.transpose() * moved;
            now.answer -= answered;
        }
        Some(())
    }

    /// All the way forwards.
    fn forwards(&self, mut each: impl FnMut(usize, &Passing)) -> Option<Evidence> {
        let (mut now, mut evidence) = (self.first(), Evidence::none());
        for n in 0..self.sightings.len() {
            self.advance(n, &mut now, &mut evidence)?;
            each(n, &now);
        }
        Some(evidence)
    }

    /// What a moment's marks say: information, gradient and chi^2 at a state.
    fn sums(&self, moment: usize, state: &State) -> (Covariance, State, f64) {
        let (mut information, mut gradient, mut chi2) = (Covariance::zeros(), State::zeros(), 0.0);
        for sight in self
            .sightings
            .at(moment)
            .iter()
            .filter(|sight| sight.weight > 0.0)
        {
            let (seen, slopes) = self.reference.picture(sight.printed);
            let miss = sight.seen - seen - slopes * state;
            let weight = sight.information() * f64::from(sight.weight);
            let weighted = slopes.transpose() * weight;
            information += weighted * slopes;
            gradient += weighted * miss;
            chi2 += miss.dot(&(weight * miss));
        }
        (information, gradient, chi2)
    }

    /// Logarithm of the likelihood but for a constant. `None` where a covariance cannot be inverted.
    pub fn likelihood(&self) -> Option<f64> {
        self.forwards(|_, _| {})?.total()
    }

    /// The estimates from all the flight.
    pub fn smoothed(&self) -> Option<Smoothed> {
        let mut starts = Vec::new();
        let evidence = self.forwards(|n, now| {
            if n % BLOCK == 0 {
                starts.push(*now);
            }
        })?;
        let mut back = Backwards::new(self, evidence.warmth()?);
        for (block, start) in starts.iter().enumerate().rev() {
            let first = block * BLOCK;
            let last = (first + BLOCK).min(self.sightings.len());
            let mut way = vec![*start];
            let mut now = *start;
            for n in first + 1..last {
                self.advance(n, &mut now, &mut Evidence::none())?;
                way.push(now);
            }
            for (n, now) in (first..last).zip(&way).rev() {
                back.take(n, now)?;
            }
        }
        Some(back.arrived())
    }
}

#[cfg(test)]
mod tests {
    use super::warmth::WARMED;
    use super::*;
    use crate::geometry::Distortion;
    use crate::units::PlateMil;
    use nalgebra::{Vector2, Vector4};
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_xoshiro::Xoshiro256PlusPlus;

    const COUNT: usize = 600;
    const MARK_SIGMA_PX: f64 = 0.03;

    fn reference() -> Reference {
        let corner = |p: PlateMil| Vector2::new(640.0 - 0.17 * p.x, 480.0 + 0.17 * p.y);
        Reference::through(&Reference::corners().map(corner), Distortion::NONE).unwrap()
    }

    fn temperature_c() -> Vec<f64> {
        (0..COUNT).map(|n| 5.0 * (n as f64 / 40.0).sin()).collect()
    }

    /// The first moments of a flight whose view goes with the temperature by so many px per degree, beside a slow walk; nobody sees marks for a
    /// sixth of it. And the view in truth.
    fn flight(moments: usize, px_per_degc: [f64; WARMED]) -> (Sightings, Vec<State>) {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(4);
        let mut noise = |sigma: f64| sigma * rng.sample::<f64, _>(StandardNormal);
        let reference = reference();
        let mut walk = State::zeros();
        let seen = |n: usize| !(250..350).contains(&n);
        let mut sights = Vec::new();
        let mut moment = |(n, degrees): (usize, f64)| {
            walk[0] += noise(0.002);
            walk[1] += noise(0.002);
            let state = walk + warmed(degrees) * Vector4::from(px_per_degc);
            let marks = (0..9).filter(|_| seen(n)).map(|k| {
                let at = |k: i32| 300.0 * f64::from(k % 3 - 1);
                let printed = PlateMil::new(at(k), at(k / 3));
                let (view, slopes) = reference.picture(printed);
                let error = Vector2::new(noise(MARK_SIGMA_PX), noise(MARK_SIGMA_PX));
                let information = MARK_SIGMA_PX.powi(-2) as f32;
                Sight {
                    seen: view + slopes * state + error,
                    printed,
                    information: [information, 0.0, information],
                    weight: 1.0,
                }
            });
            let first = sights.len();
            sights.extend(marks);
            ((n as f64 / 4.0, first..sights.len()), state)
        };
        let degrees = temperature_c().into_iter().take(moments).enumerate();
        let (moments, truth): (Vec<_>, Vec<_>) = degrees.map(&mut moment).unzip();
        (Sightings::new(sights, moments.into_iter()), truth)
    }

    fn drift<'a>(
        reference: &'a Reference,
        sightings: &'a Sightings,
        warmth_c: Option<&'a [f64]>,
    ) -> Drift<'a> {
        // Without the temperature the walk must follow it.
        let shift_px = if warmth_c.is_some() { 0.004 } else { 0.1 };
        Drift {
            reference,
            sightings,
            wander: Wander {
                shift_px,
                turn_px: 0.001,
            },
            jumps: &[],
            warmth_c,
        }
    }

    #[test]
    fn what_a_degree_does_is_told_and_bridges_the_time_without_marks() {
        let truth_per_degc = [0.13, -0.08, 0.004, -0.01];
        let (sightings, truth) = flight(COUNT, truth_per_degc);
        let (reference, degrees) = (reference(), temperature_c());
        let with = drift(&reference, &sightings, Some(&degrees));
        let without = drift(&reference, &sightings, None);
        assert!(with.likelihood().unwrap() > without.likelihood().unwrap() + 100.0);
        let (with, without) = (with.smoothed().unwrap(), without.smoothed().unwrap());
        for (n, truth) in truth_per_degc.iter().enumerate() {
            let sigma = with.warmth.covariance[(n, n)].sqrt();
            assert!((with.warmth.px_per_degc[n] - truth).abs() < 4.0 * sigma);
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
    fn a_temperature_that_does_nothing_is_told_to_do_nothing() {
        let (sightings, _) = flight(COUNT, [0.0; WARMED]);
        let (reference, degrees) = (reference(), temperature_c());
        let with = drift(&reference, &sightings, Some(&degrees));
        let still = Drift {
            warmth_c: None,
            ..drift(&reference, &sightings, Some(&degrees))
        };
        assert!(with.likelihood().unwrap() < still.likelihood().unwrap());
        let warmth = with.smoothed().unwrap().warmth;
        for n in 0..WARMED {
            let sigma = warmth.covariance[(n, n)].sqrt();
            assert!(warmth.px_per_degc[n].abs() < 4.0 * sigma);
        }
    }

    #[test]
    fn the_way_back_is_the_same_in_one_block_and_in_several() {
        let (reference, degrees) = (reference(), temperature_c());
        let smoothed = |count: usize| {
            let (sightings, _) = flight(count, [0.1; WARMED]);
            let drift = drift(&reference, &sightings, Some(&degrees));
            drift.smoothed().unwrap()
        };
        assert_eq!(smoothed(COUNT).estimates.len(), COUNT);
        let [some, one] = [BLOCK + 1, BLOCK].map(smoothed);
        let step = some.estimates[BLOCK - 1].state - one.estimates[BLOCK - 1].state;
        assert!(step.norm() < 0.02);
        assert_eq!(
            (some.estimates.len(), one.estimates.len()),
            (BLOCK + 1, BLOCK)
        );
    }
}
