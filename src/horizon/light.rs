//! What a few of a frame's pixels say of its light.

use crate::estimation::{SIGMA_PER_MEDIAN, median};
use crate::frame::{Frame, Sample, View};
use crate::units::Rejected;
use crate::with_view;
use std::f64::consts::SQRT_2;

/// One pixel in so many is looked at, in each axis.
const SPACING_PX: usize = 12;
/// The dark sky is that of so many of the pixels, and bright is what so many exceed: a thousandth may be the Sun.
const DARK_SHARE: f64 = 0.02;
const BRIGHT_SHARE: f64 = 0.005;
/// The border of what is bright stands at this share of the way from dark to bright: above glare, below land that no cloud covers.
const BORDER_SHARE: f64 = 0.3;
/// Of the saturated level. A frame whose mean is above has no dark sky (HORACE 2014, section 2.2.1 and table 3.1).
const MOST_MEAN: f64 = 235.0 / 255.0;
/// Of the saturated level, and in sigmas of a pixel's noise, from dark to bright. A frame that has less shows nothing.
const LEAST_CONTRAST: f64 = 12.0 / 255.0;
const LEAST_CONTRAST_SIGMAS: f64 = 10.0;

/// Levels of a frame, DN.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Levels {
    pub dark_dn: f64,
    pub bright_dn: f64,
    /// Of a pixel, 1 sigma.
    pub noise_dn: f64,
}

impl Levels {
    /// The levels by a raster of pixels, or why the frame is not worth a look.
    ///
    /// # Errors
    /// A frame that is dark, or bright, all over.
    pub fn of(frame: &Frame) -> Result<Self, Rejected> {
        let Raster {
            mut pixels,
            mean,
            noise_dn,
        } = with_view!(frame, view => Raster::of(&view));
        let saturation = f64::from(frame.saturation_dn());
        if mean > MOST_MEAN * saturation {
            return Err(Rejected {
                reason: "too_bright",
                measured: mean,
                limit: MOST_MEAN * saturation,
            });
        }
        let mut quantile = |share: f64| {
            let n = (share * pixels.len() as f64) as usize;
            f64::from(*pixels.select_nth_unstable_by(n, f32::total_cmp).1)
        };
        let levels = Self {
            dark_dn: quantile(DARK_SHARE),
            bright_dn: quantile(1.0 - BRIGHT_SHARE),
            noise_dn,
        };
        let contrast = levels.bright_dn - levels.dark_dn;
        let limit = (LEAST_CONTRAST * saturation).max(LEAST_CONTRAST_SIGMAS * noise_dn);
        if contrast < limit {
            return Err(Rejected {
                reason: "too_dark",
                measured: contrast,
                limit,
            });
        }
        Ok(levels)
    }

    /// Where the border of what is bright stands, DN.
    pub fn border_dn(&self) -> f64 {
        self.dark_dn + BORDER_SHARE * (self.bright_dn - self.dark_dn)
    }
}

/// Some of the pixels, their mean, and their noise by the difference from their neighbours.
struct Raster {
    pixels: Vec<f32>,
    mean: f64,
    noise_dn: f64,
}

impl Raster {
    fn of<T: Sample>(view: &View<'_, T>) -> Self {
        let rows = (0..view.height).step_by(SPACING_PX).map(|y| view.row(y));
        let pairs = rows.flat_map(|row| row.windows(2).step_by(SPACING_PX));
        let pairs: Vec<[f32; 2]> = pairs.map(|pair| [pair[0].dn(), pair[1].dn()]).collect();
        let differences = pairs.iter().map(|[one, next]| f64::from(next - one).abs());
        let noise = median(differences).unwrap_or_default() * SIGMA_PER_MEDIAN / SQRT_2;
        let pixels: Vec<f32> = pairs.iter().map(|[one, _]| *one).collect();
        Self {
            mean: pixels.iter().map(|dn| f64::from(*dn)).sum::<f64>() / pixels.len() as f64,
            // Of whole numbers, half a one at the least.
            noise_dn: noise.max(0.5),
            pixels,
        }
    }
}
