//! Prior expectations of the Moon before a frame is solved.

use crate::geometry::camera::CameraModel;
use crate::reasons::moon as reasons;
use crate::sky::sphere::{direction, separation_rad, tangents, travel};
use crate::sky::{MoonPosition, SunPosition, horizon_deg};
use crate::units::{ARCSEC_PER_RAD, Measured, Place, Rejected};
use nalgebra::{Matrix3, Rotation3, UnitVector3, Vector3};

/// Relative uncertainty of a lens's scale, and so of the radius in px; the Moon's own radius and distance are known far
/// better.
const SCALE_SIGMA: f64 = 3e-3;
/// Uncertainty of the ephemeris's phase, and of the side of the light for a stated attitude, 1 sigma, deg.
const PHASE_SIGMA_DEG: f64 = 0.1;
const SIDE_SIGMA_DEG: f64 = 2.0;
/// A Moon farther below the horizon than this, deg, is not in the picture: refraction is smaller.
const BELOW_DEG: f64 = 1.0;

/// Prior expectations of the Moon before a frame is solved.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Expected {
    pub radius: Option<Radius>,
    /// 0 at full Moon, 180 at new Moon.
    pub phase_angle_deg: Option<Measured>,
    /// Direction of the bright limb's middle in the picture, from +x towards +y.
    pub bright_limb_deg: Option<Measured>,
}

/// A prior radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Radius {
    /// Vertical half axis in the picture, px.
    Pixels(Measured),
    /// Angular radius, rad, for a camera with known optics.
    Angle(Measured),
}

impl Expected {
    /// From the ephemeris.
    pub fn of(moon: &MoonPosition) -> Self {
        let radius_rad = moon.radius_arcsec / ARCSEC_PER_RAD;
        let radius = Measured::new(radius_rad, SCALE_SIGMA * radius_rad);
        Self {
            radius: Some(Radius::Angle(radius)),
            phase_angle_deg: Some(Measured::new(moon.phase_angle_deg, PHASE_SIGMA_DEG)),
            bright_limb_deg: None,
        }
    }

    /// The same with the side of the light for a camera of known attitude.
    pub fn seen_by(
        self,
        moon: &MoonPosition,
        camera: &CameraModel,
        local_from_camera: &Rotation3<f64>,
    ) -> Self {
        const STEP_RAD: f64 = 1e-3;
        let towards = direction(moon.azimuth_deg, moon.elevation_deg);
        let bearing = moon.zenith_to_bright_limb_deg.to_radians();
        let pixel = |local: Vector3<f64>| {
            let local = Vector3::new(local.y, local.x, local.z);
            let ray = UnitVector3::new_normalize(local_from_camera.inverse() * local);
            Some(camera.pixel(&ray)?.vector())
        };
        let centre = pixel(towards);
        let beside = pixel(travel(&towards, bearing, STEP_RAD));
        let angle_deg = centre.zip(beside).map(|(centre, beside)| {
            let along = beside - centre;
            along.y.atan2(along.x).to_degrees()
        });
        Self {
            bright_limb_deg: angle_deg.map(|angle| Measured::new(angle, SIDE_SIGMA_DEG)),
            ..self
        }
    }
}

/// The rejection if the Moon is below the horizon of a place: no picture from there shows it.
pub fn below_horizon(moon: &MoonPosition, place: Place) -> Option<Rejected> {
    let (measured, limit) = (moon.elevation_deg, horizon_deg(place) - BELOW_DEG);
    (measured < limit).then_some(Rejected {
        reason: reasons::BELOW_HORIZON,
        measured,
        limit,
    })
}

/// The rejection if the Moon is nearer to the Sun than a given angle while the Sun is up.
pub fn near_sun(
    moon: &MoonPosition,
    sun: &SunPosition,
    place: Place,
    clear_of_sun_deg: f64,
) -> Option<Rejected> {
    let towards_moon = direction(moon.azimuth_deg, moon.elevation_deg);
    let towards_sun = direction(sun.azimuth_deg, sun.elevation_deg);
    let (measured, limit) = (
        separation_rad(&towards_moon, &towards_sun).to_degrees(),
        clear_of_sun_deg,
    );
    let is_near = !is_night(sun, place) && measured < limit;
    is_near.then_some(Rejected {
        reason: reasons::NEAR_SUN,
        measured,
        limit,
    })
}

/// Whether the whole Sun is below the horizon of a place.
pub fn is_night(sun: &SunPosition, place: Place) -> bool {
    sun.elevation_deg < horizon_deg(place)
}

/// Rotates directions from the camera frame (x right, y down, z forward) to the local frame (east, north, up), for a camera
/// whose axis has the given azimuth and elevation and which is rotated about it by a roll, positive with its right side
/// low.
pub fn local_from_camera(azimuth_deg: f64, elevation_deg: f64, roll_deg: f64) -> Rotation3<f64> {
    let forward = direction(azimuth_deg, elevation_deg);
    let (up, right) = tangents(&forward);
    let (sin, cos) = roll_deg.to_radians().sin_cos();
    let x = right * cos - up * sin;
    let y = -up * cos - right * sin;
    // The vectors of `sky` are north, east and up.
    let axes = [x, y, forward].map(|axis| Vector3::new(axis.y, axis.x, axis.z));
    Rotation3::from_matrix_unchecked(Matrix3::from_columns(&axes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn straight_down_lies_in_the_camera_as_roll_and_elevation_say() {
        for (azimuth, elevation, roll) in
            [(0.0, 0.0, 0.0), (130.0, 35.0, 20.0), (300.0, -5.0, -50.0)]
        {
            let turn = local_from_camera(azimuth, elevation, roll);
            assert!((turn.matrix().determinant() - 1.0).abs() < 1e-12);
            let nadir = UnitVector3::new_normalize(turn.inverse() * -Vector3::z());
            // Roll is positive with the right side low.
            assert!((nadir.x.atan2(nadir.y).to_degrees() - roll).abs() < 1e-9);
            assert!((-nadir.z.asin().to_degrees() - elevation).abs() < 1e-9);
        }
    }
}
