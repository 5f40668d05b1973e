//! One mark's fit: place, contrast and light by Gauss and Newton's steps on the pixels of its patch.

use super::patch::Patch;
use super::profile::{Profile, Shares};
use crate::frame::ROUNDING_NOISE_DN;
use crate::lanes::Scratch;
use multiversion::multiversion;
use nalgebra::{Matrix2, Matrix6, Vector6};

/// A mark farther than this from where it was expected is not that mark.
const FARTHEST_PX: f64 = 1.5;
/// Near to a place what the cross covers changes in proportion to the offset: so near, px, and in sigmas of the place, that what
/// is beyond does not matter.
const NEAR_PX: std::ops::RangeInclusive<f64> = 0.0003..=0.002;
const NEAR_SIGMAS: f64 = 0.5;
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
    pub profile: &'a Profile,
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
    ///
    /// What the cross covers is looked up about one place for two steps, which take it to change in proportion to the
    /// offset from there: the first shows what does not belong, the second does without it.
    pub(super) fn run(&self) -> Option<Converged> {
        let mut unknowns = Unknowns::from(EXPECTED);
        let most_light = self.patch.light.iter().copied().fold(0.0, f32::max);
        let allowed_dn = (MODEL_ERROR * most_light).max(ROUNDING_NOISE_DN as f32);
        let mut variance = self.noise_dn.powi(2);
        let mut shares = Shares::new(self.patch.len());
        let mut linear = Linear::new(self.patch.len());
        for look in 0..MOST_LOOKS {
            let about = [unknowns[X], unknowns[Y]];
            self.look_up(about, &mut shares);
            self.lay(&unknowns, about, &shares, &mut linear);
            // The first model is too far off to tell what does not belong.
            if look > 0 {
                linear.reject(allowed_dn);
            }
            let rough = linear.step(&unknowns, variance)?;
            unknowns += rough.by;
            if unknowns[X].hypot(unknowns[Y]) > FARTHEST_PX {
                return None;
            }
            self.lay(&unknowns, about, &shares, &mut linear);
            linear.reject(allowed_dn);
            let fine = linear.step(&unknowns, rough.variance)?;
            unknowns += fine.by;
            variance = fine.variance;
            let sigma_px = (fine.covariance.fixed_view::<2, 2>(X, X).trace() / 2.0).sqrt();
            let near_px = (NEAR_SIGMAS * sigma_px).clamp(*NEAR_PX.start(), *NEAR_PX.end());
            if (unknowns[X] - about[X]).hypot(unknowns[Y] - about[Y]) < near_px {
                return Some(Converged {
                    unknowns,
                    covariance: fine.covariance,
                    variance,
                    pixels: fine.pixels,
                });
            }
        }
        None
    }

    /// What a cross about a place covers.
    fn look_up(&self, about: [f64; 2], shares: &mut Shares) {
        let patch = self.patch;
        let about = about.map(|v| v as f32);
        self.profile
            .shares(&patch.x, &patch.y, about, self.arms(), shares);
    }

    fn arms(&self) -> [f32; 4] {
        let m = &self.to_arms;
        [m.m11, m.m12, m.m21, m.m22]
    }

    /// Residuals and slopes at the unknowns, from what is covered about a place near theirs.
    fn lay(&self, unknowns: &Unknowns, about: [f64; 2], shares: &Shares, linear: &mut Linear) {
        let model = Model {
            at: unknowns.cast::<f32>().into(),
            off: [unknowns[X] - about[X], unknowns[Y] - about[Y]].map(|v| v as f32),
            to_arms: self.arms(),
            blur_variance: self.blur_variance,
            per_reach: 1.0 / self.reach,
        };
        linear.root_weights.copy_from_slice(&self.patch.root_weight);
        let [x, y, contrast, level, tilt_x, tilt_y] = &mut linear.slopes;
        let slopes = [x, y, contrast, level, tilt_x, tilt_y].map(|slope| slope.as_mut_slice());
        lay_model(self.patch, shares, &model, &mut linear.residuals, slopes);
    }
}

/// What the residuals and slopes of every pixel share.
struct Model {
    at: [f32; UNKNOWNS],
    /// The place less the one that the shares are of, px.
    off: [f32; 2],
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

    /// Takes weight from the pixels that the model is too far from, by the noise that most of them show and by what the model
    /// itself may be off: none within a limit, all beyond twice that.
    fn reject(&mut self, allowed_dn: f32) {
        let mut sizes = Scratch::empty(self.residuals.len());
        let counting = self.residuals.iter().zip(self.root_weights.iter());
        let counting = counting.filter(|(_, weight)| **weight > 0.0);
        sizes.extend(counting.map(|(residual, _)| residual.abs()));
        if sizes.is_empty() {
            return;
        }
        let middle = sizes.len() / 2;
        let median = *sizes.select_nth_unstable_by(middle, f32::total_cmp).1;
        let limit = DOUBTED_SIGMA * 1.4826 * median + allowed_dn;
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
    shares: &Shares,
    model: &Model,
    residuals: &mut [f32],
    slopes: [&mut [f32]; UNKNOWNS],
) {
    let count = residuals.len();
    let (x, y, seen) = (&patch.x[..count], &patch.y[..count], &patch.seen[..count]);
    let (light, weights) = (&patch.light[..count], &patch.root_weight[..count]);
    let (slope_x, slope_y) = (&patch.slope_x[..count], &patch.slope_y[..count]);
    let (share, by_u, by_v) = (
        &shares.share[..count],
        &shares.slope_u[..count],
        &shares.slope_v[..count],
    );
    let [at_x, at_y, at_contrast, at_level, at_tilt_x, at_tilt_y] = slopes;
    let (at_x, at_y) = (&mut at_x[..count], &mut at_y[..count]);
    let (at_contrast, at_level) = (&mut at_contrast[..count], &mut at_level[..count]);
    let (at_tilt_x, at_tilt_y) = (&mut at_tilt_x[..count], &mut at_tilt_y[..count]);
    let [ux, uy, vx, vy] = model.to_arms;
    let (contrast, per_reach) = (model.at[CONTRAST], model.per_reach);
    let [off_x, off_y] = model.off;
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
        residuals[n] = weight * (seen[n] - level * left) - at_x[n] * off_x - at_y[n] * off_y;
        at_contrast[n] = -weight * level * taken;
        at_level[n] = weight * left;
        at_tilt_x[n] = weight * left * tilt_x;
        at_tilt_y[n] = weight * left * tilt_y;
    }
}

/// Sum of products, in lanes that the processor adds side by side.
#[multiversion(targets("x86_64+avx2"))]
fn dot(a: &[f32], b: &[f32]) -> f64 {
    const LANES: usize = 8;
    let mut lanes = [0.0_f32; LANES];
    let (whole_a, whole_b) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest = whole_a.remainder().iter().zip(whole_b.remainder());
    let rest: f32 = rest.map(|(a, b)| a * b).sum();
    for (a, b) in whole_a.zip(whole_b) {
        for lane in 0..LANES {
            lanes[lane] += a[lane] * b[lane];
        }
    }
    f64::from(lanes.iter().sum::<f32>() + rest)
}
