//! A part of a frame as used by every stage after the disc search: brightness above the background, and masked pixels.

use super::{Frame, Region, Sample, View};
use crate::kernels::{any_above, copied, subtract, zeros};
use crate::units::SensorPx;
use crate::with_view;

/// Variance of a pixel's value, DN^2: read noise and rounding, and photon noise proportional to the light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelNoise {
    /// Variance without light, DN^2.
    pub dark_dn2: f64,
    /// Variance per DN of light, DN.
    pub per_light_dn: f64,
}

impl PixelNoise {
    /// Constant noise, independent of the light, 1 sigma.
    pub fn even(sigma_dn: f64) -> Self {
        Self {
            dark_dn2: sigma_dn.powi(2),
            per_light_dn: 0.0,
        }
    }

    /// Variance of a pixel with a brightness above the background, DN^2.
    pub fn variance(&self, light_dn: f64) -> f64 {
        self.dark_dn2 + self.per_light_dn * light_dn.max(0.0)
    }

    /// 1 sigma, DN.
    pub fn sigma_dn(&self, light_dn: f64) -> f64 {
        self.variance(light_dn).sqrt()
    }
}

/// Level of a region's pixels without the light of the disc: the sum of a value of the column and one of the row, DN.
#[derive(Debug, Clone, PartialEq)]
pub struct Background {
    pub columns_dn: Vec<f32>,
    pub rows_dn: Vec<f32>,
}

impl Background {
    /// A constant background over a region.
    pub fn even(region: Region, dn: f64) -> Self {
        Self {
            columns_dn: vec![dn as f32; region.width()],
            rows_dn: vec![0.0; region.height()],
        }
    }
}

/// A rectangle of a frame: brightness above the background, DN, in single precision; positions are those of the frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Cutout {
    region: Region,
    light_dn: Vec<f32>,
    pub noise: PixelNoise,
    /// Brightness up to which no pixel saturates, DN.
    pub unsaturated_dn: f64,
    /// Excluded pixels: saturated, or hot.
    pub mask: Mask,
}

impl Cutout {
    /// The region must lie within the frame, and the background must be that of the region. Saturated and unusable pixels
    /// are masked.
    pub fn new(frame: &Frame, region: Region, background: &Background, noise: PixelNoise) -> Self {
        let most = |list: &[f32]| list.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let most_dn = most(&background.columns_dn) + most(&background.rows_dn);
        let mut cutout = Self {
            region,
            light_dn: Vec::with_capacity(region.width() * region.height()),
            noise,
            unsaturated_dn: f64::from(frame.saturation_dn()) - f64::from(most_dn),
            mask: Mask::none(region),
        };
        let below_dn = f64::from(frame.saturation_dn()) - 1.0;
        with_view!(frame, view => cutout.fill(&view, background, Sample::floor(below_dn)));
        for y in region.y0..region.y1 {
            if let Some(unusable) = frame.unusable(y, region.x0, region.x1) {
                let masked = cutout.mask.row_mut(y).iter_mut();
                masked
                    .zip(unusable)
                    .for_each(|(masked, unusable)| *masked |= *unusable);
            }
        }
        cutout
    }

    fn fill<T: Sample>(
        &mut self,
        view: &View<'_, T>,
        background: &Background,
        below_saturation: T,
    ) {
        let region = self.region;
        for (y, row_dn) in (region.y0..).zip(&background.rows_dn) {
            let row = &view.row(y)[region.x0..region.x1];
            subtract(row, &background.columns_dn, *row_dn, &mut self.light_dn);
            if any_above(row, below_saturation) {
                for (masked, pixel) in self.mask.row_mut(y).iter_mut().zip(row) {
                    *masked |= *pixel > below_saturation;
                }
            }
        }
    }

    pub fn region(&self) -> Region {
        self.region
    }

    /// The brightness of a row of the frame from column `region().x0` on, DN. The row must be within the region.
    pub fn row(&self, y: usize) -> &[f32] {
        let width = self.region.width();
        &self.light_dn[(y - self.region.y0) * width..][..width]
    }
}

/// Excluded pixels of a region.
#[derive(Debug, PartialEq)]
pub struct Mask {
    region: Region,
    masked: Vec<bool>,
}

impl Clone for Mask {
    fn clone(&self) -> Self {
        Self {
            region: self.region,
            masked: copied(&self.masked),
        }
    }
}

impl Mask {
    /// A mask that excludes no pixel.
    pub fn none(region: Region) -> Self {
        Self {
            region,
            masked: zeros(region.width() * region.height()),
        }
    }

    pub fn region(&self) -> Region {
        self.region
    }

    /// A row of the frame from column `region().x0` on. The row must be within the region.
    pub fn row(&self, y: usize) -> &[bool] {
        let width = self.region.width();
        &self.masked[(y - self.region.y0) * width..][..width]
    }

    pub fn row_mut(&mut self, y: usize) -> &mut [bool] {
        let width = self.region.width();
        &mut self.masked[(y - self.region.y0) * width..][..width]
    }

    /// Masks the pixels within `reach` px of a position in both axes that fulfil a condition.
    pub fn hide_where(&mut self, at: SensorPx, reach: f64, holds: impl Fn(SensorPx) -> bool) {
        let Some(near) = Region::around(at, reach, self.region.x1, self.region.y1) else {
            return;
        };
        let x0 = self.region.x0;
        for y in near.y0.max(self.region.y0)..near.y1 {
            let row = self.row_mut(y);
            for x in near.x0.max(x0)..near.x1 {
                row[x - x0] |= holds(SensorPx::new(f64::from(x as u32), y as f64));
            }
        }
    }

    /// Masks a pixel; pixels outside the region are ignored.
    pub fn hide(&mut self, x: usize, y: usize) {
        let region = self.region;
        if (region.x0..region.x1).contains(&x) && (region.y0..region.y1).contains(&y) {
            self.row_mut(y)[x - region.x0] = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{FrameInfo, Pixels};
    use super::*;

    #[test]
    fn a_cutout_holds_the_light_above_the_background_and_masks_what_saturates() {
        let pixels = Pixels::U8((0..20).map(|n| if n == 13 { 255 } else { n }).collect());
        let frame = Frame::new(5, 4, pixels, 255, FrameInfo::default()).unwrap();
        let region = Region::sized(1, 1, 3, 2);
        let background = Background {
            columns_dn: vec![0.0, 1.0, 2.0],
            rows_dn: vec![0.0, 5.0],
        };
        let cutout = Cutout::new(&frame, region, &background, PixelNoise::even(1.0));
        assert_eq!(cutout.row(1), [6.0, 6.0, 6.0]);
        assert_eq!(cutout.row(2)[..2], [6.0, 6.0]);
        assert_eq!(cutout.mask.row(1), [false, false, false]);
        assert_eq!(cutout.mask.row(2), [false, false, true]);
    }

    #[test]
    fn photon_noise_grows_with_the_light_and_not_below_the_background() {
        let noise = PixelNoise {
            dark_dn2: 4.0,
            per_light_dn: 0.5,
        };
        assert_eq!(
            [-10.0, 0.0, 10.0].map(|dn| noise.variance(dn)),
            [4.0, 4.0, 9.0]
        );
    }
}
