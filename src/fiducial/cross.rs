//! A printed cross as the camera sees it: two bars behind a Gaussian blur.

use crate::frame::PIXEL_VARIANCE_PX2;
use crate::kernels::{Bars, Coverage, cover};
use crate::plate::Cross;
use nalgebra::{Matrix2, Rotation2};

/// A cross on the sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CrossShape {
    pub half_length_px: f64,
    pub half_width_px: f64,
    /// Gaussian blur of lens and pixel together, 1 sigma.
    pub blur_px: f64,
}

/// How far beyond its tips a cross is looked for, in blurs: a wider window gains nothing and lets in what lies beside.
const TIP_BLURS: f64 = 1.5;

impl CrossShape {
    /// A cross of the plate at a scale, behind a lens's blur (1 sigma), on pixels of finite size.
    pub fn new(cross: &Cross, scale_mil_per_px: f64, lens_blur_px: f64) -> Self {
        Self {
            half_length_px: cross.arm_length_mil / 2.0 / scale_mil_per_px,
            half_width_px: cross.arm_width_mil / 2.0 / scale_mil_per_px,
            blur_px: (lens_blur_px.powi(2) + PIXEL_VARIANCE_PX2).sqrt(),
        }
    }

    /// How far the fit of the cross is shifted by light that is displaced and blurred more, over the product of that light's part
    /// and its displacement. `blurs` is the blur of the displaced light over that of the rest.
    ///
    /// The fit takes for a shift what of the displaced profile b' lies along the slope f' of an arm's own: the integral of f' b'
    /// over that of f'^2. For a bar of half width h behind Gaussian blurs both are differences of Gaussians.
    pub fn coma_shift(&self, blurs: f64) -> f64 {
        let (h2, own) = (self.half_width_px.powi(2), self.blur_px.powi(2));
        let both = own * (1.0 + blurs.powi(2));
        let overlap = |variance: f64| -(-2.0 * h2 / variance).exp_m1() / variance.sqrt();
        overlap(both) / overlap(2.0 * own)
    }

    /// How far from its centre the cross darkens the picture plainly, px.
    pub fn reach_px(&self) -> f64 {
        self.half_length_px + TIP_BLURS * self.blur_px
    }

    /// Half the width of an arm as the blur leaves it, px: an offset larger than this is beside the arm.
    pub(super) fn blurred_half_width_px(&self) -> f64 {
        self.half_width_px.hypot(self.blur_px)
    }

    /// The share of the light that the cross takes at offsets from its centre, px. `to_arms` leads from an offset on the
    /// sensor to one along the arms, both px.
    pub(super) fn coverage(&self, x: &[f32], y: &[f32], to_arms: &Matrix2<f64>) -> Coverage {
        let mut coverage = Coverage::of_length(x.len());
        cover(&self.bars(), rows(to_arms), x, y, &mut coverage);
        coverage
    }

    pub(super) fn bars(&self) -> Bars {
        Bars {
            half_length: self.half_length_px as f32,
            half_width: self.half_width_px as f32,
            per_blur: 1.0 / self.blur_px as f32,
        }
    }
}

/// A matrix by rows.
pub(super) fn rows(matrix: &Matrix2<f64>) -> [f32; 4] {
    [matrix.m11, matrix.m12, matrix.m21, matrix.m22].map(|v| v as f32)
}

/// From an offset on the sensor to one along arms that are turned from the sensor's axes.
pub(super) fn turned(rotation_deg: f64) -> Matrix2<f64> {
    Rotation2::new(-rotation_deg.to_radians()).into_inner()
}

#[cfg(test)]
pub(super) const USUAL_SHAPE: CrossShape = CrossShape {
    half_length_px: 7.8,
    half_width_px: 1.05,
    blur_px: 0.95,
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cross_takes_the_light_of_its_arms_area() {
        let shape = USUAL_SHAPE;
        let (length, width) = (2.0 * shape.half_length_px, 2.0 * shape.half_width_px);
        let (x, y): (Vec<f32>, Vec<f32>) = (-15..=15)
            .flat_map(|y| (-15..=15).map(move |x| (x as f32, y as f32)))
            .unzip();
        let area: f32 = shape.coverage(&x, &y, &turned(17.0)).share.iter().sum();
        assert!((f64::from(area) - (2.0 * length * width - width * width)).abs() < 0.02);
    }
}
