//! The fit of a reading: from what the outline and the arms tell to what the marks say.

use super::identify::Sight;
use crate::plate::MarkId;
use crate::units::PlateMil;
use nalgebra::Vector2;
use std::f64::consts::{PI, TAU};

/// Error of the rotation that the arms tell, 1 sigma; three noisy marks tell it to a degree.
const ARMS_SIGMA_RAD: f64 = 0.6 * PI / 180.0;
/// A detection farther from a mark's foretold place is not that mark, in sigma.
pub(super) const GATE_SIGMAS: f64 = 4.0;

/// From offsets to the plate: shift, and small changes of scale and rotation, from the marks so far. Least squares with
/// what is known of scale and rotation beforehand, in sums that grow by a mark at a time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    weight: f64,
    /// Weighted means of the offsets and of what leads from them to the printed places, mil.
    offset: Vector2<f64>,
    step: Vector2<f64>,
    /// Information on scale and rotation, and its products with them.
    scale_weight: f64,
    rotation_weight: f64,
    stretch: f64,
    twist: f64,
}

impl Fit {
    pub(super) fn new(sight: &Sight) -> Self {
        let scale_sigma = sight.radius_mil.sigma / sight.radius_mil.value;
        Self {
            weight: 0.0,
            offset: Vector2::zeros(),
            step: Vector2::zeros(),
            scale_weight: scale_sigma.powi(-2),
            rotation_weight: ARMS_SIGMA_RAD.powi(-2),
            stretch: 0.0,
            twist: 0.0,
        }
    }

    pub(super) fn add(&mut self, offset: Vector2<f64>, printed: PlateMil, variance: f64) {
        let arm = offset - self.offset;
        let change = printed.vector() - offset - self.step;
        let weight = 1.0 / variance;
        let part = weight / (self.weight + weight);
        let shared = self.weight * part;
        self.stretch += shared * arm.dot(&change);
        self.twist += shared * arm.perp(&change);
        self.scale_weight += shared * arm.norm_squared();
        self.rotation_weight += shared * arm.norm_squared();
        self.weight += weight;
        self.offset += part * arm;
        self.step += part * change;
    }

    fn scale(&self) -> f64 {
        self.stretch / self.scale_weight
    }

    fn rotation(&self) -> f64 {
        self.twist / self.rotation_weight
    }

    /// Where on the plate an offset leads.
    pub(super) fn place(&self, offset: Vector2<f64>) -> PlateMil {
        let arm = offset - self.offset;
        let turn = Vector2::new(-arm.y, arm.x);
        (offset + self.step + self.scale() * arm + self.rotation() * turn).into()
    }

    /// The inverse of [`place`](Self::place).
    pub(super) fn offset(&self, printed: PlateMil) -> Vector2<f64> {
        let arm = printed.vector() - self.offset - self.step;
        let (along, across) = (1.0 + self.scale(), self.rotation());
        let turned = Vector2::new(
            along * arm.x + across * arm.y,
            along * arm.y - across * arm.x,
        );
        self.offset + turned / (along * along + across * across)
    }

    /// Error of a place in the worse direction, 1 sigma, mil.
    pub(super) fn sigma(&self, offset: Vector2<f64>) -> f64 {
        let least = self.scale_weight.min(self.rotation_weight);
        (1.0 / self.weight + (offset - self.offset).norm_squared() / least).sqrt()
    }

    /// The mark that a detection is, of which `variance` (mil^2) tells how far it may be seen from its place, with the logarithm of how likely it is to be seen there, per mil^2. `None` when it
    /// is none.
    pub(super) fn explain(
        &self,
        offset: Vector2<f64>,
        marks: &[(MarkId, PlateMil)],
        variance: impl Fn(PlateMil) -> f64,
    ) -> Option<(MarkId, PlateMil, f64)> {
        let place = self.place(offset).vector();
        let miss = |(_, printed): &&(MarkId, PlateMil)| (printed.vector() - place).norm_squared();
        let (id, printed) = marks.iter().min_by(|a, b| miss(a).total_cmp(&miss(b)))?;
        let arm = offset - self.offset;
        let reach = arm.norm_squared();
        let common = variance(*printed) + 1.0 / self.weight;
        let along = common + reach / self.scale_weight;
        let across = common + reach / self.rotation_weight;
        let miss = printed.vector() - place;
        let (stretch, twist) = (arm.dot(&miss), arm.perp(&miss));
        let off =
            (stretch * stretch / along + twist * twist / across) / reach.max(f64::MIN_POSITIVE);
        (off < GATE_SIGMAS * GATE_SIGMAS).then(|| {
            (
                *id,
                *printed,
                -0.5 * off - TAU.ln() - 0.5 * (along * across).ln(),
            )
        })
    }
}
