//! Back-off between repeated attempts.

use std::time::Duration;

/// Waits between attempts, each twice as long as the one before, up to a limit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Backoff {
    shortest: Duration,
    longest: Duration,
    next: Duration,
}

impl Backoff {
    /// For cheap attempts at devices that should be found within seconds after they return: a port, a camera, a thread.
    pub const DEVICE: Self = Self::new(Duration::from_millis(250), Duration::from_secs(2));
    /// For a disk.
    pub const DISK: Self = Self::new(Duration::from_millis(250), Duration::from_secs(5));

    /// For a server with other users.
    #[cfg(feature = "object-store")]
    pub const NETWORK: Self = Self::new(Duration::from_secs(1), Duration::from_secs(30));

    const fn new(shortest: Duration, longest: Duration) -> Self {
        Self {
            shortest,
            longest,
            next: shortest,
        }
    }

    /// The wait after another failure.
    pub fn wait(&mut self) -> Duration {
        self.wait_at_most(self.longest)
    }

    /// The same with another limit, from which later waits continue.
    pub fn wait_at_most(&mut self, longest: Duration) -> Duration {
        let wait = self.next.min(longest);
        self.next = self.longest.min(2 * wait);
        wait
    }

    /// Resets the wait after a successful attempt.
    pub fn reset(&mut self) {
        self.next = self.shortest;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_up_to_a_limit_and_begin_anew_after_a_success() {
        let ms = Duration::from_millis;
        let mut backoff = Backoff::new(ms(250), ms(2000));
        assert_eq!(
            [(); 5].map(|()| backoff.wait()),
            [250, 500, 1000, 2000, 2000].map(ms)
        );
        assert_eq!(
            [(); 2].map(|()| backoff.wait_at_most(ms(300))),
            [300, 300].map(ms)
        );
        assert_eq!(backoff.wait(), ms(600), "on from the limit");
        backoff.reset();
        assert_eq!(backoff.wait(), ms(250));
    }
}
