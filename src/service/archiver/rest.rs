//! How long a disk rests that has refused: so long at first, and twice as long after each further refusal.

use std::time::Duration;

pub(super) const SHORTEST_REST: Duration = Duration::from_millis(250);
pub(super) const LONGEST_REST: Duration = Duration::from_secs(5);
/// Of a disk without another that takes its frames meanwhile: they wait in memory, which holds some seconds of them.
pub(super) const LONGEST_REST_ALONE: Duration = Duration::from_millis(500);
