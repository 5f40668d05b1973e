//! Converts the Sun on the plate to the telescope's offset from its target, and back.
//!
//! The Sun's shift from the boresight on the plate is an angle in a direction, relative to the telescope or to the Sun as stated in the
//! instrument's `mounting.directions`: see [`Directions`](crate::instrument::Directions). If it is relative to the telescope, the
//! telescope's [`Roll`] rotates it.
//! The target has helioprojective coordinates relative to the Sun, whose north is rotated from the zenith by the angle of the
//! ephemeris.
//! All computations are on the sphere, without small-angle approximations.

mod alignment;
mod attitude;
mod refusal;
mod target;

pub use alignment::{Roll, body_nadir, body_pitch_deg, body_roll_deg};
pub use attitude::{TelescopeAttitude, calibration_rad2, telescope_attitude};
pub use refusal::PointingError;
pub use target::{Feature, Target};

use crate::aspect::{Solution, Stage, Stopped};
use crate::geometry::attitude::Direction;
use crate::instrument::Instrument;
use crate::sky::sphere::{angles_deg, direction, separation_rad, tangents};
use crate::sky::{Ephemeris, SunPosition};
use crate::units::{ARCSEC_PER_RAD, Estimate, Measured, Place, PlateMil};
use alignment::{Alignment, gnomonic};
use attitude::{Errors, across_and_up};
use jiff::Timestamp;
use nalgebra::{Matrix2, Matrix3, UnitVector3, Vector3};
use refusal::NoOffset;
use serde::{Deserialize, Serialize};

/// Above this elevation a difference of azimuths is ill-conditioned.
const HIGHEST_ELEVATION_DEG: f64 = 85.0;

/// A position relative to the Sun's centre as seen by the observer: x towards solar west, y towards solar north.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct HelioprojectiveArcsec {
    pub x: f64,
    pub y: f64,
}

impl HelioprojectiveArcsec {
    /// From a direction in the axes about the Sun: to its centre, to solar west and north (Thompson 2006).
    pub fn of_direction(v: &Vector3<f64>) -> Self {
        Self {
            x: v.y.atan2(v.x) * ARCSEC_PER_RAD,
            y: v.z.asin() * ARCSEC_PER_RAD,
        }
    }

    /// The unit vector towards it in these axes.
    pub fn direction(self) -> Vector3<f64> {
        let [longitude_deg, latitude_deg] = [self.x, self.y].map(|arcsec| arcsec / 3600.0);
        direction(longitude_deg, latitude_deg)
    }
}

/// A direction in the observer's horizon: azimuth from north through east, elevation without refraction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Horizontal {
    pub azimuth_deg: f64,
    pub elevation_deg: f64,
}

/// The telescope's pointing, minus the target.
/// There is no offset in roll: one Sun determines two axes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Offset {
    /// The difference of the azimuths (no cos(elevation) factor), -180 to 180, as used by the HEROES controller.
    pub azimuth_deg: f64,
    /// The difference of the elevations.
    pub elevation_deg: f64,
    /// The true angle of the pointing from the target's vertical circle, positive towards larger azimuth; near the target
    /// the difference of azimuths times the cosine of the elevation.
    pub cross_elevation_deg: f64,
    /// 1 sigma per axis of true angle on the sky, the rms of the two axes of `covariance_deg2`.
    pub sigma_deg: f64,
    /// Uncertainty from this frame, in true angle: across (towards larger azimuth) and in elevation. It includes the stated sigma of the
    /// mapping, if that was borrowed, and that of the roll, if it was measured.
    pub covariance_deg2: Matrix2<f64>,
    /// Uncertainty of the pointing from the calibration, the same in every frame: boresight, clocking, plate distance and stated roll,
    /// with the sigmas stated by the instrument, and UT1 after the end of the table of Earth orientation, which moves Sun and target
    /// alike. It is not part of `covariance_deg2`.
    pub calibration_deg2: Matrix2<f64>,
    /// The telescope's roll that the offset uses.
    pub roll: Roll,
}

impl Offset {
    /// 1 sigma per axis from the calibration; `sigma_deg` is that from the frame.
    pub fn calibration_sigma_deg(&self) -> f64 {
        per_axis(&self.calibration_deg2)
    }
}

