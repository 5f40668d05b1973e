//! Scatter of residuals: the noise beyond their own sigmas, and the correlation of neighbours.

use crate::calibrate::numbers::median;
use crate::estimation::MEDIAN_CHI2_2D;
use crate::units::PlateMil;
use nalgebra::Vector2;
use std::path::PathBuf;

/// Residual of an observation in a fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Residual {
    pub file: PathBuf,
    pub utc: jiff::Timestamp,
    /// Observed position of the Sun.
    pub at: PlateMil,
    /// Observed minus fitted, mil.
    pub off: Vector2<f64>,
    /// 1 sigma per axis used in the fit, mil.
    pub sigma_mil: f64,
    /// Whether the fit used it.
    pub accepted: bool,
}

impl Residual {
    /// Normalised residual: its length in units of its sigma.
    pub fn normalised(&self) -> f64 {
        self.off.norm() / self.sigma_mil
    }
}

/// The extra variance per axis for which the median of the accepted residuals is as expected; 0 if their own sigmas suffice.
pub(super) fn extra_variance(residuals: &[Residual]) -> f64 {
    let accepted = residuals.iter().filter(|r| r.accepted);
    let squares: Vec<(f64, f64)> = accepted
        .map(|r| (r.off.norm_squared(), r.sigma_mil.powi(2)))
        .collect();
    let excess =
        |extra: f64| median(squares.iter().map(|(r2, own)| r2 / (own + extra))) - MEDIAN_CHI2_2D;
    if squares.is_empty() || excess(0.0) <= 0.0 {
        return 0.0;
    }
    let (mut low, mut high) = (0.0, squares.iter().map(|s| s.0).fold(0.0, f64::max));
    for _ in 0..60 {
        let middle = (low + high) / 2.0;
        if excess(middle) > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

/// Factor by which correlation increases the variance of a mean of the residuals: 1 + 2 sum of the autocorrelation, in the order of time,
/// up to where it vanishes in noise; the larger of the two axes.
pub(super) fn correlation(taken: &[&Residual]) -> f64 {
    let along = |axis: usize| {
        let values = taken.iter().map(|r| r.off[axis] / r.sigma_mil);
        correlation_of(&values.collect::<Vec<_>>())
    };
    along(0).max(along(1))
}

/// The same for one axis.
pub fn correlation_of(values: &[f64]) -> f64 {
    let count = values.len();
    if count < 20 {
        return 1.0;
    }
    let noise_level = 2.0 / (count as f64).sqrt();
    let square: f64 = values.iter().map(|v| v * v).sum();
    let at_lag = |lag: usize| {
        let products = values.iter().zip(&values[lag..]).map(|(a, b)| a * b);
        products.sum::<f64>() / square
    };
    let lags = (1..count / 3).map(at_lag);
    1.0 + 2.0 * lags.take_while(|rho| *rho > noise_level).sum::<f64>()
}
