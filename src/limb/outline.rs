//! The ellipse through points of the limb, on the sensor.

use super::LimbPoint;
use crate::estimation::{
    CONTRADICTION_SIGMAS, FitError, Fitted, LeastSquares, Linearised, Loss, Prior,
    SIGMA_PER_MEDIAN, Scale, TUKEY_SIGMAS, median,
};
use crate::geometry::{Ellipse, turns};
use crate::units::Measured;
use nalgebra::{Matrix2, RowSVector, SMatrix, SVector, Vector1, Vector2};

/// Prior of the outline before the limb is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutlinePrior {
    /// Mean radius, px.
    pub radius_px: Measured,
    /// Difference of a half axis from the mean radius relative to the radius, 1 sigma about zero.
    pub flatness: f64,
}

/// A fitted outline.
#[derive(Debug, Clone, PartialEq)]
pub struct OutlineFit {
    pub ellipse: Ellipse,
    /// Covariance of centre x, y, mean radius and the two parts of the flatness (along x, along the diagonal), px^2.
    pub covariance: SMatrix<f64, PARAMETERS, PARAMETERS>,
    /// Factor by which the points' sigmas were inflated, for their scatter and for correlated departures of neighbours.
    pub scatter: f64,
    /// Distance of all points from the outline, 1 sigma from the median.
    pub scatter_px: f64,
    /// Which points lie on the outline.
    pub accepted: Vec<bool>,
}

/// Centre x, y, mean radius, half the difference of the half axes along x and y, and along the diagonals; px.
const PARAMETERS: usize = 5;
/// A start is poor if half of the points are so many sigma from it; a circle is then fitted first.
const FAR_OFF_SIGMAS: f64 = 4.0;
/// Minimum number of points of an outline.
const MIN_POINTS: usize = 6;
/// Neighbouring points are averaged over arcs of this many sectors.
const ARC_POINTS: usize = 8;
/// Weight of the stated sigmas against the scatter of the arcs, in arcs.
const STATED_ARCS: f64 = 10.0;

impl OutlineFit {
    /// Covariance of the centre, px^2.
    pub fn centre_covariance(&self) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(0, 0).into_owned()
    }

    /// Fraction of the points that lie on the outline.
    pub fn accepted_share(&self) -> f64 {
        let accepted = self.accepted.iter().filter(|a| **a).count();
        accepted as f64 / self.accepted.len().max(1) as f64
    }

    /// 1 sigma of the mean radius.
    pub fn radius_sigma_px(&self) -> f64 {
        self.covariance[(2, 2)].max(0.0).sqrt()
    }

    /// Whether radius or flatness differ from a prior by more than both sigmas allow.
    pub fn contradicts(&self, prior: &OutlinePrior) -> bool {
        let found = shape_of(&self.ellipse);
        let known = prior.known();
        (2..PARAMETERS).any(|n| {
            let variance = self.covariance[(n, n)] + known.information[n].recip();
            (found[n] - known.mean[n]).powi(2) > CONTRADICTION_SIGMAS.powi(2) * variance
        })
    }

    /// The outline combined with a prior: the maximum of the product of two normal distributions.
    pub fn with(&self, prior: &OutlinePrior) -> Option<Self> {
        let known = prior.known();
        let own = self.covariance.cholesky()?.inverse();
        let covariance = (own + SMatrix::from_diagonal(&known.information))
            .cholesky()?
            .inverse();
        let found = shape_of(&self.ellipse);
        let off = known.information.component_mul(&(known.mean - found));
        Some(Self {
            ellipse: moved(&self.ellipse, &(covariance * off))?,
            covariance,
            ..self.clone()
        })
    }
}

impl OutlinePrior {
    fn known(&self) -> Prior<PARAMETERS> {
        let flat = self.flatness * self.radius_px.value;
        Prior {
            mean: SVector::from([0.0, 0.0, self.radius_px.value, 0.0, 0.0]),
            information: SVector::from([
                0.0,
                0.0,
                self.radius_px.sigma.powi(-2),
                flat.powi(-2),
                flat.powi(-2),
            ]),
        }
    }
}

