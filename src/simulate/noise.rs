//! Conversion of light to digital numbers: noise and digitisation.

use super::scene::{Depth, Noise};
use super::{Purpose, generator};
use crate::frame::Pixels;
use rand::RngExt;
use rand_distr::StandardNormal;

/// Readout of a sensor.
#[derive(Debug, Clone, Copy)]
pub(super) struct Readings {
    pub width_px: usize,
    pub noise: Noise,
    pub depth: Depth,
    pub seed: u64,
}

/// Adds noise to the light (8-bit DN, row by row) and digitises it.
pub(super) fn read_out(light: &[f32], readings: &Readings) -> Pixels {
    let limit = readings.depth.saturation_dn();
    match readings.depth {
        Depth::Eight => Pixels::U8(digitised(light, readings, |dn| dn as u8)),
        Depth::Ten | Depth::Twelve | Depth::Sixteen => {
            Pixels::U16(digitised(light, readings, |dn| (dn as u16).min(limit)))
        }
    }
}

/// Row by row: first the row's random numbers, then arithmetic that the compiler can vectorise.
fn digitised<T>(light: &[f32], readings: &Readings, stored: impl Fn(f32) -> T) -> Vec<T> {
    let steps = readings.depth.steps_per_dn();
    let noise = readings.noise;
    let read_dn = noise.read_dn as f32;
    let sigma = |light: f32| match noise.electrons_per_dn {
        None => read_dn,
        Some(electrons) => (read_dn * read_dn + light.max(0.0) / electrons as f32).sqrt(),
    };
    let mut rng = generator(readings.seed, Purpose::Noise, 0);
    let mut normal = vec![0.0_f32; readings.width_px];
    let mut pixels = Vec::with_capacity(light.len());
    for row in light.chunks_exact(readings.width_px) {
        if noise != Noise::NONE {
            normal.fill_with(|| rng.sample(StandardNormal));
        }
        // Adding half a step and truncating rounds to the nearest. Numbers beyond a pixel's range are clipped.
        let dn = |(&light, normal): (&f32, &f32)| (light + sigma(light) * normal) * steps + 0.5;
        pixels.extend(row.iter().zip(&normal).map(|pixel| stored(dn(pixel))));
    }
    pixels
}
