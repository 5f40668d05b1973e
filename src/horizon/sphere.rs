//! The angle between the edge of a sphere and the direction to its centre, and for the Earth's ellipsoid, between its edge
//! and straight down.

use super::departure::Departure;
use crate::geometry::earth::{EQUATOR_M, FLATTENING, ecef_m};
use crate::units::{EARTH_RADIUS_M, Measured, Place};
use nalgebra::{Matrix3, Matrix3x2, UnitVector3, Vector2, Vector3};
use std::f64::consts::{PI, TAU};

/// The light of the Earth's limb falls off over these heights around its edge, m. Inside there are clouds; outside, the sky
/// is dark.
const LIMB_INSIDE_M: f64 = 20_000.0;
const LIMB_OUTSIDE_M: f64 = 50_000.0;
/// Tolerance of the height of the bright area's border about the edge, m.
const BORDER_HEIGHT_M: f64 = 4_000.0;
/// The edge varies along the limb by this fraction of its height's sigma; the correlation falls to 1/e over this azimuth,
/// rad.
const VARIES: f64 = 0.05;
const VARIES_RAD: f64 = 0.17;
/// Maximum number of iterations for the edge's height; each reduces the error by a factor of 4 or more.
const HEIGHT_STEPS: usize = 20;
/// Number of azimuths in the mean of the half-angle.
const AZIMUTHS: u32 = 72;
/// An axis within this angle of straight down has no azimuth, rad.
const LEAST_LEVEL: f64 = 1e-6;

/// Refractivity of air at sea level for visible light, at 15 deg C and 1013 hPa (Edlen 1966).
const REFRACTIVITY: f64 = 2.77e-4;

/// Refraction of the rays to the limb.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refraction {
    /// Rays are straight.
    None,
    /// Air whose refractivity falls off exponentially with height.
    StandardAir,
}

impl Refraction {
    /// The refractive index at a height, m.
    fn index(self, height_m: f64) -> f64 {
        1.0 + self.refractivity(height_m)
    }

    fn refractivity(self, height_m: f64) -> f64 {
        match self {
            Self::None => 0.0,
            Self::StandardAir => REFRACTIVITY * (-height_m / Sphere::SCALE_HEIGHT_M).exp(),
        }
    }

    /// Derivative of n r by r at a height.
    fn slope(self, height_m: f64) -> f64 {
        let falls_per_m = self.refractivity(height_m) / Sphere::SCALE_HEIGHT_M;
        self.index(height_m) - falls_per_m * (EARTH_RADIUS_M + height_m)
    }
}

/// A sphere, or the Earth's ellipsoid, whose edge is searched.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Half-angle of the cone of rays to its edge; for an ellipsoid, the mean over all azimuths.
    pub half_angle_rad: Measured,
    /// Departure of the half-angle from that mean; `None` for a sphere.
    pub ellipsoid: Option<Ellipsoid>,
    /// Angles about its edge over which its light falls off.
    pub inside_rad: f64,
    pub outside_rad: f64,
    /// Tolerance of the border of the bright area about the edge.
    pub tolerance_rad: f64,
    /// Derivative of the half-angle by the edge's height; 0 for a sphere whose edge has no height.
    pub rad_per_m: f64,
    /// Departure of the edge from the sphere, as far as its height is unknown.
    pub departure: Departure,
    /// Position from which the edge is observed; `None` for a sphere whose edge has no height.
    pub viewpoint: Option<Viewpoint>,
}

impl Sphere {
    /// Scale height of the air's density in the stratosphere, where the limb's edge is, and thus of the limb's light.
    pub const SCALE_HEIGHT_M: f64 = 7_000.0;

    /// The Earth as a sphere, with its limb: see [`Viewpoint::half_angle_rad`]. `None` for a camera below the edge.
    pub fn earth(height_m: Measured, edge_m: Measured, refraction: Refraction) -> Option<Self> {
        let viewpoint = Viewpoint {
            height_m,
            refraction,
        };
        let half_angle_rad = viewpoint.half_angle_rad(edge_m)?;
        let rad_per_m = viewpoint.rad_per_m(edge_m.value, half_angle_rad.value);
        Some(Self {
            half_angle_rad,
            ellipsoid: None,
            inside_rad: (LIMB_INSIDE_M * rad_per_m).min(half_angle_rad.value / 2.0),
            outside_rad: LIMB_OUTSIDE_M * rad_per_m,
            tolerance_rad: BORDER_HEIGHT_M * rad_per_m,
            rad_per_m,
            departure: Departure {
                sigma_rad: VARIES * edge_m.sigma * rad_per_m,
                length_rad: VARIES_RAD * half_angle_rad.value.sin(),
            },
            viewpoint: Some(viewpoint),
        })
    }

