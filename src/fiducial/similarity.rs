//! A local similarity: from offsets on the disc to the plate, from the marks that a labelling has identified so far.

use super::prior::GATE_SIGMAS;
use crate::units::{Measured, PlateMil};
use nalgebra::Vector2;
use std::f64::consts::TAU;

/// From offsets to the plate: a shift, and small changes of scale and rotation. Weighted least squares with priors of scale
/// and rotation; marks are added one by one to the sums.
#[derive(Debug, Clone, Copy)]
pub(super) struct LocalSimilarity {
    weight: f64,
    /// Weighted means of the offsets, and of printed position minus offset, mil.
    mean_offset: Vector2<f64>,
    mean_shift: Vector2<f64>,
    /// Information on the changes of scale and rotation (rad), and the right sides of their normal equations.
    scale_weight: f64,
    rotation_weight: f64,
    scale_sum: f64,
    rotation_sum: f64,
}

impl LocalSimilarity {
    /// Before any mark; arguments are 1 sigma of the change of scale (relative) and of rotation (rad).
    pub(super) fn new(scale_sigma: f64, rotation_sigma: f64) -> Self {
        Self {
            weight: 0.0,
            mean_offset: Vector2::zeros(),
            mean_shift: Vector2::zeros(),
            scale_weight: scale_sigma.powi(-2),
            rotation_weight: rotation_sigma.powi(-2),
            scale_sum: 0.0,
            rotation_sum: 0.0,
        }
    }

    /// Adds a mark; `variance` per axis, mil^2.
    pub(super) fn add(&mut self, offset: Vector2<f64>, printed: PlateMil, variance: f64) {
        let lever = offset - self.mean_offset;
        let shift = printed.vector() - offset - self.mean_shift;
        let weight = 1.0 / variance;
        let share = weight / (self.weight + weight);
        let common = self.weight * share;
        self.scale_sum += common * lever.dot(&shift);
        self.rotation_sum += common * lever.perp(&shift);
        self.scale_weight += common * lever.norm_squared();
        self.rotation_weight += common * lever.norm_squared();
        self.weight += weight;
        self.mean_offset += share * lever;
        self.mean_shift += share * shift;
    }

    /// Relative change of scale, and of rotation, rad.
    fn changes(&self) -> (f64, f64) {
        (
            self.scale_sum / self.scale_weight,
            self.rotation_sum / self.rotation_weight,
        )
    }

    /// Position on the plate of an offset on the disc.
    pub(super) fn place(&self, offset: Vector2<f64>) -> PlateMil {
        let (scale, rotation) = self.changes();
        let lever = offset - self.mean_offset;
        let turned = Vector2::new(-lever.y, lever.x);
        (offset + self.mean_shift + scale * lever + rotation * turned).into()
    }

    /// The inverse of [`place`](Self::place).
    pub(super) fn offset(&self, printed: PlateMil) -> Vector2<f64> {
        let (scale, rotation) = self.changes();
        let lever = printed.vector() - self.mean_offset - self.mean_shift;
        let (along, across) = (1.0 + scale, rotation);
        let turned = Vector2::new(
            along * lever.x + across * lever.y,
            along * lever.y - across * lever.x,
        );
        self.mean_offset + turned / (along * along + across * across)
    }

    /// Change of rotation on the plate, deg.
    pub(super) fn rotation_deg(&self) -> Measured {
        let sigma = self.rotation_weight.powf(-0.5);
        Measured::new(self.changes().1.to_degrees(), sigma.to_degrees())
    }

    /// Scale, mil/px; `of_offsets` is the scale of the offsets.
    pub(super) fn scale(&self, of_offsets: f64) -> Measured {
        let sigma = self.scale_weight.powf(-0.5);
        Measured::new(of_offsets * (1.0 + self.changes().0), of_offsets * sigma)
    }

    /// Variance of a predicted position along its less certain direction, mil^2.
    pub(super) fn variance(&self, offset: Vector2<f64>) -> f64 {
        let least = self.scale_weight.min(self.rotation_weight);
        1.0 / self.weight + (offset - self.mean_offset).norm_squared() / least
    }

    /// Logarithm of the probability density, per mil^2, of observing at `offset` the mark that is printed at `printed`;
    /// `variance` (mil^2) is that of the observation. `None` if the residual exceeds [`GATE_SIGMAS`].
    pub(super) fn log_density(
        &self,
        offset: Vector2<f64>,
        printed: PlateMil,
        variance: f64,
    ) -> Option<f64> {
        let lever = offset - self.mean_offset;
        let lever2 = lever.norm_squared();
        let common = variance + 1.0 / self.weight;
        let along_variance = common + lever2 / self.scale_weight;
        let across_variance = common + lever2 / self.rotation_weight;
        let residual = printed.vector() - self.place(offset).vector();
        let (along, across) = (lever.dot(&residual), lever.perp(&residual));
        let chi2 = (along * along / along_variance + across * across / across_variance)
            / lever2.max(f64::MIN_POSITIVE);
        (chi2 < GATE_SIGMAS * GATE_SIGMAS)
            .then(|| -0.5 * chi2 - TAU.ln() - 0.5 * (along_variance * across_variance).ln())
    }
}
