//! The middle of many values and how they scatter about it, which the few that are far off do not sway.

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
    fn the_scatter_of_an_even_spread_is_told_in_spite_of_a_far_one() {
        let values = [-2.0, -1.0, 0.0, 1.0, 1e9];
        assert_eq!(median_and_scatter(&values), Some((0.0, SIGMA_PER_MEDIAN)));
        assert_eq!(median_and_scatter(&[]), None);
    }
}
