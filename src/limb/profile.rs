//! Brightness across the limb: a limb-darkened disc behind a Gaussian blur.
//!
//! The disc's brightness falls towards its edge as A ((1 - u) + u sqrt(1 - r^2 / R^2)), r from its centre. The first term
//! is a uniform disc; the second, near the edge, falls as the square root of the depth. Convolved with a blur b, the first
//! becomes the normal distribution's tail E(z) and the second sqrt(2 b / R) F(z) with z = distance / b and F(z) =
//! <sqrt(max(0, x - z))> over normally distributed x. The limb is nearly straight over the blur's width: its curvature, b /
//! 2R of a blur, moves the edge by 0.005 px, the same at all azimuths.
//!
//! Both are closed formulas, so that many pixels are computed in parallel ([`EdgeLight`]).

use crate::estimation::{LeastSquares, Linearised, Loss, Prior, Scale};
use crate::kernels::limb::EdgeLight;
use crate::units::Measured;
use nalgebra::{RowSVector, SVector, Vector1};

/// Brightness across the limb, DN, by the distance outwards from it, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Profile {
    /// Brightness outside the disc.
    pub background_dn: f64,
    /// Brightness of the uniform part, A (1 - u).
    pub even_dn: f64,
    /// Brightness of the part that falls to zero at the edge, A u.
    pub darkened_dn: f64,
    /// Gaussian blur, 1 sigma, the pixel's own size included.
    pub blur_px: f64,
    /// Radius of the disc.
    pub radius_px: f64,
}

/// The median brightness at a distance from the limb, and the number of pixels whose mean is equally precise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Brightness {
    pub distance_px: f64,
    pub dn: f64,
    pub weight: f64,
}

/// Error of the limb's radial position by this model, common to all azimuths, 1 sigma, px: the neglected curvature alone
/// causes this much.
pub(super) const MODEL_SIGMA_PX: f64 = 0.005;
/// Bounds of the blur, px: they keep the fit stable on a picture without a limb.
const BLUR_PX: [f64; 2] = [0.35, 8.0];
/// 1 sigma before the fit of the background, the two parts of the brightness (relative to the peak), the blur (its
/// logarithm) and the position of the limb (px). A window about the limb shows little of the limb darkening.
const PRIOR: [f64; 5] = [f64::INFINITY, 0.5, 0.5, 1.0, 2.0];

impl Profile {
    /// Brightness at a distance outwards from the limb.
    pub fn at(&self, distance_px: f64) -> f64 {
        let (light, ..) = self.light().at(distance_px as f32);
        self.background_dn + f64::from(light)
    }

    /// Light above the background, in single precision.
    pub(super) fn light(&self) -> EdgeLight {
        EdgeLight {
            even_dn: self.even_dn as f32,
            darkened_dn: self.darkened_dn as f32,
            per_blur: 1.0 / self.blur_px as f32,
            per_radius: 1.0 / self.radius_px as f32,
        }
    }

    /// Brightness at the centre of an unblurred disc.
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

    /// Fits the profile and the limb's position outwards from distance 0 (px) to radial medians, starting from this
    /// profile. `None` if they do not determine it.
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

    /// A median's residual, and the derivatives of the model in background, uniform part, darkened part, logarithm of the
    /// blur and position of the limb.
    fn linearised(&self, median: &Brightness, limb_px: f64, weight: f64) -> Linearised<1, 5> {
        let distance_px = median.distance_px - limb_px;
        let light = self.light();
        let parts = light.parts(distance_px as f32);
        let (light, slope, _) = light.at(distance_px as f32);
        let [tail, root, slope] = [parts.tail, parts.root, slope].map(f64::from);
        let by_log_blur = self.darkened_dn * root / 2.0 - distance_px * slope;
        let residual = median.dn - self.background_dn - f64::from(light);
        Linearised {
            residual: Vector1::new(residual * weight),
            jacobian: RowSVector::from([1.0, tail, root, by_log_blur, -slope]) * weight,
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

    /// The blurred disc along a radius, by direct numerical integration in two dimensions.
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
        // The limb's curvature moves the blurred edge by b^2 / 2R, which a fit of the radius absorbs.
        let curve = PROFILE.blur_px.powi(2) / (2.0 * PROFILE.radius_px);
        for distance in [-9.0, -4.0, -2.0, -1.0, -0.3, 0.0, 0.4, 1.0, 2.0] {
            let found = PROFILE.at(distance + curve);
            assert!((found - summed(distance)).abs() < 0.35, "{distance}");
        }
    }

    #[test]
    fn bends_are_those_of_the_slopes() {
        for n in -60..40 {
            let d = n as f32 * 0.1;
            let (_, _, bend) = PROFILE.light().at(d);
            let numeric = (PROFILE.light().at(d + 0.05).1 - PROFILE.light().at(d - 0.05).1) / 0.1;
            assert!((numeric - bend).abs() < 0.5, "{d}: {numeric} {bend}");
        }
    }

    #[test]
    fn slopes_are_those_of_the_profile() {
        for n in -40..25 {
            let d = f64::from(n) * 0.25 + 0.01;
            let step = 1e-3;
            let numeric = (PROFILE.at(d + step) - PROFILE.at(d - step)) / (2.0 * step);
            let slope = f64::from(PROFILE.light().at(d as f32).1);
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
