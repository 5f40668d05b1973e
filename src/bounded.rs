//! Work with a time limit.

use crossbeam_channel::{RecvTimeoutError, bounded};
use std::thread;
use std::time::Duration;

/// Why work gave no result.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NoAnswer {
    #[error("no answer within {:.0} s", .0.as_secs_f64())]
    Late(Duration),
    #[error("it failed by itself: this is a fault of the program")]
    Panicked,
    #[error("no thread for the check: {0}")]
    Thread(String),
}

/// Result of `work` within `limit`. Work that takes longer is abandoned on its thread.
pub fn within<T: Send + 'static>(
    limit: Duration,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, NoAnswer> {
    let (give, take) = bounded(1);
    let on_thread = move || {
        // After the time limit the receiver is gone.
        let _ = give.send(work());
    };
    thread::Builder::new()
        .name("bounded".into())
        .spawn(on_thread)
        .map_err(|error| NoAnswer::Thread(error.to_string()))?;
    take.recv_timeout(limit).map_err(|error| match error {
        RecvTimeoutError::Timeout => NoAnswer::Late(limit),
        RecvTimeoutError::Disconnected => NoAnswer::Panicked,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_that_hangs_or_panics_is_an_answer_too() {
        let limit = Duration::from_millis(20);
        assert_eq!(within(Duration::from_secs(60), || 7), Ok(7));
        let (_open, never) = bounded::<()>(0);
        let hung = within(limit, move || never.recv().is_ok());
        assert_eq!(hung, Err(NoAnswer::Late(limit)));
        let panics = within(Duration::from_secs(60), || -> u8 { panic!("on purpose") });
        assert_eq!(panics, Err(NoAnswer::Panicked));
    }
}
