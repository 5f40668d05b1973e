//! The optics of a camera that sees the horizon, from its own frames: focal length, centre and the first terms of its distortion.
//!
//! The edge of the Earth's limb is a cone of rays whose half-angle follows from the camera's height. Errors of the camera's optics distort it:
//! if limbs with different nadirs cross many parts of the picture, only one camera makes all of them cones. The edge's height is only known to
//! a sigma, which all frames share, and is fitted with them.
//!
//! ```text
//! edges, unknowns <- fit <- from_frames <- report
//! ```

mod edges;
mod fit;
mod from_frames;
mod report;
mod unknowns;

pub use edges::Limb;
pub use fit::{Optics, OpticsError, fit};
pub use from_frames::{FromFrames, NAME, from_frames};
pub use unknowns::{UNKNOWNS, Unknown};
