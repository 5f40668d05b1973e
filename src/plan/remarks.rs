//! Collects all errors and unusual values of a configuration.

use crate::bounded::within;
use crate::instrument::TomlError;
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Duration;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    Error,
    /// It would fly, though perhaps not as intended.
    Warning,
}

/// An error in a configuration, or an unusual value.
#[derive(Debug, Clone, PartialEq)]
pub struct Remark {
    pub severity: Severity,
    pub what: TomlError,
    /// Remedy.
    pub remedy: &'static str,
}

/// Time allowed for a disk: listing a folder with a day's frames may take seconds.
const TIMEOUT: Duration = Duration::from_secs(20);
const PARAMETERS: &str = "see docs/parameters.md";
const BUILD: &str = "take a program built with `--features gige`, or another camera";

impl fmt::Display for Remark {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let severity = match self.severity {
            Severity::Error => "error",
            Severity::Warning => "warning",
        };
        write!(out, "{severity}: {}", self.what)
    }
}

/// Errors of a plan, one per line.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct Faulty(String);

/// The remarks on a configuration, in the order of the checks.
#[derive(Debug, Clone, Default)]
pub struct Remarks {
    file: PathBuf,
    pub list: Vec<Remark>,
}

impl Remarks {
    /// An empty list of remarks on a file.
    pub(super) fn of(file: &Path) -> Self {
        Self {
            file: file.into(),
            list: Vec::new(),
        }
    }

    fn add(&mut self, severity: Severity, what: TomlError) {
        let remedy = match what.path == self.file {
            true => PARAMETERS,
            false => "name a file that is there and sound",
        };
        self.list.push(Remark {
            severity,
            what,
            remedy,
        });
    }

    /// An error in a key of the configuration.
    pub(super) fn error(
        &mut self,
        key: &str,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) {
        let what = TomlError::new(&self.file, key, expected, found);
        self.add(Severity::Error, what);
    }

    pub(super) fn warn(
        &mut self,
        key: &str,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) {
        let what = TomlError::new(&self.file, key, expected, found);
        self.add(Severity::Warning, what);
    }

    /// An error in a file.
    pub(super) fn wrong(&mut self, what: TomlError) {
        self.add(Severity::Error, what);
    }

    /// A source of frames that this program was built without.
    pub(super) fn not_built(&mut self, key: &str, found: String) {
        let expected = "a program built with `--features gige` for such a camera";
        self.list.push(Remark {
            severity: Severity::Error,
            what: TomlError::new(&self.file, key, expected, found),
            remedy: BUILD,
        });
    }

    /// Returns a value of a file, or adds the error to the remarks.
    pub(super) fn noted<T>(&mut self, result: Result<T, TomlError>) -> Option<T> {
        result.map_err(|what| self.add(Severity::Error, what)).ok()
    }

    /// Result of `work`, or an error in a key of the configuration if the disk that it reads hangs.
    pub(super) fn answered<T: Send + 'static>(
        &mut self,
        key: &str,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Option<T> {
        within(TIMEOUT, work)
            .map_err(|none| self.error(key, "a disk that answers", none.to_string()))
            .ok()
    }

    pub fn errors(&self) -> impl Iterator<Item = &Remark> {
        let is_error = |remark: &&Remark| remark.severity == Severity::Error;
        self.list.iter().filter(is_error)
    }

    pub fn has_errors(&self) -> bool {
        self.errors().next().is_some()
    }

    /// Whether the plan may fly.
    ///
    /// # Errors
    /// All errors of the plan.
    pub fn without_errors(&self) -> Result<(), Faulty> {
        let errors: Vec<String> = self.errors().map(|one| one.what.to_string()).collect();
        match errors.is_empty() {
            true => Ok(()),
            false => Err(Faulty(errors.join("\n"))),
        }
    }
}
