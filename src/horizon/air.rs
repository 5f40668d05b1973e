//! The limb's brightness by a model of the air.
//!
//! Air with an optical depth t along a ray scatters the fraction 1 - exp(-t) of the light that thick air scatters. The
//! depth falls off exponentially with the ray's grazing height above the Earth (Chapman 1931, for a layer that is thin
//! relative to the radius), minus the part behind a camera within the air. The transition of the brightness from the thin
//! air above to the thick air below determines the brightness of the thick air, even if only its clouds are visible.

use super::sphere::Sphere;
use crate::estimation::{LeastSquares, Linearised, Loss, Prior, Scale};
use crate::units::{EARTH_RADIUS_M, Measured};
use libm::erf;
use nalgebra::{RowVector3, Vector1, Vector3};
use std::f64::consts::{LN_2, PI, SQRT_2};

/// 1 sigma of the residuals, relative to the limb's brightness: the noise of the mean of many places. If their scatter is
/// larger by `MOST_SCATTER`, the model does not apply.
const NOISE: f64 = 1e-3;
const MOST_SCATTER: f64 = 4.0;
/// 1 sigma of the priors of the logarithms of depth and scale height.
const DEPTH_SIGMA: f64 = 1.0;
const SCALE_SIGMA: f64 = 0.3;
/// Neighbouring samples share a part of their noise, so the sigma is larger by this factor.
const SHARED_NOISE: f64 = 1.4;
/// Uncertainty of the model's blur correction, relative to the correction.
const BLUR_SIGMA: f64 = 0.5;

/// The air of a limb: its brightness where it is thick, and the logarithms of the depth at the edge and of the scale height
/// relative to the standard one.
type Parameters = Vector3<f64>;

/// Rays across the edge, and the air along them.
pub(super) struct Air {
    camera_radius_m: f64,
    half_angle_rad: f64,
    edge_m: f64,
    step_rad: f64,
    blur_steps: f64,
}

impl Air {
    /// `None` for a sphere without air.
    pub fn new(sphere: &Sphere, step_rad: f64, blur_steps: f64) -> Option<Self> {
        let camera_radius_m = EARTH_RADIUS_M + sphere.viewpoint?.height_m.value;
        let half_angle_rad = sphere.half_angle_rad.value;
        Some(Self {
            camera_radius_m,
            half_angle_rad,
            edge_m: camera_radius_m * half_angle_rad.sin(),
            step_rad,
            blur_steps,
        })
    }

    /// The standard air, with half of the thick air's brightness at the edge.
    fn usual() -> Parameters {
        Vector3::new(1.0, LN_2.ln(), 0.0)
    }

    /// Optical depth of a ray at a distance outside of the edge, in steps, and the derivative of its logarithm by that of
    /// the scale height.
    fn depth(&self, steps: f64, air: &Parameters) -> (f64, f64) {
        let scale_m = Sphere::SCALE_HEIGHT_M * air.z.exp();
        let (sine, cosine) = (self.half_angle_rad + steps * self.step_rad).sin_cos();
        let scales = (self.camera_radius_m * sine - self.edge_m) / scale_m;
        // Along a ray, the density is a Gaussian about the lowest point.
        let to_lowest = self.camera_radius_m * cosine / (EARTH_RADIUS_M * scale_m).sqrt();
        let before = 1.0 + erf(to_lowest / SQRT_2);
        let nearer = to_lowest * (-to_lowest * to_lowest / 2.0).exp() / (2.0 * PI).sqrt();
        let depth = (air.y - scales).exp() * before / 2.0;
        (depth, scales - nearer / before)
    }

    /// Fraction of the thick air's brightness, and its derivatives by the logarithms of depth and scale height.
    fn share(&self, steps: f64, air: &Parameters) -> Vector3<f64> {
        let (depth, by_scale) = self.depth(steps, air);
        let by_depth = depth * (-depth).exp();
        Vector3::new(1.0 - (-depth).exp(), by_depth, by_depth * by_scale)
    }

    /// The fraction in a blurred picture, to second order in the blur.
    fn blurred(&self, steps: f64, air: &Parameters) -> Vector3<f64> {
        (self.share(steps - self.blur_steps, air) + self.share(steps + self.blur_steps, air)) / 2.0
    }

    /// Brightness of the standard air as a fraction of the thick air's.
    pub fn usual_share(&self, steps: f64) -> f64 {
        self.share(steps, &Self::usual()).x
    }

    /// Steps from the edge to the ray that scatters half of the thick air's light, fitted to the brightness above that of
    /// the last step. `None` if the brightness does not follow the model.
    pub fn half(&self, light: &[(f64, f64)], last: f64, brightness: f64) -> Option<Measured> {
        let rows = |air: &Parameters| {
            let below = self.share(last, air);
            let row = |(steps, dn): &(f64, f64)| {
                let shown = self.blurred(*steps, air) - below;
                Linearised {
                    residual: Vector1::new((dn - air.x * shown.x) / NOISE),
                    jacobian: RowVector3::new(shown.x, air.x * shown.y, air.x * shown.z) / NOISE,
                }
            };
            Some(light.iter().map(row).collect::<Vec<_>>())
        };
        let mut start = Self::usual();
        start.x = brightness;
        let fit = LeastSquares {
            start,
            prior: Prior {
                mean: start,
                information: Vector3::new(0.0, DEPTH_SIGMA.powi(-2), SCALE_SIGMA.powi(-2)),
            },
            loss: Loss::Squares,
            scale: Scale::Inflated,
            tolerance_sigmas: 0.1,
        };
        let found = fit
            .fit(rows)
            .ok()
            .filter(|found| found.scatter < MOST_SCATTER)?;
        let air = &found.parameters;
        let half = self.half_of(air)?;
        let depth = |steps: f64| self.depth(steps, air).0;
        let scale_steps = 1.0 / (depth(half - 0.5) / depth(half + 0.5)).ln();
        // At this ray the depth is fixed, however the parameters of the air change.
        let slope = Vector3::new(0.0, 1.0, self.depth(half, air).1) * scale_steps;
        let variance = (slope.transpose() * found.covariance * slope).x;
        let blur = BLUR_SIGMA * self.blur_steps.powi(2) / scale_steps;
        let sigma = (SHARED_NOISE * variance.sqrt()).hypot(blur);
        sigma.is_finite().then(|| Measured::new(half, sigma))
    }

    /// Position where the depth is ln 2, by Newton's method on its logarithm.
    fn half_of(&self, air: &Parameters) -> Option<f64> {
        const STEPS: usize = 6;
        let half = (0..STEPS).fold(0.0, |at, _| {
            let depth = |steps: f64| self.depth(steps, air).0;
            at + (depth(at) / LN_2).ln() / (depth(at - 0.5) / depth(at + 0.5)).ln()
        });
        half.is_finite().then_some(half)
    }
}
