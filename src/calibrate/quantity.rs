//! One quantity of a calibration: stated value, found value, new value.

use super::numbers::{sigma_text, value_text};
use super::revision::{Provenance, Revision};
use crate::report::html::Page;
use crate::units::Measured;
use std::fmt;

/// Whether a quantity is determined.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The new instrument takes the found value.
    Determined,
    /// The new instrument keeps the stated value.
    Kept,
}

/// A quantity, a number or a pair, with its verdict.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibratedQuantity {
    pub name: &'static str,
    /// Dotted key in the instrument's file; none if the quantity has no value there.
    pub key: Option<&'static str>,
    pub unit: &'static str,
    /// Stated values; empty if the instrument states none.
    pub stated: Vec<f64>,
    /// Found values; empty if none were found.
    pub found: Vec<f64>,
    /// 1 sigma of the found values, per axis.
    pub sigma: f64,
    pub verdict: Verdict,
    /// For people, in one sentence.
    pub remark: String,
}

impl CalibratedQuantity {
    /// A verdict on a quantity without a value.
    pub fn without_value(name: &'static str, verdict: Verdict, remark: impl Into<String>) -> Self {
        Self {
            name,
            key: None,
            unit: "",
            stated: Vec::new(),
            found: Vec::new(),
            sigma: 0.0,
            verdict,
            remark: remark.into(),
        }
    }

    /// A measured number with a remark on the method, or the reason why it was not measured.
    pub fn measured(
        (name, key, unit): (&'static str, &'static str, &'static str),
        found: Result<Measured, String>,
        remark: impl Into<String>,
    ) -> Self {
        let (key, unit) = (Some(key), unit);
        match found {
            Ok(Measured { value, sigma }) => Self {
                key,
                unit,
                found: vec![value],
                sigma,
                ..Self::without_value(name, Verdict::Determined, remark)
            },
            Err(reason) => {
                let remark = format!("{reason}; keeps the instrument's value");
                Self {
                    key,
                    unit,
                    ..Self::without_value(name, Verdict::Kept, remark)
                }
            }
        }
    }

    /// Writes determined values into an instrument's file.
    pub fn revise(&self, revision: &mut Revision, provenance: &Provenance) {
        let (Some(key), Verdict::Determined) = (self.key, self.verdict) else {
            return;
        };
        match self.found[..] {
            [value] => revision.set_measured(key, Measured::new(value, self.sigma), provenance),
            [x, y] => revision.set_pair(key, [x, y], self.sigma, provenance),
            _ => {}
        }
    }

    /// The found numbers: to as many digits as the stated ones, or without these to two digits of the sigma.
    fn found_text(&self) -> String {
        match (&self.stated[..], &self.found[..], self.verdict) {
            ([], [value], Verdict::Determined) => value_text(Measured::new(*value, self.sigma)),
            _ => numbers(&self.found),
        }
    }

    /// Quantities as a table of a page.
    pub fn table(page: &mut Page, quantities: &[Self]) {
        let row = |q: &Self| {
            let with_unit = |numbers: String| match numbers.as_str() {
                "" => numbers,
                _ => format!("{numbers} {}", q.unit),
            };
            // Undetermined values are not printed.
            let (found, sigma) = match q.verdict {
                Verdict::Determined if !q.found.is_empty() => {
                    (with_unit(q.found_text()), sigma_text(q.sigma))
                }
                Verdict::Determined | Verdict::Kept => Default::default(),
            };
            let stated = with_unit(numbers(&q.stated));
            vec![q.name.into(), stated, found, sigma, q.remark.clone()]
        };
        let rows: Vec<_> = quantities.iter().map(row).collect();
        let heads = ["quantity", "stated", "found", "1 sigma", "verdict"];
        page.table(&heads, &rows);
    }
}

fn numbers(values: &[f64]) -> String {
    let texts: Vec<String> = values.iter().map(|v| format!("{v:.4}")).collect();
    texts.join(", ")
}

/// As one line of text.
impl fmt::Display for CalibratedQuantity {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            name, unit, remark, ..
        } = self;
        write!(out, "{name}: ")?;
        let (stated, found, sigma) = (
            numbers(&self.stated),
            self.found_text(),
            sigma_text(self.sigma),
        );
        match (stated.as_str(), found.as_str(), self.verdict) {
            ("", "", _) => {}
            ("", found, Verdict::Determined) => write!(out, "{found} +- {sigma} {unit}; ")?,
            ("", found, Verdict::Kept) => write!(out, "{found} {unit}; ")?,
            (stated, found, Verdict::Determined) => {
                write!(out, "{stated} -> {found} {unit} +- {sigma}; ")?;
            }
            (stated, _, Verdict::Kept) => write!(out, "{stated} {unit}; ")?,
        }
        write!(out, "{remark}")
    }
}