    /// The Earth as an ellipsoid (WGS 84): the fitted direction is straight down along its normal. `heading` is the
    /// heading, from north over east, of the axis `forward` of the rays' frame.
    pub fn earth_at(
        place: &Place,
        height_sigma_m: f64,
        edge_m: Measured,
        refraction: Refraction,
        heading_deg: f64,
        forward: UnitVector3<f64>,
    ) -> Option<Self> {
        let height = Measured::new(place.height_m, height_sigma_m);
        let sphere = Self::earth(height, edge_m, refraction)?;
        let straight = Viewpoint {
            height_m: height,
            refraction: Refraction::None,
        };
        let straight = straight.half_angle_rad(edge_m)?;
        let mut ellipsoid = Ellipsoid::new(place, edge_m.value, heading_deg, forward)?;
        // The refraction is the same as for the sphere.
        ellipsoid.over_sphere_rad = ellipsoid.mean_rad - straight.value;
        let Measured { value, sigma } = sphere.half_angle_rad;
        Some(Self {
            half_angle_rad: Measured::new(value + ellipsoid.over_sphere_rad, sigma),
            tolerance_rad: sphere.tolerance_rad + ellipsoid.most_rad(),
            ellipsoid: Some(ellipsoid),
            ..sphere
        })
    }

    /// A sphere with a sharp edge, such as the Sun or the Moon.
    pub fn disc(angular_radius_rad: Measured) -> Self {
        Self {
            half_angle_rad: angular_radius_rad,
            ellipsoid: None,
            inside_rad: 0.0,
            outside_rad: 0.0,
            tolerance_rad: 0.0,
            rad_per_m: 0.0,
            departure: Departure::NONE,
            viewpoint: None,
        }
    }

    /// Angle over which the limb's light falls to 1/e; 0 for a sharp edge.
    pub fn scale_rad(&self) -> f64 {
        Sphere::SCALE_HEIGHT_M * self.rad_per_m
    }

    /// The angle from straight down to the edge, on the side of a ray.
    pub fn half_angle_towards(&self, ray: &UnitVector3<f64>, down: &UnitVector3<f64>) -> f64 {
        let departure = |ellipsoid: Ellipsoid| ellipsoid.departure_rad(ray, down);
        self.half_angle_rad.value + self.ellipsoid.map_or(0.0, departure)
    }

    /// The height of an edge at the given half-angle; `None` for a sphere whose edge has no height.
    pub fn edge_m(&self, found_rad: Measured) -> Option<Measured> {
        // The ellipsoid's half-angle changes with the edge's height in the same way as the sphere's.
        let over_sphere_rad = self.ellipsoid.map_or(0.0, |e| e.over_sphere_rad);
        let found_rad = Measured::new(found_rad.value - over_sphere_rad, found_rad.sigma);
        self.viewpoint.map(|viewpoint| viewpoint.edge_m(found_rad))
    }
}

/// Position of the camera relative to a sphere of [`EARTH_RADIUS_M`], and the refraction of the rays.
///
/// Along a refracted ray n r sin(angle to the vertical) is constant (Bouguer's rule); where the ray grazes the edge the
/// sine is 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Viewpoint {
    /// Height above the sphere.
    pub height_m: Measured,
    pub refraction: Refraction,
}

impl Viewpoint {
    /// n r at the camera, m.
    fn invariant_m(&self) -> f64 {
        let height_m = self.height_m.value;
        self.refraction.index(height_m) * (EARTH_RADIUS_M + height_m)
    }

    /// The half-angle, with its 1-sigma, of the cone of rays to the horizon (Braun and Barf 2022, eq. 5), rad. The edge is
    /// `edge_m` above the sphere. `None` for a camera below the edge.
    pub fn half_angle_rad(&self, edge_m: Measured) -> Option<Measured> {
        let Measured { value, sigma } = edge_m;
        let sine = self.refraction.index(value) * (EARTH_RADIUS_M + value) / self.invariant_m();
        if value >= self.height_m.value || !(0.0..1.0).contains(&sine) {
            return None;
        }
        let angle = sine.asin();
        let by_height = sine / (EARTH_RADIUS_M + self.height_m.value) / angle.cos();
        let sigma = (by_height * self.height_m.sigma).hypot(self.rad_per_m(value, angle) * sigma);
        Some(Measured::new(angle, sigma))
    }

