//! Finding of a check, as one line of the page.

use serde::Serialize;
use std::fmt;

/// Result of a check, from best to worst.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    Pass,
    /// A flight is possible, but the operator should know.
    Warn,
    Fail,
}

impl Verdict {
    /// Name on the page: failures are in capitals.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Warn => "warn",
            Self::Fail => "FAIL",
        }
    }
}

/// One line of the page.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// The part that was checked.
    pub check: String,
    pub verdict: Verdict,
    /// The finding.
    pub found: String,
    /// Remedy; empty if none is needed.
    pub remedy: String,
}

impl Finding {
    pub fn pass(check: impl Into<String>, found: impl Into<String>) -> Self {
        Self::new(check, Verdict::Pass, found, "")
    }

    pub fn warn(check: impl Into<String>, found: impl Into<String>, remedy: &str) -> Self {
        Self::new(check, Verdict::Warn, found, remedy)
    }

    pub fn fail(check: impl Into<String>, found: impl Into<String>, remedy: &str) -> Self {
        Self::new(check, Verdict::Fail, found, remedy)
    }

    pub fn new(
        check: impl Into<String>,
        verdict: Verdict,
        found: impl Into<String>,
        remedy: &str,
    ) -> Self {
        Self {
            check: check.into(),
            verdict,
            found: found.into(),
            remedy: remedy.into(),
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { check, found, .. } = self;
        write!(out, "{}  {check:<22} {found}", self.verdict.name())?;
        match self.remedy.as_str() {
            "" => Ok(()),
            remedy => write!(out, "\n      {:<22} -> {remedy}", ""),
        }
    }
}
