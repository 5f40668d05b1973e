//! The matched filter's kernel, computed from the mark's geometry.

use crate::plate::Cross;
use nalgebra::Vector2;

/// The cross as the camera sees it, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CrossShape {
    pub half_length_px: f64,
    pub half_width_px: f64,
    /// Gaussian blur of lens and pixel together, 1 sigma.
    pub blur_px: f64,
}

/// Variance of a pixel's own box, px^2.
const PIXEL_VARIANCE: f64 = 1.0 / 12.0;

impl CrossShape {
    /// A cross of the plate at a scale, seen through a lens's blur by pixels of finite size.
    pub fn new(cross: &Cross, scale_mil_per_px: f64, lens_blur_px: f64) -> Self {
        Self {
            half_length_px: cross.arm_length_mil / 2.0 / scale_mil_per_px,
            half_width_px: cross.arm_width_mil / 2.0 / scale_mil_per_px,
            blur_px: (lens_blur_px.powi(2) + PIXEL_VARIANCE).sqrt(),
        }
    }

    /// The share of the light that a blurred bar covers at a distance from its middle, and its slope, per px.
    pub(super) fn bar(&self, at: f64, half: f64) -> (f64, f64) {
        let z = |edge: f64| edge / (self.blur_px * std::f64::consts::SQRT_2);
        let density = |z: f64| (-z * z).exp() / (self.blur_px * std::f64::consts::TAU.sqrt());
        let (near, far) = (z(at + half), z(at - half));
        let share = (libm::erf(near) - libm::erf(far)) / 2.0;
        (share, density(near) - density(far))
    }

    /// Coverage at an offset from the centre, along the arms' axes: two blurred bars less their common middle.
    pub(super) fn coverage(&self, u: f64, v: f64) -> f64 {
        let bar = |x: f64, half: f64| self.bar(x, half).0;
        let (long_u, long_v) = (bar(u, self.half_length_px), bar(v, self.half_length_px));
        let (wide_u, wide_v) = (bar(u, self.half_width_px), bar(v, self.half_width_px));
        long_u * wide_v + wide_u * long_v - wide_u * wide_v
    }

    /// Sum over pixels of the squared slope of the coverage along one axis: what a position's noise is divided by. A
    /// quarter turn leaves the cross as it is, so the sum is the same along every axis.
    pub(super) fn slope_energy(&self) -> f64 {
        const STEP: f64 = 0.05;
        let reach = (self.half_length_px + 2.0 * self.blur_px).ceil() as i32;
        let slope = |x: f64, y: f64| {
            (self.coverage(x + STEP, y) - self.coverage(x - STEP, y)) / (2.0 * STEP)
        };
        let pixels = (-reach..=reach).flat_map(|y| (-reach..=reach).map(move |x| (x, y)));
        pixels.map(|(x, y)| slope(x.into(), y.into()).powi(2)).sum()
    }

    fn coverage_at_rotation(&self, dx: f64, dy: f64, rotation_rad: f64) -> f64 {
        let (sin, cos) = rotation_rad.sin_cos();
        self.coverage(cos * dx + sin * dy, -sin * dx + cos * dy)
    }
}

/// One tap of a kernel: an offset from the middle and its weights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Tap {
    pub dx: isize,
    pub dy: isize,
    /// Coverage less its mean: what is correlated with.
    pub weight: f32,
}

/// A zero-mean kernel on a round support, so that neither even ground nor a slope answers.
#[derive(Debug, Clone, PartialEq)]
pub struct Kernel {
    pub(super) taps: Vec<Tap>,
    /// Sum of the squared weights: the response to a cross of contrast 1.
    pub energy: f64,
}

impl Kernel {
    /// The kernel of a cross whose arms are rotated from the sensor's axes.
    pub fn oriented(shape: &CrossShape, rotation_deg: f64) -> Self {
        let rotation = rotation_deg.to_radians();
        Self::from_coverage(shape, |d| shape.coverage_at_rotation(d.x, d.y, rotation))
    }

    /// The kernel averaged over all rotations.
    pub fn round(shape: &CrossShape) -> Self {
        const STEPS: usize = 12;
        Self::from_coverage(shape, |d| {
            let quarter = std::f64::consts::FRAC_PI_2;
            let turns = (0..STEPS).map(|n| n as f64 / STEPS as f64 * quarter);
            turns
                .map(|turn| shape.coverage_at_rotation(d.x, d.y, turn))
                .sum::<f64>()
                / STEPS as f64
        })
    }

    /// The farthest tap from the middle in either axis, px.
    pub(super) fn reach(&self) -> usize {
        let farthest = self.taps.iter().map(|tap| tap.dx.unsigned_abs()).max();
        farthest.unwrap_or(0)
    }

    fn from_coverage(shape: &CrossShape, coverage: impl Fn(Vector2<f64>) -> f64) -> Self {
        let reach = shape.half_length_px + 2.0 * shape.blur_px;
        let side = reach.ceil() as isize;
        let offsets: Vec<(isize, isize)> = (-side..=side)
            .flat_map(|dy| (-side..=side).map(move |dx| (dx, dy)))
            .filter(|(dx, dy)| (dx * dx + dy * dy) as f64 <= reach * reach)
            .collect();
        let values: Vec<f64> = offsets
            .iter()
            .map(|(dx, dy)| coverage(Vector2::new(*dx as f64, *dy as f64)))
            .collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        Self {
            energy: values.iter().map(|v| (v - mean).powi(2)).sum(),
            taps: offsets
                .iter()
                .zip(&values)
                .map(|((dx, dy), value)| Tap {
                    dx: *dx,
                    dy: *dy,
                    weight: (value - mean) as f32,
                })
                .collect(),
        }
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

    #[test]
    fn a_cross_looks_the_same_after_a_quarter_turn() {
        let (a, b) = (
            Kernel::oriented(&SHAPE, 7.0),
            Kernel::oriented(&SHAPE, 97.0),
        );
        for (ta, tb) in a.taps.iter().zip(&b.taps) {
            assert!((ta.weight - tb.weight).abs() < 1e-6);
        }
    }

    #[test]
    fn the_round_kernel_is_the_same_in_every_direction() {
        let kernel = Kernel::round(&SHAPE);
        let weight = |x: isize, y: isize| {
            let tap = kernel.taps.iter().find(|tap| (tap.dx, tap.dy) == (x, y));
            tap.unwrap().weight
        };
        for [a, b] in [[(5, 0), (3, 4)], [(0, 5), (-4, 3)]] {
            assert!((weight(a.0, a.1) - weight(b.0, b.1)).abs() < 0.005);
        }
    }

    #[test]
    fn even_ground_does_not_answer() {
        for kernel in [Kernel::oriented(&SHAPE, 30.0), Kernel::round(&SHAPE)] {
            let sum: f32 = kernel.taps.iter().map(|t| t.weight).sum();
            assert!(sum.abs() < 1e-4);
        }
    }

    #[test]
    fn the_cross_has_the_area_of_its_arms() {
        let (length, width) = (2.0 * SHAPE.half_length_px, 2.0 * SHAPE.half_width_px);
        let area: f64 = (-15..=15)
            .flat_map(|y| (-15..=15).map(move |x| (f64::from(x), f64::from(y))))
            .map(|(x, y)| SHAPE.coverage_at_rotation(x, y, 0.3))
            .sum();
        assert!((area - (2.0 * length * width - width * width)).abs() < 1e-3);
    }
}
