//! One mark's fit: place, contrast and light by Gauss and Newton's steps on the pixels of its patch.

use super::coverage::{BlurredCross, Coverage, Pose};
use super::patch::Patch;
use crate::frame::ROUNDING_NOISE_DN;
use crate::lanes::{LANES, Scratch};
use crate::statistics::clipped_sigma;
use multiversion::multiversion;
use nalgebra::{Matrix2, Matrix6, Vector6};

/// A mark farther than this from where it was expected is not that mark.
const FARTHEST_PX: f64 = 1.5;
/// A step as short as this ends where the next one would, px.
const SETTLED_PX: f64 = 0.02;
const MOST_LOOKS: usize = 10;
/// Pixels farther than this from the model, in sigma, may be something else: hot pixels, scratches.
const DOUBTED_SIGMA: f32 = 3.0;
/// Beyond the noise, the model may be off by this part of the light: a blur that is not quite the lens's shows at the arms'
/// edges, and leaving out some of them would move the mark.
const MODEL_ERROR: f32 = 0.04;
/// Fewest pixels that make a fit.
const MIN_PIXELS: usize = 60;

/// What is fitted, by index: the offset from the start, px; the mark's contrast; the light over the expected light at the
/// start, and how that changes over the patch's radius along x and y.
pub(super) type Unknowns = Vector6<f64>;
pub(super) const X: usize = 0;
pub(super) const Y: usize = 1;
pub(super) const CONTRAST: usize = 2;
pub(super) const LEVEL: usize = 3;
const TILT_X: usize = 4;
const TILT_Y: usize = 5;
const UNKNOWNS: usize = 6;
/// The unknowns before the fit, and what is known of them, 1 / sigma: it holds in place what a saturated or cut patch does
/// not tell.
const EXPECTED: [f64; UNKNOWNS] = [0.0, 0.0, 0.5, 1.0, 0.0, 0.0];
const EXPECTED_INVERSE_SIGMA: [f64; UNKNOWNS] = [0.0, 0.0, 2.0, 2.0, 5.0, 5.0];

/// One mark's fit.
pub(super) struct Fit<'a> {
    pub patch: &'a Patch,
    pub cross: BlurredCross,
    /// From an offset on the sensor to one along the arms, both px.
    pub to_arms: Matrix2<f32>,
    pub blur_variance: f32,
    pub reach: f32,
    pub noise_dn: f64,
}

/// Where a fit ended.
pub(super) struct Converged {
    pub unknowns: Unknowns,
    pub covariance: Matrix6<f64>,
    /// Of the residuals, DN^2.
    pub variance: f64,
    pub pixels: usize,
}

/// A step of a fit, and what it rests on.
struct Step {
    by: Unknowns,
    covariance: Matrix6<f64>,
    variance: f64,
    pixels: usize,
}

