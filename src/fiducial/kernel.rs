//! The cross as the camera sees it, and the kernels that look for it.

use super::FlatDisc;
use super::profile::Profile;
use crate::frame::PIXEL_VARIANCE_PX2;
use crate::plate::Cross;
use multiversion::multiversion;
use std::sync::LazyLock;

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

    /// The share of the light that a blurred bar covers at a distance from its middle, and its slope, per px.
    pub(super) fn bar(&self, at: f64, half: f64) -> (f64, f64) {
        let [near, far] = [at + half, at - half].map(|edge| normal(edge / self.blur_px));
        (near.0 - far.0, (near.1 - far.1) / self.blur_px)
    }

    /// How far from its middle the cross changes the picture, px.
    pub(super) fn reach_px(&self) -> f64 {
        self.half_length_px + 2.0 * self.blur_px
    }
}

/// The normal distribution and its density, from a table: straight lines between its entries miss by 4e-6 at most.
fn normal(z: f64) -> (f64, f64) {
    const PER_SIGMA: f64 = 128.0;
    const LAST_SIGMA: f64 = 6.0;
    static TABLE: LazyLock<Vec<(f64, f64)>> = LazyLock::new(|| {
        let entry = |n: usize| {
            let z = n as f64 / PER_SIGMA - LAST_SIGMA;
            let below = 0.5 * libm::erfc(-z / std::f64::consts::SQRT_2);
            (below, (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt())
        };
        let last = (2.0 * LAST_SIGMA * PER_SIGMA) as usize + 1;
        (0..=last).map(entry).collect()
    });
    let along = (z.clamp(-LAST_SIGMA, LAST_SIGMA) + LAST_SIGMA) * PER_SIGMA;
    let n = along as usize;
    let part = along - n as f64;
    let (here, next) = (TABLE[n], TABLE[n + 1]);
    (
        here.0 + part * (next.0 - here.0),
        here.1 + part * (next.1 - here.1),
    )
}

/// A zero-mean kernel on a round support, so that neither even ground nor a slope answers.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Kernel {
    /// Pixels from the middle to the edge, in both axes.
    pub reach: usize,
    /// Row by row, each row filled up with zeros to whole lanes.
    weights: Vec<f32>,
    stride: usize,
    /// Sum of the squared weights: the response to a cross of contrast 1.
    pub energy: f64,
}

/// Products that the processor makes side by side.
const LANES: usize = 8;

impl Kernel {
    /// The kernel of a cross whose arms are rotated from the sensor's axes.
    pub(super) fn oriented(shape: &CrossShape, profile: &Profile, rotation_deg: f64) -> Self {
        let (sin, cos) = rotation_deg.to_radians().sin_cos();
        let (sin, cos) = (sin as f32, cos as f32);
        let coverage =
            |x: f32, y: f32| profile.coverage(cos * x + sin * y, cos * y - sin * x).share;
        Self::from_coverage(shape, coverage)
    }

    /// The part of that kernel that is left when its average over all rotations is taken off: what is round (a sunspot,
    /// dust) does not answer to it, a cross does with its full contrast.
    pub(super) fn fourfold(shape: &CrossShape, profile: &Profile, rotation_deg: f64) -> Self {
        const STEPS_PER_PX: f32 = 4.0;
        const ANGLES: usize = 12;
        let average = |n: usize| {
            let r = n as f32 / STEPS_PER_PX;
            // An eighth of a turn and its mirror image make the whole cross.
            let angles =
                (0..ANGLES).map(|k| (k as f32 + 0.5) / ANGLES as f32 * std::f32::consts::FRAC_PI_4);
            let shares =
                angles.map(|angle| profile.coverage(r * angle.cos(), r * angle.sin()).share);
            shares.sum::<f32>() / ANGLES as f32
        };
        let last = (shape.reach_px() as f32 * STEPS_PER_PX) as usize + 2;
        let averages: Vec<f32> = (0..=last).map(average).collect();
        let (sin, cos) = rotation_deg.to_radians().sin_cos();
        let (sin, cos) = (sin as f32, cos as f32);
        Self::from_coverage(shape, |x, y| {
            let along = x.hypot(y) * STEPS_PER_PX;
            let n = (along as usize).min(last - 1);
            let round = averages[n] + (along - n as f32) * (averages[n + 1] - averages[n]);
            profile.coverage(cos * x + sin * y, cos * y - sin * x).share - round
        })
    }

