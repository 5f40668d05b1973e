//! Least squares for a few parameters: reweighted Gauss-Newton steps, halved until they lower the cost.
//!
//! Residuals are in units of their stated sigmas. The loss weights them by their size relative to the scale; scale and weights are
//! determined together with the parameters (iteratively reweighted least squares: Holland and Welsch, 1977).

use super::normal::{Normal, Prior};
use super::robust::{Loss, MEDIAN_LENGTH_2D, SIGMA_PER_MEDIAN, TUKEY_SIGMAS, median_among};
use crate::units::Measured;
use nalgebra::{SMatrix, SVector};

/// An observation linearised at some parameters, in units of its sigma.
#[derive(Debug, Clone, Copy)]
pub struct Linearised<const D: usize, const N: usize> {
    /// Observed minus predicted.
    pub residual: SVector<f64, D>,
    /// Derivatives of the prediction by the parameters.
    pub jacobian: SMatrix<f64, D, N>,
}

/// Inflation of the sigmas of observations and prior.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    /// No inflation.
    Stated,
    /// To the weighted rms of the residuals; never below 1.
    Inflated,
    /// From the median length of the residuals, in one axis or in two: stated sigmas are relative.
    Median,
}

/// Settings of a fit.
#[derive(Debug, Clone, Copy)]
pub struct LeastSquares<const N: usize> {
    pub start: SVector<f64, N>,
    pub prior: Prior<N>,
    pub loss: Loss,
    pub scale: Scale,
    /// A shorter step ends the fit, in sigmas of the parameters.
    pub tolerance_sigmas: f64,
}

/// The parameters with the least cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted<const N: usize> {
    pub parameters: SVector<f64, N>,
    pub covariance: SMatrix<f64, N, N>,
    /// Inflation of the sigmas; see [`Scale`].
    pub scatter: f64,
    /// The loss's weight of each observation, 0 to 1.
    pub weights: Vec<f64>,
}

impl<const N: usize> Fitted<N> {
    pub fn measured(&self, n: usize) -> Measured {
        Measured::new(self.parameters[n], self.covariance[(n, n)].max(0.0).sqrt())
    }
}

/// Reasons for which there is no fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FitError {
    #[error("the observations do not determine the parameters")]
    Undetermined,
    #[error("the fit does not converge: still moving after {MOST_STEPS} steps")]
    NotConverged,
}

const MOST_STEPS: usize = 100;
/// The scale is constant from this step on, so that the weights that depend on it converge.
const SCALE_STEPS: usize = 25;
/// Convergence of the scale, relative: this multiple of the parameters' tolerance in sigmas moves them by less than that tolerance.
const SETTLED_SCALE: f64 = 0.02;
const LEAST_SETTLED_SCALE: f64 = 1e-6;
/// A step halved this often is lost in rounding: there is no lower cost.
const MOST_HALVINGS: i32 = 40;

impl<const N: usize> LeastSquares<N> {
    /// Fits the parameters. `linearise` gives all observations at some parameters, always as many and in the same order; `None` if the
    /// parameters give no prediction.
    ///
    /// # Errors
    /// If observations and prior do not determine the parameters, or the steps do not converge.
    pub fn fit<const D: usize>(
        &self,
        linearise: impl Fn(&SVector<f64, N>) -> Option<Vec<Linearised<D, N>>>,
    ) -> Result<Fitted<N>, FitError> {
        self.fit_each(linearise)
    }

