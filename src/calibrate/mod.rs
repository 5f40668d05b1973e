//! The instrument as it is: from frames to a new instrument file. Each part measures some of its numbers, says what the
//! frames do not determine, and leaves the rest of the file as it was.
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
