//! Values of a header, each checked when it is used: one that cannot be used gives a warning, and the frame is read without it.

use super::Problem;
use super::header::{Header, Value};
use crate::frame::Warning;
use std::ops::RangeInclusive;

/// A header that is read value by value.
pub(super) struct Values<'a> {
    pub header: &'a Header,
    pub warnings: Vec<Warning>,
}

impl<'a> Values<'a> {
    pub fn of(header: &'a Header) -> Self {
        Self {
            header,
            warnings: Vec::new(),
        }
    }

    pub fn warn(&mut self, warning: Warning) {
        self.warnings.push(warning);
    }

    /// The value that `read` gives; if there is none, the first warning about it.
    pub fn reading<T>(
        &mut self,
        read: impl FnOnce(&mut Self) -> Option<T>,
    ) -> (Option<T>, Option<Warning>) {
        let before = self.warnings.len();
        let found = read(self);
        let why = self.warnings.get(before).filter(|_| found.is_none());
        (found, why.cloned())
    }

    /// A finite number. One in quotes is accepted, with a warning.
    pub fn number(&mut self, keyword: &str) -> Option<f64> {
        match self.header.number(keyword) {
            Ok(number) => number,
            Err(problem) => {
                let quoted = match self.header.get(keyword) {
                    Some(Value::Text(text)) => text.trim().parse().ok(),
                    _ => None,
                };
                self.warn(problem.into());
                quoted.filter(|number: &f64| number.is_finite())
            }
        }
    }

    /// The first of some keywords that has a number.
    pub fn first_number<const N: usize>(&mut self, keywords: [&str; N]) -> Option<f64> {
        keywords
            .into_iter()
            .find_map(|keyword| self.number(keyword))
    }

    /// A number in a range; `expected` describes it.
    pub fn within(
        &mut self,
        keyword: &str,
        range: RangeInclusive<f64>,
        expected: &str,
    ) -> Option<f64> {
        let number = self.number(keyword)?;
        let is_within = range.contains(&number);
        if !is_within {
            self.warn(Warning::new(keyword, expected, number));
        }
        is_within.then_some(number)
    }

    /// A non-negative integer.
    pub fn whole(&mut self, keyword: &str) -> Option<u64> {
        /// Beyond this a floating-point number is not exact.
        const MOST: f64 = 9e15;
        if let Some(Value::Integer(number @ 0..)) = self.header.get(keyword) {
            return Some(number.unsigned_abs());
        }
        let number = self.number(keyword)?;
        if number.fract() != 0.0 || !(0.0..MOST).contains(&number) {
            self.warn(Warning::new(keyword, "a whole number from 0", number));
            return None;
        }
        Some(number as u64)
    }

    /// A text unchanged; one without quotes is accepted, with a warning.
    pub fn date(&mut self, keyword: &str) -> Option<String> {
        self.header.text(keyword).unwrap_or_else(|problem| {
            self.warn(problem.into());
            self.header.unquoted(keyword).map(str::to_owned)
        })
    }

    /// A text that is not blank.
    pub fn text(&mut self, keyword: &str) -> Option<String> {
        let text = self.header.text(keyword).unwrap_or_else(|problem| {
            self.warn(problem.into());
            None
        });
        text.filter(|text| !text.trim().is_empty())
    }
}

impl From<Problem> for Warning {
    fn from(problem: Problem) -> Self {
        match problem {
            Problem::Field {
                field,
                expected,
                found,
            } => Self::new(field, expected, found),
            Problem::Content { expected, found } => Self::new("file", expected, found),
            Problem::Io { action, cause } => Self::new("file", format!("to {action} it"), cause),
        }
    }
}
