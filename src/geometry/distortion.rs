//! Radial and decentring distortion of the camera lens (Brown 1966, "Decentering Distortion of Lenses").
//!
//! With d the position relative to the distortion's centre on the ideal (undistorted) sensor and r = |d|, the distorted position
//! is `d (1 + k1 r^2 + k2 r^4) + (2 p1 dx dy + p2 (r^2 + 2 dx^2), p1 (r^2 + 2 dy^2) + 2 p2 dx dy)`.

use crate::units::SensorPx;
use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

/// Distortion of the lens, as a displacement of positions on the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Distortion {
    /// The point that does not move.
    pub centre: SensorPx,
    /// Radial terms: per px^2, per px^4.
    pub radial: [f64; 2],
    /// Decentring terms, per px.
    pub decentring: [f64; 2],
}

impl Distortion {
    /// A lens without distortion.
    pub const NONE: Self = Self {
        centre: SensorPx::new(0.0, 0.0),
        radial: [0.0; 2],
        decentring: [0.0; 2],
    };

    fn is_none(&self) -> bool {
        self.radial == [0.0; 2] && self.decentring == [0.0; 2]
    }

    /// The distorted position of an ideal one.
    pub fn distort(&self, ideal: SensorPx) -> SensorPx {
        if self.is_none() {
            return ideal;
        }
        let d = ideal.vector() - self.centre.vector();
        let ([k1, k2], [p1, p2]) = (self.radial, self.decentring);
        let r2 = d.norm_squared();
        let decentring = Vector2::new(
            2.0 * p1 * d.x * d.y + p2 * (r2 + 2.0 * d.x * d.x),
            p1 * (r2 + 2.0 * d.y * d.y) + 2.0 * p2 * d.x * d.y,
        );
        (self.centre.vector() + d * (1.0 + k1 * r2 + k2 * r2 * r2) + decentring).into()
    }

    /// The ideal position of a distorted one: the inverse of [`distort`](Self::distort), by Newton's method, which converges in two or
    /// three steps for the distortion of a real lens.
    pub fn correct(&self, seen: SensorPx) -> SensorPx {
        if self.is_none() {
            return seen;
        }
        let mut ideal = seen.vector();
        for _ in 0..8 {
            let excess = self.distort(ideal.into()).vector() - seen.vector();
            let Some(inverse) = self.derivative(ideal.into()).try_inverse() else {
                break;
            };
            let step = inverse * excess;
            ideal -= step;
            if step.norm() < 1e-10 {
                break;
            }
        }
        ideal.into()
    }

    /// Derivative of [`distort`](Self::distort) at an ideal position.
    pub fn derivative(&self, ideal: SensorPx) -> Matrix2<f64> {
        if self.is_none() {
            return Matrix2::identity();
        }
        let d = ideal.vector() - self.centre.vector();
        let ([k1, k2], [p1, p2]) = (self.radial, self.decentring);
        let r2 = d.norm_squared();
        let radial = Matrix2::identity() * (1.0 + k1 * r2 + k2 * r2 * r2)
            + d * d.transpose() * (2.0 * k1 + 4.0 * k2 * r2);
        let decentring = Matrix2::new(
            2.0 * p1 * d.y + 6.0 * p2 * d.x,
            2.0 * p1 * d.x + 2.0 * p2 * d.y,
            2.0 * p1 * d.x + 2.0 * p2 * d.y,
            6.0 * p1 * d.y + 2.0 * p2 * d.x,
        );
        radial + decentring
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn correcting_undoes_distorting_everywhere_on_the_sensor() {
        let lens = Distortion {
            centre: SensorPx::new(640.0, 480.0),
            radial: [4.6e-9, 1e-15],
            decentring: [2e-7, -1e-7],
        };
        for (x, y) in [(0.0, 0.0), (1295.0, 965.0), (640.0, 480.0), (100.0, 900.0)] {
            let ideal = SensorPx::new(x, y);
            assert!(lens.correct(lens.distort(ideal)).distance(ideal) < 1e-9);
        }
    }
}
