//! A flight as shown to one viewer at a time: the objects of the pages, as JSON.

use super::history::{Alarm, GYROS, HOUSEKEEPING, History, RECEIVED, SILENCE_S};
use super::pictures::camera_name;
use super::rules::{Severity, gyros_against_sun};
use super::table::{Nanoseconds, nanoseconds, timestamp};
use super::table::{Table, row_at};
use crate::link::housekeeping::{FIELDS, Field};
use crate::link::message::ERROR_CODES;
use crate::link::picture::TagValue;
use jiff::Timestamp;
use serde_json::{Map, Value, json};

/// Time for which ended alarms are shown.
const ENDED_NS: i64 = 24 * 3600 * 1_000_000_000;
const MOST_ALARMS: usize = 50;
const FEW_ALARMS: usize = 3;

/// Fields that are sent to a viewer on a slow line.
const MAIN_FIELDS: [&str; 16] = [
    "uptime_s",
    "taken",
    "fine",
    "coarse",
    "none",
    "quality",
    "azimuth_deg",
    "elevation_deg",
    "offset_sigma_deg",
    "exposure_us",
    "disc_dn",
    "marks",
    "limb_points",
    "stored",
    "lost",
    "solutions",
];

/// Level of detail for a viewer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Detail {
    All,
    /// For a slow line: the last alarms, the main fields.
    Main,
}

/// A time in the format of the pages.
pub fn utc(time: Nanoseconds) -> String {
    format!("{:.3}", timestamp(time))
}

/// The flight at a time, or at its newest; `now` is the ground's clock, which determines the age of received data.
#[derive(Clone, Copy)]
pub struct View<'a> {
    pub history: &'a History,
    pub at: Option<Nanoseconds>,
    pub now: Timestamp,
    /// Whether more data may arrive: then silence is a fault.
    pub is_live: bool,
}

