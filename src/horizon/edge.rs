//! Points of the edge in a picture, and their rays.

use crate::geometry::camera::CameraModel;
use crate::units::SensorPx;
use nalgebra::{Rotation3, UnitVector3, Vector2, Vector3};

/// A point of the edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgePoint {
    pub at: SensorPx,
    /// Unit vector in the image across the edge, towards the sphere.
    pub inward: Vector2<f64>,
    /// 1 sigma across the edge, from the camera's noise alone, px.
    pub sigma_px: f64,
    /// Shift of the edge by its brightness, common to all points of the same brightness: 1 sigma, px.
    pub of_brightness_px: f64,
}

/// The edge in one picture. Successive rays are neighbours.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EdgeRays {
    pub rays: Vec<EdgeRay>,
    /// 1 sigma of the edge's position in a picture's light, common to neighbours.
    pub sigma_rad: f64,
}

impl EdgeRays {
    /// Excludes the points beyond the limit of the lens. `sigma_rad` is the error common to all edges of the picture.
    pub fn of(points: &[EdgePoint], camera: &CameraModel, sigma_rad: f64) -> Self {
        let rays = points.iter();
        Self {
            rays: rays
                .filter_map(|point| EdgeRay::of(point, camera))
                .collect(),
            sigma_rad,
        }
    }

    /// The same edge in a rotated frame.
    pub fn turned(&self, rotation: &Rotation3<f64>) -> Self {
        let turned = |ray: &EdgeRay| EdgeRay {
            unit: rotation * ray.unit,
            inward: rotation * ray.inward,
            ..*ray
        };
        Self {
            rays: self.rays.iter().map(turned).collect(),
            sigma_rad: self.sigma_rad,
        }
    }
}

/// A ray to the edge, in the frame of the camera or of the vehicle's body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeRay {
    pub at: SensorPx,
    pub unit: UnitVector3<f64>,
    /// Unit vector across the ray, towards the sphere.
    pub inward: Vector3<f64>,
    /// 1 sigma of the ray across the edge, from the camera's noise alone.
    pub sigma_rad: f64,
    /// Shift of the ray by the brightness, common to all rays of the same brightness: 1 sigma.
    pub of_brightness_rad: f64,
    /// Change of the edge's position in the last iteration.
    pub unsettled_rad: f64,
}

impl EdgeRay {
    /// `None` beyond the limit of the lens.
    pub fn of(point: &EdgePoint, camera: &CameraModel) -> Option<Self> {
        let unit = camera.ray(point.at)?;
        let across = camera.ray_jacobian(point.at)? * point.inward;
        Some(Self {
            at: point.at,
            unit,
            inward: across.try_normalize(0.0)?,
            sigma_rad: across.norm() * point.sigma_px,
            of_brightness_rad: across.norm() * point.of_brightness_px,
            unsettled_rad: 0.0,
        })
    }

    /// The angle from a nadir, rad, and its derivative by the nadir.
    pub fn angle_from(&self, nadir: &UnitVector3<f64>) -> (f64, Vector3<f64>) {
        let cosine = self.unit.dot(nadir);
        let across = nadir.cross(&self.unit).norm();
        (across.atan2(cosine), -self.unit.into_inner() / across)
    }
}
