//! Where the edge of a sphere stands about the direction to its centre, and that of the Earth's ellipsoid about straight down.

use crate::units::{EARTH_RADIUS_M, Measured, Place};
use nalgebra::{Matrix3, Matrix3x2, UnitVector3, Vector2, Vector3};
use sofars::coords::{eform, gd2gc};
use std::f64::consts::{PI, TAU};

/// The light of the Earth's limb falls off over these heights about its edge, m. Inside, clouds follow; outside, the sky is dark.
const LIMB_INSIDE_M: f64 = 20_000.0;
const LIMB_OUTSIDE_M: f64 = 60_000.0;
/// By how much the border of what is bright may stand above or below the edge, m.
const BORDER_HEIGHT_M: f64 = 4_000.0;
/// SOFA's number of the WGS 84 ellipsoid.
const WGS84: i32 = 1;
/// Azimuths of which the half-angle's mean is taken.
const AZIMUTHS: u32 = 72;
/// An axis so near straight down has no azimuth, rad.
const LEAST_LEVEL: f64 = 1e-6;

/// Whether air bends the rays to the limb.
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
        // Of visible light at 15 deg C and 1013 hPa (Edlen 1966); the scale height is that of the stratosphere, where the limb's edge is.
        const REFRACTIVITY: f64 = 2.77e-4;
        const SCALE_M: f64 = 7_000.0;
        match self {
            Self::None => 1.0,
            Self::StandardAir => 1.0 + REFRACTIVITY * (-height_m / SCALE_M).exp(),
        }
    }
}

/// A sphere, or the Earth's ellipsoid, whose edge is looked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Half-angle of the cone of rays to its edge: of an ellipsoid, the mean of all azimuths.
    pub half_angle_rad: Measured,
    /// How the half-angle departs from that mean; `None` of a sphere.
    pub ellipsoid: Option<Ellipsoid>,
    /// Over which angles about its edge its light falls off.
    pub inside_rad: f64,
    pub outside_rad: f64,
    /// By how much the border of what is bright may lie off the edge.
    pub tolerance_rad: f64,
    /// Of the camera from the centre; `None` of a sphere whose edge has no height.
    pub distance_m: Option<f64>,
}

impl Sphere {
    /// The Earth as a sphere, with its limb: see [`half_angle_rad`]. `None` for a camera that is not above the edge.
    pub fn earth(height_m: Measured, edge_m: Measured, refraction: Refraction) -> Option<Self> {
        let half_angle_rad = half_angle_rad(height_m, edge_m, refraction)?;
        let rad_per_m = 1.0 / ((EARTH_RADIUS_M + height_m.value) * half_angle_rad.value.cos());
        Some(Self {
            half_angle_rad,
            ellipsoid: None,
            inside_rad: (LIMB_INSIDE_M * rad_per_m).min(half_angle_rad.value / 2.0),
            outside_rad: LIMB_OUTSIDE_M * rad_per_m,
            tolerance_rad: BORDER_HEIGHT_M * rad_per_m,
            distance_m: Some(EARTH_RADIUS_M + height_m.value),
        })
    }