impl View<'_> {
    /// State line: present alarms in words, the alarms so far, and the line's load.
    pub fn state(&self, bits_per_s: u64, viewers: usize, detail: Detail) -> Value {
        let row = self.history.row(self.at);
        let mut findings = self.silence().into_iter().collect::<Vec<_>>();
        findings.extend(row.map_or(Vec::new(), |row| self.history.findings(row)));
        let severity = findings.iter().map(|found| found.severity).max();
        let severity = severity.unwrap_or(match row {
            Some(_) => Severity::Good,
            None => Severity::Attention,
        });
        let sentences = match findings.is_empty() {
            true => vec![self.nothing_found(row)],
            false => findings.iter().map(sentence).collect(),
        };
        let line = &self.history.line;
        json!({
            "now": format!("{:.3}", self.now),
            "view": self.time().map(utc),
            "severity": severity.name(),
            "sentences": sentences,
            "alarms": self.alarms(detail),
            "line": {
                "packets": line.packets,
                "rejected": line.rejected,
                "missing": line.missing,
                "doubled": line.doubled,
                "late": line.late,
                "doubtful": line.doubtful,
                "bits_per_s": bits_per_s,
            },
            "viewers": viewers,
        })
    }

    /// The time shown.
    fn time(&self) -> Option<Nanoseconds> {
        self.at
            .or_else(|| self.history.span().map(|(_, last)| last))
    }

    /// The state without findings: all is well, or nothing is known.
    fn nothing_found(&self, row: Option<usize>) -> Value {
        let Some(row) = row else {
            let words = "no housekeeping has come yet";
            return json!({"rule": null, "severity": "attention", "words": words, "since": null});
        };
        let rows = &self.history.housekeeping;
        let wrong = (0..row).rev().find(|row| rows.flags[*row] != 0);
        let since = utc(rows.times[wrong.map_or(0, |wrong| wrong + 1)]);
        json!({"rule": null, "severity": "good", "words": "all is well", "since": since})
    }

    /// The alarm for missing housekeeping, now or at the given time.
    fn silence(&self) -> Option<Alarm> {
        let rows = &self.history.housekeeping;
        let row = self.history.row(self.at)?;
        let silent_s = match self.at {
            Some(at) => (at - rows.times[row]) / 1_000_000_000,
            None if self.is_live => (nanoseconds(self.now) - rows.arrived[row]) / 1_000_000_000,
            None => 0,
        };
        (silent_s >= SILENCE_S).then(|| Alarm {
            rule: "silence",
            severity: Severity::Alarm,
            words: format!("no housekeeping for {silent_s} s"),
            since: rows.times[row],
            until: None,
        })
    }

    fn alarms(&self, detail: Detail) -> Vec<Value> {
        let most = match detail {
            Detail::All => MOST_ALARMS,
            Detail::Main => FEW_ALARMS,
        };
        let time = self.time().unwrap_or_default();
        let is_of_view = |alarm: &&Alarm| {
            let is_recent = alarm.until.is_none_or(|until| until > time - ENDED_NS);
            alarm.severity == Severity::Alarm && alarm.since <= time && is_recent
        };
        let silence = self.silence();
        let all = self.history.alarms.iter().rev().filter(is_of_view);
        let shown = silence.iter().chain(all).take(most);
        shown
            .map(|alarm| {
                let mut alarm = alarm.clone();
                alarm.until = alarm.until.filter(|until| *until <= time);
                alarm_json(&alarm)
            })
            .collect()
    }

    /// The housekeeping at the time, with its fields by name.
    pub fn housekeeping(&self, detail: Detail) -> Option<Value> {
        let rows = &self.history.housekeeping;
        let row = self.history.row(self.at)?;
        let housekeeping = rows.at_row(row)?;
        let gyros = gyros_against_sun(&housekeeping).filter(|_| detail == Detail::All);
        let values = housekeeping.csv_row();
        let is_shown = |field: &&Field| detail == Detail::All || MAIN_FIELDS.contains(&field.name);
        let fields = FIELDS
            .iter()
            .zip(values)
            .filter(|(field, _)| is_shown(field));
        let time = rows.times[row];
        let value = |field: &Field, text: &str| match field.name {
            // Ids of other plates come in separate packets.
            "ids" if text.is_empty() => json!(self.history.ids_beside(time)),
            _ => field_json(field, text),
        };
        let fields: Map<String, Value> = fields
            .map(|(field, text)| (field.name.to_owned(), value(field, &text)))
            .collect();
        Some(json!({
            "time": utc(time),
            "arrived": utc(rows.arrived[row]),
            "fields": fields,
            "gyros_against_sun": gyros,
        }))
    }

    /// The last solution: as received, else from the log of an archive.
    pub fn solution(&self) -> Option<Value> {
        let received = self.offset(RECEIVED, "", self.history.solution_arrived);
        received.or_else(|| self.logged_solution())
    }

    fn logged_solution(&self) -> Option<Value> {
        let mut found = self.offset("solutions", "offset_", None)?;
        let time = self.at.unwrap_or(Nanoseconds::MAX);
        let frames = &self.history.frames;
        let frame = frames
            .partition_point(|frame| frame.time <= time)
            .checked_sub(1);
        let frame = frame.map(|frame| &frames[frame]);
        let reason = frame.and_then(|frame| self.history.reasons.get(usize::from(frame.reason?)));
        found["quality"] = json!(frame.map(|frame| frame.quality));
        found["reason"] = json!(reason);
        Some(found)
    }

    /// The last offset by gyros.
    pub fn gyros(&self) -> Option<Value> {
        let received = self.offset(GYROS, "", self.history.gyros_arrived);
        received.or_else(|| self.offset("propagated", "", None))
    }

    /// The offset in the last row of a table whose columns have a prefix.
    fn offset(&self, table: &str, prefix: &str, arrived: Option<Nanoseconds>) -> Option<Value> {
        let table: &Table = self.history.tables.get(table)?;
        let row = row_at(table.times(), self.at.unwrap_or(Nanoseconds::MAX))?;
        let time = table.times()[row];
        let number = |name: &str| table.value(row, &format!("{prefix}{name}"));
        let arcsec = |name: &str| number(name).map(|deg| deg * 3600.0);
        let age_ms = number("age_ms").or_else(|| number("age_s").map(|s| 1e3 * s));
        let code = number("error_code");
        let arrived = arrived.filter(|_| self.at.is_none()).unwrap_or(time);
        Some(json!({
            "time": utc(time),
            "arrived": utc(arrived),
            "quality": code.is_none().then_some("sent"),
            "azimuth_deg": number("azimuth_deg"),
            "elevation_deg": number("elevation_deg"),
            "cross_elevation_deg": number("cross_elevation_deg"),
            "roll_deg": table.value(row, "roll_deg"),
            "sigma_deg": number("sigma_deg"),
            "azimuth_arcsec": arcsec("azimuth_deg"),
            "elevation_arcsec": arcsec("elevation_deg"),
            "sigma_arcsec": arcsec("sigma_deg"),
            "age_ms": age_ms,
            "reason": code.map(|code| error_in_words(code as u16)),
        }))
    }

    /// The picture of each camera.
    pub fn pictures(&self) -> Vec<Value> {
        let cameras = self.history.cameras().into_iter();
        cameras.filter_map(|camera| self.picture(camera)).collect()
    }

    fn picture(&self, camera: u8) -> Option<Value> {
        let picture = self.history.picture(camera, self.at)?;
        let tags: Map<String, Value> = picture
            .tags
            .iter()
            .map(|tag| {
                let value = match &tag.value {
                    TagValue::Text(text) => json!(text),
                    TagValue::Whole(value) => json!(value),
                    TagValue::Number(value) => json!(value),
                };
                (
                    tag.name.clone(),
                    json!({"value": value, "comment": tag.comment}),
                )
            })
            .collect();
        Some(json!({
            "camera": camera,
            "name": camera_name(camera),
            "width": picture.width,
            "height": picture.height,
            "received": picture.received,
            "pixels": picture.width * picture.height,
            "time": utc(picture.time),
            "arrived": utc(picture.arrived),
            "version": picture.version,
            "tags": tags,
            "file": null,
        }))
    }

    /// The archive's last frame at the time, in place of a picture of the first camera.
    pub fn frame(&self) -> Option<Value> {
        let frame = self.history.stored_frame(self.at)?;
        let arrived = self.history.frame_read.filter(|_| self.at.is_none());
        Some(json!({
            "camera": 1,
            "name": camera_name(1),
            // A frame is either complete or missing.
            "width": 0,
            "height": 0,
            "received": 0,
            "pixels": 0,
            "time": utc(frame.time),
            "arrived": utc(arrived.unwrap_or(frame.time)),
            "version": frame.time / 1_000_000,
            "tags": {},
            "file": frame.file,
        }))
    }
}

