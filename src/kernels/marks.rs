//! A mark's pixels: the light that it absorbs, and the model that its fit linearises.

use super::limb::Lit;
use super::{LANES, groups, larger, normal_tail};
use multiversion::multiversion;

/// Two bars that cross at right angles, behind a Gaussian blur.
#[derive(Debug, Clone, Copy)]
pub struct Bars {
    pub half_length: f32,
    pub half_width: f32,
    /// 1 / sigma of the blur.
    pub per_blur: f32,
}

impl Bars {
    /// Whether each end of an arm can be treated separately: both are many sigma of the blur from its centre.
    #[inline(always)]
    pub fn has_ends_apart(&self) -> bool {
        const ENDS_APART_SIGMAS: f32 = 5.0;
        self.half_length * self.per_blur > ENDS_APART_SIGMAS
    }
}

/// Shares of the light that a cross absorbs at some positions, and their slopes along x and y.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Coverage {
    pub share: Vec<f32>,
    pub slope_x: Vec<f32>,
    pub slope_y: Vec<f32>,
}

impl Coverage {
    /// Sum of the squared slopes along one axis, averaged over both axes.
    pub fn slope_energy(&self) -> f64 {
        let squares = |slopes: &[f32]| slopes.iter().map(|s| f64::from(s * s)).sum::<f64>();
        (squares(&self.slope_x) + squares(&self.slope_y)) / 2.0
    }

    /// Resizes the lists for a number of positions; existing values stay.
    pub fn resize(&mut self, count: usize) {
        for list in [&mut self.share, &mut self.slope_x, &mut self.slope_y] {
            list.resize(count, 0.0);
        }
    }
}

/// Offsets from a mark's centre, px: a position, and the others relative to it.
#[derive(Clone, Copy)]
pub struct Offsets<'a> {
    pub from: [f32; 2],
    pub x: &'a [f32],
    pub y: &'a [f32],
}

/// Absorption of a cross at offsets from its centre; `to_arms` maps, by rows, an offset to one along the arms.
///
/// A blurred bar is the product of its profiles along and across, each a difference of two tails of the normal
/// distribution; the cross is the sum of two bars minus their common centre.
#[multiversion(targets("x86_64+avx2"))]
pub fn cover(bars: &Bars, to_arms: [f32; 4], offsets: Offsets<'_>, coverage: &mut Coverage) {
    if bars.has_ends_apart() {
        cover_by(long_blurred_bar, bars, to_arms, offsets, coverage);
    } else {
        cover_by(blurred_bar, bars, to_arms, offsets, coverage);
    }
}

/// The coverage; `long_bar` gives the share and slope of the bars along their length.
#[inline(always)]
fn cover_by(
    long_bar: impl Fn(f32, f32, f32) -> (f32, f32),
    bars: &Bars,
    to_arms: [f32; 4],
    Offsets { from, x, y }: Offsets<'_>,
    coverage: &mut Coverage,
) {
    let count = x.len();
    coverage.resize(count);
    let y = &y[..count];
    let share = &mut coverage.share[..count];
    let slope_x = &mut coverage.slope_x[..count];
    let slope_y = &mut coverage.slope_y[..count];
    for n in 0..count {
        let (x, y) = (from[0] + x[n], from[1] + y[n]);
        [share[n], slope_x[n], slope_y[n]] = cover_at(&long_bar, bars, to_arms, x, y);
    }
}

/// Share and slopes along x and y at one position.
#[inline(always)]
pub fn cover_at(
    long_bar: impl Fn(f32, f32, f32) -> (f32, f32),
    bars: &Bars,
    [ux, uy, vx, vy]: [f32; 4],
    x: f32,
    y: f32,
) -> [f32; 3] {
    let (u, v) = (ux * x + uy * y, vx * x + vy * y);
    let (long_u, long_slope_u) = long_bar(u, bars.half_length, bars.per_blur);
    let (long_v, long_slope_v) = long_bar(v, bars.half_length, bars.per_blur);
    let (wide_u, wide_slope_u) = blurred_bar(u, bars.half_width, bars.per_blur);
    let (wide_v, wide_slope_v) = blurred_bar(v, bars.half_width, bars.per_blur);
    let slope_u = long_slope_u * wide_v + wide_slope_u * (long_v - wide_v);
    let slope_v = long_slope_v * wide_u + wide_slope_v * (long_u - wide_u);
    [
        long_u * wide_v + wide_u * (long_v - wide_v),
        ux * slope_u + vx * slope_v,
        uy * slope_u + vy * slope_v,
    ]
}

