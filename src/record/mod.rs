//! Result of one frame as a flat record: each number once, with its names in JSON lines, CSV, FITS headers and the telemetry.
//!
//! To add a number, add a field to [`Record`] or its parts, which are the JSON lines, and a row to the table below, named in the list of each
//! form that contains it: the orders of the forms differ, and do not change.

mod number;

pub use number::{Field, Value};

use crate::aspect::{Adopted, Aspect, Quality, Solution, Stage};
use crate::clock::{Utc, utc_text};
use crate::fits::Card;
use crate::fits::keyword::Keyword;
use crate::frame::{Levels, Warning};
use crate::geometry::attitude::Direction;
use crate::horizon;
use crate::moon;
use crate::pointing::Offset;
use crate::reasons::{self, Stopped};
use crate::units::Measured;
use jiff::Timestamp;
use number::Digits::{All, Nine, Six};
use number::{Number, code, count, number, text};
use serde::Serialize;
use std::borrow::Cow;
use std::time::Duration;

/// Record of a solved frame. Fields of stages not reached are `None`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Record {
    pub file: String,
    /// Mid-exposure.
    #[serde(serialize_with = "milliseconds")]
    pub utc: Option<Utc>,
    pub quality: &'static str,
    pub reason: Option<Reason>,
    pub sun_px: Option<[f64; 2]>,
    pub sun_px_sigma: Option<[f64; 2]>,
    pub sun_radius_px: Option<f64>,
    pub sun_radius_px_sigma: Option<f64>,
    pub sun_plate_mil: Option<[f64; 2]>,
    pub sun_plate_sigma_mil: Option<[f64; 2]>,
    pub marks: Option<Vec<MarkRecord>>,
    pub mapping: Option<MappingRecord>,
    pub offset_deg: Option<OffsetRecord>,
    /// Roll of the body that carries the cameras, if the horizon was observed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roll_deg: Option<RollRecord>,
    /// Result of a frame in which the Moon was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moon: Option<MoonRecord>,
    /// Wall time of the solver alone.
    pub solve_us: Option<u64>,
}

/// Reason why processing of a frame stopped.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reason {
    pub stage: &'static str,
    /// Code for programs; `None` for a problem of the file's time or place.
    pub code: Option<&'static str>,
    pub reason: Cow<'static, str>,
    pub measured: Option<f64>,
    pub limit: Option<f64>,
}

impl Reason {
    pub fn of<S: reasons::Stage>(Stopped { stage, rejected }: &Stopped<S>) -> Self {
        Self {
            stage: stage.name(),
            code: Some(rejected.reason.code),
            reason: rejected.reason.sentence.into(),
            measured: Some(rejected.measured),
            limit: Some(rejected.limit),
        }
    }

    /// Reason why a frame has no time or no place, and so no offset, although its file states one.
    pub fn of_file(stage: &'static str, warning: &Warning) -> Self {
        Self {
            stage,
            code: None,
            reason: warning.to_string().into(),
            measured: None,
            limit: None,
        }
    }
}

/// A mark that was identified.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MarkRecord {
    pub id: [i32; 2],
    pub px: [f64; 2],
    pub sigma_px: f64,
}

/// The mapping at the Sun's place, with 1 sigma of scale and rotation: this frame's, or a borrowed one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MappingRecord {
    pub kind: &'static str,
    pub scale_mil_per_px: f64,
    pub scale_sigma_mil_per_px: f64,
    pub rotation_deg: f64,
    pub rotation_sigma_deg: f64,
    pub residual_px: Option<f64>,
}

/// The offset from the target.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OffsetRecord {
    pub azimuth: f64,
    pub elevation: f64,
    /// True angle.
    pub cross_elevation: f64,
    /// Per axis, in true angle; from this frame and from the borrowed mapping, if any.
    pub sigma: f64,
    /// The same for the calibration: boresight, clocking, plate distance; not part of `sigma`.
    pub calibration_sigma: f64,
}

