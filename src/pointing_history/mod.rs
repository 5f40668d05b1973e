//! Where the telescope pointed, as a function of time: [`PointingHistory::at`].
//!
//! A refined flight leaves the states of its smoother in `pointing.fits`: at each the telescope's attitude, its rate and covariance. They stand
//! so close that between two of them the attitude is a cubic: an answer depends on the flight alone, not on the rate of any table. Beside
//! them, once a second, stand the place of the balloon and the Sun as seen from there.
//!
//! The telescope's axes are forward, right and down; a covariance is that of small turns which move its boresight to the right and up, and
//! turn it about that, right side low positive.

mod evaluate;
mod intervals;
mod seconds;
mod state;
mod store;
mod table;

pub use evaluate::{Invalid, Limits, LineOfSight, Pointed};
pub use seconds::Second;
pub use state::{Basis, State};
pub use store::{POINTING_FILE, StoreError};
pub use table::{LONGEST_WORD, POINTING, POINTING_COLUMNS, PointingRow, pointing_cards};

use nalgebra::Vector3;
use seconds::Seconds;

/// Longer steps from state to state are gaps, s.
const LONGEST_STEP_S: f64 = 1.0;

/// The pointing of a flight.
#[derive(Debug, Clone)]
pub struct PointingHistory {
    /// Of the states, s since 1970: what is searched.
    times_s: Vec<f64>,
    states: Vec<State>,
    seconds: Seconds,
    pub limits: Limits,
}

impl PointingHistory {
    /// By states in the order of time, and what is known of each whole second from before the first to behind the last; those without a state
    /// need not be there.
    pub fn new(states: Vec<State>, seconds: Vec<Second>) -> Self {
        Self {
            times_s: states.iter().map(|state| state.unix_s).collect(),
            states,
            seconds: Seconds::new(seconds),
            limits: Limits::default(),
        }
    }

    /// The first and the last time that is known, s since 1970.
    pub fn ends_s(&self) -> Option<[f64; 2]> {
        Some([*self.times_s.first()?, *self.times_s.last()?])
    }

    /// Notes that from a time to another, s since 1970, what cameras show contradicts the gyros.
    pub fn contradict(&mut self, [first_s, last_s]: [f64; 2]) {
        let from = self.times_s.partition_point(|time_s| *time_s < first_s);
        let to = self.times_s.partition_point(|time_s| *time_s <= last_s);
        for state in &mut self.states[from..to] {
            state.is_contradicted = true;
        }
    }

    /// Where the telescope was in the second before a time, s since 1970: in ECEF.
    pub fn position_m(&self, unix_s: f64) -> Option<Vector3<f64>> {
        Some(self.seconds.row(unix_s)?.position_m)
    }

    /// The times of two states that follow each other without a gap.
    fn steps_s(&self) -> impl Iterator<Item = [f64; 2]> {
        let steps = self.times_s.windows(2).map(|step| [step[0], step[1]]);
        steps.filter(|[from, to]| to - from <= LONGEST_STEP_S)
    }

    /// Where the telescope pointed at a time, s since 1970.
    pub fn at(&self, unix_s: f64) -> Pointed {
        self.within(&self.limits, unix_s)
    }

    /// The same with other limits.
    pub fn within(&self, limits: &Limits, unix_s: f64) -> Pointed {
        let next = self.times_s.partition_point(|time_s| *time_s <= unix_s);
        // The last state is the end of its step.
        let next = match self.times_s.last() {
            Some(last) if *last == unix_s => self.states.len() - 1,
            _ => next,
        };
        let around = next
            .checked_sub(1)
            .and_then(|before| Some([self.states.get(before)?, self.states.get(next)?]));
        let Some([before, after]) = around else {
            return Pointed::unknown(Invalid::Extrapolated);
        };
        if after.unix_s - before.unix_s > LONGEST_STEP_S {
            return Pointed::unknown(Invalid::Gap);
        }
        match self.seconds.at(unix_s) {
            Some(second) => limits.judged(state::between(before, after, unix_s), &second),
            None => Pointed::unknown(Invalid::Gap),
        }
    }
}

#[cfg(test)]
mod tests;
