//! One mark's fit: place, contrast and light by Gauss and Newton's steps on the pixels of its patch.
//!
//! What the cross covers is laid once, about the patch's middle. As far as a mark may be from there, the coverage follows by
//! its slopes and bends.

use super::coverage::{BlurredCross, Coverage, Pose};
use super::patch::Patch;
use crate::estimation::clipped_sigma;
use crate::frame::ROUNDING_NOISE_DN;
use crate::lanes::{LANES, Scratch, groups, groups_mut, larger, smaller};
use multiversion::multiversion;
use nalgebra::{Matrix2, Matrix6, Matrix6x2, Vector6};

/// A mark so near the patch's middle is fitted there, px: its slopes and bends tell the coverage, to 0.0005 px of its place.
pub(super) const NEAR_PX: f64 = 0.15;
/// A step as short as this ends where the next one would, px.
const SETTLED_PX: f64 = 0.003;
const MOST_LOOKS: usize = 10;
/// Pixels farther than this from the model, in sigma, may be something else: hot pixels, scratches.
const DOUBTED_SIGMA: f32 = 3.0;
/// Beyond the noise, the model may be off by this part of the light: a blur that is not quite the lens's shows at the arms'
/// edges, and leaving out some of them would move the mark.
const MODEL_ERROR: f32 = 0.04;
/// Fewest pixels that make a fit.
const MIN_PIXELS: usize = 60;

/// What is fitted, by index: the offset from the patch's middle, px; the mark's contrast; the light over the expected light
/// there, and how that changes over the patch's radius along x and y.
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
pub(super) struct MarkFit<'a> {
    pub patch: &'a Patch,
    pub cross: BlurredCross,
    /// From an offset on the sensor to one along the arms, both px, by rows.
    pub to_arms: [f32; 4],
    pub blur_variance: f32,
    pub reach: f32,
    pub noise_dn: f64,
}

/// Where a fit ended: settled, or farther from the patch's middle than [`NEAR_PX`].
pub(super) struct Ended {
    pub unknowns: Unknowns,
    /// Of the place, px^2.
    pub covariance: Matrix2<f64>,
    /// Of the residuals, DN^2.
    pub variance: f64,
    pub pixels: usize,
}

impl Ended {
    /// The unknowns of a patch about the place.
    fn in_its_middle(&self) -> Unknowns {
        let mut unknowns = self.unknowns;
        unknowns.fixed_rows_mut::<2>(X).fill(0.0);
        unknowns
    }
}

impl MarkFit<'_> {
    /// Steps until the place settles or is too far for the patch, `before` telling where the fit on another patch ended, in
    /// the middle of this one. `None` when the pixels are too few.
    pub(super) fn run(&self, before: Option<&Ended>) -> Option<Ended> {
        let mut unknowns = before.map_or(Unknowns::from(EXPECTED), Ended::in_its_middle);
        let allowed_dn = (MODEL_ERROR * self.patch.most_light).max(ROUNDING_NOISE_DN as f32);
        // What does not belong must not widen the limits by itself, so these start from what is known.
        let expected_dn = (0.5 * allowed_dn).max(self.noise_dn as f32);
        let mut variance = before.map_or(self.noise_dn.powi(2), |ended| ended.variance);
        let coverage = self.coverage();
        let mut linear = Linear::new(self.patch);
        for look in 0..MOST_LOOKS {
            self.lay(&unknowns, &coverage, &mut linear);
            // The very first model is too far off to tell what does not belong.
            let told = look > 0 || before.is_some();
            if told {
                linear.reject(self.patch, expected_dn, allowed_dn);
            }
            let normal = linear.normal_equations(self.patch)?;
            let mut step = normal.step(&unknowns, variance)?;
            variance = normal.variance_after(&step);
            // What moves a pale model far moves one of the new contrast less far.
            let paler = unknowns[CONTRAST] / (unknowns[CONTRAST] + step[CONTRAST]);
            step.fixed_rows_mut::<2>(X).scale_mut(paler.clamp(0.0, 1.0));
            unknowns += step;
            let settled = told && step[X].hypot(step[Y]) < SETTLED_PX;
            if settled || unknowns[X].hypot(unknowns[Y]) > NEAR_PX {
                return Some(Ended {
                    unknowns,
                    covariance: normal.covariance(variance)?,
                    variance,
                    pixels: linear.pixels,
                });
            }
        }
        None
    }

    /// What a cross in the patch's middle covers.
    fn coverage(&self) -> Coverage {
        let pose = Pose {
            middle: [0.0; 2],
            to_arms: self.to_arms,
        };
        let [x, y, ..] = self.patch.lists();
        self.cross.at(x, y, &pose)
    }

    /// Residuals and slopes at the unknowns.
    fn lay(&self, unknowns: &Unknowns, coverage: &Coverage, linear: &mut Linear) {
        let model = Model {
            at: unknowns.cast::<f32>().into(),
            to_arms: self.to_arms,
            blur_variance: self.blur_variance,
            per_reach: 1.0 / self.reach,
        };
        lay_model(self.patch, coverage, &model, linear);
    }
}