    /// The Earth as an ellipsoid (WGS 84): the direction found is straight down along its normal. `heading` is that of the axis of the rays'
    /// frame that `forward` names, from north over east.
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
        let straight = half_angle_rad(height, edge_m, Refraction::None)?;
        let ellipsoid = Ellipsoid::new(place, edge_m.value, heading_deg, forward)?;
        let bent_rad = sphere.half_angle_rad.value - straight.value;
        let mean_rad = ellipsoid.mean_rad + bent_rad;
        Some(Self {
            half_angle_rad: Measured::new(mean_rad, sphere.half_angle_rad.sigma),
            tolerance_rad: sphere.tolerance_rad + ellipsoid.most_rad(),
            ellipsoid: Some(ellipsoid),
            ..sphere
        })
    }

    /// A sphere with a sharp edge, as the Sun and the Moon are.
    pub fn disc(angular_radius_rad: Measured) -> Self {
        Self {
            half_angle_rad: angular_radius_rad,
            ellipsoid: None,
            inside_rad: 0.0,
            outside_rad: 0.0,
            tolerance_rad: 0.0,
            distance_m: None,
        }
    }

    /// The angle from straight down to the edge, on the side of a ray.
    pub fn half_angle_towards(&self, ray: &UnitVector3<f64>, down: &UnitVector3<f64>) -> f64 {
        let departure = |ellipsoid: Ellipsoid| ellipsoid.departure_rad(ray, down);
        self.half_angle_rad.value + self.ellipsoid.map_or(0.0, departure)
    }

    /// Change of the half-angle with the edge's height.
    pub(super) fn rad_per_m(&self) -> f64 {
        let per_m = |distance_m: f64| 1.0 / (distance_m * self.half_angle_rad.value.cos());
        self.distance_m.map_or(0.0, per_m)
    }
}

/// The edge of the Earth's ellipsoid as it is seen from a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipsoid {
    /// Rays to the edge, in north, east, down, have r^T M r = 0.
    cone: Matrix3<f64>,
    mean_rad: f64,
    heading_rad: f64,
    /// The axis whose heading that is, in the rays' frame.
    forward: UnitVector3<f64>,
}

impl Ellipsoid {
    /// Of the ellipsoid raised by the edge's height. `None` for a place that is not above it.
    fn new(
        place: &Place,
        edge_m: f64,
        heading_deg: f64,
        forward: UnitVector3<f64>,
    ) -> Option<Self> {
        let (equator_m, flattening) = eform(WGS84).ok()?;
        let latitude = place.latitude_deg.to_radians();
        // The Earth is round about its axis, so that longitude does not matter.
        let from_centre = Vector3::from(gd2gc(WGS84, 0.0, latitude, place.height_m).ok()?);
        let polar_m = equator_m * (1.0 - flattening);
        let axes_m = Vector3::new(equator_m, equator_m, polar_m).add_scalar(edge_m);
        let to_unit_sphere = Matrix3::from_diagonal(&axes_m.map(f64::recip));
        let at = to_unit_sphere * from_centre;
        // A ray at + t d touches the unit sphere where (at . d)^2 = d^2 (at^2 - 1).
        let touching = at * at.transpose() - Matrix3::identity() * (at.norm_squared() - 1.0);
        let (sine, cosine) = latitude.sin_cos();
        let north = Vector3::new(-sine, 0.0, cosine);
        let down = Vector3::new(-cosine, 0.0, -sine);
        let from_local = to_unit_sphere * Matrix3::from_columns(&[north, Vector3::y(), down]);
        let mut ellipsoid = Self {
            cone: from_local.transpose() * touching * from_local * equator_m.powi(2),
            mean_rad: 0.0,
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
        // (down cos + level sin)^T M (down cos + level sin) = 0, for the tangent.
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

    /// The largest departure.
    fn most_rad(&self) -> f64 {
        let departures = (0..AZIMUTHS).map(|n| self.half_angle_rad(azimuth(n)) - self.mean_rad);
        departures.fold(0.0, |most, departure| most.max(departure.abs()))
    }
}

fn azimuth(n: u32) -> f64 {
    TAU * f64::from(n) / f64::from(AZIMUTHS)
}

/// Rays to a sphere's edge, and about it.
pub(super) struct Cone<'a> {
    sphere: &'a Sphere,
    nadir: UnitVector3<f64>,
    across: Matrix3x2<f64>,
}

impl<'a> Cone<'a> {
    pub fn new(sphere: &'a Sphere, nadir: &UnitVector3<f64>) -> Self {
        Self {
            sphere,
            nadir: *nadir,
            across: across(nadir),
        }
    }

