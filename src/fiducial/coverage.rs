//! What the blurred cross covers, at many places side by side: it is asked for ten thousand places a frame.
//!
//! The cross is two bars less their common middle, and a blurred bar is its profile along times its profile across. Each
//! profile is a difference of two tails of the normal distribution, which is quicker than any table: eight places go through
//! it at once.

use crate::frame::PIXEL_VARIANCE_PX2;
use crate::lanes::{Scratch, normal_tail};
use crate::plate::Cross;
use multiversion::multiversion;
use nalgebra::Vector2;

/// The cross as the camera sees it, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CrossShape {
    pub half_length_px: f64,
    pub half_width_px: f64,
    /// Gaussian blur of lens and pixel together, 1 sigma.
    pub blur_px: f64,
}

impl CrossShape {
    /// A cross of the plate at a scale, seen through a lens's blur by pixels of finite size.
    pub fn new(cross: &Cross, scale_mil_per_px: f64, lens_blur_px: f64) -> Self {
        Self {
            half_length_px: cross.arm_length_mil / 2.0 / scale_mil_per_px,
            half_width_px: cross.arm_width_mil / 2.0 / scale_mil_per_px,
            blur_px: (lens_blur_px.powi(2) + PIXEL_VARIANCE_PX2).sqrt(),
        }
    }

    /// How far the fit of a symmetric cross is shifted by a point spread function whose third moment is six times `coma_px3`,
    /// px.
    ///
    /// With f the profile across an arm, coma adds -coma f''', which a fit of the place takes for a shift by minus coma
    /// times the ratio of the integrals of f''^2 and f'^2; for a bar of half width h behind a blur s these are Gaussian integrals.
    pub fn coma_shift(&self, coma_px3: Vector2<f64>) -> Vector2<f64> {
        let h2 = (self.half_width_px / self.blur_px).powi(2);
        let overlap = (-h2).exp();
        let ratio = (1.0 - (1.0 - 2.0 * h2) * overlap) / (2.0 * (1.0 - overlap));
        -coma_px3 * (ratio / self.blur_px.powi(2))
    }

    /// How far from its middle the cross changes the picture, px.
    pub(super) fn reach_px(&self) -> f64 {
        self.half_length_px + 2.0 * self.blur_px
    }
}

/// A blurred cross of full contrast.
#[derive(Debug, Clone, Copy)]
pub(super) struct BlurredCross {
    half_length: f32,
    half_width: f32,
    per_blur: f32,
}

/// Shares of the light that a cross covers, how they change along its two arms, per px, and how these slopes change; one
/// entry a place.
pub(super) struct Coverage {
    pub share: Scratch<f32>,
    pub slope_u: Scratch<f32>,
    pub slope_v: Scratch<f32>,
    pub bend_uu: Scratch<f32>,
    pub bend_uv: Scratch<f32>,
    pub bend_vv: Scratch<f32>,
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
        let [share, slope_u, slope_v, bend_uu, bend_uv, bend_vv] =
            std::array::from_fn(|_| Scratch::of_length(count));
        Self {
            share,
            slope_u,
            slope_v,
            bend_uu,
            bend_uv,
            bend_vv,
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

    /// A bar of some half length at an offset from its middle: the share that it covers, its slope and its bend.
    #[inline(always)]
    fn bar(&self, at: f32, half: f32) -> [f32; 3] {
        let (z_near, z_far) = ((at - half) * self.per_blur, (at + half) * self.per_blur);
        let (near, near_density) = normal_tail(z_near);
        let (far, far_density) = normal_tail(z_far);
        let bend = z_near * near_density - z_far * far_density;
        [
            near - far,
            (far_density - near_density) * self.per_blur,
            bend * self.per_blur * self.per_blur,
        ]
    }

    /// The same of a bar whose other end is not seen from either.
    #[inline(always)]
    fn long_bar(&self, at: f32, half: f32) -> [f32; 3] {
        let z = (at.abs() - half) * self.per_blur;
        let (share, density) = normal_tail(z);
        let slope = density * self.per_blur;
        [share, -slope.copysign(at), slope * self.per_blur * z]
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
    let bend_uu = &mut coverage.bend_uu[..count];
    let bend_uv = &mut coverage.bend_uv[..count];
    let bend_vv = &mut coverage.bend_vv[..count];
    let ([middle_x, middle_y], [ux, uy, vx, vy]) = (pose.middle, pose.to_arms);
    for n in 0..count {
        let (dx, dy) = (x[n] - middle_x, y[n] - middle_y);
        let (u, v) = (ux * dx + uy * dy, vx * dx + vy * dy);
        let ([long_u, long_slope_u, long_bend_u], [long_v, long_slope_v, long_bend_v]) =
            if ENDS_APART {
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
        let [wide_u, wide_slope_u, wide_bend_u] = cross.bar(u, cross.half_width);
        let [wide_v, wide_slope_v, wide_bend_v] = cross.bar(v, cross.half_width);
        let (arm_u, arm_v) = (long_u - wide_u, long_v - wide_v);
        share[n] = long_u * wide_v + wide_u * arm_v;
        slope_u[n] = long_slope_u * wide_v + wide_slope_u * arm_v;
        slope_v[n] = long_slope_v * wide_u + wide_slope_v * arm_u;
        bend_uu[n] = long_bend_u * wide_v + wide_bend_u * arm_v;
        bend_vv[n] = long_bend_v * wide_u + wide_bend_v * arm_u;
        bend_uv[n] = long_slope_u * wide_slope_v + wide_slope_u * (long_slope_v - wide_slope_v);
    }
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
