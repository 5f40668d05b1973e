//! Random patterns: values at the corners of a grid in space, smooth interpolation between them, and functions along the limb's circle.

use super::{Purpose, derived_seed};
use nalgebra::{Vector2, Vector3};
use rand::{Rng, RngExt};
use rand_distr::StandardNormal;
use std::array::from_fn;
use std::cell::Cell;

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

    /// A value from 0 to 1; each `which` has values of its own.
    pub fn at(&self, corner: &Vector3<f64>, which: u64) -> f64 {
        share(corner.iter().fold(mix(self.seed ^ which), along))
    }

    /// The values at the eight corners of a cell, neighbours along x next to each other: the hash of common coordinates is computed once.
    fn around(&self, cell: &Vector3<f64>, which: u64) -> [f64; 8] {
        let next = cell.add_scalar(1.0);
        let [x, y, z] = [0, 1, 2].map(|axis| [&cell[axis], &next[axis]]);
        let start = mix(self.seed ^ which);
        let by_x = x.map(|x| along(start, x));
        let by_xy: [u64; 4] = from_fn(|n| along(by_x[n & 1], y[n >> 1]));
        from_fn(|n| share(along(by_xy[n & 3], z[n >> 2])))
    }
}

/// The mixing function of SplitMix64 (Steele, Lea and Flood 2014).
fn mix(bits: u64) -> u64 {
    let bits = (bits ^ bits >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let bits = (bits ^ bits >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ bits >> 31
}

/// Mixes an integer into the bits.
fn along(bits: u64, number: &f64) -> u64 {
    mix(bits.wrapping_add(0x9e37_79b9_7f4a_7c15) ^ (*number as i64 as u64))
}

/// A value from 0 to 1.
fn share(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1_u64 << 53) as f64
}

/// The value of the last cell: neighbouring pixels mostly lie in the same one.
pub(super) struct LastCell<T>(Cell<Option<(Vector3<f64>, T)>>);

impl<T: Copy> LastCell<T> {
    pub fn none() -> Self {
        Self(Cell::new(None))
    }

    /// The value of a cell, made if the cell is not the last one.
    pub fn value(&self, cell: &Vector3<f64>, make: impl FnOnce() -> T) -> T {
        match self.0.get() {
            Some((last, value)) if last == *cell => value,
            _ => {
                let value = make();
                self.0.set(Some((*cell, value)));
                value
            }
        }
    }
}

/// Value noise in several octaves, each with half the amplitude and half the scale of the one before.
pub(super) struct Pattern {
    random: Random,
    /// The numbers at the corners of the last cell, for each octave.
    corners: [LastCell<[f64; 8]>; Self::OCTAVES],
}

impl Pattern {
    const OCTAVES: usize = 5;

    pub fn new(purpose: Purpose, seed: u64, number: u64) -> Self {
        Self {
            random: Random::new(purpose, seed, number),
            corners: from_fn(|_| LastCell::none()),
        }
    }

    /// A value from 0 to 1, with mean 0.5, at a place in units of the coarsest cell.
    pub fn at(&self, place: &Vector3<f64>) -> f64 {
        let (mut sum, mut most, mut scale) = (0.0, 0.0, 1.0);
        for octave in 0..Self::OCTAVES {
            sum += self.one_octave(&(place * scale), octave) / scale;
            most += 1.0 / scale;
            scale *= 2.0;
        }
        sum / most
    }

    fn one_octave(&self, place: &Vector3<f64>, octave: usize) -> f64 {
        let cell = place.map(f64::floor);
        let smooth = (place - cell).map(|t| t * t * (3.0 - 2.0 * t));
        let around = || self.random.around(&cell, octave as u64);
        let corners = self.corners[octave].value(&cell, around);
        let between = |a: f64, b: f64, t: f64| a + t * (b - a);
        let edges: [f64; 4] = from_fn(|n| between(corners[2 * n], corners[2 * n + 1], smooth.x));
        let faces: [f64; 2] = from_fn(|n| between(edges[2 * n], edges[2 * n + 1], smooth.y));
        between(faces[0], faces[1], smooth.z)
    }
}

/// Two random functions of the azimuth with a Gaussian correlation.
#[derive(Debug, Clone)]
pub(super) struct AlongLimb {
    /// Empty if nothing varies.
    values: Vec<Vector2<f64>>,
}

impl AlongLimb {
    const STEPS: usize = 720;

    /// Functions with these 1 sigmas, zero if that is 0; the correlation falls to 1/e over `length_deg`.
    pub fn new(sigmas: [f64; 2], length_deg: f64, random: [impl Rng; 2]) -> Self {
        if sigmas == [0.0; 2] {
            return Self { values: Vec::new() };
        }
        let white = random
            .map(|mut random| -> [f64; Self::STEPS] { from_fn(|_| random.sample(StandardNormal)) });
        // White noise filtered with a Gaussian of half this width has a correlation of this width.
        let width = length_deg / 360.0 * Self::STEPS as f64 / 2.0;
        let weights: [f64; Self::STEPS] = from_fn(|n| {
            let away = n.min(Self::STEPS - n) as f64;
            (-0.5 * (away / width).powi(2)).exp()
        });
        let norm = weights.iter().map(|w| w * w).sum::<f64>().sqrt();
        let value = |n: usize, which: usize| {
            let pairs = weights.iter().enumerate();
            let sum: f64 = pairs
                .map(|(k, w)| w * white[which][(n + k) % Self::STEPS])
                .sum();
            sum / (norm / sigmas[which])
        };
        let at = |n| Vector2::new(value(n, 0), value(n, 1));
        Self {
            values: (0..Self::STEPS).map(at).collect(),
        }
    }

    /// The two values in the direction of a ray (north, east, down).
    pub fn at(&self, ray: &Vector3<f64>) -> Vector2<f64> {
        if self.values.is_empty() {
            return Vector2::zeros();
        }
        let turns = (ray.y.atan2(ray.x) / std::f64::consts::TAU).rem_euclid(1.0);
        let place = turns * Self::STEPS as f64;
        let (n, part) = (place as usize % Self::STEPS, place.fract());
        let next = self.values[(n + 1) % Self::STEPS];
        self.values[n] + (next - self.values[n]) * part
    }
}
