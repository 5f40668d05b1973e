//! Work that is given its time and no more.

use super::Finding;
use crossbeam_channel::{RecvTimeoutError, bounded};
use std::thread;
use std::time::Duration;

/// Why work gave nothing.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum NoAnswer {
    #[error("no answer within {:.0} s", .0.as_secs_f64())]
    Late(Duration),
    #[error("the check itself failed: this is a fault of the program")]
    Panicked,
    #[error("no thread to look with: {0}")]
    Thread(String),
}

/// What `work` gives within `limit`. Work that takes longer is left behind on its thread.
pub(super) fn within<T: Send + 'static>(
    limit: Duration,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, NoAnswer> {
    let (give, take) = bounded(1);
    let on_thread = move || {
        // Nobody listens any more where this came too late.
        let _ = give.send(work());
    };
    thread::Builder::new()
        .name("preflight".into())
        .spawn(on_thread)
        .map_err(|error| NoAnswer::Thread(error.to_string()))?;
    take.recv_timeout(limit).map_err(|error| match error {
        RecvTimeoutError::Timeout => NoAnswer::Late(limit),
        RecvTimeoutError::Disconnected => NoAnswer::Panicked,
    })
}

/// The findings of `work`, or that it gave none, under the name of `check`.
pub(super) fn findings_within(
    limit: Duration,
    check: &str,
    remedy: &str,
    work: impl FnOnce() -> Vec<Finding> + Send + 'static,
) -> Vec<Finding> {
    within(limit, work)
        .unwrap_or_else(|no_answer| vec![Finding::fail(check, no_answer.to_string(), remedy)])
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
