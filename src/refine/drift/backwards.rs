//! The way back through a flight, from the last moment to the first (Rauch, Tung and Striebel).

use super::warmth::{Warmth, warmed};
use super::{Break, Drift, Estimate, Passing, Smoothed};
use crate::refine::view::{Covariance, State, packed};

/// On the way back.
pub struct Backwards<'a> {
    drift: &'a Drift<'a>,
    warmth: Warmth,
    /// From the last moment on.
    estimates: Vec<Estimate>,
    sharpest: Option<Break>,
    next: Option<Passing>,
}

impl<'a> Backwards<'a> {
    /// At the last moment, with the temperature's coefficients as all the way forwards tells them.
    pub fn new(drift: &'a Drift<'a>, warmth: Warmth) -> Self {
        Self {
            drift,
            warmth,
            estimates: Vec::with_capacity(drift.sightings.len()),
            sharpest: None,
            next: None,
        }
    }

    /// Adds to what a moment knew on the way forwards what all later ones say.
    pub fn take(&mut self, n: usize, passing: &Passing) -> Option<()> {
        let mut now = *passing;
        if let Some(next) = self.next {
            let predicted = now.covariance + self.drift.step(n + 1);
            let back = predicted.cholesky()?.inverse();
            let gain = now.covariance * back;
            let surprise = next.state - now.state;
            let degrees = self.drift.degrees(n + 1) - self.drift.degrees(n);
            let answer = next.answer - now.answer - warmed(degrees);
            let learnt = next.covariance - predicted;
            let beside = surprise + answer * self.warmth.px_per_degc;
            self.look_for_break(n + 1, &back, &beside, &learnt);
            let covariance = now.covariance + gain * learnt * gain.transpose();
            now = Passing {
                state: now.state + gain * surprise,
                covariance: (covariance + covariance.transpose()) / 2.0,
                answer: now.answer + gain * answer,
            };
        }
        let by_warmth = now.answer * self.warmth.covariance * now.answer.transpose();
        self.estimates.push(Estimate {
            state: now.state + now.answer * self.warmth.px_per_degc,
            covariance: packed(&(now.covariance + by_warmth)),
        });
        self.next = Some(now);
        Some(())
    }

    /// What was found, back at the first moment.
    pub fn arrived(mut self) -> Smoothed {
        self.estimates.reverse();
        Smoothed {
            estimates: self.estimates,
            sharpest: self.sharpest,
            warmth: self.warmth,
        }
    }

    fn look_for_break(
        &mut self,
        moment: usize,
        back: &Covariance,
        surprise: &State,
        learnt: &Covariance,
    ) {
        let known = self.drift.jumps.binary_search(&moment).is_ok();
        let found = break_chi2(back, surprise, learnt).filter(|_| !known);
        let found = found.map(|chi2| Break { moment, chi2 });
        let least = self.sharpest.map_or(0.0, |sharpest| sharpest.chi2);
        self.sharpest = found.filter(|found| found.chi2 > least).or(self.sharpest);
    }
}

/// How far the disturbance of a step, as all data show it, is beyond what the random walk expects: the auxiliary residual
/// of Harvey and Koopman (1992), of shift and turn.
fn break_chi2(back: &Covariance, surprise: &State, learnt: &Covariance) -> Option<f64> {
    let pull = (back * surprise).fixed_rows::<4>(0).into_owned();
    let spread = -(back * learnt * back);
    let spread = spread.fixed_view::<4, 4>(0, 0).into_owned();
    let chi2 = pull.dot(&spread.cholesky()?.solve(&pull));
    chi2.is_finite().then_some(chi2)
}
