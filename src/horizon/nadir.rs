//! The nadir from rays to the edge.
//!
//! The residual of a ray is its angle from the nadir minus the cone's half-angle, over its sigma. Two unknowns move the
//! nadir perpendicular to itself, so that it stays a unit vector; linear least squares for its three components (Braun and
//! Barf 2022, eq. 22-24) is biased if the arc is short. A third unknown, the half-angle, is held unless its fit is
//! requested.

use super::departure::Departure;
use super::edge::{EdgeRay, EdgeRays};
use super::sphere::{Sphere, across};
use crate::estimation::{FitError, LeastSquares, Linearised, Loss, Prior, Scale, TUKEY_SIGMAS};
use crate::geometry::attitude::Direction;
use crate::units::Measured;
use nalgebra::{Matrix3, RowVector3, UnitVector3, Vector1, Vector3};

/// Minimum number of rays for a direction.
const LEAST_RAYS: usize = 3;
/// Prior of a fitted half-angle about the given one, rad: 1 sigma, far more than the effect of any air.
const FREE_RAD: f64 = 0.05;
/// Correlation angle, along the edge, of brightness and blur, which shift the edge in a picture's light.
const LIGHT_RAD: f64 = 50.0;
/// A point with a lower weight is not part of the edge.
const LEAST_WEIGHT: f64 = 0.1;

/// Whether the height of the edge is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EdgeHeight {
    /// Held at the sphere's half-angle, within its sigma.
    #[default]
    Given,
    /// Fitted together with the nadir, from the curvature of the edge.
    Fitted,
}

/// Shape of the edge in the plane of a rectilinear camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Conic {
    Ellipse,
    Parabola,
    Hyperbola,
}

impl Conic {
    /// From the elevation of the nadir above the image plane and the half-angle (Braun and Barf 2022, eq. 11).
    pub fn of(nadir: &UnitVector3<f64>, half_angle_rad: f64) -> Self {
        const SAME_RAD: f64 = 1e-12;
        let above = nadir.z.abs().asin() - half_angle_rad;
        match above {
            _ if above.abs() < SAME_RAD => Self::Parabola,
            0.0.. => Self::Ellipse,
            _ => Self::Hyperbola,
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Ellipse => "ellipse",
            Self::Parabola => "parabola",
            Self::Hyperbola => "hyperbola",
        }
    }
}

/// The direction of a sphere's centre; for an ellipsoid, straight down.
#[derive(Debug, Clone, PartialEq)]
pub struct Nadir {
    pub direction: Direction,
    pub height: EdgeHeight,
    pub half_angle_rad: Measured,
    pub conic: Conic,
    /// Departure of the edge from the sphere that was assumed.
    pub departure: Departure,
    /// Rms of the normalised residuals.
    pub scatter: f64,
    /// Weight of each ray by the loss function, 0 to 1.
    pub weights: Vec<f64>,
}

/// Why there is no nadir.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NadirError {
    #[error("expected at least {LEAST_RAYS} points of the edge, found {0}")]
    Rays(usize),
    #[error(transparent)]
    Fit(#[from] FitError),
}

