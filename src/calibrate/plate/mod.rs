//! Measures the plate as printed: every mark's position, the lens's distortion and the camera's poses, from many frames with the Sun all
//! over the plate.
//!
//! # Method
//! Within a pose, camera and plate are one rigid body, so all frames of a pose share one mapping, which may drift slowly; if the camera
//! slips, another pose begins. One robust bundle adjustment estimates the marks' displacements, the lens (as many radial and decentring
//! terms as the data support) and the mapping of every pose (shift, rotation and one scale; keystone if the data require it). The
//! shift, rotation and scale common to the measured marks are no property of the plate and are fixed at zero.
//!
//! Priors: marks lie within the stated sigma of their position in the start's file, which is the drawn one if they were
//! not measured; each term of the lens moves the sensor's corner by less than [`LENS_PRIOR_PX`]. If the frames separate the plate's errors
//! from the lens's distortion (the camera was moved between poses) the priors do not matter; otherwise they divide the errors between the
//! two, and [`Separation`] reports it.
//!
//! ```text
//! used_frames <- calibration; observation <- refusal, lit <- measure <- poses <- calibration, suspects <- summary, write <- report
//! camera <- adjust <- robust <- choose, correlations <- fit <- rest <- poses; adjust, motion <- slips <- poses; motion <- rest
//! ```

mod adjust;
mod calibration;
mod camera;
mod choose;
mod correlations;
mod fit;
mod lit;
mod measure;
mod motion;
mod observation;
mod poses;
mod refusal;
mod report;
mod rest;
mod robust;
mod slips;
mod summary;
mod suspects;
mod used_frames;
mod write;

pub use calibration::{Calibration, StartFrom, calibrate, fit_frames};
pub use choose::{Choice, Separation};
pub use correlations::{Correlation, Parameter};
pub use fit::{LENS_PRIOR_PX, MeasuredMark, PlateFit, PoseFit, Residual};
pub use observation::{FrameObservation, MarkObservation, Pose};
pub use poses::Posed;
pub use refusal::{MissingCoverage, Refusal};
pub use report::html;
pub use summary::summary;
pub use suspects::SuspectMark;
pub use used_frames::UsedFrames;
