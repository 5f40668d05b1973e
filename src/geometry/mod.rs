//! Mappings between the sensor and the plate, and the lens's distortion. No fitting here: that is
//! [`registration`](crate::registration)'s work.

mod distortion;
mod mapping;

pub use distortion::Distortion;
pub use mapping::{Handedness, Mapping, MappingKind, SimilarityParameters};