/// What the residuals and slopes of every pixel share.
struct Model {
    at: [f32; UNKNOWNS],
    to_arms: [f32; 4],
    blur_variance: f32,
    per_reach: f32,
}

/// How a model changes with each unknown, and its residuals, DN, both times the root of what each pixel counts: by groups
/// of pixels.
struct Linear {
    columns: Scratch<f32>,
    residuals: Scratch<f32>,
    /// What of each pixel is kept, 0 to 1.
    kept: Scratch<f32>,
    /// How many are kept, be it in part.
    pixels: usize,
}

/// The slopes in the unknowns, the residuals.
const COLUMNS: usize = UNKNOWNS + 1;
const RESIDUAL: usize = UNKNOWNS;

type Group = [f32; LANES];
/// Products of columns with those that follow, each lane's own sum.
type Products = [[Group; COLUMNS]; COLUMNS];

impl Linear {
    /// Of a patch whose pixels are all kept.
    fn new(patch: &Patch) -> Self {
        let length = patch.length();
        let mut kept = Scratch::of_length(length);
        kept.fill(1.0);
        Self {
            columns: Scratch::of_length(COLUMNS * length),
            residuals: Scratch::of_length(length),
            kept,
            pixels: patch.pixels,
        }
    }

    /// Keeps less of the pixels that the model is too far from, by the noise that most of them show, about the expected
    /// one, and by what the model itself may be off: all within a limit, nothing beyond twice that.
    fn reject(&mut self, patch: &Patch, expected_dn: f32, allowed_dn: f32) {
        let residuals = &self.residuals[..patch.pixels];
        if let Some(noise_dn) = clipped_sigma(residuals, expected_dn, ROUNDING_NOISE_DN) {
            let limit = DOUBTED_SIGMA * noise_dn as f32 + allowed_dn;
            let left_out = keep_within(limit, &self.residuals, &mut self.kept);
            self.pixels = patch.pixels - total(&left_out) as usize;
        }
    }

    /// `None` of too few pixels.
    fn normal_equations(&self, patch: &Patch) -> Option<Normal> {
        if self.pixels < MIN_PIXELS {
            return None;
        }
        let products = products(&self.columns, &self.kept);
        let mut matrix = Matrix6::zeros();
        for m in 0..UNKNOWNS {
            for n in m..UNKNOWNS {
                matrix[(n, m)] = total(&products[m][n]);
                matrix[(m, n)] = matrix[(n, m)];
            }
        }
        let weight = total(&weight(patch.root_weights(), &self.kept));
        Some(Normal {
            matrix,
            right: Vector6::from_fn(|m, _| total(&products[m][RESIDUAL])),
            squares: total(&products[RESIDUAL][RESIDUAL]),
            freedoms: weight * (1.0 - UNKNOWNS as f64 / self.pixels as f64),
        })
    }
}

/// The normal equations of a step.
struct Normal {
    matrix: Matrix6<f64>,
    right: Vector6<f64>,
    /// Of the residuals, DN^2.
    squares: f64,
    freedoms: f64,
}

impl Normal {
    /// What the pixels tell at a variance, and what is known beforehand: the inverse of the unknowns' covariance.
    fn informed(&self, variance: f64) -> Matrix6<f64> {
        self.matrix / variance + Matrix6::from_diagonal(&known())
    }

    /// Gauss and Newton's step.
    fn step(&self, unknowns: &Unknowns, variance: f64) -> Option<Unknowns> {
        let pull = known().component_mul(&(Unknowns::from(EXPECTED) - unknowns));
        let right = self.right / variance + pull;
        Some(self.informed(variance).cholesky()?.solve(&right))
    }

    /// Of the place, at a variance.
    fn covariance(&self, variance: f64) -> Option<Matrix2<f64>> {
        let of_place = self
            .informed(variance)
            .cholesky()?
            .solve(&Matrix6x2::identity());
        Some(of_place.fixed_rows::<2>(X).into_owned())
    }

    /// The residuals' variance, DN^2, less what a step explains, which is no noise.
    fn variance_after(&self, step: &Unknowns) -> f64 {
        let left = self.squares - 2.0 * step.dot(&self.right) + step.dot(&(self.matrix * step));
        (left / self.freedoms).max(ROUNDING_NOISE_DN.powi(2))
    }
}

/// What is known of the unknowns before the fit, 1 / variance.
fn known() -> Unknowns {
    Unknowns::from(EXPECTED_INVERSE_SIGMA.map(|s| s * s))
}

