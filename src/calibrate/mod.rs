//! Calibration of the instrument: from frames to a new instrument file. Each module measures some of its values, reports which the frames
//! do not determine, and leaves the rest of the file unchanged.
//!
//! ```text
//! parts, numbers <- revision <- quantity, frames <- camera, mounting, plate; compare; mounting <- roll_camera <- horizon_camera; revision <- navigation
//! ```

pub mod camera;
pub mod check;
pub mod compare;
pub mod frames;
pub mod horizon_camera;
pub mod mounting;
pub mod navigation;
pub mod numbers;
pub mod parts;
pub mod plate;
pub mod quantity;
pub mod revision;
pub mod roll_camera;