    /// Derivative of the half-angle by the edge's height.
    fn rad_per_m(&self, edge_m: f64, half_angle_rad: f64) -> f64 {
        self.refraction.slope(edge_m) / self.invariant_m() / half_angle_rad.cos()
    }

    /// The height of the edge with the given half-angle.
    fn edge_m(&self, half_angle_rad: Measured) -> Measured {
        let Measured { value, sigma } = half_angle_rad;
        let grazing_m = self.invariant_m() * value.sin();
        let height_m = (0..HEIGHT_STEPS).fold(0.0, |height_m, _| {
            grazing_m / self.refraction.index(height_m) - EARTH_RADIUS_M
        });
        let of_height = value.sin() / self.refraction.slope(height_m) * self.height_m.sigma;
        let of_angle = sigma / self.rad_per_m(height_m, value);
        Measured::new(height_m, of_height.hypot(of_angle))
    }
}

/// The edge of the Earth's ellipsoid as observed from a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipsoid {
    /// Rays to the edge, in north, east, down, have r^T M r = 0.
    cone: Matrix3<f64>,
    mean_rad: f64,
    /// Difference between that mean and a sphere's half-angle.
    over_sphere_rad: f64,
    heading_rad: f64,
    /// The axis with that heading, in the rays' frame.
    forward: UnitVector3<f64>,
}

impl Ellipsoid {
    /// For the ellipsoid enlarged by the edge's height. `None` for a place below it.
    fn new(
        place: &Place,
        edge_m: f64,
        heading_deg: f64,
        forward: UnitVector3<f64>,
    ) -> Option<Self> {
        let latitude = place.latitude_deg.to_radians();
        // The Earth is rotationally symmetric, so longitude does not matter.
        let from_centre = ecef_m(&Place {
            longitude_deg: 0.0,
            ..*place
        });
        let polar_m = EQUATOR_M * (1.0 - FLATTENING);
        let axes_m = Vector3::new(EQUATOR_M, EQUATOR_M, polar_m).add_scalar(edge_m);
        let to_unit_sphere = Matrix3::from_diagonal(&axes_m.map(f64::recip));
        let at = to_unit_sphere * from_centre;
        // A ray at + t d is tangent to the unit sphere if (at . d)^2 = d^2 (at^2 - 1).
        let touching = at * at.transpose() - Matrix3::identity() * (at.norm_squared() - 1.0);
        let (sine, cosine) = latitude.sin_cos();
        let north = Vector3::new(-sine, 0.0, cosine);
        let down = Vector3::new(-cosine, 0.0, -sine);
        let from_local = to_unit_sphere * Matrix3::from_columns(&[north, Vector3::y(), down]);
        let mut ellipsoid = Self {
            cone: from_local.transpose() * touching * from_local * EQUATOR_M.powi(2),
            mean_rad: 0.0,
            over_sphere_rad: 0.0,
            heading_rad: heading_deg.to_radians(),
            forward,
        };
        let angles = (0..AZIMUTHS).map(|n| ellipsoid.half_angle_rad(azimuth(n)));
        let mean_rad = angles.sum::<f64>() / f64::from(AZIMUTHS);
        ellipsoid.mean_rad = mean_rad;
        (at.norm_squared() > 1.0 && mean_rad.is_finite()).then_some(ellipsoid)
    }

    /// The angle from straight down to the edge at an azimuth from north over east.
    fn half_angle_rad(&self, azimuth_rad: f64) -> f64 {
        let level = Vector3::new(azimuth_rad.cos(), azimuth_rad.sin(), 0.0);
        let down = Vector3::z();
        // Solves (down cos + level sin)^T M (down cos + level sin) = 0 for the tangent.
        let by = |a: &Vector3<f64>, b: &Vector3<f64>| a.dot(&(self.cone * b));
        let (square, half, constant) = (by(&level, &level), by(&level, &down), by(&down, &down));
        let root = (half * half - square * constant).sqrt();
        (-(half + root) / square).atan().rem_euclid(PI)
    }

