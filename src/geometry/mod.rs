//! Mappings between the sensor and the plate, and the lens's distortion. No fitting here: that is
//! [`registration`](crate::registration)'s work.

mod angle;
mod circle;
mod distortion;
mod ellipse;
mod mapping;

pub(crate) use angle::turns;
pub use circle::Circle;
pub use distortion::Distortion;
pub use ellipse::Ellipse;
pub(crate) use mapping::projection_jacobian;
pub use mapping::{Handedness, Mapping, MappingKind, SimilarityParameters};
