//! From a camera's frame ids to numbers that only grow.

/// The largest id of 16 bits; after it comes 1, as 0 is none.
const LAST_SHORT_ID: u64 = 65_535;

/// How a camera counts its frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Ids {
    /// With 16 bits, as GigE Vision does; or with more: then it goes beyond them.
    Short,
    /// With 64 bits, as USB3 Vision does.
    Long,
}

/// Counts frames by the camera's ids, so that a frame that is missing leaves a gap.
#[derive(Debug)]
pub(super) struct Numbers {
    next: u64,
    last_id: Option<u64>,
}

impl Numbers {
    /// `first` for the first frame, whatever its id.
    pub(super) fn from(first: u64) -> Self {
        Self {
            next: first,
            last_id: None,
        }
    }

    /// The number of the frame with this id.
    pub(super) fn number(&mut self, id: u64, ids: Ids) -> u64 {
        let skipped = match self.last_id.replace(id) {
            Some(last) if id > last => id - last - 1,
            Some(last) if id < last && last <= LAST_SHORT_ID && ids == Ids::Short => {
                (id + LAST_SHORT_ID).saturating_sub(last + 1)
            }
            // The camera restarts its count.
            _ => 0,
        };
        let number = self.next + skipped;
        self.next = number + 1;
        number
    }

    /// The acquisition restarts, and perhaps the ids do, too.
    pub(super) fn restart(&mut self) {
        self.last_id = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers<const N: usize>(first: u64, ids: Ids, seen: [u64; N]) -> [u64; N] {
        let mut numbers = Numbers::from(first);
        seen.map(|id| numbers.number(id, ids))
    }

    #[test]
    fn numbers_go_on_where_ids_of_16_bits_wrap_past_zero() {
        let seen = numbers(7, Ids::Short, [65_534, 65_535, 1, 2, 4, 65_535, 2]);
        assert_eq!(seen, [7, 8, 9, 10, 12, 65_543, 65_545]);
        // One that does not skip 0.
        assert_eq!(numbers(0, Ids::Short, [65_535, 0, 1]), [0, 1, 2]);
    }

    #[test]
    fn long_ids_do_not_wrap() {
        for ids in [Ids::Short, Ids::Long] {
            assert_eq!(numbers(0, ids, [65_535, 65_536, 65_540]), [0, 1, 5]);
        }
        // A USB3 camera that restarted has lost nothing that is known.
        assert_eq!(numbers(0, Ids::Long, [500, 501, 0, 1]), [0, 1, 2, 3]);
    }

    #[test]
    fn numbers_go_on_where_ids_start_anew() {
        let mut numbers = Numbers::from(0);
        assert_eq!(numbers.number(900, Ids::Short), 0);
        numbers.restart();
        assert_eq!(numbers.number(1, Ids::Short), 1);
    }
}
