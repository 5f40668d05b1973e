//! The ellipse through points of the limb, on the sensor.

use super::LimbPoint;
use super::band::outwards;
use crate::estimation::{SIGMA_PER_MEDIAN, TUKEY_SIGMAS, median_size};
use crate::geometry::{Ellipse, turns};
use crate::lanes::{LANES, Scratch, groups, larger};
use crate::units::Measured;
use multiversion::multiversion;
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// What is known of the outline before the limb is looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutlinePrior {
    /// Mean radius, px.
    pub radius_px: Measured,
    /// How far a half axis differs from the mean radius, 1 sigma about none, over the radius.
    pub flatness: f64,
}

/// A fitted outline.
#[derive(Debug, Clone, PartialEq)]
pub struct OutlineFit {
    pub ellipse: Ellipse,
    /// Covariance of centre x, y, mean radius and the two parts of the flatness (along x, along the diagonal), px^2.
    pub covariance: SMatrix<f64, 5, 5>,
    /// Scatter of the accepted points over their sigmas.
    pub scatter: f64,
    /// Typical distance of all points from the outline, 1 sigma.
    pub scatter_px: f64,
    /// Which points lie on the outline.
    pub accepted: Vec<bool>,
}

impl OutlineFit {
    /// Covariance of the centre, px^2.
    pub fn centre_covariance(&self) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(0, 0).into_owned()
    }

    /// Part of the points that lie on the outline.
    pub fn accepted_share(&self) -> f64 {
        let accepted = self.accepted.iter().filter(|a| **a).count();
        accepted as f64 / self.accepted.len().max(1) as f64
    }

    /// Whether radius or flatness differ from what a prior states by more than both their sigmas allow.
    pub fn contradicts(&self, prior: &OutlinePrior) -> bool {
        let root = self.ellipse.root();
        let flat = prior.flatness * prior.radius_px.value;
        let found = [
            self.ellipse.mean_radius() - prior.radius_px.value,
            (root.m11 - root.m22) / 2.0,
            root.m12,
        ];
        let stated = [prior.radius_px.sigma, flat, flat];
        (0..3).any(|n| {
            let variance = self.covariance[(n + 2, n + 2)] + stated[n].powi(2);
            found[n].powi(2) > CONTRADICTION_SIGMAS.powi(2) * variance
        })
    }

    /// 1 sigma of the mean radius.
    pub fn radius_sigma_px(&self) -> f64 {
        self.covariance[(2, 2)].max(0.0).sqrt()
    }
}

const STEPS: usize = 16;
const ROUND_STEPS: usize = 6;
/// Points that scatter by more sigmas than this about the start may lead an ellipse astray; a circle is harder to lead.
const CRUDE_SIGMAS: f64 = 6.0;
/// A shorter step changes nothing, px.
const SETTLED_STEP_PX: f64 = 1e-3;
/// Two values so many sigma apart are not of the same thing.
const CONTRADICTION_SIGMAS: f64 = 5.0;
/// Fewer points make no outline.
const MIN_POINTS: usize = 6;

