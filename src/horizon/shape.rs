//! The mean profile of a limb: its half-brightness point, and whether it is a limb's at all.

use super::air::Air;
use super::places::{Light, OfPlaces};
use super::profile::{INTERPOLATED_NOISE, Profiles, falls_through};
use super::sphere::Sphere;
use super::template::CLOUDED_SHARE;
use crate::reasons::horizon as reasons;
use crate::units::{Measured, Rejected};
use std::ops::Range;

/// Noise lowers the cloudless quantile of the places by so many sigmas (normal distribution, a tenth of them).
const CLOUDLESS_SIGMAS: f64 = 1.282;
/// 1 sigma of the typical blur of lens, pixels and interpolation.
const BLUR_PX: f64 = 0.9;
/// Relative uncertainty of the correction of the limb's peak for blur.
const BLUR_SIGMA: f64 = 0.5;
/// Relative uncertainty of the limb's brightness.
const BRIGHTNESS_SIGMA: f64 = 0.005;
/// The darkest places may have clouds as well: 1 sigma, relative to the excess brightness of the median place.
const CLOUDS_LEFT: f64 = 0.6;
/// Relative to the limb's brightness: light beyond the profile. More is glare.
const MOST_BEYOND: f64 = 0.04;
/// Relative to the limb's brightness: darker air is above any cloud, and its model determines the brightness.
const AIR_ALONE: f64 = 0.6;
/// The same without clouds.
const AIR_OF_CLEAR: f64 = 0.93;
/// Brightness and model differ by more sigmas only if clouds lie all along the limb.
const MOST_LAW_SIGMAS: f64 = 3.0;
/// The sky begins so many scale heights above the edge, and needs at least so many samples.
const SKY_SCALES: f64 = 4.0;
const LEAST_SKY: usize = 4;
/// Increase of the sky towards the edge that may be the limb's own, relative to its brightness.
const OWN_SKY: f64 = 0.02;
/// Relative uncertainty of the extrapolation of the sky's increase to the edge.
const SKY_SIGMA: f64 = 0.5;

/// Light falls off within so many scale heights of the half-brightness point, or pixels if these are more, by this share of
/// the brightness.
const WITHIN_SCALES: f64 = 2.0;
const WITHIN_PX: f64 = 2.0;
const FALLS_WITHIN: Range<f64> = 0.6..1.7;
/// Thin air above a limb leaves this share at so many scale heights outside of the half-brightness point, or pixels if
/// these are more. A panel leaves none; the contrast of a photograph, some.
const THIN_AIR_SCALES: f64 = 0.5;
const THIN_AIR_PX: f64 = 1.0;
const LEAST_THIN_AIR: f64 = 0.08;
/// Number of the innermost samples, and their minimum share of the brightness.
const INNERMOST: usize = 4;
const LEAST_INSIDE: f64 = 0.35;

/// A mean profile that may be a limb's. The light falls off over a few scale heights of the air: a terminator, a glow or a
/// gradient is softer, a strut sharper. The inside is as bright as an Earth.
pub(super) struct Shape {
    /// The profile minus the sky's increase towards it, from the inside outwards, and the index of the sample on the edge.
    light: Vec<f64>,
    edge: usize,
    /// The sky's increase per step towards the edge.
    glow: f64,
    air: Option<Air>,
    /// Range of the sky's samples.
    sky: Range<usize>,
    /// Number of steps over which the light falls to 1/e.
    pub scale: f64,
    step_px: f64,
}

/// The point of the mean profile with half of the limb's brightness.
pub(super) struct Half {
    /// Distance outwards from the edge of the cone.
    pub steps: Measured,
    brightness: f64,
    /// The light follows the model of the air down to the thick air, and no place shows a cloud; or there is no air.
    pub is_clear: bool,
}

/// The weighted mean of two values; its sigma grows with their disagreement.
fn weighted_mean(one: Measured, other: Measured) -> Measured {
    let weights = [one, other].map(|m| m.sigma.powi(-2));
    let sum = weights[0] + weights[1];
    let apart_sigmas = (one.value - other.value).abs() / one.sigma.hypot(other.sigma);
    Measured::new(
        (one.value * weights[0] + other.value * weights[1]) / sum,
        apart_sigmas.max(1.0) / sum.sqrt(),
    )
}

impl Shape {
    pub fn new(profiles: &Profiles, sphere: &Sphere, mean: Vec<f64>) -> Self {
        let scale = sphere.scale_rad() / profiles.step_rad;
        let air = Air::new(sphere, profiles.step_rad, BLUR_PX / profiles.step_px);
        let mut shape = Self {
            light: mean,
            edge: profiles.edge,
            glow: 0.0,
            air,
            sky: profiles.sky(),
            scale,
            step_px: profiles.step_px,
        };
        shape.glow = shape.growth();
        for n in 0..shape.light.len() {
            shape.light[n] -= shape.glow * (shape.light.len() - n.max(shape.edge)) as f64;
        }
        shape
    }

    /// Increase of the sky per step towards the limb, beyond that of the limb's own light there.
    fn growth(&self) -> f64 {
        let first = self.edge + (SKY_SCALES * self.scale).ceil() as usize;
        let sky = first..self.light.len();
        let Some(air) = self.air.as_ref().filter(|_| sky.len() >= LEAST_SKY) else {
            return 0.0;
        };
        let middle = (sky.start + sky.end - 1) as f64 / 2.0;
        let slope = |light: &dyn Fn(usize) -> f64| {
            let (mut sum, mut squares) = (0.0, 0.0);
            for n in sky.clone() {
                let inwards = middle - n as f64;
                sum += inwards * light(n);
                squares += inwards * inwards;
            }
            sum / squares
        };
        let usual = |n: usize| air.usual_share(n as f64 - self.edge as f64);
        let own = slope(&usual) + OWN_SKY / (self.light.len() - self.edge) as f64;
        (slope(&|n| self.light[n]) - own).max(0.0)
    }

