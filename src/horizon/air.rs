//! The limb's light by the law of its air.
//!
//! Air of an optical depth t along a ray scatters 1 - exp(-t) of what thick air does. The depth falls off exponentially with the height at which
//! the ray grazes the Earth (Chapman 1931, for a layer that is thin against it), less what lies behind a camera within the air. How the light
//! turns from the faint air above to the thick one below determines the brightness of the latter, even where only its clouds are seen.

use super::sphere::Sphere;
use crate::estimation::{LeastSquares, Linearised, Loss, Prior, Scale};
use crate::units::{EARTH_RADIUS_M, Measured};
use libm::erf;
use nalgebra::{RowVector3, Vector1, Vector3};
use std::f64::consts::{LN_2, PI, SQRT_2};

/// Residuals are counted in this share of the limb's brightness: what the mean of many places has of noise. The law is not the air's where they are so
/// many times larger.
const NOISE: f64 = 1e-3;
const MOST_SCATTER: f64 = 4.0;
/// 1 sigma of the logarithms of depth and scale height, before.
const DEPTH_SIGMA: f64 = 1.0;
const SCALE_SIGMA: f64 = 0.3;
/// Samples share a part of their noise with their neighbours, so that fewer of them count.
const SHARED_NOISE: f64 = 1.4;
/// The law is known to that part of what blur makes of it.
const BLUR_SIGMA: f64 = 0.5;

/// The air of a limb: its brightness where it is thick, and the logarithms of the depth at the edge and of the scale height over the usual one.
type Parameters = Vector3<f64>;

/// Rays across the edge, and where their light comes from.
pub(super) struct Air {
    camera_radius_m: f64,
    half_angle_rad: f64,
    edge_m: f64,
    step_rad: f64,
    blur_steps: f64,
}

impl Air {
    /// `None` of a sphere without air.
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

    /// The usual air, of half the thick one's light at the edge.
    fn usual() -> Parameters {
        Vector3::new(1.0, LN_2.ln(), 0.0)
    }

    /// Optical depth of a ray so many steps outside of the edge, and the derivative of its logarithm by that of the scale height.
    fn depth(&self, steps: f64, air: &Parameters) -> (f64, f64) {
        let scale_m = Sphere::SCALE_HEIGHT_M * air.z.exp();
        let (sine, cosine) = (self.half_angle_rad + steps * self.step_rad).sin_cos();
        let scales = (self.camera_radius_m * sine - self.edge_m) / scale_m;
        // Along a ray, density is a Gaussian about the lowest place.
        let to_lowest = self.camera_radius_m * cosine / (EARTH_RADIUS_M * scale_m).sqrt();
        let before = 1.0 + erf(to_lowest / SQRT_2);
        let nearer = to_lowest * (-to_lowest * to_lowest / 2.0).exp() / (2.0 * PI).sqrt();
        let depth = (air.y - scales).exp() * before / 2.0;
        (depth, scales - nearer / before)
    }

    /// Share of the thick air's light, and its derivatives by the logarithms of depth and scale height.
    fn share(&self, steps: f64, air: &Parameters) -> Vector3<f64> {
        let (depth, by_scale) = self.depth(steps, air);
        let by_depth = depth * (-depth).exp();
        Vector3::new(1.0 - (-depth).exp(), by_depth, by_depth * by_scale)
    }

    /// A share in a blurred picture, to the second order of the blur.
    fn blurred(&self, steps: f64, air: &Parameters) -> Vector3<f64> {
        (self.share(steps - self.blur_steps, air) + self.share(steps + self.blur_steps, air)) / 2.0
    }

    /// Light of the usual air over its brightness.
    pub fn usual_share(&self, steps: f64) -> f64 {
        self.share(steps, &Self::usual()).x
    }

    /// Steps from the edge to where half of the thick air's light is scattered, by light above that of the last step. `None` of light that
    /// has another law.
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
        // The depth at half stays what it is, by whatever the air changes.
        let slope = Vector3::new(0.0, 1.0, self.depth(half, air).1) * scale_steps;
        let variance = (slope.transpose() * found.covariance * slope).x;
        let blur = BLUR_SIGMA * self.blur_steps.powi(2) / scale_steps;
        let sigma = (SHARED_NOISE * variance.sqrt()).hypot(blur);
        sigma.is_finite().then(|| Measured::new(half, sigma))
    }

    /// Where the depth is ln 2, by Newton's steps of its logarithm.
    fn half_of(&self, air: &Parameters) -> Option<f64> {
        const STEPS: usize = 6;
        let half = (0..STEPS).fold(0.0, |at, _| {
            let depth = |steps: f64| self.depth(steps, air).0;
            at + (depth(at) / LN_2).ln() / (depth(at - 0.5) / depth(at + 0.5)).ln()
        });
        half.is_finite().then_some(half)
    }
}
