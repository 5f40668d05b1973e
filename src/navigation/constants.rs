//! The constant errors of the sensors: results of one flight for the next.

use super::filter::Filter;
use nalgebra::{DMatrix, Vector3};

/// A constant error about the three axes of the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Constant {
    /// m/s^2
    AccelerometerBias,
    /// rad/s
    GyroBias,
    /// Index of the camera in the settings; rad.
    Misalignment(usize),
}

/// The constant errors that the settings do not state as exact, as estimated by a filter.
#[derive(Debug, Clone, PartialEq)]
pub struct ConstantErrors {
    pub values: Vec<(Constant, Vector3<f64>)>,
    /// Covariance of their axes, in the order of `values`.
    pub covariance: DMatrix<f64>,
}

impl ConstantErrors {
    pub(super) fn of(filter: &Filter) -> Self {
        let (layout, estimate) = (&filter.model.layout, &filter.estimate);
        let imu = [Constant::AccelerometerBias, Constant::GyroBias];
        let imu = imu.into_iter().zip(&layout.imu).zip(&estimate.imu);
        let cameras = (0..).map(Constant::Misalignment);
        let cameras = cameras.zip(&layout.cameras).zip(&estimate.cameras);
        let (mut values, mut states) = (Vec::new(), Vec::new());
        for ((constant, triad), value) in imu.chain(cameras) {
            if let Some(triad) = triad {
                values.push((constant, *value));
                states.extend(triad.range());
            }
        }
        // They do not change between the last measurement and the end.
        let covariance = &filter.covariance;
        let of = |row: usize, column: usize| covariance[(states[row], states[column])];
        Self {
            values,
            covariance: DMatrix::from_fn(states.len(), states.len(), of),
        }
    }

    /// 1 sigma of the n-th error, the largest of its three axes.
    pub fn sigma(&self, n: usize) -> f64 {
        let variances = self.covariance.diagonal();
        variances.rows(3 * n, 3).max().max(0.0).sqrt()
    }
}
