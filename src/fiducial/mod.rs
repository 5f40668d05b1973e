//! The plate's fiducial marks: dark crosses or dots are found on the disc, their places beside each other identify them, and
//! least squares on their pixels measures them.
//!
//! # Method (Cramer 2014, sections 4.3 and 4.4, with the improvements its author lists)
//! 1. The disc is flattened: its own light is divided out, so that a mark is dark on even ground and the limb
//!    leaves no edge ([`FlatDisc`]).
//! 2. Sums over boxes give candidates whatever the camera's rotation; the arms there show the rotation to a quarter turn; a
//!    matched filter of the blurred cross at that rotation gives position and contrast, and its fourfold part separates crosses
//!    from what is round. Dots, and crosses too small to show their arms, are found by a round filter ([`detect`]).
//! 3. Ids come from the places of marks beside each other. Every labelling near the stated plate centre is scored by all
//!    marks in view, and one that is not clearly the best is refused ([`identify()`]).
//! 4. A fit of the blurred mark to the pixels about it gives a mark's place without the bias that a paraboloid has over the
//!    sub-pixel phase, with a covariance of its own: [`Refiner::refine`] cuts the pixels out (`patch`) and takes Gauss-Newton
//!    steps on them (`mark_fit`).

mod blurred_dot;
mod candidates;
mod detect;
mod flatten;
mod identify;
mod labelling;
mod lighting;
mod mark_fit;
mod mark_image;
mod patch;
mod prior;
mod refine;
mod similarity;
mod template;

pub use crate::kernels::limb::Lit;
pub use detect::{Detection, Detections, detect};
pub use flatten::FlatDisc;
pub(crate) use identify::likeliest;
pub use identify::{Identified, Unread, identify, identify_with_margin};
pub use lighting::Lighting;
pub use mark_image::{MarkForm, MarkImage};
pub use patch::Illumination;
pub use prior::IdentificationPrior;
pub use refine::{RefinedMark, Refiner};

/// Statistics of detections, for the evidence of [`identify()`].
pub(crate) mod shares {
    pub(crate) use super::prior::{
        ATYPICAL_SHARE, CONTRAST_RANGE, CONTRAST_SCATTER, CUT_FOUND_SHARE, FALSE_ON_DISC,
        LEAST_CONTRAST, MARK_LIKE_SHARE,
    };
}

/// Tunable settings for finding and identifying marks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FiducialSettings {
    /// A mark's response must exceed this many sigma of the noise.
    pub detection_sigma: f64,
    /// A mark's least contrast, as a fraction of the light around it.
    pub min_contrast: f64,
    /// How much of the structure about a detection the cross must explain, 0 to 1.
    pub min_likeness: f64,
    /// Most detections that are identified.
    pub max_detections: usize,
    /// Fewest marks that make a labelling.
    pub min_marks: usize,
    /// Largest distance of the plate's centre, as a labelling puts it on the sensor, from the instrument's value, px.
    pub max_centre_shift_px: f64,
}

impl Default for FiducialSettings {
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
