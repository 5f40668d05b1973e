//! The light across the limb of a shaded sphere, blurred.

use super::shading::Sphere;
use std::f64::consts::PI;

/// Angles from the middle of the bright limb at which it is computed, to half a turn.
const ANGLES: usize = 24;
const STEPS_PER_PX: f64 = 4.0;
/// The blur's Gaussian ends after so many sigmas.
const REACH_SIGMAS: f64 = 3.5;
/// A pixel blurs by as much as a Gaussian of this variance, px^2.
pub(super) const PIXEL_VARIANCE: f64 = 1.0 / 12.0;

/// A range of depths behind the limb, px; what lies before the limb is less than 0.
pub(super) type Depths = std::ops::Range<f64>;

/// The light of a limb by angle and depth.
pub(super) struct Profiles {
    by_angle: Vec<Vec<f64>>,
    first_px: f64,
}

/// Light of a place, and its derivatives.
#[derive(Debug, Clone, Copy)]
pub(super) struct Light {
    pub light: f64,
    /// By the depth, px, once and twice.
    pub slope: f64,
    pub curve: f64,
    /// By the angle, rad.
    pub by_angle: f64,
}

impl Profiles {
    /// Of a sphere of some radius, px, for depths in a range and angles up to one. `blur_px` is the optics', 1 sigma.
    pub fn new(sphere: &Sphere, radius: f64, blur_px: f64, depths: &Depths, most_rad: f64) -> Self {
        let sigma = (blur_px * blur_px + PIXEL_VARIANCE).sqrt();
        let reach = (REACH_SIGMAS * sigma * STEPS_PER_PX).ceil() as usize;
        let weight = |n: usize| {
            let away = (n as f64 - reach as f64) / STEPS_PER_PX / sigma;
            (-0.5 * away * away).exp()
        };
        let weights: Vec<f64> = (0..=2 * reach).map(weight).collect();
        let sum: f64 = weights.iter().sum();
        // The limb falls between two steps.
        let first = (depths.start * STEPS_PER_PX).floor() + 0.5;
        let steps = ((depths.end - depths.start) * STEPS_PER_PX).ceil() as usize + 2;
        let sharp = |angle: f64| {
            let depth = move |n: usize| (first + n as f64 - reach as f64) / STEPS_PER_PX;
            let light = move |n| match depth(n) {
                depth if depth > 0.0 => sphere.light((1.0 - depth / radius).max(0.0), angle),
                _ => 0.0,
            };
            (0..steps + 2 * reach).map(light).collect::<Vec<f64>>()
        };
        let blurred = |n: usize| {
            let sharp = sharp(n as f64 / ANGLES as f64 * PI);
            let taps = sharp.windows(weights.len());
            let product = |taps: &[f64]| taps.iter().zip(&weights).map(|(l, w)| l * w).sum::<f64>();
            taps.map(|taps| product(taps) / sum).collect()
        };
        let angles = (most_rad / PI * ANGLES as f64).ceil() as usize;
        Self {
            by_angle: (0..=angles.clamp(1, ANGLES)).map(blurred).collect(),
            first_px: first / STEPS_PER_PX,
        }
    }

    /// The light at a depth behind the limb, at an angle from the middle of the bright limb.
    pub fn at(&self, angle_rad: f64, depth_px: f64) -> Light {
        let last = self.by_angle.len() - 1;
        let angle = (angle_rad.abs() / PI * ANGLES as f64).min(last as f64 - 1e-9);
        let (low, part) = (angle as usize, angle.fract());
        let here = self.along(low, depth_px);
        let next = self.along(low + 1, depth_px);
        let [light, slope, curve] = [0, 1, 2].map(|n| here[n] + (next[n] - here[n]) * part);
        Light {
            light,
            slope,
            curve,
            by_angle: (next[0] - here[0]) * (ANGLES as f64 / PI) * angle_rad.signum(),
        }
    }

    /// Light, slope and curvature, by the cubic through a step and the next whose slopes are those of their neighbours (Catmull and Rom 1974):
    /// light and slope change without a jump.
    fn along(&self, angle: usize, depth_px: f64) -> [f64; 3] {
        let profile = &self.by_angle[angle];
        let place = (depth_px - self.first_px) * STEPS_PER_PX;
        let before = place.floor().clamp(1.0, profile.len() as f64 - 3.0);
        let t = (place - before).clamp(0.0, 1.0);
        let n = before as usize;
        let [a, b, c, d] = [profile[n - 1], profile[n], profile[n + 1], profile[n + 2]];
        let (first, second) = ((c - a) / 2.0, a - 2.5 * b + 2.0 * c - d / 2.0);
        let third = (d - a) / 2.0 + 1.5 * (b - c);
        [
            b + t * (first + t * (second + t * third)),
            (first + t * (2.0 * second + 3.0 * t * third)) * STEPS_PER_PX,
            (2.0 * second + 6.0 * t * third) * STEPS_PER_PX.powi(2),
        ]
    }
}
