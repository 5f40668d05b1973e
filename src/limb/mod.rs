//! The edge of the disc: brightness levels, chords across the frame, sub-pixel crossings of the limb, and the
//! circle through them.
//!
//! # Method
//! Rows and columns of the sensor serve as chords, as RHESSI's linear CCDs did (Cramer 2014, section 4.2). Sparse
//! rows over the whole frame tell where it is bright; chords across each bright patch find the disc, whole or cut by
//! the sensor's edge; a dense set across the disc gives the crossings that are refined by a local straight line. The circle is fitted to the crossings on the plate, where the Sun's image
//! is round whatever the camera's tilt.
//!
//! # When it fails
//! Marks across the limb pull a crossing inwards by pixels: the fit is robust, and crossings near a mark are left
//! out once the marks are known. Fewer than [`Settings::min_crossings`] crossings on a circle of the expected size
//! are refused.

mod bright;
mod chords;
mod consensus;
mod disc;
mod levels;
mod patches;
mod search;

pub use chords::{Axis, Chords, Crossing, Edge, Scan};
pub use disc::{DiscFit, arc_fraction, fit_disc};
pub use levels::levels;
pub use search::{CoarseDisc, find_disc, fine_chords};

/// What can be tuned in finding the limb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Height of the limb's threshold between background and disc. Lower values stay clear of marks, higher ones
    /// of the noise. With a limb darkening of 0.56 and a blur of 0.95 px the disc's true edge stands at 0.26.
    pub level_fraction: f64,
    /// Rows and columns of the dense set, each. More of them lower the noise with the square root.
    pub chords_per_axis: usize,
    /// Distance between the rows that look for bright patches, px.
    pub search_spacing_px: usize,
    /// Bright runs shorter than this are hot pixels and noise, px.
    pub min_run_px: usize,
    /// The disc must outshine the background by this many sigma of the noise.
    pub min_contrast_sigma: f64,
    /// Fewest crossings that make a disc.
    pub min_crossings: usize,
    /// Largest relative deviation of the disc's radius from the expected one.
    pub max_radius_deviation: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            level_fraction: 0.26,
            chords_per_axis: 64,
            search_spacing_px: 8,
            min_run_px: 4,
            min_contrast_sigma: 6.0,
            min_crossings: 8,
            max_radius_deviation: 0.12,
        }
    }
}
