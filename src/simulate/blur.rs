//! Blur and pixel integration in one separable kernel, applied to sub-samples.

use super::coverage::TENT_VARIANCE;

/// Half the width of the kernel, in sigma: 1e-5 of the light is beyond.
const REACH_SIGMA: f64 = 4.5;

/// The kernel that reduces S sub-samples per pixel to pixels.
#[derive(Debug, Clone)]
pub(super) struct Kernel {
    samples_per_px: usize,
    /// Taps before the pixel's first sub-sample and after its last.
    reach: usize,
    weights: Vec<f32>,
}

impl Kernel {
    /// Gaussian of `blur_px` (1 sigma), integrated over the pixel.
    ///
    /// A sub-sample already represents the mean over its own small square, so a plain mean of S x S of them is the
    /// pixel's integral. The blur by the sub-sample's tent beyond that square is subtracted from the Gaussian.
    pub(super) fn new(blur_px: f64, samples_per_px: usize) -> Self {
        let sigma = (blur_px * samples_per_px as f64).powi(2) - TENT_VARIANCE;
        let sigma = sigma.max(0.0).sqrt();
        let reach = (REACH_SIGMA * sigma).ceil() as usize;
        let gauss = |tap: f64| {
            if sigma > 0.0 {
                (-0.5 * (tap / sigma).powi(2)).exp()
            } else {
                1.0
            }
        };
        let mut weights = vec![0.0; 2 * reach + samples_per_px];
        for shift in 0..samples_per_px {
            for tap in 0..=2 * reach {
                weights[shift + tap] += gauss(tap as f64 - reach as f64);
            }
        }
        let sum: f64 = weights.iter().sum();
        Self {
            samples_per_px,
            reach,
            weights: weights.iter().map(|w| (w / sum) as f32).collect(),
        }
    }

    /// Width of the margin around a window whose light reaches into it.
    pub(super) fn margin_px(&self) -> usize {
        self.reach.div_ceil(self.samples_per_px)
    }

    /// Blurs a field of sub-samples, `columns` in a row, that covers `width` x `height` pixels and the margin around
    /// them; gives those pixels row by row.
    pub(super) fn apply(
        &self,
        field: &[f32],
        columns: usize,
        width: usize,
        height: usize,
    ) -> Vec<f32> {
        let first = self.margin_px() * self.samples_per_px - self.reach;
        let mut pixels = Vec::with_capacity(width * height);
        let mut blurred = vec![0.0_f32; columns];
        for y in 0..height {
            blurred.fill(0.0);
            let top = first + y * self.samples_per_px;
            for (tap, &weight) in self.weights.iter().enumerate() {
                let row = &field[(top + tap) * columns..][..columns];
                for (sum, &value) in blurred.iter_mut().zip(row) {
                    *sum += weight * value;
                }
            }
            pixels.extend((0..width).map(|x| {
                let taps = &blurred[first + x * self.samples_per_px..];
                dot(&self.weights, taps)
            }));
        }
        pixels
    }
}

/// Sum of products, in four lanes that the processor adds in parallel.
fn dot(weights: &[f32], values: &[f32]) -> f32 {
    let values = &values[..weights.len()];
    let mut lanes = [0.0_f32; 4];
    let (w4, v4) = (weights.chunks_exact(4), values.chunks_exact(4));
    let rest: f32 = w4
        .remainder()
        .iter()
        .zip(v4.remainder())
        .map(|(w, v)| w * v)
        .sum();
    for (w, v) in w4.zip(v4) {
        for lane in 0..4 {
            lanes[lane] += w[lane] * v[lane];
        }
    }
    lanes.iter().sum::<f32>() + rest
}
