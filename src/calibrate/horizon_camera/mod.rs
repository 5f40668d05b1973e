//! The optics of a camera that sees the horizon, by its own frames: focal length, centre and the first terms of its distortion.
//!
//! The edge of the Earth's limb is a cone of rays whose half-angle the camera's height gives. A camera that is wrong bends it: where the limb
//! crosses the picture at many places, each of its own nadir, all of them are cones of one camera alone. The edge's height is known to a sigma
//! only, which all frames share, and is fitted with them.
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
