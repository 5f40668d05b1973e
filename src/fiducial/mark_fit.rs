//! One mark's fit: place, contrast and light by Gauss-Newton steps on the pixels of its patch, reweighted against outliers.

use super::blurred_dot::BlurredDot;
use super::mark_image::rows;
use super::patch::Patch;
use super::{MarkForm, MarkImage};
use crate::estimation::{Normal, Prior, clipped_sigma};
use crate::frame::PixelNoise;
use crate::kernels::{
    Bars, LANES, blurred_bar, cover_at, groups, larger, long_blurred_bar, products, smaller,
};
use multiversion::multiversion;
use nalgebra::{Matrix2, Matrix6, Vector2, Vector6};

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
const UNKNOWNS: usize = 6;
/// The unknowns before the fit, and what is known of them, 1 / sigma: it holds in place what a saturated or cut patch does
/// not determine.
const EXPECTED: [f64; UNKNOWNS] = [0.0, 0.0, 0.5, 1.0, 0.0, 0.0];
const EXPECTED_INVERSE_SIGMA: [f64; UNKNOWNS] = [0.0, 0.0, 2.0, 2.0, 5.0, 5.0];

/// What a mark takes of the light, and how that changes.
#[derive(Debug, Clone)]
pub(super) enum Cover {
    Cross(Bars),
    Dot(BlurredDot),
}

impl Cover {
    pub fn new(image: &MarkImage) -> Self {
        match image.form {
            MarkForm::Cross { half_width_px } => Self::Cross(image.bars(half_width_px)),
            MarkForm::Dot => Self::Dot(image.dot()),
        }
    }
}

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

/// The lists of a fit, which the next one uses again.
#[derive(Debug, Clone, Default)]
pub(super) struct Lists {
    pub patch: Patch,
    near: Near,
    weights: Vec<[f32; LANES]>,
    counted: Vec<f32>,
}

/// Where a fit settled.
pub(super) struct Settled {
    pub unknowns: Unknowns,
    /// Of the place, px^2; inflated where the residuals scatter by more than the stated noise.
    pub covariance: Matrix2<f64>,
    /// Mean square of the residuals in units of the pixels' stated variance.
    pub reduced_chi2: f64,
}

