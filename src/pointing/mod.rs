//! From the Sun on the plate to the telescope's offset from its target, and back.
//!
//! The shift s of the Sun from the boresight on the plate is an angle atan2(|s|, plate distance) in the direction
//! atan2(s.x, s.y), clockwise from the plate's +Y. The telescope points, from the Sun, by that angle in the
//! direction -(direction + clocking), clockwise from the zenith as seen looking out (HEROES flight program, 2013).
//! The target lies at helioprojective coordinates about the Sun, whose north is turned from the zenith as the
//! ephemeris says.
//! All of it is on the sphere; nothing assumes small angles.

use crate::aspect::Solution;
use crate::instrument::{Instrument, Optics};
use crate::sky::sphere::{angles_deg, bearing_rad, direction, separation_rad, tangents, travel};
use crate::sky::{self, SunPosition};
use crate::units::{ARCSEC_PER_RAD, Estimate, MIL_MM, Place, PlateMil};
use jiff::Timestamp;
use nalgebra::{Matrix2, Vector2, Vector3};

/// Above this elevation a difference of azimuths says nothing of use.
const HIGHEST_ELEVATION_DEG: f64 = 85.0;

/// A place about the Sun's centre as seen by the observer: x towards solar west, y towards solar north.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct HelioprojectiveArcsec {
    pub x: f64,
    pub y: f64,
}

/// A direction in the observer's horizon: azimuth from north through east, elevation without refraction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Horizontal {
    pub azimuth_deg: f64,
    pub elevation_deg: f64,
}

/// Where the telescope points, minus the target: plain differences of azimuth (-180 to 180) and elevation.
/// There is no roll here: one Sun tells two axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Offset {
    pub azimuth_deg: f64,
    pub elevation_deg: f64,
    /// 1 sigma per axis of true angle on the sky, the rms of the two axes.
    pub sigma_deg: f64,
}

/// Why an offset or a plate position cannot be given.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PointingError {
    #[error(
        "expected an elevation up to {HIGHEST_ELEVATION_DEG} deg, where azimuth still tells directions apart, found {elevation_deg:.3} deg"
    )]
    NearZenith { elevation_deg: f64 },
    #[error(
        "expected the Sun within 90 deg of the pointing, found it {separation_deg:.3} deg away"
    )]
    BehindTheLens { separation_deg: f64 },
}

/// The offset of a solved frame. `None` where the frame has no Sun, or its time or place is not known; where the sky
/// gives no answer (a date out of range, too near the zenith) the reason is logged.
pub fn offset_of(
    solution: &Solution,
    utc: Option<Timestamp>,
    place: Option<Place>,
    instrument: &Instrument,
    target: HelioprojectiveArcsec,
) -> Option<Offset> {
    let sun_plate = solution.aspect?.sun_plate;
    let sun = match sky::sun(utc?, place?) {
        Ok(sun) => sun,
        Err(error) => {
            tracing::warn!(%error, "no offset: the Sun's position is not known");
            return None;
        }
    };
    offset(sun_plate, instrument, &sun, target)
        .inspect_err(|error| tracing::warn!(%error, "no offset"))
        .ok()
}

/// The telescope's offset from a target, with the uncertainty that the Sun's place on the plate gives it.
///
/// # Errors
/// [`PointingError::NearZenith`] when the pointing or the target stands above 85 deg.
pub fn offset(
    sun_on_plate: Estimate<PlateMil>,
    instrument: &Instrument,
    sun: &SunPosition,
    target: HelioprojectiveArcsec,
) -> Result<Offset, PointingError> {
    let pointing = away_from_zenith(&boresight(sun_on_plate.position, instrument, sun))?;
    let target = away_from_zenith(&target_direction(target, sun))?;
    Ok(Offset {
        azimuth_deg: wrapped_deg(pointing.azimuth_deg - target.azimuth_deg),
        elevation_deg: pointing.elevation_deg - target.elevation_deg,
        sigma_deg: sigma_rad(&sun_on_plate, instrument).to_degrees(),
    })
}

/// Where the telescope points when the Sun stands at a place on the plate.
pub fn pointing(sun_on_plate: PlateMil, instrument: &Instrument, sun: &SunPosition) -> Horizontal {
    horizontal(&boresight(sun_on_plate, instrument, sun))
}

