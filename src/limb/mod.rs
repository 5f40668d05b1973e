//! The edge of the disc: detection of the disc, and its outline as precise as the pixel noise allows.
//!
//! # Method
//! Rows and columns of the sensor serve as chords, as RHESSI's linear CCDs did (Cramer 2014, section 4.2): sparse rows over
//! the frame find bright patches, and chords across each patch find the disc, whole or cut by the sensor's edge. The
//! outline then uses the whole limb: at every azimuth the blurred, limb-darkened edge is fitted to the pixels near it, and
//! an ellipse to the resulting points, because the round image of the Sun on the plate is an ellipse on the sensor. Pixels
//! masked by marks are excluded once the marks are known.
//!
//! # Failure
//! Fewer than [`LimbSettings::min_crossings`] crossings on a circle of the expected size are rejected, and so are fewer
//! than [`LimbSettings::min_limb_points`] points on an outline.

mod background;
mod band;
mod chords;
mod circle;
mod edge;
mod fit;
mod levels;
mod light;
mod outline;
mod profile;
mod search;
mod shape;

pub use background::background;
pub use edge::LimbPoint;
pub use fit::{KnownOutline, Limb, LimbFit};
pub use levels::levels;
pub use light::{DiscLight, motion_variance_px2};
pub use outline::{OutlineFit, OutlinePrior, arc_fraction, fit_outline};
pub use profile::{Brightness, Profile};
pub use search::DiscSearch;
pub use shape::COMA_BLURS;

/// Linear limb darkening at 630 nm (Neckel and Labs 1994): brightness falls as 1 - u (1 - cos theta) towards the limb.
const LIMB_DARKENING: f64 = 0.56;

/// Tunable settings of the limb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LimbSettings {
    /// Threshold of the limb as a fraction of the height from background to disc. Lower values avoid marks, higher ones
    /// avoid noise. With a limb darkening of 0.56 and a blur of 0.95 px the disc's true edge is at 0.26.
    pub level_fraction: f64,
    /// Number of points round the limb at which the edge is measured.
    pub limb_points: usize,
    /// Spacing of the rows that are searched for bright patches, px.
    pub search_spacing_px: usize,
    /// Bright runs shorter than this are hot pixels and noise, px.
    pub min_run_px: usize,
    /// The disc must outshine the background by this many sigma of the noise.
    pub min_contrast_sigma: f64,
    /// Minimum number of crossings of a disc.
    pub min_crossings: usize,
    /// Minimum number of points of a limb.
    pub min_limb_points: usize,
    /// Largest relative deviation of the disc's radius from the expected one.
    pub max_radius_deviation: f64,
}

impl Default for LimbSettings {
    fn default() -> Self {
        Self {
            level_fraction: 0.26,
            limb_points: 96,
            search_spacing_px: 8,
            min_run_px: 4,
            min_contrast_sigma: 6.0,
            min_crossings: 8,
            min_limb_points: 10,
            max_radius_deviation: 0.12,
        }
    }
}