/// Least-squares ellipse through points of the limb, with Tukey's weights against marks, scratches and leaks. Scatter
/// beyond the points' own sigmas raises the covariance. `None` when too few points agree.
pub fn fit_outline(
    points: &[LimbPoint],
    start: &Ellipse,
    prior: &OutlinePrior,
) -> Option<OutlineFit> {
    let mut ellipse = *start;
    let places = Places::from(points, start);
    let mut seen = Residuals::from(&places, &ellipse);
    let crude = seen.scatter > CRUDE_SIGMAS;
    let mut information = SMatrix::<f64, 5, 5>::zeros();
    for step in 0..STEPS {
        let round = crude && step < ROUND_STEPS;
        let (matrix, gradient) = seen.normal_equations(&ellipse, prior, round);
        information = matrix;
        let moved = information.cholesky()?.solve(&gradient);
        let grown = Matrix2::new(moved[2] + moved[3], moved[4], moved[4], moved[2] - moved[3]);
        let root = ellipse.root() + grown;
        ellipse = Ellipse::new(ellipse.centre + moved.fixed_rows::<2>(0), root)?;
        seen = Residuals::from(&places, &ellipse);
        if !round && moved.norm() < SETTLED_STEP_PX {
            break;
        }
    }
    let limit = (TUKEY_SIGMAS * seen.scatter) as f32;
    let accepted: Vec<bool> = seen.pulls().map(|pull| pull.abs() < limit).collect();
    let count = accepted.iter().filter(|a| **a).count();
    let excess = seen.excess_px.iter().take(places.count);
    (count >= MIN_POINTS).then_some(OutlineFit {
        ellipse,
        covariance: information.cholesky()?.inverse(),
        scatter: seen.scatter,
        scatter_px: robust_sigma(excess.copied()),
        accepted,
    })
}

/// The points, in whole groups of lanes; what fills up the last one has no weight.
struct Places {
    count: usize,
    origin: Vector2<f64>,
    /// From the origin, px.
    x: Scratch<f32>,
    y: Scratch<f32>,
    /// One over the points' sigmas.
    per_sigma: Scratch<f32>,
}

impl Places {
    fn from(points: &[LimbPoint], start: &Ellipse) -> Self {
        let origin = start.centre;
        let room = points.len().next_multiple_of(LANES);
        let list = |value: &dyn Fn(&LimbPoint) -> f64, filling: f64| {
            let mut list = Scratch::empty(room);
            list.extend(points.iter().map(|point| value(point) as f32));
            list.resize(room, filling as f32);
            list
        };
        Self {
            count: points.len(),
            origin,
            x: list(&|point| point.at.x - origin.x, start.mean_radius()),
            y: list(&|point| point.at.y - origin.y, 0.0),
            per_sigma: list(&|point| 1.0 / point.sigma_px, 0.0),
        }
    }
}

/// The points as an ellipse sees them.
struct Residuals<'a> {
    places: &'a Places,
    /// Distance outwards from the outline.
    excess_px: Scratch<f32>,
    /// How the outline moves outwards there with centre x and y and the two parts of the flatness; with its mean radius it
    /// moves as that does.
    slopes: [Scratch<f32>; 4],
    /// Robust 1 sigma of excess over stated sigma; not below 1, since less is luck.
    scatter: f64,
}

impl<'a> Residuals<'a> {
    fn from(places: &'a Places, ellipse: &Ellipse) -> Self {
        let list = || Scratch::of_length(places.x.len());
        let mut seen = Self {
            places,
            excess_px: list(),
            slopes: std::array::from_fn(|_| list()),
            scatter: 1.0,
        };
        let [x, y] = (ellipse.centre - places.origin).into();
        let inverse = ellipse.inverse().cast();
        let inverse = [inverse.m11, inverse.m12, inverse.m22];
        see(
            places,
            [x as f32, y as f32],
            inverse,
            &mut seen.excess_px,
            &mut seen.slopes,
        );
        seen.scatter = robust_sigma(seen.pulls()).max(1.0);
        seen
    }

    fn pulls(&self) -> impl Iterator<Item = f32> {
        let excess = self.excess_px.iter().take(self.places.count);
        excess
            .zip(self.places.per_sigma.iter())
            .map(|(excess, per_sigma)| excess * per_sigma)
    }

