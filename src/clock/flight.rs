use jiff::{SignedDuration, Timestamp};

/// Time of a flight: the computer's, except for a simulated flight, which may begin on any day.
#[derive(Debug, Clone, Copy, Default)]
pub struct FlightClock {
    start: Option<Timestamp>,
    ahead: SignedDuration,
}

impl FlightClock {
    /// The clock of a flight that begins now, and is simulated to begin at `start`.
    pub fn starting(start: Timestamp) -> Self {
        Self {
            start: Some(start),
            ahead: start.duration_since(Timestamp::now()),
        }
    }

    /// Start of the simulated flight, if it is stated.
    pub fn start(self) -> Option<Timestamp> {
        self.start
    }

    pub fn now(self) -> Timestamp {
        let now = Timestamp::now();
        now.checked_add(self.ahead).unwrap_or(now)
    }
}
