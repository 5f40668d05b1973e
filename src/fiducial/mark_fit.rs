//! One mark's fit: place, contrast and light by Gauss-Newton steps on the pixels of its patch, reweighted against outliers.

use super::CrossShape;
use super::patch::Patch;
use crate::estimation::clipped_sigma;
use crate::frame::PixelNoise;
use crate::lanes::dot;
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
const TILT_X: usize = 4;
const TILT_Y: usize = 5;
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
        let mut model = Linearised::of_length(self.patch.pixels());
        let mut weights = vec![1.0; self.patch.pixels()];
        // The very first model is too far off to tell outliers.
        let mut reduced_chi2 = 1.0;
        let mut last_move = Vector2::zeros();
        for step_number in 0..MOST_STEPS {
            self.linearise(&unknowns, &mut model);
            if (1..REWEIGHTED_STEPS).contains(&step_number) {
                model.reweight(&mut weights);
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

    /// The model at some unknowns: residuals and slopes of every pixel in units of its sigma.
    fn linearise(&self, unknowns: &Unknowns, model: &mut Linearised) {
        let patch = self.patch;
        let count = patch.pixels();
        let at = unknowns.map(|v| v as f32);
        let [x, y] = [(&patch.x, at[X]), (&patch.y, at[Y])]
            .map(|(list, moved)| list.iter().map(|v| v - moved).collect::<Vec<f32>>());
        let coverage = self.shape.coverage(&x, &y, &self.to_arms);
        let blur_variance = self.shape.blur_px.powi(2) as f32;
        let per_reach = 1.0 / self.reach as f32;
        let Linearised {
            slopes: [by_x, by_y, by_contrast, by_level, by_tilt_x, by_tilt_y],
            residuals,
            allowed,
        } = model;
        for n in 0..count {
            let light = patch.light[n];
            let (slope_x, slope_y) = (coverage.slope_x[n], coverage.slope_y[n]);
            // The light that a mark of contrast 1 takes.
            let taken = light * coverage.share[n]
                + blur_variance * (patch.slope_x[n] * slope_x + patch.slope_y[n] * slope_y);
            let left = light - at[CONTRAST] * taken;
            let (tilt_x, tilt_y) = (patch.x[n] * per_reach, patch.y[n] * per_reach);
            let level = at[LEVEL] + at[TILT_X] * tilt_x + at[TILT_Y] * tilt_y;
            let left_out = LEFT_OUT * blur_variance * patch.bend[n];
            let variance =
                self.noise.variance(f64::from(level * left)) as f32 + left_out * left_out;
            let per_sigma = 1.0 / variance.sqrt();
            let dark = per_sigma * level * at[CONTRAST] * light;
            by_x[n] = dark * slope_x;
            by_y[n] = dark * slope_y;
            by_contrast[n] = -per_sigma * level * taken;
            by_level[n] = per_sigma * left;
            by_tilt_x[n] = per_sigma * left * tilt_x;
            by_tilt_y[n] = per_sigma * left * tilt_y;
            residuals[n] = per_sigma * (patch.seen[n] - level * left);
            allowed[n] = per_sigma * MODEL_ERROR * light;
        }
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
    fn of_length(count: usize) -> Self {
        Self {
            slopes: std::array::from_fn(|_| vec![0.0; count]),
            residuals: vec![0.0; count],
            allowed: vec![0.0; count],
        }
    }

    /// Weights 1 of pixels within a limit of the model and 0 beyond twice that: the limit by the scatter that most pixels show,
    /// at least the stated one, and by what the model may be off.
    fn reweight(&self, weights: &mut [f32]) {
        // Outliers must not widen the limit by themselves, so the scatter starts from what is expected.
        let model_error = self.allowed.iter().copied().fold(0.0, f32::max);
        let Some(scatter) = clipped_sigma(&self.residuals, (0.5 * model_error).max(1.0), 1.0)
        else {
            return;
        };
        let limit = (DOUBTED_SIGMA * scatter) as f32;
        let pixels = self.residuals.iter().zip(&self.allowed);
        for (weight, (residual, allowed)) in weights.iter_mut().zip(pixels) {
            *weight = (2.0 - residual.abs() / (limit + allowed)).clamp(0.0, 1.0);
        }
    }

    /// `None` of too few pixels.
    fn normal_equations(&self, weights: &[f32]) -> Option<NormalEquations> {
        let pixels = weights.iter().filter(|weight| **weight > 0.0).count();
        if pixels < MIN_PIXELS_PER_UNKNOWN * UNKNOWNS {
            return None;
        }
        let weighted = |list: &Vec<f32>| -> Vec<f32> {
            list.iter()
                .zip(weights)
                .map(|(v, weight)| v * weight)
                .collect()
        };
        let mut information = Matrix6::zeros();
        let mut gradient = Vector6::zeros();
        for (m, slopes) in self.slopes.iter().enumerate() {
            let slopes = weighted(slopes);
            gradient[m] = f64::from(dot(&slopes, &self.residuals));
            for n in 0..=m {
                information[(m, n)] = f64::from(dot(&slopes, &self.slopes[n]));
                information[(n, m)] = information[(m, n)];
            }
        }
        let total: f32 = weights.iter().sum();
        Some(NormalEquations {
            information,
            gradient,
            chi2: f64::from(dot(&weighted(&self.residuals), &self.residuals)),
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
