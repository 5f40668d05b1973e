//! What the filter tells the line.

use crate::link::Propagated;
use std::time::Instant;

/// What an offset by the gyros tells the line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::service) struct PropagatedEvent {
    pub propagated: Propagated,
    /// When the sample was read that it rests on.
    pub read: Instant,
}
