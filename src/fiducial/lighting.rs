//! Whether a mark is lit.

use crate::frame::Region;
use crate::geometry::Ellipse;
use crate::units::SensorPx;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// How far inside the limb a tip must be to count as lit: the outline's own uncertainty.
const TIP_MARGIN_PX: f64 = 0.25;

/// Whether the whole mark is lit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Lighting {
    /// All of the mark's tips lie inside the limb and on the sensor.
    Full,
    /// The limb or the sensor's edge cuts the mark: its detected position is biased, and it must not decide a mapping.
    Cut,
}

impl Lighting {
    /// Lighting of a mark at a position, by the offsets of its [`tips`](super::MarkImage::tips), on a disc of which the
    /// sensor shows a region.
    pub fn of(
        at: SensorPx,
        mut tips: impl Iterator<Item = Vector2<f64>>,
        disc: &Ellipse,
        region: &Region,
    ) -> Self {
        let lit = |tip: Vector2<f64>| {
            let tip = at.vector() + tip;
            disc.excess(tip) < -TIP_MARGIN_PX && region.holds(tip.into(), TIP_MARGIN_PX)
        };
        match tips.all(lit) {
            true => Self::Full,
            false => Self::Cut,
        }
    }
}