    fn departure_rad(&self, ray: &UnitVector3<f64>, down: &UnitVector3<f64>) -> f64 {
        let level =
            |axis: &UnitVector3<f64>| axis.into_inner() - down.into_inner() * axis.dot(down);
        let ahead = level(&self.forward);
        if ahead.norm() < LEAST_LEVEL {
            return 0.0;
        }
        let right = down.cross(&ahead);
        let aside_rad = ray.dot(&right).atan2(ray.dot(&ahead));
        self.half_angle_rad(self.heading_rad + aside_rad) - self.mean_rad
    }

    /// The largest departure from the mean.
    fn most_rad(&self) -> f64 {
        let departures = (0..AZIMUTHS).map(|n| self.half_angle_rad(azimuth(n)) - self.mean_rad);
        departures.fold(0.0, |most, departure| most.max(departure.abs()))
    }
}

fn azimuth(n: u32) -> f64 {
    TAU * f64::from(n) / f64::from(AZIMUTHS)
}

/// Rays to a sphere's edge, and near it.
pub(super) struct Cone<'a> {
    sphere: &'a Sphere,
    nadir: UnitVector3<f64>,
    across: Matrix3x2<f64>,
    /// Sine and cosine of the sphere's half-angle.
    half_angle: (f64, f64),
}

impl<'a> Cone<'a> {
    pub fn new(sphere: &'a Sphere, nadir: &UnitVector3<f64>) -> Self {
        // Angles around the nadir start behind the camera, so that an arc in view is not split at the start.
        let behind = nadir.into_inner() * nadir.z - Vector3::z();
        let across = match behind.try_normalize(LEAST_LEVEL) {
            Some(behind) => Matrix3x2::from_columns(&[behind, nadir.cross(&behind)]),
            None => across(nadir),
        };
        Self {
            sphere,
            nadir: *nadir,
            across,
            half_angle: sphere.half_angle_rad.value.sin_cos(),
        }
    }

    /// The edge in a direction around the nadir, given by its cosine and sine.
    pub fn edge(&self, around: &Vector2<f64>) -> ConeEdge {
        let outward = UnitVector3::new_unchecked(self.across * around);
        let (sine, cosine) = match self.sphere.ellipsoid {
            None => self.half_angle,
            Some(_) => self
                .sphere
                .half_angle_towards(&outward, &self.nadir)
                .sin_cos(),
        };
        let (down, outward) = (self.nadir.into_inner(), outward.into_inner());
        ConeEdge {
            ray: down * cosine + outward * sine,
            outward: outward * cosine - down * sine,
        }
    }
}

/// A place of the edge of a cone.
pub(super) struct ConeEdge {
    ray: Vector3<f64>,
    /// Unit vector across the ray.
    outward: Vector3<f64>,
}

impl ConeEdge {
    pub fn ray(&self) -> UnitVector3<f64> {
        UnitVector3::new_unchecked(self.ray)
    }

    /// The ray outside of the edge by an angle, given by its sine and cosine.
    pub fn outside(&self, (sine, cosine): (f64, f64)) -> UnitVector3<f64> {
        UnitVector3::new_unchecked(self.ray * cosine + self.outward * sine)
    }
}