    /// The same for observations that come from an iterator.
    ///
    /// # Errors
    /// Those of [`fit`](Self::fit).
    pub fn fit_each<const D: usize, Rows: IntoIterator<Item = Linearised<D, N>>>(
        &self,
        linearise: impl Fn(&SVector<f64, N>) -> Option<Rows>,
    ) -> Result<Fitted<N>, FitError> {
        let mut parameters = self.start;
        let first = linearise(&parameters).ok_or(FitError::Undetermined)?;
        let mut rows: Vec<Linearised<D, N>> = first.into_iter().collect();
        let mut moved_rows = Vec::with_capacity(rows.len());
        let mut weights = vec![1.0; rows.len()];
        let mut sizes = Vec::new();
        let mut scale = 1.0;
        let settled_scale = (SETTLED_SCALE * self.tolerance_sigmas).max(LEAST_SETTLED_SCALE);
        for step in 0..MOST_STEPS {
            let previous = scale;
            if step < SCALE_STEPS {
                scale = self.scale.of(&rows, &weights, &mut sizes);
            }
            let loss = Scaled::new(self.loss, scale);
            weights.clear();
            weights.extend(rows.iter().map(|row| loss.weight(row)));
            let normal = normal_equations(&rows, &weights);
            let solved = normal.solve(&self.prior, &parameters);
            let solved = solved.ok_or(FitError::Undetermined)?;
            let full = &solved.step;
            let gain = full.dot(&self.prior.gradient(&parameters)) + full.dot(&normal.gradient);
            let better = (gain > (self.tolerance_sigmas * scale).powi(2)).then(|| {
                let cost = |at: &_, rows: &[_]| loss.cost(rows) + self.prior.cost(at);
                let limit = cost(&parameters, &rows);
                (0..MOST_HALVINGS).find_map(|halvings| {
                    let moved = parameters + full * 0.5_f64.powi(halvings);
                    moved_rows.clear();
                    moved_rows.extend(linearise(&moved)?);
                    (cost(&moved, &moved_rows) < limit).then_some(moved)
                })
            });
            match better.flatten() {
                Some(moved) => {
                    parameters = moved;
                    std::mem::swap(&mut rows, &mut moved_rows);
                }
                None if (scale - previous).abs() > settled_scale * scale => {}
                None => {
                    return Ok(Fitted {
                        parameters,
                        covariance: solved.covariance() * scale.powi(2),
                        scatter: scale,
                        weights,
                    });
                }
            }
        }
        Err(FitError::NotConverged)
    }

    /// Fits after a first fit by plain least squares: for a start at which residuals do not yet show outliers.
    ///
    /// # Errors
    /// Those of [`fit`](Self::fit).
    pub fn fit_after_plain<const D: usize, Rows: IntoIterator<Item = Linearised<D, N>>>(
        &self,
        linearise: impl Fn(&SVector<f64, N>) -> Option<Rows>,
    ) -> Result<Fitted<N>, FitError> {
        let plain = Self {
            loss: Loss::Squares,
            scale: Scale::Stated,
            ..*self
        };
        let start = plain.fit_each(&linearise)?.parameters;
        Self { start, ..*self }.fit_each(linearise)
    }
}

fn normal_equations<const D: usize, const N: usize>(
    rows: &[Linearised<D, N>],
    weights: &[f64],
) -> Normal<N> {
    let mut normal = Normal::<N>::zero();
    for (row, weight) in rows.iter().zip(weights).filter(|(_, w)| **w > 0.0) {
        for d in 0..D {
            let residual = row.residual[d];
            normal.chi2 += weight * residual * residual;
            for m in 0..N {
                let slope = weight * row.jacobian[(d, m)];
                normal.gradient[m] += slope * residual;
                for n in m..N {
                    normal.information[(n, m)] += slope * row.jacobian[(d, n)];
                }
            }
        }
    }
    normal.information.fill_upper_triangle_with_lower_triangle();
    normal
}

/// A loss of residuals relative to their scale; equal weights if the scale is zero.
struct Scaled {
    loss: Loss,
    scale: f64,
}

impl Scaled {
    fn new(loss: Loss, scale: f64) -> Self {
        match scale > 0.0 {
            true => Self { loss, scale },
            false => Self {
                loss: Loss::Squares,
                scale: 1.0,
            },
        }
    }

