//! From a camera's frame ids to numbers that only grow.

/// The largest id of a camera whose ids have 16 bits; after it comes 1, as 0 is none.
const LAST_SHORT_ID: u64 = 65_535;

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
    pub(super) fn number(&mut self, id: u64) -> u64 {
        let skipped = match self.last_id.replace(id) {
            Some(last) if id > last => id - last - 1,
            Some(last) if id < last && last <= LAST_SHORT_ID => id + LAST_SHORT_ID - last - 1,
            _ => 0,
        };
        let number = self.next + skipped;
        self.next = number + 1;
        number
    }

    /// The acquisition starts anew, and perhaps the ids do, too.
    pub(super) fn restart(&mut self) {
        self.last_id = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_go_on_where_ids_of_16_bits_wrap_past_zero() {
        let mut numbers = Numbers::from(7);
        let ids = [65_534, 65_535, 1, 2, 4, 65_535, 2];
        let seen = ids.map(|id| numbers.number(id));
        assert_eq!(seen, [7, 8, 9, 10, 12, 65_543, 65_545]);
    }

    #[test]
    fn long_ids_do_not_wrap() {
        let mut numbers = Numbers::from(0);
        assert_eq!(
            [65_535, 65_536, 65_540].map(|id| numbers.number(id)),
            [0, 1, 5]
        );
    }

    #[test]
    fn numbers_go_on_where_ids_start_anew() {
        let mut numbers = Numbers::from(0);
        assert_eq!(numbers.number(900), 0);
        numbers.restart();
        assert_eq!(numbers.number(1), 1);
    }
}
