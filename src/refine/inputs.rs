//! What of a camera's files was not used as it stands: copies, files that could not be read, values of headers.

use super::copies::CopiedFrame;
use super::first_pass::Span;
use super::record::FrameFacts;
use crate::frame::{Unreadable, Warnings};
use crate::units::counted;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;

/// Their counts.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct InputSummary {
    /// Files that hold a frame once more.
    pub copies: usize,
    /// Files that could not be read.
    #[serde(flatten, serialize_with = "unreadable")]
    pub unreadable: Unreadable,
    /// Frames by what of their files was not used.
    pub warnings: BTreeMap<String, u64>,
}

impl InputSummary {
    /// How many of so many files gave a frame.
    pub fn frames(&self, files: usize) -> usize {
        files - self.copies - self.unreadable.files()
    }

    /// For people.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if self.copies > 0 {
            let files = counted(self.copies as u64, "file");
            lines.push(format!("left out: {files} with the same frames as others"));
        }
        lines.extend(self.unreadable.line());
        let warnings = self.warnings.iter();
        lines.extend(warnings.map(|(kind, files)| format!("{}: {kind}", counted(*files, "file"))));
        lines
    }
}

/// Files that could not be read: `unreadable`, and `unreadable_reasons` with the count of each.
fn unreadable<S: Serializer>(unreadable: &Unreadable, serializer: S) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(Some(2))?;
    map.serialize_entry("unreadable", &unreadable.files())?;
    map.serialize_entry("unreadable_reasons", unreadable.reasons())?;
    map.end()
}

/// Counts them while a camera's records are read.
#[derive(Default)]
pub(super) struct InputNotes {
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
    use crate::frame::{FrameInfo, Warning};

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
