//! Fit of one mark: position, contrast and illumination by Gauss-Newton steps on the pixels of its patch, reweighted
//! against outliers.

use super::MarkImage;
use super::mark_image::{Cover, rows};
use super::patch::Patch;
use crate::estimation::{Normal, Prior, clipped_sigma};
use crate::frame::PixelNoise;
use crate::kernels::marks::{Coverage, MarkModel, MarkPixels, Near, Offsets, UNKNOWNS, linearise};
use crate::kernels::{LANES, groups, larger, products, smaller};
use nalgebra::{Matrix2, Matrix6, Vector2, Vector6};

/// The fit has converged when a step is shorter than this, px: a tenth of the noise error in a clean frame.
const SETTLED_PX: f64 = 0.003;
const MOST_STEPS: usize = 10;
/// From this step on the pixels' weights are held: with some outliers, weights and position would oscillate.
const REWEIGHTED_STEPS: usize = 6;
/// Pixels farther than this from the model, in sigma, are down-weighted: hot pixels, scratches.
const DOUBTED_SIGMA: f64 = 3.0;
/// Fewest pixels of a fit, per unknown.
const MIN_PIXELS_PER_UNKNOWN: usize = 10;

/// Unknowns of the fit, indexed as [`UNKNOWNS`] states.
pub(super) type Unknowns = Vector6<f64>;
pub(super) const X: usize = 0;
pub(super) const Y: usize = 1;
pub(super) const CONTRAST: usize = 2;
/// Prior of the unknowns: mean, and 1 / sigma. It constrains unknowns that a saturated or cut patch does not determine.
const EXPECTED: [f64; UNKNOWNS] = [0.0, 0.0, 0.5, 1.0, 0.0, 0.0];
const EXPECTED_INVERSE_SIGMA: [f64; UNKNOWNS] = [0.0, 0.0, 2.0, 2.0, 5.0, 5.0];

/// One mark's fit.
pub(super) struct MarkFit<'a> {
    pub image: &'a MarkImage,
    pub cover: &'a Cover,
    /// From an offset on the sensor to one along the arms, both px.
    pub to_arms: Matrix2<f64>,
    /// Radius of the patch, px.
    pub reach: f64,
    pub noise: PixelNoise,
}

/// Buffers of a fit, reused for the next one.
#[derive(Debug, Clone, Default)]
pub(super) struct Lists {
    pub patch: Patch,
    coverage: Coverage,
    near: Near,
    weights: Vec<[f32; LANES]>,
    counted: Vec<f32>,
}

/// Result of a converged fit.
pub(super) struct Settled {
    pub unknowns: Unknowns,
    /// Covariance of the position, px^2; inflated if the residuals scatter by more than the stated noise.
    pub covariance: Matrix2<f64>,
    /// Mean square of the residuals in units of the pixels' stated variance.
    pub reduced_chi2: f64,
}

impl MarkFit<'_> {
    /// Iterates until the position converges. `None` if there are too few pixels, or the position moves farther than
    /// allowed.
    pub(super) fn run(&self, lists: &mut Lists, farthest_px: f64) -> Option<Settled> {
        let prior = Prior {
            mean: Unknowns::from(EXPECTED),
            information: Unknowns::from(EXPECTED_INVERSE_SIGMA.map(|s| s * s)),
        };
        let mut unknowns = prior.mean;
        // The first model is too far off to identify outliers.
        lists.weights.clear();
        lists.weights.extend_from_slice(groups(&lists.patch.counts));
        let mut reduced_chi2: f64 = 1.0;
        let mut last_move = Vector2::zeros();
        for step_number in 0..MOST_STEPS {
            lists.linearise(self, &unknowns);
            if (1..REWEIGHTED_STEPS).contains(&step_number) {
                lists.weigh();
            }
            let (normal, freedoms) = normal_equations(&lists.near, &lists.weights)?;
            // The pixels' variances are inflated by their reduced chi^2 if that is larger than 1.
            let solve = |reduced_chi2: f64| {
                let inflated = normal.weighted(1.0 / reduced_chi2.max(1.0));
                inflated.solve(&prior, &unknowns)
            };
            let mut step = solve(reduced_chi2)?.step;
            reduced_chi2 = (normal.chi2_after(&step) / freedoms).max(0.0);
            // A higher contrast needs a smaller shift for the same change of the picture.
            let higher = unknowns[CONTRAST] / (unknowns[CONTRAST] + step[CONTRAST]);
            let mut moved = step.fixed_rows::<2>(X) * higher.clamp(0.0, 1.0);
            // A reversed step shows that the previous one was too long.
            if moved.dot(&last_move) < 0.0 {
                moved /= 2.0;
            }
            last_move = moved;
            let settled = step_number > 0 && moved.norm() < SETTLED_PX;
            let settled = settled.then(|| solve(reduced_chi2));
            step.fixed_rows_mut::<2>(X).copy_from(&moved);
            unknowns += step;
            if unknowns[X].hypot(unknowns[Y]) > farthest_px {
                return None;
            }
            if let Some(solved) = settled {
                let covariance = solved?.covariance();
                return Some(Settled {
                    unknowns,
                    covariance: covariance.fixed_view::<2, 2>(X, X).into_owned(),
                    reduced_chi2,
                });
            }
        }
        None
    }
}