    /// The brightness at a distance outside of the edge, in steps.
    fn at(&self, steps: f64) -> f64 {
        let last = self.light.len() - 1;
        let at = (self.edge as f64 + steps).clamp(0.0, last as f64);
        let n = (at as usize).min(last - 1);
        self.light[n] + (at - n as f64) * (self.light[n + 1] - self.light[n])
    }

    /// The point with half of the limb's brightness above the sky. Without clouds, the places and the model of the air both
    /// determine the brightness; otherwise the model alone, from the air above all clouds. If the light does not follow the
    /// model, the places determine it. `None` if there is no limb.
    pub fn half(&self, places: &OfPlaces, clouded: f64, light: &Light) -> Option<Half> {
        let noise =
            INTERPOLATED_NOISE * light.noise_dn / places.limb_dn / (places.averaged as f64).sqrt();
        let cloudless = places.cloudless + CLOUDLESS_SIGMAS * noise;
        let clouds = (places.middle - cloudless).max(0.0);
        // The limb's light extends beyond the profile, most of all for a balloon, which has some air above it.
        let beyond = |far_dn: f64| (places.sky_dn - far_dn) / places.limb_dn;
        let beyond = light.far_sky_dn.map_or(0.0, beyond).clamp(0.0, MOST_BEYOND);
        let sky = self.glow * (self.light.len() - self.edge) as f64;
        let blurred = self.taken_by_blur();
        let brightness = cloudless + blurred - sky;
        let half = self.falls_through((brightness - beyond) / 2.0)?;
        let fall = (self.at(half - 1.0) - self.at(half + 1.0)) / 2.0;
        let of_clouds = (CLOUDS_LEFT * clouds).hypot(BRIGHTNESS_SIGMA);
        let left = of_clouds.hypot(BLUR_SIGMA * blurred).hypot(SKY_SIGMA * sky);
        let by_places = Measured::new(half, left / 2.0 / fall);
        let is_alike = |law: &Measured| {
            (law.value - half).abs() < MOST_LAW_SIGMAS * law.sigma.hypot(by_places.sigma)
        };
        let clear = match clouded <= CLOUDED_SHARE {
            true => self.half_by_law(brightness, AIR_OF_CLEAR).filter(is_alike),
            false => None,
        };
        let above_clouds = || self.half_by_law(brightness, AIR_ALONE).unwrap_or(by_places);
        Some(Half {
            steps: clear.map_or_else(above_clouds, |law| weighted_mean(law, by_places)),
            brightness,
            is_clear: clear.is_some() || self.air.is_none(),
        })
    }

    /// Steps from the edge to the last position at which the light falls below a level.
    fn falls_through(&self, level: f64) -> Option<f64> {
        let light: Vec<f32> = self.light.iter().map(|light| *light as f32).collect();
        Some(falls_through(&light, level)? - self.edge as f64)
    }

    /// The half-brightness point by the model of the air, from light below a share of the brightness.
    fn half_by_law(&self, brightness: f64, most: f64) -> Option<Measured> {
        let thick = self
            .light
            .iter()
            .rposition(|light| *light > most * brightness);
        let steps = |n: usize| n as f64 - self.edge as f64;
        let air = thick.map_or(0, |n| n + 1)..self.sky.start;
        let light: Vec<(f64, f64)> = air.map(|n| (steps(n), self.light[n])).collect();
        let last = (steps(self.sky.start) + steps(self.sky.end - 1)) / 2.0;
        self.air.as_ref()?.half(&light, last, brightness)
    }

    /// Loss of the profile's peak by blur, estimated from the loss by an additional blur in proportion to the variance.
    fn taken_by_blur(&self) -> f64 {
        // Variance of the weights 1/4, 1/2, 1/4, in steps^2.
        const VARIANCE: f64 = 0.5;
        let light = &self.light;
        let inner = 1..=self.edge.min(light.len().saturating_sub(2));
        let peak = inner.max_by(|a, b| light[*a].total_cmp(&light[*b]));
        let taken = |n: usize| light[n] - (light[n - 1] + 2.0 * light[n] + light[n + 1]) / 4.0;
        let blur_steps = BLUR_PX / self.step_px;
        peak.map_or(0.0, |n| taken(n).max(0.0) * blur_steps.powi(2) / VARIANCE)
    }

    /// Checks that this is a limb.
    ///
    /// # Errors
    /// The share of the brightness that contradicts it.
    pub fn check(&self, half: &Half) -> Result<(), Rejected> {
        let fall =
            |steps: f64| self.at(half.steps.value - steps) - self.at(half.steps.value + steps);
        let steps = |scales: f64, px: f64| (scales * self.scale).max(px / self.step_px);
        let within = fall(steps(WITHIN_SCALES, WITHIN_PX)) / half.brightness;
        let outside = half.steps.value + steps(THIN_AIR_SCALES, THIN_AIR_PX);
        let thin_air = self.at(outside) / half.brightness;
        let innermost = self.light[..INNERMOST].iter().sum::<f64>() / INNERMOST as f64;
        Rejected::at_least(FALLS_WITHIN.start, within, reasons::SOFT_EDGE)?;
        Rejected::at_most(FALLS_WITHIN.end, within, reasons::UNEVEN_EDGE)?;
        Rejected::at_least(LEAST_THIN_AIR, thin_air, reasons::SHARP_EDGE)?;
        Rejected::at_least(
            LEAST_INSIDE,
            innermost / half.brightness,
            reasons::DARK_INSIDE,
        )
    }
}
