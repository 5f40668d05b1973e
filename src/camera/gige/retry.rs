//! When to try again.

use std::time::{Duration, Instant};

const FIRST: Duration = Duration::from_millis(250);
/// An attempt costs nothing, and a camera that is back should be seen within seconds: each attempt takes 2.5 s itself.
const LONGEST: Duration = Duration::from_secs(2);

/// Pauses between attempts, each twice as long as the one before, up to a limit.
#[derive(Debug, Default)]
pub(super) struct Retry {
    pause: Option<Duration>,
    next: Option<Instant>,
}

impl Retry {
    /// An attempt has failed.
    pub(super) fn failed(&mut self, now: Instant) {
        let pause = self.pause.map_or(FIRST, |pause| (2 * pause).min(LONGEST));
        self.pause = Some(pause);
        self.next = Some(now + pause);
    }

    /// How long to wait for the next attempt; `None` where it is due.
    pub(super) fn wait(&self, now: Instant) -> Option<Duration> {
        self.next?
            .checked_duration_since(now)
            .filter(|d| !d.is_zero())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_double_up_to_a_limit() {
        let now = Instant::now();
        let mut retry = Retry::default();
        assert_eq!(retry.wait(now), None, "the first attempt is due at once");
        for pause_ms in [250, 500, 1000, 2000, 2000] {
            retry.failed(now);
            let pause = Duration::from_millis(pause_ms);
            assert_eq!(retry.wait(now), Some(pause));
            assert_eq!(retry.wait(now + pause), None);
        }
    }
}
