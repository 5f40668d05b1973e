//! The plate's fiducial marks: dark crosses or dots are detected on the disc, identified by their relative positions, and
//! measured by least squares on their pixels.
//!
//! # Method (Cramer 2014, sections 4.3 and 4.4, with the improvements its author lists)
//! 1. The disc is flattened: its own brightness is divided out, so that a mark is dark on a uniform background and the limb
//!    leaves no edge ([`FlatDisc`]).
//! 2. Sums over boxes give candidates at any rotation of the camera; the arms there determine the rotation to a quarter
//!    turn; a matched filter of the blurred cross at that rotation gives position and contrast, and its fourfold part
//!    separates crosses from round features. Dots, and crosses too small to resolve their arms, are found by a round filter
//!    ([`detect`]).
//! 3. Ids come from the relative positions of the marks. Every labelling near the stated plate centre is scored by all
//!    marks in view, and one that is not clearly the best is rejected ([`identify()`]).
//! 4. A fit of the blurred mark to the pixels around it gives the mark's position without a paraboloid's bias over the
//!    sub-pixel phase, with its own covariance: [`Refiner::refine`] extracts the pixels (`patch`) and iterates Gauss-Newton
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
    /// Detection threshold of a mark's response, in sigma of the noise.
    pub detection_sigma: f64,
    /// Minimum contrast of a mark, as a fraction of the light around it.
    pub min_contrast: f64,
    /// Minimum fraction of the structure around a detection that the cross explains, 0 to 1.
    pub min_likeness: f64,
    /// Maximum number of detections that are identified.
    pub max_detections: usize,
    /// Minimum number of marks of a labelling.
    pub min_marks: usize,
    /// Largest distance of the plate's centre on the sensor, by a labelling, from the instrument's value, px.
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
