//! How the limb departs from the sphere: neighbours do alike.

use super::edge::EdgeRay;
use crate::estimation::median;
use nalgebra::{SMatrix, SVector};
use std::f64::consts::E;

/// The limb does alike over so many places.
const SHARED_PLACES: usize = 3;
/// An arc is worth as many free stretches as this, however long its neighbours do alike.
const LEAST_STRETCHES: f64 = 6.0;

/// How the edge itself departs from its cone: as a Gauss-Markov process of first order (Braun and Barf 2022, eq. 34).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Departure {
    /// 1 sigma.
    pub sigma_rad: f64,
    /// Angle between two rays at which their correlation has fallen to 1/e.
    pub length_rad: f64,
}

impl Departure {
    /// Of a limb that is a sphere's.
    pub const NONE: Self = Self {
        sigma_rad: 0.0,
        length_rad: 1.0,
    };

    /// That all rays have alike.
    pub(super) fn shared(sigma_rad: f64) -> Self {
        Self {
            sigma_rad,
            length_rad: f64::INFINITY,
        }
    }

    /// By what a fit leaves beyond noise: rays that follow each other, and how far each is from the edge that was found, rad.
    pub(super) fn of_residuals(left: &[(&EdgeRay, f64)]) -> Self {
        if left.is_empty() {
            return Self::NONE;
        }
        let together = |lag: usize| {
            let pairs = left.iter().zip(left.iter().skip(lag));
            pairs.map(|((_, one), (_, other))| one * other).sum::<f64>() / left.len() as f64
        };
        // Noise differs from one place to the next; what neighbours share is the limb's. The mean of so many products is uncertain, and the
        // limb may hide in that: it counts as half a sigma larger.
        let hidden = together(0) / ((SHARED_PLACES * left.len()) as f64).sqrt() / 2.0;
        let shared = |lag: usize| {
            let lags = lag..lag + SHARED_PLACES;
            lags.map(together).sum::<f64>() / SHARED_PLACES as f64 + hidden
        };
        let variance = shared(1).max(hidden);
        let steps = left.windows(2);
        let spacing_rad = median(steps.map(|pair| pair[0].0.unit.angle(&pair[1].0.unit)));
        let fallen = (1..left.len()).find(|lag| shared(*lag) < variance / E);
        // Only what may hide in noise falls nowhere: it shows no length, and counts from place to place.
        let lag = fallen.unwrap_or(1) as f64;
        // Of so many stretches that are free of each other, the nadir's two parameters take two, and the length one; a variance of few is itself
        // so uncertain (Student's t) that it counts as if two more were missing.
        let stretches = (left.len() as f64 / (2.0 * lag)).max(LEAST_STRETCHES);
        let variance = variance * stretches / (stretches - 5.0);
        Self {
            sigma_rad: variance.sqrt(),
            length_rad: lag * spacing_rad.unwrap_or(1.0),
        }
    }

    /// Covariance of the sum of gradients, each times its ray's departure. Rays are in order, and the last and the first are no neighbours: an edge
    /// that closes counts as a chain. The sum over all pairs takes one pass, since the correlation of two
    /// rays is that over all steps between them (Braun and Barf 2022, eq. 35).
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
