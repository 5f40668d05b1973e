//! What the frames saw: positions of named marks, by frame and pose.

use crate::geometry::Mapping;
use crate::plate::MarkId;
use crate::units::{PlateMil, SensorPx};
use jiff::Timestamp;
use nalgebra::Matrix2;
use std::path::PathBuf;

/// A mark seen in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    pub id: MarkId,
    pub at: SensorPx,
    pub covariance_px2: Matrix2<f64>,
}

/// The marks seen in a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameSightings {
    pub file: PathBuf,
    /// Which of the poses the frame belongs to; which of the folders, until poses are told apart.
    pub pose: usize,
    pub utc: Option<Timestamp>,
    /// The frame's own mapping, from its own marks.
    pub mapping: Mapping,
    /// Where the Sun stood on the plate; none in a frame of the lit plate.
    pub sun: Option<PlateMil>,
    pub sightings: Vec<Sighting>,
}

/// A frame that was not used, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct Spoiled {
    pub file: PathBuf,
    pub reason: String,
}