impl Lists {
    /// The model at the given unknowns.
    fn linearise(&mut self, fit: &MarkFit<'_>, unknowns: &Unknowns) {
        let Patch {
            x, y, seen, lit, ..
        } = &self.patch;
        let from = [X, Y].map(|axis| -unknowns[axis] as f32);
        fit.cover.at(
            rows(&fit.to_arms),
            Offsets { from, x, y },
            &mut self.coverage,
        );
        let model = MarkModel {
            unknowns: unknowns.map(|v| v as f32).into(),
            dark_dn2: fit.noise.dark_dn2 as f32,
            per_light_dn: fit.noise.per_light_dn as f32,
            blur_variance: fit.image.blur_px.powi(2) as f32,
            per_reach: 1.0 / fit.reach as f32,
        };
        let coverage = &self.coverage;
        let pixels = MarkPixels {
            x,
            y,
            seen,
            lit,
            coverage,
        };
        linearise(&model, pixels, &mut self.near);
    }

    /// Weights of the pixels that count: 1 within a limit of the model, 0 beyond twice that. The limit comes from the
    /// scatter of the pixels, at least the stated one, and from the model's own error. If there are too few pixels, the
    /// previous weights stay.
    fn weigh(&mut self) {
        let Self {
            patch,
            near,
            weights,
            counted,
            ..
        } = self;
        counted.clear();
        let counts = groups(&patch.counts);
        // Pixels that do not count are placed beyond every limit.
        for (pixels, counts) in near.pixels.iter().zip(counts) {
            let residuals = pixels[UNKNOWNS];
            counted.extend(std::array::from_fn::<f32, LANES, _>(|k| {
                match counts[k] > 0.0 {
                    true => residuals[k],
                    false => f32::INFINITY,
                }
            }));
        }
        // Outliers must not widen the limit by themselves, so the scatter starts from its expected value.
        let model_error = near
            .allowed
            .as_flattened()
            .iter()
            .copied()
            .fold(0.0, larger);
        let Some(scatter) = clipped_sigma(counted, (0.5 * model_error).max(1.0), 1.0) else {
            return;
        };
        let limit = (DOUBTED_SIGMA * scatter) as f32;
        weights.clear();
        let pixels = near.pixels.iter().zip(&near.allowed).zip(counts);
        weights.extend(pixels.map(|((pixels, allowed), counts)| {
            std::array::from_fn(|k| {
                let within = 2.0 - pixels[UNKNOWNS][k].abs() / (limit + allowed[k]);
                counts[k] * larger(smaller(within, 1.0), 0.0)
            })
        }));
    }
}

/// The normal equations of a model, with their degrees of freedom; `None` if there are too few pixels.
fn normal_equations(near: &Near, weights: &[[f32; LANES]]) -> Option<(Normal<UNKNOWNS>, f64)> {
    let each = weights.as_flattened();
    let pixels = each.iter().filter(|weight| **weight > 0.0).count();
    if pixels < MIN_PIXELS_PER_UNKNOWN * UNKNOWNS {
        return None;
    }
    // The last row and column contain the residuals.
    let sums = products(&near.pixels, weights);
    let sum = |m: usize, n: usize| f64::from(sums[m.max(n)][m.min(n)]);
    let total: f32 = each.iter().sum();
    let normal = Normal {
        information: Matrix6::from_fn(sum),
        gradient: Vector6::from_fn(|m, _| sum(m, UNKNOWNS)),
        chi2: sum(UNKNOWNS, UNKNOWNS),
    };
    let freedoms = f64::from(total) * (1.0 - UNKNOWNS as f64 / pixels as f64);
    Some((normal, freedoms))
}
