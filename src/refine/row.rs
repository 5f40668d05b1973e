//! One file's row of the history.

use super::disc::PlateDisc;
use super::flags::FrameFlags;
use super::mapping::MappingNumbers;
use super::path::timing_mil2;
use super::record::{FrameRecord, Grade};
use super::times::Timing;
use crate::geometry::attitude::Direction;
use crate::units::{Estimate, Measured, PlateMil};
use jiff::Timestamp;

/// Pointing of the telescope.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SkyRow {
    pub azimuth_deg: f64,
    pub elevation_deg: f64,
    /// Helioprojective position of the boresight, relative to the Sun's centre.
    pub helioprojective_arcsec: [f64; 2],
    /// Pointing minus target: azimuth, elevation, and true angle across.
    pub offset_deg: Option<[f64; 3]>,
    /// The telescope's roll that the offset uses.
    pub roll_deg: Measured,
    /// 1 sigma per axis of true angle: of the frame, and of the calibration.
    pub sigma_deg: Option<[f64; 2]>,
    pub sun_azimuth_deg: f64,
    pub sun_elevation_deg: f64,
}

/// One file's row, assembled from its frame's record and the flight's results.
#[derive(Debug, Clone, PartialEq)]
pub struct RefinedRow {
    pub file: String,
    /// The file of which this one's frame is a copy.
    pub copy_of: Option<String>,
    /// Mid-exposure, ns since 1970.
    pub utc_ns: Option<i64>,
    pub timing: Timing,
    /// Speed of the Sun over the plate along the smoothed path, mil/s, where the time has a sigma.
    pub speed_mil_per_s: Option<[f64; 2]>,
    /// Record of the frame on its own; none of a file without a frame.
    pub own: Option<FrameRecord>,
    pub quality: Grade,
    /// The reason in the frame's own solution why it is not fine; empty if there is none.
    pub own_reason: String,
    pub flags: FrameFlags,
    pub sun: Option<Estimate<PlateMil>>,
    pub disc: Option<PlateDisc>,
    /// Visible part of the limb, 0 to 1.
    pub limb_part: Option<f64>,
    /// Radius from ephemeris and plate distance.
    pub expected_radius_mil: Option<f64>,
    pub mapping: Option<MappingNumbers>,
    pub jump_px: Option<f64>,
    pub sky: Option<SkyRow>,
    /// The nadir in the axes of the body, where the roll camera saw the horizon.
    pub body_nadir: Option<Direction>,
}

impl RefinedRow {
    /// The reason why the frame is not fine, and its flags; empty if there is nothing to state.
    pub fn reason(&self) -> String {
        let own = (!self.own_reason.is_empty()).then(|| self.own_reason.clone());
        let flag = self.flags().map(|flag| format!("refine: {flag}"));
        own.into_iter().chain(flag).collect::<Vec<_>>().join("; ")
    }

    /// The flags of its time and its frame, in words.
    pub fn flags(&self) -> impl Iterator<Item = String> {
        let of_time = self.timing.flag.map(|flag| flag.to_string());
        of_time
            .into_iter()
            .chain(self.flags.iter().map(|flag| flag.to_string()))
    }

    /// The frame's own quality.
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

    /// The Sun at the row's time, with the uncertainty that the time adds; none where that is not known.
    pub fn sun_at_time(&self) -> Option<Estimate<PlateMil>> {
        let sun = self.sun?;
        /// In a shorter time the Sun does not move far, s.
        const SHORT_S: f64 = 0.01;
        match (self.timing.sigma_s, self.speed_mil_per_s) {
            (Some(sigma_s), Some(speed)) => Some(Estimate {
                covariance: sun.covariance + timing_mil2(speed, sigma_s),
                ..sun
            }),
            (Some(sigma_s), None) => (sigma_s < SHORT_S).then_some(sun),
            (None, _) => Some(sun),
        }
    }

    /// Whether the row's Sun may define the flight's path.
    pub fn is_fine(&self) -> bool {
        self.quality == Grade::Fine && self.sun.is_some()
    }
}
