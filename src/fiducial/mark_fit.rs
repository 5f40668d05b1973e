//! One mark's fit: place, contrast and light by Gauss-Newton steps on the pixels of its patch, reweighted against outliers.

use super::CrossShape;
use super::patch::Patch;
use crate::estimation::clipped_sigma;
use crate::frame::PixelNoise;
use crate::kernels::{Coverage, combine, larger, products, smaller};
use multiversion::multiversion;
use nalgebra::{Matrix2, Matrix6, Matrix6x2, Vector2, Vector6};

/// A step as short as this ends where the next one would, px: a tenth of what the noise of a clean frame leaves.
const SETTLED_PX: f64 = 0.003;
const MOST_STEPS: usize = 10;
/// From this step on the pixels' weights are held: with some outliers weights and place would oscillate.
const REWEIGHTED_STEPS: usize = 6;
/// Pixels farther than this from the model, in sigma, may be something else: hot pixels, scratches.
const DOUBTED_SIGMA: f64 = 3.0;
/// Beyond the noise, the model may be off by this part of the light: a blur that is not quite the lens's shows at the arms'
/// edges, and rejecting some of them would move the mark.
const MODEL_ERROR: f32 = 0.04;
/// What the blurred product leaves out is about this part of s^2 div grad L', of a mark of contrast 1.
const LEFT_OUT: f32 = 0.4;
/// Fewest pixels that make a fit, for each unknown.
const MIN_PIXELS_PER_UNKNOWN: usize = 10;

/// What is fitted, by index: the offset from where the mark is expected, px; the mark's contrast; the light over the
/// expected light there, and how that changes over the patch's radius along x and y.
pub(super) type Unknowns = Vector6<f64>;
pub(super) const X: usize = 0;
pub(super) const Y: usize = 1;
pub(super) const CONTRAST: usize = 2;
pub(super) const LEVEL: usize = 3;
const UNKNOWNS: usize = 6;
/// The unknowns before the fit, and what is known of them, 1 / sigma: it holds in place what a saturated or cut patch does
/// not determine.
const EXPECTED: [f64; UNKNOWNS] = [0.0, 0.0, 0.5, 1.0, 0.0, 0.0];
const EXPECTED_INVERSE_SIGMA: [f64; UNKNOWNS] = [0.0, 0.0, 2.0, 2.0, 5.0, 5.0];

/// One mark's fit.
pub(super) struct MarkFit<'a> {
    pub patch: &'a Patch,
    pub shape: &'a CrossShape,
    /// From an offset on the sensor to one along the arms, both px.
    pub to_arms: Matrix2<f64>,
    /// Radius of the patch, px.
    pub reach: f64,
    pub noise: PixelNoise,
}

/// Where a fit settled.
pub(super) struct Settled {
    pub unknowns: Unknowns,
    /// Of the place, px^2; inflated where the residuals scatter by more than the stated noise.
    pub covariance: Matrix2<f64>,
    /// Mean square of the residuals in units of the pixels' stated variance.
    pub reduced_chi2: f64,
    /// Pixels that were not rejected.
    pub pixels: usize,
}

