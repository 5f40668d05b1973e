//! What the blurred cross covers, at many places side by side: it is asked for ten thousand places a frame.
//!
//! The cross is two bars less their common middle, and a blurred bar is its profile along times its profile across. Each
//! profile is a difference of two tails of the normal distribution (Abramowitz and Stegun, Handbook of Mathematical
//! Functions, 26.2.16, to 1e-5), which is quicker than any table: eight places go through it at once.

use super::CrossShape;
use crate::lanes::{Scratch, WHOLES, larger};
use multiversion::multiversion;

/// A blurred cross of full contrast.
#[derive(Debug, Clone, Copy)]
pub(super) struct BlurredCross {
    half_length: f32,
    half_width: f32,
    per_blur: f32,
}

/// Shares of the light that a cross covers, and how they change along its two arms, per px; one entry a place.
pub(super) struct Coverage {
    pub share: Scratch<f32>,
    pub slope_u: Scratch<f32>,
    pub slope_v: Scratch<f32>,
}

/// Where a cross lies: its middle on the sensor, px, and (by rows) what leads from an offset on the sensor to one along its
/// arms, both px.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pose {
    pub middle: [f32; 2],
    pub to_arms: [f32; 4],
}

impl Pose {
    /// About the origin, its arms turned from the sensor's axes.
    pub(super) fn turned(rotation_deg: f64) -> Self {
        let (sin, cos) = rotation_deg.to_radians().sin_cos();
        let (sin, cos) = (sin as f32, cos as f32);
        Self {
            middle: [0.0; 2],
            to_arms: [cos, sin, -sin, cos],
        }
    }
}

impl Coverage {
    pub(super) fn of_length(count: usize) -> Self {
        let [share, slope_u, slope_v] = std::array::from_fn(|_| Scratch::of_length(count));
        Self {
            share,
            slope_u,
            slope_v,
        }
    }
}

impl BlurredCross {
    pub(super) fn new(shape: &CrossShape) -> Self {
        Self {
            half_length: shape.half_length_px as f32,
            half_width: shape.half_width_px as f32,
            per_blur: 1.0 / shape.blur_px as f32,
        }
    }

    /// The coverage at places of the sensor.
    pub(super) fn at(&self, x: &[f32], y: &[f32], pose: &Pose) -> Coverage {
        let mut coverage = Coverage::of_length(x.len());
        self.fill(x, y, pose, &mut coverage);
        coverage
    }

    /// The same, into lists as long as those of the places.
    pub(super) fn fill(&self, x: &[f32], y: &[f32], pose: &Pose, coverage: &mut Coverage) {
        if self.half_length * self.per_blur > ENDS_APART_SIGMAS {
            cover::<true>(self, x, y, pose, coverage);
        } else {
            cover::<false>(self, x, y, pose, coverage);
        }
    }

    /// A bar of some half length at an offset from its middle: the share that it covers, and its slope.
    #[inline(always)]
    fn bar(&self, at: f32, half: f32) -> (f32, f32) {
        let (near, near_density) = tail((at - half) * self.per_blur);
        let (far, far_density) = tail((at + half) * self.per_blur);
        (near - far, (far_density - near_density) * self.per_blur)
    }

    /// The same of a bar whose other end is not seen from either.
    #[inline(always)]
    fn long_bar(&self, at: f32, half: f32) -> (f32, f32) {
        let (share, density) = tail((at.abs() - half) * self.per_blur);
        (share, -(density * self.per_blur).copysign(at))
    }
}

/// Ends of an arm that are so many sigma of the blur from its middle are each on its own.
const ENDS_APART_SIGMAS: f32 = 5.0;

#[multiversion(targets("x86_64+avx2"))]
fn cover<const ENDS_APART: bool>(
    cross: &BlurredCross,
    x: &[f32],
    y: &[f32],
    pose: &Pose,
    coverage: &mut Coverage,
) {
    let count = x.len();
    let y = &y[..count];
    let share = &mut coverage.share[..count];
    let (slope_u, slope_v) = (
        &mut coverage.slope_u[..count],
        &mut coverage.slope_v[..count],
    );
    let ([middle_x, middle_y], [ux, uy, vx, vy]) = (pose.middle, pose.to_arms);
    for n in 0..count {
        let (dx, dy) = (x[n] - middle_x, y[n] - middle_y);
        let (u, v) = (ux * dx + uy * dy, vx * dx + vy * dy);
        let ((long_u, long_slope_u), (long_v, long_slope_v)) = if ENDS_APART {
            (
                cross.long_bar(u, cross.half_length),
                cross.long_bar(v, cross.half_length),
            )
        } else {
            (
                cross.bar(u, cross.half_length),
                cross.bar(v, cross.half_length),
            )
        };
        let (wide_u, wide_slope_u) = cross.bar(u, cross.half_width);
        let (wide_v, wide_slope_v) = cross.bar(v, cross.half_width);
        let (arm_u, arm_v) = (long_u - wide_u, long_v - wide_v);
        share[n] = long_u * wide_v + wide_u * arm_v;
        slope_u[n] = long_slope_u * wide_v + wide_slope_u * arm_v;
        slope_v[n] = long_slope_v * wide_u + wide_slope_v * arm_u;
    }
}

