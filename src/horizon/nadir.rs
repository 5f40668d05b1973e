//! The nadir by points of the edge.
//!
//! The fit is by angles: that between each ray and the nadir, less the cone's half-angle, over its sigma. The two unknowns move the nadir across
//! itself, so that it stays a unit vector; linear least squares for its three components (Braun and Barf 2022, eq. 22-24) are biased where the
//! arc is short.

use super::across;
use crate::estimation::{FitError, LeastSquares, Linearised, Loss, Prior, Scale, TUKEY_SIGMAS};
use crate::geometry::attitude::Direction;
use crate::geometry::camera::Camera;
use crate::units::{Measured, SensorPx};
use nalgebra::{Matrix2, RowVector2, UnitVector3, Vector2, Vector3};

/// Fewer points determine no direction.
const LEAST_POINTS: usize = 3;

/// A point of the edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgePoint {
    pub at: SensorPx,
    /// Unit vector in the image across the edge, towards the sphere.
    pub inward: Vector2<f64>,
    /// 1 sigma across the edge, by the camera's noise alone, px.
    pub sigma_px: f64,
}

/// How the edge itself departs from its cone: neighbours do alike, as a Gauss-Markov process of first order (Braun and Barf
/// 2022, eq. 34).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeCorrelation {
    /// 1 sigma of the departure, rad.
    pub sigma_rad: f64,
    /// Distance along the edge at which the correlation has fallen to 1/e, px.
    pub length_px: f64,
}

/// What the edge is in the plane of a rectilinear camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Conic {
    Ellipse,
    Parabola,
    Hyperbola,
}

impl Conic {
    pub fn name(self) -> &'static str {
        match self {
            Self::Ellipse => "ellipse",
            Self::Parabola => "parabola",
            Self::Hyperbola => "hyperbola",
        }
    }
}

/// The direction of a sphere's centre.
#[derive(Debug, Clone, PartialEq)]
pub struct Nadir {
    pub direction: Direction,
    pub conic: Conic,
    /// Rms of the residuals over their sigmas.
    pub scatter: f64,
    /// The loss's weight of each point, 0 to 1.
    pub weights: Vec<f64>,
}

/// Why there is no nadir.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NadirError {
    #[error(
        "expected at least {LEAST_POINTS} points of the edge within the camera's view, found {0}"
    )]
    Points(usize),
    #[error(transparent)]
    Fit(#[from] FitError),
}

/// The nadir by points of its edge, given the half-angle of the cone (rad). Points that follow each other are neighbours on the edge.
///
/// # Errors
/// Too few points within the camera's view, or points that determine no direction.
pub fn nadir(
    points: &[EdgePoint],
    camera: &Camera,
    half_angle_rad: Measured,
    correlation: EdgeCorrelation,
) -> Result<Nadir, NadirError> {
    let edge: Vec<EdgeRay> = points
        .iter()
        .filter_map(|p| EdgeRay::of(p, camera))
        .collect();
    if edge.len() < LEAST_POINTS {
        return Err(NadirError::Points(edge.len()));
    }
    let angle = half_angle_rad.value;
    let start = start(&edge, angle).ok_or(FitError::Undetermined)?;
    let tangents = across(&start);
    let moved = |by: &Vector2<f64>| UnitVector3::new_normalize(start.into_inner() + tangents * by);
    let sigma = |ray: &EdgeRay| ray.sigma_rad.hypot(correlation.sigma_rad);
    let linearise = |by: &Vector2<f64>| {
        let nadir = moved(by);
        let row = |ray: &EdgeRay| {
            let (off, slope) = ray.angle_from(&nadir);
            let by_parameters: RowVector2<f64> = slope.transpose() * tangents;
            Linearised {
                residual: nalgebra::Vector1::new((angle - off) / sigma(ray)),
                jacobian: by_parameters / sigma(ray),
            }
        };
        Some(edge.iter().map(row).collect::<Vec<_>>())
    };
    let robust = LeastSquares {
        start: Vector2::zeros(),
        prior: Prior::none(),
        loss: Loss::Tukey(TUKEY_SIGMAS),
        scale: Scale::Inflated,
        tolerance_sigmas: 1e-4,
    };
    let fitted = robust.fit_after_plain(linearise)?;
    let rows = linearise(&fitted.parameters).unwrap_or_default();
    let terms: Vec<Term> = edge
        .iter()
        .zip(&rows)
        .zip(&fitted.weights)
        .map(|((ray, row), weight)| Term {
            gradient: row.jacobian.transpose() * (*weight / sigma(ray)),
            ray: *ray,
        })
        .collect();
    let scatter = spread(&terms, half_angle_rad.sigma, correlation);
    // The core has inflated each of the two already, and once is right.
    let covariance = fitted.covariance * scatter * fitted.covariance / fitted.scatter.powi(2);
    let unit = moved(&fitted.parameters);
    Ok(Nadir {
        conic: conic(&unit, angle),
        direction: Direction {
            unit,
            covariance_rad2: tangents * covariance * tangents.transpose(),
        },
        scatter: fitted.scatter,
        weights: fitted.weights,
    })
}

