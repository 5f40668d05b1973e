//! One file of the roll camera in the history.

use super::super::copies::CopiedFrame;
use super::super::oddity::Oddity;
use super::super::record::{FrameFacts, Grade};
use super::HorizonRecord;
use crate::archive::StoredFile;
use crate::geometry::attitude::Direction;
use crate::pointing::{body_pitch_deg, body_roll_deg};
use crate::units::Measured;
use nalgebra::Matrix3;

/// One input file's row.
#[derive(Debug, Clone, PartialEq)]
pub struct RollRow {
    pub file: String,
    /// The file whose frame this one holds once more.
    pub copy_of: Option<String>,
    /// Its time is corrected where the clock had stepped.
    pub facts: FrameFacts,
    pub utc_correction_s: Option<Measured>,
    /// 1 sigma of the time, s; none where it is as good as the header's.
    pub time_sigma_s: Option<f64>,
    /// What is odd about the time.
    pub odd_time: Option<Oddity>,
    pub quality: Grade,
    /// Why there is no nadir; empty where nothing is to be said.
    pub reason: String,
    /// What stands beside the edge, or hides it.
    pub flags: String,
    /// Straight down in the body's axes, by this frame alone.
    pub nadir: Option<Direction>,
    /// Places of the edge that are in view, and those that agree with the nadir.
    pub places: usize,
    pub agreeing: usize,
    /// The body's roll in flight, and 1 sigma.
    pub in_flight_deg: Option<[f64; 2]>,
    pub smoothed: Option<SmoothedRoll>,
}

/// Roll and pitch of the body as the frames about a moment have them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmoothedRoll {
    pub roll_deg: Measured,
    pub pitch_deg: Measured,
    /// Of roll and pitch.
    pub rates_deg_per_s: [f64; 2],
}

impl RollRow {
    pub(super) fn unread(input: StoredFile, error: &str) -> Self {
        Self {
            file: input.file,
            copy_of: None,
            facts: FrameFacts::default(),
            utc_correction_s: None,
            time_sigma_s: None,
            odd_time: None,
            quality: Grade::None,
            reason: format!("file: {error}"),
            flags: String::new(),
            nadir: None,
            places: 0,
            agreeing: 0,
            in_flight_deg: None,
            smoothed: None,
        }
    }

    pub(super) fn copied(copy: &CopiedFrame) -> Self {
        Self {
            copy_of: Some(copy.first.clone()),
            ..Self::unread(copy.input.clone(), &copy.reason())
        }
    }

    pub(super) fn of(input: StoredFile, record: HorizonRecord) -> Self {
        Self {
            reason: record.facts.reason(record.reason.as_deref()),
            facts: record.facts,
            quality: record.quality,
            flags: record.flags,
            nadir: record.nadir.map(|nadir| nadir.direction()),
            places: record.places,
            agreeing: record.agreeing,
            in_flight_deg: record.in_flight_deg,
            ..Self::unread(input, "")
        }
    }

    /// Seconds since 1970.
    pub fn unix_s(&self) -> Option<f64> {
        Some(self.facts.utc_ns? as f64 / 1e9)
    }

    /// Roll and pitch by this frame alone.
    pub fn angles_deg(&self) -> Option<[Measured; 2]> {
        let nadir = self.nadir.as_ref()?;
        Some([body_roll_deg(nadir), body_pitch_deg(nadir)])
    }

    /// Why there is no roll, and what is odd about the time; empty where nothing is to be said.
    pub fn told_reason(&self) -> String {
        let own = (!self.reason.is_empty()).then(|| self.reason.clone());
        let odd = self.odd_time.map(|odd| format!("refine: {odd}"));
        own.into_iter().chain(odd).collect::<Vec<_>>().join("; ")
    }

    /// The nadir at the row's time, with what the uncertainty of that adds; none where it cannot be told how much that is.
    pub fn nadir_at_time(&self) -> Option<Direction> {
        let nadir = self.nadir?;
        let Some(sigma_s) = self.time_sigma_s else {
            return Some(nadir);
        };
        let [roll, pitch] = self.smoothed?.rates_deg_per_s;
        let moved_rad = roll.hypot(pitch).to_radians() * sigma_s;
        Some(Direction {
            covariance_rad2: nadir.covariance_rad2 + Matrix3::identity() * moved_rad.powi(2),
            ..nadir
        })
    }

    /// Why the frame is not fine; empty where it is.
    pub fn remark(&self) -> String {
        match self.quality {
            Grade::Coarse if self.reason.is_empty() => {
                format!("little of the edge is seen: {}", self.flags)
            }
            _ => self.reason.clone(),
        }
    }
}
