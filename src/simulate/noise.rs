//! From light to digital numbers: noise and depth.

use super::scene::{Depth, Noise};
use super::{Purpose, generator};
use crate::frame::Pixels;
use rand::RngExt;
use rand_distr::StandardNormal;

/// How a sensor is read.
#[derive(Debug, Clone, Copy)]
pub(super) struct Readings {
    pub width_px: usize,
    pub noise: Noise,
    pub depth: Depth,
    pub seed: u64,
}

/// Adds noise to the light (8-bit DN, row by row) and digitises it.
pub(super) fn read_out(light: &[f32], readings: &Readings) -> Pixels {
    match readings.depth {
        Depth::Eight => Pixels::U8(digitised(light, readings, |dn| dn as u8)),
        Depth::Twelve => Pixels::U16(digitised(light, readings, |dn| dn as u16)),
    }
}

/// Row by row: first the row's random numbers, then arithmetic that the compiler can do for many pixels at once.
fn digitised<T>(light: &[f32], readings: &Readings, stored: impl Fn(f32) -> T) -> Vec<T> {
    let steps = readings.depth.steps_per_dn();
    let limit = f32::from(readings.depth.saturation_dn());
    let read_variance = readings.noise.read_dn.powi(2) as f32;
    let photon_variance = readings
        .noise
        .electrons_per_dn
        .map_or(0.0, |e| 1.0 / e as f32);
    let mut rng = generator(readings.seed, Purpose::Noise, 0);
    let mut normal = vec![0.0_f32; readings.width_px];
    let mut pixels = Vec::with_capacity(light.len());
    for row in light.chunks_exact(readings.width_px) {
        if read_variance + photon_variance > 0.0 {
            normal.fill_with(|| rng.sample(StandardNormal));
        }
        pixels.extend(row.iter().zip(&normal).map(|(&light, normal)| {
            let sigma = (read_variance + light.max(0.0) * photon_variance).sqrt();
            // Half a step up and cut off: the nearest step.
            let dn = (light + sigma * normal) * steps + 0.5;
            stored(dn.clamp(0.0, limit))
        }));
    }
    pixels
}
