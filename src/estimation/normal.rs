//! Normal equations: of a few parameters, and of many parameters with observations that depend on a few each.

use nalgebra::{Cholesky, Const, DMatrix, DVector, Dyn, Matrix2, SMatrix, SVector, Vector2};

/// Least part of an unknown's information that must be independent of the previous unknowns; else it is not determined.
const LEAST_OWN_PART: f64 = 1e-10;

/// Independent priors of the parameters.
#[derive(Debug, Clone, Copy)]
pub struct Prior<const N: usize> {
    pub mean: SVector<f64, N>,
    /// 1 / variance; 0 without a prior, infinite for a fixed parameter: a fit must start with it at the mean.
    pub information: SVector<f64, N>,
}

impl<const N: usize> Prior<N> {
    pub fn none() -> Self {
        Self {
            mean: SVector::zeros(),
            information: SVector::zeros(),
        }
    }

    /// Prior information on the free parameters.
    fn free(&self) -> SVector<f64, N> {
        self.information
            .map(|known| if known.is_finite() { known } else { 0.0 })
    }

    pub(super) fn gradient(&self, parameters: &SVector<f64, N>) -> SVector<f64, N> {
        self.free().component_mul(&(self.mean - parameters))
    }

    pub(super) fn cost(&self, parameters: &SVector<f64, N>) -> f64 {
        let off = parameters - self.mean;
        self.free().dot(&off.component_mul(&off))
    }
}

/// The normal equations of observations linearised at some parameters, with residuals and derivatives in units of their sigmas.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Normal<const N: usize> {
    pub information: SMatrix<f64, N, N>,
    pub gradient: SVector<f64, N>,
    /// Sum of the squared residuals.
    pub chi2: f64,
}

/// Solved normal equations.
#[derive(Debug, Clone)]
pub struct Solved<const N: usize> {
    /// Step of the parameters.
    pub step: SVector<f64, N>,
    root: Cholesky<f64, Const<N>>,
    is_held: [bool; N],
}

impl<const N: usize> Solved<N> {
    /// Covariance of the parameters after the step: 0 for fixed ones.
    pub fn covariance(&self) -> SMatrix<f64, N, N> {
        let mut covariance = self.root.inverse();
        for n in (0..N).filter(|n| self.is_held[*n]) {
            covariance[(n, n)] = 0.0;
        }
        covariance
    }
}

impl<const N: usize> Normal<N> {
    pub fn zero() -> Self {
        Self {
            information: SMatrix::zeros(),
            gradient: SVector::zeros(),
            chi2: 0.0,
        }
    }

    /// Adds an observation with a weight: derivatives of its prediction, and observed minus predicted.
    pub fn add(&mut self, slopes: &SVector<f64, N>, residual: f64, weight: f64) {
        self.information.ger(weight, slopes, slopes, 1.0);
        self.gradient.axpy(weight * residual, slopes, 1.0);
        self.chi2 += weight * residual * residual;
    }

    /// The same observations, each multiplied by a weight.
    pub fn weighted(&self, weight: f64) -> Self {
        Self {
            information: self.information * weight,
            gradient: self.gradient * weight,
            chi2: self.chi2 * weight,
        }
    }

    /// Sum of these observations and others.
    pub fn with(&self, other: &Self) -> Self {
        Self {
            information: self.information + other.information,
            gradient: self.gradient + other.gradient,
            chi2: self.chi2 + other.chi2,
        }
    }

    /// Normal equations of the last `LEFT` parameters with the `FIRST` ones eliminated by the observations alone (Schur complement).
    /// `None` if these do not determine them. FIRST + LEFT = N.
    pub fn of_last<const FIRST: usize, const LEFT: usize>(&self) -> Option<Normal<LEFT>> {
        let block = self.information.fixed_view::<FIRST, FIRST>(0, 0);
        let mixed = self.information.fixed_view::<FIRST, LEFT>(0, FIRST);
        let root = block.into_owned().cholesky()?;
        let gradient = self.gradient.fixed_rows::<FIRST>(0);
        let taken = mixed.transpose() * root.solve(&mixed.into_owned());
        let step = root.solve(&gradient.into_owned());
        Some(Normal {
            information: self.information.fixed_view::<LEFT, LEFT>(FIRST, FIRST) - taken,
            gradient: self.gradient.fixed_rows::<LEFT>(FIRST) - mixed.transpose() * step,
            chi2: self.chi2 - gradient.dot(&step),
        })
    }