/// The nadir from the edge of a sphere in one picture, or in several at one time.
///
/// # Errors
/// If there are too few rays, or if they do not determine a direction.
pub fn nadir(
    pictures: &[EdgeRays],
    sphere: &Sphere,
    height: EdgeHeight,
    departure: Departure,
) -> Result<Nadir, NadirError> {
    let edge = || pictures.iter().flat_map(|picture| &picture.rays);
    let count = edge().count();
    if count < LEAST_RAYS {
        return Err(NadirError::Rays(count));
    }
    let given = sphere.half_angle_rad;
    let free_rad = match height {
        EdgeHeight::Given => 0.0,
        EdgeHeight::Fitted => FREE_RAD,
    };
    let start = start(edge(), given.value).ok_or(FitError::Undetermined)?;
    let tangents = across(&start);
    let moved = |by: &Vector3<f64>| {
        UnitVector3::new_normalize(start.into_inner() + tangents * by.fixed_rows::<2>(0))
    };
    let sigma_rad = |ray: &EdgeRay| {
        let own = ray.sigma_rad.hypot(ray.of_brightness_rad);
        own.hypot(departure.sigma_rad)
    };
    let edge: Vec<(&EdgeRay, f64)> = edge().map(|ray| (ray, sigma_rad(ray))).collect();
    let linearise = |by: &Vector3<f64>| {
        let (nadir, risen_rad) = (moved(by), by.z * free_rad);
        let of_sphere = (given.value + risen_rad).sin_cos();
        Some(edge.iter().map(move |(ray, sigma)| {
            let towards = || sphere.half_angle_towards(&ray.unit, &nadir) + risen_rad;
            let (sine, cosine) = match sphere.ellipsoid {
                None => of_sphere,
                Some(_) => towards().sin_cos(),
            };
            let along = ray.unit.dot(&nadir);
            let outward = (1.0 - along * along).sqrt();
            let slope = tangents.tr_mul(&ray.unit) / outward;
            Linearised {
                // The sine of a small difference of angles, which equals that difference.
                residual: Vector1::new((sine * along - cosine * outward) / *sigma),
                jacobian: -RowVector3::new(slope.x, slope.y, free_rad) / *sigma,
            }
        }))
    };
    let robust = LeastSquares {
        start: Vector3::zeros(),
        // Prior of the half-angle's change in units of its free range; if it is held, the prior keeps the equations
        // regular.
        prior: Prior {
            mean: Vector3::zeros(),
            information: Vector3::z(),
        },
        loss: Loss::Tukey(TUKEY_SIGMAS),
        scale: Scale::Inflated,
        tolerance_sigmas: 1e-2,
    };
    let fitted = robust.fit_after_plain(linearise)?;
    let rows = linearise(&fitted.parameters).into_iter().flatten();
    let weighted = rows.zip(&fitted.weights).zip(&edge);
    let gradients: Vec<(Vector3<f64>, &EdgeRay)> = weighted
        .map(|((row, weight), (ray, sigma))| (row.jacobian.transpose() * (*weight / sigma), *ray))
        .collect();
    let held_rad = match height {
        EdgeHeight::Given => given.sigma,
        EdgeHeight::Fitted => 0.0,
    };
    let noise = |(gradient, ray): &(Vector3<f64>, &EdgeRay)| {
        gradient * gradient.transpose() * ray.sigma_rad.powi(2)
    };
    let mut scatter: Matrix3<f64> = gradients.iter().map(noise).sum();
    // Contribution of the prior of the half-angle, in units of its free range.
    scatter += Matrix3::from_diagonal(&Vector3::z());
    // The departure seen in the residuals is already a part of that expected from the height's sigma: the larger one
    // counts.
    let shown = departure.scatter(&gradients);
    let expected = sphere.departure.scatter(&gradients);
    let of_nadir = |scatter: &Matrix3<f64>| scatter.m11 + scatter.m22;
    scatter += match of_nadir(&expected) > of_nadir(&shown) {
        true => expected,
        false => shown,
    };
    scatter += Departure::shared(held_rad).scatter(&gradients);
    // Shifts common to all rays, each with its own magnitude.
    let together = |moved_rad: fn(&EdgeRay) -> f64| {
        let moved = gradients
            .iter()
            .map(|(gradient, ray)| gradient * moved_rad(ray));
        let sum: Vector3<f64> = moved.sum();
        sum * sum.transpose()
    };
    scatter += together(|ray| ray.of_brightness_rad) + together(|ray| ray.unsettled_rad);
    let mut left = &gradients[..];
    for picture in pictures {
        let (own, others) = left.split_at(picture.rays.len());
        scatter += light(picture).scatter(own);
        left = others;
    }
    // Both covariances contain the inflation by the scatter; it must count once.
    let covariance = fitted.covariance * scatter * fitted.covariance / fitted.scatter.powi(2);
    if !covariance.iter().all(|v| v.is_finite()) {
        return Err(FitError::Undetermined.into());
    }
    let unit = moved(&fitted.parameters);
    let half_angle_rad = Measured::new(
        given.value + fitted.parameters.z * free_rad,
        held_rad.hypot(covariance.m33.sqrt() * free_rad),
    );
    let across_rad2 = covariance.fixed_view::<2, 2>(0, 0);
    Ok(Nadir {
        conic: Conic::of(&unit, half_angle_rad.value),
        height,
        direction: Direction {
            unit,
            covariance_rad2: tangents * across_rad2 * tangents.transpose(),
        },
        half_angle_rad,
        departure,
        scatter: fitted.scatter,
        weights: fitted.weights,
    })
}

/// Rotation of the camera about its axis from the horizontal, deg: positive with its right side low.
pub fn roll_deg(nadir: &UnitVector3<f64>) -> f64 {
    nadir.x.atan2(nadir.y).to_degrees()
}

/// Elevation of the camera's axis above the horizontal, deg.
pub fn pitch_deg(nadir: &UnitVector3<f64>) -> f64 {
    -nadir.z.asin().to_degrees()
}