impl MarkFit<'_> {
    /// Steps until the place settles. `None` when the pixels are too few, or the place goes farther than a mark may be.
    pub(super) fn run(&self, farthest_px: f64) -> Option<Settled> {
        let mut unknowns = Unknowns::from(EXPECTED);
        let mut weights = self.patch.counts.clone();
        // The very first model is too far off to tell outliers.
        let mut reduced_chi2 = 1.0;
        let mut last_move = Vector2::zeros();
        for step_number in 0..MOST_STEPS {
            let model = linearise(self, &unknowns);
            if (1..REWEIGHTED_STEPS).contains(&step_number) {
                weights = model.weights(&self.patch.counts).unwrap_or(weights);
            }
            let normal = model.normal_equations(&weights)?;
            let mut step = normal.step(&unknowns, reduced_chi2)?;
            reduced_chi2 = normal.reduced_chi2_after(&step);
            // A higher contrast needs a smaller shift for the same change of the picture.
            let higher = unknowns[CONTRAST] / (unknowns[CONTRAST] + step[CONTRAST]);
            let mut moved = step.fixed_rows::<2>(X) * higher.clamp(0.0, 1.0);
            // A step back shows that the one before was too long.
            if moved.dot(&last_move) < 0.0 {
                moved /= 2.0;
            }
            last_move = moved;
            step.fixed_rows_mut::<2>(X).copy_from(&moved);
            unknowns += step;
            if unknowns[X].hypot(unknowns[Y]) > farthest_px {
                return None;
            }
            if step_number > 0 && moved.norm() < SETTLED_PX {
                return Some(Settled {
                    unknowns,
                    covariance: normal.covariance_of_place(reduced_chi2)?,
                    reduced_chi2,
                    pixels: normal.pixels,
                });
            }
        }
        None
    }
}

/// The model at some unknowns: residuals and slopes of every pixel in units of its sigma.
#[multiversion(targets("x86_64+avx2"))]
fn linearise(fit: &MarkFit<'_>, unknowns: &Unknowns) -> Linearised {
    let Patch {
        x,
        y,
        seen,
        light,
        slope_x,
        slope_y,
        bend,
        ..
    } = fit.patch;
    let [at_x, at_y, contrast, even, tilt_x, tilt_y] = unknowns.map(|v| v as f32).into();
    let [from_x, from_y] = [(x, at_x), (y, at_y)].map(|(x, at)| combine([x], |[x]| x - at));
    let coverage = fit.shape.coverage(&from_x, &from_y, &fit.to_arms);
    let blur_variance = fit.shape.blur_px.powi(2) as f32;
    let per_reach = 1.0 / fit.reach as f32;
    // The light that a mark of contrast 1 takes, and what this one leaves.
    let Coverage {
        share,
        slope_x: share_x,
        slope_y: share_y,
    } = &coverage;
    let taken = combine(
        [light, share, slope_x, share_x, slope_y, share_y],
        |[light, share, slope_x, share_x, slope_y, share_y]| {
            light * share + blur_variance * (slope_x * share_x + slope_y * share_y)
        },
    );
    let left = combine([light, &taken], |[light, taken]| light - contrast * taken);
    let level = combine([x, y], |[x, y]| {
        even + (tilt_x * x + tilt_y * y) * per_reach
    });
    let per_sigma = combine([&level, &left, bend], |[level, left, bend]| {
        let left_out = f64::from(LEFT_OUT * blur_variance * bend);
        let variance = fit.noise.variance(f64::from(level * left)) + left_out * left_out;
        (1.0 / variance.sqrt()) as f32
    });
    let scale = combine([&per_sigma, &level], |[per_sigma, level]| per_sigma * level);
    let by_place = |share: &[f32]| {
        combine([&scale, light, share], |[scale, light, share]| {
            scale * contrast * light * share
        })
    };
    let by_level = combine([&per_sigma, &left], |[per_sigma, left]| per_sigma * left);
    let by_tilt = |x: &[f32]| combine([&by_level, x], |[by_level, x]| by_level * x * per_reach);
    Linearised {
        residuals: combine(
            [&per_sigma, seen, &level, &left],
            |[per_sigma, seen, level, left]| per_sigma * (seen - level * left),
        ),
        allowed: combine([&per_sigma, light], |[per_sigma, light]| {
            per_sigma * MODEL_ERROR * light
        }),
        slopes: [
            by_place(share_x),
            by_place(share_y),
            combine([&scale, &taken], |[scale, taken]| -scale * taken),
            by_level.clone(),
            by_tilt(x),
            by_tilt(y),
        ],
    }
}

/// A model near some unknowns, pixel by pixel, in units of the pixels' sigma.
struct Linearised {
    /// Change of the prediction with each unknown.
    slopes: [Vec<f32>; UNKNOWNS],
    /// Seen minus predicted.
    residuals: Vec<f32>,
    /// By how much the model itself may be off.
    allowed: Vec<f32>,
}

