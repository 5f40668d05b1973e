//! Brightness across the limb: a limb-darkened disc behind a Gaussian blur.
//!
//! The disc's light falls towards its edge as A ((1 - u) + u sqrt(1 - r^2 / R^2)), r from its centre. The first part is
//! an even ground that ends at the edge; the second, near the edge, falls as the root of the depth. Blurred by b, the
//! one becomes the normal distribution's tail E(z) and the other sqrt(2 b / R) F(z) with z = distance / b and
//! F(z) = <sqrt(max(0, x - z))> over normally distributed x. The limb is so nearly straight over the blur's width that
//! what its curve adds, b / 2R of a blur, moves the edge by 0.005 px, the same all round.

use nalgebra::{SMatrix, SVector};
use std::sync::LazyLock;

/// Brightness across the limb, DN, by the distance outwards from it, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Profile {
    /// Brightness outside the disc.
    pub background_dn: f64,
    /// Light of the even part, A (1 - u).
    pub even_dn: f64,
    /// Light of the part that falls to zero at the edge, A u.
    pub darkened_dn: f64,
    /// Gaussian blur, 1 sigma, the pixel's own size included.
    pub blur_px: f64,
    /// Radius of the disc.
    pub radius_px: f64,
}

/// A brightness that is typical for a distance from the limb, and how much it counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Brightness {
    pub distance_px: f64,
    pub dn: f64,
    pub weight: f64,
}

const STEPS: usize = 8;
const MIN_BLUR_PX: f64 = 0.35;
const MAX_BLUR_PX: f64 = 8.0;

impl Profile {
    /// Brightness at a distance outwards from the limb.
    pub fn at(&self, distance_px: f64) -> f64 {
        self.both(distance_px).0
    }

    /// Change of the brightness per px outwards.
    pub fn slope(&self, distance_px: f64) -> f64 {
        self.both(distance_px).1
    }

    /// Brightness at a distance outwards from the limb, and its change per px.
    pub(super) fn both(&self, distance_px: f64) -> (f64, f64) {
        let z = distance_px / self.blur_px;
        let scale = self.root_scale(distance_px);
        let ((tail, tail_slope), (root, root_slope)) = (TAIL.both(z), ROOT.both(z));
        let dn = self.background_dn + self.even_dn * tail + self.darkened_dn * scale * root;
        let slope = self.even_dn * tail_slope + self.darkened_dn * scale * root_slope;
        (dn, slope / self.blur_px)
    }

    /// The disc's light at the middle of an unblurred disc.
    pub fn peak_dn(&self) -> f64 {
        self.even_dn + self.darkened_dn
    }

    /// From F(z) to sqrt(1 - r^2 / R^2) with r = R + distance.
    fn root_scale(&self, distance_px: f64) -> f64 {
        let depth = (-distance_px).clamp(0.0, self.radius_px);
        ((2.0 - depth / self.radius_px) * self.blur_px / self.radius_px).sqrt()
    }

    /// Fits the profile, and how far outwards the limb lies from distance 0, to typical brightnesses; the start is this
    /// profile. `None` when they do not determine one.
    ///
    /// The share of the limb darkening is held loosely to the start's: a window about the limb shows little of it.
    pub fn fitted(&self, typical: &[Brightness], noise_dn: f64) -> Option<(Self, f64)> {
        let (mut profile, mut shift) = (*self, 0.0);
        let loose = 0.5 * self.peak_dn();
        let priors: [f64; 5] = [0.0, loose.powi(-2), loose.powi(-2), 0.25, 0.25];
        for _ in 0..STEPS {
            let mut information = SMatrix::<f64, 5, 5>::from_diagonal(&SVector::from(priors));
            let off = [
                0.0,
                self.even_dn - profile.even_dn,
                self.darkened_dn - profile.darkened_dn,
                self.blur_px - profile.blur_px,
                -shift,
            ];
            let mut gradient = SVector::<f64, 5>::from_fn(|n, _| priors[n] * off[n]);
            for b in typical {
                let (dn, row) = profile.linear(b.distance_px - shift);
                let weight = b.weight / noise_dn.powi(2);
                information.ger(weight, &row, &row, 1.0);
                gradient += row * ((b.dn - dn) * weight);
            }
            let step = information.cholesky()?.solve(&gradient);
            if !step.iter().all(|v| v.is_finite()) {
                return None;
            }
            profile.background_dn += step[0];
            profile.even_dn += step[1];
            profile.darkened_dn += step[2];
            profile.blur_px =
                (profile.blur_px + step[3].clamp(-0.5, 0.5)).clamp(MIN_BLUR_PX, MAX_BLUR_PX);
            shift += step[4].clamp(-1.0, 1.0);
            if step[3].abs().max(step[4].abs()) < 1e-3 {
                break;
            }
        }
        (profile.peak_dn() > 0.0).then_some((profile, shift))
    }

    /// Brightness, and its slopes in background, even light, darkened light, blur and place of the limb.
    fn linear(&self, distance_px: f64) -> (f64, SVector<f64, 5>) {
        let z = distance_px / self.blur_px;
        let scale = self.root_scale(distance_px);
        let ((tail, tail_slope), (root, root_slope)) = (TAIL.both(z), ROOT.both(z));
        let root = root * scale;
        let outwards =
            (self.even_dn * tail_slope + self.darkened_dn * scale * root_slope) / self.blur_px;
        let by_blur = -z * outwards + self.darkened_dn * root / (2.0 * self.blur_px);
        let dn = self.background_dn + self.even_dn * tail + self.darkened_dn * root;
        (dn, SVector::from([1.0, tail, root, by_blur, -outwards]))
    }
}

