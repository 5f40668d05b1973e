//! Pixels that outshine a threshold, compared as the whole numbers they are, and runs of them.

use crate::frame::Sample;
use multiversion::multiversion;
use std::ops::BitOr;

/// Pixels that are looked at together: where none of them is bright, none is looked at alone.
const STRETCH: usize = 64;

/// A pixel as a whole number.
pub trait Whole: Sample + PartialOrd + Default + BitOr<Output = Self> {
    /// The largest value that does not outshine a threshold: `value > floor` says what
    /// `value.dn() > threshold_dn` says.
    fn floor(threshold_dn: f64) -> Self;

    /// How far a value lies above another; zero where it does not.
    fn above(self, floor: Self) -> Self;

    /// The value, to count by.
    fn index(self) -> usize;
}

macro_rules! whole {
    ($kind:ty) => {
        impl Whole for $kind {
            fn floor(threshold_dn: f64) -> Self {
                threshold_dn.floor() as Self
            }

            fn above(self, floor: Self) -> Self {
                self.saturating_sub(floor)
            }

            fn index(self) -> usize {
                usize::from(self)
            }
        }
    };
}
whole!(u8);
whole!(u16);

/// Which stretches of a row hold a bright pixel, in a list that is used again from row to row.
#[derive(Debug, Default)]
pub(super) struct Stretches {
    found: Vec<u32>,
}

impl Stretches {
    /// The stretches of a row that hold a bright pixel, each with its place in the row.
    pub(super) fn bright<'a, T: Whole>(
        &'a mut self,
        row: &'a [T],
        floor: T,
    ) -> impl Iterator<Item = (usize, &'a [T])> {
        self.found.clear();
        find_bright(row, floor, &mut self.found);
        self.found.iter().map(move |n| {
            let first = *n as usize * STRETCH;
            (first, &row[first..(first + STRETCH).min(row.len())])
        })
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn find_bright<T: Whole>(row: &[T], floor: T, found: &mut Vec<u32>) {
    let join = |any: T, pixel: &T| any | pixel.above(floor);
    // Most rows are dark all along.
    if row.iter().fold(T::default(), join) == T::default() {
        return;
    }
    for (n, stretch) in row.chunks(STRETCH).enumerate() {
        let any = match <&[T; STRETCH]>::try_from(stretch) {
            Ok(whole) => whole.iter().fold(T::default(), join),
            Err(_) => stretch.iter().fold(T::default(), join),
        };
        if any > T::default() {
            found.push(n as u32);
        }
    }
}

/// Bright runs of a line, first pixel and the one after the last: long enough to be no hot pixel, marks filled in.
#[derive(Debug, Default)]
pub(super) struct Runs {
    pub found: Vec<(usize, usize)>,
    min_run_px: usize,
    max_gap_px: usize,
    /// First pixel of the run that has not ended yet, and the pixel after its last so far.
    open: Option<(usize, usize)>,
    stretches: Stretches,
}

impl Runs {
    pub(super) fn new(min_run_px: usize, max_gap_px: usize) -> Self {
        Self {
            min_run_px,
            max_gap_px,
            ..Self::default()
        }
    }

    /// The runs of a line from its pixel `from` on.
    pub(super) fn of_line<T: Whole>(
        &mut self,
        line: impl Iterator<Item = T>,
        from: usize,
        floor: T,
    ) {
        self.found.clear();
        self.add(line, from, floor);
        self.close();
    }

    /// The same of a row that lies in one piece: what is dark is passed over.
    pub(super) fn of_row<T: Whole>(&mut self, row: &[T], from: usize, floor: T) {
        self.found.clear();
        let mut stretches = std::mem::take(&mut self.stretches);
        for (first, stretch) in stretches.bright(row, floor) {
            self.add(stretch.iter().copied(), from + first, floor);
        }
        self.stretches = stretches;
        self.close();
    }

    fn add<T: Whole>(&mut self, pixels: impl Iterator<Item = T>, from: usize, floor: T) {
        for (n, pixel) in pixels.enumerate() {
            if pixel > floor {
                let n = from + n;
                match &mut self.open {
                    Some((_, end)) if *end == n => *end = n + 1,
                    _ => {
                        self.close();
                        self.open = Some((n, n + 1));
                    }
                }
            }
        }
    }

    fn close(&mut self) {
        if let Some((first, end)) = self.open.take()
            && end - first >= self.min_run_px
        {
            match self.found.last_mut() {
                Some(last) if first - last.1 <= self.max_gap_px => last.1 = end,
                _ => self.found.push((first, end)),
            }
        }
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
    fn a_row_in_one_piece_has_the_runs_that_its_pixels_have_one_by_one() {
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
        let [mut passing, mut each] = [(); 2].map(|()| Runs::new(4, 5));
        passing.of_row(&row, 7, 500);
        each.of_line(row.iter().copied(), 7, 500);
        assert_eq!(passing.found, each.found);
        let long = [(10, 37), (57, 63), (132, 142), (197, 327)];
        assert_eq!(passing.found, long);
    }
}
