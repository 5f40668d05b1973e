//! What of a camera's files was not used as it stands: copies, files that could not be read, values of headers.

use super::copies::CopiedFrame;
use super::first_pass::Span;
use super::record::FrameFacts;
use crate::archive::StoredFile;
use crate::frame::Warnings;
use crate::units::counted;
use serde::Serialize;
use std::collections::BTreeMap;

/// Their counts.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct InputSummary {
    /// Files that hold a frame once more.
    pub copies: usize,
    /// Files that could not be read.
    pub unreadable: usize,
    /// These by what was expected of them.
    pub unreadable_reasons: BTreeMap<String, usize>,
    /// Frames by what of their files was not used.
    pub warnings: BTreeMap<String, u64>,
}

impl InputSummary {
    /// How many of so many files gave a frame.
    pub fn frames(&self, files: usize) -> usize {
        files - self.copies - self.unreadable
    }

    /// For people.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if self.copies > 0 {
            let files = counted(self.copies as u64, "file");
            lines.push(format!("left out: {files} with the same frames as others"));
        }
        lines.extend(unreadable_line(&self.unreadable_reasons));
        let warnings = self.warnings.iter();
        lines.extend(warnings.map(|(kind, files)| format!("{}: {kind}", counted(*files, "file"))));
        lines
    }
}

/// How many files could not be read, and the most frequent reason; `None` of none.
pub fn unreadable_line(reasons: &BTreeMap<String, usize>) -> Option<String> {
    let files: usize = reasons.values().sum();
    let most = reasons.iter().rev().max_by_key(|(_, files)| **files);
    most.map(|(reason, _)| {
        let files = counted(files as u64, "file");
        let most = if reasons.len() > 1 { "most " } else { "" };
        format!("{files} could not be read, {most}for {reason}")
    })
}

/// An error without what differs from file to file.
pub fn kind_of_error(error: &str) -> &str {
    error.split_once(", found ").map_or(error, |(kind, _)| kind)
}

/// Counts them while a camera's records are read.
#[derive(Default)]
pub(super) struct InputNotes {
    summary: InputSummary,
    warnings: Warnings,
}

impl InputNotes {
    pub fn unreadable(&mut self, error: &str) {
        self.summary.unreadable += 1;
        let reasons = &mut self.summary.unreadable_reasons;
        *reasons.entry(kind_of_error(error).into()).or_default() += 1;
    }

    pub fn read(&mut self, file: &str, facts: &FrameFacts) {
        self.warnings.note(file, &facts.warnings);
        self.warnings.note(file, facts.untimed.as_slice());
    }

    /// The copies within a span, each with the reason of its row.
    pub fn copies(&mut self, copies: &[CopiedFrame], span: &Span) -> Vec<(StoredFile, String)> {
        let copies = copies.iter().filter(|copy| copy.is_in(span));
        let rows: Vec<_> = copies
            .map(|copy| (copy.input.clone(), copy.reason()))
            .collect();
        self.summary.copies += rows.len();
        rows
    }

    pub fn finish(self) -> InputSummary {
        InputSummary {
            warnings: self.warnings.counts().collect(),
            ..self.summary
        }
    }
}
