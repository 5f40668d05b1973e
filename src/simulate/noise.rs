//! From light to digital numbers: noise and depth.

use super::scene::Scene;
use super::{Purpose, generator};
use crate::frame::Pixels;
use rand::RngExt;
use rand_distr::StandardNormal;

/// Noise of a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Additive Gaussian noise, 1 sigma.
    pub read_dn: f64,
    /// Photo-electrons of one DN; with it, photons add noise of variance signal / gain, drawn from a Gaussian.
    pub electrons_per_dn: Option<f64>,
}

impl Noise {
    pub const NONE: Self = Self::read(0.0);

    /// Additive noise alone.
    pub const fn read(read_dn: f64) -> Self {
        Self {
            read_dn,
            electrons_per_dn: None,
        }
    }
}

/// How finely the camera digitises.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Depth {
    /// 8 bits, saturating at 255.
    Eight,
    /// 12 bits in 16, saturating at 4095; 16 of its steps make one of the 8-bit camera's.
    Twelve,
}

impl Depth {
    /// Where a pixel saturates, in the camera's own DN.
    pub fn saturation_dn(self) -> u16 {
        match self {
            Self::Eight => 255,
            Self::Twelve => 4095,
        }
    }

    /// The camera's own DN in one 8-bit DN.
    fn steps_per_dn(self) -> f32 {
        match self {
            Self::Eight => 1.0,
            Self::Twelve => 16.0,
        }
    }
}

/// Adds the scene's noise to the light (8-bit DN, row by row) and digitises it.
pub(super) fn read_out(light: &[f32], scene: &Scene) -> Pixels {
    let steps = scene.depth.steps_per_dn();
    let limit = f32::from(scene.depth.saturation_dn());
    // Half a step up and cut off: the nearest step.
    let digitised = |dn: f32| (dn * steps + 0.5).clamp(0.0, limit);
    let mut noisy = noise_source(scene);
    match scene.depth {
        Depth::Eight => Pixels::U8(light.iter().map(|&l| digitised(noisy(l)) as u8).collect()),
        Depth::Twelve => Pixels::U16(light.iter().map(|&l| digitised(noisy(l)) as u16).collect()),
    }
}

/// What a pixel's light becomes, pixel after pixel.
fn noise_source(scene: &Scene) -> impl FnMut(f32) -> f32 {
    let read = scene.noise.read_dn as f32;
    let photon_variance = scene.noise.electrons_per_dn.map_or(0.0, |e| 1.0 / e as f32);
    let mut rng = generator(scene.seed, Purpose::Noise, 0);
    move |light| {
        let sigma = if photon_variance > 0.0 {
            (read * read + light.max(0.0) * photon_variance).sqrt()
        } else {
            read
        };
        if sigma > 0.0 {
            light + sigma * rng.sample::<f32, _>(StandardNormal)
        } else {
            light
        }
    }
}
