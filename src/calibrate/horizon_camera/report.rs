//! The optics in words and in the camera's file.

use super::fit::Optics;
use super::from_frames::FromFrames;
use super::unknowns::Unknown;
use crate::calibrate::numbers::{sigma_text, value_text};
use crate::calibrate::revision::{Revision, number, rows};
use crate::geometry::camera::Lens;
use crate::units::Measured;
use toml_edit::{Array, Table, Value, value};

impl FromFrames {
    /// Writes the optics with their sigmas and covariance into the camera's file.
    pub fn revise(&self, revision: &mut Revision) {
        let Self {
            optics, provenance, ..
        } = self;
        let sigma = |unknown: Unknown| optics.changed(unknown).sigma;
        revision.set_pair(
            "camera.focal_px",
            optics.camera.focal_px(),
            optics.focal_sigma_px(),
            provenance,
        );
        let centre = optics.camera.principal_point();
        let of_centre = sigma(Unknown::CentreX).max(sigma(Unknown::CentreY));
        revision.set_pair(
            "camera.centre_px",
            [centre.x, centre.y],
            of_centre,
            provenance,
        );
        if let Lens::KannalaBrandt(k) = optics.camera.lens() {
            let k = Value::Array(k.into_iter().collect());
            revision.set(
                "camera.kannala_brandt",
                k,
                Some(sigma(Unknown::Cubic)),
                provenance,
            );
        }
        let mut table = Table::new();
        let unknowns: Array = Unknown::ALL.iter().map(|unknown| unknown.name()).collect();
        table["unknowns"] = value(unknowns);
        table["covariance"] = value(rows(&optics.covariance));
        table["residual_px"] = value(number(optics.residual_px, optics.residual_px));
        revision.note(provenance, table);
    }

    /// For people, without the rejected frames.
    pub fn lines(&self) -> Vec<String> {
        let optics = &self.optics;
        let Optics {
            frames,
            agreeing,
            points,
            residual_px,
            ..
        } = optics;
        let with_sigma = |what: &str, found: Measured, unit: &str| {
            format!(
                "{what}: {} +- {}{unit}",
                value_text(found),
                sigma_text(found.sigma)
            )
        };
        let centre = optics.camera.principal_point();
        let of = |value: f64, unknown: Unknown| Measured::new(value, optics.changed(unknown).sigma);
        let [fx, fy] = optics.camera.focal_px();
        let mut lines = vec![
            format!(
                "{frames} frames; {agreeing} of {points} points of the limb's edge agree, {residual_px:.3} px rms from it"
            ),
            with_sigma(
                "focal length in x",
                Measured::new(fx, optics.focal_sigma_px()),
                " px",
            ),
            with_sigma(
                "focal length in y",
                Measured::new(fy, optics.focal_sigma_px()),
                " px",
            ),
            with_sigma("centre in x", of(centre.x, Unknown::CentreX), " px"),
            with_sigma("centre in y", of(centre.y, Unknown::CentreY), " px"),
        ];
        if let Lens::KannalaBrandt(k) = optics.camera.lens() {
            lines.push(with_sigma("distortion k2", of(k[1], Unknown::Cubic), ""));
            lines.push(with_sigma("distortion k3", of(k[2], Unknown::Quintic), ""));
        }
        lines.push(with_sigma(
            "the limb's edge from the stated height",
            optics.changed(Unknown::Edge),
            " stated sigmas",
        ));
        if !optics.uncrossed.is_empty() {
            let parts = optics.uncrossed.join(", ");
            lines.push(format!(
                "hardly a frame has the limb in these parts of the picture: {parts}"
            ));
        }
        lines
    }
}

impl Optics {
    fn focal_sigma_px(&self) -> f64 {
        self.changed(Unknown::Focal).sigma * self.camera.focal_px()[0]
    }
}