/// Least-squares ellipse through points of the limb, with Tukey's weights against marks, scratches and leaks.
///
/// # Errors
/// If too few points agree, or if the points do not determine an ellipse.
pub fn fit_outline(
    points: &[LimbPoint],
    start: &Ellipse,
    prior: &OutlinePrior,
) -> Result<OutlineFit, FitError> {
    let linearise = |parameters: &SVector<f64, PARAMETERS>| {
        let ellipse = ellipse_of(parameters)?;
        Some(points.iter().map(move |point| linearised(point, &ellipse)))
    };
    let mut fit = LeastSquares {
        start: shape_of(start),
        prior: prior.known(),
        loss: Loss::Tukey(TUKEY_SIGMAS),
        scale: Scale::Median,
        tolerance_sigmas: 0.05,
    };
    // An outlying arc can make an ellipse fit diverge from a poor start; a circle fit is more robust.
    let off = points
        .iter()
        .map(|p| start.excess(p.at.vector()).abs() / p.sigma_px);
    if median(off).unwrap_or_default() > FAR_OFF_SIGMAS {
        let mut round = fit;
        for flatness in 3..PARAMETERS {
            round.start[flatness] = 0.0;
            round.prior.information[flatness] = f64::INFINITY;
        }
        fit.start = round.fit_each(linearise)?.parameters;
    }
    let fitted = fit.fit_each(linearise)?;
    let ellipse = ellipse_of(&fitted.parameters).ok_or(FitError::Undetermined)?;
    let accepted: Vec<bool> = fitted.weights.iter().map(|weight| *weight > 0.0).collect();
    let count = accepted.iter().filter(|a| **a).count();
    if count < MIN_POINTS {
        return Err(FitError::Undetermined);
    }
    let scatter = fitted.scatter.max(1.0) * common_departure(points, &ellipse, &fitted);
    let away = points.iter().map(|p| ellipse.excess(p.at.vector()).abs());
    Ok(OutlineFit {
        ellipse,
        covariance: fitted.covariance * (scatter / fitted.scatter.max(f64::MIN_POSITIVE)).powi(2),
        scatter,
        scatter_px: SIGMA_PER_MEDIAN * median(away).unwrap_or_default(),
        accepted,
    })
}

/// Factor by which the points' sigmas must be inflated for correlated errors of neighbours: unmodelled light shifts whole
/// arcs of the limb. It is hardly ever below 1, so that on average chance adds nothing.
fn common_departure(points: &[LimbPoint], ellipse: &Ellipse, fitted: &Fitted<PARAMETERS>) -> f64 {
    let scatter = fitted.scatter.max(1.0);
    let (mut chi2, mut arcs) = (0.0, 0.0);
    let all: Vec<_> = points.iter().zip(&fitted.weights).collect();
    for arc in all.chunks_exact(ARC_POINTS) {
        let (mut sum, mut information) = (0.0, 0.0);
        for (point, weight) in arc {
            let own = *weight / (point.sigma_px * scatter).powi(2);
            sum += own * ellipse.excess(point.at.vector());
            information += own;
        }
        if information > 0.0 {
            chi2 += sum * sum / information;
            arcs += 1.0;
        }
    }
    let freedom: f64 = arcs - PARAMETERS as f64;
    if freedom < 1.0 {
        return 1.0;
    }
    ((STATED_ARCS + chi2) / (STATED_ARCS + freedom)).sqrt()
}

/// The parameters of an ellipse.
fn shape_of(ellipse: &Ellipse) -> SVector<f64, PARAMETERS> {
    let root = ellipse.root();
    SVector::from([
        ellipse.centre.x,
        ellipse.centre.y,
        ellipse.mean_radius(),
        (root.m11 - root.m22) / 2.0,
        root.m12,
    ])
}

fn ellipse_of(parameters: &SVector<f64, PARAMETERS>) -> Option<Ellipse> {
    let [x, y, radius, along_x, diagonal]: [f64; PARAMETERS] = (*parameters).into();
    let root = Matrix2::new(radius + along_x, diagonal, diagonal, radius - along_x);
    Ellipse::new(Vector2::new(x, y), root)
}

fn moved(ellipse: &Ellipse, step: &SVector<f64, PARAMETERS>) -> Option<Ellipse> {
    ellipse_of(&(shape_of(ellipse) + step))
}

/// A point's distance outwards from an ellipse and how it changes with the parameters, in sigmas.
fn linearised(point: &LimbPoint, ellipse: &Ellipse) -> Linearised<1, PARAMETERS> {
    let w = ellipse.to_disc(point.at.vector());
    let (normal, r2) = (ellipse.normal(w), w.norm_squared());
    let along_x = (w.x * w.x - w.y * w.y) / r2;
    let diagonal = 2.0 * w.x * w.y / r2;
    Linearised {
        residual: Vector1::new(ellipse.excess_at(w) / point.sigma_px),
        jacobian: RowSVector::from([normal.x, normal.y, 1.0, along_x, diagonal]) / point.sigma_px,
    }
}

/// Fraction of the outline that has points on it, 0 to 1, in steps of 10 deg.
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
    fn an_ellipse_is_found_though_a_fifth_of_its_points_is_moved_inwards() {
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
        assert!(fit_outline(&points, &start(), &LOOSE).is_err());
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