impl Nadir {
    /// Turn of the camera about its axis, deg, from the horizontal: positive with its right side low.
    pub fn roll_deg(&self) -> f64 {
        let nadir = self.direction.unit;
        nadir.x.atan2(nadir.y).to_degrees()
    }

    /// Elevation of the camera's axis above the horizontal, deg.
    pub fn pitch_deg(&self) -> f64 {
        -self.direction.unit.z.asin().to_degrees()
    }

    /// Root of the largest eigenvalue of the covariance, deg: the isotropic bound (Braun and Barf 2022, eq. 37).
    pub fn sigma_deg(&self) -> f64 {
        let eigenvalues = self.direction.covariance_rad2.symmetric_eigenvalues();
        eigenvalues.max().max(0.0).sqrt().to_degrees()
    }
}

/// A point of the edge as a ray.
#[derive(Debug, Clone, Copy)]
pub(super) struct EdgeRay {
    pub at: SensorPx,
    pub unit: UnitVector3<f64>,
    /// Unit vector across the ray, towards the sphere.
    pub inward: Vector3<f64>,
    /// 1 sigma of the ray across the edge.
    pub sigma_rad: f64,
}

impl EdgeRay {
    /// `None` beyond the limit of the lens.
    pub fn of(point: &EdgePoint, camera: &Camera) -> Option<Self> {
        let unit = camera.ray(point.at)?;
        let across = camera.ray_jacobian(point.at)? * point.inward;
        Some(Self {
            at: point.at,
            unit,
            inward: across.try_normalize(0.0)?,
            sigma_rad: across.norm() * point.sigma_px,
        })
    }

    /// The angle from a nadir, rad, and its derivative by the nadir.
    pub fn angle_from(&self, nadir: &UnitVector3<f64>) -> (f64, Vector3<f64>) {
        let cosine = self.unit.dot(nadir);
        let across = nadir.cross(&self.unit).norm();
        (across.atan2(cosine), -self.unit.into_inner() / across)
    }
}

/// Where each ray, and the side on which the sphere is seen, have the nadir.
fn start(edge: &[EdgeRay], angle: f64) -> Option<UnitVector3<f64>> {
    let (sine, cosine) = angle.sin_cos();
    let of_one = |ray: &EdgeRay| ray.unit.into_inner() * cosine + ray.inward * sine;
    let sum: Vector3<f64> = edge.iter().map(of_one).sum();
    UnitVector3::try_new(sum, 0.0)
}

/// By how much an error of 1 rad of one point moves the gradient of the cost.
struct Term {
    gradient: Vector2<f64>,
    ray: EdgeRay,
}

