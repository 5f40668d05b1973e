//! The rotation in words and in the camera's file.

use super::fit::Turn;
use crate::calibrate::revision::{Provenance, Revision, number, rows};
use nalgebra::Rotation3;
use std::fmt;
use toml_edit::{Array, Table, value};

/// The name of the calibration in the file.
pub const NAME: &str = "body_from_camera";

impl Turn {
    /// Difference from a stated rotation, about the body's forward, right and down axes, deg.
    pub fn from_stated_deg(&self, stated: &Rotation3<f64>) -> [f64; 3] {
        let more = self.body_from_camera * stated.inverse();
        more.scaled_axis().map(f64::to_degrees).into()
    }

    /// Writes the rotation with its sigmas and covariance into a camera's file.
    pub fn revise(&self, revision: &mut Revision, provenance: &Provenance) {
        let sigmas_deg = self.sigmas_deg();
        let worst_deg = sigmas_deg.into_iter().fold(0.0, f64::max);
        revision.set(
            "camera.body_from_camera",
            rows(self.body_from_camera.matrix()),
            Some(worst_deg),
            provenance,
        );
        let mut table = Table::new();
        let sigmas: Array = sigmas_deg
            .iter()
            .map(|sigma| number(*sigma, *sigma))
            .collect();
        table["sigmas_deg"] = value(sigmas);
        let covariance = self.covariance_rad2.map(|c| c * 1_f64.to_degrees().powi(2));
        table["covariance_deg2"] = value(rows(&covariance));
        revision.note(provenance, table);
    }
}

impl fmt::Display for Turn {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            taken,
            observations,
            scatter_deg,
            ..
        } = self;
        write!(
            out,
            "{taken} of {observations} observations agree, scattering by {scatter_deg:.4} deg rms"
        )
    }
}