/// Residuals and slopes of every pixel.
#[multiversion(targets("x86_64+avx2"))]
fn lay_model(patch: &Patch, coverage: &Coverage, model: &Model, linear: &mut Linear) {
    let columns = groups_mut(&mut linear.columns).as_chunks_mut::<COLUMNS>().0;
    let count = columns.len();
    let residuals = &mut groups_mut(&mut linear.residuals)[..count];
    let [x, y, seen, light, slope_x, slope_y, root] = patch.lists();
    let (x, y, seen) = (
        &groups(x)[..count],
        &groups(y)[..count],
        &groups(seen)[..count],
    );
    let (slope_x, slope_y) = (&groups(slope_x)[..count], &groups(slope_y)[..count]);
    let (light, root) = (&groups(light)[..count], &groups(root)[..count]);
    let share = &groups(&coverage.share)[..count];
    let slope_u = &groups(&coverage.slope_u)[..count];
    let slope_v = &groups(&coverage.slope_v)[..count];
    let bend_uu = &groups(&coverage.bend_uu)[..count];
    let bend_uv = &groups(&coverage.bend_uv)[..count];
    let bend_vv = &groups(&coverage.bend_vv)[..count];
    let ([ux, uy, vx, vy], [moved_x, moved_y, ..]) = (model.to_arms, model.at);
    let (moved_u, moved_v) = (ux * moved_x + uy * moved_y, vx * moved_x + vy * moved_y);
    let (contrast, per_reach) = (model.at[CONTRAST], model.per_reach);
    for n in 0..count {
        let mut of_group = [[0.0; LANES]; COLUMNS];
        for k in 0..LANES {
            let by_u = moved_u * bend_uu[n][k] + moved_v * bend_uv[n][k];
            let by_v = moved_u * bend_uv[n][k] + moved_v * bend_vv[n][k];
            let half_way = [slope_u[n][k] - 0.5 * by_u, slope_v[n][k] - 0.5 * by_v];
            let covered = share[n][k] - moved_u * half_way[0] - moved_v * half_way[1];
            let (by_u, by_v) = (slope_u[n][k] - by_u, slope_v[n][k] - by_v);
            let (along_x, along_y) = (ux * by_u + vx * by_v, uy * by_u + vy * by_v);
            let drift = slope_x[n][k] * along_x + slope_y[n][k] * along_y;
            let taken = light[n][k] * covered + model.blur_variance * drift;
            let left = light[n][k] - contrast * taken;
            let (tilt_x, tilt_y) = (x[n][k] * per_reach, y[n][k] * per_reach);
            let level = model.at[LEVEL] + model.at[TILT_X] * tilt_x + model.at[TILT_Y] * tilt_y;
            let root = root[n][k];
            let dark = root * level * contrast * light[n][k];
            of_group[X][k] = dark * along_x;
            of_group[Y][k] = dark * along_y;
            of_group[CONTRAST][k] = -root * level * taken;
            of_group[LEVEL][k] = root * left;
            of_group[TILT_X][k] = root * left * tilt_x;
            of_group[TILT_Y][k] = root * left * tilt_y;
            of_group[RESIDUAL][k] = root * (seen[n][k] - level * left);
        }
        residuals[n] = of_group[RESIDUAL];
        columns[n] = of_group;
    }
}

/// Keeps all of what is within a limit, nothing beyond twice that; how many are left out, by lanes.
#[multiversion(targets("x86_64+avx2"))]
fn keep_within(limit: f32, residuals: &[f32], kept: &mut [f32]) -> Group {
    let mut left_out = [0.0; LANES];
    for (kept, residuals) in groups_mut(kept).iter_mut().zip(groups(residuals)) {
        for k in 0..LANES {
            kept[k] = larger(smaller(2.0 - residuals[k].abs() / limit, 1.0), 0.0);
            left_out[k] += if kept[k] > 0.0 { 0.0 } else { 1.0 };
        }
    }
    left_out
}

/// Products of the columns, summed over what is kept of the pixels.
#[multiversion(targets("x86_64+avx2"))]
fn products(columns: &[f32], kept: &[f32]) -> Products {
    let columns = groups(columns).as_chunks().0;
    let mut sums = [[[0.0; LANES]; COLUMNS]; COLUMNS];
    // As many at a time as the processor holds sums.
    add_products::<0, 2>(columns, kept, &mut sums);
    add_products::<2, 4>(columns, kept, &mut sums);
    add_products::<4, COLUMNS>(columns, kept, &mut sums);
    sums
}

/// What all that is kept counts, each lane's own sum.
#[multiversion(targets("x86_64+avx2"))]
fn weight(roots: &[f32], kept: &[f32]) -> Group {
    let mut sums = [0.0; LANES];
    for (roots, kept) in groups(roots).iter().zip(groups(kept)) {
        for k in 0..LANES {
            sums[k] += roots[k] * roots[k] * kept[k];
        }
    }
    sums
}

/// Adds the products of some columns with those that follow.
#[inline(always)]
fn add_products<const FROM: usize, const TO: usize>(
    columns: &[[Group; COLUMNS]],
    kept: &[f32],
    into: &mut Products,
) {
    let mut sums = *into;
    for (columns, kept) in columns.iter().zip(groups(kept)) {
        for m in FROM..TO {
            let column: Group = std::array::from_fn(|k| columns[m][k] * kept[k]);
            for n in m..COLUMNS {
                for k in 0..LANES {
                    sums[m][n][k] += column[k] * columns[n][k];
                }
            }
        }
    }
    *into = sums;
}

fn total(lanes: &Group) -> f64 {
    f64::from(lanes.iter().sum::<f32>())
}