/// The normal distribution's tail beyond z, and its density there.
#[inline(always)]
fn tail(z: f32) -> (f32, f32) {
    const PER_ROOT_TAU: f32 = 0.398_942_3;
    let t = 1.0 / (1.0 + 0.332_67 * z.abs());
    let density = PER_ROOT_TAU * power_of_two(-0.5 * std::f32::consts::LOG2_E * z * z);
    let beyond = ((0.937_298 * t - 0.120_167_6) * t + 0.436_183_6) * t * density;
    (if z < 0.0 { 1.0 - beyond } else { beyond }, density)
}

/// 2^x of x from 0 down, to 4e-6 of it (interpolated at Chebyshev's nodes); what is below 2^-120 is taken for that.
#[inline(always)]
fn power_of_two(x: f32) -> f32 {
    const EXPONENT_BITS: u32 = 23;
    const EXPONENT_OF_ONE: u32 = 127;
    let x = larger(x, -120.0);
    let shifted = x + WHOLES;
    let part = x - (shifted - WHOLES);
    let series = (0.009_666_37 * part + 0.055_921_98) * part + 0.240_223_5;
    let series = (series * part + 0.693_121_1) * part + 1.0;
    let whole = shifted.to_bits().wrapping_sub(WHOLES.to_bits());
    series * f32::from_bits(whole.wrapping_add(EXPONENT_OF_ONE) << EXPONENT_BITS)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPE: CrossShape = CrossShape {
        half_length_px: 7.8,
        half_width_px: 1.05,
        blur_px: 0.95,
    };

    /// The blurred cross straight from its definition.
    fn true_share(u: f64, v: f64) -> f64 {
        let below = |at: f64| 0.5 * libm::erfc(-at / SHAPE.blur_px / std::f64::consts::SQRT_2);
        let bar = |x: f64, half: f64| below(x + half) - below(x - half);
        let (long_u, long_v) = (bar(u, SHAPE.half_length_px), bar(v, SHAPE.half_length_px));
        let (wide_u, wide_v) = (bar(u, SHAPE.half_width_px), bar(v, SHAPE.half_width_px));
        long_u * wide_v + wide_u * long_v - wide_u * wide_v
    }

    #[test]
    fn the_coverage_is_that_of_the_blurred_cross_and_its_slopes() {
        let places = |n: i32| (f64::from(n) * 0.41 - 12.0, f64::from(n) * 0.17 - 5.0);
        let (u, v): (Vec<f32>, Vec<f32>) = (0..60)
            .map(places)
            .map(|(u, v)| (u as f32, v as f32))
            .unzip();
        let seen = BlurredCross::new(&SHAPE).at(&u, &v, &Pose::turned(0.0));
        for (n, (u, v)) in (0..60).map(places).enumerate() {
            assert!((f64::from(seen.share[n]) - true_share(u, v)).abs() < 3e-5);
            const H: f64 = 1e-4;
            let slope_u = (true_share(u + H, v) - true_share(u - H, v)) / (2.0 * H);
            let slope_v = (true_share(u, v + H) - true_share(u, v - H)) / (2.0 * H);
            assert!((f64::from(seen.slope_u[n]) - slope_u).abs() < 3e-5);
            assert!((f64::from(seen.slope_v[n]) - slope_v).abs() < 3e-5);
        }
    }

    #[test]
    fn the_cross_has_the_area_of_its_arms() {
        let (length, width) = (2.0 * SHAPE.half_length_px, 2.0 * SHAPE.half_width_px);
        let (x, y): (Vec<f32>, Vec<f32>) = (-15..=15)
            .flat_map(|y| (-15..=15).map(move |x| (x as f32, y as f32)))
            .unzip();
        let coverage = BlurredCross::new(&SHAPE).at(&x, &y, &Pose::turned(17.0));
        let area: f32 = coverage.share.iter().sum();
        assert!((f64::from(area) - (2.0 * length * width - width * width)).abs() < 0.02);
    }
}
