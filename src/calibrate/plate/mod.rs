//! The plate as it is: every mark's position, the lens's distortion and the camera's poses from many frames.

mod adjust;
mod camera;
mod choose;
mod consensus;
mod fit;
mod input;
mod measure;
mod robust;
mod sighting;

pub use choose::Choice;
pub use fit::{LENS_PRIOR_PX, MeasuredMark, PlateFit, PoseFit, Residual, Separation, fit};
pub use input::{InputError, Pose, poses};
pub use measure::{FileFacts, Sightings, measure};
pub use sighting::{FrameSightings, Sighting, Spoiled};
