//! A mark's place by least squares on its pixels.
//!
//! The picture is the plate's light L times what the mark leaves of it, 1 - c C, and blurred. For a Gaussian blur s the
//! blur of a product is exp(s^2 grad . grad) of the product of the blurred factors L' and C', one gradient acting on each:
//!
//! > blur(L (1 - c C)) = L' (1 - c C') - c s^2 grad L' . grad C' - ...
//!
//! The second term keeps a mark in its place where the light falls towards the limb: without it, marks there are seen up
//! to 0.02 px too far inwards. What follows matters only where the light bends within a blur's width, that is at the
//! limb's very edge, where pixels weigh little for it.
//!
//! # When it fails
//! Where the limb leaves a single arm, nothing tells the place along that arm: the covariance says so, or there is no
//! result.

use super::CrossShape;
use super::profile::Profile;
use crate::frame::{Frame, Levels, ROUNDING_NOISE_DN, Sample, View};
use crate::plate::Cross;
use crate::units::{Estimate, SensorPx};
use crate::with_view;
use nalgebra::{Matrix2, Matrix6, Vector2, Vector6};

/// Ground about the cross that takes part, px: it tells the light's level and slope.
const GROUND_PX: f64 = 2.5;
/// A mark farther than this from where it was expected is not that mark.
const FARTHEST_PX: f64 = 1.5;
/// A step shorter than this is the last: the next would be its square.
const LAST_STEP_PX: f64 = 0.02;
const MOST_STEPS: usize = 8;
/// Pixels farther than this from the model, in sigma, may be something else: hot pixels, scratches.
const DOUBTED_SIGMA: f32 = 3.0;
/// Beyond the noise, the model may be off by this part of the light: a blur that is not quite the lens's shows at the arms'
/// edges, and leaving out some of them would move the mark.
const MODEL_ERROR: f32 = 0.04;
/// Where less than this part of the patch's most light falls, a pixel tells nothing of the mark.
const LEAST_LIGHT: f32 = 0.05;
/// Fewest pixels that make a fit.
const MIN_PIXELS: usize = 60;
/// What the blurred product leaves out is about this part of s^2 div grad L', of a mark of contrast 1.
const LEFT_OUT: f32 = 0.4;

/// What is fitted, by index: the offset from the start, px; the mark's contrast; the light over the expected light at the
/// start, and how that changes over the patch's radius along x and y.
type Unknowns = Vector6<f64>;
const X: usize = 0;
const Y: usize = 1;
const CONTRAST: usize = 2;
const LEVEL: usize = 3;
const TILT_X: usize = 4;
const TILT_Y: usize = 5;
const UNKNOWNS: usize = 6;
/// The unknowns before the fit, and what is known of them, 1 / sigma: it holds in place what a saturated or cut patch does
/// not tell.
const EXPECTED: [f64; UNKNOWNS] = [0.0, 0.0, 0.5, 1.0, 0.0, 0.0];
const EXPECTED_INVERSE_SIGMA: [f64; UNKNOWNS] = [0.0, 0.0, 2.0, 2.0, 5.0, 5.0];

/// A mark as its pixels show it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefinedMark {
    /// Where it is, with the covariance that the fit's own noise makes.
    pub place: Estimate<SensorPx>,
    /// Darkness of the cross as a fraction of the light around it.
    pub contrast: f64,
    /// The light around it over the light that was expected.
    pub level: f64,
    /// Mean square of the residuals in units of the frame's background noise.
    pub reduced_chi2: f64,
    /// Pixels that took part.
    pub pixels: usize,
}

/// Refines the marks of a frame: their shape at the frame's scale and blur.
#[derive(Debug, Clone)]
pub struct Refiner {
    profile: Profile,
    shape: CrossShape,
    scale_mil_per_px: f64,
}

impl Refiner {
    /// For crosses of the plate at a scale and a lens's blur (1 sigma). A blur that is off by a fifth moves no mark.
    pub fn new(cross: &Cross, scale_mil_per_px: f64, lens_blur_px: f64) -> Self {
        let shape = CrossShape::new(cross, scale_mil_per_px, lens_blur_px);
        Self {
            profile: Profile::new(&shape),
            shape,
            scale_mil_per_px,
        }
    }

