//! Where the Sun stands, and how its light fades across the terminator.

use super::EarthScene;
use crate::simulate::{Purpose, generator};
use nalgebra::{UnitVector3, Vector3};
use rand::RngExt;

/// Sunlight on a part of the Earth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sunlight {
    /// In north, east, down at the camera.
    pub towards: UnitVector3<f64>,
    /// Over so much of the Sun's sine of elevation its light fades.
    fades_over: f64,
}

impl Sunlight {
    /// Of a scene whose terminator is drawn: the Sun where the picture shows it, or anywhere around, at most a little higher than the limb
    /// reaches down. `None` of day everywhere.
    pub fn of(scene: &EarthScene) -> Option<Self> {
        const MOST_SINE: f64 = 0.6;
        const FADES_OVER: std::ops::Range<f64> = 0.05..0.4;
        if !scene.conditions.terminator {
            return None;
        }
        let mut random = generator(scene.seed, Purpose::Sunlight, scene.number);
        let azimuth = random.random_range(0.0..std::f64::consts::TAU);
        // Below the lower end all that is in view lies in the night.
        let lowest = -scene.edge_angle_rad().cos();
        let up: f64 = random.random_range(lowest..MOST_SINE);
        let level = (1.0 - up * up).sqrt();
        let drawn = Vector3::new(azimuth.cos() * level, azimuth.sin() * level, -up);
        let towards = match scene
            .sun_px()
            .and_then(|at| scene.conditions.camera.ray(at))
        {
            Some(ray) => scene.local_from_camera() * ray,
            None => UnitVector3::new_normalize(drawn),
        };
        Some(Self {
            towards,
            fades_over: random.random_range(FADES_OVER),
        })
    }

    /// The share of the Sun's light where its elevation has a sine.
    pub fn share(&self, sine: f64) -> f64 {
        let day = (0.5 + sine / self.fades_over).clamp(0.0, 1.0);
        day * day * (3.0 - 2.0 * day)
    }
}