/// A function of z, and its slope, by linear interpolation in a table.
struct Table {
    values: Vec<(f64, f64)>,
    /// What holds deeper inside than the table reaches.
    inside: fn(f64) -> (f64, f64),
}

const FIRST_Z: f64 = -10.0;
const LAST_Z: f64 = 6.0;
const PER_UNIT: f64 = 32.0;

impl Table {
    fn of(value: impl Fn(f64) -> (f64, f64), inside: fn(f64) -> (f64, f64)) -> Self {
        let count = ((LAST_Z - FIRST_Z) * PER_UNIT) as usize + 2;
        let values = (0..count).map(|n| value(FIRST_Z + n as f64 / PER_UNIT));
        Self {
            values: values.collect(),
            inside,
        }
    }

    fn both(&self, z: f64) -> (f64, f64) {
        if z < FIRST_Z {
            return (self.inside)(z);
        }
        if z >= LAST_Z {
            return (0.0, 0.0);
        }
        let place = (z - FIRST_Z) * PER_UNIT;
        let n = place as usize;
        let part = place - n as f64;
        let (a, b) = (self.values[n], self.values[n + 1]);
        (a.0 + (b.0 - a.0) * part, a.1 + (b.1 - a.1) * part)
    }
}

fn normal_density(z: f64) -> f64 {
    (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt()
}

/// E(z), the normal distribution's tail beyond z.
static TAIL: LazyLock<Table> = LazyLock::new(|| {
    let tail = |z: f64| 0.5 * libm::erfc(z / std::f64::consts::SQRT_2);
    Table::of(|z| (tail(z), -normal_density(z)), |_| (1.0, 0.0))
});

/// F(z), the mean of the root of what a normally distributed number exceeds z by.
static ROOT: LazyLock<Table> = LazyLock::new(|| {
    // With x = z + s^2 the root is gone: F = integral of 2 s^2 phi(z + s^2), F' = -integral of phi(z + s^2).
    let integrals = |z: f64| {
        const CELLS: usize = 400;
        let farthest = (8.0 - z).max(1.0).sqrt();
        let step = farthest / CELLS as f64;
        let cells = (0..CELLS).map(|n| (n as f64 + 0.5) * step);
        cells.fold((0.0, 0.0), |(value, slope), s| {
            let density = normal_density(z + s * s) * step;
            (value + 2.0 * s * s * density, slope - density)
        })
    };
    Table::of(integrals, |z| {
        let root = (-z).sqrt();
        (root * (1.0 - 0.125 / (z * z)), -0.5 / root)
    })
});

#[cfg(test)]
mod tests {
    use super::*;

    const PROFILE: Profile = Profile {
        background_dn: 4.0,
        even_dn: 90.0,
        darkened_dn: 115.0,
        blur_px: 0.945,
        radius_px: 95.163,
    };

    /// The blurred disc along a radius, by plain summation in two dimensions.
    fn summed(distance: f64) -> f64 {
        let (r0, b) = (PROFILE.radius_px + distance, PROFILE.blur_px);
        let (mut sum, mut weights) = (0.0, 0.0);
        const STEP: f64 = 0.02;
        for i in -300..=300 {
            for j in -300..=300 {
                let (x, y) = (f64::from(i) * STEP, f64::from(j) * STEP);
                let weight = (-0.5 * (x * x + y * y) / (b * b)).exp();
                let cosine2 = 1.0 - ((r0 + x).powi(2) + y * y) / PROFILE.radius_px.powi(2);
                weights += weight;
                if cosine2 > 0.0 {
                    sum += weight * (PROFILE.even_dn + PROFILE.darkened_dn * cosine2.sqrt());
                }
            }
        }
        PROFILE.background_dn + sum / weights
    }

    #[test]
    fn the_profile_is_that_of_a_blurred_limb_darkened_disc() {
        // The curve of the limb moves the blurred edge by b^2 / 2R, which a fit of the radius takes up.
        let curve = PROFILE.blur_px.powi(2) / (2.0 * PROFILE.radius_px);
        for distance in [-9.0, -4.0, -2.0, -1.0, -0.3, 0.0, 0.4, 1.0, 2.0] {
            let found = PROFILE.at(distance + curve);
            assert!((found - summed(distance)).abs() < 0.35, "{distance}");
        }
    }

    #[test]
    fn slopes_are_those_of_the_profile() {
        for n in -40..25 {
            let d = f64::from(n) * 0.25 + 0.01;
            let step = 1e-3;
            let numeric = (PROFILE.at(d + step) - PROFILE.at(d - step)) / (2.0 * step);
            assert!((numeric - PROFILE.slope(d)).abs() < 0.6, "{d}: {numeric}");
            let blurred = |by: f64| {
                Profile {
                    blur_px: PROFILE.blur_px + by,
                    ..PROFILE
                }
                .at(d)
            };
            let numeric = (blurred(step) - blurred(-step)) / (2.0 * step);
            assert!((numeric - PROFILE.linear(d).1[3]).abs() < 0.6, "{d}");
        }
    }

    #[test]
    fn a_profile_is_found_from_brightnesses() {
        let typical: Vec<Brightness> = (-40..24)
            .map(|n| Brightness {
                distance_px: f64::from(n) / 4.0,
                dn: PROFILE.at(f64::from(n) / 4.0 - 0.2),
                weight: 75.0,
            })
            .collect();
        let start = Profile {
            background_dn: 6.0,
            even_dn: 80.0,
            darkened_dn: 100.0,
            blur_px: 1.3,
            ..PROFILE
        };
        let (found, shift) = start.fitted(&typical, 1.0).unwrap();
        assert!((shift - 0.2).abs() < 0.01, "{shift}");
        assert!((found.blur_px - PROFILE.blur_px).abs() < 0.02);
        assert!((found.even_dn - PROFILE.even_dn).abs() < 3.0);
    }
}