impl Nadir {
    pub fn roll_deg(&self) -> f64 {
        roll_deg(&self.direction.unit)
    }

    pub fn pitch_deg(&self) -> f64 {
        pitch_deg(&self.direction.unit)
    }

    /// Square root of the largest eigenvalue of the covariance, deg: the isotropic bound (Braun and Barf 2022, eq. 37).
    pub fn sigma_deg(&self) -> f64 {
        self.direction.sigma_rad().to_degrees()
    }

    /// The fitted height of the edge; `None` if it was held, or for a sphere without air.
    pub fn edge_m(&self, sphere: &Sphere) -> Option<Measured> {
        match self.height {
            EdgeHeight::Given => None,
            EdgeHeight::Fitted => sphere.edge_m(self.half_angle_rad),
        }
    }

    /// Whether the n-th ray is part of the edge.
    pub fn agrees(&self, n: usize) -> bool {
        self.weights.get(n).is_some_and(is_part)
    }

    /// Number of rays that are part of the edge.
    pub fn agreeing(&self) -> usize {
        agreeing(&self.weights)
    }
}

/// Number of rays that are part of the edge, by their weights.
pub(super) fn agreeing(weights: &[f64]) -> usize {
    weights.iter().filter(|weight| is_part(weight)).count()
}

/// Whether a ray with this weight is part of the edge.
pub(super) fn is_part(weight: &f64) -> bool {
    *weight > LEAST_WEIGHT
}

/// Common shift of a picture's edge, outwards or inwards, by its light.
fn light(picture: &EdgeRays) -> Departure {
    Departure {
        sigma_rad: picture.sigma_rad,
        length_rad: LIGHT_RAD,
    }
}

