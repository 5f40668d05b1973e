//! How the view drifts: a random walk, estimated forwards and backwards in time (Kalman; Rauch, Tung and Striebel).

use super::view::{Covariance, Reference, STATES, State};
use crate::units::PlateMil;
use nalgebra::{Matrix2, Vector2};

/// A mark as the flight's mapping takes it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sight {
    /// On the ideal sensor.
    pub seen: Vector2<f64>,
    pub printed: PlateMil,
    /// Inverse covariance, px^-2.
    pub information: Matrix2<f64>,
    /// What it counts, 0 to 1.
    pub weight: f64,
}

/// A moment of the flight, and the marks that were read then.
#[derive(Debug, Clone)]
pub(super) struct Moment {
    /// Since the first moment.
    pub time_s: f64,
    pub sights: Vec<Sight>,
}

impl Moment {
    pub fn has_marks(&self) -> bool {
        self.sights.iter().any(|sight| sight.weight > 0.0)
    }
}

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
    pub covariance: Covariance,
}

/// A jump lies between a moment and the one before it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Break {
    pub moment: usize,
    /// How unlikely it is that the view merely wandered: chi^2 of four.
    pub chi2: f64,
}

/// All that estimating the drift takes.
pub(super) struct Drift<'a> {
    pub reference: &'a Reference,
    pub moments: &'a [Moment],
    pub wander: Wander,
    /// Moments before which the view jumped, in order.
    pub jumps: &'a [usize],
}

impl Drift<'_> {
    /// Process noise between a moment and the one before it.
    fn step(&self, moment: usize) -> Covariance {
        let before = moment.saturating_sub(1);
        let step_s = self.moments[moment].time_s - self.moments[before].time_s;
        let wandered = self.wander.variance(step_s.max(0.0));
        match self.jumps.binary_search(&moment) {
            Ok(_) => wandered + diagonal([JUMP_PX[0].powi(2), JUMP_PX[1].powi(2), 0.0, 0.0]),
            Err(_) => wandered,
        }
    }

    /// The estimates forwards, and the logarithm of the likelihood but for a constant. `None` where a covariance cannot be
    /// inverted.
    fn forwards(&self, mut each: impl FnMut(Estimate)) -> Option<f64> {
        let mut now = Estimate {
            state: State::zeros(),
            covariance: diagonal(FIRST_SIGMA.map(|sigma| sigma.powi(2))),
        };
        let mut likelihood = 0.0;
        for (n, moment) in self.moments.iter().enumerate() {
            if n > 0 {
                now.covariance += self.step(n);
            }
            if moment.has_marks() {
                let (information, gradient, chi2) = self.sums(moment, &now.state);
                let before = now.covariance.cholesky()?;
                let root = (before.inverse() + information).cholesky()?;
                let moved = root.solve(&gradient);
                likelihood -= (chi2 - gradient.dot(&moved)) / 2.0;
                likelihood -= log_root(&root) + log_root(&before);
                now.state += moved;
                now.covariance = root.inverse();
            }
            each(now);
        }
        likelihood.is_finite().then_some(likelihood)
    }

    /// What a moment's marks say: information, gradient and chi^2 at a state.
    fn sums(&self, moment: &Moment, state: &State) -> (Covariance, State, f64) {
        let (mut information, mut gradient, mut chi2) = (Covariance::zeros(), State::zeros(), 0.0);
        for sight in moment.sights.iter().filter(|sight| sight.weight > 0.0) {
            let (seen, slopes) = self.reference.picture(sight.printed);
            let miss = sight.seen - seen - slopes * state;
            let weight = sight.information * sight.weight;
            let weighted = slopes.transpose() * weight;
            information += weighted * slopes;
            gradient += weighted * miss;
            chi2 += miss.dot(&(weight * miss));
        }
        (information, gradient, chi2)
    }

    pub fn likelihood(&self) -> Option<f64> {
        self.forwards(|_| {})
    }

    /// The estimates from all the flight, and the place where a jump would explain most.
    pub fn smoothed(&self) -> Option<(Vec<Estimate>, Option<Break>)> {
        let mut estimates = Vec::with_capacity(self.moments.len());
        self.forwards(|estimate| estimates.push(estimate))?;
        let mut sharpest: Option<Break> = None;
        for n in (0..estimates.len().saturating_sub(1)).rev() {
            let (now, next) = (estimates[n], estimates[n + 1]);
            let predicted = now.covariance + self.step(n + 1);
            let back = predicted.cholesky()?.inverse();
            let gain = now.covariance * back;
            let surprise = next.state - now.state;
            let learnt = next.covariance - predicted;
            if self.jumps.binary_search(&(n + 1)).is_err()
                && let Some(chi2) = break_chi2(&back, &surprise, &learnt)
                && sharpest.is_none_or(|sharpest| chi2 > sharpest.chi2)
            {
                let moment = n + 1;
                sharpest = Some(Break { moment, chi2 });
            }
            let covariance = now.covariance + gain * learnt * gain.transpose();
            estimates[n] = Estimate {
                state: now.state + gain * surprise,
                covariance: (covariance + covariance.transpose()) / 2.0,
            };
        }
        Some((estimates, sharpest))
    }
}

fn log_root(root: &nalgebra::Cholesky<f64, nalgebra::Const<STATES>>) -> f64 {
    let l = root.l_dirty();
    (0..STATES).map(|n| l[(n, n)].ln()).sum()
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