/// Covariance of the gradient of the cost: of the camera's noise, of the edge's own departure, and of the half-angle, which all points
/// share. The sum over all pairs of the correlated ones takes one pass, since an exponential's pairs go through all between them.
fn spread(terms: &[Term], angle_sigma_rad: f64, correlation: EdgeCorrelation) -> Matrix2<f64> {
    let mut noise = Matrix2::zeros();
    let mut edge = Matrix2::zeros();
    let mut shared = Vector2::zeros();
    let mut before = Vector2::zeros();
    let mut last: Option<SensorPx> = None;
    for Term { gradient, ray } in terms {
        noise += gradient * gradient.transpose() * ray.sigma_rad.powi(2);
        let step_px = last.map_or(f64::INFINITY, |last| last.distance(ray.at));
        before *= (-step_px / correlation.length_px).exp();
        let pairs = before * gradient.transpose();
        edge += gradient * gradient.transpose() + pairs + pairs.transpose();
        before += gradient;
        shared += gradient;
        last = Some(ray.at);
    }
    noise
        + edge * correlation.sigma_rad.powi(2)
        + shared * shared.transpose() * angle_sigma_rad.powi(2)
}

/// By the elevation of the nadir above the image plane against the half-angle (Braun and Barf 2022, eq. 11).
fn conic(nadir: &UnitVector3<f64>, angle: f64) -> Conic {
    const SAME_RAD: f64 = 1e-12;
    let above = nadir.z.abs().asin() - angle;
    match above {
        _ if above.abs() < SAME_RAD => Conic::Parabola,
        0.0.. => Conic::Ellipse,
        _ => Conic::Hyperbola,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::camera::Lens;
    use crate::horizon::{Refraction, half_angle_rad};
    use nalgebra::Rotation3;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_xoshiro::Xoshiro256PlusPlus;
    use std::f64::consts::TAU;

    const SIZE_PX: [f64; 2] = [1920.0, 1080.0];
    const NOISE_PX: f64 = 0.1;
    /// Of the whole edge, in view or not.
    const DRAWN_POINTS: u32 = 2000;
    const CALM: EdgeCorrelation = EdgeCorrelation {
        sigma_rad: 0.0,
        length_px: 1.0,
    };

    /// 94.4 deg across.
    fn camera() -> Camera {
        let focal = SIZE_PX[0] / 2.0 / 47.2_f64.to_radians().tan();
        let centre = SensorPx::new(959.5, 539.5);
        Camera::new(Lens::Rectilinear, [focal, focal], centre).unwrap()
    }

    /// A nadir by the camera's roll and pitch.
    fn nadir_of(roll_deg: f64, pitch_deg: f64) -> UnitVector3<f64> {
        let (roll, pitch) = (roll_deg.to_radians(), pitch_deg.to_radians());
        let level = Vector3::new(roll.sin(), roll.cos(), 0.0) * pitch.cos();
        UnitVector3::new_normalize(level - Vector3::z() * pitch.sin())
    }

    /// Errors of a drawn edge: white noise of the camera (px), a correlated one of the edge and one of the half-angle.
    #[derive(Clone, Copy)]
    struct Errors {
        noise_px: f64,
        edge: EdgeCorrelation,
        angle_rad: f64,
    }

    const NOISE_ALONE: Errors = Errors {
        noise_px: NOISE_PX,
        edge: CALM,
        angle_rad: 0.0,
    };

    /// Points of the edge within the picture, some pixels apart, whose errors are drawn.
    fn edge(
        nadir: &UnitVector3<f64>,
        angle: f64,
        errors: Errors,
        random: &mut Xoshiro256PlusPlus,
    ) -> Vec<EdgePoint> {
        let camera = camera();
        let across = across(nadir);
        let shared = errors.angle_rad * random.sample::<f64, _>(StandardNormal);
        let mut departure = errors.edge.sigma_rad * random.sample::<f64, _>(StandardNormal);
        let mut last: Option<SensorPx> = None;
        let mut points = Vec::new();
        for n in 0..DRAWN_POINTS {
            let around = f64::from(n) / f64::from(DRAWN_POINTS) * TAU;
            let outward = across * Vector2::new(around.cos(), around.sin());
            let on_cone = |angle: f64| {
                let ray = nadir.into_inner() * angle.cos() + outward * angle.sin();
                camera.pixel(&UnitVector3::new_normalize(ray))
            };
            let is_in_view = |at: &SensorPx| {
                (0.0..SIZE_PX[0]).contains(&at.x) && (0.0..SIZE_PX[1]).contains(&at.y)
            };
            let Some(at) = on_cone(angle).filter(is_in_view) else {
                continue;
            };
            let step = last.map_or(f64::INFINITY, |last| last.distance(at));
            let kept = (-step / errors.edge.length_px).exp();
            let fresh = (1.0 - kept * kept).sqrt() * errors.edge.sigma_rad;
            departure = kept * departure + fresh * random.sample::<f64, _>(StandardNormal);
            last = Some(at);
            let (Some(at), Some(inside)) = (
                on_cone(angle + shared + departure),
                on_cone(angle + shared + departure - 1e-4),
            ) else {
                continue;
            };
            let inward = (inside.vector() - at.vector()).normalize();
            let noise = errors.noise_px * random.sample::<f64, _>(StandardNormal);
            points.push(EdgePoint {
                at: (at.vector() + inward * noise).into(),
                inward,
                sigma_px: NOISE_PX,
            });
        }
        points
    }

    /// Root of the mean of the squared error over its covariance, over many scenes.
    fn error_over_sigma(height_m: f64, errors: Errors) -> f64 {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(20);
        let angle = half_angle(height_m);
        let mut squares = 0.0;
        const SCENES: usize = 200;
        for _ in 0..SCENES {
            let truth = nadir_of(
                random.random_range(-25.0..25.0),
                random.random_range(-15.0..10.0),
            );
            let points = edge(&truth, angle, errors, &mut random);
            let half_angle = Measured::new(angle, errors.angle_rad);
            let found = nadir(&points, &camera(), half_angle, errors.edge).unwrap();
            let across = across(&truth);
            let error =
                across.transpose() * (found.direction.unit.into_inner() - truth.into_inner());
            let covariance = across.transpose() * found.direction.covariance_rad2 * across;
            squares += (error.transpose() * covariance.try_inverse().unwrap() * error)[0] / 2.0;
        }
        (squares / SCENES as f64).sqrt()
    }

    fn half_angle(height_m: f64) -> f64 {
        let exact = |m| Measured::new(m, 0.0);
        half_angle_rad(exact(height_m), exact(0.0), Refraction::None)
            .unwrap()
            .value
    }

    #[test]
    fn the_nadir_of_an_exact_edge_is_exact_for_ellipses_and_hyperbolas() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
        let none = Errors {
            noise_px: 0.0,
            ..NOISE_ALONE
        };
        for (height_m, roll_deg, pitch_deg, conic) in [
            (38_000.0, 24.0, -19.0, Conic::Hyperbola),
            (230_000.0, -150.0, 8.0, Conic::Hyperbola),
            (2_000_000.0, 10.0, -60.0, Conic::Ellipse),
            (36_000_000.0, 0.0, -88.0, Conic::Ellipse),
        ] {
            let truth = nadir_of(roll_deg, pitch_deg);
            let angle = half_angle(height_m);
            let points = edge(&truth, angle, none, &mut random);
            let found = nadir(&points, &camera(), Measured::new(angle, 0.0), CALM).unwrap();
            assert!(
                found.direction.unit.dot(&truth) > 1.0 - 1e-14,
                "{height_m} m"
            );
            assert!((found.roll_deg() - roll_deg).abs() < 1e-6, "{height_m} m");
            assert!((found.pitch_deg() - pitch_deg).abs() < 1e-6, "{height_m} m");
            assert_eq!(found.conic, conic, "{height_m} m");
        }
    }

    #[test]
    fn errors_are_as_large_as_their_covariance_says() {
        let edge = EdgeCorrelation {
            sigma_rad: 3e-4,
            length_px: 100.0,
        };
        for height_m in [38_000.0, 230_000.0] {
            let of_edge = Errors {
                edge,
                ..NOISE_ALONE
            };
            let of_angle = Errors {
                angle_rad: 5e-4,
                ..NOISE_ALONE
            };
            let all = Errors {
                angle_rad: 5e-4,
                ..of_edge
            };
            for errors in [NOISE_ALONE, of_edge, of_angle, all] {
                let ratio = error_over_sigma(height_m, errors);
                assert!((0.8..1.25).contains(&ratio), "{ratio} at {height_m} m");
            }
        }
    }

    #[test]
    fn a_short_arc_is_no_bias() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
        let angle = half_angle(38_000.0);
        let truth = nadir_of(5.0, -6.0);
        let mut off = (Vector2::zeros(), Matrix2::zeros());
        const SCENES: usize = 200;
        for _ in 0..SCENES {
            let mut points = edge(&truth, angle, NOISE_ALONE, &mut random);
            points.retain(|point| (900.0..1000.0).contains(&point.at.x));
            let found = nadir(&points, &camera(), Measured::new(angle, 0.0), CALM).unwrap();
            let across = across(&truth);
            off.0 += across.transpose() * (found.direction.unit.into_inner() - truth.into_inner());
            off.1 += across.transpose() * found.direction.covariance_rad2 * across;
        }
        // The mean error is a draw of the mean covariance over the number of scenes, twice.
        let chi2 = (off.0.transpose() * off.1.try_inverse().unwrap() * off.0)[0];
        assert!(chi2 < 13.8, "{chi2}: one in a thousand is larger");
    }

    #[test]
    fn points_far_from_the_edge_count_nothing() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(4);
        let angle = half_angle(230_000.0);
        let truth = nadir_of(-8.0, -10.0);
        let mut points = edge(&truth, angle, NOISE_ALONE, &mut random);
        let flare = points.len() / 4..points.len() / 4 + 60;
        for point in &mut points[flare.clone()] {
            point.at.y -= 5.0;
        }
        let found = nadir(&points, &camera(), Measured::new(angle, 0.0), CALM).unwrap();
        assert!(found.weights[flare].iter().all(|weight| *weight < 0.01));
        let error = found.direction.unit.angle(&truth).to_degrees();
        assert!(error < 5.0 * found.sigma_deg(), "{error} deg");
    }

    #[test]
    fn what_determines_no_direction_is_an_error() {
        let angle = Measured::new(1.4, 0.0);
        let none = nadir(&[], &camera(), angle, CALM);
        assert_eq!(none, Err(NadirError::Points(0)));
        let point = EdgePoint {
            at: SensorPx::new(100.0, 500.0),
            inward: Vector2::y(),
            sigma_px: NOISE_PX,
        };
        let one_place = nadir(&[point; 5], &camera(), angle, CALM);
        assert!(one_place.is_err() || one_place.unwrap().sigma_deg() > 1.0);
    }

    #[test]
    fn roll_is_positive_with_the_right_side_low_and_pitch_above_the_horizontal() {
        let unit = Rotation3::from_axis_angle(&Vector3::z_axis(), -0.1) * Vector3::y_axis();
        let direction = Direction::new(unit, 1e-4);
        let nadir = Nadir {
            direction,
            conic: Conic::Hyperbola,
            scatter: 1.0,
            weights: Vec::new(),
        };
        assert!((nadir.roll_deg() - 0.1_f64.to_degrees()).abs() < 1e-9);
        assert!(nadir.pitch_deg().abs() < 1e-9);
        assert!((nadir.sigma_deg() - 1e-4_f64.to_degrees()).abs() < 1e-9);
        assert!(nadir_of(0.0, 10.0).z < 0.0);
    }
}
