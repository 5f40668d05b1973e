//! Fit of a mark's position by least squares on its pixels.
//!
//! The image is the plate's brightness L times the mark's transmission 1 - c C, blurred. For a Gaussian blur s the blur of
//! a product is exp(s^2 grad . grad) of the product of the blurred factors L' and C', one gradient acting on each:
//!
//! > blur(L (1 - c C)) = L' (1 - c C') - c s^2 grad L' . grad C' - ...
//!
//! The second term removes a bias where the brightness falls towards the limb: without it, marks there are measured up to
//! 0.02 px too far inwards. Further terms matter only where the brightness curves within a blur's width, that is at the
//! very edge of the limb; pixels there have a lower weight for it.
//!
//! # Failure
//! If only a single arm is lit at the limb, the position along that arm is not determined: the covariance shows it, or
//! there is no result.

use super::MarkImage;
use super::mark_fit::{CONTRAST, Lists, MarkFit, Settled, X, Y};
use super::mark_image::Cover;
use super::patch::Illumination;
use crate::frame::{Cutout, PixelNoise};
use crate::plate::MarkShape;
use crate::units::{Estimate, SensorPx};
use nalgebra::{Matrix2, Vector2};

/// A mark measured from its pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefinedMark {
    /// Its position, with the fit's covariance: from the pixels' stated variance, or from the residuals if theirs is
    /// larger.
    pub place: Estimate<SensorPx>,
    /// Darkness of the mark as a fraction of the light around it.
    pub contrast: f64,
    /// Mean square of the residuals in units of the pixels' stated variance.
    pub reduced_chi2: f64,
}

/// Refines the marks of a frame: contains their shape at the frame's scale and blur.
#[derive(Debug, Clone)]
pub struct Refiner {
    image: MarkImage,
    cover: Cover,
    /// From an offset along the plate's axes to one along the arms.
    to_arms: Matrix2<f64>,
    scale_mil_per_px: f64,
    noise: PixelNoise,
    lists: Lists,
}

impl Refiner {
    /// For marks of the plate at a scale and a lens's blur (1 sigma), on pixels with some noise. An error of the blur by a
    /// fifth shifts no mark.
    pub fn new(
        shape: &MarkShape,
        scale_mil_per_px: f64,
        lens_blur_px: f64,
        noise: PixelNoise,
    ) -> Self {
        let image = MarkImage::new(shape, scale_mil_per_px, lens_blur_px);
        Self {
            cover: Cover::new(&image),
            to_arms: shape.arms().transpose(),
            scale_mil_per_px,
            image,
            noise,
            lists: Lists::default(),
        }
    }

    /// Radius of the pixels used around a mark's expected position, px.
    pub fn reach_px(&self) -> f64 {
        self.image.fit_reach_px()
    }

    /// The mark near `start`, within half an arm's width.
    ///
    /// `illumination` is the blurred light without marks, DN above background; `jacobian` the mapping from plate to sensor
    /// there, px per mil. `None` if the fit does not converge to a mark near the start.
    pub fn refine(
        &mut self,
        cutout: &Cutout,
        illumination: &impl Illumination,
        jacobian: &Matrix2<f64>,
        start: SensorPx,
    ) -> Option<RefinedMark> {
        let reach = self.reach_px();
        self.lists.patch.take(start, reach, cutout, illumination)?;
        let fit = MarkFit {
            image: &self.image,
            cover: &self.cover,
            to_arms: self.to_arms * (jacobian.try_inverse()? / self.scale_mil_per_px),
            reach,
            noise: self.noise,
        };
        // Beyond an arm's width there is another mark, or none.
        let farthest_px = self.image.blurred_half_width_px();
        let settled = fit.run(&mut self.lists, farthest_px)?;
        RefinedMark::of(&settled, start)
    }
}

impl RefinedMark {
    /// `None` if it is not a mark.
    fn of(settled: &Settled, start: SensorPx) -> Option<Self> {
        let Settled {
            unknowns,
            covariance,
            ..
        } = settled;
        let sound = unknowns[CONTRAST] > 0.0 && covariance.iter().all(|v| v.is_finite());
        sound.then(|| Self {
            place: Estimate {
                position: SensorPx::from(start.vector() + Vector2::new(unknowns[X], unknowns[Y])),
                covariance: *covariance,
            },
            contrast: unknowns[CONTRAST],
            reduced_chi2: settled.reduced_chi2,
        })
    }
}
