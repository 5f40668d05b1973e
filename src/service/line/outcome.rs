//! Messages on an exposure.

use crate::link::Solution;
use crate::link::message::NO_OFFSET;
use crate::pointing::Roll;
use crate::service::messages::Outcome;
use std::time::Duration;

impl Outcome {
    /// Time since mid-exposure.
    pub fn age(&self) -> Duration {
        self.arrived.elapsed() + self.exposure_time.unwrap_or_default() / 2
    }

    pub fn solution(&self) -> Option<Solution> {
        let offset = self.offset?;
        // The packet has no other code for a roll that is not known, or on which the offset does not rest.
        let roll_deg = match (offset.roll, self.roll) {
            (Roll::Measured(_), Some(roll)) => roll.deg.value,
            _ => 0.0,
        };
        let numbers = [
            offset.azimuth_deg,
            offset.elevation_deg,
            roll_deg,
            offset.sigma_deg,
        ];
        numbers.iter().all(|n| n.is_finite()).then_some(Solution {
            azimuth_deg: offset.azimuth_deg,
            elevation_deg: offset.elevation_deg,
            roll_deg,
            error_deg: offset.sigma_deg,
            time: self.exposure.start,
        })
    }

    /// Code of the message to the controller without a solution.
    pub fn error_code(&self) -> u16 {
        self.stopped
            .map_or(NO_OFFSET, |stopped| stopped.stage as u16 + 1)
    }
}