/// The body's roll, deg: positive with the right side low.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RollRecord {
    pub value: f64,
    pub sigma: f64,
}

impl From<Measured> for RollRecord {
    fn from(roll_deg: Measured) -> Self {
        Self {
            value: roll_deg.value,
            sigma: roll_deg.sigma,
        }
    }
}

/// The Moon's full disc, including its dark part.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MoonRecord {
    pub centre_px: [f64; 2],
    pub centre_sigma_px: [f64; 2],
    /// Vertical half axis.
    pub radius_px: f64,
    pub radius_sigma_px: f64,
    /// 0 full, 180 new.
    pub phase_angle_deg: f64,
    /// Position angle of the middle of the bright limb in the picture, from +x towards +y.
    pub bright_limb_deg: f64,
    /// Unit vector in the camera's axes.
    pub direction: Option<[f64; 3]>,
    /// 1 sigma per axis.
    pub direction_sigma_deg: Option<f64>,
}

impl MoonRecord {
    fn new(disc: &moon::Disc, direction: Option<&Direction>) -> Self {
        Self {
            centre_px: [disc.centre.position.x, disc.centre.position.y],
            centre_sigma_px: disc.centre.sigma(),
            radius_px: disc.radius_px.value,
            radius_sigma_px: disc.radius_px.sigma,
            phase_angle_deg: disc.phase_angle_deg.value,
            bright_limb_deg: disc.bright_limb_deg,
            direction: direction.map(|direction| direction.unit.into_inner().into()),
            direction_sigma_deg: direction.map(|direction| direction.sigma_rad().to_degrees()),
        }
    }
}

fn milliseconds<S: serde::Serializer>(utc: &Option<Utc>, serializer: S) -> Result<S::Ok, S::Error> {
    match utc {
        Some(utc) => serializer.serialize_str(&utc_text(*utc, 3)),
        None => serializer.serialize_none(),
    }
}

impl Record {
    pub fn new(
        file: &str,
        utc: Option<Timestamp>,
        solution: &Solution,
        offset: Option<Offset>,
        solve_time: Option<Duration>,
    ) -> Self {
        let aspect = solution.aspect.as_ref();
        let adopted = solution.mapping.as_ref();
        Self {
            file: file.into(),
            utc: utc.map(Utc::from),
            quality: solution.quality.name(),
            reason: solution.stopped.as_ref().map(Reason::of),
            sun_px: aspect.map(|a| [a.sun_px.position.x, a.sun_px.position.y]),
            sun_px_sigma: aspect.map(|a| a.sun_px.sigma()),
            sun_radius_px: aspect.map(|a| a.sun_radius_px.value),
            sun_radius_px_sigma: aspect.map(|a| a.sun_radius_px.sigma),
            sun_plate_mil: aspect.map(|a| [a.sun_plate.position.x, a.sun_plate.position.y]),
            sun_plate_sigma_mil: aspect.map(|a| a.sun_plate.sigma()),
            marks: aspect.map(|_| marks(solution)),
            mapping: aspect
                .zip(adopted)
                .map(|(aspect, adopted)| mapping(aspect, adopted)),
            offset_deg: offset.map(|offset| OffsetRecord {
                azimuth: offset.azimuth_deg,
                elevation: offset.elevation_deg,
                cross_elevation: offset.cross_elevation_deg,
                calibration_sigma: offset.calibration_sigma_deg(),
                sigma: offset.sigma_deg,
            }),
            roll_deg: None,
            moon: None,
            solve_us: solve_time.map(|time| time.as_micros() as u64),
        }
    }

    /// A frame that is stored and not solved.
    pub fn unsolved(
        utc: Option<Timestamp>,
        stopped: Option<&Stopped<&'static str>>,
        solve_time: Duration,
    ) -> Self {
        Self {
            reason: stopped.map(Reason::of),
            ..Self::new("", utc, &Solution::none(), None, Some(solve_time))
        }
    }

