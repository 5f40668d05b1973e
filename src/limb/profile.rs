//! Brightness across the limb: a limb-darkened disc behind a Gaussian blur.
//!
//! The disc's light falls towards its edge as A ((1 - u) + u sqrt(1 - r^2 / R^2)), r from its centre. The first part is
//! an even ground that ends at the edge; the second, near the edge, falls as the root of the depth. Blurred by b, the
//! one becomes the normal distribution's tail E(z) and the other sqrt(2 b / R) F(z) with z = distance / b and
//! F(z) = <sqrt(max(0, x - z))> over normally distributed x. The limb is so nearly straight over the blur's width that
//! what its curve adds, b / 2R of a blur, moves the edge by 0.005 px, the same all round.
//!
//! Both are formulas, so that many pixels go through them side by side.

use crate::estimation::{LeastSquares, Linearised, Loss, Prior, Scale};
use crate::kernels::{larger, normal_tail, smaller};
use crate::units::Measured;
use nalgebra::{RowSVector, SVector, Vector1};

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

/// The median brightness at a distance from the limb, and the number of pixels whose mean is as precise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Brightness {
    pub distance_px: f64,
    pub dn: f64,
    pub weight: f64,
}

/// How far this model puts the limb from where it is, all round, 1 sigma, px: the curve alone does by so much.
pub(super) const MODEL_SIGMA_PX: f64 = 0.005;
/// The blur is kept within these bounds, px: the fit is not led astray by a picture without a limb.
const BLUR_PX: [f64; 2] = [0.35, 8.0];
/// How well background, the two parts of the light (relative to the peak), the blur (its logarithm) and the place of the limb
/// (px) are known before the fit, 1 sigma. A window about the limb shows little of the limb darkening.
const PRIOR: [f64; 5] = [f64::INFINITY, 0.5, 0.5, 1.0, 2.0];

impl Profile {
    /// Brightness at a distance outwards from the limb.
    pub fn at(&self, distance_px: f64) -> f64 {
        let (light, _) = self.light(distance_px as f32);
        self.background_dn + f64::from(light)
    }

    /// Light above the background at a distance outwards from the limb, DN, and its change per px.
    #[inline(always)]
    pub(super) fn light(&self, distance_px: f32) -> (f32, f32) {
        let (light, slope, _) = self.light_and_bend(distance_px);
        (light, slope)
    }

    /// The same, and how the change changes per px.
    #[inline(always)]
    pub(super) fn light_and_bend(&self, distance_px: f32) -> (f32, f32, f32) {
        let (even, darkened) = (self.even_dn as f32, self.darkened_dn as f32);
        let parts = self.parts(distance_px);
        let per_blur = 1.0 / self.blur_px as f32;
        let slope = darkened * parts.root_slope - even * parts.density;
        let bend = darkened * parts.root_bend + even * parts.density * distance_px * per_blur;
        (
            even * parts.tail + darkened * parts.root,
            slope * per_blur,
            bend * per_blur * per_blur,
        )
    }

    /// What the two parts of the light, as they are at the middle of an unblurred disc, leave at a distance.
    #[inline(always)]
    fn parts(&self, distance_px: f32) -> Parts {
        let (blur, radius) = (self.blur_px as f32, self.radius_px as f32);
        let depth = smaller(larger(-distance_px, 0.0), radius);
        // From F(z)^2 to 1 - r^2 / R^2 with r = R + distance.
        let scale2 = (2.0 - depth / radius) * blur / radius;
        Parts::at(distance_px / blur, scale2)
    }

    /// The disc's light at the middle of an unblurred disc.
    pub fn peak_dn(&self) -> f64 {
        self.even_dn + self.darkened_dn
    }

    /// The same limb behind another blur.
    pub(super) fn with_blur(&self, blur_px: f64) -> Self {
        Self {
            blur_px: blur_px.clamp(BLUR_PX[0], BLUR_PX[1]),
            ..*self
        }
    }

    /// Fits the profile, and how far outwards the limb lies from distance 0 (px), to radial medians; the start is this profile.
    /// `None` when they do not determine one.
    pub fn fitted(&self, medians: &[Brightness], noise_dn: f64) -> Option<(Self, Measured)> {
        let start = SVector::from([
            self.background_dn,
            self.even_dn,
            self.darkened_dn,
            self.blur_px.ln(),
            0.0,
        ]);
        let peak = self.peak_dn();
        let units = [1.0, peak, peak, 1.0, 1.0];
        let fit = LeastSquares {
            start,
            prior: Prior {
                mean: start,
                information: SVector::from_fn(|n, _| (PRIOR[n] * units[n]).powi(-2)),
            },
            loss: Loss::Squares,
            scale: Scale::Stated,
            tolerance_sigmas: 0.1,
        };
        let with = |p: &SVector<f64, 5>| Self {
            background_dn: p[0],
            even_dn: p[1],
            darkened_dn: p[2],
            ..self.with_blur(p[3].exp())
        };
        let linearise = |p: &SVector<f64, 5>| {
            let (profile, limb_px) = (with(p), p[4]);
            let row =
                move |b: &Brightness| profile.linearised(b, limb_px, b.weight.sqrt() / noise_dn);
            Some(medians.iter().map(row))
        };
        let found = fit.fit_each(linearise).ok()?;
        let profile = with(&found.parameters);
        (profile.peak_dn() > 0.0).then(|| (profile, found.measured(4)))
    }