fn sentence(alarm: &Alarm) -> Value {
    json!({
        "rule": alarm.rule,
        "severity": alarm.severity.name(),
        "words": alarm.words,
        "since": utc(alarm.since),
    })
}

fn alarm_json(alarm: &Alarm) -> Value {
    let since = utc(alarm.since);
    let mut json = sentence(alarm);
    json["id"] = json!(format!("{}@{since}", alarm.rule));
    json["until"] = json!(alarm.until.map(utc));
    json
}

/// Why there is no solution.
fn error_in_words(code: u16) -> &'static str {
    ERROR_CODES.meaning(code).unwrap_or("unknown error")
}

/// A field's text as JSON: a number if it has one, null if unknown.
fn field_json(field: &Field, text: &str) -> Value {
    let number = |text: &str| text.parse().map_or(Value::Null, |value: f64| json!(value));
    match field.is_number {
        true => number(text),
        false if text.is_empty() => Value::Null,
        false => json!(text),
    }
}

/// Every field, by its table; those without numbers cannot be plotted.
pub fn fields(history: &History) -> Vec<Value> {
    let field = |table: &str, name: &str, unit: &str, documentation: &str| {
        json!({
            "table": table,
            "name": name,
            "field": format!("{table}.{name}"),
            "unit": unit,
            "documentation": documentation,
            "number": true,
        })
    };
    let fields = FIELDS.iter().map(|one| {
        let mut json = field(HOUSEKEEPING, one.name, one.unit, &one.documentation());
        json["number"] = json!(one.is_number);
        json
    });
    let tables = history
        .tables
        .values()
        .filter(|table| !table.times().is_empty());
    let columns = tables.flat_map(|table| {
        let columns = table.columns.iter();
        columns.map(|column| {
            field(
                &table.name,
                &column.name,
                &column.unit,
                &column.documentation,
            )
        })
    });
    fields.chain(columns).collect()
}
