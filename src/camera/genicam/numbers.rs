//! Converts a camera's frame ids to numbers that only grow.

/// The largest id of 16 bits; the next one is 1, as 0 is not used.
const LAST_SHORT_ID: u64 = 65_535;

/// Form of a camera's frame ids.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Ids {
    /// 16 bits, as in GigE Vision; or more, if an id exceeds 16 bits.
    Short,
    /// 64 bits, as in USB3 Vision.
    Long,
}

/// Numbers frames by the camera's ids, so that a missing frame leaves a gap.
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

    /// Notes that the acquisition restarts; the ids may restart, too.
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
        // A camera that does not skip 0.
        assert_eq!(numbers(0, Ids::Short, [65_535, 0, 1]), [0, 1, 2]);
    }

    #[test]
    fn long_ids_do_not_wrap() {
        for ids in [Ids::Short, Ids::Long] {
            assert_eq!(numbers(0, ids, [65_535, 65_536, 65_540]), [0, 1, 5]);
        }
        // For a USB3 camera that restarted, no loss is known.
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