    /// A median's residual, and the slopes of the model in background, even light, darkened light, logarithm of the blur and
    /// place of the limb.
    fn linearised(&self, median: &Brightness, limb_px: f64, weight: f64) -> Linearised<1, 5> {
        let distance_px = median.distance_px - limb_px;
        let parts = self.parts(distance_px as f32);
        let (light, slope) = self.light(distance_px as f32);
        let [tail, root, slope] = [parts.tail, parts.root, slope].map(f64::from);
        let by_log_blur = self.darkened_dn * root / 2.0 - distance_px * slope;
        let residual = median.dn - self.background_dn - f64::from(light);
        Linearised {
            residual: Vector1::new(residual * weight),
            jacobian: RowSVector::from([1.0, tail, root, by_log_blur, -slope]) * weight,
        }
    }
}

/// The blurred disc's two parts so many blurs outwards from the limb.
struct Parts {
    /// E(z) and the normal distribution's density, by which it falls.
    tail: f32,
    density: f32,
    /// F(z), scaled, its change with z, and the change of that.
    root: f32,
    root_slope: f32,
    root_bend: f32,
}

impl Parts {
    /// With d = max(0, x - z), <sqrt d> is at most sqrt(<1> <d>) and <1 / sqrt d> at least sqrt(<1>^3 / <d>), where <1> is
    /// the tail and <d> the density less z tails. Deep in the disc they are that, and far out less by a sixth and more by
    /// three quarters; in between factors fitted to the integrals lead from the one to the other. F is true to 0.004 and its
    /// slope to 0.008, which are 0.05 DN and 0.1 DN per px of a Sun of 200 DN.
    #[inline(always)]
    fn at(z: f32, scale2: f32) -> Self {
        let (tail, density) = normal_tail(z);
        // So far out that <d> drowns in rounding it is a tenth of the tail and less.
        let beyond = larger(density - z * tail, 0.1 * tail);
        let bound = (scale2 * tail * beyond + f32::MIN_POSITIVE).sqrt();
        let per_far = 1.0 / (z * z + 2.5).sqrt();
        let out = z * per_far;
        let factor = 0.9169 + out * (0.07366 * out - 0.01016);
        let slope_factor = 1.56246 + out * (0.22187 - 0.35538 * out);
        let factor_slope = (0.22187 - 0.71076 * out) * 2.5 * per_far * per_far * per_far;
        let root_slope = -0.5 * slope_factor * scale2 * tail * tail / bound;
        let relative_bend =
            factor_slope / slope_factor - 1.5 * density / tail + 0.5 * tail / beyond;
        Self {
            tail,
            density,
            root: factor * bound,
            root_slope,
            root_bend: root_slope * relative_bend,
        }
    }
}

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
    fn the_blurred_parts_are_those_of_their_definition() {
        let density = |x: f64| (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt();
        for n in -60..=32 {
            let z = f64::from(n) * 0.25;
            // With x = z + s^2 the root is gone: F = integral of 2 s^2 density, F' = -integral of density.
            let step = (8.0 - z).max(1.0).sqrt() / 2000.0;
            let cells = (0..2000).map(|n| (n as f64 + 0.5) * step);
            let (root, slope) = cells.fold((0.0, 0.0), |(root, slope), s| {
                let here = density(z + s * s) * step;
                (root + 2.0 * s * s * here, slope - here)
            });
            let parts = Parts::at(z as f32, 1.0);
            assert!((f64::from(parts.root) - root).abs() < 0.004, "{z}");
            assert!((f64::from(parts.root_slope) - slope).abs() < 0.008, "{z}");
            let tail = 0.5 * libm::erfc(z / std::f64::consts::SQRT_2);
            assert!((f64::from(parts.tail) - tail).abs() < 2e-5, "{z}");
        }
    }

    #[test]
    fn bends_are_those_of_the_slopes() {
        for n in -60..40 {
            let d = n as f32 * 0.1;
            let (_, _, bend) = PROFILE.light_and_bend(d);
            let numeric = (PROFILE.light(d + 0.05).1 - PROFILE.light(d - 0.05).1) / 0.1;
            assert!((numeric - bend).abs() < 0.5, "{d}: {numeric} {bend}");
        }
    }

    #[test]
    fn slopes_are_those_of_the_profile() {
        for n in -40..25 {
            let d = f64::from(n) * 0.25 + 0.01;
            let step = 1e-3;
            let numeric = (PROFILE.at(d + step) - PROFILE.at(d - step)) / (2.0 * step);
            let slope = f64::from(PROFILE.light(d as f32).1);
            assert!((numeric - slope).abs() < 0.6, "{d}: {numeric}");
            let blurred = |by: f64| PROFILE.with_blur(PROFILE.blur_px * by.exp()).at(d);
            let numeric = (blurred(step) - blurred(-step)) / (2.0 * step);
            let median = Brightness {
                distance_px: d,
                dn: 0.0,
                weight: 1.0,
            };
            let by_log_blur = PROFILE.linearised(&median, 0.0, 1.0).jacobian[3];
            assert!((numeric - by_log_blur).abs() < 0.6, "{d}: {numeric}");
        }
    }

    #[test]
    fn a_profile_is_found_from_medians() {
        let medians: Vec<Brightness> = (-40..24)
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
        let (found, shift) = start.fitted(&medians, 1.0).unwrap();
        assert!((shift.value - 0.2).abs() < 0.01, "{shift:?}");
        assert!((0.001..0.003).contains(&shift.sigma), "{shift:?}");
        assert!((found.blur_px - PROFILE.blur_px).abs() < 0.02);
        assert!((found.even_dn - PROFILE.even_dn).abs() < 3.0);
    }
}
