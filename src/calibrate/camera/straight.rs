//! Linear least squares for a few coefficients, robust against outliers.

use crate::calibrate::numbers::median;
use crate::statistics::SIGMA_PER_MEDIAN;
use nalgebra::{SMatrix, SVector};

/// Sigmas beyond which a value does not count.
const TUKEY_SIGMAS: f64 = 4.7;
const STEPS: usize = 12;

/// Coefficients with their sigmas.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Solved<const N: usize> {
    pub coefficients: SVector<f64, N>,
    pub covariance: SMatrix<f64, N, N>,
}

impl<const N: usize> Solved<N> {
    pub fn sigma(&self, n: usize) -> f64 {
        self.covariance[(n, n)].max(0.0).sqrt()
    }
}

/// Fits values as sums of coefficients times known terms; `sigmas` are relative, their scale is told by the scatter. `None` when
/// the terms do not determine the coefficients.
pub(super) fn solve<const N: usize>(
    terms: &[SVector<f64, N>],
    values: &[f64],
    sigmas: &[f64],
) -> Option<Solved<N>> {
    if values.len() <= N {
        return None;
    }
    let mut weights = vec![1.0; values.len()];
    let mut solved = None;
    for _ in 0..STEPS {
        let (mut matrix, mut right) = (SMatrix::<f64, N, N>::zeros(), SVector::<f64, N>::zeros());
        for (n, row) in terms.iter().enumerate() {
            let weight = weights[n] / sigmas[n].powi(2);
            matrix += row * row.transpose() * weight;
            right += row * (values[n] * weight);
        }
        let inverse = matrix.try_inverse()?;
        let coefficients = inverse * right;
        if !coefficients.iter().all(|c| c.is_finite()) {
            return None;
        }
        let off = |n: usize| (values[n] - terms[n].dot(&coefficients)) / sigmas[n];
        let sizes: Vec<f64> = (0..values.len()).map(|n| off(n).abs()).collect();
        let scale = SIGMA_PER_MEDIAN
            * median(&sizes)
            * (values.len() as f64 / (values.len() - N) as f64).sqrt();
        if scale > 0.0 {
            let part = |u: f64| {
                (1.0 - (u / (TUKEY_SIGMAS * scale)).powi(2))
                    .max(0.0)
                    .powi(2)
            };
            weights = sizes.iter().map(|u| part(*u)).collect();
        }
        solved = Some(Solved {
            coefficients,
            covariance: inverse * scale.powi(2),
        });
    }
    solved
}
