//! The plane in which the Moon's disc is a circle: the picture's, with its columns rescaled.

use crate::frame::{Frame, Region};
use crate::geometry::Circle;
use crate::geometry::camera::CameraModel;
use crate::units::{Estimate, SensorPx};
use nalgebra::{Matrix2, Matrix3x2, Vector2, Vector3};
use std::ops::Range;

/// Maps the picture's px to round px, in which the disc's radius is its vertical half axis in the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Plane {
    from_sensor: Matrix2<f64>,
    to_sensor: Matrix2<f64>,
    /// Round px per rad.
    pub px_per_rad: Option<f64>,
}

impl Plane {
    /// For pixels whose height is `aspect` times their width.
    pub fn of_aspect(aspect: f64) -> Self {
        Self {
            from_sensor: Matrix2::new(1.0 / aspect, 0.0, 0.0, 1.0),
            to_sensor: Matrix2::new(aspect, 0.0, 0.0, 1.0),
            px_per_rad: None,
        }
    }

    /// For a camera near a pixel; `None` if the pixel is beyond the limit of its lens.
    pub fn of_camera(camera: &CameraModel, at: SensorPx) -> Option<Self> {
        let ray = camera.ray(at)?;
        let down = (Vector3::y() - ray.into_inner() * ray.y).try_normalize(1e-6)?;
        let right = down.cross(&ray);
        let px_by_rad = camera.pixel_jacobian(&ray)? * Matrix3x2::from_columns(&[right, down]);
        let px_per_rad = px_by_rad.row(1).norm();
        let to_sensor = px_by_rad / px_per_rad;
        Some(Self {
            from_sensor: to_sensor.try_inverse()?,
            to_sensor,
            px_per_rad: Some(px_per_rad),
        })
    }

    pub fn round(&self, x: f64, y: f64) -> Vector2<f64> {
        self.from_sensor * Vector2::new(x, y)
    }

    pub fn sensor(&self, round: Vector2<f64>) -> SensorPx {
        (self.to_sensor * round).into()
    }

    pub fn estimate(&self, round: Vector2<f64>, covariance: Matrix2<f64>) -> Estimate<SensorPx> {
        Estimate {
            position: self.sensor(round),
            covariance: self.to_sensor * covariance * self.to_sensor.transpose(),
        }
    }

    /// Horizontal half axis of the disc over the vertical one.
    pub fn aspect(&self) -> f64 {
        self.to_sensor.row(0).norm()
    }

    /// Area in the picture per unit of area.
    pub fn sensor_area(&self) -> f64 {
        self.to_sensor.determinant().abs()
    }

    /// The corresponding direction in the picture, from +x towards +y.
    pub fn sensor_angle_rad(&self, round_rad: f64) -> f64 {
        let (sin, cos) = round_rad.sin_cos();
        let along = self.to_sensor * Vector2::new(cos, sin);
        along.y.atan2(along.x)
    }

    pub fn round_angle_rad(&self, sensor_rad: f64) -> f64 {
        let (sin, cos) = sensor_rad.sin_cos();
        let along = self.from_sensor * Vector2::new(cos, sin);
        along.y.atan2(along.x)
    }

    /// Visits every pixel, or every `step`-th along both axes, in a range of depths behind a circle: its position in round
    /// px, and its DN.
    pub fn each_near(
        &self,
        frame: &Frame,
        circle: &Circle,
        depths: &Range<f64>,
        step: usize,
        mut take: impl FnMut(Vector2<f64>, f32),
    ) {
        let outer = circle.radius - depths.start;
        let inner = (circle.radius - depths.end).max(0.0);
        let Some(region) = self.region(circle, outer, frame) else {
            return;
        };
        for y in (region.y0..region.y1).step_by(step) {
            let row = frame.row_dn(y, region.x0..region.x1);
            for (x, dn) in (region.x0..region.x1).zip(row).step_by(step) {
                let at = self.round(x as f64, y as f64);
                let square = (at - circle.centre).norm_squared();
                if (inner * inner..outer * outer).contains(&square) {
                    take(at, dn);
                }
            }
        }
    }

    /// The frame's part within a distance from a circle's centre.
    fn region(&self, circle: &Circle, reach: f64, frame: &Frame) -> Option<Region> {
        let longest = self
            .to_sensor
            .row(0)
            .norm()
            .max(self.to_sensor.row(1).norm());
        frame.around(self.sensor(circle.centre), reach * longest + 1.0)
    }
}