    /// Record of a frame of the horizon, except for the body's roll by it.
    pub fn of_horizon(
        utc: Option<Timestamp>,
        solution: &horizon::Solution,
        solve_time: Duration,
    ) -> Self {
        Self {
            quality: solution.quality().name(),
            reason: solution.reason().map(Reason::of),
            ..Self::unsolved(utc, None, solve_time)
        }
    }

    /// Record of a frame of the Moon.
    pub fn of_moon(
        utc: Option<Timestamp>,
        found: &Result<moon::Disc, moon::Stopped>,
        direction: Option<&Direction>,
        solve_time: Duration,
    ) -> Self {
        let none = Self::unsolved(utc, None, solve_time);
        match found {
            Ok(disc) => Self {
                quality: disc.quality.name(),
                moon: Some(MoonRecord::new(disc, direction)),
                ..none
            },
            Err(stopped) => Self {
                reason: Some(Reason::of(stopped)),
                ..none
            },
        }
    }

    /// Names of the columns of [`csv_row`](Self::csv_row), each with its unit.
    pub fn csv_columns() -> Vec<&'static str> {
        columns(&COLUMNS).collect()
    }

    /// The record as the fields of a CSV row; unknown values are empty.
    pub fn csv_row(&self) -> Vec<String> {
        let row = self.alone();
        COLUMNS.iter().map(|number| number.text(&row)).collect()
    }

    /// The keywords of the record.
    pub fn cards(&self) -> Vec<Card> {
        let row = self.alone();
        KEYWORDS
            .iter()
            .filter_map(|number| number.card(&row))
            .collect()
    }

    /// A row with only this record.
    fn alone(&self) -> LoggedRow {
        LoggedRow::bare(None, self.clone())
    }

    /// "stage: reason", for FITS and CSV.
    pub fn reason_text(&self) -> Option<String> {
        let reason = self.reason.as_ref()?;
        Some(format!("{}: {}", reason.stage, reason.reason))
    }
}

/// A frame's row in the logs. `record.file` is empty if its picture was not stored.
#[derive(Debug, Clone, PartialEq)]
pub struct LoggedRow {
    /// Number of the frame in its sequence.
    pub number: Option<u64>,
    pub quality: Quality,
    /// Stage at which the frame stopped.
    pub stopped: Option<Stage>,
    pub levels: Option<Levels>,
    pub record: Record,
    /// Whether the picture is on the disk of the log itself; `None` if it is on none.
    pub on_own_disk: Option<bool>,
    pub archive_state: ArchiveState,
}

/// State of the archive when a frame came.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ArchiveState {
    /// Free space of each disk; `None` if there is no disk, or it does not report it.
    pub free_percent: [Option<f64>; 2],
    /// Pictures that waited for a disk.
    pub waiting: u64,
    /// Pictures so far that are on no disk.
    pub unstored: u64,
}

impl LoggedRow {
    /// The row of a solved frame; `record` must be of the same solution.
    pub fn new(number: Option<u64>, solution: &Solution, record: Record) -> Self {
        Self {
            quality: solution.quality,
            stopped: solution.stopped.map(|stopped| stopped.stage),
            levels: solution.levels,
            ..Self::bare(number, record)
        }
    }

    /// The row with only this record.
    pub fn bare(number: Option<u64>, record: Record) -> Self {
        Self {
            number,
            quality: Quality::None,
            stopped: None,
            levels: None,
            record,
            on_own_disk: None,
            archive_state: ArchiveState::default(),
        }
    }

    /// Values of the column `disk`: the picture is on the disk of the log itself, or on the other one.
    pub const THIS_DISK: &'static str = "this";
    pub const OTHER_DISK: &'static str = "other";

    /// The quality as a number: 0 none, 1 coarse, 2 fine.
    pub fn quality_code(&self) -> u8 {
        quality_code(self.quality)
    }