impl Fit<'_> {
    /// Steps until the place settles. `None` when they lead away or the pixels are too few.
    pub(super) fn run(&self) -> Option<Converged> {
        let mut unknowns = Unknowns::from(EXPECTED);
        let most_light = self.patch.light.iter().copied().fold(0.0, f32::max);
        let allowed_dn = (MODEL_ERROR * most_light).max(ROUNDING_NOISE_DN as f32);
        // What does not belong must not widen the limits by itself, so these start from what is known.
        let expected_dn = (0.5 * allowed_dn).max(self.noise_dn as f32);
        let mut variance = self.noise_dn.powi(2);
        let mut coverage = Coverage::of_length(self.patch.len());
        let mut linear = Linear::new(self.patch.len());
        for look in 0..MOST_LOOKS {
            self.lay(&unknowns, &mut coverage, &mut linear);
            // The first model is too far off to tell what does not belong.
            if look > 0 {
                linear.reject(expected_dn, allowed_dn);
            }
            let step = linear.step(&unknowns, variance)?;
            unknowns += step.by;
            variance = step.variance;
            if unknowns[X].hypot(unknowns[Y]) > FARTHEST_PX {
                return None;
            }
            if look > 0 && step.by[X].hypot(step.by[Y]) < SETTLED_PX {
                return Some(Converged {
                    unknowns,
                    covariance: step.covariance,
                    variance,
                    pixels: step.pixels,
                });
            }
        }
        None
    }

    /// Residuals and slopes at the unknowns.
    fn lay(&self, unknowns: &Unknowns, coverage: &mut Coverage, linear: &mut Linear) {
        let m = &self.to_arms;
        let pose = Pose {
            middle: [unknowns[X], unknowns[Y]].map(|v| v as f32),
            to_arms: [m.m11, m.m12, m.m21, m.m22],
        };
        self.cross
            .fill(&self.patch.x, &self.patch.y, &pose, coverage);
        let model = Model {
            at: unknowns.cast::<f32>().into(),
            to_arms: pose.to_arms,
            blur_variance: self.blur_variance,
            per_reach: 1.0 / self.reach,
        };
        linear.root_weights.copy_from_slice(&self.patch.root_weight);
        let [x, y, contrast, level, tilt_x, tilt_y] = &mut linear.slopes;
        let slopes = [x, y, contrast, level, tilt_x, tilt_y].map(|slope| slope.as_mut_slice());
        lay_model(self.patch, coverage, &model, &mut linear.residuals, slopes);
    }
}

/// What the residuals and slopes of every pixel share.
struct Model {
    at: [f32; UNKNOWNS],
    to_arms: [f32; 4],
    blur_variance: f32,
    per_reach: f32,
}

/// Residuals of a model, DN, and how the model changes with each unknown; one entry a pixel.
struct Linear {
    /// Roots of the weights that residuals and slopes carry.
    root_weights: Scratch<f32>,
    residuals: Scratch<f32>,
    slopes: [Scratch<f32>; UNKNOWNS],
}

impl Linear {
    fn new(count: usize) -> Self {
        Self {
            root_weights: Scratch::of_length(count),
            residuals: Scratch::of_length(count),
            slopes: std::array::from_fn(|_| Scratch::of_length(count)),
        }
    }

    /// Gauss and Newton's step, with what is known of the unknowns beforehand. `None` of too few pixels.
    fn step(&self, unknowns: &Unknowns, variance: f64) -> Option<Step> {
        let pixels = self.root_weights.iter().filter(|w| **w > 0.0).count();
        if pixels < MIN_PIXELS {
            return None;
        }
        let (matrix, right, squares) = self.normal_equations();
        let weight = dot(&self.root_weights, &self.root_weights);
        let freedoms = weight * (1.0 - UNKNOWNS as f64 / pixels as f64);
        let known = Vector6::from(EXPECTED_INVERSE_SIGMA.map(|s| s * s));
        let informed = |variance| matrix / variance + Matrix6::from_diagonal(&known);
        let pull = known.component_mul(&(Unknowns::from(EXPECTED) - unknowns));
        let by = informed(variance)
            .cholesky()?
            .solve(&(right / variance + pull));
        // What the step explains is no noise.
        let left = (squares - 2.0 * by.dot(&right) + by.dot(&(matrix * by))) / freedoms;
        let variance = left.max(ROUNDING_NOISE_DN.powi(2));
        Some(Step {
            by,
            covariance: informed(variance).cholesky()?.inverse(),
            variance,
            pixels,
        })
    }

    /// Takes weight from the pixels that the model is too far from, by the noise that most of them show, about the expected
    /// one, and by what the model itself may be off: none within a limit, all beyond twice that.
    fn reject(&mut self, expected_dn: f32, allowed_dn: f32) {
        let Some(noise_dn) = clipped_sigma(&self.residuals, expected_dn) else {
            return;
        };
        let limit = DOUBTED_SIGMA * noise_dn as f32 + allowed_dn;
        for n in 0..self.residuals.len() {
            let size = self.residuals[n].abs();
            if size > limit {
                let part = (2.0 - size / limit).max(0.0).sqrt();
                self.residuals[n] *= part;
                self.root_weights[n] *= part;
                self.slopes.iter_mut().for_each(|slope| slope[n] *= part);
            }
        }
    }

