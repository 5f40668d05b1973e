//! One frame's nadir with its reference.

use crate::geometry::attitude::Direction;
use jiff::Timestamp;
use nalgebra::UnitVector3;
use std::path::PathBuf;

/// A frame of the horizon.
#[derive(Debug, Clone, PartialEq)]
pub struct Horizon {
    pub file: PathBuf,
    pub utc: Timestamp,
    /// The nadir in the camera's axes.
    pub nadir: Direction,
}

/// Knowledge of the nadir in the body's axes: forward, right, down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Known {
    Nadir(UnitVector3<f64>),
    /// The Sun in these axes, and its apparent elevation, with refraction.
    Sun {
        unit: UnitVector3<f64>,
        elevation_deg: f64,
    },
}

/// A frame of the horizon with its reference.
#[derive(Debug, Clone, PartialEq)]
pub struct HorizonObservation {
    pub horizon: Horizon,
    pub known: Known,
}
