//! What is known of the picture before any mark is read.

use crate::geometry::{Ellipse, Handedness};
use crate::units::{Measured, SensorPx};
use nalgebra::{Matrix2, Rotation2};

/// What limb, ephemeris, arms and instrument tell before any mark is read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdentificationPrior {
    /// The disc's outline on the sensor.
    pub outline: Ellipse,
    /// Radius of the outline on the plate; its sigma tells how well that fixes the scale.
    pub radius_mil: Measured,
    /// Rotation of the picture modulo a quarter turn, from the arms of the crosses, in the outline's own coordinates
    /// ([`Ellipse::to_disc`]).
    pub quarter_rotation_deg: f64,
    pub handedness: Handedness,
    /// Where the instrument says the plate's centre is seen, and 1 sigma of that per axis.
    pub plate_centre: SensorPx,
    pub plate_centre_sigma_px: f64,
    /// Rotation of the plate's axes on the sensor as the instrument states it, positive from +x towards +y, deg.
    pub rotation_deg: Measured,
    /// Scale as the instrument states it.
    pub scale_mil_per_px: Measured,
    /// Depth inside the limb from which a mark must have been found, px.
    pub sure_depth_px: f64,
    /// Distance from the sensor's edge from which a mark must have been found, px.
    pub sure_margin_px: f64,
    /// Width and height of the sensor, px.
    pub sensor_px: [f64; 2],
    /// Share of the marks that must have been found and are not.
    pub missed_share: f64,
}

impl IdentificationPrior {
    pub(super) fn found_share(&self) -> f64 {
        1.0 - self.missed_share
    }

    /// The rotations that the arms allow, deg, each with the map from the unit disc to offsets from the Sun's centre on the
    /// plate (mil).
    pub(super) fn turns(&self) -> impl Iterator<Item = (f64, Matrix2<f64>)> {
        let axes = self.handedness.axes() * self.radius_mil.value;
        [0.0, 90.0, 180.0, 270.0].into_iter().map(move |quarter| {
            let rotation_deg = self.quarter_rotation_deg + quarter;
            let rotation = Rotation2::new(rotation_deg.to_radians());
            (rotation_deg, axes * rotation.matrix().transpose())
        })
    }

    /// Mean scale on the disc.
    pub(super) fn mil_per_px(&self) -> f64 {
        self.radius_mil.value / self.outline.mean_radius()
    }

    /// Whether a mark at this position lies far enough from the sensor's edge.
    pub(super) fn on_sensor(&self, at: SensorPx) -> bool {
        let margin = self.sure_margin_px;
        let inside = |v: f64, size: f64| v > margin && v < size - 1.0 - margin;
        inside(at.x, self.sensor_px[0]) && inside(at.y, self.sensor_px[1])
    }
}
