//! The cross as the camera sees it, and the kernels that look for it.

use super::FlatDisc;
use super::coverage::{BlurredCross, Pose};
use crate::lanes::{LANES, groups, smaller, split};
use multiversion::multiversion;
use std::f32::consts::FRAC_PI_4;

/// The pixels within a radius of one of them: a square about it, row by row, each row filled up to whole lanes. Weights for
/// them are nothing outside the radius.
#[derive(Debug, Clone)]
pub(super) struct Support {
    /// Pixels from the middle to the edge, in both axes.
    pub reach: usize,
    stride: usize,
    /// Offsets from the middle, px.
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    /// 1 within the radius and 0 outside.
    pub inside: Vec<f32>,
}

impl Support {
    pub(super) fn within(radius_px: f64) -> Self {
        let reach = radius_px as usize;
        let side = 2 * reach + 1;
        let stride = side.next_multiple_of(LANES);
        let [mut x, mut y] = [(); 2].map(|()| Vec::with_capacity(side * stride));
        for row in 0..side {
            x.extend((0..stride).map(|column| column as i32 as f32 - reach as f32));
            y.resize(y.len() + stride, row as f32 - reach as f32);
        }
        let radius2 = (radius_px * radius_px) as f32;
        let inside = |(x, y): (&f32, &f32)| f32::from(u8::from(x * x + y * y <= radius2));
        Self {
            reach,
            stride,
            inside: x.iter().zip(&y).map(inside).collect(),
            x,
            y,
        }
    }

    /// The products of weights with this support's own.
    pub(super) fn weights(&self, weights: &[f32]) -> Vec<f32> {
        let pairs = weights.iter().zip(&self.inside);
        pairs.map(|(weight, inside)| weight * inside).collect()
    }

    /// Whether the pixels about a value of the flattened disc, with one to spare, are all in its square.
    pub(super) fn fits(&self, flat: &FlatDisc, index: usize) -> bool {
        let inner = self.reach + 1..flat.side().saturating_sub(self.stride - self.reach + 1);
        inner.contains(&(index / flat.side())) && inner.contains(&(index % flat.side()))
    }

    /// The flattened disc's values from the first pixel about one of them on.
    fn values<'f>(&self, flat: &'f FlatDisc, index: usize) -> &'f [f32] {
        &flat.values()[index - self.reach * (flat.side() + 1)..]
    }

    /// The values about one of them, row by row, where the support [`fits`](Self::fits).
    pub(super) fn rows<'f>(
        &self,
        flat: &'f FlatDisc,
        index: usize,
    ) -> impl Iterator<Item = &'f [f32]> {
        let side = 2 * self.reach + 1;
        let rows = self.values(flat, index).chunks(flat.side()).take(side);
        rows.map(move |row| &row[..side])
    }

    /// The rows of what belongs to the pixels.
    pub(super) fn rows_of<'l, T>(&self, list: &'l [T]) -> impl Iterator<Item = &'l [T]> {
        list.chunks_exact(self.stride)
    }

    /// Sum of the products of weights with the values about one of them, where the support [`fits`](Self::fits).
    pub(super) fn sum(&self, weights: &[f32], flat: &FlatDisc, index: usize) -> f32 {
        let values = self.values(flat, index);
        products(weights, self.stride, values, flat.side())
    }

    /// Sum of the squared values within the radius.
    pub(super) fn squares(&self, flat: &FlatDisc, index: usize) -> f32 {
        let values = self.values(flat, index);
        squares(&self.inside, self.stride, values, flat.side())
    }
}

/// A zero-mean kernel, so that neither even ground nor a slope answers.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Kernel {
    weights: Vec<f32>,
    /// Sum of the squared weights: the response to a cross of contrast 1.
    pub energy: f64,
}

impl Kernel {
    /// The kernel of what a cross covers of a support's pixels.
    pub(super) fn of(support: &Support, shares: &[f32]) -> Self {
        let mut weights = support.weights(shares);
        let mean = weights.iter().sum::<f32>() / support.inside.iter().sum::<f32>();
        for (weight, inside) in weights.iter_mut().zip(&support.inside) {
            *weight -= mean * inside;
        }
        let energy = f64::from(weights.iter().map(|w| w * w).sum::<f32>());
        Self { weights, energy }
    }

    /// The part of that kernel that is left when its average over all rotations is taken off: what is round (a sunspot,
    /// dust) does not answer to it, a cross does with its full contrast.
    pub(super) fn fourfold(support: &Support, shares: &[f32], cross: &BlurredCross) -> Self {
        const STEPS_PER_PX: f32 = 4.0;
        let last = STEPS_PER_PX as usize * (support.reach + 1) + 1;
        let averages = rotation_averages(cross, last + 1, STEPS_PER_PX);
        let places = support.x.iter().zip(&support.y);
        let fourfold = |(share, (x, y)): (&f32, (&f32, &f32))| {
            let along = smaller((x * x + y * y).sqrt() * STEPS_PER_PX, last as f32 - 0.5);
            let (n, part) = split(along);
            let (near, far) = (averages[n as usize], averages[n as usize + 1]);
            share - near - part * (far - near)
        };
        let fourfold: Vec<f32> = shares.iter().zip(places).map(fourfold).collect();
        Self::of(support, &fourfold)
    }

    /// Contrast of the cross as the kernel sees it, centred on a value where its support fits.
    pub(super) fn response(&self, support: &Support, flat: &FlatDisc, index: usize) -> f64 {
        f64::from(support.sum(&self.weights, flat, index)) / self.energy
    }