    /// Names of the log's columns, each with its unit.
    pub fn csv_columns() -> Vec<&'static str> {
        columns(&LOG_BEFORE)
            .chain(columns(&COLUMNS))
            .chain(columns(&LOG_AFTER))
            .collect()
    }

    /// The fields of the columns; unknown values are empty.
    pub fn csv_fields(&self) -> Vec<String> {
        let numbers = LOG_BEFORE.iter().chain(&COLUMNS).chain(&LOG_AFTER);
        numbers.map(|number| number.text(self)).collect()
    }
}

/// The names of numbers as columns.
fn columns(numbers: &'static [Number]) -> impl Iterator<Item = &'static str> {
    numbers.iter().filter_map(|number| Some(number.column?.0))
}

/// The fields of the telemetry, in the order in which they are written.
pub fn fields() -> impl Iterator<Item = &'static Field> {
    FIELDS.iter().filter_map(|number| number.field.as_ref())
}

/// The keywords of a solution, in the order of the table below.
pub fn keywords() -> impl Iterator<Item = &'static Keyword> {
    ALL.iter().filter_map(|(_, number)| number.keyword.as_ref())
}

macro_rules! numbers {
    ($($name:ident: $number:expr;)*) => {
        $(const $name: Number = $number;)*

        /// All numbers, with their names here.
        static ALL: &[(&str, Number)] = &[$((stringify!($name), $name)),*];
    };
}

