//! A circle, in any unit: on the sensor (px) or on the plate (mil).

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

/// A circle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Circle {
    pub centre: Vector2<f64>,
    pub radius: f64,
}

impl Circle {
    /// Distance of a point outside the circle; negative inside.
    pub fn excess(&self, point: Vector2<f64>) -> f64 {
        (point - self.centre).norm() - self.radius
    }

    /// The circle through three points; `None` if they lie on a line.
    pub fn through(a: Vector2<f64>, b: Vector2<f64>, c: Vector2<f64>) -> Option<Self> {
        let (ab, ac) = (b - a, c - a);
        let m = Matrix2::new(ab.x, ab.y, ac.x, ac.y) * 2.0;
        let from_a = m.try_inverse()? * Vector2::new(ab.norm_squared(), ac.norm_squared());
        from_a.iter().all(|v| v.is_finite()).then(|| Self {
            centre: a + from_a,
            radius: from_a.norm(),
        })
    }
}
