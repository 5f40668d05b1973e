//! Location, scale and loss that are robust against a minority of outliers.

use crate::kernels::squares_within;
use std::borrow::Borrow;

/// 1 sigma of a normal distribution over the median of the absolute deviations from its middle.
pub const SIGMA_PER_MEDIAN: f64 = 1.4826;
/// The upper quartile of a normal distribution, in sigmas, which is the median of the absolute deviations.
pub const QUARTILE_SIGMAS: f64 = 0.6745;
/// The median length of a normal deviation in two axes, in sigmas per axis (Rayleigh): the square root of 2 ln 2.
pub const MEDIAN_LENGTH_2D: f64 = 1.177;
/// Its square: the median of chi^2 with two degrees of freedom.
pub const MEDIAN_CHI2_2D: f64 = 2.0 * std::f64::consts::LN_2;
/// 1 sigma of the median of many normally distributed values over that of their mean: the square root of pi / 2.
pub const MEDIAN_SIGMA: f64 = 1.253_314_137_315_500_3;

/// Two values that differ by more sigmas than this contradict each other.
pub const CONTRADICTION_SIGMAS: f64 = 5.0;

/// Tukey's limit for residuals in one axis: 95 % of the efficiency of least squares for normal errors.
pub const TUKEY_SIGMAS: f64 = 4.685;
/// The same for the length of residuals in two axes, in sigmas per axis; it is larger because such lengths are.
pub const TUKEY_SIGMAS_2D: f64 = 5.123;

/// Loss of residuals, and so their weights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// Least squares: equal weights.
    Squares,
    /// Tukey's biweight: the weight falls to zero at this many sigmas.
    Tukey(f64),
}

impl Loss {
    /// Weight of a residual in sigmas, 0 to 1.
    pub fn weight(self, residual: f64) -> f64 {
        match self {
            Self::Squares => 1.0,
            Self::Tukey(limit) => (1.0 - (residual / limit).powi(2)).max(0.0).powi(2),
        }
    }

    /// Cost of a residual in sigmas, near its square where it is small: twice the integral of residual times weight.
    pub fn cost(self, residual: f64) -> f64 {
        match self {
            Self::Squares => residual.powi(2),
            Self::Tukey(limit) => {
                let inside = (1.0 - (residual / limit).powi(2)).max(0.0);
                limit.powi(2) / 3.0 * (1.0 - inside.powi(3))
            }
        }
    }
}

/// The median of some values, the larger of the two middle ones if their number is even; `None` without values.
pub fn median<V: Borrow<f64>>(values: impl IntoIterator<Item = V>) -> Option<f64> {
    median_among(
        &mut values
            .into_iter()
            .map(|v| *v.borrow())
            .collect::<Vec<f64>>(),
    )
}

/// The same, reordering the values.
pub fn median_among(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The [`median`] of some values, and 1 sigma of their scatter about it; `None` without values.
pub fn median_and_scatter(values: &[f64]) -> Option<(f64, f64)> {
    let middle = median(values)?;
    let away = median(values.iter().map(|value| (value - middle).abs()))?;
    Some((middle, SIGMA_PER_MEDIAN * away))
}

/// An integer with the same order as the numbers, for faster comparisons.
pub fn order(value: f32) -> i32 {
    let bits = value.to_bits() as i32;
    bits ^ ((bits >> 31) & i32::MAX)
}

/// The [`median`] of numbers given by their [`order`]; `None` without values.
pub fn median_of_orders(orders: &mut [i32]) -> Option<f32> {
    let middle = orders.len() / 2;
    // The mapping between bits and order is its own inverse.
    let of = |middle: i32| f32::from_bits(order(f32::from_bits(middle as u32)) as u32);
    (!orders.is_empty()).then(|| of(*orders.select_nth_unstable(middle).1))
}

/// 1 sigma of residuals, at least `least`, from those within three sigmas: iterated, because the limit depends on the result.
/// `None` if there are too few.
pub fn clipped_sigma(residuals: &[f32], start: f32, least: f64) -> Option<f64> {
    /// Fewest values that determine a sigma.
    const MIN_VALUES: f32 = 10.0;
    /// Ratio of the standard deviation of a normal distribution cut at three sigmas to its sigma.
    const KEPT: f32 = 0.9866;
    const ROUNDS: usize = 4;
    /// The start may be from another part of the picture.
    const FIRST_LIMIT: f32 = 5.0;
    let mut limit = FIRST_LIMIT * start;
    let mut sigma = None;
    for _ in 0..ROUNDS {
        let [count, squares] = squares_within(residuals, limit);
        if count < MIN_VALUES {
            return None;
        }
        let found = ((squares / count).sqrt() / KEPT).max(least as f32);
        sigma = Some(f64::from(found));
        if limit == 3.0 * found {
            break;
        }
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
        for values in [&[3.0, -0.5, 1e9][..], &[4.0, -1.0, 3.0, 0.0], &[-2.0], &[]] {
            let mut orders: Vec<i32> = values.iter().copied().map(order).collect();
            let values = values.iter().map(|value| f64::from(*value));
            assert_eq!(median_of_orders(&mut orders).map(f64::from), median(values));
        }
    }

    #[test]
    fn a_tenth_that_is_far_off_hardly_sways_a_clipped_sigma() {
        let even = |n: usize| (n * 7919 % 401) as f32 / 40.0 - 5.0;
        let mut values: Vec<f32> = (0..400).map(even).collect();
        let clean = clipped_sigma(&values, 2.0, 0.3).unwrap();
        values[..40].fill(60.0);
        let swayed = clipped_sigma(&values, 2.0, 0.3).unwrap();
        assert!((swayed / clean - 1.0).abs() < 0.03, "{clean} and {swayed}");
        assert_eq!(clipped_sigma(&values[..8], 2.0, 0.3), None);
    }

    #[test]
    fn a_loss_grows_as_its_weight_says_and_not_beyond_its_limit() {
        for loss in [Loss::Squares, Loss::Tukey(TUKEY_SIGMAS)] {
            for residual in [0.0, 0.5, 2.0, 4.0, 6.0] {
                let slope = (loss.cost(residual + 1e-4) - loss.cost(residual - 1e-4)) / 2e-4;
                assert!((slope - 2.0 * residual * loss.weight(residual)).abs() < 1e-6);
            }
        }
        let [near, far] = [5.0, 1e9].map(|residual| Loss::Tukey(TUKEY_SIGMAS).cost(residual));
        assert_eq!(near, far);
    }

    #[test]
    fn the_scatter_of_an_even_spread_is_measured_in_spite_of_a_far_one() {
        let values = [-2.0, -1.0, 0.0, 1.0, 1e9];
        assert_eq!(median_and_scatter(&values), Some((0.0, SIGMA_PER_MEDIAN)));
        assert_eq!(median_and_scatter(&[]), None);
    }
}
