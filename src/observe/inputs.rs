//! Time and place of frames, and inputs that were not used as they stand: copies, unreadable files, header values.

use super::copies::CopiedFrame;
use super::pass::Span;
use crate::frame::{FrameInfo, Unreadable, Warning, Warnings};
use crate::units::{Place, counted};
use jiff::Timestamp;
use serde::ser::SerializeMap;
use serde::{Deserialize, Serialize, Serializer};
use std::collections::BTreeMap;

/// Time and place of a frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct FrameFacts {
    /// Mid-exposure, ns since 1970.
    pub utc_ns: Option<i64>,
    pub monotonic_s: Option<f64>,
    pub number: Option<u64>,
    pub temperature_c: Option<f64>,
    /// Exposure time, s.
    pub exposure_s: Option<f64>,
    /// Latitude and longitude (deg) and height (m).
    place: Option<[f64; 3]>,
    /// Contents of the file that were not used as they stand.
    pub warnings: Vec<Warning>,
    /// The reason why the frame has no time although its file states one.
    pub untimed: Option<Warning>,
}

impl FrameFacts {
    pub fn of(info: &FrameInfo) -> Self {
        let nanoseconds = |utc: Timestamp| i64::try_from(utc.as_nanosecond()).ok();
        Self {
            utc_ns: info.mid_exposure.and_then(nanoseconds),
            monotonic_s: info.monotonic.map(|time| time.as_secs_f64()),
            number: info.number,
            temperature_c: info.camera_temperature_c,
            exposure_s: info.exposure.map(|exposure| exposure.as_secs_f64()),
            warnings: info.warnings.clone(),
            untimed: info.untimed.clone(),
            place: info
                .place
                .map(|place| [place.latitude_deg, place.longitude_deg, place.height_m]),
        }
    }

    /// A frame's reason: the reason why its time is not used, and its own.
    pub fn reason(&self, own: Option<&str>) -> String {
        let untimed = self.untimed.as_ref().map(|why| format!("time: {why}"));
        let own = own.map(str::to_owned);
        untimed
            .into_iter()
            .chain(own)
            .collect::<Vec<_>>()
            .join("; ")
    }

    pub fn utc(&self) -> Option<Timestamp> {
        Timestamp::from_nanosecond(self.utc_ns?.into()).ok()
    }

    pub fn place(&self) -> Option<Place> {
        let [latitude, longitude, height] = self.place?;
        Place::new(latitude, longitude, height).ok()
    }
}

/// Counts of inputs that were not used as they stand.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct InputSummary {
    /// Files with a copy of another file's frame.
    pub copies: usize,
    /// Files that could not be read.
    #[serde(flatten, serialize_with = "unreadable")]
    pub unreadable: Unreadable,
    /// Number of frames by the kind of warning.
    pub warnings: BTreeMap<String, u64>,
}

impl InputSummary {
    /// Number of files that gave a frame, of a total number.
    pub fn frames(&self, files: usize) -> usize {
        files - self.copies - self.unreadable.files()
    }

    /// For people.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if self.copies > 0 {
            let files = counted(self.copies as u64, "file");
            lines.push(format!("skipped: {files} with the same frames as others"));
        }
        lines.extend(self.unreadable.line());
        let warnings = self.warnings.iter();
        lines.extend(warnings.map(|(kind, files)| format!("{}: {kind}", counted(*files, "file"))));
        lines
    }
}

/// Files that could not be read: `unreadable`, and `unreadable_reasons` with the number for each reason.
fn unreadable<S: Serializer>(unreadable: &Unreadable, serializer: S) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(Some(2))?;
    map.serialize_entry("unreadable", &unreadable.files())?;
    map.serialize_entry("unreadable_reasons", unreadable.reasons())?;
    map.end()
}

/// Counts them while a camera's records are read.
#[derive(Default)]
pub struct InputNotes {
    summary: InputSummary,
    warnings: Warnings,
}

impl InputNotes {
    pub fn unreadable(&mut self, error: &str) {
        self.summary.unreadable.note(error);
    }

    pub fn read(&mut self, file: &str, facts: &FrameFacts) {
        self.warnings.note(file, &facts.warnings);
    }

    /// The copies within a span.
    pub fn copies<'a>(
        &mut self,
        copies: &'a [CopiedFrame],
        span: &Span,
    ) -> impl Iterator<Item = &'a CopiedFrame> {
        let within = copies.iter().filter(|copy| copy.is_in(span));
        let within: Vec<&CopiedFrame> = within.collect();
        self.summary.copies += within.len();
        within.into_iter()
    }

    pub fn finish(self) -> InputSummary {
        InputSummary {
            warnings: self.warnings.counts().collect(),
            ..self.summary
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warnings_and_unread_times_are_counted_by_kind_and_files_by_reason() {
        let untimed = Warning::new("DATE-OBS", "a UTC date and time", "'UNKNOWN'");
        let info = |found: &str| FrameInfo {
            warnings: vec![
                Warning::new("GAIN", "a finite number", found),
                untimed.clone(),
            ],
            untimed: Some(untimed.clone()),
            ..FrameInfo::default()
        };
        let mut notes = InputNotes::default();
        for found in ["'High'", "'Low'"] {
            let facts = FrameFacts::of(&info(found));
            notes.read("a.fits", &facts);
            let time = "time: DATE-OBS: expected a UTC date and time, found 'UNKNOWN'";
            assert_eq!(facts.reason(None), time);
            assert_eq!(
                facts.reason(Some("limb: dark")),
                format!("{time}; limb: dark")
            );
        }
        notes.unreadable("expected a FITS file, found an empty file");
        let summary = notes.finish();
        let lines = [
            "1 file could not be read, for expected a FITS file",
            "2 files: DATE-OBS: expected a UTC date and time",
            "2 files: GAIN: expected a finite number",
        ];
        assert_eq!(summary.lines(), lines);
        let json = serde_json::to_value(&summary).unwrap();
        assert_eq!(json["unreadable"], 1);
        assert_eq!(json["unreadable_reasons"]["expected a FITS file"], 1);
        assert_eq!(json["warnings"]["GAIN: expected a finite number"], 2);
        assert_eq!(summary.frames(3), 2);
    }
}
