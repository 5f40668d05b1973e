//! Random patterns: numbers at the corners of a grid in space, smooth ones between them, and along a limb's circle.

use super::{Purpose, derived_seed, generator};
use nalgebra::Vector3;
use rand::RngExt;
use rand_distr::StandardNormal;

/// A random number at every corner of a grid in space.
#[derive(Debug, Clone, Copy)]
pub(super) struct Random {
    seed: u64,
}

impl Random {
    pub fn new(purpose: Purpose, seed: u64, number: u64) -> Self {
        Self {
            seed: derived_seed(seed, purpose, number),
        }
    }

    /// 0 to 1; each `which` has numbers of its own.
    pub fn at(&self, corner: &Vector3<f64>, which: u64) -> f64 {
        // The mixing of SplitMix64 (Steele, Lea and Flood 2014).
        let mix = |bits: u64| {
            let bits = (bits ^ bits >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let bits = (bits ^ bits >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
            bits ^ bits >> 31
        };
        let bits = corner.iter().fold(mix(self.seed ^ which), |bits, v| {
            mix(bits.wrapping_add(0x9e37_79b9_7f4a_7c15) ^ (*v as i64 as u64))
        });
        (bits >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Value noise in several octaves, each half as strong and twice as fine as the one before.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pattern {
    random: Random,
}

impl Pattern {
    const OCTAVES: i32 = 5;

    pub fn new(purpose: Purpose, seed: u64, number: u64) -> Self {
        Self {
            random: Random::new(purpose, seed, number),
        }
    }

    /// 0 to 1, about a half, at a place in units of the coarsest cell.
    pub fn at(&self, place: &Vector3<f64>) -> f64 {
        let octave = |n: i32| {
            let scale = 2.0_f64.powi(n);
            self.one_octave(&(place * scale), n as u64) / scale
        };
        let most: f64 = (0..Self::OCTAVES).map(|n| 0.5_f64.powi(n)).sum();
        (0..Self::OCTAVES).map(octave).sum::<f64>() / most
    }

    fn one_octave(&self, place: &Vector3<f64>, octave: u64) -> f64 {
        let cell = place.map(f64::floor);
        let smooth = (place - cell).map(|t| t * t * (3.0 - 2.0 * t));
        let corner = |n: u32| {
            let offset = Vector3::new(n & 1, n >> 1 & 1, n >> 2 & 1).map(f64::from);
            let weights = offset.zip_map(&smooth, |o, t| if o > 0.5 { t } else { 1.0 - t });
            weights.product() * self.random.at(&(cell + offset), octave)
        };
        (0..8).map(corner).sum()
    }
}

/// A random function of the azimuth with variance 1, correlated as a Gaussian.
#[derive(Debug, Clone)]
pub(super) struct AlongLimb {
    values: Vec<f64>,
}

impl AlongLimb {
    const STEPS: usize = 720;

    /// The correlation falls to 1/e over `length_deg`.
    pub fn new(length_deg: f64, purpose: Purpose, seed: u64, number: u64) -> Self {
        let mut random = generator(seed, purpose, number);
        let white: Vec<f64> = (0..Self::STEPS)
            .map(|_| random.sample(StandardNormal))
            .collect();
        // White noise through a Gaussian of half the width has a correlation of this one.
        let width = length_deg / 360.0 * Self::STEPS as f64 / 2.0;
        let weight = |n: usize| {
            let away = n.min(Self::STEPS - n) as f64;
            (-0.5 * (away / width).powi(2)).exp()
        };
        let weights: Vec<f64> = (0..Self::STEPS).map(weight).collect();
        let norm = weights.iter().map(|w| w * w).sum::<f64>().sqrt();
        let at = |n: usize| {
            let pairs = weights.iter().enumerate();
            pairs
                .map(|(k, w)| w * white[(n + k) % Self::STEPS])
                .sum::<f64>()
                / norm
        };
        Self {
            values: (0..Self::STEPS).map(at).collect(),
        }
    }

    pub fn at(&self, azimuth_rad: f64) -> f64 {
        let turns = (azimuth_rad / std::f64::consts::TAU).rem_euclid(1.0);
        let place = turns * Self::STEPS as f64;
        let (n, part) = (place as usize % Self::STEPS, place.fract());
        let next = self.values[(n + 1) % Self::STEPS];
        self.values[n] + part * (next - self.values[n])
    }
}