    /// Information and gradient at an ellipse, that of the prior included; while it is to stay round, held to that.
    fn normal_equations(
        &self,
        ellipse: &Ellipse,
        prior: &OutlinePrior,
        round: bool,
    ) -> (SMatrix<f64, 5, 5>, SVector<f64, 5>) {
        let root = ellipse.root();
        let hold = if round { 0.1 } else { 1.0 };
        let flat = hold * prior.flatness * prior.radius_px.value;
        let tightness = [0.0, 0.0, prior.radius_px.sigma, flat, flat]
            .map(|sigma: f64| if sigma > 0.0 { sigma.powi(-2) } else { 0.0 });
        let (stretch, diagonal) = ((root.m11 - root.m22) / 2.0, root.m12);
        let short = prior.radius_px.value - ellipse.mean_radius();
        let off = [0.0, 0.0, short, -stretch, -diagonal];
        let sums = sum_products(self);
        let information = SMatrix::from_fn(|m, n| {
            let known = if m == n { tightness[m] } else { 0.0 };
            sums[m.min(n)][m.max(n)] + known
        });
        let gradient = SVector::from_fn(|m, _| sums[m][5] + tightness[m] * off[m]);
        (information, gradient)
    }
}

/// The points as an ellipse sees them, its centre given from the points' origin and `inverse` as for [`outwards`].
#[multiversion(targets("x86_64+avx2"))]
fn see(
    places: &Places,
    centre: [f32; 2],
    inverse: [f32; 3],
    excess_px: &mut [f32],
    slopes: &mut [Scratch<f32>; 4],
) {
    let count = excess_px.len();
    let (x, y) = (&places.x[..count], &places.y[..count]);
    let [a, b, c] = inverse;
    let [by_x, by_y, by_stretch, by_diagonal] = slopes.each_mut().map(|list| &mut list[..count]);
    for n in 0..count {
        let ([wx, wy], distance) = outwards(inverse, x[n] - centre[0], y[n] - centre[1]);
        let (nx, ny) = (a * wx + b * wy, b * wx + c * wy);
        let (per_normal, per_r2) = (1.0 / (nx * nx + ny * ny).sqrt(), 1.0 / (wx * wx + wy * wy));
        excess_px[n] = distance;
        (by_x[n], by_y[n]) = (nx * per_normal, ny * per_normal);
        by_stretch[n] = (wx * wx - wy * wy) * per_r2;
        by_diagonal[n] = 2.0 * wx * wy * per_r2;
    }
}

/// Weighted sums of the products of the slopes with one another and, last, with the excess; from the diagonal on.
#[multiversion(targets("x86_64+avx2"))]
fn sum_products(seen: &Residuals<'_>) -> [[f64; 6]; 5] {
    let per_limit = (1.0 / (TUKEY_SIGMAS * seen.scatter)) as f32;
    let per_scatter = (1.0 / seen.scatter) as f32;
    let per_sigma = groups(&seen.places.per_sigma);
    let excess = groups(&seen.excess_px);
    let [x, y, stretch, diagonal] = seen
        .slopes
        .each_ref()
        .map(|list| list.as_chunks::<LANES>().0);
    let mut sums = [[[0.0_f32; LANES]; 6]; 5];
    for n in 0..excess.len() {
        let factors = [x[n], y[n], [1.0; LANES], stretch[n], diagonal[n], excess[n]];
        let mut weight = [0.0; LANES];
        for k in 0..LANES {
            let u = excess[n][k] * per_sigma[n][k] * per_limit;
            let within = larger(1.0 - u * u, 0.0);
            let per_spread = per_sigma[n][k] * per_scatter;
            weight[k] = within * within * per_spread * per_spread;
        }
        for p in 0..5 {
            for q in p..6 {
                for k in 0..LANES {
                    sums[p][q][k] += weight[k] * factors[p][k] * factors[q][k];
                }
            }
        }
    }
    sums.map(|row| row.map(|lanes| f64::from(lanes.iter().sum::<f32>())))
}

/// 1 sigma from the median of the absolute residuals; 0 of none.
fn robust_sigma(residuals: impl Iterator<Item = f32>) -> f64 {
    let sizes = residuals.map(f32::abs);
    SIGMA_PER_MEDIAN * f64::from(median_size(sizes).unwrap_or(0.0))
}

