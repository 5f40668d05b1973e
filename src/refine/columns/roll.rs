//! The columns of the roll camera's history.

use super::{Cell, ColumnRow, TIME_SIGMA, column};
use crate::refine::roll::{RollRow, SmoothedRoll};
use crate::units::Measured;
use jiff::Timestamp;

/// The extension that holds a row for every file of the roll camera.
pub const ROLL: &str = "ROLL";

fn own(row: &RollRow, axis: usize, value: fn(Measured) -> f64) -> Cell {
    Cell::Float(row.angles_deg().map(|angles| value(angles[axis])))
}

fn smoothed(row: &RollRow, value: fn(SmoothedRoll) -> f64) -> Cell {
    Cell::Float(row.smoothed.map(value))
}

fn value(angle: Measured) -> f64 {
    angle.value
}

fn sigma(angle: Measured) -> f64 {
    angle.sigma
}

/// The columns of [`ROLL`].
pub const ROLL_COLUMNS: &[ColumnRow<RollRow>] = &[
    column(
        "FILE",
        "",
        "the frame's file, relative to the archive",
        |r| Cell::Text(r.file.clone()),
    ),
    column("UTC", "", "mid-exposure, UTC, ISO 8601", |r| {
        let text = |utc: Timestamp| format!("{utc:.6}");
        Cell::Text(r.facts.utc().map_or(String::new(), text))
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
    column("UTC_SIGMA_S", "s", TIME_SIGMA, |r| {
        Cell::Float(r.time_sigma_s)
    }),
    column("MONO_S", "s", "mid-exposure on the monotonic clock", |r| {
        Cell::Float(r.facts.monotonic_s)
    }),
    column(
        "FRAMENUM",
        "",
        "number of the frame; -1 where it has none",
        |r| Cell::Integer(r.facts.number.map_or(-1, |number| number as i64)),
    ),
    column(
        "QUALITY",
        "",
        "fine: most of the edge in view is seen; coarse: less; none",
        |r| Cell::Text(r.quality.name().into()),
    ),
    column(
        "REASON",
        "",
        "why there is no roll, and what is odd about the time; empty for the others",
        |r| Cell::Text(r.told_reason()),
    ),
    column(
        "FLAGS",
        "",
        "what stands beside the edge or hides it: clouds, other_edges, no_edge",
        |r| Cell::Text(r.flags.clone()),
    ),
    column("PLACES", "", "places of the edge that are in view", |r| {
        Cell::Integer(r.places as i64)
    }),
    column("AGREEING", "", "those that agree with the nadir", |r| {
        Cell::Integer(r.agreeing as i64)
    }),
    column(
        "ROLL_DEG",
        "deg",
        "roll of the body by this frame alone, right side low positive",
        |r| own(r, 0, value),
    ),
    column("ROLL_SIGMA_DEG", "deg", "1 sigma of ROLL_DEG", |r| {
        own(r, 0, sigma)
    }),
    column(
        "PITCH_DEG",
        "deg",
        "pitch of the body by this frame alone, forward end high positive",
        |r| own(r, 1, value),
    ),
    column("PITCH_SIGMA_DEG", "deg", "1 sigma of PITCH_DEG", |r| {
        own(r, 1, sigma)
    }),
    column(
        "SMOOTHED_ROLL_DEG",
        "deg",
        "the roll as the frames about this one have it",
        |r| smoothed(r, |s| s.roll_deg.value),
    ),
    column(
        "SMOOTHED_ROLL_SIGMA_DEG",
        "deg",
        "1 sigma of SMOOTHED_ROLL_DEG, with what neighbours share",
        |r| smoothed(r, |s| s.roll_deg.sigma),
    ),
    column(
        "ROLL_RATE_DEG_PER_S",
        "deg/s",
        "how fast the roll changes",
        |r| smoothed(r, |s| s.rates_deg_per_s[0]),
    ),
    column(
        "SMOOTHED_PITCH_DEG",
        "deg",
        "the pitch as the frames about this one have it",
        |r| smoothed(r, |s| s.pitch_deg.value),
    ),
    column(
        "SMOOTHED_PITCH_SIGMA_DEG",
        "deg",
        "1 sigma of SMOOTHED_PITCH_DEG, with what neighbours share",
        |r| smoothed(r, |s| s.pitch_deg.sigma),
    ),
    column(
        "PITCH_RATE_DEG_PER_S",
        "deg/s",
        "how fast the pitch changes",
        |r| smoothed(r, |s| s.rates_deg_per_s[1]),
    ),
    column(
        "FLIGHT_ROLL_DEG",
        "deg",
        "BODYROLL of the header: the answer in flight",
        |r| Cell::Float(r.in_flight_deg.map(|[roll, _]| roll)),
    ),
    column(
        "FLIGHT_ROLL_SIGMA_DEG",
        "deg",
        "BODYRLSG of the header",
        |r| Cell::Float(r.in_flight_deg.map(|[_, sigma]| sigma)),
    ),
];
