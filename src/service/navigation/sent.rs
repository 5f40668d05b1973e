//! Selection of the offsets by the gyros that are sent, and their form.

use crate::config;
use crate::link::{Propagated, Solution};
use crate::navigation::PropagatedOffset;
use jiff::Timestamp;

impl config::Navigation {
    /// Whether an offset is sent: it is asked for, and its uncertainty is small enough.
    pub(super) fn sends(&self, offset: &PropagatedOffset) -> bool {
        self.send == config::Switch::On && offset.sigma_deg <= self.max_sigma_deg()
    }
}

/// An offset in the form for the controller, `age_s` after the last direction.
pub(super) fn propagated(offset: &PropagatedOffset, utc: Timestamp, age_s: f64) -> Propagated {
    Propagated {
        solution: Solution {
            azimuth_deg: offset.difference.azimuth_deg,
            elevation_deg: offset.difference.elevation_deg,
            roll_deg: offset.roll_deg.value,
            error_deg: offset.sigma_deg,
            time: utc,
        },
        age_ms: (1e3 * age_s).round().clamp(0.0, u16::MAX.into()) as u16,
    }
}