    fn weight<const D: usize, const N: usize>(&self, row: &Linearised<D, N>) -> f64 {
        self.loss.weight(row.residual.norm() / self.scale)
    }

    fn cost<const D: usize, const N: usize>(&self, rows: &[Linearised<D, N>]) -> f64 {
        let sizes = rows.iter().map(|row| row.residual.norm() / self.scale);
        self.scale.powi(2) * sizes.map(|size| self.loss.cost(size)).sum::<f64>()
    }
}

impl Scale {
    /// The scale from these observations; `list` is a buffer for the sizes of their residuals.
    fn of<const D: usize, const N: usize>(
        self,
        rows: &[Linearised<D, N>],
        weights: &[f64],
        list: &mut Vec<f64>,
    ) -> f64 {
        let sizes = rows.iter().map(|row| row.residual.norm());
        let freedom = |counted: f64| (counted * D as f64 - N as f64).max(1.0);
        match self {
            Self::Stated => 1.0,
            Self::Inflated => {
                let squares: f64 = sizes.zip(weights).map(|(r, w)| w * r.powi(2)).sum();
                (squares / freedom(weights.iter().sum())).sqrt().max(1.0)
            }
            Self::Median => {
                let count = rows.len() as f64;
                let sigma_per_median = match D {
                    1 => SIGMA_PER_MEDIAN,
                    _ => 1.0 / MEDIAN_LENGTH_2D,
                };
                list.clear();
                list.extend(sizes);
                let middle = median_among(list).unwrap_or_default();
                sigma_per_median * middle * (count / freedom(count)).sqrt()
            }
        }
    }
}

/// Robust linear regression: values as sums of coefficients times known terms. `sigmas` are relative, their scale is determined from the
/// scatter.
///
/// # Errors
/// If the terms do not determine the coefficients, or leave no value to determine the scatter.
pub fn regression<const N: usize>(
    terms: &[SVector<f64, N>],
    values: &[f64],
    sigmas: &[f64],
) -> Result<Fitted<N>, FitError> {
    regression_by(
        Loss::Tukey(TUKEY_SIGMAS),
        Scale::Median,
        terms,
        values,
        sigmas,
    )
}

/// Linear regression with a given loss and scale. Plain squares are unbiased for skewed errors; a robust loss is biased.
///
/// # Errors
/// Those of [`regression`].
pub fn regression_by<const N: usize>(
    loss: Loss,
    scale: Scale,
    terms: &[SVector<f64, N>],
    values: &[f64],
    sigmas: &[f64],
) -> Result<Fitted<N>, FitError> {
    if values.len() <= N {
        return Err(FitError::Undetermined);
    }
    let linearise = |coefficients: &SVector<f64, N>| {
        let rows = terms.iter().zip(values).zip(sigmas);
        let row = |((terms, value), sigma): ((&SVector<f64, N>, &f64), &f64)| Linearised {
            residual: SVector::from([(value - terms.dot(coefficients)) / sigma]),
            jacobian: terms.transpose() / *sigma,
        };
        Some(rows.map(row).collect::<Vec<_>>())
    };
    let fit = LeastSquares {
        start: SVector::zeros(),
        prior: Prior::none(),
        loss,
        scale,
        tolerance_sigmas: 1e-6,
    };
    fit.fit_after_plain(linearise)
}

