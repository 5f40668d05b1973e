//! The marks: dark places that are as fourfold as a cross are found on the disc, the code in their spacings names them,
//! least squares on their pixels measures them.
//!
//! # Method (Cramer 2014, sections 4.3 and 4.4, with what its author wished for)
//! 1. The disc is flattened: its own limb darkening is divided out, so that a mark is a dark cross on an even
//!    ground and the limb leaves no edge ([`FlatDisc`]).
//! 2. Sums over boxes find dark spots whatever the camera's rotation; their arms tell the rotation to a quarter turn; a
//!    filter of the blurred cross at that rotation then gives position and contrast, and its fourfold part tells crosses
//!    from what is round ([`detect`]).
//! 3. Ids come from pairs of neighbours: one spacing is fixed, the other is the code. Every labelling that a pair
//!    allows is held against all marks in view, and one that is not clearly the best is refused.
//! 4. A fit of the blurred cross to the pixels about it gives a mark's place without the bias that a paraboloid has over the
//!    sub-pixel phase, with a covariance of its own ([`Refiner`]).

mod coverage;
mod darkening;
mod detect;
mod fit;
mod flatten;
mod identify;
mod kernel;
mod labelling;
mod least_squares;
mod patch;
mod prior;
mod refine;
mod spots;

pub use coverage::CrossShape;
pub use detect::{Detection, Detections, Lighting, detect};
pub use flatten::FlatDisc;
pub use identify::{Identification, identify};
pub use patch::Light;
pub use prior::IdentificationPrior;
pub use refine::{RefinedMark, Refiner};

/// What can be tuned in finding and identifying marks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// A mark's response must exceed this many sigma of the noise.
    pub detection_sigma: f64,
    /// A mark's least contrast, as a fraction of the light around it.
    pub min_contrast: f64,
    /// How much of the structure about a detection the cross must explain, 0 to 1.
    pub min_likeness: f64,
    /// Most detections that are read.
    pub max_detections: usize,
    /// Fewest marks that make a labelling.
    pub min_marks: usize,
    /// Largest distance of the plate's centre, as a labelling puts it on the sensor, from the instrument's value, px.
    pub max_centre_shift_px: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            detection_sigma: 6.0,
            min_contrast: 0.12,
            min_likeness: 0.15,
            max_detections: 24,
            min_marks: 3,
            max_centre_shift_px: 100.0,
        }
    }
}
