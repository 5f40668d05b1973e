//! How long a disk rests that has refused: so long at first, and twice as long after each further refusal.

use std::time::Duration;

pub(super) const SHORTEST_REST: Duration = Duration::from_millis(250);
pub(super) const LONGEST_REST: Duration = Duration::from_secs(5);