#[rustfmt::skip] // One row, one line.
numbers! {
    FRAME: count(|r| r.number).column("frame", All).field("FRAME", "", "number of the frame");
    FILE: text(|r| Some(r.record.file.as_str().into())).column("file", All);
    STORED: code(|r| u8::from(!r.record.file.is_empty())).field("STORED", "", "picture stored: 0 no, 1 yes");
    UTC: text(|r| Some(utc_text(r.record.utc?, 3).into())).column("utc", All);
    TIME: number(|r| r.record.utc.map(|utc| utc.time.as_nanosecond() as f64 * 1e-9)).field("TIME", "s", "mid-exposure, UTC since 1970");
    QUALITY: text(|r| Some(r.record.quality.into())).column("quality", All).keyword("QUALITY", "", "fine, coarse or none");
    QUALITY_CODE: code(LoggedRow::quality_code).field("QUALITY", "", "quality: 0 none, 1 coarse, 2 fine");
    STOPPED: code(|r| r.stopped.map_or(0, stage_code))
        .field("STOPPED", "", "stopped at: 0 nowhere, 1 levels, 2 limb, 3 marks, 4 identification, 5 registration, 6 aspect, 7 pointing");
    REASON: text(|r| Some(r.record.reason_text()?.into())).column("reason", All).keyword("REASON", "", "why processing stopped");
    REASON_MEASURED: number(|r| r.record.reason.as_ref()?.measured).column("reason_measured", All)
        .keyword("REASONIS", "", "the measured value of REASON");
    REASON_LIMIT: number(|r| r.record.reason.as_ref()?.limit).column("reason_limit", All)
        .keyword("REASONLM", "", "the limit that REASONIS violates");
    SUN_X_PX: number(|r| Some(r.record.sun_px?[0])).column("sun_x_px", Six)
        .keyword("SUNPX-X", "pixel", "disc's centre, first pixel is 0").field("PIXEL_X", "px", "Sun's centre on the sensor, x");
    SUN_Y_PX: number(|r| Some(r.record.sun_px?[1])).column("sun_y_px", Six)
        .keyword("SUNPX-Y", "pixel", "disc's centre, first pixel is 0").field("PIXEL_Y", "px", "Sun's centre on the sensor, y");
    SUN_SIGMA_X_PX: number(|r| Some(r.record.sun_px_sigma?[0])).column("sun_sigma_x_px", Six).keyword("SUNPX-SX", "pixel", "1 sigma of SUNPX-X");
    SUN_SIGMA_Y_PX: number(|r| Some(r.record.sun_px_sigma?[1])).column("sun_sigma_y_px", Six).keyword("SUNPX-SY", "pixel", "1 sigma of SUNPX-Y");
    SUN_RADIUS_PX: number(|r| r.record.sun_radius_px).column("sun_radius_px", Six)
        .keyword("SUNPX-R", "pixel", "disc's radius at the mapping's scale").field("RADIUS", "px", "Sun's radius on the sensor");
    SUN_RADIUS_SIGMA_PX: number(|r| r.record.sun_radius_px_sigma).column("sun_radius_sigma_px", Six)
        .keyword("SUNPX-SR", "pixel", "1 sigma of SUNPX-R").field("RADIUS_SIGMA", "px", "1 sigma of RADIUS");
    SUN_X_MIL: number(|r| Some(r.record.sun_plate_mil?[0])).column("sun_plate_x_mil", Six)
        .keyword("SUNMIL-X", "mil", "disc's centre on the plate").field("SUN_X", "mil", "Sun's centre on the plate, x");
    SUN_Y_MIL: number(|r| Some(r.record.sun_plate_mil?[1])).column("sun_plate_y_mil", Six)
        .keyword("SUNMIL-Y", "mil", "disc's centre on the plate").field("SUN_Y", "mil", "Sun's centre on the plate, y");
    SUN_SIGMA_X_MIL: number(|r| Some(r.record.sun_plate_sigma_mil?[0])).column("sun_plate_sigma_x_mil", Six)
        .keyword("SUNMILSX", "mil", "1 sigma of SUNMIL-X").field("SIGMA_X", "mil", "1 sigma of SUN_X");
    SUN_SIGMA_Y_MIL: number(|r| Some(r.record.sun_plate_sigma_mil?[1])).column("sun_plate_sigma_y_mil", Six)
        .keyword("SUNMILSY", "mil", "1 sigma of SUNMIL-Y").field("SIGMA_Y", "mil", "1 sigma of SUN_Y");
    MARKS: count(|r| Some(r.record.marks.as_ref()?.len() as u64)).column("marks", All)
        .keyword("NMARKS", "", "marks that were read").field("MARKS", "", "marks with ids");
    MAPPING: text(|r| Some(r.record.mapping.as_ref()?.kind.into())).column("mapping", All).keyword("MAPKIND", "", "kind of mapping, or its origin");
    SCALE: number(|r| Some(r.record.mapping.as_ref()?.scale_mil_per_px)).column("scale_mil_per_px", Six)
        .keyword("MAPSCALE", "mil/pixel", "plate length per pixel").field("SCALE", "mil/px", "scale of the mapping");
    SCALE_SIGMA: number(|r| Some(r.record.mapping.as_ref()?.scale_sigma_mil_per_px)).column("scale_sigma_mil_per_px", Six)
        .keyword("MAPSCASG", "mil/pixel", "1 sigma of MAPSCALE").field("SCALE_SIGMA", "mil/px", "1 sigma of SCALE");
    ROTATION: number(|r| Some(r.record.mapping.as_ref()?.rotation_deg)).column("rotation_deg", Six)
        .keyword("MAPROT", "deg", "rotation from +x towards +y").field("ROTATION", "deg", "rotation of the mapping");
    ROTATION_SIGMA: number(|r| Some(r.record.mapping.as_ref()?.rotation_sigma_deg)).column("rotation_sigma_deg", Six)
        .keyword("MAPROTSG", "deg", "1 sigma of MAPROT").field("ROTATION_SIGMA", "deg", "1 sigma of ROTATION");
    RESIDUAL: number(|r| r.record.mapping.as_ref()?.residual_px).column("residual_px", Six)
        .keyword("MAPRES", "pixel", "rms residual of the marks").field("RESIDUAL", "px", "residual of the marks");
    OFFSET_AZIMUTH: number(|r| Some(r.record.offset_deg.as_ref()?.azimuth)).column("offset_azimuth_deg", Nine)
        .keyword("OFFSETAZ", "deg", "azimuth, pointing minus target").field("OFFSET_AZ", "deg", "azimuth minus target's");
    OFFSET_ELEVATION: number(|r| Some(r.record.offset_deg.as_ref()?.elevation)).column("offset_elevation_deg", Nine)
        .keyword("OFFSETEL", "deg", "elevation, pointing minus target").field("OFFSET_EL", "deg", "elevation minus target's");
    OFFSET_CROSS: number(|r| Some(r.record.offset_deg.as_ref()?.cross_elevation)).column("offset_cross_elevation_deg", All)
        .keyword("OFFSETXE", "deg", "true angle across, to larger azimuth").field("OFFSET_XEL", "deg", "cross-elevation from the target, true angle");
    OFFSET_SIGMA: number(|r| Some(r.record.offset_deg.as_ref()?.sigma)).column("offset_sigma_deg", Nine)
        .keyword("OFFSETSG", "deg", "1 sigma per axis of true angle").field("OFFSET_SIGMA", "deg", "1 sigma of the offset per axis, noise");
    OFFSET_CALIBRATION: number(|r| Some(r.record.offset_deg.as_ref()?.calibration_sigma)).column("offset_calibration_sigma_deg", All)
        .keyword("OFFSETCS", "deg", "the same, left by the calibration")
        .field("OFFSET_CALSIGMA", "deg", "1 sigma of the offset per axis, calibration");
    ROLL: number(|r| Some(r.record.roll_deg.as_ref()?.value)).column("roll_deg", All)
        .keyword("BODYROLL", "deg", "roll by the horizon, right low").field("ROLL", "deg", "body's roll by the horizon");
    ROLL_SIGMA: number(|r| Some(r.record.roll_deg.as_ref()?.sigma)).column("roll_sigma_deg", All)
        .keyword("BODYRLSG", "deg", "1 sigma of BODYROLL").field("ROLL_SIGMA", "deg", "1 sigma of ROLL");
    MOON_X: number(|r| Some(r.record.moon.as_ref()?.centre_px[0])).column("moon_x_px", All)
        .keyword("MOONPX-X", "pixel", "Moon's centre, first pixel is 0").field("MOON_X", "px", "Moon's centre, x");
    MOON_Y: number(|r| Some(r.record.moon.as_ref()?.centre_px[1])).column("moon_y_px", All)
        .keyword("MOONPX-Y", "pixel", "Moon's centre, first pixel is 0").field("MOON_Y", "px", "Moon's centre, y");
    MOON_SIGMA_X: number(|r| Some(r.record.moon.as_ref()?.centre_sigma_px[0])).column("moon_sigma_x_px", All)
        .keyword("MOONPXSX", "pixel", "1 sigma of MOONPX-X").field("MOON_SIGMA_X", "px", "1 sigma of MOON_X");
    MOON_SIGMA_Y: number(|r| Some(r.record.moon.as_ref()?.centre_sigma_px[1])).column("moon_sigma_y_px", All)
        .keyword("MOONPXSY", "pixel", "1 sigma of MOONPX-Y").field("MOON_SIGMA_Y", "px", "1 sigma of MOON_Y");
    MOON_RADIUS: number(|r| Some(r.record.moon.as_ref()?.radius_px)).column("moon_radius_px", All)
        .keyword("MOONPX-R", "pixel", "Moon's radius, vertical half axis").field("MOON_RADIUS", "px", "Moon's vertical half axis");
    MOON_RADIUS_SIGMA: number(|r| Some(r.record.moon.as_ref()?.radius_sigma_px)).keyword("MOONPXSR", "pixel", "1 sigma of MOONPX-R");
    MOON_PHASE: number(|r| Some(r.record.moon.as_ref()?.phase_angle_deg)).keyword("MOONPHAS", "deg", "phase angle, 0 full, 180 new");
    MOON_LIMB: number(|r| Some(r.record.moon.as_ref()?.bright_limb_deg)).keyword("MOONLIMB", "deg", "middle of bright limb, +x towards +y");
    MOON_RIGHT: number(|r| Some(r.record.moon.as_ref()?.direction?[0])).keyword("MOONDIRX", "", "direction to the Moon, camera's right");
    MOON_DOWN: number(|r| Some(r.record.moon.as_ref()?.direction?[1])).keyword("MOONDIRY", "", "direction to the Moon, camera's down");
    MOON_FORWARD: number(|r| Some(r.record.moon.as_ref()?.direction?[2])).keyword("MOONDIRZ", "", "direction to the Moon, forward");
    MOON_DIRECTION_SIGMA: number(|r| r.record.moon.as_ref()?.direction_sigma_deg).keyword("MOONDIRS", "deg", "1 sigma of the direction per axis");
    BACKGROUND: number(|r| Some(r.levels?.background_dn)).column("background_dn", All).field("LEVEL_BACKGROUND", "DN", "level of the background");
    NOISE: number(|r| Some(r.levels?.noise_dn)).column("noise_dn", All).field("LEVEL_NOISE", "DN", "1 sigma of the background");
    DISC: number(|r| Some(r.levels?.disc_dn)).column("disc_dn", All).field("LEVEL_DISC", "DN", "level of the disc");
    DISK: text(|r| Some(if r.on_own_disk? { LoggedRow::THIS_DISK } else { LoggedRow::OTHER_DISK }.into())).column("disk", All);
    SOLVE_US: count(|r| r.record.solve_us).column("solve_us", All);
    SOLVE_TIME: number(|r| r.record.solve_us.map(|us| us as f64 * 1e-6)).keyword("SOLVETIM", "s", "wall time of the solver")
        .field("SOLVE_TIME", "s", "wall time of the solver");
    DISK1_FREE: number(|r| r.archive_state.free_percent[0]).field("DISK1_FREE", "percent", "free space of the first disk");
    DISK2_FREE: number(|r| r.archive_state.free_percent[1]).field("DISK2_FREE", "percent", "free space of the second disk");
    WAITING: number(|r| Some(r.archive_state.waiting as f64)).field("WAITING", "", "pictures that wait for a disk");
    UNSTORED: number(|r| Some(r.archive_state.unstored as f64)).field("UNSTORED", "", "pictures so far that no disk has");
}

