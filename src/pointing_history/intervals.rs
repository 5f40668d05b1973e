//! Intervals of valid pointing.

use super::PointingHistory;

/// Greatest time between checks of the pointing, s.
const PIECE_S: f64 = 0.1;
/// Accuracy of an interval's ends, s.
const EXACT_S: f64 = 1e-3;

impl PointingHistory {
    /// The intervals in which the pointing is valid, each with its first and last valid time, s since 1970, in the order of time. Their
    /// ends are accurate to 1 ms and inside; an interval shorter than 0.1 s may be missing.
    ///
    /// Between two states rate and covariance are linear in time, and the limits apply to convex functions of them: if both ends of a
    /// piece are valid, all of it is.
    pub fn valid_intervals(&self) -> Vec<[f64; 2]> {
        let mut intervals: Vec<[f64; 2]> = Vec::new();
        for [from, to] in self.pieces_s() {
            // A valid piece ends before the next one begins; the piece with the last state of all includes its end.
            let is_end = self.times_s.last() == Some(&to);
            let last = if is_end { to } else { to.next_down() };
            let part = match [from, last].map(|time_s| self.at(time_s).is_valid()) {
                [true, true] => [from, last],
                [true, false] => [from, self.edge_s(from, last)],
                [false, true] => [self.edge_s(last, from), last],
                [false, false] => continue,
            };
            match intervals.last_mut() {
                Some(before) if before[1].next_up() == part[0] => before[1] = part[1],
                // Drop an interval of zero length.
                _ if part[0] < part[1] => intervals.push(part),
                _ => {}
            }
        }
        intervals
    }

    /// Pieces of the steps between states; none extends over a whole second, because another row of the seconds begins there.
    fn pieces_s(&self) -> impl Iterator<Item = [f64; 2]> {
        self.steps_s().flat_map(|[from, to]| {
            let second = from.floor() + 1.0;
            let cut = if second < to { second } else { to };
            [[from, cut], [cut, to]].into_iter().flat_map(|[from, to]| {
                let count = ((to - from) / PIECE_S).ceil();
                let time_s = move |n: f64| {
                    if n < count {
                        from + (to - from) * n / count
                    } else {
                        to
                    }
                };
                (0..count as u32).map(move |n| [time_s(n.into()), time_s((n + 1).into())])
            })
        })
    }

    /// The last valid time between a valid time and an invalid one.
    fn edge_s(&self, mut valid: f64, mut invalid: f64) -> f64 {
        while (valid - invalid).abs() > EXACT_S {
            let middle = f64::midpoint(valid, invalid);
            match self.at(middle).is_valid() {
                true => valid = middle,
                false => invalid = middle,
            }
        }
        valid
    }
}
