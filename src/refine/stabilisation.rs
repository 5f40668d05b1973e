//! The telescope's offset at a constant rate, for stabilising images: the smoothed path between the frames.

use super::history::History;
use super::path::is_known;
use super::roll::RollHistory;
use crate::geometry::attitude::Direction;
use crate::observe::JournalError;
use crate::pointing::Offset;
use crate::smoothing::PathPoint;
use crate::units::{Estimate, Place, PlateMil};
use jiff::Timestamp;
use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

/// The table is made in memory.
const MOST_ROWS: f64 = 10e6;
/// Rows that share an ephemeris, whose costly part is done once a second.
const TOGETHER: usize = 1024;

/// The telescope's offset at a moment between frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StabilisationRow {
    pub unix_s: f64,
    /// None where the path, the place or the target is not known.
    pub offset: Option<Offset>,
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

/// The offset at the multiples of 1 / `rate_hz`, s since 1970, from the first dated frame to the last. Roll is that of the roll camera, where
/// its history is given and near, else the instrument's.
///
/// # Errors
/// A rate that makes more than ten million rows; a journal that cannot be read.
pub fn stabilisation(
    history: &History,
    rate_hz: f64,
    roll: Option<&RollHistory>,
) -> Result<Vec<StabilisationRow>, RateError> {
    let Some((path, (first_s, [_, last_s]))) = history.path().zip(history.path_times_s()) else {
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
    let (sky, instrument) = (history.sky(), history.instrument());
    let count = rows.max(0.0) as u64;
    let times_s: Vec<f64> = (0..count).map(|n| (first + n as f64) / rate_hz).collect();
    let since_first: Vec<f64> = times_s.iter().map(|time_s| time_s - first_s).collect();
    let points = path.at(&since_first);
    let nadirs = roll.map(|roll| roll.body_nadirs(&times_s));
    let places = history.places()?;
    let row = |n: usize, ephemeris: &mut _| {
        let utc = Timestamp::from_nanosecond((times_s[n] * 1e9) as i128).ok()?;
        let sun = points[n].as_ref().and_then(sun_on_plate)?;
        let place = place_before(&places, times_s[n]).or(sky.place)?;
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

/// The place of the last frame before a time.
fn place_before(places: &[(f64, Place)], time_s: f64) -> Option<Place> {
    let later = places.partition_point(|(taken_s, _)| *taken_s <= time_s);
    Some(places.get(later.checked_sub(1)?)?.1)
}