impl Linearised {
    /// Weights 1 of pixels within a limit of the model and 0 beyond twice that, of those that count: the limit by the scatter that
    /// most pixels show, at least the stated one, and by what the model may be off. `None` of too few pixels.
    fn weights(&self, counts: &[f32]) -> Option<Vec<f32>> {
        // Outliers must not widen the limit by themselves, so the scatter starts from what is expected.
        let model_error = self.allowed.iter().copied().fold(0.0, larger);
        let counted = combine([&self.residuals, counts], |[residual, counts]| {
            residual * counts
        });
        let scatter = clipped_sigma(&counted, (0.5 * model_error).max(1.0), 1.0)?;
        let limit = (DOUBTED_SIGMA * scatter) as f32;
        let weight = |[residual, allowed, counts]: [f32; 3]| {
            let weight = 2.0 - residual.abs() / (limit + allowed);
            counts * larger(smaller(weight, 1.0), 0.0)
        };
        Some(combine([&self.residuals, &self.allowed, counts], weight))
    }

    /// `None` of too few pixels.
    fn normal_equations(&self, weights: &[f32]) -> Option<NormalEquations> {
        let pixels = weights.iter().filter(|weight| **weight > 0.0).count();
        if pixels < MIN_PIXELS_PER_UNKNOWN * UNKNOWNS {
            return None;
        }
        // The last row and column belong to the residuals.
        let [a, b, c, d, e, f] = &self.slopes;
        let sums = products([a, b, c, d, e, f, &self.residuals], weights);
        let sum = |m: usize, n: usize| f64::from(sums[m.max(n)][m.min(n)]);
        let total: f32 = weights.iter().sum();
        Some(NormalEquations {
            information: Matrix6::from_fn(sum),
            gradient: Vector6::from_fn(|m, _| sum(m, UNKNOWNS)),
            chi2: sum(UNKNOWNS, UNKNOWNS),
            freedoms: f64::from(total) * (1.0 - UNKNOWNS as f64 / pixels as f64),
            pixels,
        })
    }
}

/// The normal equations of a step, by the stated variances.
struct NormalEquations {
    information: Matrix6<f64>,
    gradient: Vector6<f64>,
    chi2: f64,
    freedoms: f64,
    /// Pixels that count.
    pixels: usize,
}

impl NormalEquations {
    /// Inverse of the unknowns' covariance, of pixels and prior together. The pixels' variances are inflated by their
    /// chi^2 where that is larger than 1.
    fn precision(&self, reduced_chi2: f64) -> Matrix6<f64> {
        self.information / reduced_chi2.max(1.0) + Matrix6::from_diagonal(&prior_information())
    }

    /// The Gauss-Newton step.
    fn step(&self, unknowns: &Unknowns, reduced_chi2: f64) -> Option<Unknowns> {
        let to_prior = prior_information().component_mul(&(Unknowns::from(EXPECTED) - unknowns));
        let gradient = self.gradient / reduced_chi2.max(1.0) + to_prior;
        Some(self.precision(reduced_chi2).cholesky()?.solve(&gradient))
    }

    fn covariance_of_place(&self, reduced_chi2: f64) -> Option<Matrix2<f64>> {
        let factor = self.precision(reduced_chi2).cholesky()?;
        Some(
            factor
                .solve(&Matrix6x2::identity())
                .fixed_rows::<2>(X)
                .into_owned(),
        )
    }

    /// Mean square of the residuals, less what a step explains.
    fn reduced_chi2_after(&self, step: &Unknowns) -> f64 {
        let explained = 2.0 * step.dot(&self.gradient) - step.dot(&(self.information * step));
        ((self.chi2 - explained) / self.freedoms).max(0.0)
    }
}

/// 1 / variance of the unknowns before the fit.
fn prior_information() -> Unknowns {
    Unknowns::from(EXPECTED_INVERSE_SIGMA.map(|s| s * s))
}