    /// A ray at an angle around the nadir, and another one outside of the edge.
    pub fn ray(&self, around_rad: f64, outside_rad: f64) -> UnitVector3<f64> {
        let (sine, cosine) = around_rad.sin_cos();
        let outward = UnitVector3::new_unchecked(self.across * Vector2::new(cosine, sine));
        let edge_rad = self.sphere.half_angle_towards(&outward, &self.nadir);
        let (sine, cosine) = (edge_rad + outside_rad).sin_cos();
        UnitVector3::new_unchecked(self.nadir.into_inner() * cosine + outward.into_inner() * sine)
    }
}

/// Two unit vectors across a direction and each other.
pub(super) fn across(unit: &UnitVector3<f64>) -> Matrix3x2<f64> {
    let first = match unit.x.abs() < 0.5 {
        true => unit.cross(&Vector3::x()).normalize(),
        false => unit.cross(&Vector3::y()).normalize(),
    };
    Matrix3x2::from_columns(&[first, unit.cross(&first)])
}

/// The half-angle, with its 1-sigma, of the cone of rays to the horizon (Braun and Barf 2022, eq. 5), rad: of a sphere of
/// [`EARTH_RADIUS_M`] seen from a height above it. The edge that is seen stands `edge` above the sphere. All heights are in m; `None` for a
/// camera that is not above the edge.
///
/// Along a bent ray n r sin(angle to the vertical) is the same everywhere (Bouguer's rule); where the ray grazes the edge the sine is 1.
pub fn half_angle_rad(
    height_m: Measured,
    edge_m: Measured,
    refraction: Refraction,
) -> Option<Measured> {
    let (distance, radius) = (
        EARTH_RADIUS_M + height_m.value,
        EARTH_RADIUS_M + edge_m.value,
    );
    let bent = refraction.index(edge_m.value) / refraction.index(height_m.value);
    let sine = bent * radius / distance;
    if radius >= distance || !(0.0..1.0).contains(&sine) {
        return None;
    }
    let slope_per_m = 1.0 / (distance * (1.0 - sine * sine).sqrt());
    let sigma = slope_per_m * (sine * height_m.sigma).hypot(edge_m.sigma);
    Some(Measured::new(sine.asin(), sigma))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_half_angle_of_known_heights() {
        // asin(6371 / 6601), and so on.
        for (height_m, degrees) in [(230_000.0, 74.830_690), (38_000.0, 83.757_636)] {
            let height = Measured::new(height_m, 100.0);
            let angle = half_angle_rad(height, Measured::new(0.0, 0.0), Refraction::None).unwrap();
            assert!((angle.value.to_degrees() - degrees).abs() < 1e-6);
            let at = |height_m| {
                let height = Measured::new(height_m, 0.0);
                half_angle_rad(height, Measured::new(0.0, 0.0), Refraction::None)
                    .unwrap()
                    .value
            };
            let slope = at(height_m + 50.0) - at(height_m - 50.0);
            assert!((angle.sigma + slope).abs() < 1e-6 * angle.sigma);
        }
    }

    #[test]
    fn refraction_raises_the_limb_as_it_bends_a_ray_step_by_step() {
        // From where the ray is level at 20 km: d(n t)/ds is the gradient of n, which points down.
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
        let exact = |m| Measured::new(m, 0.0);
        let angle = |refraction| {
            let found = half_angle_rad(exact(camera_m), exact(edge_m), refraction);
            found.unwrap().value
        };
        let (bent, straight) = (angle(Refraction::StandardAir), angle(Refraction::None));
        assert!(bent > straight);
        assert!(
            (bent - traced).abs() < 0.02 * (bent - straight),
            "{bent} {traced} {straight}"
        );
    }

    #[test]
    fn there_is_no_horizon_at_or_below_the_edge() {
        let exact = |m| Measured::new(m, 0.0);
        assert_eq!(
            half_angle_rad(exact(0.0), exact(0.0), Refraction::None),
            None
        );
        assert_eq!(
            half_angle_rad(exact(10_000.0), exact(20_000.0), Refraction::None),
            None
        );
        assert_eq!(
            half_angle_rad(exact(f64::NAN), exact(0.0), Refraction::None),
            None
        );
    }
}
