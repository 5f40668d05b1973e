//! Brightness levels of a frame from a few of its pixels.

use super::sphere::Sphere;
use crate::estimation::{SIGMA_PER_MEDIAN, median_among, median_of_orders, order};
use crate::frame::{Frame, Sample, View};
use crate::instrument::DirectionCamera;
use crate::reasons::horizon as reasons;
use crate::units::{Rejected, SensorPx};
use crate::with_view;
use nalgebra::UnitVector3;
use std::f64::consts::{PI, SQRT_2};
use std::ops::Range;

/// Largest spacing of the sampled pixels along each axis, and minimum number of samples across a small sphere or a small
/// picture.
const MOST_SPACING_PX: f64 = 40.0;
const ACROSS: f64 = 8.0;
const RASTER_LINES: usize = 24;
/// Quantiles of the pixels: of the dark sky, and the share above the bright level, of which a thousandth may be the Sun. If
/// the Sun is searched, the share is a fraction of the Sun's area.
const DARK_SHARE: f64 = 0.02;
const BRIGHT_SHARE: f64 = 0.005;
const PART_OF_SPHERE: f64 = 0.25;
/// The border of the bright area is at this fraction of the way from dark to bright: above glare, below land without
/// clouds.
const BORDER_SHARE: f64 = 0.3;
/// Relative to saturation. A frame with a higher mean has no dark sky (HORACE 2014, section 2.2.1 and table 3.1).
const MOST_MEAN: f64 = 235.0 / 255.0;
/// Minimum contrast from dark to bright, relative to saturation, and in sigmas of a pixel's noise. A frame with less shows
/// no edge.
const LEAST_CONTRAST: f64 = 12.0 / 255.0;
const LEAST_CONTRAST_SIGMAS: f64 = 10.0;

/// Largest spacing of the raster that shows which side of the edge is bright.
const MOST_RASTER_PX: usize = 54;
/// Distance beyond the limb's light at which the sky has its full darkness, rad.
const FAR_RAD: f64 = 0.05;
/// Minimum share of bright pixels of the raster within the sphere, and maximum share in the sky. Both are needed to find
/// the border.
const LEAST_INSIDE: f64 = 0.1;
const MOST_OUTSIDE: f64 = 0.4;
const LEAST_PIXELS: usize = 40;

/// Levels of a frame, DN.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Levels {
    pub dark_dn: f64,
    pub bright_dn: f64,
    /// Noise of a pixel, 1 sigma.
    pub noise_dn: f64,
}

impl Levels {
    /// Reason for a frame that is bright all over.
    pub const TOO_BRIGHT: &'static str = "too_bright";
    /// Reason for a frame that is dark all over.
    pub const TOO_DARK: &'static str = "too_dark";

    /// The levels from a raster of pixels, for a sphere with the given radius in the picture.
    ///
    /// # Errors
    /// If the frame is dark, or bright, all over and cannot show an edge.
    pub fn of(frame: &Frame, radius_px: f64) -> Result<Self, Rejected> {
        let shorter_px = frame.width().min(frame.height());
        let spacing_px = (2.0 * radius_px / ACROSS).min(MOST_SPACING_PX) as usize;
        let spacing_px = spacing_px.min(shorter_px / RASTER_LINES).max(1);
        let Sampled {
            mut pixels,
            mean,
            noise_dn,
        } = with_view!(frame, view => Sampled::of(&view, spacing_px));
        let saturation = f64::from(frame.saturation_dn());
        Rejected::at_most(MOST_MEAN * saturation, mean, reasons::TOO_BRIGHT)?;
        let sphere_share = PI * radius_px * radius_px / (frame.width() * frame.height()) as f64;
        let bright_share = (PART_OF_SPHERE * sphere_share).min(BRIGHT_SHARE);
        let mut quantile = |share: f64| {
            let n = ((share * pixels.len() as f64) as usize).min(pixels.len() - 1);
            f64::from(*pixels.select_nth_unstable(n).1)
        };
        let levels = Self {
            dark_dn: quantile(DARK_SHARE),
            bright_dn: quantile(1.0 - bright_share),
            noise_dn,
        };
        let contrast = levels.bright_dn - levels.dark_dn;
        let limit = (LEAST_CONTRAST * saturation).max(LEAST_CONTRAST_SIGMAS * noise_dn);
        Rejected::at_least(limit, contrast, reasons::TOO_DARK)?;
        Ok(levels)
    }

    /// Level of the border of the bright area, DN.
    pub fn border_dn(&self) -> f64 {
        self.dark_dn + BORDER_SHARE * (self.bright_dn - self.dark_dn)
    }
}