/// The share and slope of a bar so long that its two ends do not overlap.
#[inline(always)]
pub fn long_blurred_bar(at: f32, half: f32, per_blur: f32) -> (f32, f32) {
    let (share, density) = normal_tail((at.abs() - half) * per_blur);
    (share, -(density * per_blur).copysign(at))
}

/// The share that a blurred bar of some half length covers at an offset from its centre, and its slope.
#[inline(always)]
pub fn blurred_bar(at: f32, half: f32, per_blur: f32) -> (f32, f32) {
    let (near, near_density) = normal_tail((at - half) * per_blur);
    let (far, far_density) = normal_tail((at + half) * per_blur);
    (near - far, (far_density - near_density) * per_blur)
}

/// Number of unknowns of a mark's fit: the offset from the expected position, px; the mark's contrast; the ratio of the
/// light to the expected light there, and the change of that ratio over the patch's radius along x and y.
pub const UNKNOWNS: usize = 6;

/// Error of the model beside the noise, relative to the light: a blur that differs from the lens's leaves residuals at the
/// arms' edges, and rejecting some of them would shift the mark.
const MODEL_ERROR: f32 = 0.04;
/// The neglected terms of the blurred product are about this fraction of s^2 div grad L', for a mark of contrast 1.
const LEFT_OUT: f32 = 0.4;

/// The pixels around a mark, in whole lanes.
#[derive(Clone, Copy)]
pub struct MarkPixels<'a> {
    /// Offset from the mark's expected position, px.
    pub x: &'a [f32],
    pub y: &'a [f32],
    /// Light above the background, DN.
    pub seen: &'a [f32],
    /// Light without the mark.
    pub lit: &'a Lit,
    /// The mark's absorption.
    pub coverage: &'a Coverage,
}

/// Parameters of a mark's model apart from its pixels.
pub struct MarkModel {
    pub unknowns: [f32; UNKNOWNS],
    /// Variance of a pixel without light, DN^2, and per DN of light, DN.
    pub dark_dn2: f32,
    pub per_light_dn: f32,
    /// Variance of the blur, px^2.
    pub blur_variance: f32,
    /// 1 / radius of the patch.
    pub per_reach: f32,
}

/// A model linearised at some unknowns, pixel by pixel, in units of the pixels' sigma.
#[derive(Debug, Clone, Default)]
pub struct Near {
    /// Derivatives of the prediction by each unknown, then observed minus predicted.
    pub pixels: Vec<[[f32; LANES]; UNKNOWNS + 1]>,
    /// Allowance for the error of the model itself.
    pub allowed: Vec<[f32; LANES]>,
}

/// One pixel, and the share of its light that the mark absorbs.
struct Pixel {
    x: f32,
    y: f32,
    seen: f32,
    light: f32,
    slope_x: f32,
    slope_y: f32,
    bend: f32,
    cover: [f32; 3],
}

/// Derivatives by the unknowns and residual, and the error of the model, in units of a pixel's sigma.
#[inline(always)]
fn near_pixel(model: &MarkModel, pixel: &Pixel) -> ([f32; UNKNOWNS + 1], f32) {
    let Pixel { x, y, light, .. } = *pixel;
    let [.., contrast, even, tilt_x, tilt_y] = model.unknowns;
    let per_reach = model.per_reach;
    let [share, share_x, share_y] = pixel.cover;
    // The light that a mark of contrast 1 absorbs, and the light that this mark leaves.
    let taken =
        light * share + model.blur_variance * (pixel.slope_x * share_x + pixel.slope_y * share_y);
    let left = light - contrast * taken;
    let level = even + (tilt_x * x + tilt_y * y) * per_reach;
    let left_out = LEFT_OUT * model.blur_variance * pixel.bend;
    let photons = model.per_light_dn * larger(level * left, 0.0);
    let per_sigma = 1.0 / (model.dark_dn2 + photons + left_out * left_out).sqrt();
    let scale = per_sigma * level;
    let (by_place, by_level) = (scale * contrast * light, per_sigma * left);
    let columns = [
        by_place * share_x,
        by_place * share_y,
        -scale * taken,
        by_level,
        by_level * x * per_reach,
        by_level * y * per_reach,
        per_sigma * (pixel.seen - level * left),
    ];
    (columns, per_sigma * MODEL_ERROR * light)
}

