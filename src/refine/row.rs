//! One input file's row of the history.

use super::copies::CopiedFrame;
use super::disc::PlateDisc;
use super::mapping::MappingNumbers;
use super::oddity::Oddity;
use super::record::{FrameRecord, Grade, InFlight};
use crate::archive::StoredFile;
use crate::geometry::attitude::Direction;
use crate::units::{Estimate, Measured, PlateMil};
use jiff::Timestamp;
use nalgebra::{Matrix2, Vector2};

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

/// What a frame gave by itself.
#[derive(Debug, Clone, PartialEq)]
pub struct OwnRow {
    pub quality: Grade,
    /// Why it went no further; empty where nothing is to be said.
    pub reason: String,
    pub sun_mil: Option<[f64; 2]>,
    pub sigma_mil: Option<[f64; 2]>,
    pub sun_px: Option<[f64; 2]>,
    pub marks: usize,
    pub levels_dn: Option<[f64; 3]>,
}

/// One input file's row.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    pub file: String,
    /// The file whose frame this one holds once more.
    pub copy_of: Option<String>,
    pub utc_ns: Option<i64>,
    /// What was added to the header's time, s, where the clock had stepped.
    pub utc_correction_s: Option<Measured>,
    /// 1 sigma of the time, s; none where it is as good as the header's.
    pub time_sigma_s: Option<f64>,
    /// How fast the Sun moves over the plate along the smoothed path, mil/s, where the time has a sigma.
    pub speed_mil_per_s: Option<[f64; 2]>,
    pub monotonic_s: Option<f64>,
    pub number: Option<u64>,
    pub temperature_c: Option<f64>,
    pub quality: Grade,
    /// Why the frame is not fine, where its own solution says it; empty where nothing is to be said.
    pub own_reason: String,
    pub oddities: Vec<Oddity>,
    pub sun: Option<Estimate<PlateMil>>,
    pub disc: Option<PlateDisc>,
    /// Part of the limb that the disc rests on, 0 to 1.
    pub limb_part: Option<f64>,
    /// By ephemeris and plate distance.
    pub expected_radius_mil: Option<f64>,
    pub mapping: Option<MappingNumbers>,
    pub jump_px: Option<f64>,
    pub own: OwnRow,
    pub sky: Option<SkyRow>,
    /// Straight down in the axes of the body, where the roll camera saw the horizon.
    pub body_nadir: Option<Direction>,
    pub in_flight: InFlight,
}

impl Row {
    /// Notes an oddity; one that spoils the frame takes its place away.
    pub(super) fn note(&mut self, odd: Oddity) {
        if self.oddities.contains(&odd) {
            return;
        }
        self.oddities.push(odd);
        if odd.spoils() {
            self.quality = Grade::None;
            self.sun = None;
        }
    }

    /// Takes back what was odd, but for the time.
    pub(super) fn take_back_oddities(&mut self) {
        self.oddities.retain(|odd| odd.is_of_time());
    }

    /// Why the frame is not fine, and what is odd about it; empty where nothing is to be said.
    pub fn reason(&self) -> String {
        let own = (!self.own_reason.is_empty()).then(|| self.own_reason.clone());
        let odd = self.oddities.iter().map(|odd| format!("refine: {odd}"));
        own.into_iter().chain(odd).collect::<Vec<_>>().join("; ")
    }

    /// A file that could not be read.
    pub(super) fn unread(input: StoredFile, error: String) -> Self {
        Self {
            file: input.file,
            copy_of: None,
            utc_ns: None,
            utc_correction_s: None,
            time_sigma_s: None,
            speed_mil_per_s: None,
            monotonic_s: None,
            number: None,
            temperature_c: None,
            quality: Grade::None,
            own_reason: format!("file: {error}"),
            oddities: Vec::new(),
            sun: None,
            disc: None,
            limb_part: None,
            expected_radius_mil: None,
            mapping: None,
            jump_px: None,
            own: OwnRow {
                quality: Grade::None,
                reason: String::new(),
                sun_mil: None,
                sigma_mil: None,
                sun_px: None,
                marks: 0,
                levels_dn: None,
            },
            sky: None,
            body_nadir: None,
            in_flight: InFlight::default(),
        }
    }

    /// A file that holds the frame of another one.
    pub(super) fn copied(copy: &CopiedFrame) -> Self {
        Self {
            copy_of: Some(copy.first.clone()),
            ..Self::unread(copy.input.clone(), copy.reason())
        }
    }

    /// A frame as it gave itself.
    pub(super) fn of(input: StoredFile, frame: &FrameRecord) -> Self {
        let disc = frame.disc.as_ref();
        let sun = disc.map(|disc| Estimate {
            position: PlateMil::new(disc.on_plate_mil[0], disc.on_plate_mil[1]),
            covariance: super::record::symmetric(disc.covariance_mil2),
        });
        Self {
            utc_ns: frame.facts.utc_ns,
            monotonic_s: frame.facts.monotonic_s,
            number: frame.facts.number,
            temperature_c: frame.facts.temperature_c,
            quality: frame.quality,
            own_reason: frame.facts.reason(frame.reason.as_deref()),
            own: OwnRow {
                quality: frame.quality,
                reason: frame.reason.clone().unwrap_or_default(),
                sun_mil: disc.map(|disc| disc.on_plate_mil),
                sigma_mil: sun.map(|sun| sun.sigma()),
                sun_px: disc.map(|disc| disc.centre_px),
                marks: frame.marks.len(),
                levels_dn: frame.levels_dn,
            },
            sun,
            limb_part: disc.map(|disc| disc.limb_fraction),
            in_flight: frame.in_flight.clone(),
            ..Self::unread(input, String::new())
        }
    }

    pub fn utc(&self) -> Option<Timestamp> {
        Timestamp::from_nanosecond(self.utc_ns?.into()).ok()
    }

    /// Seconds since 1970.
    pub fn unix_s(&self) -> Option<f64> {
        Some(self.utc_ns? as f64 / 1e9)
    }

    /// The Sun at the row's time, with what the uncertainty of that adds; none where it cannot be told how much that is.
    pub fn sun_at_time(&self) -> Option<Estimate<PlateMil>> {
        let sun = self.sun?;
        /// Over a shorter time no Sun moves far: s.
        const SHORT_S: f64 = 0.01;
        match (self.time_sigma_s, self.speed_mil_per_s) {
            (Some(_), Some(speed)) => Some(Estimate {
                covariance: sun.covariance + self.moved_mil2(speed),
                ..sun
            }),
            (Some(sigma_s), None) => (sigma_s < SHORT_S).then_some(sun),
            (None, _) => Some(sun),
        }
    }

    /// Covariance that the uncertainty of the time adds to a place that moves, mil^2.
    pub(super) fn moved_mil2(&self, speed_mil_per_s: [f64; 2]) -> Matrix2<f64> {
        let moved = Vector2::from(speed_mil_per_s) * self.time_sigma_s.unwrap_or(0.0);
        moved * moved.transpose()
    }

    /// Whether the row's time is one of the smoothed path.
    pub(super) fn is_timed(&self) -> bool {
        let mut of_time = self.oddities.iter().filter(|odd| odd.is_of_time());
        of_time.all(|odd| odd.is_of_path())
    }

    /// Whether the row's place is one of the flight's path.
    pub fn is_fine(&self) -> bool {
        self.quality == Grade::Fine && self.sun.is_some()
    }
}