/// Which part of the outline has points on it, 0 to 1, in steps of 10 deg.
pub fn arc_fraction(points: impl Iterator<Item = Vector2<f64>>, centre: Vector2<f64>) -> f64 {
    const BINS: usize = 36;
    let mut seen = [false; BINS];
    for point in points {
        seen[(turns(point - centre) * BINS as f64) as usize % BINS] = true;
    }
    seen.iter().filter(|s| **s).count() as f64 / BINS as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Circle;

    fn limb(ellipse: &Ellipse, degrees: std::ops::Range<i32>, ripple: f64) -> Vec<LimbPoint> {
        degrees
            .step_by(2)
            .map(|d| {
                let (sin, cos) = f64::from(d).to_radians().sin_cos();
                let off = ripple * f64::from(d * 7919 % 13 - 6) / 3.7;
                let w = Vector2::new(cos, sin);
                let at = ellipse.from_disc(w) + ellipse.normal(w) * off;
                LimbPoint {
                    at: at.into(),
                    sigma_px: 0.05,
                }
            })
            .collect()
    }

    fn truth() -> Ellipse {
        let root = Matrix2::new(95.46, 0.1, 0.1, 94.86);
        Ellipse::new(Vector2::new(400.0, 300.0), root).unwrap()
    }

    fn start() -> Ellipse {
        Circle {
            centre: Vector2::new(400.4, 299.8),
            radius: 94.7,
        }
        .into()
    }

    const LOOSE: OutlinePrior = OutlinePrior {
        radius_px: Measured::new(95.0, 5.0),
        flatness: 0.01,
    };

    #[test]
    fn an_ellipse_is_found_though_a_fifth_of_its_points_is_pulled_inwards() {
        let mut points = limb(&truth(), 0..360, 0.05);
        for point in points.iter_mut().take(36) {
            let inwards = (truth().centre - point.at.vector()).normalize();
            point.at = (point.at.vector() + inwards * 3.0).into();
        }
        let fit = fit_outline(&points, &start(), &LOOSE).unwrap();
        assert!((fit.ellipse.centre - truth().centre).norm() < 0.03);
        assert!((fit.ellipse.root() - truth().root()).norm() < 0.04);
        assert_eq!(fit.accepted.iter().filter(|a| **a).count(), 144);
    }

    #[test]
    fn a_short_arc_is_less_certain_across_it_than_along_it_and_the_known_radius_helps() {
        let points = limb(&truth(), -20..20, 0.05);
        let sigma = |radius_sigma_px| {
            let prior = OutlinePrior {
                radius_px: Measured::new(95.16, radius_sigma_px),
                flatness: 0.0005,
            };
            let fit = fit_outline(&points, &start(), &prior).unwrap();
            let covariance = fit.centre_covariance();
            [covariance[(0, 0)].sqrt(), covariance[(1, 1)].sqrt()]
        };
        let (loose, tight) = (sigma(5.0), sigma(0.1));
        assert!(loose[0] > 2.0 * loose[1]);
        assert!(tight[0] < 0.5 * loose[0]);
    }

    #[test]
    fn scatter_beyond_the_stated_sigma_raises_the_uncertainty() {
        let sigma = |ripple| {
            let points = limb(&truth(), 0..360, ripple);
            let fit = fit_outline(&points, &start(), &LOOSE).unwrap();
            fit.centre_covariance().trace()
        };
        assert!(sigma(0.5) > 25.0 * sigma(0.05));
    }

    #[test]
    fn too_few_points_make_no_outline() {
        let points = limb(&truth(), 0..10, 0.0);
        assert_eq!(fit_outline(&points, &start(), &LOOSE), None);
    }

    #[test]
    fn the_seen_part_of_the_limb_is_counted() {
        let seen = |degrees| {
            let points = limb(&truth(), degrees, 0.0);
            arc_fraction(points.iter().map(|p| p.at.vector()), truth().centre)
        };
        assert!((seen(0..360) - 1.0).abs() < 1e-9);
        assert!((seen(0..90) - 0.25).abs() < 0.03);
    }
}
