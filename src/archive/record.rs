//! One frame's answer as a flat record: the same numbers for JSON lines, CSV and FITS keywords.

use crate::aspect::{Adopted, Aspect, Solution};
use crate::clock::{Utc, utc_text};
use crate::fits::{Card, Column, Table, Values};
use crate::frame::Warning;
use crate::geometry::attitude::Direction;
use crate::horizon;
use crate::instrument::Instrument;
use crate::limb::LimbPoint;
use crate::moon;
use crate::pointing::{Offset, Roll, Target};
use crate::reasons::{Stage, Stopped};
use crate::units::Measured;
use jiff::Timestamp;
use serde::Serialize;
use std::borrow::Cow;
use std::time::Duration;

/// What is known of a solved frame. Fields that the frame did not reach are `None`.
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
    /// Of the body that carries the cameras, where the horizon was seen.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roll_deg: Option<RollRecord>,
    /// Of a frame in which the Moon was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moon: Option<MoonRecord>,
    /// Wall time of the solver alone.
    pub solve_us: Option<u64>,
}

/// Why a frame went no further.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reason {
    pub stage: &'static str,
    /// For programs; none of what a file says of its time or place.
    pub code: Option<&'static str>,
    pub reason: Cow<'static, str>,
    pub measured: Option<f64>,
    pub limit: Option<f64>,
}

impl Reason {
    pub fn of<S: Stage>(Stopped { stage, rejected }: &Stopped<S>) -> Self {
        Self {
            stage: stage.name(),
            code: Some(rejected.reason.code),
            reason: rejected.reason.sentence.into(),
            measured: Some(rejected.measured),
            limit: Some(rejected.limit),
        }
    }

    /// Why a frame has no time or no place, and so no offset, although its file states one.
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

/// A mark that was read.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MarkRecord {
    pub id: [i32; 2],
    pub px: [f64; 2],
    pub sigma_px: f64,
}

/// The mapping at the Sun's place, with 1 sigma of scale and rotation: this frame's, or those of the mapping that it borrowed.
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
    /// Per axis of true angle, of this frame and of the mapping that it borrowed, if it did.
    pub sigma: f64,
    /// The same of the calibration: boresight, clocking, plate distance; not part of `sigma`.
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

