//! A mark's place by least squares on its pixels.
//!
//! The picture is the plate's light L times what the mark leaves of it, 1 - c C, and blurred. For a Gaussian blur s the
//! blur of a product is exp(s^2 grad . grad) of the product of the blurred factors L' and C', one gradient acting on each:
//!
//! > blur(L (1 - c C)) = L' (1 - c C') - c s^2 grad L' . grad C' - ...
//!
//! The second term keeps a mark in its place where the light falls towards the limb: without it, marks there are seen up
//! to 0.02 px too far inwards. What follows matters only where the light bends within a blur's width, that is at the
//! limb's very edge, where pixels weigh little for it.
//!
//! # When it fails
//! Where the limb leaves a single arm, nothing tells the place along that arm: the covariance says so, or there is no
//! result.

use super::CrossShape;
use super::coverage::BlurredCross;
use super::least_squares::{CONTRAST, Ended, LEVEL, MarkFit, NEAR_PX, X, Y};
use super::patch::{Counting, Light, LightMap, Patch};
use crate::frame::{Frame, Levels, ROUNDING_NOISE_DN};
use crate::plate::Cross;
use crate::units::{Estimate, SensorPx};
use crate::with_view;
use nalgebra::{Matrix2, Vector2};

/// Ground about the cross that takes part, px: it tells the light's level and slope.
const GROUND_PX: f64 = 2.5;
/// A mark farther than this from where it was expected is not that mark.
const FARTHEST_PX: f64 = 1.5;
/// A mark that is far from the middle of its patch gets another about its place, up to so many.
const MOST_PATCHES: usize = 8;
/// What the blurred product leaves out is about this part of s^2 div grad L', of a mark of contrast 1.
const LEFT_OUT: f32 = 0.4;

/// A mark as its pixels show it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefinedMark {
    /// Where it is, with the covariance that the fit's own noise makes.
    pub place: Estimate<SensorPx>,
    /// Darkness of the cross as a fraction of the light around it.
    pub contrast: f64,
    /// The light around it over the light that was expected.
    pub level: f64,
    /// Mean square of the residuals in units of the frame's background noise.
    pub reduced_chi2: f64,
    /// Pixels that took part.
    pub pixels: usize,
}

/// Refines the marks of a frame: their shape at the frame's scale and blur.
#[derive(Debug, Clone)]
pub struct Refiner {
    shape: CrossShape,
    scale_mil_per_px: f64,
}

impl Refiner {
    /// For crosses of the plate at a scale and a lens's blur (1 sigma). A blur that is off by a fifth moves no mark.
    pub fn new(cross: &Cross, scale_mil_per_px: f64, lens_blur_px: f64) -> Self {
        let shape = CrossShape::new(cross, scale_mil_per_px, lens_blur_px);
        Self {
            shape,
            scale_mil_per_px,
        }
    }

    /// The mark near `start`, within about 0.3 px.
    ///
    /// `light` is the blurred light without marks, DN above background; `jacobian` the mapping from plate to sensor there,
    /// px per mil. `None` when the pixels do not lead to a mark near the start.
    pub fn refine(
        &self,
        frame: &Frame,
        levels: &Levels,
        light: &impl Light,
        jacobian: &Matrix2<f64>,
        start: SensorPx,
    ) -> Option<RefinedMark> {
        let to_arms = jacobian.try_inverse()? / self.scale_mil_per_px;
        let to_arms = [to_arms.m11, to_arms.m12, to_arms.m21, to_arms.m22].map(|v| v as f32);
        let noise_dn = levels.noise_dn.max(ROUNDING_NOISE_DN);
        let counting = Counting {
            background_dn: levels.background_dn as f32,
            saturation_dn: f32::from(frame.saturation_dn()),
        };
        let mut middle = start;
        let mut before = None;
        for _ in 0..MOST_PATCHES {
            let ended = self.fit(frame, &counting, noise_dn, light, to_arms, (middle, before))?;
            let offset = Vector2::new(ended.unknowns[X], ended.unknowns[Y]);
            let place = SensorPx::from(middle.vector() + offset);
            if start.distance(place) > FARTHEST_PX {
                return None;
            }
            if offset.norm() <= NEAR_PX {
                return RefinedMark::of(&ended, place, noise_dn);
            }
            middle = place;
            before = Some(ended);
        }
        None
    }

    /// The fit on the pixels about a place, which goes on from where another patch's ended.
    fn fit(
        &self,
        frame: &Frame,
        counting: &Counting,
        noise_dn: f64,
        light: &impl Light,
        to_arms: [f32; 4],
        (middle, before): (SensorPx, Option<Ended>),
    ) -> Option<Ended> {
        let reach = self.shape.half_length_px + GROUND_PX;
        let left_out_per_bend = LEFT_OUT * self.blur_variance() / noise_dn as f32;
        let map = LightMap::about(middle, reach, left_out_per_bend, light);
        let patch = with_view!(frame, view => Patch::cut(&view, counting, &map, middle, reach));
        let fit = MarkFit {
            patch: &patch,
            cross: BlurredCross::new(&self.shape),
            to_arms,
            blur_variance: self.blur_variance(),
            reach: reach as f32,
            noise_dn,
        };
        fit.run(before.as_ref())
    }

    fn blur_variance(&self) -> f32 {
        self.shape.blur_px.powi(2) as f32
    }
}

impl RefinedMark {
    /// `None` of what is no mark.
    fn of(ended: &Ended, position: SensorPx, noise_dn: f64) -> Option<Self> {
        let covariance = ended.covariance;
        let sound = ended.unknowns[CONTRAST] > 0.0 && covariance.iter().all(|v| v.is_finite());
        sound.then(|| Self {
            place: Estimate {
                position,
                covariance,
            },
            contrast: ended.unknowns[CONTRAST],
            level: ended.unknowns[LEVEL],
            reduced_chi2: ended.variance / noise_dn.powi(2),
            pixels: ended.pixels,
        })
    }
}
