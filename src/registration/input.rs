//! What is registered, and how the mapping is chosen.

use crate::geometry::Ellipse;
use crate::units::{Measured, PlateMil, SensorPx};
use nalgebra::Matrix2;

/// One point, seen on the sensor and printed on the plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    pub seen: SensorPx,
    pub printed: PlateMil,
    /// Covariance of the seen position, px^2.
    pub covariance_px2: Matrix2<f64>,
}

/// Points of the sensor that lie on one circle of the plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outline<'a> {
    /// An ellipse close to it.
    pub ellipse: Ellipse,
    /// Points, and 1 sigma across the outline, px.
    pub points: &'a [(SensorPx, f64)],
    /// Prior of the circle's radius.
    pub radius_mil: Measured,
}

/// How a mapping is chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Least gain in chi^2, per added parameter.
    pub min_gain: f64,
    /// Weight of the stated sigmas against the residuals, in degrees of freedom.
    pub prior_freedom: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            min_gain: 9.0,
            prior_freedom: 6.0,
        }
    }
}
