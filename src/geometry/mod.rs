//! Mappings between the sensor and the plate, and the lens's distortion. No fitting here: that is
//! [`registration`](crate::registration)'s work.

mod circle;
mod distortion;
mod ellipse;
mod mapping;

pub use circle::Circle;
pub use distortion::Distortion;
pub use ellipse::Ellipse;
pub use mapping::{Handedness, Mapping, MappingKind, SimilarityParameters};
pub(crate) use mapping::{project, projection_jacobian};