    /// The responses centred on the value before, on this one and on the one after.
    pub(super) fn responses_beside(
        &self,
        support: &Support,
        flat: &FlatDisc,
        index: usize,
    ) -> [f64; 3] {
        let values = support.values(flat, index - 1);
        let sums = products_beside(&self.weights, support.stride, values, flat.side());
        sums.map(|lanes| f64::from(lanes.iter().sum::<f32>()) / self.energy)
    }

    /// 1 sigma of a response where the values have this noise.
    pub(super) fn noise(&self, values: f64) -> f64 {
        values / self.energy.sqrt()
    }
}

/// What a cross covers at so many distances from its middle, on average over its rotations.
fn rotation_averages(cross: &BlurredCross, count: usize, steps_per_px: f32) -> Vec<f32> {
    // An eighth of a turn and its mirror image make the whole cross.
    let angles: [f32; LANES] = std::array::from_fn(|k| (k as f32 + 0.5) / LANES as f32 * FRAC_PI_4);
    let (sines, cosines) = (angles.map(f32::sin), angles.map(f32::cos));
    let places = |units: [f32; LANES]| -> Vec<f32> {
        let radii = (0..count).map(|n| n as f32 / steps_per_px);
        radii.flat_map(|r| units.map(|unit| r * unit)).collect()
    };
    let (x, y) = (places(cosines), places(sines));
    let shares = cross.at(&x, &y, &Pose::turned(0.0)).share;
    let mean = |shares: &[f32; LANES]| shares.iter().sum::<f32>() / LANES as f32;
    shares.as_chunks::<LANES>().0.iter().map(mean).collect()
}

/// Sum of the products of weights, row by row, with values of which a row is `side` long.
#[multiversion(targets("x86_64+avx2"))]
fn products(weights: &[f32], stride: usize, values: &[f32], side: usize) -> f32 {
    let mut lanes = [0.0_f32; LANES];
    for (weights, values) in weights.chunks_exact(stride).zip(values.chunks(side)) {
        for (weights, values) in groups(weights).iter().zip(groups(&values[..stride])) {
            for k in 0..LANES {
                lanes[k] += weights[k] * values[k];
            }
        }
    }
    lanes.iter().sum()
}

/// The same, by lanes, with the values from the first, from the second and from the third on.
#[multiversion(targets("x86_64+avx2"))]
fn products_beside(
    weights: &[f32],
    stride: usize,
    values: &[f32],
    side: usize,
) -> [[f32; LANES]; 3] {
    let [mut before, mut here, mut after] = [[0.0_f32; LANES]; 3];
    for (weights, values) in weights.chunks_exact(stride).zip(values.chunks(side)) {
        let values = &values[..stride + 2];
        let (first, second, third) = (groups(values), groups(&values[1..]), groups(&values[2..]));
        let beside = first.iter().zip(second).zip(third);
        for (weights, ((first, second), third)) in groups(weights).iter().zip(beside) {
            for k in 0..LANES {
                before[k] += weights[k] * first[k];
                here[k] += weights[k] * second[k];
                after[k] += weights[k] * third[k];
            }
        }
    }
    [before, here, after]
}

/// Sum of the squares, each times its weight.
#[multiversion(targets("x86_64+avx2"))]
fn squares(weights: &[f32], stride: usize, values: &[f32], side: usize) -> f32 {
    let mut lanes = [0.0_f32; LANES];
    for (weights, values) in weights.chunks_exact(stride).zip(values.chunks(side)) {
        for (weights, values) in groups(weights).iter().zip(groups(&values[..stride])) {
            for k in 0..LANES {
                lanes[k] += weights[k] * (values[k] * values[k]);
            }
        }
    }
    lanes.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::super::coverage::CrossShape;
    use super::*;

    const SHAPE: CrossShape = CrossShape {
        half_length_px: 7.8,
        half_width_px: 1.05,
        blur_px: 0.95,
    };

    fn kernels(rotation_deg: f64) -> (Support, [Kernel; 2]) {
        let support = Support::within(SHAPE.reach_px());
        let cross = BlurredCross::new(&SHAPE);
        let pose = Pose::turned(rotation_deg);
        let shares = cross.at(&support.x, &support.y, &pose).share;
        let oriented = Kernel::of(&support, &shares);
        let fourfold = Kernel::fourfold(&support, &shares, &cross);
        (support, [oriented, fourfold])
    }

    #[test]
    fn a_cross_looks_the_same_after_a_quarter_turn() {
        let [a, b] = [7.0, 97.0].map(|turn| kernels(turn).1[0].clone());
        for (a, b) in a.weights.iter().zip(&b.weights) {
            assert!((a - b).abs() < 1e-5);
        }
    }

    #[test]
    fn what_is_round_does_not_answer_to_the_fourfold_kernel() {
        let (support, [_, kernel]) = kernels(30.0);
        for sigma in [1.5_f32, 2.5, 4.0] {
            let mut sum = 0.0;
            for (n, (x, y)) in support.x.iter().zip(&support.y).enumerate() {
                let r2 = x * x + y * y;
                sum += kernel.weights[n] * (-r2 / (2.0 * sigma * sigma)).exp();
            }
            assert!(
                f64::from(sum.abs()) < 0.01 * kernel.energy,
                "{sum} at {sigma}"
            );
        }
    }

    #[test]
    fn even_ground_does_not_answer() {
        for kernel in kernels(30.0).1 {
            assert!(kernel.weights.iter().sum::<f32>().abs() < 1e-3);
        }
    }
}
