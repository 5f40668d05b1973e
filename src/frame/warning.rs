//! Values of a frame's file that were not used as stored, and the count of such files in a run.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// A value of a frame's file that was not used as stored. Field and expectation together are its kind: neither contains a
/// part that differs from file to file.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Warning {
    /// A keyword, or a part of the file.
    pub field: String,
    pub expected: String,
    pub found: String,
}

impl Warning {
    pub fn new(
        field: impl Into<String>,
        expected: impl Into<String>,
        found: impl ToString,
    ) -> Self {
        Self {
            field: field.into(),
            expected: expected.into(),
            found: found.to_string(),
        }
    }
}

impl fmt::Display for Warning {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            field,
            expected,
            found,
        } = self;
        write!(out, "{field}: expected {expected}, found {found}")
    }
}

/// The warnings of a run. Each kind is logged on its first occurrence; all are counted.
#[derive(Debug, Default)]
pub struct Warnings {
    kinds: BTreeMap<(String, String), u64>,
}

impl Warnings {
    /// Counts the warnings of a file, and logs those of a new kind.
    pub fn note(&mut self, file: &str, warnings: &[Warning]) {
        for warning in warnings {
            let kind = (warning.field.clone(), warning.expected.clone());
            let files = self.kinds.entry(kind).or_default();
            if *files == 0 {
                tracing::warn!("{file}: {warning}");
            }
            *files += 1;
        }
    }

    /// Each kind in words, with its number of files.
    pub fn counts(&self) -> impl Iterator<Item = (String, u64)> {
        self.kinds
            .iter()
            .map(|((field, expected), files)| (format!("{field}: expected {expected}"), *files))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warnings_are_counted_by_kind_whatever_was_found() {
        let mut warnings = Warnings::default();
        for (file, found) in [("a.fits", "'High'"), ("b.fits", "'Low'")] {
            let gain = Warning::new("GAIN", "a finite number", found);
            let axes = Warning::new("NAXIS", "2", 3);
            warnings.note(file, &[gain, axes]);
        }
        let counts: Vec<_> = warnings.counts().collect();
        let kinds = ["GAIN: expected a finite number", "NAXIS: expected 2"];
        assert_eq!(counts, kinds.map(|kind| (kind.to_owned(), 2)));
    }
}
