//! How the limb of a frame appears, all round: its profile, the pixels' noise, and the light's tilt across the disc.

use super::profile::Profile;
use crate::frame::ROUNDING_NOISE_DN;
use multiversion::multiversion;
use nalgebra::{Matrix3, Vector2, Vector3};

/// How far the light at one azimuth may be from what was expected before its own scale is known, 1 sigma.
pub(super) const TILT: f64 = 0.04;
/// Fewest pixels that tell a noise.
const MIN_PIXELS: f32 = 10.0;

/// What a look at the limb teaches beside its points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Appearance {
    pub profile: Profile,
    pub noise: Noise,
    pub light: Tilt,
}

impl Appearance {
    pub(super) fn disc_noise_dn(&self) -> f64 {
        self.noise.inside_dn
    }
}

/// Noise of a pixel, 1 sigma, on both sides of the limb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    pub outside_dn: f64,
    pub inside_dn: f64,
}

/// Light over the profile's, less 1, as it changes across the disc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Tilt {
    mean: f64,
    slope: Vector2<f64>,
}

impl Tilt {
    pub(super) const NONE: Self = Self {
        mean: 0.0,
        slope: Vector2::new(0.0, 0.0),
    };

    /// By least squares, twice: the second time without what is far from the first.
    pub(super) fn of(seen: impl Iterator<Item = (Vector2<f64>, f64)> + Clone) -> Self {
        let mut tilt = Self::NONE;
        for limit in [4.0 * TILT, 2.0 * TILT] {
            // A little information of none at all, for what a short arc does not tell.
            let mut matrix = Matrix3::identity();
            let mut right = Vector3::zeros();
            for (w, excess) in seen.clone() {
                let left = excess - tilt.at(w);
                if left.abs() < limit {
                    let row = Vector3::new(1.0, w.x, w.y);
                    matrix += row * row.transpose();
                    right += row * excess;
                }
            }
            let Some(fit) = matrix.cholesky().map(|root| root.solve(&right)) else {
                break;
            };
            tilt.mean = fit.x;
            tilt.slope = Vector2::new(fit.y, fit.z);
        }
        tilt
    }

    pub(super) fn at(&self, direction: Vector2<f64>) -> f64 {
        self.mean + self.slope.dot(&direction)
    }
}

impl Noise {
    /// At a share of the disc's light, DN^2.
    pub(super) fn variance(&self, share: f32) -> f32 {
        let [outside, inside] = [self.outside_dn, self.inside_dn].map(|dn| dn.powi(2) as f32);
        outside + (inside - outside) * share
    }
}

/// 1 sigma of what is left, from what lies within three of it: in rounds, since the limit rests on the result. `None` of
/// too few.
#[multiversion(targets("x86_64+avx2"))]
pub(super) fn clipped_sigma(left: &[f32], start: f32) -> Option<f64> {
    /// What the normal distribution keeps of its sigma within three of it.
    const KEPT: f32 = 0.9866;
    const ROUNDS: usize = 4;
    /// The start may be of another part of the picture.
    const FIRST_LIMIT: f32 = 5.0;
    const LANES: usize = 8;
    let mut limit = FIRST_LIMIT * start;
    let mut sigma = None;
    for _ in 0..ROUNDS {
        let limit2 = limit * limit;
        let (mut counts, mut squares) = ([0.0_f32; LANES], [0.0_f32; LANES]);
        for left in left.chunks_exact(LANES) {
            for k in 0..LANES {
                let square = left[k] * left[k];
                counts[k] += if square < limit2 { 1.0 } else { 0.0 };
                squares[k] += if square < limit2 { square } else { 0.0 };
            }
        }
        let count: f32 = counts.iter().sum();
        if count < MIN_PIXELS {
            return None;
        }
        let found = (squares.iter().sum::<f32>() / count).sqrt() / KEPT;
        let found = found.max(ROUNDING_NOISE_DN as f32);
        sigma = Some(f64::from(found));
        limit = 3.0 * found;
    }
    sigma
}
