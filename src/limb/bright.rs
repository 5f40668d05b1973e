//! Pixels that outshine a threshold, compared as the whole numbers they are, and runs of them.

use crate::frame::Sample;
use multiversion::multiversion;

/// Pixels that are compared side by side.
const GROUP: usize = 32;

/// A pixel as a whole number.
pub trait Whole: Sample + Ord + Default {
    /// The largest value that does not outshine a threshold: `value > floor` says what
    /// `value.dn() > threshold_dn` says.
    fn floor(threshold_dn: f64) -> Self;

    /// How many values there are to count in a frame that saturates at `saturation_dn`.
    fn values(saturation_dn: u16) -> usize;

    /// The value, to count by.
    fn index(self) -> usize;
}

impl Whole for u8 {
    fn floor(threshold_dn: f64) -> Self {
        threshold_dn.floor() as Self
    }

    /// All there are, whatever saturates: a number that the compiler knows spares a check at every pixel.
    fn values(_: u16) -> usize {
        1 << Self::BITS
    }

    fn index(self) -> usize {
        usize::from(self)
    }
}

impl Whole for u16 {
    fn floor(threshold_dn: f64) -> Self {
        threshold_dn.floor() as Self
    }

    fn values(saturation_dn: u16) -> usize {
        usize::from(saturation_dn) + 1
    }

    fn index(self) -> usize {
        usize::from(self)
    }
}

/// The first bright pixel of a row.
#[inline(always)]
pub(super) fn first_bright<T: Whole>(row: &[T], floor: T) -> Option<usize> {
    // Most rows are dark all along.
    if brightest(row) > floor {
        first(row, |pixel| pixel > floor)
    } else {
        None
    }
}

#[inline(always)]
fn brightest<T: Whole>(row: &[T]) -> T {
    let (groups, rest) = row.as_chunks::<GROUP>();
    let mut most = [T::default(); GROUP];
    for group in groups {
        for (most, pixel) in most.iter_mut().zip(group) {
            *most = (*most).max(*pixel);
        }
    }
    let all = most.iter().chain(rest);
    all.fold(T::default(), |most, pixel| most.max(*pixel))
}

/// The first pixel of a row that is as wanted: groups without any are passed over.
#[inline(always)]
fn first<T: Whole>(row: &[T], wanted: impl Fn(T) -> bool) -> Option<usize> {
    let (groups, _) = row.as_chunks::<GROUP>();
    let any = |group: &[T; GROUP]| group.iter().fold(false, |any, pixel| any | wanted(*pixel));
    let passed = groups.iter().position(any).unwrap_or(groups.len()) * GROUP;
    let left = &row[passed..];
    Some(passed + left.iter().position(|pixel| wanted(*pixel))?)
}

/// Bright runs of a line, first pixel and the one after the last: long enough to be no hot pixel, marks filled in.
#[derive(Debug, Default)]
pub(super) struct Runs {
    pub found: Vec<(usize, usize)>,
    min_run_px: usize,
    max_gap_px: usize,
}

impl Runs {
    pub(super) fn new(min_run_px: usize, max_gap_px: usize) -> Self {
        Self {
            min_run_px,
            max_gap_px,
            ..Self::default()
        }
    }

    /// The runs of a line, whose first pixel is the line's pixel `from`.
    pub(super) fn find<T: Whole>(&mut self, line: &[T], from: usize, floor: T) {
        self.found.clear();
        add_runs(self, line, from, floor);
    }

    fn add(&mut self, first: usize, end: usize) {
        if end - first >= self.min_run_px {
            match self.found.last_mut() {
                Some(last) if first - last.1 <= self.max_gap_px => last.1 = end,
                _ => self.found.push((first, end)),
            }
        }
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn add_runs<T: Whole>(runs: &mut Runs, line: &[T], from: usize, floor: T) {
    let mut at = 0;
    while let Some(dark) = first_bright(&line[at..], floor) {
        let start = at + dark;
        let left = &line[start..];
        at = start + first(left, |pixel| pixel <= floor).unwrap_or(left.len());
        runs.add(from + start, from + at);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_are_compared_as_the_values_they_stand_for() {
        for threshold in [0.0, 3.999, 4.0, 4.001, 254.5, 255.0] {
            for value in [0_u8, 3, 4, 5, 254, 255] {
                assert_eq!(
                    value > u8::floor(threshold),
                    f64::from(value.dn()) > threshold
                );
            }
        }
    }

    #[test]
    fn runs_are_those_that_are_long_enough_with_their_short_gaps_filled() {
        let lit = [3..30, 50..56, 120..123, 125..135, 190..320, 331..333];
        let row: Vec<u16> = (0..333)
            .map(|n| {
                if lit.iter().any(|run| run.contains(&n)) {
                    900
                } else {
                    40
                }
            })
            .collect();
        let mut runs = Runs::new(4, 5);
        runs.find(&row, 7, 500);
        let long = [(10, 37), (57, 63), (132, 142), (197, 327)];
        assert_eq!(runs.found, long);
    }
}
