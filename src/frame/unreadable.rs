//! The files of a run that could not be read, counted by reason.

use crate::units::counted;
use std::collections::BTreeMap;

/// Files that could not be read, by the reason in their error message.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Unreadable {
    reasons: BTreeMap<String, usize>,
}

impl Unreadable {
    /// Counts a file; the reason is its error without the part that differs from file to file.
    pub fn note(&mut self, error: &str) {
        let reason = error.split_once(", found ").map_or(error, |(kind, _)| kind);
        *self.reasons.entry(reason.into()).or_default() += 1;
    }

    pub fn add(&mut self, other: &Self) {
        for (reason, files) in &other.reasons {
            *self.reasons.entry(reason.clone()).or_default() += files;
        }
    }

    pub fn files(&self) -> usize {
        self.reasons.values().sum()
    }

    pub fn reasons(&self) -> &BTreeMap<String, usize> {
        &self.reasons
    }

    /// Their number and the most frequent reason, in words; `None` if there are none.
    pub fn line(&self) -> Option<String> {
        let most = self.reasons.iter().rev().max_by_key(|(_, files)| **files);
        most.map(|(reason, _)| {
            let files = counted(self.files() as u64, "file");
            let most = if self.reasons.len() > 1 { "most " } else { "" };
            format!("{files} could not be read, {most}for {reason}")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_counted_by_what_was_expected_of_them() {
        let mut unreadable = Unreadable::default();
        assert_eq!(unreadable.line(), None);
        for found in ["'High'", "'Low'"] {
            unreadable.note(&format!("GAIN: expected a finite number, found {found}"));
        }
        let all = "2 files could not be read, for GAIN: expected a finite number";
        assert_eq!(unreadable.line().as_deref(), Some(all));
        unreadable.note("expected a FITS file, found an empty file");
        let most = "3 files could not be read, most for GAIN: expected a finite number";
        assert_eq!(unreadable.line().as_deref(), Some(most));
    }
}
