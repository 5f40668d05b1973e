//! How the limb departs from the sphere: neighbours do alike.

use super::nadir::EdgeRay;
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

    /// By what a fit leaves beyond noise: rays that follow each other, and how far each is from the edge that was found, rad.
    pub(super) fn of_residuals(left: &[(&EdgeRay, f64)]) -> Self {
        let together = |lag: usize| {
            let pairs = left.iter().zip(left.iter().skip(lag));
            pairs.map(|((_, one), (_, other))| one * other).sum::<f64>() / left.len() as f64
        };
        // Noise differs from one place to the next; what neighbours share is the limb's.
        let variance = (1..=SHARED_PLACES).map(together).sum::<f64>() / SHARED_PLACES as f64;
        let variance = variance.max(0.0);
        let steps = left.windows(2);
        let spacing_rad = median(steps.map(|pair| pair[0].0.unit.angle(&pair[1].0.unit)));
        let fallen = (1..left.len()).find(|lag| together(*lag) < variance / E);
        let lag = fallen.unwrap_or(1) as f64;
        // Of so many stretches that are free of each other, the nadir's two parameters take two; and a variance of few is itself so
        // uncertain (Student's t) that it counts as if two more were missing.
        let stretches = (left.len() as f64 / (2.0 * lag)).max(LEAST_STRETCHES);
        let variance = variance * stretches / (stretches - 4.0);
        Self {
            sigma_rad: variance.sqrt(),
            length_rad: lag * spacing_rad.unwrap_or(1.0),
        }
    }

    /// Covariance of the sum of gradients, each times its ray's error: of the camera's noise and of the edge's departure. The sum
    /// over all pairs takes one pass, since the correlation of two rays is that over all steps between them.
    pub(super) fn scatter<const N: usize>(
        self,
        gradients: &[(SVector<f64, N>, &EdgeRay)],
    ) -> SMatrix<f64, N, N> {
        let mut noise = SMatrix::zeros();
        let mut edge = SMatrix::zeros();
        let mut before = SVector::<f64, N>::zeros();
        let mut last: Option<&EdgeRay> = None;
        for (gradient, ray) in gradients {
            let square = gradient * gradient.transpose();
            noise += square * ray.sigma_rad.powi(2);
            let step_rad = last.map_or(f64::INFINITY, |last| last.unit.angle(&ray.unit));
            before *= (-step_rad / self.length_rad).exp();
            let pairs = before * gradient.transpose();
            edge += square + pairs + pairs.transpose();
            before += gradient;
            last = Some(ray);
        }
        noise + edge * self.sigma_rad.powi(2)
    }
}
