//! Pointing of the telescope as a function of time: [`PointingHistory::at`].
//!
//! `pointing.fits` of a refined flight contains the states of its smoother: the telescope's attitude, its rate and covariance. They are
//! so close that the attitude is interpolated by a cubic: a result depends on the flight alone, not on the rate of any table. Once a
//! second the file also contains the position of the balloon and the Sun as seen from there.
//!
//! The telescope's axes are forward, right and down; a covariance is that of small rotations which move its boresight to the right and
//! up, and rotate the telescope about it, right side low positive.

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

/// Longer steps between states are gaps, s.
const LONGEST_STEP_S: f64 = 1.0;

/// The pointing of a flight.
#[derive(Debug, Clone)]
pub struct PointingHistory {
    /// Times of the states, s since 1970, for searches.
    times_s: Vec<f64>,
    states: Vec<State>,
    seconds: Seconds,
    pub limits: Limits,
}

impl PointingHistory {
    /// From states in the order of time, and the data of each whole second from before the first to after the last; seconds without a
    /// state may be missing.
    pub fn new(states: Vec<State>, seconds: Vec<Second>) -> Self {
        Self {
            times_s: states.iter().map(|state| state.unix_s).collect(),
            states,
            seconds: Seconds::new(seconds),
            limits: Limits::default(),
        }
    }

    /// The first and the last known time, s since 1970.
    pub fn ends_s(&self) -> Option<[f64; 2]> {
        Some([*self.times_s.first()?, *self.times_s.last()?])
    }

    /// Marks a time span, s since 1970, in which cameras contradict the gyros.
    pub fn contradict(&mut self, [first_s, last_s]: [f64; 2]) {
        let from = self.times_s.partition_point(|time_s| *time_s < first_s);
        let to = self.times_s.partition_point(|time_s| *time_s <= last_s);
        for state in &mut self.states[from..to] {
            state.is_contradicted = true;
        }
    }

    /// Position of the telescope in ECEF at the second before a time, s since 1970.
    pub fn position_m(&self, unix_s: f64) -> Option<Vector3<f64>> {
        Some(self.seconds.row(unix_s)?.position_m)
    }

    /// The times of pairs of successive states without a gap.
    fn steps_s(&self) -> impl Iterator<Item = [f64; 2]> {
        let steps = self.times_s.windows(2).map(|step| [step[0], step[1]]);
        steps.filter(|[from, to]| to - from <= LONGEST_STEP_S)
    }

    /// The telescope's pointing at a time, s since 1970.
    pub fn at(&self, unix_s: f64) -> Pointed {
        self.within(&self.limits, unix_s)
    }

    /// The same with other limits.
    pub fn within(&self, limits: &Limits, unix_s: f64) -> Pointed {
        let next = self.times_s.partition_point(|time_s| *time_s <= unix_s);
        // The last state belongs to the step that ends there.
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
            Some(second) => limits.pointed(state::between(before, after, unix_s), &second),
            None => Pointed::unknown(Invalid::Gap),
        }
    }
}

#[cfg(test)]
mod tests;