/// The columns of a record, and the log's columns before and after them.
#[rustfmt::skip]
static COLUMNS: [Number; 25] = [
    FILE, UTC, QUALITY, REASON, SUN_X_PX, SUN_Y_PX, SUN_SIGMA_X_PX, SUN_SIGMA_Y_PX, SUN_RADIUS_PX, SUN_RADIUS_SIGMA_PX,
    SUN_X_MIL, SUN_Y_MIL, SUN_SIGMA_X_MIL, SUN_SIGMA_Y_MIL, MARKS, MAPPING, SCALE, SCALE_SIGMA, ROTATION, ROTATION_SIGMA, RESIDUAL,
    OFFSET_AZIMUTH, OFFSET_ELEVATION, OFFSET_SIGMA, SOLVE_US,
];
static LOG_BEFORE: [Number; 1] = [FRAME];
#[rustfmt::skip]
static LOG_AFTER: [Number; 15] = [
    REASON_MEASURED, REASON_LIMIT, OFFSET_CROSS, OFFSET_CALIBRATION, BACKGROUND, NOISE, DISC, DISK, ROLL, ROLL_SIGMA,
    MOON_X, MOON_Y, MOON_SIGMA_X, MOON_SIGMA_Y, MOON_RADIUS,
];

/// Keywords in the order of a header.
#[rustfmt::skip]
static KEYWORDS: [Number; 41] = [
    QUALITY, REASON, REASON_MEASURED, REASON_LIMIT, SUN_X_PX, SUN_Y_PX, SUN_SIGMA_X_PX, SUN_SIGMA_Y_PX, SUN_RADIUS_PX, SUN_RADIUS_SIGMA_PX,
    SUN_X_MIL, SUN_Y_MIL, SUN_SIGMA_X_MIL, SUN_SIGMA_Y_MIL, SCALE, SCALE_SIGMA, ROTATION, ROTATION_SIGMA, RESIDUAL,
    OFFSET_AZIMUTH, OFFSET_ELEVATION, OFFSET_CROSS, OFFSET_SIGMA, OFFSET_CALIBRATION, ROLL, ROLL_SIGMA,
    MOON_X, MOON_Y, MOON_SIGMA_X, MOON_SIGMA_Y, MOON_RADIUS, MOON_RADIUS_SIGMA, MOON_PHASE, MOON_LIMB,
    MOON_RIGHT, MOON_DOWN, MOON_FORWARD, MOON_DIRECTION_SIGMA, SOLVE_TIME, MAPPING, MARKS,
];

