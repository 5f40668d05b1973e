//! The columns of the history itself, a row for every input file.

use super::{Cell, ColumnRow, TIME_SIGMA, column};
use crate::pointing::body_roll_deg;
use crate::refine::row::{Row, SkyRow};

fn sky(row: &Row, value: impl Fn(&SkyRow) -> f64) -> Cell {
    Cell::Float(row.sky.as_ref().map(value))
}

fn sky_some(row: &Row, value: impl Fn(&SkyRow) -> Option<f64>) -> Cell {
    Cell::Float(row.sky.as_ref().and_then(value))
}

fn sigma(row: &Row, axis: usize) -> Cell {
    Cell::Float(row.sun.map(|sun| sun.sigma()[axis]))
}

fn part(pair: Option<[f64; 2]>, axis: usize) -> Cell {
    Cell::Float(pair.map(|pair| pair[axis]))
}

/// The extension that holds a row for every input file.
pub const ASPECT: &str = "ASPECT";

/// The columns of [`ASPECT`].
pub const ASPECT_COLUMNS: &[ColumnRow<Row>] = &[
    column(
        "FILE",
        "",
        "the frame's file, relative to the archive",
        |r| Cell::Text(r.file.clone()),
    ),
    column("UTC", "", "mid-exposure, UTC, ISO 8601", |r| {
        Cell::Text(r.utc().map_or(String::new(), |utc| format!("{utc:.6}")))
    }),
    column("UNIX_S", "s", "mid-exposure, UTC, since 1970-01-01", |r| {
        Cell::Float(r.unix_s())
    }),
    column(
        "UTC_CORRECTION_S",
        "s",
        "what was added to the header's time, where others contradict it",
        |r| Cell::Float(r.utc_correction_s.map(|shift| shift.value)),
    ),
    column(
        "UTC_CORRECTION_SIGMA_S",
        "s",
        "1 sigma of UTC_CORRECTION_S",
        |r| Cell::Float(r.utc_correction_s.map(|shift| shift.sigma)),
    ),
    column("UTC_SIGMA_S", "s", TIME_SIGMA, |r| {
        Cell::Float(r.time_sigma_s)
    }),
    column("MONO_S", "s", "mid-exposure on the monotonic clock", |r| {
        Cell::Float(r.monotonic_s)
    }),
    column(
        "FRAMENUM",
        "",
        "number of the frame; -1 where it has none",
        |r| Cell::Integer(r.number.map_or(-1, |number| number as i64)),
    ),
    column(
        "SUN_X_MIL",
        "mil",
        "the Sun's centre on the plate, unsmoothed",
        |r| Cell::Float(r.sun.map(|sun| sun.position.x)),
    ),
    column(
        "SUN_Y_MIL",
        "mil",
        "the Sun's centre on the plate, unsmoothed",
        |r| Cell::Float(r.sun.map(|sun| sun.position.y)),
    ),
    column(
        "SIGMA_X_MIL",
        "mil",
        "1 sigma of SUN_X_MIL, of limb and mapping together",
        |r| sigma(r, 0),
    ),
    column(
        "SIGMA_Y_MIL",
        "mil",
        "1 sigma of SUN_Y_MIL, of limb and mapping together",
        |r| sigma(r, 1),
    ),
    column(
        "COV_XY_MIL2",
        "mil2",
        "covariance of SUN_X_MIL and SUN_Y_MIL",
        |r| Cell::Float(r.sun.map(|sun| sun.covariance.m12)),
    ),
    column("QUALITY", "", "fine, coarse or none", |r| {
        Cell::Text(r.quality.name().into())
    }),
    column(
        "REASON",
        "",
        "why the frame is not fine, or what is odd about it; empty for the others",
        |r| Cell::Text(r.reason()),
    ),
    column("NMARKS", "", "marks that were read", |r| {
        Cell::Integer(r.own.marks as i64)
    }),
    column(
        "LIMB_PART",
        "",
        "part of the limb that was seen, 0 to 1",
        |r| Cell::Float(r.limb_part),
    ),
    column("RADIUS_MIL", "mil", "the disc's radius on the plate", |r| {
        Cell::Float(r.disc.map(|disc| disc.radius_mil.value))
    }),
    column(
        "RADIUS_SIGMA_MIL",
        "mil",
        "1 sigma of RADIUS_MIL, by the points of the limb",
        |r| Cell::Float(r.disc.map(|disc| disc.radius_mil.sigma)),
    ),
    column(
        "RADIUS_EXPECTED_MIL",
        "mil",
        "the radius by ephemeris and plate distance",
        |r| Cell::Float(r.expected_radius_mil),
    ),
    column(
        "OFFSET_AZ_DEG",
        "deg",
        "azimuth, pointing minus target",
        |r| sky_some(r, |s| Some(s.offset_deg?[0])),
    ),
    column(
        "OFFSET_EL_DEG",
        "deg",
        "elevation, pointing minus target",
        |r| sky_some(r, |s| Some(s.offset_deg?[1])),
    ),
    column(
        "OFFSET_XEL_DEG",
        "deg",
        "true angle across, pointing from target, to larger azimuth",
        |r| sky_some(r, |s| Some(s.offset_deg?[2])),
    ),
    column(
        "OFFSET_SIGMA_DEG",
        "deg",
        "1 sigma per axis of true angle, of this frame",
        |r| sky_some(r, |s| Some(s.sigma_deg?[0])),
    ),
    column(
        "OFFSET_CAL_SIGMA_DEG",
        "deg",
        "the same of the calibration, alike in all frames",
        |r| sky_some(r, |s| Some(s.sigma_deg?[1])),
    ),
    column(
        "POINTING_AZ_DEG",
        "deg",
        "azimuth of the telescope, from north through east",
        |r| sky(r, |s| s.azimuth_deg),
    ),
    column(
        "POINTING_EL_DEG",
        "deg",
        "elevation of the telescope, without refraction",
        |r| sky(r, |s| s.elevation_deg),
    ),
    column(
        "BORESIGHT_HPLN_ARCSEC",
        "arcsec",
        "helioprojective longitude of the boresight, to solar west",
        |r| sky(r, |s| s.helioprojective_arcsec[0]),
    ),
    column(
        "BORESIGHT_HPLT_ARCSEC",
        "arcsec",
        "helioprojective latitude of the boresight, to solar north",
        |r| sky(r, |s| s.helioprojective_arcsec[1]),
    ),
    column(
        "TELESCOPE_ROLL_DEG",
        "deg",
        "roll about the boresight that the offsets rest on: by the horizon where it was seen, else as stated",
        |r| sky(r, |s| s.roll_deg.value),
    ),
    column(
        "TELESCOPE_ROLL_SIGMA_DEG",
        "deg",
        "1 sigma of TELESCOPE_ROLL_DEG",
        |r| sky(r, |s| s.roll_deg.sigma),
    ),
    column(
        "BODY_ROLL_DEG",
        "deg",
        "roll of the body by the horizon, smoothed, right side low positive",
        |r| Cell::Float(r.body_nadir.map(|nadir| body_roll_deg(&nadir).value)),
    ),
    column(
        "BODY_ROLL_SIGMA_DEG",
        "deg",
        "1 sigma of BODY_ROLL_DEG",
        |r| Cell::Float(r.body_nadir.map(|nadir| body_roll_deg(&nadir).sigma)),
    ),
    column("SUN_AZ_DEG", "deg", "azimuth of the Sun", |r| {
        sky(r, |s| s.sun_azimuth_deg)
    }),
    column(
        "SUN_EL_DEG",
        "deg",
        "elevation of the Sun, without refraction",
        |r| sky(r, |s| s.sun_elevation_deg),
    ),
    column(
        "CENTRE_X_PX",
        "pixel",
        "where the flight's mapping puts the plate's centre, first pixel is 0",
        |r| Cell::Float(r.mapping.map(|m| m.centre_px[0].value)),
    ),
    column(
        "CENTRE_SIGMA_X_PX",
        "pixel",
        "1 sigma of CENTRE_X_PX",
        |r| Cell::Float(r.mapping.map(|m| m.centre_px[0].sigma)),
    ),
    column(
        "CENTRE_Y_PX",
        "pixel",
        "where the flight's mapping puts the plate's centre, first pixel is 0",
        |r| Cell::Float(r.mapping.map(|m| m.centre_px[1].value)),
    ),
    column(
        "CENTRE_SIGMA_Y_PX",
        "pixel",
        "1 sigma of CENTRE_Y_PX",
        |r| Cell::Float(r.mapping.map(|m| m.centre_px[1].sigma)),
    ),
    column(
        "ROTATION_DEG",
        "deg",
        "rotation of the flight's mapping at the plate's centre, from +x towards +y",
        |r| Cell::Float(r.mapping.map(|m| m.there.rotation_deg.value)),
    ),
    column(
        "ROTATION_SIGMA_DEG",
        "deg",
        "1 sigma of ROTATION_DEG",
        |r| Cell::Float(r.mapping.map(|m| m.there.rotation_deg.sigma)),
    ),
    column(
        "SCALE_MIL_PER_PX",
        "mil/pixel",
        "scale of the flight's mapping at the plate's centre",
        |r| Cell::Float(r.mapping.map(|m| m.there.scale_mil_per_px.value)),
    ),
    column(
        "SCALE_SIGMA_MIL_PER_PX",
        "mil/pixel",
        "1 sigma of SCALE_MIL_PER_PX",
        |r| Cell::Float(r.mapping.map(|m| m.there.scale_mil_per_px.sigma)),
    ),
    column(
        "JUMP_PX",
        "pixel",
        "size of the mapping's jump at this frame",
        |r| Cell::Float(r.jump_px),
    ),
    column("TEMPERATURE_C", "degC", "temperature of the camera", |r| {
        Cell::Float(r.temperature_c)
    }),
    column(
        "OWN_QUALITY",
        "",
        "quality of the frame by itself: fine, coarse or none",
        |r| Cell::Text(r.own.quality.name().into()),
    ),
    column(
        "OWN_X_MIL",
        "mil",
        "the Sun on the plate by this frame alone",
        |r| part(r.own.sun_mil, 0),
    ),
    column(
        "OWN_Y_MIL",
        "mil",
        "the Sun on the plate by this frame alone",
        |r| part(r.own.sun_mil, 1),
    ),
    column("OWN_SIGMA_X_MIL", "mil", "1 sigma of OWN_X_MIL", |r| {
        part(r.own.sigma_mil, 0)
    }),
    column("OWN_SIGMA_Y_MIL", "mil", "1 sigma of OWN_Y_MIL", |r| {
        part(r.own.sigma_mil, 1)
    }),
    column(
        "SUN_X_PX",
        "pixel",
        "the disc's centre on the sensor by this frame alone, first pixel is 0",
        |r| part(r.own.sun_px, 0),
    ),
    column(
        "SUN_Y_PX",
        "pixel",
        "the disc's centre on the sensor by this frame alone, first pixel is 0",
        |r| part(r.own.sun_px, 1),
    ),
    column(
        "FLIGHT_X_MIL",
        "mil",
        "SUNMIL-X of the header: the answer in flight",
        |r| part(r.in_flight.sun_mil, 0),
    ),
    column(
        "FLIGHT_Y_MIL",
        "mil",
        "SUNMIL-Y of the header: the answer in flight",
        |r| part(r.in_flight.sun_mil, 1),
    ),
    column("FLIGHT_SIGMA_X_MIL", "mil", "SUNMILSX of the header", |r| {
        part(r.in_flight.sigma_mil, 0)
    }),
    column("FLIGHT_SIGMA_Y_MIL", "mil", "SUNMILSY of the header", |r| {
        part(r.in_flight.sigma_mil, 1)
    }),
    column(
        "FLIGHT_OFFSET_AZ_DEG",
        "deg",
        "OFFSETAZ of the header, or CTL_AZIM of HEROES",
        |r| part(r.in_flight.offset_deg, 0),
    ),
    column(
        "FLIGHT_OFFSET_EL_DEG",
        "deg",
        "OFFSETEL of the header, or CTL_ELEV of HEROES",
        |r| part(r.in_flight.offset_deg, 1),
    ),
    column(
        "FLIGHT_ROLL_DEG",
        "deg",
        "BODYROLL of the header: the body's roll in flight",
        |r| part(r.in_flight.roll_deg, 0),
    ),
    column(
        "FLIGHT_ROLL_SIGMA_DEG",
        "deg",
        "BODYRLSG of the header",
        |r| part(r.in_flight.roll_deg, 1),
    ),
    column("FLIGHT_QUALITY", "", "QUALITY of the header", |r| {
        Cell::Text(r.in_flight.quality.clone().unwrap_or_default())
    }),
];