/// The offset of a solved frame, with the nadir in the axes of the body that carries the telescope (see [`Roll::by_nadir`]) if it was
/// observed. `None` if the frame has no Sun, or its time or place is not known. If sky or sphere give no result (a date out of range, too
/// near the zenith, a target behind the limb), the solution gets the reason, unless an earlier stage has set one, and keeps its quality.
pub fn offset_of(
    solution: &mut Solution,
    utc: Option<Timestamp>,
    place: Option<Place>,
    target: &Target,
    nadir: Option<&Direction>,
    instrument: &Instrument,
    ephemeris: &mut Ephemeris,
) -> Option<Offset> {
    let sun_plate = solution.aspect?.sun_plate;
    let (utc, place) = (utc?, place?);
    let found = ephemeris
        .sun(utc, place)
        .map_err(NoOffset::from)
        .and_then(|sun| {
            let target = target.at(utc, &sun)?;
            let roll = match nadir {
                Some(nadir) => roll_by_nadir(nadir, sun_plate.position, instrument, &sun),
                None => Roll::Stated,
            };
            Ok(offset(sun_plate, roll, instrument, &sun, target)?)
        });
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

/// The telescope's roll from the nadir in the axes of the body that carries it ([`Roll::by_nadir`]). The elevation that it needs depends
/// on the roll only slightly. The stated roll is used if the body gives none, near the zenith.
pub fn roll_by_nadir(
    nadir: &Direction,
    sun_on_plate: PlateMil,
    instrument: &Instrument,
    sun: &SunPosition,
) -> Roll {
    const ROUNDS: usize = 3;
    let found = (0..ROUNDS).try_fold(Roll::Stated, |roll, _| {
        let towards = pointing(sun_on_plate, roll, instrument, sun).ok()?;
        Roll::by_nadir(nadir, towards.elevation_deg)
    });
    found.unwrap_or(Roll::Stated)
}

/// The telescope's offset from a target, with the uncertainty from the Sun's position on the plate and from the calibration.
///
/// # Errors
/// [`PointingError::NearZenith`] if the pointing or the target is above 85 deg;
/// [`PointingError::NoBoresight`] if no pointing near the zenith gives this position of the Sun.
pub fn offset(
    sun_on_plate: Estimate<PlateMil>,
    roll: Roll,
    instrument: &Instrument,
    sun: &SunPosition,
    target: HelioprojectiveArcsec,
) -> Result<Offset, PointingError> {
    let boresight = boresight(sun_on_plate.position, roll, instrument, sun)?;
    let difference = difference(&boresight, &target_direction(target, sun))?;
    let errors = Errors::new(&sun_on_plate, roll, instrument, sun)?;
    let covariance_deg2 = across_and_up(&errors.frame_rad2) * 1_f64.to_degrees().powi(2);
    let calibration = across_and_up(&errors.calibration_rad2) + errors.ut1_rad2;
    Ok(Offset {
        azimuth_deg: difference.azimuth_deg,
        elevation_deg: difference.elevation_deg,
        cross_elevation_deg: difference.cross_elevation_deg,
        sigma_deg: per_axis(&covariance_deg2),
        covariance_deg2,
        calibration_deg2: calibration * 1_f64.to_degrees().powi(2),
        roll,
    })
}

/// Difference of two directions, defined as in [`Offset`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    pub azimuth_deg: f64,
    pub elevation_deg: f64,
    pub cross_elevation_deg: f64,
}

/// A telescope's pointing minus its target: unit vectors towards north, east and up.
///
/// # Errors
/// [`PointingError::NearZenith`] if one of them is above 85 deg.
pub fn difference(
    boresight: &Vector3<f64>,
    target: &Vector3<f64>,
) -> Result<Difference, PointingError> {
    let pointing = away_from_zenith(boresight)?;
    let target = away_from_zenith(target)?;
    let azimuth_deg = wrapped_deg(pointing.azimuth_deg - target.azimuth_deg);
    let across = pointing.elevation_deg.to_radians().cos() * azimuth_deg.to_radians().sin();
    Ok(Difference {
        azimuth_deg,
        elevation_deg: pointing.elevation_deg - target.elevation_deg,
        cross_elevation_deg: across.asin().to_degrees(),
    })
}

/// The telescope's pointing for a position of the Sun on the plate.
///
/// # Errors
/// [`PointingError::NoBoresight`] if no pointing near the zenith gives this position of the Sun.
pub fn pointing(
    sun_on_plate: PlateMil,
    roll: Roll,
    instrument: &Instrument,
    sun: &SunPosition,
) -> Result<Horizontal, PointingError> {
    Ok(horizontal(&boresight(sun_on_plate, roll, instrument, sun)?))
}

/// The telescope's pointing relative to the Sun's centre, for a position of the Sun on the plate; in the coordinates of a
/// [`Target`].
///
/// # Errors
/// Those of [`pointing`].
pub fn helioprojective(
    sun_on_plate: PlateMil,
    roll: Roll,
    instrument: &Instrument,
    sun: &SunPosition,
) -> Result<HelioprojectiveArcsec, PointingError> {
    let towards = boresight(sun_on_plate, roll, instrument, sun)?;
    let centre = sun_direction(sun);
    let (west, north) = west_and_north(&centre, sun);
    let axes = Matrix3::from_columns(&[centre, west, north]);
    Ok(HelioprojectiveArcsec::of_direction(&axes.tr_mul(&towards)))
}