/// Where on the plate the Sun stands when the telescope points in a direction.
///
/// # Errors
/// [`PointingError::BehindTheLens`] when the Sun is 90 deg or more away.
pub fn sun_on_plate(
    pointing: Horizontal,
    instrument: &Instrument,
    sun: &SunPosition,
) -> Result<PlateMil, PointingError> {
    let centre = sun_direction(sun);
    let towards = direction(pointing.azimuth_deg, pointing.elevation_deg);
    let angle = separation_rad(&centre, &towards);
    if angle >= std::f64::consts::FRAC_PI_2 {
        let separation_deg = angle.to_degrees();
        return Err(PointingError::BehindTheLens { separation_deg });
    }
    let mounting = &instrument.mounting;
    let clockwise = -bearing_rad(&centre, &towards) - mounting.clocking_deg.value.to_radians();
    let length = angle.tan() * plate_distance_mil(&instrument.optics);
    let shift = Vector2::new(clockwise.sin(), clockwise.cos()) * length;
    Ok((mounting.boresight_mil.vector() + shift).into())
}

/// Where on the plate the Sun stands when the telescope is off its target by an offset: the inverse of
/// [`offset`].
///
/// # Errors
/// Those of [`offset`] for the target, and those of [`sun_on_plate`].
pub fn sun_on_plate_for(
    offset: &Offset,
    instrument: &Instrument,
    sun: &SunPosition,
    target: HelioprojectiveArcsec,
) -> Result<PlateMil, PointingError> {
    let target = away_from_zenith(&target_direction(target, sun))?;
    let pointing = Horizontal {
        azimuth_deg: target.azimuth_deg + offset.azimuth_deg,
        elevation_deg: target.elevation_deg + offset.elevation_deg,
    };
    sun_on_plate(pointing, instrument, sun)
}

/// The direction in which the telescope points.
fn boresight(sun_on_plate: PlateMil, instrument: &Instrument, sun: &SunPosition) -> Vector3<f64> {
    let shift = shift(sun_on_plate, instrument);
    let angle = shift.norm().atan2(plate_distance_mil(&instrument.optics));
    let clockwise = shift.x.atan2(shift.y);
    let clocking = instrument.mounting.clocking_deg.value.to_radians();
    travel(&sun_direction(sun), -(clockwise + clocking), angle)
}

/// The direction of a target, by the definition of helioprojective longitude and latitude (Thompson 2006).
fn target_direction(target: HelioprojectiveArcsec, sun: &SunPosition) -> Vector3<f64> {
    let centre = sun_direction(sun);
    let (up, clockwise) = tangents(&centre);
    let (sin, cos) = sun.zenith_to_north_deg.to_radians().sin_cos();
    let north = up * cos + clockwise * sin;
    let west = clockwise * cos - up * sin;
    let (sin_x, cos_x) = (target.x / ARCSEC_PER_RAD).sin_cos();
    let (sin_y, cos_y) = (target.y / ARCSEC_PER_RAD).sin_cos();
    centre * (cos_y * cos_x) + west * (cos_y * sin_x) + north * sin_y
}

/// 1 sigma per axis of the pointing, true angle: the plate position's covariance through the lens, along the
/// shift and across it.
fn sigma_rad(sun_on_plate: &Estimate<PlateMil>, instrument: &Instrument) -> f64 {
    let shift = shift(sun_on_plate.position, instrument);
    let distance = plate_distance_mil(&instrument.optics);
    let cos = distance / distance.hypot(shift.norm());
    let along = shift.try_normalize(0.0).unwrap_or_else(Vector2::x);
    let across = Vector2::new(-along.y, along.x);
    let to_angle = Matrix2::from_rows(&[
        (along * cos.powi(2) / distance).transpose(),
        (across * cos / distance).transpose(),
    ]);
    let covariance = to_angle * sun_on_plate.covariance * to_angle.transpose();
    (covariance.trace().max(0.0) / 2.0).sqrt()
}

fn shift(sun_on_plate: PlateMil, instrument: &Instrument) -> Vector2<f64> {
    sun_on_plate.vector() - instrument.mounting.boresight_mil.vector()
}

fn plate_distance_mil(optics: &Optics) -> f64 {
    optics.plate_distance_mm.value / MIL_MM
}

fn sun_direction(sun: &SunPosition) -> Vector3<f64> {
    direction(sun.azimuth_deg, sun.elevation_deg)
}

fn horizontal(v: &Vector3<f64>) -> Horizontal {
    let (azimuth_deg, elevation_deg) = angles_deg(v);
    Horizontal {
        azimuth_deg,
        elevation_deg,
    }
}

fn away_from_zenith(v: &Vector3<f64>) -> Result<Horizontal, PointingError> {
    let seen = horizontal(v);
    if seen.elevation_deg > HIGHEST_ELEVATION_DEG {
        let elevation_deg = seen.elevation_deg;
        return Err(PointingError::NearZenith { elevation_deg });
    }
    Ok(seen)
}

/// A difference of angles, -180 to 180 deg.
fn wrapped_deg(difference: f64) -> f64 {
    (difference + 180.0).rem_euclid(360.0) - 180.0
}