    /// The products of the slopes with each other and with the residuals, and the residuals' squares.
    fn normal_equations(&self) -> (Matrix6<f64>, Vector6<f64>, f64) {
        let mut matrix = Matrix6::zeros();
        let mut right = Vector6::zeros();
        for (m, a) in self.slopes.iter().enumerate() {
            for (n, b) in self.slopes.iter().enumerate().skip(m) {
                matrix[(m, n)] = dot(a, b);
                matrix[(n, m)] = matrix[(m, n)];
            }
            right[m] = dot(a, &self.residuals);
        }
        (matrix, right, dot(&self.residuals, &self.residuals))
    }
}

/// Residuals and slopes of every pixel.
#[multiversion(targets("x86_64+avx2"))]
fn lay_model(
    patch: &Patch,
    coverage: &Coverage,
    model: &Model,
    residuals: &mut [f32],
    slopes: [&mut [f32]; UNKNOWNS],
) {
    let count = residuals.len();
    let (x, y, seen) = (&patch.x[..count], &patch.y[..count], &patch.seen[..count]);
    let (light, weights) = (&patch.light[..count], &patch.root_weight[..count]);
    let (slope_x, slope_y) = (&patch.slope_x[..count], &patch.slope_y[..count]);
    let (share, by_u, by_v) = (
        &coverage.share[..count],
        &coverage.slope_u[..count],
        &coverage.slope_v[..count],
    );
    let [at_x, at_y, at_contrast, at_level, at_tilt_x, at_tilt_y] = slopes;
    let (at_x, at_y) = (&mut at_x[..count], &mut at_y[..count]);
    let (at_contrast, at_level) = (&mut at_contrast[..count], &mut at_level[..count]);
    let (at_tilt_x, at_tilt_y) = (&mut at_tilt_x[..count], &mut at_tilt_y[..count]);
    let [ux, uy, vx, vy] = model.to_arms;
    let (contrast, per_reach) = (model.at[CONTRAST], model.per_reach);
    for n in 0..count {
        let along_x = ux * by_u[n] + vx * by_v[n];
        let along_y = uy * by_u[n] + vy * by_v[n];
        let drift = slope_x[n] * along_x + slope_y[n] * along_y;
        let taken = light[n] * share[n] + model.blur_variance * drift;
        let left = light[n] - contrast * taken;
        let (tilt_x, tilt_y) = (x[n] * per_reach, y[n] * per_reach);
        let level = model.at[LEVEL] + model.at[TILT_X] * tilt_x + model.at[TILT_Y] * tilt_y;
        let weight = weights[n];
        let dark = weight * level * contrast * light[n];
        at_x[n] = dark * along_x;
        at_y[n] = dark * along_y;
        residuals[n] = weight * (seen[n] - level * left);
        at_contrast[n] = -weight * level * taken;
        at_level[n] = weight * left;
        at_tilt_x[n] = weight * left * tilt_x;
        at_tilt_y[n] = weight * left * tilt_y;
    }
}

/// Sum of products, in lanes that the processor adds side by side.
#[multiversion(targets("x86_64+avx2"))]
fn dot(a: &[f32], b: &[f32]) -> f64 {
    let (whole_a, rest_a) = a.as_chunks::<LANES>();
    let (whole_b, rest_b) = b.as_chunks::<LANES>();
    let mut lanes = [0.0_f32; LANES];
    for (a, b) in whole_a.iter().zip(whole_b) {
        for lane in 0..LANES {
            lanes[lane] += a[lane] * b[lane];
        }
    }
    let rest: f32 = rest_a.iter().zip(rest_b).map(|(a, b)| a * b).sum();
    f64::from(lanes.iter().sum::<f32>() + rest)
}