    /// The mark near `start`, within about 0.3 px.
    ///
    /// `light` is the blurred light without marks at a sensor position (x, y), DN above background; `jacobian` the
    /// mapping from plate to sensor there, px per mil. `None` when the pixels do not lead to a mark near the start.
    pub fn refine(
        &self,
        frame: &Frame,
        levels: &Levels,
        light: impl Fn(f64, f64) -> f64,
        jacobian: &Matrix2<f64>,
        start: SensorPx,
    ) -> Option<RefinedMark> {
        let to_arms = jacobian.try_inverse()? / self.scale_mil_per_px;
        let reach = self.shape.half_length_px + GROUND_PX;
        let map = LightMap::about(start, reach, light);
        let patch = with_view!(frame, view => {
            let saturation_dn = f32::from(frame.saturation_dn());
            Patch::cut(&view, saturation_dn, levels.background_dn as f32, &map, start, reach)
        });
        let noise_dn = levels.noise_dn.max(ROUNDING_NOISE_DN);
        let blur_variance = self.shape.blur_px.powi(2) as f32;
        let left_out = |bend: &f32| LEFT_OUT * blur_variance * bend / noise_dn as f32;
        let root_weight = |bend: &f32| 1.0 / (1.0 + left_out(bend).powi(2)).sqrt();
        let fit = Fit {
            root_weights: patch.bend.iter().map(root_weight).collect(),
            patch: &patch,
            profile: &self.profile,
            to_arms: to_arms.cast(),
            blur_variance,
            reach: reach as f32,
            noise_dn,
        };
        let found = fit.run()?;
        let offset = Vector2::new(found.unknowns[X], found.unknowns[Y]);
        let covariance = found.covariance.fixed_view::<2, 2>(X, X).into_owned();
        let sound = found.unknowns[CONTRAST] > 0.0 && covariance.iter().all(|v| v.is_finite());
        sound.then(|| RefinedMark {
            place: Estimate {
                position: (start.vector() + offset).into(),
                covariance,
            },
            contrast: found.unknowns[CONTRAST],
            level: found.unknowns[LEVEL],
            reduced_chi2: found.variance / noise_dn.powi(2),
            pixels: found.pixels,
        })
    }
}

/// Light without marks on the pixels of a square, with one more pixel around for the slopes.
struct LightMap {
    left: isize,
    top: isize,
    side: usize,
    light: Vec<f32>,
}

impl LightMap {
    fn about(start: SensorPx, reach: f64, light: impl Fn(f64, f64) -> f64) -> Self {
        let whole = reach.ceil() as isize + 1;
        let (left, top) = (
            start.x.round() as isize - whole,
            start.y.round() as isize - whole,
        );
        let side = 2 * whole as usize + 1;
        let at = |n: usize| {
            let (x, y) = (left + (n % side) as isize, top + (n / side) as isize);
            light(x as f64, y as f64) as f32
        };
        Self {
            left,
            top,
            side,
            light: (0..side * side).map(at).collect(),
        }
    }

    fn most(&self) -> f32 {
        self.light.iter().copied().fold(0.0, f32::max)
    }
}

/// The pixels about a mark, one list for each quantity, as vector instructions like it. Positions count from the start.
#[derive(Default)]
struct Patch {
    x: Vec<f32>,
    y: Vec<f32>,
    /// Seen above background, DN.
    seen: Vec<f32>,
    /// Light without the mark, DN, its slopes, DN/px, and how it bends (div grad), DN/px^2.
    light: Vec<f32>,
    slope_x: Vec<f32>,
    slope_y: Vec<f32>,
    bend: Vec<f32>,
}

impl Patch {
    /// The lit pixels within `reach` of the start that are not saturated.
    fn cut<T: Sample>(
        view: &View<'_, T>,
        saturation_dn: f32,
        background_dn: f32,
        map: &LightMap,
        start: SensorPx,
        reach: f64,
    ) -> Self {
        let least = LEAST_LIGHT * map.most();
        let column = |n: usize| usize::try_from(map.left + n as isize).ok();
        let row = |n: usize| usize::try_from(map.top + n as isize).ok();
        let inner = 1..map.side - 1;
        let mut patch = Self::default();
        for (m, y) in inner.clone().filter_map(|m| Some((m, row(m)?))) {
            let dy = y as f64 - start.y;
            let half = (reach * reach - dy * dy).max(0.0).sqrt();
            for (n, x) in inner.clone().filter_map(|n| Some((n, column(n)?))) {
                let dx = x as f64 - start.x;
                if dx.abs() >= half || x >= view.width || y >= view.height {
                    continue;
                }
                let (dn, here) = (view.dn(x, y), m * map.side + n);
                if dn < saturation_dn && map.light[here] > least {
                    patch.x.push(dx as f32);
                    patch.y.push(dy as f32);
                    patch.seen.push(dn - background_dn);
                    patch.light.push(map.light[here]);
                    let [left, right] = [map.light[here - 1], map.light[here + 1]];
                    let [above, below] = [here - map.side, here + map.side].map(|n| map.light[n]);
                    patch.slope_x.push((right - left) / 2.0);
                    patch.slope_y.push((below - above) / 2.0);
                    patch
                        .bend
                        .push(left + right + above + below - 4.0 * map.light[here]);
                }
            }
        }
        patch
    }

    fn len(&self) -> usize {
        self.x.len()
    }
}

/// Residuals of a model, DN, and how the model changes with each unknown; one entry a pixel.
struct Linear {
    /// Roots of the weights that residuals and slopes carry.
    root_weights: Vec<f32>,
    residuals: Vec<f32>,
    slopes: [Vec<f32>; UNKNOWNS],
}

/// One mark's fit.
struct Fit<'a> {
    patch: &'a Patch,
    profile: &'a Profile,
    /// From an offset on the sensor to one along the arms, both px.
    to_arms: Matrix2<f32>,
    blur_variance: f32,
    reach: f32,
    noise_dn: f64,
    /// Of each pixel, from what the model leaves out there beside the noise; 1 on the even disc.
    root_weights: Vec<f32>,
}