/// Some of the pixels, their mean, and the noise of the brighter ones from the difference between neighbours.
struct Sampled {
    pixels: Vec<u32>,
    mean: f64,
    noise_dn: f64,
}

impl Sampled {
    fn of<T: Sample>(view: &View<'_, T>, spacing_px: usize) -> Self {
        let mut pairs: Vec<[u32; 2]> = Vec::new();
        for y in (0..view.height).step_by(spacing_px) {
            let row = view.row(y);
            let columns = (0..view.width.saturating_sub(1)).step_by(spacing_px);
            pairs.extend(columns.map(|x| [row[x].into(), row[x + 1].into()]));
        }
        let pixels: Vec<u32> = pairs.iter().map(|[one, _]| *one).collect();
        let sum: u64 = pixels.iter().map(|dn| u64::from(*dn)).sum();
        let mean = sum as f64 / pixels.len() as f64;
        // The noise grows with the light, and that of the dark sky may be clipped at 0.
        let bright = pairs.iter().filter(|[one, _]| f64::from(*one) >= mean);
        let differences = bright.map(|[one, next]| order(one.abs_diff(*next) as f32));
        let median = median_of_orders(&mut differences.collect::<Vec<i32>>());
        let difference = f64::from(median.unwrap_or_default());
        let noise = difference * SIGMA_PER_MEDIAN / SQRT_2;
        Self {
            mean,
            pixels,
            // At least half a DN, because of rounding.
            noise_dn: noise.max(0.5),
        }
    }
}

/// Unmasked pixels all over the frame: the direction of each, and its brightness, DN.
pub(super) struct Raster {
    pixels: Vec<(UnitVector3<f64>, f64)>,
}

impl Raster {
    pub fn of<T: Sample>(view: &View<'_, T>, camera: &DirectionCamera) -> Self {
        let shorter_px = view.width.min(view.height);
        let apart_px = (shorter_px / RASTER_LINES).clamp(1, MOST_RASTER_PX);
        let [columns, rows] = [view.width, view.height].map(|size| (0..size).step_by(apart_px));
        let mut pixels = Vec::with_capacity(columns.len() * rows.len());
        for y in rows {
            let row = view.row(y);
            for x in columns.clone() {
                let ray = camera.lens.ray(SensorPx::new(x as f64, y as f64));
                if let Some(ray) = ray.filter(|_| !camera.mask.iter().any(|r| r.contains(x, y))) {
                    pixels.push((ray, f64::from(row[x].dn())));
                }
            }
        }
        Self { pixels }
    }

    /// The brightness of the pixels whose rays have a cosine to a nadir within a range; `None` if there are too few.
    fn light_within(&self, nadir: &UnitVector3<f64>, range: Range<f64>) -> Option<Vec<f64>> {
        let mut light = Vec::with_capacity(self.pixels.len());
        for (ray, dn) in &self.pixels {
            if range.contains(&ray.dot(nadir)) {
                light.push(*dn);
            }
        }
        (light.len() >= LEAST_PIXELS).then_some(light)
    }

    /// Level of the sky far from the limb, DN; `None` if too little of it is in view.
    pub fn far_sky_dn(&self, sphere: &Sphere, nadir: &UnitVector3<f64>) -> Option<f64> {
        let angle = sphere.half_angle_rad.value + sphere.outside_rad + FAR_RAD;
        median_among(&mut self.light_within(nadir, f64::NEG_INFINITY..angle.cos())?)
    }

    /// Checks that the sphere is bright, as far as it is day there, and the sky is not. Flares have edges as well.
    ///
    /// # Errors
    /// The share of bright pixels that contradicts this.
    pub fn is_filled(
        &self,
        sphere: &Sphere,
        nadir: &UnitVector3<f64>,
        levels: &Levels,
    ) -> Result<(), Rejected> {
        let bright_share = |light: Vec<f64>| {
            let bright = light.iter().filter(|dn| **dn > levels.border_dn());
            bright.count() as f64 / light.len() as f64
        };
        let edge = sphere.half_angle_rad.value;
        let inside = self.light_within(nadir, edge.cos()..f64::INFINITY);
        let sky = edge + sphere.outside_rad;
        let outside = self.light_within(nadir, f64::NEG_INFINITY..sky.cos());
        if let Some(share) = inside.map(bright_share) {
            Rejected::at_least(LEAST_INSIDE, share, reasons::DARK_INSIDE)?;
        }
        if let Some(share) = outside.map(bright_share) {
            Rejected::at_most(MOST_OUTSIDE, share, reasons::BRIGHT_OUTSIDE)?;
        }
        Ok(())
    }
}