/// Mean of the nadirs that follow from each ray and its bright side.
fn start<'a>(edge: impl Iterator<Item = &'a EdgeRay>, angle: f64) -> Option<UnitVector3<f64>> {
    let (sine, cosine) = angle.sin_cos();
    let of_one = |ray: &EdgeRay| ray.unit.into_inner() * cosine + ray.inward * sine;
    let sum: Vector3<f64> = edge.map(of_one).sum();
    UnitVector3::try_new(sum, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::camera::{CameraModel, Lens};
    use crate::horizon::EdgePoint;
    use crate::horizon::Refraction;
    use crate::units::SensorPx;
    use nalgebra::{Matrix2, Rotation3, Vector2};
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_xoshiro::Xoshiro256PlusPlus;
    use std::f64::consts::TAU;

    const SIZE_PX: [f64; 2] = [1920.0, 1080.0];
    const NOISE_PX: f64 = 0.1;
    /// Number of points on the whole edge, in view or not.
    const DRAWN_POINTS: u32 = 2000;

    /// A field of 94.4 deg.
    fn camera() -> CameraModel {
        let focal = SIZE_PX[0] / 2.0 / 47.2_f64.to_radians().tan();
        let centre = SensorPx::new(959.5, 539.5);
        CameraModel::new(Lens::Rectilinear, [focal, focal], centre).unwrap()
    }

    /// A nadir from the camera's roll and pitch.
    fn nadir_of(roll_deg: f64, pitch_deg: f64) -> UnitVector3<f64> {
        let (roll, pitch) = (roll_deg.to_radians(), pitch_deg.to_radians());
        let level = Vector3::new(roll.sin(), roll.cos(), 0.0) * pitch.cos();
        UnitVector3::new_normalize(level - Vector3::z() * pitch.sin())
    }

    /// Errors of a drawn edge: white noise of the camera (px), a correlated error of the edge and an error of the
    /// half-angle.
    #[derive(Clone, Copy)]
    struct Errors {
        noise_px: f64,
        edge: Departure,
        angle_rad: f64,
    }

    const NOISE_ALONE: Errors = Errors {
        noise_px: NOISE_PX,
        edge: Departure::NONE,
        angle_rad: 0.0,
    };

    /// Points of the edge within the picture, some pixels apart, with drawn errors.
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
        let mut last: Option<UnitVector3<f64>> = None;
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
            let ray = camera.ray(at).unwrap();
            let step = last.map_or(f64::INFINITY, |last| last.angle(&ray));
            let kept = (-step / errors.edge.length_rad).exp();
            let fresh = (1.0 - kept * kept).sqrt() * errors.edge.sigma_rad;
            departure = kept * departure + fresh * random.sample::<f64, _>(StandardNormal);
            last = Some(ray);
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
                of_brightness_px: 0.0,
            });
        }
        points
    }

    fn rays(points: &[EdgePoint]) -> [EdgeRays; 1] {
        let camera = camera();
        let rays = points
            .iter()
            .map(|point| EdgeRay::of(point, &camera).unwrap());
        [EdgeRays {
            rays: rays.collect(),
            sigma_rad: 0.0,
        }]
    }

    /// The nadir fitted to points on a sphere's edge.
    fn found(points: &[EdgePoint], angle: Measured, departure: Departure) -> Nadir {
        let sphere = Sphere::disc(angle);
        nadir(&rays(points), &sphere, EdgeHeight::Given, departure).unwrap()
    }

    /// Rms of the errors normalised by their covariance, over many scenes.
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
            let found = found(&points, half_angle, errors.edge);
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
        let sphere = Sphere::earth(exact(height_m), exact(0.0), Refraction::None);
        sphere.unwrap().half_angle_rad.value
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
            let found = found(&points, Measured::new(angle, 0.0), Departure::NONE);
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
        let edge = Departure {
            sigma_rad: 3e-4,
            length_rad: 0.1,
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
    fn the_edges_height_is_found_with_the_nadir_and_known_as_well_as_it_says() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(6);
        let angle = half_angle(230_000.0);
        // The half-angle is off by the height of the air above the sphere.
        let start = Sphere::disc(Measured::new(angle - 0.012, 0.0));
        let mut squares = 0.0;
        const SCENES: usize = 200;
        for _ in 0..SCENES {
            let truth = nadir_of(random.random_range(-25.0..25.0), -10.0);
            let points = edge(&truth, angle, NOISE_ALONE, &mut random);
            let fitted = EdgeHeight::Fitted;
            let found = nadir(&rays(&points), &start, fitted, Departure::NONE).unwrap();
            let Measured { value, sigma } = found.half_angle_rad;
            squares += ((value - angle) / sigma).powi(2);
            let off_deg = found.direction.unit.angle(&truth).to_degrees();
            assert!(off_deg < 5.0 * found.sigma_deg(), "{off_deg} deg");
        }
        let ratio = (squares / SCENES as f64).sqrt();
        assert!((0.85..1.15).contains(&ratio), "{ratio}");
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
            let found = found(&points, Measured::new(angle, 0.0), Departure::NONE);
            let across = across(&truth);
            off.0 += across.transpose() * (found.direction.unit.into_inner() - truth.into_inner());
            off.1 += across.transpose() * found.direction.covariance_rad2 * across;
        }
        // The mean error is a draw from the mean covariance over the number of scenes, twice.
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
        let found = found(&points, Measured::new(angle, 0.0), Departure::NONE);
        assert!(found.weights[flare].iter().all(|weight| *weight < 0.01));
        let error = found.direction.unit.angle(&truth).to_degrees();
        assert!(error < 5.0 * found.sigma_deg(), "{error} deg");
    }

    #[test]
    fn what_determines_no_direction_is_an_error() {
        let sphere = Sphere::disc(Measured::new(1.4, 0.0));
        let of = |rays: &[EdgeRays]| nadir(rays, &sphere, EdgeHeight::Given, Departure::NONE);
        assert_eq!(of(&[]), Err(NadirError::Rays(0)));
        let point = EdgePoint {
            at: SensorPx::new(100.0, 500.0),
            inward: Vector2::y(),
            sigma_px: NOISE_PX,
            of_brightness_px: 0.0,
        };
        let one_place = of(&rays(&[point; 5]));
        assert!(one_place.is_err() || one_place.unwrap().sigma_deg() > 1.0);
    }

    #[test]
    fn roll_is_positive_with_the_right_side_low_and_pitch_above_the_horizontal() {
        let unit = Rotation3::from_axis_angle(&Vector3::z_axis(), -0.1) * Vector3::y_axis();
        let direction = Direction::new(unit, 1e-4);
        let nadir = Nadir {
            direction,
            height: EdgeHeight::Given,
            half_angle_rad: Measured::new(1.4, 0.0),
            conic: Conic::Hyperbola,
            departure: Departure::NONE,
            scatter: 1.0,
            weights: Vec::new(),
        };
        assert!((nadir.roll_deg() - 0.1_f64.to_degrees()).abs() < 1e-9);
        assert!(nadir.pitch_deg().abs() < 1e-9);
        assert!((nadir.sigma_deg() - 1e-4_f64.to_degrees()).abs() < 1e-9);
        assert!(nadir_of(0.0, 10.0).z < 0.0);
    }
}
