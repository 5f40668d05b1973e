//! One file of the roll camera in the history.

use super::super::record::Grade;
use super::super::times::{TIME_SIGMA, Timing};
use super::HorizonRecord;
use crate::clock::utc_microseconds;
use crate::columns::{Column, float, integer, text};
use crate::geometry::attitude::Direction;
use crate::pointing::{body_pitch_deg, body_roll_deg};
use crate::units::Measured;
use jiff::Timestamp;
use nalgebra::Matrix3;

/// One file's row, assembled from its frame's record and the flight's results.
#[derive(Debug, Clone, PartialEq)]
pub struct RollRow {
    pub file: String,
    /// The file of which this one's frame is a copy.
    pub copy_of: Option<String>,
    /// Mid-exposure, ns since 1970.
    pub utc_ns: Option<i64>,
    pub timing: Timing,
    /// Record of the frame on its own; none of a file without a frame.
    pub own: Option<HorizonRecord>,
    pub quality: Grade,
    /// The reason why there is no nadir; empty if there is none to state.
    pub reason: String,
    /// The nadir in the body's axes, from this frame alone.
    pub nadir: Option<Direction>,
    pub smoothed: Option<SmoothedRoll>,
}

/// Smoothed roll and pitch of the body at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmoothedRoll {
    pub roll_deg: Measured,
    pub pitch_deg: Measured,
    /// Rates of roll and pitch.
    pub rates_deg_per_s: [f64; 2],
}

impl RollRow {
    pub fn utc(&self) -> Option<Timestamp> {
        Timestamp::from_nanosecond(self.utc_ns?.into()).ok()
    }

    /// Seconds since 1970.
    pub fn unix_s(&self) -> Option<f64> {
        Some(self.utc_ns? as f64 / 1e9)
    }

    /// Roll and pitch from this frame alone.
    pub fn angles_deg(&self) -> Option<[Measured; 2]> {
        let nadir = self.nadir.as_ref()?;
        Some([body_roll_deg(nadir), body_pitch_deg(nadir)])
    }

    /// The body's roll in flight, and 1 sigma.
    pub fn in_flight_deg(&self) -> Option<[f64; 2]> {
        self.own.as_ref()?.in_flight_deg
    }

    /// The reason why there is no roll, and the flag of the time; empty if there is nothing to state.
    pub fn full_reason(&self) -> String {
        let own = (!self.reason.is_empty()).then(|| self.reason.clone());
        let flag = self.timing.flag.map(|flag| format!("refine: {flag}"));
        own.into_iter().chain(flag).collect::<Vec<_>>().join("; ")
    }

    /// The nadir at the row's time, with the uncertainty that the time adds; none where that is not known.
    pub fn nadir_at_time(&self) -> Option<Direction> {
        let nadir = self.nadir?;
        let Some(sigma_s) = self.timing.sigma_s else {
            return Some(nadir);
        };
        let [roll, pitch] = self.smoothed?.rates_deg_per_s;
        let moved_rad = roll.hypot(pitch).to_radians() * sigma_s;
        Some(Direction {
            covariance_rad2: nadir.covariance_rad2 + Matrix3::identity() * moved_rad.powi(2),
            ..nadir
        })
    }

    fn flags(&self) -> &str {
        self.own.as_ref().map_or("", |own| own.flags.as_str())
    }

    /// The reason why the frame is not fine; empty if it is fine.
    pub fn remark(&self) -> String {
        match self.quality {
            Grade::Coarse if self.reason.is_empty() => {
                format!("little of the edge is seen: {}", self.flags())
            }
            _ => self.reason.clone(),
        }
    }
}

/// A remark without its numbers.
pub fn kind(remark: &str) -> String {
    let kind = remark.split_once(" (measured");
    kind.map_or(remark, |(kind, _)| kind).into()
}

/// The extension that holds a row for every file of the roll camera.
pub const ROLL: &str = "ROLL";

/// The columns of [`ROLL`].
#[rustfmt::skip]
pub const ROLL_COLUMNS: &[Column<RollRow>] = &[
    text("FILE", "the frame's file, relative to the archive", |r| r.file.as_str().into()),
    text("UTC", "mid-exposure, UTC, ISO 8601", |r| r.utc().map_or(String::new(), utc_microseconds).into()),
    float("UNIX_S", "s", "mid-exposure, UTC, since 1970-01-01", |r| r.unix_s()),
    float("UTC_CORRECTION_S", "s", "correction that was added to the header's time, if any", |r| Some(r.timing.correction_s?.value)),
    float("UTC_SIGMA_S", "s", TIME_SIGMA, |r| r.timing.sigma_s),
    float("MONO_S", "s", "mid-exposure on the monotonic clock", |r| r.own.as_ref()?.facts.monotonic_s),
    integer("FRAMENUM", "number of the frame", |r| r.own.as_ref()?.facts.number.map(|number| number as i64)),
    text("QUALITY", "fine: most of the edge in view is seen; coarse: less; none", |r| r.quality.name().into()),
    text("REASON", "why there is no roll, and why the time is flagged; empty for the others", |r| r.full_reason().into()),
    text("FLAGS", "disturbances of the edge: clouds, other_edges, no_edge", |r| r.flags().into()),
    integer("PLACES", "places of the edge that are in view", |r| Some(r.own.as_ref()?.places as i64)),
    integer("AGREEING", "those that agree with the nadir", |r| Some(r.own.as_ref()?.agreeing as i64)),
    float("ROLL_DEG", "deg", "roll of the body by this frame alone, right side low positive", |r| Some(r.angles_deg()?[0].value)),
    float("ROLL_SIGMA_DEG", "deg", "1 sigma of ROLL_DEG", |r| Some(r.angles_deg()?[0].sigma)),
    float("PITCH_DEG", "deg", "pitch of the body by this frame alone, forward end high positive", |r| Some(r.angles_deg()?[1].value)),
    float("PITCH_SIGMA_DEG", "deg", "1 sigma of PITCH_DEG", |r| Some(r.angles_deg()?[1].sigma)),
    float("SMOOTHED_ROLL_DEG", "deg", "the roll, smoothed over the neighbouring frames", |r| Some(r.smoothed?.roll_deg.value)),
    float("SMOOTHED_ROLL_SIGMA_DEG", "deg", "1 sigma of SMOOTHED_ROLL_DEG, with what neighbours share", |r| Some(r.smoothed?.roll_deg.sigma)),
    float("ROLL_RATE_DEG_PER_S", "deg/s", "rate of change of the roll", |r| Some(r.smoothed?.rates_deg_per_s[0])),
    float("SMOOTHED_PITCH_DEG", "deg", "the pitch, smoothed over the neighbouring frames", |r| Some(r.smoothed?.pitch_deg.value)),
    float("SMOOTHED_PITCH_SIGMA_DEG", "deg", "1 sigma of SMOOTHED_PITCH_DEG, with what neighbours share", |r| Some(r.smoothed?.pitch_deg.sigma)),
    float("PITCH_RATE_DEG_PER_S", "deg/s", "rate of change of the pitch", |r| Some(r.smoothed?.rates_deg_per_s[1])),
    float("FLIGHT_ROLL_DEG", "deg", "BODYROLL of the header: the solution in flight", |r| Some(r.in_flight_deg()?[0])),
    float("FLIGHT_ROLL_SIGMA_DEG", "deg", "BODYRLSG of the header", |r| Some(r.in_flight_deg()?[1])),
];