    /// The Gauss-Newton step from parameters with a prior; those with infinite information are fixed at their mean. `None` if the others
    /// are not determined.
    pub fn solve(&self, prior: &Prior<N>, parameters: &SVector<f64, N>) -> Option<Solved<N>> {
        let mut information = self.information;
        let mut gradient = self.gradient;
        for n in 0..N {
            let known = prior.information[n];
            if known.is_finite() {
                information[(n, n)] += known;
                gradient[n] += known * (prior.mean[n] - parameters[n]);
            } else {
                let step = prior.mean[n] - parameters[n];
                gradient.axpy(-step, &information.column(n).into_owned(), 1.0);
                information.row_mut(n).fill(0.0);
                information.column_mut(n).fill(0.0);
                (information[(n, n)], gradient[n]) = (1.0, step);
            }
        }
        let root = information.cholesky()?;
        let own = |n: usize| root.l_dirty()[(n, n)].powi(2);
        if (0..N).any(|n| own(n) <= LEAST_OWN_PART * information[(n, n)]) {
            return None;
        }
        let step = root.solve(&gradient);
        step.iter().all(|v| v.is_finite()).then_some(Solved {
            step,
            root,
            is_held: prior.information.map(f64::is_infinite).into(),
        })
    }

    /// The sum of the squared residuals predicted for a step by the linearisation.
    pub fn chi2_after(&self, step: &SVector<f64, N>) -> f64 {
        self.chi2 - 2.0 * step.dot(&self.gradient) + step.dot(&(self.information * step))
    }
}

/// The normal equations of many unknowns. A prior is added as an observation.
#[derive(Debug, Clone)]
pub struct Large {
    information: DMatrix<f64>,
    gradient: DVector<f64>,
}

/// Solved normal equations of many unknowns.
#[derive(Debug, Clone)]
pub struct LargeSolved {
    /// Step of all unknowns: 0 for fixed ones.
    pub step: DVector<f64>,
    /// Cholesky factor of the free unknowns' information.
    root: Cholesky<f64, Dyn>,
    free: Vec<usize>,
}

impl Large {
    pub fn zero(unknowns: usize) -> Self {
        Self {
            information: DMatrix::zeros(unknowns, unknowns),
            gradient: DVector::zeros(unknowns),
        }
    }

    /// Adds an observation of `D` coordinates with a weight, the inverse of its covariance: the derivatives of its prediction by the
    /// unknowns on which it depends, and observed minus predicted.
    pub fn add<const D: usize>(
        &mut self,
        slopes: &[(usize, SVector<f64, D>)],
        residual: &SVector<f64, D>,
        weight: &SMatrix<f64, D, D>,
    ) {
        for (a, slope) in slopes {
            let weighted = weight * slope;
            self.gradient[*a] += weighted.dot(residual);
            for (b, slope) in slopes {
                self.information[(*b, *a)] += weighted.dot(slope);
            }
        }
    }

    /// Adds to the information between two neighbouring unknowns and two others, or themselves.
    pub fn add_block(&mut self, [row, column]: [usize; 2], information: &Matrix2<f64>) {
        let mut block = self.information.fixed_view_mut::<2, 2>(row, column);
        block += information;
    }

    /// Adds to the gradient of two neighbouring unknowns.
    pub fn add_gradient(&mut self, first: usize, gradient: &Vector2<f64>) {
        let mut rows = self.gradient.fixed_rows_mut::<2>(first);
        rows += gradient;
    }

