//! A number of a record, and its names in each form that contains it.

use super::LoggedRow;
use crate::fits::Card;
use crate::fits::keyword::{Keyword, Kind, Use, row};
use std::borrow::Cow;

/// A number or text of a frame: its meaning, and its names in each form that contains it.
#[derive(Clone, Copy)]
pub struct Number {
    value: Value,
    pub column: Option<(&'static str, Digits)>,
    pub keyword: Option<Keyword>,
    pub field: Option<Field>,
}

/// Function that takes the value from a row, by type.
#[derive(Clone, Copy)]
pub enum Value {
    Text(fn(&LoggedRow) -> Option<Cow<'_, str>>),
    Count(fn(&LoggedRow) -> Option<u64>),
    Number(fn(&LoggedRow) -> Option<f64>),
    Code(fn(&LoggedRow) -> u8),
}

/// Decimals of a number in CSV: a fixed number, or as many as represent it exactly.
#[derive(Clone, Copy)]
pub enum Digits {
    Six,
    Nine,
    All,
}

/// A field of the telemetry.
#[derive(Clone, Copy)]
pub struct Field {
    pub name: &'static str,
    pub unit: &'static str,
    pub meaning: &'static str,
    pub value: Value,
}

const fn say(value: Value) -> Number {
    Number {
        value,
        column: None,
        keyword: None,
        field: None,
    }
}

pub const fn text(value: fn(&LoggedRow) -> Option<Cow<'_, str>>) -> Number {
    say(Value::Text(value))
}

pub const fn count(value: fn(&LoggedRow) -> Option<u64>) -> Number {
    say(Value::Count(value))
}

pub const fn number(value: fn(&LoggedRow) -> Option<f64>) -> Number {
    say(Value::Number(value))
}

pub const fn code(value: fn(&LoggedRow) -> u8) -> Number {
    say(Value::Code(value))
}

impl Number {
    /// A column of the logs.
    pub const fn column(self, name: &'static str, digits: Digits) -> Self {
        let column = Some((name, digits));
        Self { column, ..self }
    }

    /// A keyword of FITS headers.
    pub const fn keyword(
        self,
        name: &'static str,
        unit: &'static str,
        meaning: &'static str,
    ) -> Self {
        let kind = match self.value {
            Value::Text(_) => Kind::Text,
            Value::Count(_) | Value::Code(_) => Kind::Integer,
            Value::Number(_) => Kind::Float,
        };
        let keyword = Some(row(name, kind, unit, Use::Written, meaning));
        Self { keyword, ..self }
    }

    /// A field of the telemetry.
    pub const fn field(
        self,
        name: &'static str,
        unit: &'static str,
        meaning: &'static str,
    ) -> Self {
        let field = Some(Field {
            name,
            unit,
            meaning,
            value: self.value,
        });
        Self { field, ..self }
    }

    /// The value in CSV; empty if it is not known.
    pub fn text(&self, row: &LoggedRow) -> String {
        let digits = self.column.map_or(Digits::All, |(_, digits)| digits);
        let text = match self.value {
            Value::Text(value) => value(row).map(Cow::into_owned),
            Value::Count(value) => value(row).map(|count| count.to_string()),
            Value::Code(value) => Some(value(row).to_string()),
            Value::Number(value) => value(row).and_then(|number| match digits {
                Digits::Six => Some(format!("{number:.6}")),
                Digits::Nine => Some(format!("{number:.9}")),
                Digits::All => number.is_finite().then(|| number.to_string()),
            }),
        };
        text.unwrap_or_default()
    }

    /// The value in a header; `None` if it is not finite.
    pub fn card(&'static self, row: &LoggedRow) -> Option<Card> {
        let keyword = self.keyword.as_ref()?;
        match self.value {
            Value::Text(value) => Some(Card::new(keyword, &*value(row)?)),
            Value::Count(value) => Some(Card::new(keyword, value(row)? as i64)),
            Value::Code(value) => Some(Card::new(keyword, i64::from(value(row)))),
            Value::Number(value) => {
                let number = value(row).filter(|number| number.is_finite())?;
                Some(Card::new(keyword, number))
            }
        }
    }
}