/// Fields of the telemetry in the order in which they are written.
#[rustfmt::skip]
static FIELDS: [Number; 39] = [
    FRAME, QUALITY_CODE, STOPPED, STORED, SUN_X_MIL, SUN_Y_MIL, SUN_SIGMA_X_MIL, SUN_SIGMA_Y_MIL, SUN_X_PX, SUN_Y_PX,
    SUN_RADIUS_PX, SUN_RADIUS_SIGMA_PX, MARKS, SCALE, SCALE_SIGMA, ROTATION, ROTATION_SIGMA, RESIDUAL,
    OFFSET_AZIMUTH, OFFSET_ELEVATION, OFFSET_CROSS, OFFSET_SIGMA, OFFSET_CALIBRATION, ROLL, ROLL_SIGMA,
    MOON_X, MOON_Y, MOON_SIGMA_X, MOON_SIGMA_Y, MOON_RADIUS, BACKGROUND, NOISE, DISC, SOLVE_TIME, DISK1_FREE, DISK2_FREE,
    WAITING, UNSTORED, TIME,
];

fn quality_code(quality: Quality) -> u8 {
    match quality {
        Quality::None => 0,
        Quality::Coarse => 1,
        Quality::Fine => 2,
    }
}

fn stage_code(stage: Stage) -> u8 {
    match stage {
        Stage::Levels => 1,
        Stage::Limb => 2,
        Stage::Marks => 3,
        Stage::Identification => 4,
        Stage::Registration => 5,
        Stage::Aspect => 6,
        Stage::Pointing => 7,
    }
}

