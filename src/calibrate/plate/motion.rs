//! A motion of the camera in its mount: small shift, rotation and stretch of the plate's picture.

use crate::estimation::{
    FitError, Fitted, LeastSquares, Linearised, Loss, Prior, Scale, TUKEY_SIGMAS_2D,
};
use nalgebra::{Matrix2x4, SMatrix, SVector, Vector2, Vector4};

/// Loss that rejects displacements far from the motion.
pub(super) const LOSS: Loss = Loss::Tukey(TUKEY_SIGMAS_2D);
/// Rotations and stretches are displacements at this distance from the middle, px.
const REACH_PX: f64 = 500.0;
/// Prior of the motions, 1 sigma, px: undetermined parts stay near zero.
const UNKNOWN_PX: f64 = 10.0;

/// A displacement on the sensor.
#[derive(Debug, Clone, Copy)]
pub(super) struct Displacement {
    /// Position relative to the middle of the picture.
    pub at: Vector2<f64>,
    pub moved_px: Vector2<f64>,
    /// 1 sigma of the displacement per axis.
    pub sigma_px: f64,
}

impl Displacement {
    /// Displacement for one px of shift x, shift y, rotation and stretch.
    pub fn slopes(&self) -> Matrix2x4<f64> {
        let at = self.at / REACH_PX;
        Matrix2x4::new(1.0, 0.0, -at.y, at.x, 0.0, 1.0, at.x, at.y)
    }

    /// Residual after a motion, in its sigmas.
    pub fn residual(&self, motion: &Vector4<f64>) -> Vector2<f64> {
        (self.moved_px - self.slopes() * motion) / self.sigma_px
    }
}

/// The motion fitted to displacements, px along each of the slopes given with them.
pub(super) fn motion<'a, const N: usize>(
    displacements: impl Iterator<Item = (&'a Displacement, SMatrix<f64, 2, N>)>,
) -> Result<Fitted<N>, FitError> {
    let fit = LeastSquares {
        start: SVector::zeros(),
        prior: Prior {
            mean: SVector::zeros(),
            information: SVector::repeat(UNKNOWN_PX.powi(-2)),
        },
        loss: LOSS,
        scale: Scale::Median,
        tolerance_sigmas: 1e-2,
    };
    let displacements: Vec<_> = displacements.collect();
    fit.fit(|motion| {
        let row = |(one, slopes): &(&Displacement, SMatrix<f64, 2, N>)| Linearised {
            residual: (one.moved_px - slopes * motion) / one.sigma_px,
            jacobian: slopes / one.sigma_px,
        };
        Some(displacements.iter().map(row).collect())
    })
}
