//! From the Sun on the plate to the telescope's offset from its target, and back.
//!
//! The shift s of the Sun from the boresight on the plate is an angle atan2(|s|, plate distance) in the direction
//! atan2(s.x, s.y), clockwise from the plate's +Y. The telescope points, from the Sun, by that angle in the
//! direction -(direction + clocking), clockwise from the zenith as seen looking out (HEROES flight program, 2013). In
//! other words the plate, turned by the clocking, is the plane that touches the sky at the Sun (gnomonic projection).
//! The lens's focal length does not enter: the ray through its middle goes straight.
//! The target lies at helioprojective coordinates about the Sun, whose north is turned from the zenith as the
//! ephemeris says.
//! All of it is on the sphere; nothing assumes small angles.

mod refusal;
mod target;

pub use refusal::PointingError;
pub use target::{Feature, Target};

use crate::aspect::{Solution, Stage, Stopped};
use crate::instrument::{Instrument, Optics};
use crate::sky::sphere::{angles_deg, direction, separation_rad, tangents};
use crate::sky::{Ephemeris, SunPosition};
use crate::units::{ARCSEC_PER_RAD, Estimate, MIL_MM, Place, PlateMil};
use jiff::Timestamp;
use nalgebra::{Matrix2, Matrix3x2, Vector2, Vector3};
use refusal::NoOffset;

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

/// Where the telescope points, minus the target.
/// There is no roll here: one Sun tells two axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Offset {
    /// A plain difference of azimuths, -180 to 180, as the HEROES controller took it.
    pub azimuth_deg: f64,
    /// A plain difference of elevations.
    pub elevation_deg: f64,
    /// The true angle of the pointing from the target's vertical circle, positive towards larger azimuth; near the target
    /// the difference of azimuths times the cosine of the elevation.
    pub cross_elevation_deg: f64,
    /// 1 sigma per axis of true angle on the sky, the rms of the two axes of `covariance_deg2`.
    pub sigma_deg: f64,
    /// What is uncertain in this frame, in true angle: across (towards larger azimuth) and in elevation. It holds the
    /// stated sigma of the mapping, where that was borrowed.
    pub covariance_deg2: Matrix2<f64>,
    /// What the calibration leaves uncertain of the pointing, the same in every frame: boresight, clocking and plate
    /// distance, by the sigmas that the instrument states, and UT1 behind the table of Earth orientation, which moves Sun
    /// and target alike. It is not part of `covariance_deg2`.
    pub calibration_deg2: Matrix2<f64>,
}

impl Offset {
    /// 1 sigma per axis that the calibration leaves, as `sigma_deg` is of the frame.
    pub fn calibration_sigma_deg(&self) -> f64 {
        per_axis(&self.calibration_deg2)
    }
}

/// The offset of a solved frame. `None` where the frame has no Sun, or its time or place is not known. Where sky or sphere
/// give no answer (a date out of range, too near the zenith, a target behind the limb), the solution says so, unless an
/// earlier stage has had its say, and stays as good as it is.
pub fn offset_of(
    solution: &mut Solution,
    utc: Option<Timestamp>,
    place: Option<Place>,
    target: &Target,
    instrument: &Instrument,
    ephemeris: &mut Ephemeris,
) -> Option<Offset> {
    let sun_plate = solution.aspect?.sun_plate;
    let (utc, place) = (utc?, place?);
    let found = ephemeris
        .sun(utc, place)
        .map_err(NoOffset::from)
        .and_then(|sun| Ok(offset(sun_plate, instrument, &sun, target.at(utc, &sun)?)?));
    match found {
        Ok(offset) => Some(offset),
        Err(error) => {
            tracing::debug!(%error, "no offset");
            let (stage, rejected) = (Stage::Pointing, error.rejected());
            solution.stopped.get_or_insert(Stopped { stage, rejected });
            None
        }
    }
}

/// The telescope's offset from a target, with what the Sun's place on the plate and the calibration leave uncertain.
///
/// # Errors
/// [`PointingError::NearZenith`] when the pointing or the target stands above 85 deg.
pub fn offset(
    sun_on_plate: Estimate<PlateMil>,
    instrument: &Instrument,
    sun: &SunPosition,
    target: HelioprojectiveArcsec,
) -> Result<Offset, PointingError> {
    let boresight = boresight(sun_on_plate.position, instrument, sun);
    let pointing = away_from_zenith(&boresight)?;
    let target = away_from_zenith(&target_direction(target, sun))?;
    let azimuth_deg = wrapped_deg(pointing.azimuth_deg - target.azimuth_deg);
    let across = pointing.elevation_deg.to_radians().cos() * azimuth_deg.to_radians().sin();
    let [frame, calibration] = covariances_rad2(&sun_on_plate, instrument, sun, &boresight);
    let covariance_deg2 = frame * 1_f64.to_degrees().powi(2);
    Ok(Offset {
        azimuth_deg,
        elevation_deg: pointing.elevation_deg - target.elevation_deg,
        cross_elevation_deg: across.asin().to_degrees(),
        sigma_deg: per_axis(&covariance_deg2),
        covariance_deg2,
        calibration_deg2: calibration * 1_f64.to_degrees().powi(2),
    })
}