/// Two unit vectors perpendicular to a direction and to each other.
pub(crate) fn across(unit: &UnitVector3<f64>) -> Matrix3x2<f64> {
    let first = match unit.x.abs() < 0.5 {
        true => unit.cross(&Vector3::x()).normalize(),
        false => unit.cross(&Vector3::y()).normalize(),
    };
    Matrix3x2::from_columns(&[first, unit.cross(&first)])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn exact(m: f64) -> Measured {
        Measured::new(m, 0.0)
    }

    fn straight(height_m: Measured) -> Viewpoint {
        Viewpoint {
            height_m,
            refraction: Refraction::None,
        }
    }

    #[test]
    fn the_half_angle_of_known_heights() {
        // asin(6371 / 6601), and so on.
        for (height_m, degrees) in [(230_000.0, 74.830_690), (38_000.0, 83.757_636)] {
            let height = Measured::new(height_m, 100.0);
            let angle = straight(height).half_angle_rad(exact(0.0)).unwrap();
            assert!((angle.value.to_degrees() - degrees).abs() < 1e-6);
            let at = |m| straight(exact(m)).half_angle_rad(exact(0.0)).unwrap().value;
            let slope = at(height_m + 50.0) - at(height_m - 50.0);
            assert!((angle.sigma + slope).abs() < 1e-6 * angle.sigma);
        }
    }

    #[test]
    fn refraction_raises_the_limb_as_it_bends_a_ray_step_by_step() {
        // Starts where the ray is level at 20 km: d(n t)/ds is the gradient of n, which points down.
        const STEP_M: f64 = 50.0;
        let (edge_m, camera_m) = (20_000.0, 38_000.0);
        let index = |at: &Vector2<f64>| Refraction::StandardAir.index(at.norm() - EARTH_RADIUS_M);
        let gradient = |at: &Vector2<f64>| -at.normalize() * (index(at) - 1.0) / 7_000.0;
        let mut at = Vector2::new(0.0, EARTH_RADIUS_M + edge_m);
        let mut along = Vector2::x() * index(&at);
        while at.norm() < EARTH_RADIUS_M + camera_m {
            let middle = at + along / index(&at) * (STEP_M / 2.0);
            let along_middle = along + gradient(&at) * (STEP_M / 2.0);
            at += along_middle / index(&middle) * STEP_M;
            along += gradient(&middle) * STEP_M;
        }
        let traced = at.angle(&along);
        let angle = |refraction| {
            let viewpoint = Viewpoint {
                height_m: exact(camera_m),
                refraction,
            };
            viewpoint.half_angle_rad(exact(edge_m)).unwrap().value
        };
        let (bent, straight) = (angle(Refraction::StandardAir), angle(Refraction::None));
        assert!(bent > straight);
        assert!(
            (bent - traced).abs() < 0.02 * (bent - straight),
            "{bent} {traced} {straight}"
        );
    }

    #[test]
    fn an_edges_height_and_its_sigma_are_those_of_its_half_angle() {
        for refraction in [Refraction::None, Refraction::StandardAir] {
            for (camera_m, edge_m) in [(38_000.0, 20_000.0), (38_000.0, 300.0), (230e3, 9_000.0)] {
                let from = |camera_m: f64| Viewpoint {
                    height_m: Measured::new(camera_m, 100.0),
                    refraction,
                };
                let edge = Measured::new(edge_m, 200.0);
                let angle = from(camera_m).half_angle_rad(edge).unwrap();
                let of_edge = from(camera_m).rad_per_m(edge_m, angle.value) * edge.sigma;
                let found = from(camera_m).edge_m(Measured::new(angle.value, of_edge));
                assert!((found.value - edge_m).abs() < 0.1, "{found:?}");
                // Finite differences for the derivatives.
                let at = |camera_m: f64, angle: f64| from(camera_m).edge_m(exact(angle)).value;
                let by_angle = at(camera_m, angle.value + 1e-6) - at(camera_m, angle.value - 1e-6);
                let by_height = at(camera_m + 1.0, angle.value) - at(camera_m - 1.0, angle.value);
                let sigma = (by_angle / 2e-6 * of_edge).hypot(by_height / 2.0 * 100.0);
                assert!(
                    (found.sigma / sigma - 1.0).abs() < 1e-2,
                    "{found:?}, {sigma}"
                );
                assert!((angle.sigma / of_edge - found.sigma / 200.0).abs() < 0.02);
            }
        }
    }

    #[test]
    fn an_arc_in_view_is_in_one_piece_whatever_the_roll() {
        let sphere = Sphere::earth(exact(38_000.0), exact(0.0), Refraction::None).unwrap();
        for roll_deg in (-180..180).step_by(15) {
            let roll = f64::from(roll_deg).to_radians();
            let nadir = UnitVector3::new_normalize(Vector3::new(roll.sin(), roll.cos(), 0.1));
            let cone = Cone::new(&sphere, &nadir);
            assert!(cone.edge(&Vector2::x()).ray.z < 0.0, "{roll_deg} deg");
        }
    }

    #[test]
    fn there_is_no_horizon_at_or_below_the_edge() {
        for (height_m, edge_m) in [(0.0, 0.0), (10_000.0, 20_000.0), (f64::NAN, 0.0)] {
            let seen = straight(exact(height_m)).half_angle_rad(exact(edge_m));
            assert_eq!(seen, None);
        }
    }
}
