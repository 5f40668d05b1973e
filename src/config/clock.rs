//! What time it is in a flight.

use super::Config;
use crate::camera::Source;
use jiff::{SignedDuration, Timestamp};

/// The computer's clock, but for a simulated flight: that may begin on any day.
#[derive(Debug, Clone, Copy, Default)]
pub struct FlightClock {
    ahead: SignedDuration,
}

impl FlightClock {
    /// The clock of a flight that begins now, and is simulated to begin at `start`.
    pub fn starting(start: Timestamp) -> Self {
        Self {
            ahead: start.duration_since(Timestamp::now()),
        }
    }

    pub fn now(self) -> Timestamp {
        let now = Timestamp::now();
        now.checked_add(self.ahead).unwrap_or(now)
    }
}

impl Config {
    /// The clock of a flight that begins now.
    pub fn clock(&self) -> FlightClock {
        let is_simulated = matches!(self.cameras.first().source, Some(Source::Simulated(_)));
        let start = self.simulation.start_utc.filter(|_| is_simulated);
        start.map_or_else(FlightClock::default, FlightClock::starting)
    }
}
