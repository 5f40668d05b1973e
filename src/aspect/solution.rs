//! Solution of a frame: every stage's product as far as processing got, and why it went no further.

use super::Adopted;
use crate::fiducial::{Detections, Lighting};
use crate::frame::Levels;
use crate::geometry::{Circle, LocalSimilarity};
use crate::limb::LimbPoint;
use crate::plate::MarkId;
use crate::reasons;
use crate::registration::Registration;
use crate::units::{Estimate, Measured, PlateMil, SensorPx};
use nalgebra::Matrix2;
use serde::{Deserialize, Serialize};

/// Quality of a solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Quality {
    /// No Sun.
    None,
    /// Part of the disc, or a mapping borrowed from the prior or the calibration.
    Coarse,
    /// Disc and mapping from this frame.
    Fine,
}

impl Quality {
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Coarse => "coarse",
            Self::Fine => "fine",
        }
    }
}

/// The stages of the pipeline, in order, and the stage that follows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Stage {
    Levels,
    Limb,
    Marks,
    Identification,
    Registration,
    Aspect,
    /// From the plate to the sky.
    Pointing,
}

impl Stage {
    pub const ALL: [Self; 7] = [
        Self::Levels,
        Self::Limb,
        Self::Marks,
        Self::Identification,
        Self::Registration,
        Self::Aspect,
        Self::Pointing,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Levels => "levels",
            Self::Limb => "limb",
            Self::Marks => "marks",
            Self::Identification => "identification",
            Self::Registration => "registration",
            Self::Aspect => "aspect",
            Self::Pointing => "pointing",
        }
    }
}

impl reasons::Stage for Stage {
    fn name(self) -> &'static str {
        Self::name(self)
    }
}

/// Why processing of a frame stopped.
pub type Stopped = reasons::Stopped<Stage>;

/// A mark of the plate with its id.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Mark {
    pub id: MarkId,
    pub at: SensorPx,
    pub covariance_px2: Matrix2<f64>,
    pub lighting: Lighting,
}

impl Mark {
    /// 1 sigma per axis, the mean of both.
    pub fn sigma_px(&self) -> f64 {
        (self.covariance_px2.trace() / 2.0).max(0.0).sqrt()
    }
}

/// Position of the Sun.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Aspect {
    /// The image of the disc's centre on the sensor.
    pub sun_px: Estimate<SensorPx>,
    /// The disc's radius at the mapping's scale there. If little of the limb is visible, its value and sigma are nearly
    /// those of ephemeris, focus and stated scale.
    pub sun_radius_px: Measured,
    /// The mapping's scale and rotation there. Those of a borrowed mapping have the sigma of the frame that gave it, or
    /// that of the calibration for the plate's centre, without the effect of a tilt of the camera.
    pub mapping: LocalSimilarity,
    /// The disc's centre on the plate, with the mapping's uncertainty included.
    pub sun_plate: Estimate<PlateMil>,
    /// Visible fraction of the limb, 0 to 1.
    pub limb_fraction: f64,
}

/// Tracking prior from one frame for the next.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Track {
    pub disc: Circle,
    /// Frames in succession whose marks were measured where the prior predicted them, without detection.
    pub predicted: u32,
    /// The last registration from a frame's own marks.
    pub registration: Option<Registration>,
}

/// Solution of a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Solution {
    pub quality: Quality,
    pub stopped: Option<Stopped>,
    pub levels: Option<Levels>,
    /// Points of the limb that the disc was fitted to.
    pub limb: Vec<LimbPoint>,
    /// Blur of the limb, 1 sigma, with the pixel response subtracted in quadrature.
    pub limb_blur_px: Option<f64>,
    /// The detected marks; none if a prior predicted them.
    pub detections: Detections,
    pub marks: Vec<Mark>,
    pub mapping: Option<Adopted>,
    pub aspect: Option<Aspect>,
    /// The prior for the next frame.
    pub track: Option<Track>,
}

impl Solution {
    pub fn none() -> Self {
        Self {
            quality: Quality::None,
            stopped: None,
            levels: None,
            limb: Vec::new(),
            limb_blur_px: None,
            detections: Detections::default(),
            marks: Vec::new(),
            mapping: None,
            aspect: None,
            track: None,
        }
    }
}
