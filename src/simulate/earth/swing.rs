//! The Earth's limb in a camera of a swinging gondola.

use super::{Aim, EarthConditions, EarthScene};
use crate::instrument::MountedCamera;
use crate::simulate::gondola::Gondola;
use crate::units::Place;
use nalgebra::{Matrix3, Rotation3};
use std::time::Duration;

/// Azimuth of the body's first axis, from north over east.
const HEADING_DEG: f64 = 180.0;

/// A gondola that swings under its balloon.
#[derive(Debug, Clone)]
pub struct SwingingGondola {
    conditions: EarthConditions,
    latitude_deg: f64,
    body_from_camera: Rotation3<f64>,
    seed: u64,
}

impl SwingingGondola {
    /// A gondola with a camera, at a place, over a limb that varies by 2 % and 100 m.
    pub fn new(camera: &MountedCamera, place: &Place, seed: u64) -> Self {
        Self {
            conditions: EarthConditions {
                camera: camera.optics.lens,
                width_px: camera.optics.width_px,
                height_px: camera.optics.height_px,
                aim: Aim::Horizon { most_roll_deg: 0.0 },
                ..EarthConditions::clear(place.height_m).varying(0.02, 100.0)
            },
            latitude_deg: place.latitude_deg,
            body_from_camera: camera.body_from_camera,
            seed,
        }
    }

    /// The body's roll at a time after the start.
    pub fn roll_deg(&self, after: Duration) -> f64 {
        Gondola::Swinging.roll_deg(after)
    }

    /// The camera's picture at that time; `brightness` scales the standard one.
    pub fn scene(&self, number: u64, after: Duration, brightness: f64) -> EarthScene {
        let mut conditions = self.conditions.clone();
        conditions.air.brightness_dn *= brightness;
        // First along the body's first axis, then rotated to the camera.
        let forward = EarthScene {
            conditions,
            latitude_deg: self.latitude_deg,
            heading_deg: HEADING_DEG,
            roll_deg: self.roll_deg(after),
            pitch_deg: Gondola::Swinging.pitch_deg(after),
            seed: self.seed,
            number,
            weather: 0,
            camera: 0,
        };
        let body_from_forward =
            Rotation3::from_matrix_unchecked(Matrix3::new(0., 0., 1., 1., 0., 0., 0., 1., 0.));
        forward.seen_by(&(body_from_forward.inverse() * self.body_from_camera))
    }
}
