//! How the limb of a frame appears, all round: its profile, the pixels' noise, and the light's tilt across the disc.

use super::profile::Profile;
use nalgebra::{Matrix3, Vector2, Vector3};

/// How far the light at one azimuth may be from what was expected before its own scale is known, 1 sigma.
pub(super) const TILT: f64 = 0.04;

/// What a look at the limb teaches beside its points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Appearance {
    pub profile: Profile,
    pub noise: Noise,
    pub light: Tilt,
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
