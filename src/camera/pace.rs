//! A steady rate of frames.

use std::time::{Duration, Instant};

/// Lets frame n begin n periods after the first.
#[derive(Debug)]
pub(super) struct Pace {
    period: Duration,
    start: Option<Instant>,
    number: u32,
}

impl Pace {
    pub(super) fn new(rate_hz: f64) -> Self {
        let period = Duration::try_from_secs_f64(1.0 / rate_hz).unwrap_or(Duration::ZERO);
        Self {
            period,
            start: None,
            number: 0,
        }
    }

    /// Time from the first frame to the one that is due next.
    pub(super) fn next_due(&self) -> Duration {
        self.period.saturating_mul(self.number)
    }

    /// Waits until the next frame is due; a late one begins at once.
    pub(super) fn wait(&mut self) {
        let due = self.next_due();
        let start = *self.start.get_or_insert_with(Instant::now);
        std::thread::sleep(due.saturating_sub(start.elapsed()));
        self.number = self.number.saturating_add(1);
    }
}