#[cfg(test)]
mod strd;

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Vector1, Vector2};
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_xoshiro::Xoshiro256PlusPlus;

    /// A straight line 3 + 0.5 x with normal errors of 0.2.
    fn line(count: usize, seed: u64) -> (Vec<Vector2<f64>>, Vec<f64>) {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let terms: Vec<_> = (0..count)
            .map(|n| Vector2::new(1.0, n as f64 / 10.0))
            .collect();
        let value = |t: &Vector2<f64>| 3.0 + 0.5 * t.y + 0.2 * rng.sample::<f64, _>(StandardNormal);
        let values = terms.iter().map(value).collect();
        (terms, values)
    }

    #[test]
    fn a_regression_ignores_a_fifth_of_outliers() {
        let (terms, mut values) = line(50, 1);
        let outliers = values.iter_mut().step_by(5);
        outliers.for_each(|value| *value += 40.0);
        let slope = regression(&terms, &values, &[1.0; 50]).unwrap();
        assert!(slope.weights.iter().step_by(5).all(|w| *w == 0.0));
        let Measured { value, sigma } = slope.measured(1);
        assert!((value - 0.5).abs() < 3.0 * sigma && sigma < 0.04);
    }

    #[test]
    fn the_sigmas_of_a_regression_are_honest() {
        let squares = (0..200).map(|seed| {
            let (terms, values) = line(50, seed);
            let slope = regression(&terms, &values, &[1.0; 50]).unwrap().measured(1);
            ((slope.value - 0.5) / slope.sigma).powi(2)
        });
        let rms = (squares.sum::<f64>() / 200.0).sqrt();
        assert!((0.85..1.25).contains(&rms), "{rms}");
    }

    #[test]
    fn terms_that_say_the_same_or_too_few_values_determine_nothing() {
        let same = vec![Vector2::new(1.0, 1.0); 9];
        let found = regression(&same, &[1.0; 9], &[1.0; 9]);
        assert_eq!(found, Err(FitError::Undetermined));
        let (terms, values) = line(2, 1);
        let found = regression(&terms, &values, &[1.0; 2]);
        assert_eq!(found, Err(FitError::Undetermined));
    }

    #[test]
    fn values_without_scatter_are_fitted_exactly() {
        let (terms, _) = line(20, 1);
        let values: Vec<f64> = terms.iter().map(|t| 3.0 + 0.5 * t.y).collect();
        let fitted = regression(&terms, &values, &[1.0; 20]).unwrap();
        assert!((fitted.parameters - Vector2::new(3.0, 0.5)).norm() < 1e-12);
    }

    /// The decay a exp(-b x) observed without errors at ten points, from a start.
    fn decay(start: [f64; 2], prior: Prior<2>) -> Result<Fitted<2>, FitError> {
        let fit = LeastSquares {
            start: start.into(),
            prior,
            loss: Loss::Squares,
            scale: Scale::Stated,
            tolerance_sigmas: 1e-6,
        };
        fit.fit(|p| {
            let row = |n: i32| {
                let x = f64::from(n);
                let part = (-p.y * x).exp();
                Linearised {
                    residual: Vector1::new(5.0 * (-0.3 * x).exp() - p.x * part) / 0.01,
                    jacobian: Vector2::new(part, -p.x * x * part).transpose() / 0.01,
                }
            };
            Some((0..10).map(row).collect())
        })
    }

    #[test]
    fn a_start_from_which_full_steps_diverge_is_led_to_the_least_cost() {
        for start in [[5.0, 3.0], [0.1, 5.0], [50.0, 0.0], [-3.0, 1.0]] {
            let fitted = decay(start, Prior::none()).unwrap();
            assert!(
                (fitted.parameters - Vector2::new(5.0, 0.3)).norm() < 1e-6,
                "{start:?}"
            );
        }
    }

    #[test]
    fn a_prior_counts_as_its_information_says() {
        let free = decay([5.0, 0.3], Prior::none()).unwrap();
        let prior = Prior {
            mean: Vector2::new(5.0, 0.3) + Vector2::new(free.measured(0).sigma, 0.0),
            information: Vector2::new(1.0 / free.covariance.m11, 0.0),
        };
        let held = decay([5.0, 0.3], prior).unwrap();
        assert!((held.covariance.m11 / free.covariance.m11 - 0.5).abs() < 0.01);
        let moved = (held.parameters.x - 5.0) / free.measured(0).sigma;
        assert!((moved - 0.5).abs() < 0.01, "{moved}");
    }
}
