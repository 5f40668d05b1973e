//! The middle of many values and how they scatter about it, which the few that are far off do not sway.

use crate::frame::ROUNDING_NOISE_DN;
use crate::lanes::{LANES, Scratch};
use multiversion::multiversion;
use std::borrow::Borrow;

/// 1 sigma of values that scatter normally, over the median of how far they are from their middle.
pub const SIGMA_PER_MEDIAN: f64 = 1.4826;

/// The middle one of some values in order, of an even number the larger of the two in the middle; `None` of none.
pub fn median<V: Borrow<f64>>(values: impl IntoIterator<Item = V>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().map(|v| *v.borrow()).collect();
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The [`median`] of some values, and 1 sigma of their scatter about it; `None` of none.
pub fn median_and_scatter(values: &[f64]) -> Option<(f64, f64)> {
    let middle = median(values)?;
    let away = median(values.iter().map(|value| (value - middle).abs()))?;
    Some((middle, SIGMA_PER_MEDIAN * away))
}

/// The median of some sizes, which are not negative; `None` of none.
pub fn median_size(sizes: impl Iterator<Item = f32>) -> Option<f32> {
    // The bits of such numbers are ordered as the numbers are, and compared more quickly.
    let mut bits = Scratch::<u32>::empty(sizes.size_hint().0);
    bits.extend(sizes.map(f32::to_bits));
    let middle = bits.len() / 2;
    (!bits.is_empty()).then(|| f32::from_bits(*bits.select_nth_unstable(middle).1))
}

/// 1 sigma of what is left, from what lies within three of it: in rounds, since the limit rests on the result. `None` of
/// too few.
#[multiversion(targets("x86_64+avx2"))]
pub fn clipped_sigma(left: &[f32], start: f32) -> Option<f64> {
    /// Fewest values that tell a sigma.
    const MIN_VALUES: u32 = 10;
    /// What the normal distribution keeps of its sigma within three of it.
    const KEPT: f32 = 0.9866;
    const ROUNDS: usize = 4;
    /// The start may be of another part of the picture.
    const FIRST_LIMIT: f32 = 5.0;
    let mut limit = FIRST_LIMIT * start;
    let mut sigma = None;
    for _ in 0..ROUNDS {
        let limit2 = limit * limit;
        let (mut counts, mut squares) = ([0_u32; LANES], [0.0_f32; LANES]);
        for left in left.as_chunks::<LANES>().0 {
            for k in 0..LANES {
                let square = left[k] * left[k];
                counts[k] += u32::from(square < limit2);
                squares[k] += if square < limit2 { square } else { 0.0 };
            }
        }
        let count: u32 = counts.iter().sum();
        if count < MIN_VALUES {
            return None;
        }
        let found = (squares.iter().sum::<f32>() / count as f32).sqrt() / KEPT;
        let found = found.max(ROUNDING_NOISE_DN as f32);
        sigma = Some(f64::from(found));
        limit = 3.0 * found;
    }
    sigma
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_one_is_one_of_the_values_and_not_swayed_by_the_largest() {
        assert_eq!(median([3.0, 1.0, 1e9]), Some(3.0));
        assert_eq!(median([4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(median::<f64>([]), None);
    }

    #[test]
    fn the_median_of_sizes_is_one_of_them() {
        assert_eq!(median_size([3.0, 0.5, 1e9].into_iter()), Some(3.0));
        assert_eq!(median_size([4.0, 1.0, 3.0, 0.0].into_iter()), Some(3.0));
        assert_eq!(median_size([].into_iter()), None);
    }

    #[test]
    fn a_tenth_that_is_far_off_hardly_sways_a_clipped_sigma() {
        let even = |n: usize| (n * 7919 % 401) as f32 / 40.0 - 5.0;
        let mut values: Vec<f32> = (0..400).map(even).collect();
        let clean = clipped_sigma(&values, 2.0).unwrap();
        values[..40].fill(60.0);
        let swayed = clipped_sigma(&values, 2.0).unwrap();
        assert!((swayed / clean - 1.0).abs() < 0.03, "{clean} and {swayed}");
        assert_eq!(clipped_sigma(&values[..8], 2.0), None);
    }

    #[test]
    fn the_scatter_of_an_even_spread_is_told_in_spite_of_a_far_one() {
        let values = [-2.0, -1.0, 0.0, 1.0, 1e9];
        assert_eq!(median_and_scatter(&values), Some((0.0, SIGMA_PER_MEDIAN)));
        assert_eq!(median_and_scatter(&[]), None);
    }
}
