//! The telescope's offset at a constant rate, for stabilising images: the smoothed path between the frames.

use super::columns::{STABILISATION, STABILISATION_COLUMNS, StabilisationRow, table};
use super::flight::Flight;
use super::follow::is_known;
use crate::smoothing::PathPoint;
use super::output::{OutputError, csv, whole, write_tables};
use super::roll::RollHistory;
use super::sky::Sky;
use crate::archive::Flown;
use crate::geometry::attitude::Direction;
use crate::instrument::Instrument;
use crate::units::{Estimate, Place, PlateMil};
use jiff::Timestamp;
use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;
use std::iter;
use std::path::Path;

/// The table is made in memory.
const MOST_ROWS: f64 = 10e6;
/// A row takes no more bytes in the table.
const ROW_BYTES: usize = 64;
/// Rows that share an ephemeris, whose costly part is done once a second.
const TOGETHER: usize = 1024;

/// A rate that would make too many rows.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "--rate: expected at most {MOST_ROWS} rows, found {rows} ({rate_hz} Hz for {duration_s:.0} s)"
)]
pub struct RateError {
    rows: f64,
    rate_hz: f64,
    duration_s: f64,
}

/// The offset at the multiples of 1 / `rate_hz`, s since 1970, from the first dated frame to the last. Roll is that of the roll camera, where
/// its history is given and near, else the instrument's.
///
/// # Errors
/// A rate that makes more than ten million rows.
pub fn stabilisation(
    flight: &Flight,
    rate_hz: f64,
    instrument: &Instrument,
    sky: &Sky,
    roll: Option<&RollHistory>,
) -> Result<Vec<StabilisationRow>, RateError> {
    let Some((path, first_s)) = flight
        .path
        .as_ref()
        .zip(flight.path_times_s.first().copied())
    else {
        return Ok(Vec::new());
    };
    let last_s = flight.path_times_s.last().copied().unwrap_or(first_s);
    let (first, last) = ((first_s * rate_hz).ceil(), (last_s * rate_hz).floor());
    let rows = last - first + 1.0;
    if rows > MOST_ROWS {
        return Err(RateError {
            rows,
            rate_hz,
            duration_s: last_s - first_s,
        });
    }
    let count = rows.max(0.0) as u64;
    let times_s: Vec<f64> = (0..count).map(|n| (first + n as f64) / rate_hz).collect();
    let since_first: Vec<f64> = times_s.iter().map(|time_s| time_s - first_s).collect();
    let points = path.at(&since_first);
    let nadirs = roll.map(|roll| roll.body_nadirs(&times_s));
    let frames = FramePlaces::of(flight);
    let row = |n: usize, ephemeris: &mut _| {
        let utc = Timestamp::from_nanosecond((times_s[n] * 1e9) as i128).ok()?;
        let sun = points[n].as_ref().and_then(sun_on_plate)?;
        let place = frames.before(times_s[n]).or(sky.place)?;
        let nadir: Option<&Direction> = nadirs.as_ref().and_then(|nadirs| nadirs[n].as_ref());
        sky.offset(sun, utc, place, nadir, instrument, ephemeris)
    };
    let chunks = (0..times_s.len()).into_par_iter().chunks(TOGETHER);
    let rows = chunks.flat_map_iter(|chunk| {
        let mut ephemeris = sky.ephemeris.clone();
        let rows = chunk.into_iter().map(|n| StabilisationRow {
            unix_s: times_s[n],
            offset: row(n, &mut ephemeris),
        });
        rows.collect::<Vec<_>>()
    });
    Ok(rows.collect())
}

/// The Sun on the plate; `None` where the path is a guess.
fn sun_on_plate(point: &PathPoint) -> Option<Estimate<PlateMil>> {
    is_known(point).then(|| Estimate {
        position: Vector2::from(point.place).into(),
        covariance: Matrix2::from_diagonal(&point.variance.into()),
    })
}

/// Where the frames that say so were taken, in the order of time.
struct FramePlaces(Vec<(f64, Place)>);

impl FramePlaces {
    fn of(flight: &Flight) -> Self {
        let frames = flight.rows.iter().zip(&flight.places);
        Self(
            frames
                .filter_map(|(row, place)| Some((row.unix_s()?, (*place)?)))
                .collect(),
        )
    }

    /// That of the last frame before a time.
    fn before(&self, time_s: f64) -> Option<Place> {
        let later = self.0.partition_point(|(taken_s, _)| *taken_s <= time_s);
        Some(self.0.get(later.checked_sub(1)?)?.1)
    }
}

/// Writes `stabilisation.fits` and `stabilisation.csv` of a flight to a folder.
///
/// # Errors
/// A file that cannot be written.
pub fn write_stabilisation(
    folder: &Path,
    rows: &[StabilisationRow],
    flown: &Flown,
) -> Result<(), OutputError> {
    let made = iter::once_with(|| table(STABILISATION, STABILISATION_COLUMNS, rows));
    let path = folder.join("stabilisation.fits");
    write_tables(&path, flown, rows.len() * ROW_BYTES, made)?;
    whole(&folder.join("stabilisation.csv"), |file| {
        csv(file, STABILISATION_COLUMNS, rows)
    })
}