/// Plate position of a point relative to the Sun, with the Sun's centre at `sun_on_plate`: in the Sun's image, the tangent plane of the
/// sky at its centre.
///
/// # Errors
/// Those of [`pointing`].
pub fn place_on_plate(
    place: HelioprojectiveArcsec,
    sun_on_plate: PlateMil,
    roll: Roll,
    instrument: &Instrument,
    sun: &SunPosition,
) -> Result<PlateMil, PointingError> {
    let (alignment, centre) = (Alignment::new(instrument, roll), sun_direction(sun));
    let turn = alignment.turn_from_sun(&alignment.on_plane(sun_on_plate), &centre)?;
    let from_centre = turn * gnomonic(&centre, &target_direction(place, sun));
    // The image is inverted: the Sun moves opposite to the telescope.
    Ok((sun_on_plate.vector() - alignment.to_shift(&from_centre)).into())
}

/// The Sun's position on the plate for a pointing of the telescope.
///
/// # Errors
/// [`PointingError::BehindTheLens`] when the Sun is 90 deg or more away.
pub fn sun_on_plate(
    pointing: Horizontal,
    roll: Roll,
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
    let alignment = Alignment::new(instrument, roll);
    Ok(alignment.on_plate(&alignment.towards(&towards, &centre)))
}

/// The Sun in the telescope's own axes: forward along the boresight, right and down.
pub fn sun_in_telescope(sun_on_plate: PlateMil, instrument: &Instrument) -> UnitVector3<f64> {
    let level = Roll::Measured(Measured::new(0.0, 0.0));
    // Vector from the Sun to the boresight.
    let [up, right] = Alignment::new(instrument, level)
        .on_plane(sun_on_plate)
        .into();
    UnitVector3::new_normalize(Vector3::new(1.0, -right, up))
}

/// The same with its uncertainty: the rms of the two axes of the Sun's position on the plate.
pub fn measured_sun_in_telescope(
    sun_on_plate: &Estimate<PlateMil>,
    instrument: &Instrument,
) -> Direction {
    let [sx, sy] = sun_on_plate.sigma();
    let sigma_mil = ((sx * sx + sy * sy) / 2.0).sqrt();
    let sigma_rad = sigma_mil * instrument.optics.arcsec_per_mil() / ARCSEC_PER_RAD;
    Direction::new(
        sun_in_telescope(sun_on_plate.position, instrument),
        sigma_rad,
    )
}

/// The Sun's position on the plate for an offset of the telescope from its target: the inverse of
/// [`offset`].
///
/// # Errors
/// Those of [`offset`] for the target, and those of [`sun_on_plate`].
pub fn sun_on_plate_for(
    offset: &Offset,
    roll: Roll,
    instrument: &Instrument,
    sun: &SunPosition,
    target: HelioprojectiveArcsec,
) -> Result<PlateMil, PointingError> {
    let target = away_from_zenith(&target_direction(target, sun))?;
    let pointing = Horizontal {
        azimuth_deg: target.azimuth_deg + offset.azimuth_deg,
        elevation_deg: target.elevation_deg + offset.elevation_deg,
    };
    sun_on_plate(pointing, roll, instrument, sun)
}

/// 1 sigma of the rotation of directions on the plate, deg: from the clocking, and from the roll if it rotates them.
pub fn turn_sigma_deg(roll: Roll, instrument: &Instrument) -> f64 {
    let clocking = instrument.mounting.clocking_deg;
    let roll_sigma_deg = Alignment::new(instrument, roll).roll_sigma_deg;
    clocking.sigma.hypot(roll_sigma_deg)
}

/// The telescope's pointing, a unit vector.
fn boresight(
    sun_on_plate: PlateMil,
    roll: Roll,
    instrument: &Instrument,
    sun: &SunPosition,
) -> Result<Vector3<f64>, PointingError> {
    let alignment = Alignment::new(instrument, roll);
    alignment.boresight(&alignment.on_plane(sun_on_plate), &sun_direction(sun))
}

/// The direction of a target, towards north, east and up, by the definition of helioprojective longitude and latitude (Thompson 2006).
pub fn target_direction(target: HelioprojectiveArcsec, sun: &SunPosition) -> Vector3<f64> {
    let centre = sun_direction(sun);
    let (west, north) = west_and_north(&centre, sun);
    Matrix3::from_columns(&[centre, west, north]) * target.direction()
}

/// The direction of solar north at the Sun's centre, towards north, east and up.
pub fn solar_north(sun: &SunPosition) -> Vector3<f64> {
    west_and_north(&sun_direction(sun), sun).1
}

/// Unit vectors at the Sun's centre to solar west and north.
fn west_and_north(centre: &Vector3<f64>, sun: &SunPosition) -> (Vector3<f64>, Vector3<f64>) {
    let (up, clockwise) = tangents(centre);
    let (sin, cos) = sun.zenith_to_north_deg.to_radians().sin_cos();
    (clockwise * cos - up * sin, up * cos + clockwise * sin)
}

/// 1 sigma per axis: the rms of the two.
fn per_axis(covariance: &Matrix2<f64>) -> f64 {
    (covariance.trace().max(0.0) / 2.0).sqrt()
}

/// The direction to the Sun's centre, towards north, east and up.
pub fn sun_direction(sun: &SunPosition) -> Vector3<f64> {
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
