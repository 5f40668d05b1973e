//! Correlated departures of the limb from the sphere.

use super::edge::EdgeRay;
use crate::estimation::median;
use nalgebra::{SMatrix, SVector};
use std::f64::consts::E;

/// Number of lags over which the covariance of neighbours is averaged.
const SHARED_PLACES: usize = 3;
/// Minimum number of independent stretches of an arc, however long the correlation length.
const LEAST_STRETCHES: f64 = 6.0;

/// Departure of the edge from its cone: a Gauss-Markov process of first order (Braun and Barf 2022, eq. 34).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Departure {
    /// 1 sigma.
    pub sigma_rad: f64,
    /// Angle between two rays at which their correlation has fallen to 1/e.
    pub length_rad: f64,
}

impl Departure {
    /// A limb without departures from the sphere.
    pub const NONE: Self = Self {
        sigma_rad: 0.0,
        length_rad: 1.0,
    };

    /// A departure common to all rays.
    pub(super) fn shared(sigma_rad: f64) -> Self {
        Self {
            sigma_rad,
            length_rad: f64::INFINITY,
        }
    }

    /// Estimated from the residuals of a fit beyond noise: rays in order, each with its distance from the fitted edge, rad.
    pub(super) fn of_residuals(left: &[(&EdgeRay, f64)]) -> Self {
        if left.is_empty() {
            return Self::NONE;
        }
        let together = |lag: usize| {
            let pairs = left.iter().zip(left.iter().skip(lag));
            pairs.map(|((_, one), (_, other))| one * other).sum::<f64>() / left.len() as f64
        };
        // Noise is independent from one place to the next; the covariance of neighbours is the limb's. The mean of these
        // products is uncertain, and a departure may be undetected within it: it is increased by half a sigma.
        let hidden = together(0) / ((SHARED_PLACES * left.len()) as f64).sqrt() / 2.0;
        let shared = |lag: usize| {
            let lags = lag..lag + SHARED_PLACES;
            lags.map(together).sum::<f64>() / SHARED_PLACES as f64 + hidden
        };
        let variance = shared(1).max(hidden);
        let steps = left.windows(2);
        let spacing_rad = median(steps.map(|pair| pair[0].0.unit.angle(&pair[1].0.unit)));
        let fallen = (1..left.len()).find(|lag| shared(*lag) < variance / E);
        // A departure that is undetected in the noise has no correlation length, and is taken as independent from place to
        // place.
        let lag = fallen.unwrap_or(1) as f64;
        // Of the number of independent stretches, the nadir's two parameters take two, and the length one; a variance from
        // few stretches is so uncertain (Student's t) that two more are subtracted.
        let stretches = (left.len() as f64 / (2.0 * lag)).max(LEAST_STRETCHES);
        let variance = variance * stretches / (stretches - 5.0);
        Self {
            sigma_rad: variance.sqrt(),
            length_rad: lag * spacing_rad.unwrap_or(1.0),
        }
    }

    /// Covariance of the sum of gradients, each times its ray's departure. Rays are in order, and the last and the first
    /// are not neighbours: a closed edge counts as a chain. The sum over all pairs takes one pass, since the correlation of
    /// two rays is the product of those of all steps between them (Braun and Barf 2022, eq. 35).
    pub(super) fn scatter<const N: usize>(
        self,
        gradients: &[(SVector<f64, N>, &EdgeRay)],
    ) -> SMatrix<f64, N, N> {
        let mut sum = SMatrix::zeros();
        if self.sigma_rad == 0.0 {
            return sum;
        }
        let mut before = SVector::<f64, N>::zeros();
        let mut last: Option<&EdgeRay> = None;
        for (gradient, ray) in gradients {
            if let Some(last) = last {
                before *= (-last.unit.angle(&ray.unit) / self.length_rad).exp();
            }
            let pairs = before * gradient.transpose();
            sum += gradient * gradient.transpose() + pairs + pairs.transpose();
            before += gradient;
            last = Some(ray);
        }
        sum * self.sigma_rad.powi(2)
    }
}
