//! Gaussian error of any number of states, some of which are only considered: the Schmidt-Kalman update in Joseph's form.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, SMatrix, SVector};

/// Whether measurements change a state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    Estimated,
    /// Its error contributes to every covariance, but no measurement changes it.
    Considered,
}

/// Update by an observation, before it is applied.
#[derive(Debug, Clone)]
pub struct Proposal<const M: usize> {
    /// Observed minus predicted, and its covariance.
    pub residual: SVector<f64, M>,
    pub covariance: SMatrix<f64, M, M>,
    /// Covariance of the state with the residual.
    across: DMatrix<f64>,
    root: Cholesky<f64, nalgebra::Const<M>>,
    noise: SMatrix<f64, M, M>,
}

impl<const M: usize> Proposal<M> {
    /// Prepares an update from the state's covariance: observed minus predicted values, the derivatives of the prediction by the state,
    /// and the covariance of the observation's errors. `None` if the residual's covariance is not positive.
    pub fn new(
        covariance: &DMatrix<f64>,
        residual: SVector<f64, M>,
        jacobian: &DMatrix<f64>,
        noise: SMatrix<f64, M, M>,
    ) -> Option<Self> {
        let across = covariance * jacobian.transpose();
        let predicted = jacobian * &across;
        let predicted: SMatrix<f64, M, M> = predicted.fixed_view::<M, M>(0, 0).into_owned();
        let covariance = predicted + noise;
        Some(Self {
            root: covariance.cholesky()?,
            residual,
            covariance,
            across,
            noise,
        })
    }

    /// The normalised residual squared.
    pub fn chi2(&self) -> f64 {
        self.residual.dot(&self.root.solve(&self.residual))
    }

    /// The residual in units of its errors, decorrelated: for a consistent filter the mean is 0.
    pub fn whitened(&self) -> SVector<f64, M> {
        let whitened = self.root.l_dirty().solve_lower_triangular(&self.residual);
        whitened.unwrap_or_else(SVector::zeros)
    }

    /// Applies the update: returns the change of the estimated states, and updates the covariance of all.
    pub fn take(&self, covariance: &mut DMatrix<f64>, roles: &[Role]) -> DVector<f64> {
        let across = self.across.fixed_columns::<M>(0);
        let mut gain = self.root.solve(&across.transpose()).transpose();
        for (n, _) in (0..)
            .zip(roles)
            .filter(|(_, role)| **role == Role::Considered)
        {
            gain.row_mut(n).fill(0.0);
        }
        // (1 - K H) P (1 - K H)^T + K R K^T, one factor at a time.
        let predicted = self.covariance - self.noise;
        let kept = across - &gain * predicted;
        covariance.gemm(-1.0, &gain, &across.transpose(), 1.0);
        let left = kept - &gain * self.noise;
        covariance.gemm(-1.0, &left, &gain.transpose(), 1.0);
        symmetrise(covariance);
        &gain * self.residual
    }
}

/// Removes the asymmetry of a covariance caused by rounding.
pub fn symmetrise(covariance: &mut DMatrix<f64>) {
    for column in 0..covariance.ncols() {
        for row in 0..column {
            let mean = (covariance[(row, column)] + covariance[(column, row)]) / 2.0;
            covariance[(row, column)] = mean;
            covariance[(column, row)] = mean;
        }
    }
}

/// Cholesky factor of a covariance whose states have different units: states are first scaled to unit variance. `None` if it is not positive.
pub struct ScaledRoot {
    scale: DVector<f64>,
    root: Cholesky<f64, Dyn>,
}

impl ScaledRoot {
    pub fn of(covariance: &DMatrix<f64>) -> Option<Self> {
        let scale = covariance
            .diagonal()
            .map(|variance| variance.sqrt().recip());
        let mut scaled = covariance.clone();
        for (n, factor) in scale.iter().enumerate() {
            scaled.row_mut(n).scale_mut(*factor);
            scaled.column_mut(n).scale_mut(*factor);
        }
        // Allows for rounding in the smallest eigenvalue.
        const LEAST: f64 = 1e-13;
        (0..scaled.nrows()).for_each(|n| scaled[(n, n)] += LEAST);
        Some(Self {
            root: scaled.cholesky()?,
            scale,
        })
    }

    /// The covariance's inverse times a matrix.
    pub fn solve(&self, of: &DMatrix<f64>) -> DMatrix<f64> {
        let scaled = |mut matrix: DMatrix<f64>| {
            for (n, factor) in self.scale.iter().enumerate() {
                matrix.row_mut(n).scale_mut(*factor);
            }
            matrix
        };
        scaled(self.root.solve(&scaled(of.clone())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix1, Matrix2, Vector1};

    fn start() -> DMatrix<f64> {
        DMatrix::from_row_slice(3, 3, &[4.0, 0.5, 0.2, 0.5, 2.0, -0.3, 0.2, -0.3, 1.0])
    }

    #[test]
    fn where_all_is_estimated_it_is_the_kalman_filter() {
        let jacobian = DMatrix::from_row_slice(2, 3, &[1.0, 0.0, 0.5, 0.0, 1.0, -1.0]);
        let (noise, residual) = (Matrix2::new(0.5, 0.1, 0.1, 0.3), [0.4, -0.2].into());
        let mut covariance = start();
        let proposal = Proposal::new(&covariance, residual, &jacobian, noise).unwrap();
        let change = proposal.take(&mut covariance, &[Role::Estimated; 3]);
        let noise = DMatrix::from_fn(2, 2, |row, column| noise[(row, column)]);
        let information = start().try_inverse().unwrap()
            + jacobian.transpose() * noise.clone().try_inverse().unwrap() * &jacobian;
        let expected = information.try_inverse().unwrap();
        assert!((&covariance - &expected).amax() < 1e-12);
        let residual = DVector::from_row_slice(&[0.4, -0.2]);
        let moved = expected * jacobian.transpose() * noise.try_inverse().unwrap() * residual;
        assert!((change - moved).amax() < 1e-12);
    }

    #[test]
    fn a_considered_state_stays_and_its_error_counts() {
        let jacobian = DMatrix::from_row_slice(1, 3, &[1.0, 0.0, 1.0]);
        let roles = [Role::Estimated, Role::Estimated, Role::Considered];
        let mut covariance = DMatrix::from_diagonal(&DVector::from_row_slice(&[4.0, 2.0, 1.0]));
        for _ in 0..1000 {
            let proposal =
                Proposal::new(&covariance, Vector1::new(0.3), &jacobian, Matrix1::new(0.1))
                    .unwrap();
            let change = proposal.take(&mut covariance, &roles);
            assert_eq!(change[2], 0.0);
        }
        assert_eq!(covariance[(2, 2)], 1.0);
        // The sum of both is known: this leaves at least 4 * 1 / (4 + 1) of the first.
        assert!((0.8..0.9).contains(&covariance[(0, 0)]), "{covariance}");
        assert!(covariance.cholesky().is_some());
    }
}
