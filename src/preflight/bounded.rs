//! Checks with a time limit.

pub(super) use crate::bounded::within;

use super::Finding;
use std::time::Duration;

/// The findings of `work`, or, after the limit, a failure of `check`.
pub(super) fn findings_within(
    limit: Duration,
    check: &str,
    remedy: &str,
    work: impl FnOnce() -> Vec<Finding> + Send + 'static,
) -> Vec<Finding> {
    within(limit, work)
        .unwrap_or_else(|no_answer| vec![Finding::fail(check, no_answer.to_string(), remedy)])
}
