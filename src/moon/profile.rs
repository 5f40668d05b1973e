//! The blurred brightness across the limb of a shaded sphere.

use super::shading::Sphere;

const STEPS_PER_PX: f64 = 4.0;
/// Cut-off of the blur's Gaussian, in sigmas.
const REACH_SIGMAS: f64 = 3.5;
/// Variance of the blur by a pixel, px^2.
pub(super) const PIXEL_VARIANCE: f64 = 1.0 / 12.0;

/// A range of depths behind the limb, px; negative in front of the limb.
pub(super) type Depths = std::ops::Range<f64>;

/// The brightness across a limb at one angle, by depth.
#[derive(Debug, Clone)]
pub(super) struct Profile {
    steps: Vec<f64>,
    first_px: f64,
}

/// Brightness at a position, and its first and second derivatives by the depth, px.
#[derive(Debug, Clone, Copy)]
pub(super) struct Light {
    pub light: f64,
    pub slope: f64,
    pub curve: f64,
}

/// A blur of the light across a limb.
pub(super) struct Blur {
    weights: Vec<f64>,
}

impl Blur {
    /// Blur of optics and pixels; `blur_px` is that of the optics, 1 sigma.
    pub fn new(blur_px: f64) -> Self {
        let sigma = (blur_px * blur_px + PIXEL_VARIANCE).sqrt();
        let reach = (REACH_SIGMAS * sigma * STEPS_PER_PX).ceil();
        let weight = |n: usize| {
            let away = (n as f64 - reach) / STEPS_PER_PX / sigma;
            (-0.5 * away * away).exp()
        };
        let weights: Vec<f64> = (0..=2 * reach as usize).map(weight).collect();
        let sum: f64 = weights.iter().sum();
        Self {
            weights: weights.iter().map(|weight| weight / sum).collect(),
        }
    }
}

impl Profile {
    /// For a sphere of some radius, px, for a range of depths, at an angle from the middle of the bright limb.
    pub fn new(sphere: &Sphere, radius: f64, blur: &Blur, depths: &Depths, angle_rad: f64) -> Self {
        // The limb lies between two steps.
        let first = (depths.start * STEPS_PER_PX).floor() + 0.5;
        let steps = ((depths.end - depths.start) * STEPS_PER_PX).ceil() as usize + 2;
        let (taps, cos_angle) = (blur.weights.len(), angle_rad.cos());
        let from = first - (taps / 2) as f64;
        let light = |n: usize| match (from + n as f64) / STEPS_PER_PX {
            depth if depth > 0.0 => sphere.light_along((1.0 - depth / radius).max(0.0), cos_angle),
            _ => 0.0,
        };
        let sharp: Vec<f64> = (0..steps + taps - 1).map(light).collect();
        let blurred = |sharp: &[f64]| sharp.iter().zip(&blur.weights).map(|(l, w)| l * w).sum();
        Self {
            steps: sharp.windows(taps).map(blurred).collect(),
            first_px: first / STEPS_PER_PX,
        }
    }

    /// Difference from another profile with the same depths, divided by a step.
    pub fn change_from(&self, other: &Self, step: f64) -> Self {
        let both = self.steps.iter().zip(&other.steps);
        Self {
            steps: both.map(|(here, there)| (here - there) / step).collect(),
            first_px: self.first_px,
        }
    }

    /// The brightness at a depth behind the limb, interpolated by the cubic through neighbouring steps with slopes from
    /// their neighbours (Catmull and Rom 1974): brightness and slope are continuous.
    pub fn at(&self, depth_px: f64) -> Light {
        let last = self.steps.len() as f64 - 2.0;
        let place = ((depth_px - self.first_px) * STEPS_PER_PX).clamp(1.0, last - 1e-9);
        let n = place as usize;
        let t = place - n as f64;
        let steps = &self.steps[n - 1..n + 3];
        let [a, b, c, d] = [steps[0], steps[1], steps[2], steps[3]];
        let (first, second) = ((c - a) / 2.0, a - 2.5 * b + 2.0 * c - d / 2.0);
        let third = (d - a) / 2.0 + 1.5 * (b - c);
        Light {
            light: b + t * (first + t * (second + t * third)),
            slope: (first + t * (2.0 * second + 3.0 * t * third)) * STEPS_PER_PX,
            curve: (2.0 * second + 6.0 * t * third) * STEPS_PER_PX.powi(2),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::moon::Shading;
    use libm::erf;
    use std::f64::consts::PI;

    #[test]
    fn the_blurred_limb_of_an_even_disc_is_the_integral_of_a_gaussian() {
        // By the law of Lommel and Seeliger, the full Moon is uniformly half as bright as the brightest ground.
        let full = Sphere::new(Shading::LommelSeeliger, 0.0);
        let sigma = (0.8_f64 * 0.8 + PIXEL_VARIANCE).sqrt();
        let profile = Profile::new(&full, 40.0, &Blur::new(0.8), &(-6.0..6.5), 1.1);
        for n in -40..=40 {
            let depth = f64::from(n) / 10.0;
            let light = 0.25 * (1.0 + erf(depth / sigma / 2.0_f64.sqrt()));
            let slope = 0.5 * (-0.5 * (depth / sigma).powi(2)).exp() / sigma / (2.0 * PI).sqrt();
            let found = profile.at(depth);
            assert!((found.light - light).abs() < 1e-3, "{depth}: {found:?}");
            assert!((found.slope - slope).abs() < 3e-3, "{depth}: {found:?}");
        }
    }
}