fn marks(solution: &Solution) -> Vec<MarkRecord> {
    let record = |mark: &crate::aspect::Mark| MarkRecord {
        id: [mark.id.i, mark.id.j],
        px: [mark.at.x, mark.at.y],
        sigma_px: mark.sigma_px(),
    };
    solution.marks.iter().map(record).collect()
}

fn mapping(aspect: &Aspect, adopted: &Adopted) -> MappingRecord {
    let (scale, rotation) = (aspect.mapping.scale_mil_per_px, aspect.mapping.rotation_deg);
    MappingRecord {
        kind: adopted.name(),
        scale_mil_per_px: scale.value,
        scale_sigma_mil_per_px: scale.sigma,
        rotation_deg: rotation.value,
        rotation_sigma_deg: rotation.sigma,
        residual_px: adopted.residual_px(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_number_is_in_the_list_of_every_form_that_has_it() {
        let logs = || {
            columns(&LOG_BEFORE)
                .chain(columns(&COLUMNS))
                .chain(columns(&LOG_AFTER))
        };
        for (name, number) in ALL {
            let listed = |form: &str, own: Option<&str>, found: usize| {
                assert_eq!(found, usize::from(own.is_some()), "{name}: {form}");
            };
            let column = number.column.map(|(name, _)| name);
            listed(
                "column",
                column,
                logs().filter(|one| Some(*one) == column).count(),
            );
            let keyword = number.keyword.map(|keyword| keyword.name);
            listed(
                "keyword",
                keyword,
                keywords().filter(|one| Some(one.name) == keyword).count(),
            );
            let field = number.field.map(|field| field.name);
            listed(
                "field",
                field,
                fields().filter(|one| Some(one.name) == field).count(),
            );
        }
    }
}