/// The model at some unknowns: residuals and derivatives of every pixel in units of its sigma.
#[multiversion(targets("x86_64+avx2"))]
pub fn linearise(model: &MarkModel, pixels: MarkPixels<'_>, near: &mut Near) {
    let count = pixels.x.len() / LANES;
    let (lit, coverage) = (pixels.lit, pixels.coverage);
    let [x, y, seen] = [pixels.x, pixels.y, pixels.seen].map(|list| &groups(list)[..count]);
    let [light, slope_x, slope_y, bend] =
        [&lit.light, &lit.slope_x, &lit.slope_y, &lit.bend].map(|list| &groups(list)[..count]);
    let [share, share_x, share_y] =
        [&coverage.share, &coverage.slope_x, &coverage.slope_y].map(|list| &groups(list)[..count]);
    near.pixels.clear();
    near.allowed.clear();
    for n in 0..count {
        let mut found = [[0.0; LANES]; UNKNOWNS + 1];
        let mut allowed = [0.0; LANES];
        for k in 0..LANES {
            let here = Pixel {
                x: x[n][k],
                y: y[n][k],
                seen: seen[n][k],
                light: light[n][k],
                slope_x: slope_x[n][k],
                slope_y: slope_y[n][k],
                bend: bend[n][k],
                cover: [share[n][k], share_x[n][k], share_y[n][k]],
            };
            let values;
            (values, allowed[k]) = near_pixel(model, &here);
            for (found, value) in found.iter_mut().zip(values) {
                found[k] = value;
            }
        }
        near.pixels.push(found);
        near.allowed.push(allowed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_coverage_is_that_of_the_blurred_cross_and_its_slopes() {
        const BARS: Bars = Bars {
            half_length: 7.8,
            half_width: 1.05,
            per_blur: 1.0 / 0.95,
        };
        // The blurred cross by its definition, rotated by 0.3 rad.
        let share = |x: f64, y: f64| {
            let (sin, cos) = 0.3_f64.sin_cos();
            let (u, v) = (cos * x + sin * y, cos * y - sin * x);
            let below = |at: f64| {
                0.5 * libm::erfc(-at * f64::from(BARS.per_blur) / std::f64::consts::SQRT_2)
            };
            let bar =
                |at: f64, half: f32| below(at + f64::from(half)) - below(at - f64::from(half));
            let (long_u, long_v) = (bar(u, BARS.half_length), bar(v, BARS.half_length));
            let (wide_u, wide_v) = (bar(u, BARS.half_width), bar(v, BARS.half_width));
            long_u * wide_v + wide_u * long_v - wide_u * wide_v
        };
        let places = |n: i32| (f64::from(n) * 0.41 - 12.0, f64::from(n) * 0.17 - 5.0);
        let (x, y): (Vec<f32>, Vec<f32>) = (0..60)
            .map(places)
            .map(|(x, y)| (x as f32, y as f32))
            .unzip();
        let (sin, cos) = 0.3_f32.sin_cos();
        let mut found = Coverage::default();
        let offsets = Offsets {
            from: [0.0; 2],
            x: &x,
            y: &y,
        };
        cover(&BARS, [cos, sin, -sin, cos], offsets, &mut found);
        for (n, (x, y)) in (0..60).map(places).enumerate() {
            assert!((f64::from(found.share[n]) - share(x, y)).abs() < 3e-5);
            const H: f64 = 1e-4;
            let slope_x = (share(x + H, y) - share(x - H, y)) / (2.0 * H);
            let slope_y = (share(x, y + H) - share(x, y - H)) / (2.0 * H);
            assert!((f64::from(found.slope_x[n]) - slope_x).abs() < 3e-5);
            assert!((f64::from(found.slope_y[n]) - slope_y).abs() < 3e-5);
        }
    }
}
