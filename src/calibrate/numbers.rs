//! Numbers: medians, and formatting of measured values to two digits of the sigma.

use crate::estimation;
use crate::units::Measured;
use std::borrow::Borrow;

/// Sigmas below this are written with an exponent.
const SMALL: f64 = 1e-5;

/// A sigma to two digits.
pub fn sigma_text(sigma: f64) -> String {
    value_text(Measured::new(sigma, sigma))
}

/// A value to two digits of its sigma; all digits if there is no useful sigma.
pub fn value_text(measured: Measured) -> String {
    let Measured { value, sigma } = measured;
    if !(sigma.is_finite() && sigma > 0.0) {
        return value.to_string();
    }
    if sigma < SMALL {
        let digits = (value.abs() / sigma).log10().ceil().clamp(1.0, 15.0) as usize;
        return format!("{value:.digits$e}");
    }
    let digits = (1.0 - sigma.log10().floor()).max(0.0) as usize;
    format!("{value:.digits$}")
}

/// The median of the finite ones of some values; 0 if there are none.
pub fn median<V: Borrow<f64>>(values: impl IntoIterator<Item = V>) -> f64 {
    let values = values.into_iter().map(|v| *v.borrow());
    estimation::median(values.filter(|v| v.is_finite())).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_median_is_of_the_finite_values() {
        assert_eq!(median([2.0, f64::NAN]), 2.0);
        assert_eq!(median::<f64>([]), 0.0);
    }

    #[test]
    fn values_are_written_to_two_digits_of_their_sigma() {
        let text = |value, sigma| value_text(Measured::new(value, sigma));
        assert_eq!(text(-51.306_12, 0.004_6), "-51.3061");
        assert_eq!(text(3005.314, 3.1), "3005.3");
        assert_eq!(text(-4.5318e-7, 3.6e-9), "-4.532e-7");
        assert_eq!(sigma_text(0.004_6), "0.0046");
        assert_eq!(sigma_text(3.6e-9), "3.6e-9");
        assert_eq!(text(4.25, 0.0), "4.25");
    }
}