    fn from_coverage(shape: &CrossShape, coverage: impl Fn(f32, f32) -> f32) -> Self {
        let radius = shape.reach_px() as f32;
        let reach = radius.ceil() as usize;
        let side = 2 * reach + 1;
        let stride = side.next_multiple_of(LANES);
        let mut weights = vec![0.0; side * stride];
        let mut inside = Vec::new();
        for row in 0..side {
            for column in 0..side {
                let (x, y) = (column as f32 - reach as f32, row as f32 - reach as f32);
                if x * x + y * y <= radius * radius {
                    weights[row * stride + column] = coverage(x, y);
                    inside.push(row * stride + column);
                }
            }
        }
        let mean = inside.iter().map(|n| weights[*n]).sum::<f32>() / inside.len() as f32;
        inside.iter().for_each(|n| weights[*n] -= mean);
        let energy = weights.iter().map(|w| f64::from(w * w)).sum();
        Self {
            reach,
            weights,
            stride,
            energy,
        }
    }

    /// Whether the kernel, laid on a value with one pixel to spare, stays within the flattened disc's square.
    pub(super) fn fits(&self, flat: &FlatDisc, index: usize) -> bool {
        let inner = self.reach + 1..flat.side().saturating_sub(self.stride - self.reach + 1);
        inner.contains(&(index / flat.side())) && inner.contains(&(index % flat.side()))
    }

    /// Contrast of the cross as the kernel sees it, centred on a value where it [`fits`](Self::fits).
    pub(super) fn response(&self, flat: &FlatDisc, index: usize) -> f64 {
        let first = index - self.reach * (flat.side() + 1);
        let values = &flat.values()[first..];
        respond(&self.weights, self.stride, values, flat.side()) / self.energy
    }

    /// 1 sigma of a response where the values have this noise.
    pub(super) fn noise(&self, values: f64) -> f64 {
        values / self.energy.sqrt()
    }
}

/// Sum of the products of weights, row by row, with values of which a row is `side` long.
#[multiversion(targets("x86_64+avx2"))]
fn respond(weights: &[f32], stride: usize, values: &[f32], side: usize) -> f64 {
    let mut lanes = [0.0_f32; LANES];
    for (row, weights) in weights.chunks_exact(stride).enumerate() {
        let values = &values[row * side..][..stride];
        let pairs = weights.chunks_exact(LANES).zip(values.chunks_exact(LANES));
        for (weights, values) in pairs {
            for lane in 0..LANES {
                lanes[lane] += weights[lane] * values[lane];
            }
        }
    }
    f64::from(lanes.iter().sum::<f32>())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPE: CrossShape = CrossShape {
        half_length_px: 7.8,
        half_width_px: 1.05,
        blur_px: 0.95,
    };

    fn weight(kernel: &Kernel, x: isize, y: isize) -> f32 {
        let place = |v: isize| kernel.reach.wrapping_add_signed(v);
        kernel.weights[place(y) * kernel.stride + place(x)]
    }

    #[test]
    fn a_cross_looks_the_same_after_a_quarter_turn() {
        let profile = Profile::new(&SHAPE);
        let [a, b] = [7.0, 97.0].map(|turn| Kernel::oriented(&SHAPE, &profile, turn));
        for (a, b) in a.weights.iter().zip(&b.weights) {
            assert!((a - b).abs() < 1e-5);
        }
    }

    #[test]
    fn what_is_round_does_not_answer_to_the_fourfold_kernel() {
        let kernel = Kernel::fourfold(&SHAPE, &Profile::new(&SHAPE), 30.0);
        for sigma in [1.5_f32, 2.5, 4.0] {
            let mut sum = 0.0;
            for (x, y) in (-10..=10).flat_map(|y| (-10..=10).map(move |x| (x, y))) {
                let r2 = (x * x + y * y) as f32;
                sum += weight(&kernel, x, y) * (-r2 / (2.0 * sigma * sigma)).exp();
            }
            assert!(
                f64::from(sum.abs()) < 0.01 * kernel.energy,
                "{sum} at {sigma}"
            );
        }
    }

    #[test]
    fn even_ground_does_not_answer() {
        let profile = Profile::new(&SHAPE);
        let kernels = [
            Kernel::oriented(&SHAPE, &profile, 30.0),
            Kernel::fourfold(&SHAPE, &profile, 30.0),
        ];
        for kernel in kernels {
            assert!(kernel.weights.iter().sum::<f32>().abs() < 1e-3);
        }
    }
}
