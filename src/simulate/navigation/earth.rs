//! The Earth as a vehicle near it feels it, and the Sun's direction.

use crate::simulate::earth::Shape;
use crate::units::Place;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Gravitational constant of the Earth times its mass, m^3/s^2.
pub(super) const GM_M3_S2: f64 = 3.986_004_418e14;
/// Of the potential's second harmonic.
const J2: f64 = 1.082_629_82e-3;
/// The Earth's rotation against inertial space.
pub(super) const EARTH_RATE_RAD_S: f64 = 7.292_115e-5;

/// The Earth's rotation as a vector, Earth-fixed.
pub(super) fn earth_rate_rad_s() -> Vector3<f64> {
    Vector3::new(0.0, 0.0, EARTH_RATE_RAD_S)
}

/// Acceleration by attraction alone, without the centrifugal one.
pub(super) fn gravitation_m_s2(position_m: &Vector3<f64>) -> Vector3<f64> {
    let radius_m = position_m.norm();
    let oblate = 1.5 * J2 * (Shape::WGS84.equator_m / radius_m).powi(2);
    let polar = 5.0 * (position_m.z / radius_m).powi(2);
    let across = 1.0 + oblate * (1.0 - polar);
    let along = 1.0 + oblate * (3.0 - polar);
    let scaled = position_m.component_mul(&Vector3::new(across, across, along));
    scaled * (-GM_M3_S2 / radius_m.powi(3))
}

/// Earth-fixed coordinates of a place.
pub(super) fn position_m(place: &Place) -> Vector3<f64> {
    let (sin, cos) = place.latitude_deg.to_radians().sin_cos();
    let (sin_east, cos_east) = place.longitude_deg.to_radians().sin_cos();
    let square = Shape::WGS84.flattening * (2.0 - Shape::WGS84.flattening);
    let normal_m = Shape::WGS84.equator_m / (1.0 - square * sin * sin).sqrt();
    let from_axis_m = (normal_m + place.height_m) * cos;
    Vector3::new(
        from_axis_m * cos_east,
        from_axis_m * sin_east,
        (normal_m * (1.0 - square) + place.height_m) * sin,
    )
}

/// North, east and down at a place, which it takes to Earth-fixed axes.
pub(super) fn ecef_from_north_east_down(place: &Place) -> Rotation3<f64> {
    let (sin, cos) = place.latitude_deg.to_radians().sin_cos();
    let (sin_east, cos_east) = place.longitude_deg.to_radians().sin_cos();
    let north = Vector3::new(-sin * cos_east, -sin * sin_east, cos);
    let east = Vector3::new(-sin_east, cos_east, 0.0);
    let columns = [north, east, north.cross(&east)];
    Rotation3::from_matrix_unchecked(Matrix3::from_columns(&columns))
}

/// The Sun, which stands still in inertial space for as long as a flight lasts, infinitely far away.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FixedSun {
    pub declination_deg: f64,
    /// Of the place above which it stands at time 0, east positive.
    pub longitude_deg: f64,
}

impl FixedSun {
    /// Above such a place in the morning at time 0, at an elevation; highest then, where the Sun rises no higher.
    pub fn rising(declination_deg: f64, place: &Place, elevation_deg: f64) -> Self {
        let (sin, cos) = place.latitude_deg.to_radians().sin_cos();
        let (sin_declination, cos_declination) = declination_deg.to_radians().sin_cos();
        let sin_elevation = elevation_deg.to_radians().sin();
        let cos_hour = (sin_elevation - sin * sin_declination) / (cos * cos_declination);
        let before_noon_deg = cos_hour.clamp(-1.0, 1.0).acos().to_degrees();
        Self {
            declination_deg,
            longitude_deg: place.longitude_deg + before_noon_deg,
        }
    }

    /// Earth-fixed, of length 1.
    pub fn direction(&self, t_s: f64) -> Vector3<f64> {
        let (sin, cos) = self.declination_deg.to_radians().sin_cos();
        let (sin_east, cos_east) =
            (self.longitude_deg.to_radians() - EARTH_RATE_RAD_S * t_s).sin_cos();
        Vector3::new(cos * cos_east, cos * sin_east, sin)
    }
}
