//! The cross as the camera sees it, and the kernels that look for it.

use super::FlatDisc;
use super::coverage::{BlurredCross, Pose};
use crate::frame::PIXEL_VARIANCE_PX2;
use crate::lanes::LANES;
use crate::plate::Cross;
use multiversion::multiversion;

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

    /// How far from its middle the cross changes the picture, px.
    pub(super) fn reach_px(&self) -> f64 {
        self.half_length_px + 2.0 * self.blur_px
    }
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

impl Kernel {
    /// The kernel of a cross whose arms are rotated from the sensor's axes.
    pub(super) fn oriented(shape: &CrossShape, cross: &BlurredCross, rotation_deg: f64) -> Self {
        let support = Support::of(shape);
        let shares = cross.at(&support.x, &support.y, &Pose::turned(rotation_deg));
        support.kernel(&shares.share)
    }

    /// The part of that kernel that is left when its average over all rotations is taken off: what is round (a sunspot,
    /// dust) does not answer to it, a cross does with its full contrast.
    pub(super) fn fourfold(shape: &CrossShape, cross: &BlurredCross, rotation_deg: f64) -> Self {
        const STEPS_PER_PX: f32 = 4.0;
        let support = Support::of(shape);
        let last = (shape.reach_px() as f32 * STEPS_PER_PX) as usize + 2;
        let radii = (0..=last).map(|n| n as f32 / STEPS_PER_PX);
        let averages = rotation_averages(cross, radii);
        let mut shares = cross
            .at(&support.x, &support.y, &Pose::turned(rotation_deg))
            .share;
        for ((share, x), y) in shares.iter_mut().zip(&support.x).zip(&support.y) {
            let along = (x * x + y * y).sqrt() * STEPS_PER_PX;
            let n = (along as usize).min(last - 1);
            *share -= averages[n] + (along - n as f32) * (averages[n + 1] - averages[n]);
        }
        support.kernel(&shares)
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

/// What a cross covers at distances from its middle, on average over its rotations.
fn rotation_averages(cross: &BlurredCross, radii: impl Iterator<Item = f32>) -> Vec<f32> {
    const ANGLES: usize = 12;
    // An eighth of a turn and its mirror image make the whole cross.
    let angles: [f32; ANGLES] =
        std::array::from_fn(|k| (k as f32 + 0.5) / ANGLES as f32 * std::f32::consts::FRAC_PI_4);
    let places = radii.flat_map(|r| angles.map(|angle| (r * angle.cos(), r * angle.sin())));
    let (x, y): (Vec<f32>, Vec<f32>) = places.unzip();
    let shares = cross.at(&x, &y, &Pose::turned(0.0)).share;
    let mean = |shares: &[f32]| shares.iter().sum::<f32>() / ANGLES as f32;
    shares.chunks_exact(ANGLES).map(mean).collect()
}

/// The round support of a kernel: its pixels' offsets from the middle, px.
struct Support {
    reach: usize,
    x: Vec<f32>,
    y: Vec<f32>,
}

impl Support {
    fn of(shape: &CrossShape) -> Self {
        let radius = shape.reach_px() as f32;
        let reach = radius.ceil() as i32;
        let square = (-reach..=reach).flat_map(|y| (-reach..=reach).map(move |x| (x, y)));
        let (x, y) = square
            .map(|(x, y)| (x as f32, y as f32))
            .filter(|(x, y)| x * x + y * y <= radius * radius)
            .unzip();
        Self {
            reach: reach as usize,
            x,
            y,
        }
    }

    /// The kernel of values on the support's pixels, their mean taken off.
    fn kernel(&self, values: &[f32]) -> Kernel {
        let reach = self.reach;
        let side = 2 * reach + 1;
        let stride = side.next_multiple_of(LANES);
        let mut weights = vec![0.0; side * stride];
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        for ((value, x), y) in values.iter().zip(&self.x).zip(&self.y) {
            let place = |offset: f32| (offset + reach as f32) as usize;
            weights[place(*y) * stride + place(*x)] = value - mean;
        }
        let energy = weights.iter().map(|w| f64::from(w * w)).sum();
        Kernel {
            reach,
            weights,
            stride,
            energy,
        }
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
        let cross = BlurredCross::new(&SHAPE);
        let [a, b] = [7.0, 97.0].map(|turn| Kernel::oriented(&SHAPE, &cross, turn));
        for (a, b) in a.weights.iter().zip(&b.weights) {
            assert!((a - b).abs() < 1e-5);
        }
    }

    #[test]
    fn what_is_round_does_not_answer_to_the_fourfold_kernel() {
        let kernel = Kernel::fourfold(&SHAPE, &BlurredCross::new(&SHAPE), 30.0);
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
        let cross = BlurredCross::new(&SHAPE);
        let kernels = [
            Kernel::oriented(&SHAPE, &cross, 30.0),
            Kernel::fourfold(&SHAPE, &cross, 30.0),
        ];
        for kernel in kernels {
            assert!(kernel.weights.iter().sum::<f32>().abs() < 1e-3);
        }
    }
}