/// Where a fit ended.
struct Converged {
    unknowns: Unknowns,
    covariance: Matrix6<f64>,
    /// Of the residuals, DN^2.
    variance: f64,
    pixels: usize,
}

impl Fit<'_> {
    /// Gauss and Newton's steps until they are short. `None` when they lead away or the pixels are too few.
    fn run(&self) -> Option<Converged> {
        let mut unknowns = Unknowns::from(EXPECTED);
        let most_light = self.patch.light.iter().copied().fold(0.0, f32::max);
        let allowed_dn = (MODEL_ERROR * most_light).max(ROUNDING_NOISE_DN as f32);
        for attempt in 0..MOST_STEPS {
            let mut linear = self.linearise(&unknowns);
            // The first model is too far off to tell what does not belong.
            if attempt > 0 {
                linear.reject(allowed_dn);
            }
            let pixels = linear.root_weights().filter(|w| *w > 0.0).count();
            if pixels < MIN_PIXELS {
                return None;
            }
            let weight: f64 = linear.root_weights().map(|w| f64::from(w * w)).sum();
            let freedoms = weight * (1.0 - UNKNOWNS as f64 / pixels as f64);
            let (matrix, right, squares) = linear.normal_equations();
            let floor = ROUNDING_NOISE_DN.powi(2);
            let variance = if attempt == 0 {
                self.noise_dn.powi(2)
            } else {
                (squares / freedoms).max(floor)
            };
            let known = Vector6::from(EXPECTED_INVERSE_SIGMA.map(|s| s * s));
            let informed = |variance| matrix / variance + Matrix6::from_diagonal(&known);
            let pull = known.component_mul(&(Unknowns::from(EXPECTED) - unknowns));
            let step = informed(variance)
                .cholesky()?
                .solve(&(right / variance + pull));
            unknowns += step;
            if unknowns[X].hypot(unknowns[Y]) > FARTHEST_PX {
                return None;
            }
            if attempt > 0 && step[X].hypot(step[Y]) < LAST_STEP_PX {
                // What the last step explains is no noise.
                let variance = ((squares - step.dot(&right)) / freedoms).max(floor);
                return Some(Converged {
                    unknowns,
                    covariance: informed(variance).cholesky()?.inverse(),
                    variance,
                    pixels,
                });
            }
        }
        None
    }

    /// The model of every pixel and its slopes.
    fn linearise(&self, at: &Unknowns) -> Linear {
        let patch = self.patch;
        let count = patch.len();
        let mut linear = Linear {
            root_weights: self.root_weights.clone(),
            residuals: vec![0.0; count],
            slopes: std::array::from_fn(|_| vec![0.0; count]),
        };
        let at = at.cast::<f32>();
        let per_reach = 1.0 / self.reach;
        let (to_u, to_v) = (self.to_arms.row(0), self.to_arms.row(1));
        let (ux, uy, vx, vy) = (to_u[0], to_u[1], to_v[0], to_v[1]);
        for n in 0..count {
            let (dx, dy) = (patch.x[n] - at[X], patch.y[n] - at[Y]);
            let covered = self.profile.coverage(ux * dx + uy * dy, vx * dx + vy * dy);
            let along_x = ux * covered.slope_u + vx * covered.slope_v;
            let along_y = uy * covered.slope_u + vy * covered.slope_v;
            let drift = patch.slope_x[n] * along_x + patch.slope_y[n] * along_y;
            let taken = patch.light[n] * covered.share + self.blur_variance * drift;
            let left = patch.light[n] - at[CONTRAST] * taken;
            let (tilt_x, tilt_y) = (patch.x[n] * per_reach, patch.y[n] * per_reach);
            let level = at[LEVEL] + at[TILT_X] * tilt_x + at[TILT_Y] * tilt_y;
            let weight = self.root_weights[n];
            let dark = weight * level * at[CONTRAST] * patch.light[n];
            linear.residuals[n] = weight * (patch.seen[n] - level * left);
            linear.slopes[X][n] = dark * along_x;
            linear.slopes[Y][n] = dark * along_y;
            linear.slopes[CONTRAST][n] = -weight * level * taken;
            linear.slopes[LEVEL][n] = weight * left;
            linear.slopes[TILT_X][n] = weight * left * tilt_x;
            linear.slopes[TILT_Y][n] = weight * left * tilt_y;
        }
        linear
    }
}

impl Linear {
    fn root_weights(&self) -> impl Iterator<Item = f32> {
        self.root_weights.iter().copied()
    }

    /// Takes weight from the pixels that the model is too far from, by the noise that most of them show and by what the model
    /// itself may be off: none within a limit, all beyond twice that.
    fn reject(&mut self, allowed_dn: f32) {
        let mut sizes: Vec<f32> = self.residuals.iter().map(|r| r.abs()).collect();
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

/// Sum of products, in lanes that the processor adds side by side.
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
