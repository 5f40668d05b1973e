//! Sky level and noise of a frame.

use crate::estimation::{QUARTILE_SIGMAS, SIGMA_PER_MEDIAN, median};
use crate::frame::{Frame, Region};
use crate::reasons::moon as reasons;
use crate::units::Rejected;
use std::f64::consts::SQRT_2;

/// Limits of the spacing of the pixels, along each axis, that sample the sky; a small picture is sampled more densely to
/// get enough pixels.
const MOST_RASTER_PX: usize = 24;
const LEAST_RASTER_PX: usize = 4;
const RASTER_PLACES: usize = 1000;
/// Pixels brighter than the sky by this many sigmas of a pixel's noise belong to a light.
const BRIGHT_SIGMAS: f64 = 4.0;
/// A frame whose sky is brighter than this share of saturation is rejected as glare.
const MOST_SKY: f64 = 0.7;
/// Minimum noise, because values are rounded to whole DN.
const LEAST_NOISE_DN: f64 = 0.5;

/// Number of the brightest pixels of a light: a crescent has at least so many.
const BRIGHTEST: usize = 20;

/// Level that the brightest pixels of a region exceed, DN, for automatic exposure. `None` if the region has fewer pixels.
pub fn bright_dn(frame: &Frame, region: Region) -> Option<f64> {
    let rows = (region.y0..region.y1).flat_map(|y| frame.row_dn(y, region.x0..region.x1));
    let mut light: Vec<f32> = rows.collect();
    if light.len() <= BRIGHTEST {
        return None;
    }
    let (_, bright, _) = light.select_nth_unstable_by(BRIGHTEST, |a, b| b.total_cmp(a));
    Some(f64::from(*bright))
}

/// Brightness levels of a frame, DN.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Levels {
    pub dark_dn: f64,
    /// Noise of a pixel, 1 sigma.
    pub noise_dn: f64,
    /// Pixels of at least this value are saturated.
    pub saturated_dn: f64,
}

/// Spacing of the pixels that sample the sky.
fn raster_px(frame: &Frame) -> usize {
    let apart_px = (frame.width() * frame.height() / RASTER_PLACES).isqrt();
    apart_px.clamp(LEAST_RASTER_PX, MOST_RASTER_PX)
}

/// Noise of a sky that is partly clipped at 0 DN, from the values above. `None` if hardly any pixel is clipped.
fn clipped_noise_dn(frame: &Frame) -> Option<f64> {
    /// Fewest pixels of a clipped sky for an estimate.
    const LEAST_PIXELS: usize = 50;
    /// The share of the values, for a mean of 0, that lies below so many sigmas.
    const SHARE: f64 = 0.98;
    const SIGMAS: f64 = 2.054;
    let raster_px = raster_px(frame);
    let beside = raster_px / 2;
    let rows = (beside..frame.height()).step_by(raster_px);
    let columns = || (beside..frame.width().saturating_sub(beside)).step_by(raster_px);
    let places = rows.flat_map(|y| columns().map(move |x| (x, y)));
    // A pixel between two clipped ones belongs to the sky, whatever its value.
    let is_clipped = |x: usize, y: usize| frame.dn(x, y) == 0.0;
    let sky = places.filter(|(x, y)| is_clipped(x - beside, *y) && is_clipped(x + beside, *y));
    let mut sky: Vec<f64> = sky.map(|(x, y)| f64::from(frame.dn(x, y))).collect();
    if sky.len() < LEAST_PIXELS {
        return None;
    }
    let rank = (SHARE * sky.len() as f64) as usize;
    let (_, most, _) = sky.select_nth_unstable_by(rank, f64::total_cmp);
    // A rounded value represents values up to half a DN above it.
    (*most > 0.0).then(|| (*most + 0.5) / SIGMAS)
}

impl Levels {
    /// The levels from a raster of pixels.
    ///
    /// # Errors
    /// If the frame is bright all over.
    pub fn of(frame: &Frame) -> Result<Self, Rejected> {
        let saturated_dn = f64::from(frame.saturation_dn());
        let raster_px = raster_px(frame);
        let rows = (raster_px / 2..frame.height()).step_by(raster_px);
        let columns = || (raster_px / 2..frame.width() - 1).step_by(raster_px);
        let pixel = |x: usize, y: usize| f64::from(frame.dn(x, y));
        let places = rows.flat_map(|y| columns().map(move |x| (x, y)));
        let (mut pixels, steps): (Vec<f64>, Vec<f64>) = places
            .map(|(x, y)| (pixel(x, y), (pixel(x + 1, y) - pixel(x, y)).abs()))
            .unzip();
        let step = median(&steps).unwrap_or(0.0);
        let noise_dn = (step * SIGMA_PER_MEDIAN / SQRT_2)
            .max(clipped_noise_dn(frame).unwrap_or_default())
            .max(LEAST_NOISE_DN);
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

    /// Minimum brightness above the sky that is not noise, DN.
    pub fn least_dn(&self) -> f64 {
        BRIGHT_SIGMAS * self.noise_dn
    }
}
