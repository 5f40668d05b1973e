//! The telescope's offset at a constant rate, for stabilising images, from the pointing between the frames.

use super::history::History;
use crate::geometry::earth::geodetic;
use crate::observe::JournalError;
use crate::pointing::{Difference, difference};
use crate::pointing_history::{Invalid, Pointed, PointingHistory};
use crate::sky::Ephemeris;
use crate::units::{ARCSEC_PER_RAD, Place};
use jiff::Timestamp;
use nalgebra::Matrix2;
use rayon::prelude::*;

/// Limit of the table's rows: it is built in memory.
const MOST_ROWS: f64 = 10e6;
/// Rows that share an ephemeris, whose costly part is done once a second.
const TOGETHER: usize = 1024;

/// The telescope's offset at a moment between frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StabilisationRow {
    pub unix_s: f64,
    /// None if the pointing or the target is not known.
    pub offset: Option<StableOffset>,
    /// Whether the offset is known and nothing contradicts it. A slew or a large sigma (which is given) does not invalidate it.
    pub is_valid: bool,
}

/// An offset with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StableOffset {
    pub difference: Difference,
    /// Random part, in true angle: across (towards larger azimuth) and in elevation.
    pub covariance_deg2: Matrix2<f64>,
}

/// Why there is no table.
#[derive(Debug, thiserror::Error)]
pub enum RateError {
    #[error(
        "--rate: expected at most {MOST_ROWS} rows, found {rows} ({rate_hz} Hz for {duration_s:.0} s)"
    )]
    TooManyRows {
        rows: f64,
        rate_hz: f64,
        duration_s: f64,
    },
    #[error(transparent)]
    Journal(#[from] JournalError),
}

/// The offset at the multiples of 1 / `rate_hz`, s since 1970, from the first dated frame to the last.
///
/// # Errors
/// If the rate makes more than ten million rows.
pub fn stabilisation(
    history: &History,
    pointing: &PointingHistory,
    rate_hz: f64,
) -> Result<Vec<StabilisationRow>, RateError> {
    let Some((_, [first_s, last_s])) = history.path_times_s() else {
        return Ok(Vec::new());
    };
    let (first, last) = ((first_s * rate_hz).ceil(), (last_s * rate_hz).floor());
    let rows = last - first + 1.0;
    if rows > MOST_ROWS {
        return Err(RateError::TooManyRows {
            rows,
            rate_hz,
            duration_s: last_s - first_s,
        });
    }
    let chunks = (0..rows.max(0.0) as usize).into_par_iter().chunks(TOGETHER);
    let rows = chunks.flat_map_iter(|chunk| {
        let mut ephemeris = history.sky().ephemeris.clone();
        let rows = chunk.into_iter().map(|n| {
            let unix_s = (first + n as f64) / rate_hz;
            let pointed = pointing.at(unix_s);
            let place = pointing.position_m(unix_s);
            let place = place.and_then(|at_m| geodetic(&at_m));
            let offset = offset(history, &pointed, unix_s, place, &mut ephemeris);
            StabilisationRow {
                unix_s,
                offset,
                is_valid: offset.is_some() && pointed.invalid != Some(Invalid::Contradicted),
            }
        });
        rows.collect::<Vec<_>>()
    });
    Ok(rows.collect())
}

/// The offset from the history's target.
fn offset(
    history: &History,
    pointed: &Pointed,
    unix_s: f64,
    place: Option<Place>,
    ephemeris: &mut Ephemeris,
) -> Option<StableOffset> {
    let line_of_sight = pointed.line_of_sight.as_ref()?;
    let utc = Timestamp::from_nanosecond((unix_s * 1e9) as i128).ok()?;
    let sun = ephemeris.sun(utc, place?).ok()?;
    let target = history.sky().target.at(utc, &sun).ok()?;
    let (boresight, target) = (line_of_sight.boresight(), line_of_sight.direction(target));
    let difference = difference(&boresight, &target).ok()?;
    // Rotate from right and up of the telescope to across and up of the horizon.
    let (sin, cos) = line_of_sight.roll_deg.to_radians().sin_cos();
    let turn = Matrix2::new(cos, sin, -sin, cos);
    let random_arcsec2 = line_of_sight.random_arcsec2.fixed_view::<2, 2>(0, 0);
    let per_deg2 = (1_f64.to_degrees() / ARCSEC_PER_RAD).powi(2);
    Some(StableOffset {
        difference,
        covariance_deg2: turn * random_arcsec2 * turn.transpose() * per_deg2,
    })
}
