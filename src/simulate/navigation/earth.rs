//! Gravitation and rotation of the Earth, and the Sun's direction.

use crate::simulate::earth::Shape;
use crate::units::Place;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Gravitational constant of the Earth times its mass, m^3/s^2.
pub(super) const GM_M3_S2: f64 = 3.986_004_418e14;
/// Rate of the Earth's rotation in inertial space.
pub(super) const EARTH_RATE_RAD_S: f64 = 7.292_115e-5;

/// The Earth's rotation as a vector, Earth-fixed.
pub(super) fn earth_rate_rad_s() -> Vector3<f64> {
    Vector3::new(0.0, 0.0, EARTH_RATE_RAD_S)
}

/// Gravitational acceleration, without the centrifugal one: that of the body whose gravity potential is constant on WGS 84, in closed form
/// (NIMA TR8350.2, chapter 4, with ellipsoidal coordinates u and beta).
pub(super) fn gravitation_m_s2(position_m: &Vector3<f64>) -> Vector3<f64> {
    let (equator_m, polar_m) = (Shape::WGS84.equator_m, Shape::WGS84.polar_m());
    let focal2 = equator_m.powi(2) - polar_m.powi(2);
    let focal_m = focal2.sqrt();
    let from_axis_m = position_m.xy().norm();
    let beyond2 = position_m.norm_squared() - focal2;
    let flat = 2.0 * focal_m * position_m.z / beyond2;
    let u2 = beyond2 * (1.0 + (1.0 + flat * flat).sqrt()) / 2.0;
    let (u, wide) = (u2.sqrt(), (u2 + focal2).sqrt());
    let (sin, cos) = (position_m.z * wide).atan2(from_axis_m * u).sin_cos();
    let w = ((u2 + focal2 * sin * sin) / (u2 + focal2)).sqrt();
    let q = |u: f64| {
        let ratio = u / focal_m;
        ((1.0 + 3.0 * ratio * ratio) * (1.0 / ratio).atan() - 3.0 * ratio) / 2.0
    };
    let ratio = u / focal_m;
    let steeper = 3.0 * (1.0 + ratio * ratio) * (1.0 - ratio * (1.0 / ratio).atan()) - 1.0;
    let spun = (EARTH_RATE_RAD_S * equator_m).powi(2) / q(polar_m);
    let along_u =
        -(GM_M3_S2 + spun * focal_m * steeper * (sin * sin / 2.0 - 1.0 / 6.0)) / (wide * wide * w);
    let along_beta = spun * q(u) * sin * cos / (wide * w);
    let outwards = (along_u * u / wide * cos - along_beta * sin) / w;
    let z = (along_u * sin + along_beta * u / wide * cos) / w;
    let (sin_east, cos_east) = position_m.y.atan2(position_m.x).sin_cos();
    Vector3::new(outwards * cos_east, outwards * sin_east, z)
}

/// Earth-fixed coordinates of a place.
pub(super) fn position_m(place: &Place) -> Vector3<f64> {
    let on_meridian = Shape::WGS84.place(place.latitude_deg.to_radians(), place.height_m);
    Rotation3::from_axis_angle(&Vector3::z_axis(), place.longitude_deg.to_radians()) * on_meridian
}

/// Rotation from north, east and down at a place to Earth-fixed axes.
pub(super) fn ecef_from_north_east_down(place: &Place) -> Rotation3<f64> {
    let (sin, cos) = place.latitude_deg.to_radians().sin_cos();
    let (sin_east, cos_east) = place.longitude_deg.to_radians().sin_cos();
    let north = Vector3::new(-sin * cos_east, -sin * sin_east, cos);
    let east = Vector3::new(-sin_east, cos_east, 0.0);
    let columns = [north, east, north.cross(&east)];
    Rotation3::from_matrix_unchecked(Matrix3::from_columns(&columns))
}

/// The Sun, infinitely far away, which is fixed in inertial space during a flight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FixedSun {
    pub declination_deg: f64,
    /// Longitude of the place above which it is at time 0, east positive.
    pub longitude_deg: f64,
}

impl FixedSun {
    /// A Sun at an elevation above this place in the morning at time 0; if it does not rise so high, at its highest.
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

    /// Earth-fixed unit vector.
    pub fn direction(&self, t_s: f64) -> Vector3<f64> {
        let (sin, cos) = self.declination_deg.to_radians().sin_cos();
        let (sin_east, cos_east) =
            (self.longitude_deg.to_radians() - EARTH_RATE_RAD_S * t_s).sin_cos();
        Vector3::new(cos * cos_east, cos * sin_east, sin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gravity_on_the_ellipsoid_is_the_published_one() {
        // NIMA TR8350.2, chapter 3: normal gravity at equator and pole, m/s^2.
        for (latitude_deg, published) in [(0.0, 9.780_325_335_9), (90.0, 9.832_184_937_8)] {
            let place = Place::new(latitude_deg, 20.0, 0.0).unwrap();
            let at_m = position_m(&place);
            let turn = earth_rate_rad_s();
            let gravity = gravitation_m_s2(&at_m) - turn.cross(&turn.cross(&at_m));
            assert!(
                (gravity.norm() - published).abs() < 1e-8,
                "{}",
                gravity.norm()
            );
        }
    }
}
