//! Mappings between the sensor and the plate, the lens's distortion, cameras that measure directions, attitudes, and the Earth. Fitting
//! is in [`registration`](crate::registration).

mod angle;
pub mod attitude;
pub mod camera;
mod circle;
mod distortion;
pub mod earth;
mod ellipse;
mod mapping;
pub mod view;

pub(crate) use angle::{turns, unit};
pub use circle::Circle;
pub use distortion::Distortion;
pub use ellipse::Ellipse;
pub use mapping::{Handedness, Mapping, MappingKind, SimilarityParameters};
pub use view::{LocalSimilarity, TILT_PER_PX};
