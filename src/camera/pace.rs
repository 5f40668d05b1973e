//! Times at which frames are due.

use std::time::{Duration, Instant};

/// Longest wait of a source before it reports that there is no frame yet.
pub(super) const TIMEOUT: Duration = Duration::from_millis(250);

/// The time at which the next frame is due, counted from the first.
#[derive(Debug, Default)]
pub(super) struct Pace {
    start: Option<Instant>,
    due: Duration,
}

impl Pace {
    /// Time from the first frame to the next one due.
    pub(super) fn due(&self) -> Duration {
        self.due
    }

    /// Whether the first frame has been requested.
    pub(super) fn has_started(&self) -> bool {
        self.start.is_some()
    }

    /// Begins to count time, unless it has begun already.
    pub(super) fn start(&mut self) -> Instant {
        *self.start.get_or_insert_with(Instant::now)
    }

    /// Waits until the next frame is due, at most for [`TIMEOUT`]; returns whether it is. A late frame is due at once.
    pub(super) fn is_due(&mut self) -> bool {
        let start = self.start();
        let wait = self.due.saturating_sub(start.elapsed());
        std::thread::sleep(wait.min(TIMEOUT));
        wait <= TIMEOUT
    }

    /// Makes the next frame due this much later than the present one.
    pub(super) fn advance(&mut self, by: Duration) {
        self.due = self.due.saturating_add(by);
    }

    /// As [`advance`](Self::advance), but skips the frames for which the present frame leaves no time: a camera does not
    /// catch up.
    #[cfg(feature = "gige")]
    pub(super) fn advance_past_now(&mut self, by: Duration) {
        let elapsed = self.start.map_or(Duration::ZERO, |start| start.elapsed());
        self.due = self.due.saturating_add(by).max(elapsed);
    }
}