impl MarkFit<'_> {
    /// Steps until the place settles. `None` when the pixels are too few, or the place goes farther than a mark may be.
    pub(super) fn run(&self, lists: &mut Lists, farthest_px: f64) -> Option<Settled> {
        let prior = Prior {
            mean: Unknowns::from(EXPECTED),
            information: Unknowns::from(EXPECTED_INVERSE_SIGMA.map(|s| s * s)),
        };
        let mut unknowns = prior.mean;
        // The very first model is too far off to tell outliers.
        lists.weights.clear();
        lists.weights.extend_from_slice(groups(&lists.patch.counts));
        let mut reduced_chi2: f64 = 1.0;
        let mut last_move = Vector2::zeros();
        for step_number in 0..MOST_STEPS {
            linearise(self, &lists.patch, &unknowns, &mut lists.near);
            if (1..REWEIGHTED_STEPS).contains(&step_number) {
                lists.weigh();
            }
            let (normal, freedoms) = lists.near.normal_equations(&lists.weights)?;
            // The pixels' variances are inflated by their chi^2 where that is larger than 1.
            let solve = |reduced_chi2: f64| {
                let inflated = normal.weighted(1.0 / reduced_chi2.max(1.0));
                inflated.solve(&prior, &unknowns)
            };
            let mut step = solve(reduced_chi2)?.step;
            reduced_chi2 = (normal.chi2_after(&step) / freedoms).max(0.0);
            // A higher contrast needs a smaller shift for the same change of the picture.
            let higher = unknowns[CONTRAST] / (unknowns[CONTRAST] + step[CONTRAST]);
            let mut moved = step.fixed_rows::<2>(X) * higher.clamp(0.0, 1.0);
            // A step back shows that the one before was too long.
            if moved.dot(&last_move) < 0.0 {
                moved /= 2.0;
            }
            last_move = moved;
            if std::env::var_os("DBG").is_some() {
                eprintln!(
                    "step {step_number} {:?} moved {:.5} contrast {:.4} even {:.4}",
                    unknowns[X],
                    moved.norm(),
                    unknowns[CONTRAST],
                    unknowns[3]
                );
            }
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

/// A model near some unknowns, pixel by pixel, in units of the pixels' sigma.
#[derive(Debug, Clone, Default)]
struct Near {
    /// Change of the prediction with each unknown, then seen minus predicted.
    pixels: Vec<[[f32; LANES]; UNKNOWNS + 1]>,
    /// By how much the model itself may be off.
    allowed: Vec<[f32; LANES]>,
}

/// The model at some unknowns: residuals and slopes of every pixel in units of its sigma.
#[multiversion(targets("x86_64+avx2+fma"))]
fn linearise(fit: &MarkFit<'_>, patch: &Patch, unknowns: &Unknowns, near: &mut Near) {
    match fit.cover {
        Cover::Cross(bars) if bars.has_ends_apart() => linearise_by(
            |to_arms, x, y| cover_at(long_blurred_bar, bars, to_arms, x, y),
            fit,
            patch,
            unknowns,
            near,
        ),
        Cover::Cross(bars) => linearise_by(
            |to_arms, x, y| cover_at(blurred_bar, bars, to_arms, x, y),
            fit,
            patch,
            unknowns,
            near,
        ),
        Cover::Dot(dot) => linearise_by(
            |to_dot, x, y| dot.cover_at(to_dot, x, y),
            fit,
            patch,
            unknowns,
            near,
        ),
    }
}

/// What the model of one pixel needs.
struct PixelModel {
    to_arms: [f32; 4],
    unknowns: [f32; UNKNOWNS],
    noise: [f32; 2],
    blur_variance: f32,
    per_reach: f32,
}

/// One pixel of a patch.
struct Pixel {
    x: f32,
    y: f32,
    seen: f32,
    light: f32,
    slope_x: f32,
    slope_y: f32,
    bend: f32,
}

/// Slopes by the unknowns, residual, and by how much the model may be off, in units of a pixel's sigma; `cover_at` gives what the
/// mark takes of the light at an offset from its middle, and its slopes.
#[inline(always)]
fn near_pixel(
    model: &PixelModel,
    cover_at: &impl Fn([f32; 4], f32, f32) -> [f32; 3],
    pixel: &Pixel,
) -> ([f32; UNKNOWNS + 1], f32) {
    let Pixel { x, y, light, .. } = *pixel;
    let [at_x, at_y, contrast, even, tilt_x, tilt_y] = model.unknowns;
    let per_reach = model.per_reach;
    let [share, share_x, share_y] = cover_at(model.to_arms, x - at_x, y - at_y);
    // The light that a mark of contrast 1 takes, and what this one leaves.
    let taken =
        light * share + model.blur_variance * (pixel.slope_x * share_x + pixel.slope_y * share_y);
    let left = light - contrast * taken;
    let level = even + (tilt_x * x + tilt_y * y) * per_reach;
    let left_out = LEFT_OUT * model.blur_variance * pixel.bend;
    let [dark_dn2, per_light_dn] = model.noise;
    let variance = dark_dn2 + per_light_dn * larger(level * left, 0.0) + left_out * left_out;
    let per_sigma = 1.0 / variance.sqrt();
    let scale = per_sigma * level;
    let (by_place, by_level) = (scale * contrast * light, per_sigma * left);
    let columns = [
        by_place * share_x,
        by_place * share_y,
        -scale * taken,
        by_level,
        by_level * x * per_reach,
        by_level * y * per_reach,
        per_sigma * (pixel.seen - level * left),
    ];
    (columns, per_sigma * MODEL_ERROR * light)
}

#[inline(always)]
fn linearise_by(
    cover_at: impl Fn([f32; 4], f32, f32) -> [f32; 3],
    fit: &MarkFit<'_>,
    patch: &Patch,
    unknowns: &Unknowns,
    near: &mut Near,
) {
    let model = PixelModel {
        to_arms: rows(&fit.to_arms),
        unknowns: unknowns.map(|v| v as f32).into(),
        noise: [fit.noise.dark_dn2, fit.noise.per_light_dn].map(|v| v as f32),
        blur_variance: fit.image.blur_px.powi(2) as f32,
        per_reach: 1.0 / fit.reach as f32,
    };
    let count = patch.x.len() / LANES;
    let [x, y, seen, light, slope_x, slope_y, bend] = [
        &patch.x,
        &patch.y,
        &patch.seen,
        &patch.lit.light,
        &patch.lit.slope_x,
        &patch.lit.slope_y,
        &patch.lit.bend,
    ]
    .map(|list| &groups(list)[..count]);
    near.pixels.clear();
    near.allowed.clear();
    for n in 0..count {
        let mut found = [[0.0; LANES]; UNKNOWNS + 1];
        let mut allowed = [0.0; LANES];
        for k in 0..LANES {
            let here = Pixel {
                x: x[n][k],
                y: y[n][k],
                seen: seen[n][k],
                light: light[n][k],
                slope_x: slope_x[n][k],
                slope_y: slope_y[n][k],
                bend: bend[n][k],
            };
            let values;
            (values, allowed[k]) = near_pixel(&model, &cover_at, &here);
            for (found, value) in found.iter_mut().zip(values) {
                found[k] = value;
            }
        }
        near.pixels.push(found);
        near.allowed.push(allowed);
    }
}

impl Lists {
    /// Weights 1 of pixels within a limit of the model and 0 beyond twice that, of those that count: the limit by the scatter that
    /// most pixels show, at least the stated one, and by what the model may be off. Those of before where pixels are too few.
    fn weigh(&mut self) {
        let Self {
            patch,
            near,
            weights,
            counted,
        } = self;
        counted.clear();
        let counts = groups(&patch.counts);
        // What does not count is beyond every limit.
        for (pixels, counts) in near.pixels.iter().zip(counts) {
            let residuals = pixels[UNKNOWNS];
            counted.extend(std::array::from_fn::<f32, LANES, _>(|k| {
                match counts[k] > 0.0 {
                    true => residuals[k],
                    false => f32::INFINITY,
                }
            }));
        }
        // Outliers must not widen the limit by themselves, so the scatter starts from what is expected.
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

impl Near {
    /// With their degrees of freedom; `None` of too few pixels.
    fn normal_equations(&self, weights: &[[f32; LANES]]) -> Option<(Normal<UNKNOWNS>, f64)> {
        let each = weights.as_flattened();
        let pixels = each.iter().filter(|weight| **weight > 0.0).count();
        if pixels < MIN_PIXELS_PER_UNKNOWN * UNKNOWNS {
            return None;
        }
        // The last row and column belong to the residuals.
        let sums = products(&self.pixels, weights);
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
}
