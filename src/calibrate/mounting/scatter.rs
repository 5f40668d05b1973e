//! How sights scatter: weights, noise beyond their own sigmas, likeness of neighbours, and which of two fits is better.

use super::fit::{Fit, Residual};
use crate::calibrate::numbers::median;
use nalgebra::Vector2;

/// Tukey's limit for residuals in two axes, in sigmas.
const TUKEY_SIGMAS: f64 = 6.0;
/// Half of all residuals in two axes are smaller than the root of this many variances.
const MEDIAN_SQUARE: f64 = 1.386;

/// By how much one fit's sum of squares is below another's, with the better one's sigmas. No sight counts for much, and neighbours
/// that scatter alike count once.
pub(super) fn advantage(fit: &Fit, over: &Fit) -> f64 {
    const MOST_SQUARE: f64 = 12.25;
    let better = if fit.scatter_mil <= over.scatter_mil {
        fit
    } else {
        over
    };
    let cost = |fit: &Fit| -> f64 {
        let sigmas = better.residuals.iter().map(|r| r.sigma_mil);
        let pairs = fit.residuals.iter().zip(sigmas);
        let square = |(r, s): (&Residual, f64)| (r.off.norm_squared() / (s * s)).min(MOST_SQUARE);
        pairs.map(square).sum()
    };
    (cost(over) - cost(fit)) / better.correlation
}

/// Two models are told apart where the sum of squares differs by more than this.
pub(super) const TOLD: f64 = 25.0;

/// Residuals in units of their sigmas.
pub(super) fn sizes(residuals: &[Vector2<f64>], variances: &[f64]) -> impl Iterator<Item = f64> {
    residuals
        .iter()
        .zip(variances)
        .map(|(r, v)| r.norm() / v.sqrt())
}

pub(super) fn tukey(residuals: &[Vector2<f64>], variances: &[f64]) -> Vec<f64> {
    let part = |u: f64| (1.0 - (u / TUKEY_SIGMAS).powi(2)).max(0.0).powi(2);
    let parts = sizes(residuals, variances).map(part);
    parts.zip(variances).map(|(part, v)| part / v).collect()
}

pub(super) fn plain(variances: &[f64], accepted: &[bool]) -> Vec<f64> {
    let taken = variances.iter().zip(accepted);
    taken
        .map(|(v, accepted)| if *accepted { 1.0 / v } else { 0.0 })
        .collect()
}

/// The variance per axis beyond their own that gives the residuals the median they have; 0 where their own suffices.
pub(super) fn extra_variance(
    residuals: &[Vector2<f64>],
    own: &[f64],
    accepted: Option<&[bool]>,
) -> f64 {
    let taken: Vec<(f64, f64)> = residuals
        .iter()
        .zip(own)
        .enumerate()
        .filter(|(n, _)| accepted.is_none_or(|accepted| accepted[*n]))
        .map(|(_, (r, own))| (r.norm_squared(), *own))
        .collect();
    let excess =
        |extra: f64| median(taken.iter().map(|(r2, own)| r2 / (own + extra))) - MEDIAN_SQUARE;
    if taken.is_empty() || excess(0.0) <= 0.0 {
        return 0.0;
    }
    let (mut low, mut high) = (0.0, taken.iter().map(|t| t.0).fold(0.0, f64::max));
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

/// How many times more a mean of the residuals varies than if each were on its own: 1 + 2 sum of the autocorrelation, in the
/// order of time, up to where it drowns in noise; the larger of the two axes.
pub(super) fn correlation(taken: &[&Residual]) -> f64 {
    let count = taken.len();
    if count < 20 {
        return 1.0;
    }
    let drowned = 2.0 / (count as f64).sqrt();
    let along = |axis: usize| {
        let values: Vec<f64> = taken.iter().map(|r| r.off[axis] / r.sigma_mil).collect();
        let square: f64 = values.iter().map(|v| v * v).sum();
        let at_lag = |lag: usize| {
            let products = values.iter().zip(&values[lag..]).map(|(a, b)| a * b);
            products.sum::<f64>() / square
        };
        let lags = (1..count / 3).map(at_lag);
        1.0 + 2.0 * lags.take_while(|rho| *rho > drowned).sum::<f64>()
    };
    along(0).max(along(1))
}
