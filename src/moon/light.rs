//! Sky and noise of a frame.

use crate::estimation::{QUARTILE_SIGMAS, SIGMA_PER_MEDIAN, median};
use crate::frame::{Frame, Region};
use crate::reasons::moon as reasons;
use crate::units::Rejected;
use std::f64::consts::SQRT_2;

/// One pixel in so many, in each axis, tells the sky.
const RASTER_PX: usize = 24;
/// What is brighter than the sky by so many sigmas of a pixel's noise is of a light.
const BRIGHT_SIGMAS: f64 = 4.0;
/// A frame whose sky is brighter than this share of the saturated level is lost in glare.
const MOST_SKY: f64 = 0.7;
/// Steps of one DN hide less than that.
const LEAST_NOISE_DN: f64 = 0.5;

/// The brightest pixels of a light: a crescent has so many.
const BRIGHTEST: usize = 20;

/// What the brightest pixels of a region exceed, DN: what an exposure may follow. `None` of a region of fewer pixels.
pub fn bright_dn(frame: &Frame, region: Region) -> Option<f64> {
    let rows = (region.y0..region.y1).flat_map(|y| frame.row_dn(y, region.x0..region.x1));
    let mut light: Vec<f32> = rows.collect();
    if light.len() <= BRIGHTEST {
        return None;
    }
    let (_, bright, _) = light.select_nth_unstable_by(BRIGHTEST, |a, b| b.total_cmp(a));
    Some(f64::from(*bright))
}

/// Levels of a frame, DN.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Levels {
    pub dark_dn: f64,
    /// Of a pixel, 1 sigma.
    pub noise_dn: f64,
    /// Pixels of this and more tell nothing.
    pub saturated_dn: f64,
}

impl Levels {
    /// The levels by a raster of pixels.
    ///
    /// # Errors
    /// A frame that is bright all over.
    pub fn of(frame: &Frame) -> Result<Self, Rejected> {
        let saturated_dn = f64::from(frame.saturation_dn());
        let rows = (RASTER_PX / 2..frame.height()).step_by(RASTER_PX);
        let columns = || (RASTER_PX / 2..frame.width() - 1).step_by(RASTER_PX);
        let pixel = |x: usize, y: usize| f64::from(frame.dn(x, y));
        let places = rows.flat_map(|y| columns().map(move |x| (x, y)));
        let (mut pixels, steps): (Vec<f64>, Vec<f64>) = places
            .map(|(x, y)| (pixel(x, y), (pixel(x + 1, y) - pixel(x, y)).abs()))
            .unzip();
        let step = median(&steps).unwrap_or(0.0);
        let noise_dn = (step * SIGMA_PER_MEDIAN / SQRT_2).max(LEAST_NOISE_DN);
        let dark_dn = match pixels.len() / 4 {
            0 => saturated_dn,
            // A large Moon leaves less than half of the picture to the sky.
            quarter => {
                *pixels.select_nth_unstable_by(quarter, f64::total_cmp).1
                    + QUARTILE_SIGMAS * noise_dn
            }
        };
        Rejected::at_most(MOST_SKY * saturated_dn, dark_dn, reasons::TOO_BRIGHT)?;
        Ok(Self {
            dark_dn,
            noise_dn,
            saturated_dn,
        })
    }

    /// Less light above the sky may be noise.
    pub fn least_dn(&self) -> f64 {
        BRIGHT_SIGMAS * self.noise_dn
    }
}