    /// The Gauss-Newton step. `None` if the free unknowns are not determined.
    pub fn solve(&self, is_held: impl Fn(usize) -> bool) -> Option<LargeSolved> {
        let free: Vec<usize> = (0..self.gradient.len()).filter(|n| !is_held(*n)).collect();
        let information = self.information.select_rows(&free).select_columns(&free);
        let root = information.cholesky()?;
        let of_free = root.solve(&self.gradient.select_rows(&free));
        let mut step = DVector::zeros(self.gradient.len());
        for (n, value) in free.iter().zip(&of_free) {
            step[*n] = *value;
        }
        let is_finite = step.iter().all(|v| v.is_finite());
        is_finite.then_some(LargeSolved { step, root, free })
    }
}

impl LargeSolved {
    /// Covariance of the unknowns after the step: 0 for fixed ones.
    pub fn covariance(&self) -> DMatrix<f64> {
        let of_free = self.root.inverse();
        let mut covariance = DMatrix::zeros(self.step.len(), self.step.len());
        for (column, m) in self.free.iter().enumerate() {
            for (row, n) in self.free.iter().enumerate() {
                covariance[(*n, *m)] = of_free[(row, column)];
            }
        }
        covariance
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line through (0, 1), (1, 3) and (2, 5.3), each with sigma 0.1.
    fn line() -> Normal<2> {
        let mut normal = Normal::zero();
        for (x, y) in [(0.0, 1.0), (1.0, 3.0), (2.0, 5.3)] {
            normal.add(&SVector::from([1.0, x]), y, 100.0);
        }
        normal
    }

    #[test]
    fn a_line_is_the_one_of_the_textbook() {
        let solved = line().solve(&Prior::none(), &SVector::zeros()).unwrap();
        assert!((solved.step - SVector::from([0.95, 2.15])).norm() < 1e-9);
        assert!((solved.covariance()[(1, 1)] - 0.01 / 2.0).abs() < 1e-12);
        assert!((line().chi2_after(&solved.step) - 1.5).abs() < 1e-9);
    }

    #[test]
    fn what_is_held_goes_to_its_mean_and_has_no_variance() {
        let mut prior = Prior::none();
        prior.information[1] = f64::INFINITY;
        let solved = line().solve(&prior, &SVector::from([0.0, 0.5])).unwrap();
        assert!((solved.step - SVector::from([3.1 + 0.5, -0.5])).norm() < 1e-9);
        assert_eq!(solved.covariance()[(1, 1)], 0.0);
        assert!((solved.covariance()[(0, 0)] - 0.01 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_left_for_the_last_parameters_solves_to_the_same() {
        let slope = line().of_last::<1, 1>().unwrap();
        let solved = slope.solve(&Prior::none(), &SVector::zeros()).unwrap();
        assert!((solved.step[0] - 2.15).abs() < 1e-9);
        assert!((solved.covariance()[(0, 0)] - 0.01 / 2.0).abs() < 1e-12);
        assert!((slope.chi2_after(&solved.step) - 1.5).abs() < 1e-9);
    }

    #[test]
    fn many_unknowns_are_solved_as_a_few_are() {
        let mut large = Large::zero(3);
        for (x, y) in [(0.0, 1.0), (1.0, 3.0), (2.0, 5.3)] {
            let slopes = [(0, SVector::from([1.0])), (2, SVector::from([x]))];
            large.add(&slopes, &SVector::from([y]), &SMatrix::from([[100.0]]));
        }
        assert!(large.solve(|_| false).is_none());
        let solved = large.solve(|n| n == 1).unwrap();
        let expected = DVector::from_vec(vec![0.95, 0.0, 2.15]);
        assert!((&solved.step - expected).norm() < 1e-9);
        let covariance = solved.covariance();
        assert_eq!(covariance[(1, 1)], 0.0);
        assert!((covariance[(2, 2)] - 0.01 / 2.0).abs() < 1e-12);
    }

    #[test]
    fn what_nothing_determines_is_refused() {
        let mut normal = Normal::zero();
        normal.add(&SVector::from([1.0, 2.0]), 1.0, 1.0);
        assert!(normal.solve(&Prior::none(), &SVector::zeros()).is_none());
        let prior = Prior {
            mean: SVector::zeros(),
            information: SVector::from([0.0, 1.0]),
        };
        assert!(normal.solve(&prior, &SVector::zeros()).is_some());
    }
}