/// Where the telescope points when the Sun stands at a place on the plate.
pub fn pointing(sun_on_plate: PlateMil, instrument: &Instrument, sun: &SunPosition) -> Horizontal {
    horizontal(&boresight(sun_on_plate, instrument, sun))
}

/// Where the telescope points about the Sun's centre, when the Sun stands at a place on the plate: the inverse of a
/// [`Target`]'s place.
pub fn helioprojective(
    sun_on_plate: PlateMil,
    instrument: &Instrument,
    sun: &SunPosition,
) -> HelioprojectiveArcsec {
    let towards = boresight(sun_on_plate, instrument, sun).normalize();
    let centre = sun_direction(sun);
    let (west, north) = west_and_north(&centre, sun);
    HelioprojectiveArcsec {
        x: towards.dot(&west).atan2(towards.dot(&centre)) * ARCSEC_PER_RAD,
        y: towards.dot(&north).asin() * ARCSEC_PER_RAD,
    }
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
    let on_plane = axes(&centre).transpose() * towards / towards.dot(&centre);
    let distance = plate_distance_mil(&instrument.optics);
    // `to_plane` is a rotation divided by the distance.
    let shift = to_plane(instrument).transpose() * on_plane * distance.powi(2);
    Ok((instrument.mounting.boresight_mil.vector() + shift).into())
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

/// The direction in which the telescope points; its length is the secant of the angle from the Sun.
fn boresight(sun_on_plate: PlateMil, instrument: &Instrument, sun: &SunPosition) -> Vector3<f64> {
    let centre = sun_direction(sun);
    centre + axes(&centre) * to_plane(instrument) * shift(sun_on_plate, instrument)
}

/// From a shift on the plate (mil) to the plane that touches the sky at the Sun: towards the zenith, and clockwise.
fn to_plane(instrument: &Instrument) -> Matrix2<f64> {
    let (sin, cos) = instrument
        .mounting
        .clocking_deg
        .value
        .to_radians()
        .sin_cos();
    Matrix2::new(-sin, cos, -cos, -sin) / plate_distance_mil(&instrument.optics)
}

/// The axes of that plane as columns: towards the zenith, and clockwise, which is towards larger azimuth.
fn axes(at: &Vector3<f64>) -> Matrix3x2<f64> {
    let (up, clockwise) = tangents(at);
    Matrix3x2::from_columns(&[up, clockwise])
}

/// The direction of a target, by the definition of helioprojective longitude and latitude (Thompson 2006).
fn target_direction(target: HelioprojectiveArcsec, sun: &SunPosition) -> Vector3<f64> {
    let centre = sun_direction(sun);
    let (west, north) = west_and_north(&centre, sun);
    let (sin_x, cos_x) = (target.x / ARCSEC_PER_RAD).sin_cos();
    let (sin_y, cos_y) = (target.y / ARCSEC_PER_RAD).sin_cos();
    centre * (cos_y * cos_x) + west * (cos_y * sin_x) + north * sin_y
}

/// Unit vectors at the Sun's centre to solar west and north.
fn west_and_north(centre: &Vector3<f64>, sun: &SunPosition) -> (Vector3<f64>, Vector3<f64>) {
    let (up, clockwise) = tangents(centre);
    let (sin, cos) = sun.zenith_to_north_deg.to_radians().sin_cos();
    (clockwise * cos - up * sin, up * cos + clockwise * sin)
}

/// Covariance of the pointing in true angle, across and in elevation: what the frame and what the calibration leave.
fn covariances_rad2(
    sun_on_plate: &Estimate<PlateMil>,
    instrument: &Instrument,
    sun: &SunPosition,
    boresight: &Vector3<f64>,
) -> [Matrix2<f64>; 2] {
    let (up, across) = tangents(boresight);
    let seen = Matrix3x2::from_columns(&[across, up]) / boresight.norm();
    let from_plane = seen.transpose() * axes(&sun_direction(sun));
    let from_plate = from_plane * to_plane(instrument);
    let on_plane = to_plane(instrument) * shift(sun_on_plate.position, instrument);
    let mounting = &instrument.mounting;
    let distance = instrument.optics.plate_distance_mm;
    let by_clocking = from_plane
        * Vector2::new(on_plane.y, -on_plane.x)
        * mounting.clocking_deg.sigma.to_radians();
    let by_distance = from_plane * on_plane * (distance.sigma / distance.value);
    let by_boresight = from_plate * mounting.boresight_sigma_mil;
    let [across_arcsec, up_arcsec] = sun.ut1_shift_arcsec;
    let by_ut1 = from_plane * Vector2::new(up_arcsec, across_arcsec) / ARCSEC_PER_RAD;
    [
        from_plate * sun_on_plate.covariance * from_plate.transpose(),
        by_boresight * by_boresight.transpose()
            + by_clocking * by_clocking.transpose()
            + by_distance * by_distance.transpose()
            + by_ut1 * by_ut1.transpose(),
    ]
}

/// 1 sigma per axis: the rms of the two.
fn per_axis(covariance: &Matrix2<f64>) -> f64 {
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
