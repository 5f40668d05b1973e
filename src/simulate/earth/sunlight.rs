//! Direction of the Sun, and the decrease of its light across the terminator.

use super::EarthScene;
use crate::simulate::{Purpose, generator};
use nalgebra::{UnitVector3, Vector3};
use rand::RngExt;

/// Sunlight on a part of the Earth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sunlight {
    /// Direction to the Sun in north, east, down at the camera.
    pub towards: UnitVector3<f64>,
    /// Range of the sine of the Sun's elevation over which its light decreases.
    fades_over: f64,
}

impl Sunlight {
    /// The sunlight of a scene with a terminator: from the Sun's place in the picture, or from a random direction, at the lowest so that
    /// everything in view is just dark. `None` if the whole Earth is in daylight.
    pub fn of(scene: &EarthScene) -> Option<Self> {
        const MOST_SINE: f64 = 0.6;
        const FADES_OVER: std::ops::Range<f64> = 0.05..0.4;
        if !scene.conditions.terminator {
            return None;
        }
        let mut random = generator(scene.seed, Purpose::Sunlight, scene.number);
        let azimuth = random.random_range(0.0..std::f64::consts::TAU);
        // Below the lower end everything in view is dark.
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

    /// The fraction of the Sun's light at a sine of its elevation.
    pub fn share(&self, sine: f64) -> f64 {
        let day = (0.5 + sine / self.fades_over).clamp(0.0, 1.0);
        day * day * (3.0 - 2.0 * day)
    }
}
