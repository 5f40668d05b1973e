//! Pointing of the telescope according to the attitude, minus its target.

use super::solve::NavigationRow;
use crate::geometry::earth::north_east_up;
use crate::pointing::{Difference, PointingError, difference};
use crate::units::Measured;
use nalgebra::{Matrix2x3, Rotation3, UnitVector3, Vector3};

/// An offset from the attitude between frames, not from a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PropagatedOffset {
    pub t_s: f64,
    pub difference: Difference,
    /// 1 sigma per axis of true angle, the rms of both axes.
    pub sigma_deg: f64,
    /// Roll about the boresight, positive with the right side low.
    pub roll_deg: Measured,
}

impl PropagatedOffset {
    /// Column names of its numbers.
    pub const COLUMNS: [&str; 6] = [
        "azimuth_deg",
        "elevation_deg",
        "cross_elevation_deg",
        "sigma_deg",
        "roll_deg",
        "roll_sigma_deg",
    ];

    /// The numbers in the format of tables.
    pub fn cells(&self) -> [String; 6] {
        let difference = &self.difference;
        let numbers = [
            difference.azimuth_deg,
            difference.elevation_deg,
            difference.cross_elevation_deg,
            self.sigma_deg,
            self.roll_deg.value,
            self.roll_deg.sigma,
        ];
        numbers.map(|number| format!("{number:.7}"))
    }
}

/// The offset of the telescope from a target in ECEF, for a row; `None` before the start. The telescope's axes are forward,
/// right and down.
///
/// # Errors
/// [`PointingError::NearZenith`] if the pointing or the target is above 85 deg.
pub fn offset(
    row: &NavigationRow,
    body_from_telescope: &Rotation3<f64>,
    target: &UnitVector3<f64>,
) -> Result<Option<PropagatedOffset>, PointingError> {
    let Some((motion, covariance)) = &row.attitude else {
        return Ok(None);
    };
    let telescope = motion.attitude.to_rotation_matrix() * body_from_telescope;
    let [forward, right, down] = [Vector3::x(), Vector3::y(), Vector3::z()].map(|v| telescope * v);
    let axes = north_east_up(&motion.position_m);
    let difference = difference(&(axes.tr_mul(&forward)), &axes.tr_mul(target))?;
    // A rotation about one axis of the telescope moves the boresight along the other.
    let across = Matrix2x3::from_rows(&[right.transpose(), down.transpose()]);
    let variance_rad2 = (across * covariance * across.transpose()).trace() / 2.0;
    let up = axes.column(2);
    let roll_rad = (-right.dot(&up)).atan2(-down.dot(&up));
    let roll_sigma_rad = forward.dot(&(covariance * forward)).max(0.0).sqrt();
    Ok(Some(PropagatedOffset {
        t_s: row.t_s,
        difference,
        sigma_deg: variance_rad2.max(0.0).sqrt().to_degrees(),
        roll_deg: Measured::new(roll_rad.to_degrees(), roll_sigma_rad.to_degrees()),
    }))
}
