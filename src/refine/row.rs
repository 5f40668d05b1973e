//! One file's row of the history.

use super::disc::PlateDisc;
use super::flags::FrameFlags;
use super::mapping::MappingNumbers;
use super::path::moved_mil2;
use super::record::{FrameRecord, Grade};
use super::times::Timing;
use crate::geometry::attitude::Direction;
use crate::units::{Estimate, Measured, PlateMil};
use jiff::Timestamp;

/// Where the telescope pointed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SkyRow {
    pub azimuth_deg: f64,
    pub elevation_deg: f64,
    /// Of the boresight, about the Sun's centre.
    pub helioprojective_arcsec: [f64; 2],
    /// Pointing minus target: azimuth, elevation, and true angle across.
    pub offset_deg: Option<[f64; 3]>,
    /// The telescope's roll that the offset rests on.
    pub roll_deg: Measured,
    /// 1 sigma per axis of true angle: of the frame, and of the calibration.
    pub sigma_deg: Option<[f64; 2]>,
    pub sun_azimuth_deg: f64,
    pub sun_elevation_deg: f64,
}

/// One file's row, put together from what its frame gave and what the flight made of it.
#[derive(Debug, Clone, PartialEq)]
pub struct RefinedRow {
    pub file: String,
    /// The file whose frame this one holds once more.
    pub copy_of: Option<String>,
    /// Mid-exposure, ns since 1970.
    pub utc_ns: Option<i64>,
    pub timing: Timing,
    /// How fast the Sun moves over the plate along the smoothed path, mil/s, where the time has a sigma.
    pub speed_mil_per_s: Option<[f64; 2]>,
    /// Record of the frame on its own; none of a file without a frame.
    pub own: Option<FrameRecord>,
    pub quality: Grade,
    /// Why the frame is not fine, where its own solution says it; empty where nothing is to be said.
    pub own_reason: String,
    pub flags: FrameFlags,
    pub sun: Option<Estimate<PlateMil>>,
    pub disc: Option<PlateDisc>,
    /// Part of the limb that the disc rests on, 0 to 1.
    pub limb_part: Option<f64>,
    /// By ephemeris and plate distance.
    pub expected_radius_mil: Option<f64>,
    pub mapping: Option<MappingNumbers>,
    pub jump_px: Option<f64>,
    pub sky: Option<SkyRow>,
    /// Straight down in the axes of the body, where the roll camera saw the horizon.
    pub body_nadir: Option<Direction>,
}

impl RefinedRow {
    /// Why the frame is not fine, and why it is flagged; empty where nothing is to be said.
    pub fn reason(&self) -> String {
        let own = (!self.own_reason.is_empty()).then(|| self.own_reason.clone());
        let flag = self.flags().map(|flag| format!("refine: {flag}"));
        own.into_iter().chain(flag).collect::<Vec<_>>().join("; ")
    }

    /// Why its time and its frame are flagged, in words.
    pub fn flags(&self) -> impl Iterator<Item = String> {
        let of_time = self.timing.flag.map(|flag| flag.to_string());
        of_time
            .into_iter()
            .chain(self.flags.iter().map(|flag| flag.to_string()))
    }

    /// The frame's quality by itself.
    pub fn own_quality(&self) -> Grade {
        self.own.as_ref().map_or(Grade::None, |own| own.quality)
    }

    pub fn utc(&self) -> Option<Timestamp> {
        Timestamp::from_nanosecond(self.utc_ns?.into()).ok()
    }

    /// Seconds since 1970.
    pub fn unix_s(&self) -> Option<f64> {
        Some(self.utc_ns? as f64 / 1e9)
    }

    /// The Sun at the row's time, with what the uncertainty of that adds; none where that is not known.
    pub fn sun_at_time(&self) -> Option<Estimate<PlateMil>> {
        let sun = self.sun?;
        /// Over a shorter time no Sun moves far: s.
        const SHORT_S: f64 = 0.01;
        match (self.timing.sigma_s, self.speed_mil_per_s) {
            (Some(sigma_s), Some(speed)) => Some(Estimate {
                covariance: sun.covariance + moved_mil2(speed, sigma_s),
                ..sun
            }),
            (Some(sigma_s), None) => (sigma_s < SHORT_S).then_some(sun),
            (None, _) => Some(sun),
        }
    }

    /// Whether the row's place is one of the flight's path.
    pub fn is_fine(&self) -> bool {
        self.quality == Grade::Fine && self.sun.is_some()
    }
}