/// The Moon's disc: its whole one, whatever is lit of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MoonRecord {
    pub centre_px: [f64; 2],
    pub centre_sigma_px: [f64; 2],
    /// Vertical half axis.
    pub radius_px: f64,
    pub radius_sigma_px: f64,
    /// 0 full, 180 new.
    pub phase_angle_deg: f64,
    /// The middle of the bright limb in the picture, from +x towards +y.
    pub bright_limb_deg: f64,
    /// Unit vector in the camera's axes.
    pub direction: Option<[f64; 3]>,
    /// Per axis.
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

    /// What a frame of the horizon says, with the body's roll by it.
    pub fn of_horizon(
        utc: Option<Timestamp>,
        solution: &horizon::Solution,
        roll_deg: Option<Measured>,
        solve_time: Duration,
    ) -> Self {
        Self {
            utc: utc.map(Utc::from),
            quality: solution.quality().name(),
            reason: solution.reason().map(Reason::of),
            roll_deg: roll_deg.map(RollRecord::from),
            ..Self::new("", None, &Solution::none(), None, Some(solve_time))
        }
    }

    /// What a frame of the Moon says.
    pub fn of_moon(
        utc: Option<Timestamp>,
        found: &Result<moon::Disc, moon::Stopped>,
        direction: Option<&Direction>,
        solve_time: Duration,
    ) -> Self {
        let none = Self::new("", None, &Solution::none(), None, Some(solve_time));
        match found {
            Ok(disc) => Self {
                utc: utc.map(Utc::from),
                quality: disc.quality.name(),
                reason: None,
                moon: Some(MoonRecord::new(disc, direction)),
                ..none
            },
            Err(stopped) => Self {
                utc: utc.map(Utc::from),
                reason: Some(Reason::of(stopped)),
                ..none
            },
        }
    }

    /// Names of the columns of [`csv_row`](Self::csv_row), each with its unit.
    pub const CSV_COLUMNS: [&'static str; 25] = [
        "file",
        "utc",
        "quality",
        "reason",
        "sun_x_px",
        "sun_y_px",
        "sun_sigma_x_px",
        "sun_sigma_y_px",
        "sun_radius_px",
        "sun_radius_sigma_px",
        "sun_plate_x_mil",
        "sun_plate_y_mil",
        "sun_plate_sigma_x_mil",
        "sun_plate_sigma_y_mil",
        "marks",
        "mapping",
        "scale_mil_per_px",
        "scale_sigma_mil_per_px",
        "rotation_deg",
        "rotation_sigma_deg",
        "residual_px",
        "offset_azimuth_deg",
        "offset_elevation_deg",
        "offset_sigma_deg",
        "solve_us",
    ];

    /// The record as the fields of a CSV row; what is not known is empty.
    pub fn csv_row(&self) -> [String; 25] {
        let number = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.6}"));
        let axis = |pair: Option<[f64; 2]>, n: usize| number(pair.map(|p| p[n]));
        let offset = self.offset_deg.as_ref();
        let mapping = self.mapping.as_ref();
        let fine = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.9}"));
        [
            self.file.clone(),
            self.utc.map_or(String::new(), |utc| utc_text(utc, 3)),
            self.quality.into(),
            self.reason_text().unwrap_or_default(),
            axis(self.sun_px, 0),
            axis(self.sun_px, 1),
            axis(self.sun_px_sigma, 0),
            axis(self.sun_px_sigma, 1),
            number(self.sun_radius_px),
            number(self.sun_radius_px_sigma),
            axis(self.sun_plate_mil, 0),
            axis(self.sun_plate_mil, 1),
            axis(self.sun_plate_sigma_mil, 0),
            axis(self.sun_plate_sigma_mil, 1),
            self.marks
                .as_ref()
                .map_or(String::new(), |m| m.len().to_string()),
            mapping.map_or(String::new(), |m| m.kind.into()),
            number(mapping.map(|m| m.scale_mil_per_px)),
            number(mapping.map(|m| m.scale_sigma_mil_per_px)),
            number(mapping.map(|m| m.rotation_deg)),
            number(mapping.map(|m| m.rotation_sigma_deg)),
            number(mapping.and_then(|m| m.residual_px)),
            fine(offset.map(|o| o.azimuth)),
            fine(offset.map(|o| o.elevation)),
            fine(offset.map(|o| o.sigma)),
            self.solve_us.map_or(String::new(), |us| us.to_string()),
        ]
    }

    /// "stage: reason", as FITS and CSV write it.
    pub fn reason_text(&self) -> Option<String> {
        let reason = self.reason.as_ref()?;
        Some(format!("{}: {}", reason.stage, reason.reason))
    }

    /// The keywords of the record.
    pub fn cards(&self) -> Vec<Card> {
        let mut cards = vec![Card::new("QUALITY", self.quality)];
        if let Some(reason) = self.reason_text() {
            cards.push(Card::new("REASON", reason.as_str()));
        }
        let mut number = |keyword, value: Option<f64>| {
            // A number that is not finite has no place in a header.
            if let Some(value) = value.filter(|value| value.is_finite()) {
                cards.push(Card::new(keyword, value));
            }
        };
        let axis = |pair: Option<[f64; 2]>, n: usize| pair.map(|p| p[n]);
        number("REASONIS", self.reason.as_ref().and_then(|r| r.measured));
        number("REASONLM", self.reason.as_ref().and_then(|r| r.limit));
        number("SUNPX-X", axis(self.sun_px, 0));
        number("SUNPX-Y", axis(self.sun_px, 1));
        number("SUNPX-SX", axis(self.sun_px_sigma, 0));
        number("SUNPX-SY", axis(self.sun_px_sigma, 1));
        number("SUNPX-R", self.sun_radius_px);
        number("SUNPX-SR", self.sun_radius_px_sigma);
        number("SUNMIL-X", axis(self.sun_plate_mil, 0));
        number("SUNMIL-Y", axis(self.sun_plate_mil, 1));
        number("SUNMILSX", axis(self.sun_plate_sigma_mil, 0));
        number("SUNMILSY", axis(self.sun_plate_sigma_mil, 1));
        let mapping = self.mapping.as_ref();
        number("MAPSCALE", mapping.map(|m| m.scale_mil_per_px));
        number("MAPSCASG", mapping.map(|m| m.scale_sigma_mil_per_px));
        number("MAPROT", mapping.map(|m| m.rotation_deg));
        number("MAPROTSG", mapping.map(|m| m.rotation_sigma_deg));
        number("MAPRES", mapping.and_then(|m| m.residual_px));
        let offset = self.offset_deg.as_ref();
        number("OFFSETAZ", offset.map(|o| o.azimuth));
        number("OFFSETEL", offset.map(|o| o.elevation));
        number("OFFSETXE", offset.map(|o| o.cross_elevation));
        number("OFFSETSG", offset.map(|o| o.sigma));
        number("OFFSETCS", offset.map(|o| o.calibration_sigma));
        let roll = self.roll_deg.as_ref();
        number("BODYROLL", roll.map(|roll| roll.value));
        number("BODYRLSG", roll.map(|roll| roll.sigma));
        let moon = self.moon.as_ref();
        number("MOONPX-X", moon.map(|moon| moon.centre_px[0]));
        number("MOONPX-Y", moon.map(|moon| moon.centre_px[1]));
        number("MOONPXSX", moon.map(|moon| moon.centre_sigma_px[0]));
        number("MOONPXSY", moon.map(|moon| moon.centre_sigma_px[1]));
        number("MOONPX-R", moon.map(|moon| moon.radius_px));
        number("MOONPXSR", moon.map(|moon| moon.radius_sigma_px));
        number("MOONPHAS", moon.map(|moon| moon.phase_angle_deg));
        number("MOONLIMB", moon.map(|moon| moon.bright_limb_deg));
        let towards = moon.and_then(|moon| moon.direction);
        number("MOONDIRX", towards.map(|towards| towards[0]));
        number("MOONDIRY", towards.map(|towards| towards[1]));
        number("MOONDIRZ", towards.map(|towards| towards[2]));
        number("MOONDIRS", moon.and_then(|moon| moon.direction_sigma_deg));
        number("SOLVETIM", self.solve_us.map(|us| us as f64 * 1e-6));
        if let Some(mapping) = mapping {
            cards.push(Card::new("MAPKIND", mapping.kind));
        }
        if let Some(marks) = &self.marks {
            cards.push(Card::new("NMARKS", marks.len() as i64));
        }
        cards
    }
}

