//! Model of the Earth: WGS 84, its rotation, and gravity with J2 and J4.

use crate::units::Place;
use nalgebra::{Matrix3, UnitVector3, Vector3};
use sofars::coords::gc2gde;

/// Gravitational constant times mass of the Earth with its atmosphere, m^3/s^2 (WGS 84).
const GRAVITY_M3_PER_S2: f64 = 3.986_004_418e14;
pub const EQUATOR_M: f64 = 6_378_137.0;
pub const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// Zonal harmonics of the ellipsoid's potential (WGS 84; NIMA TR8350.2).
const J2: f64 = 1.082_629_821_3e-3;
const J4: f64 = -2.370_911_2e-6;
/// Angular velocity relative to inertial space, about the z axis of ECEF.
pub const TURN_RAD_PER_S: f64 = 7.292_115e-5;

/// Angular velocity of the Earth, rad/s.
pub fn turn() -> Vector3<f64> {
    Vector3::new(0.0, 0.0, TURN_RAD_PER_S)
}

/// Gravitational acceleration at a position in ECEF, m/s^2: the gradient of the potential to J4 (Montenbruck and Gill, "Satellite Orbits", 3.2).
pub fn gravitation(at_m: &Vector3<f64>) -> Vector3<f64> {
    let r = at_m.norm();
    let sine2 = (at_m.z / r).powi(2);
    let closeness2 = (EQUATOR_M / r).powi(2);
    let (j2, j4) = (1.5 * J2 * closeness2, 1.875 * J4 * closeness2.powi(2));
    let sine4 = sine2 * sine2;
    let across = 1.0 + j2 * (1.0 - 5.0 * sine2) - j4 * (1.0 - 14.0 * sine2 + 21.0 * sine4);
    let along = 1.0 + j2 * (3.0 - 5.0 * sine2) - j4 * (5.0 - 70.0 / 3.0 * sine2 + 21.0 * sine4);
    let scale = Vector3::new(across, across, along);
    -GRAVITY_M3_PER_S2 / r.powi(3) * at_m.component_mul(&scale)
}

/// Acceleration in ECEF of a body with a position and a velocity, without specific force: gravitation plus Coriolis and centrifugal
/// acceleration.
pub fn acceleration(at_m: &Vector3<f64>, velocity_m_s: &Vector3<f64>) -> Vector3<f64> {
    let turn = turn();
    gravitation(at_m) - turn.cross(&(2.0 * velocity_m_s + turn.cross(at_m)))
}

/// Direction of a plumb line at rest, downwards, in ECEF.
pub fn plumb(at_m: &Vector3<f64>) -> UnitVector3<f64> {
    UnitVector3::new_normalize(acceleration(at_m, &Vector3::zeros()))
}

/// Magnitude of the specific force at rest at a place, m/s^2.
pub fn gravity_m_s2(place: &Place) -> f64 {
    acceleration(&ecef_m(place), &Vector3::zeros()).norm()
}

/// Position of a place in ECEF, m.
pub fn ecef_m(place: &Place) -> Vector3<f64> {
    let (sin, cos) = place.latitude_deg.to_radians().sin_cos();
    let (sin_east, cos_east) = place.longitude_deg.to_radians().sin_cos();
    let eccentricity2 = FLATTENING * (2.0 - FLATTENING);
    let normal_m = EQUATOR_M / (1.0 - eccentricity2 * sin * sin).sqrt();
    let axis_m = (normal_m + place.height_m) * cos;
    let z_m = (normal_m * (1.0 - eccentricity2) + place.height_m) * sin;
    Vector3::new(axis_m * cos_east, axis_m * sin_east, z_m)
}

/// The place at a position in ECEF. `None` if it is no place near the Earth's surface.
pub fn geodetic(at_m: &Vector3<f64>) -> Option<Place> {
    let (longitude, latitude, height_m) = gc2gde(EQUATOR_M, FLATTENING, (*at_m).into()).ok()?;
    Place::new(latitude.to_degrees(), longitude.to_degrees(), height_m).ok()
}

/// North, east and up at a position in ECEF, as columns.
pub fn north_east_up(at_m: &Vector3<f64>) -> Matrix3<f64> {
    let up = geodetic_up(at_m);
    let east = Vector3::z().cross(&up).normalize();
    Matrix3::from_columns(&[up.cross(&east), east, up])
}

/// Normal of the ellipsoid at a position in ECEF, upwards.
pub fn geodetic_up(at_m: &Vector3<f64>) -> Vector3<f64> {
    // Bowring's formula (1976), accurate to a hundredth of an arcsecond up to satellites' heights.
    let polar_m = EQUATOR_M * (1.0 - FLATTENING);
    let eccentricity2 = FLATTENING * (2.0 - FLATTENING);
    let second2 = eccentricity2 / (1.0 - eccentricity2);
    let axis_m = at_m.x.hypot(at_m.y);
    let (sin, cos) = (at_m.z * EQUATOR_M).atan2(axis_m * polar_m).sin_cos();
    let latitude = (at_m.z + second2 * polar_m * sin.powi(3))
        .atan2(axis_m - eccentricity2 * EQUATOR_M * cos.powi(3));
    let longitude = at_m.y.atan2(at_m.x);
    Vector3::new(
        latitude.cos() * longitude.cos(),
        latitude.cos() * longitude.sin(),
        latitude.sin(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gravity_is_that_of_the_ellipsoid() {
        // Normal gravity at equator and pole (NIMA TR8350.2, chapter 3).
        for (at, normal) in [
            (Vector3::new(EQUATOR_M, 0.0, 0.0), 9.780_325_335_9),
            (Vector3::new(0.0, 0.0, 6_356_752.314), 9.832_184_937_8),
        ] {
            let down = acceleration(&at, &Vector3::zeros());
            assert!((down.norm() - normal).abs() < 1e-6, "{}", down.norm());
        }
    }

    #[test]
    fn up_by_the_ellipsoid_has_the_latitude_of_maps() {
        // 45 deg north, 30 deg east, 38 km altitude.
        let (latitude, longitude, height) = (45f64.to_radians(), 30f64.to_radians(), 38_000.0);
        let eccentricity2 = FLATTENING * (2.0 - FLATTENING);
        let n = EQUATOR_M / (1.0 - eccentricity2 * latitude.sin().powi(2)).sqrt();
        let axis = (n + height) * latitude.cos();
        let z = (n * (1.0 - eccentricity2) + height) * latitude.sin();
        let at = Vector3::new(axis * longitude.cos(), axis * longitude.sin(), z);
        let place = Place::new(45.0, 30.0, height).unwrap();
        assert!((ecef_m(&place) - at).norm() < 1e-6);
        let up = geodetic_up(&at);
        assert!((up.z.asin() - latitude).abs() < 1e-9);
        assert!((up.y.atan2(up.x) - longitude).abs() < 1e-12);
    }
}