/// The keywords of what the telescope is to point at: what stays about the Sun.
pub fn target_cards(target: &Target) -> Vec<Card> {
    match target {
        Target::Fixed(place) => vec![
            Card::new("OBJECT", "Sun"),
            Card::new("TARGETX", place.x),
            Card::new("TARGETY", place.y),
        ],
        Target::Feature(_) => vec![Card::new("OBJECT", "a feature of the Sun")],
    }
}

/// The keywords of what a frame was taken with, and of the roll that its directions rest on.
pub fn instrument_cards(instrument: &Instrument, roll: Roll) -> Vec<Card> {
    let mounting = &instrument.mounting;
    let roll_deg = roll.about_boresight_deg(instrument);
    vec![
        Card::new("OBSRVTRY", instrument.name.as_str()),
        Card::new("TELESCOP", instrument.name.as_str()),
        Card::new("INSTRUME", "solar aspect camera"),
        Card::new("WAVELNTH", instrument.optics.wavelength_nm),
        Card::new("WAVEUNIT", "nm"),
        Card::new("CLOCKANG", mounting.clocking_deg.value),
        Card::new("PLATEDIR", mounting.directions.name()),
        Card::new("ROLLANG", roll_deg.value),
        Card::new("ROLLANSG", roll_deg.sigma),
        Card::new("BORE-X", mounting.boresight_mil.x),
        Card::new("BORE-Y", mounting.boresight_mil.y),
        Card::new("PLATEDST", instrument.optics.plate_distance_mm.value),
    ]
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

/// The marks and the limb's points of a frame, as tables for its file. Empty ones are left out.
pub fn tables(solution: &Solution) -> Vec<Table> {
    const SEEN: &str = "where it was seen, first pixel is 0";
    const EDGE: &str = "point of the limb, first pixel is 0";
    let column = |name: &str, unit: &str, meaning: &str, values: Values| Column {
        name: name.into(),
        unit: unit.into(),
        meaning: meaning.into(),
        values,
    };
    let mut tables = Vec::new();
    let marks = &solution.marks;
    if !marks.is_empty() {
        let floats =
            |of: fn(&crate::aspect::Mark) -> f64| Values::Float(marks.iter().map(of).collect());
        let whole = |of: fn(&crate::aspect::Mark) -> i32| {
            Values::Integer(marks.iter().map(|mark| i64::from(of(mark))).collect())
        };
        tables.push(Table {
            name: "MARKS".into(),
            columns: vec![
                column(
                    "I",
                    "",
                    "id of a mark that was read",
                    whole(|mark| mark.id.i),
                ),
                column(
                    "J",
                    "",
                    "id of a mark that was read",
                    whole(|mark| mark.id.j),
                ),
                column("X", "pixel", SEEN, floats(|mark| mark.at.x)),
                column("Y", "pixel", SEEN, floats(|mark| mark.at.y)),
                column(
                    "SIGMA",
                    "pixel",
                    "1 sigma per axis",
                    floats(|mark| mark.sigma_px()),
                ),
            ],
        });
    }
    if !solution.limb.is_empty() {
        let floats =
            |of: fn(&LimbPoint) -> f64| Values::Float(solution.limb.iter().map(of).collect());
        tables.push(Table {
            name: "LIMB".into(),
            columns: vec![
                column("X", "pixel", EDGE, floats(|point| point.at.x)),
                column("Y", "pixel", EDGE, floats(|point| point.at.y)),
                column(
                    "SIGMA",
                    "pixel",
                    "1 sigma along the radius",
                    floats(|point| point.sigma_px),
                ),
            ],
        });
    }
    tables
}
