//! One row of the parameter table: a parameter, its type and its range.

use super::Config;
use super::value::{Value, found};
use crate::camera::Source;
use crate::clock::parse_utc;
use crate::frame::Region;
use crate::instrument::toml_file::Utc;
use crate::output::Destination;
use std::borrow::Cow;
use std::fmt;

/// A parameter of the configuration.
#[derive(Clone)]
pub struct Parameter {
    /// Dotted path in the TOML file; its last word ends in the unit, if there is one.
    pub key: &'static str,
    /// Empty for counts, names and quantities on the camera's own scale.
    pub unit: &'static str,
    pub allowed: Allowed,
    /// The number by which the ground sets it in flight (aspect commands 0x0712 and 0x0722).
    pub command: Option<u16>,
    pub documentation: &'static str,
    /// Value in the example, commented out, if there is no default.
    pub(super) sample: Option<Sample>,
    /// Gets the field's value; for a camera or an output, that of the given table.
    pub(super) get: fn(&Config, &str) -> Option<Value>,
    /// Sets the field; `None` if its type cannot hold the value.
    pub(super) set: fn(&mut Config, &str, Option<Value>) -> Option<()>,
}

/// A value to show.
#[derive(Debug, Clone, Copy)]
pub(super) enum Sample {
    Number(f64),
    Text(&'static str),
}

impl fmt::Display for Sample {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(value) => write!(out, "{value}"),
            Self::Text(value) => write!(out, "{value:?}"),
        }
    }
}

/// The values that a parameter may take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Allowed {
    /// A number within these limits.
    Number(f64, f64),
    /// A whole number within these limits.
    Whole(i64, i64),
    /// One of these names.
    Name(&'static [&'static str]),
    /// Any text.
    Text,
    /// An instant.
    Utc,
    /// A part of the sensor.
    Region,
    /// A source of frames.
    Source,
    /// A destination of an output.
    Destination,
}

impl Allowed {
    fn allows(self, value: &Value) -> bool {
        match (self, value) {
            (Self::Number(low, high), Value::Number(value)) => (low..=high).contains(value),
            (Self::Number(low, high), Value::Whole(value)) => {
                (low..=high).contains(&(*value as f64))
            }
            (Self::Whole(low, high), Value::Whole(value)) => (low..=high).contains(value),
            (Self::Name(names), Value::Text(value)) => names.contains(&value.as_str()),
            (Self::Text, Value::Text(_)) => true,
            // An empty text sets nothing.
            (Self::Source, Value::Text(text)) => text.is_empty() || text.parse::<Source>().is_ok(),
            (Self::Destination, Value::Text(text)) => {
                text.is_empty() || text.parse::<Destination>().is_ok()
            }
            (Self::Region, Value::Text(text)) => text.is_empty() || text.parse::<Region>().is_ok(),
            (Self::Utc, Value::Text(text)) => text.is_empty() || parse_utc(text).is_ok(),
            _ => false,
        }
    }
}

/// Reason why a parameter was not set: expected and found value.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key}: expected {expected}, found {found}")]
pub struct Refused {
    pub key: Cow<'static, str>,
    pub expected: String,
    pub found: String,
}

impl Parameter {
    /// The table of the file that holds the parameter.
    pub fn table(&self) -> &'static str {
        self.key.split_once('.').map_or("", |(table, _)| table)
    }

    /// The parameter's name within its table.
    pub fn name(&self) -> &'static str {
        self.key.split_once('.').map_or(self.key, |(_, name)| name)
    }

    /// The value in a configuration; `None` if it is not set.
    pub fn get(&self, config: &Config) -> Option<Value> {
        self.get_of(config, self.table())
    }

    /// The same for the table of another camera or output.
    pub(super) fn get_of(&self, config: &Config, table: &str) -> Option<Value> {
        (self.get)(config, table)
    }

    /// The value of `Config::default()`.
    pub fn default(&self) -> Option<Value> {
        self.get(&Config::default())
    }

    /// Sets the value; `None` unsets a parameter that is optional.
    ///
    /// # Errors
    /// If the value has another type or is not allowed, or is missing but required.
    pub fn set(&self, config: &mut Config, value: Option<Value>) -> Result<(), Refused> {
        self.set_of(config, self.table(), value)
    }

    fn set_of(
        &self,
        config: &mut Config,
        table: &str,
        value: Option<Value>,
    ) -> Result<(), Refused> {
        let shown = value.as_ref().map_or("nothing".into(), Value::to_string);
        if value
            .as_ref()
            .is_none_or(|value| self.allowed.allows(value))
        {
            (self.set)(config, table, value).ok_or_else(|| self.refused(shown))
        } else {
            Err(self.refused(shown))
        }
    }

    /// As [`set`](Self::set), for the camera or output of a table, if the parameter belongs to one.
    pub(super) fn set_from_toml(
        &self,
        config: &mut Config,
        table: &str,
        value: &toml::Value,
    ) -> Result<(), Refused> {
        match (self.allowed, Value::from_toml(value), value) {
            (_, Some(value), _) => self.set_of(config, table, Some(value)),
            // A time without quotes is accepted like one with quotes: see `Utc`.
            (Allowed::Utc, _, toml::Value::Datetime(time)) => {
                self.set_of(config, table, Some(Value::Text(time.to_string())))
            }
            _ => Err(self.refused(found(value))),
        }
    }

    /// The allowed values in words, without the unit.
    pub fn range(&self) -> String {
        match self.allowed {
            Allowed::Number(low, high) => format!("{low} to {high}"),
            Allowed::Whole(low, high) => format!("{low} to {high}"),
            Allowed::Name(names) => listed(names),
            Allowed::Text => "any text".into(),
            Allowed::Source => Source::EXPECTED.into(),
            Allowed::Region => {
                r#"column and row of its corner, width and height, such as "100,50,640,480""#.into()
            }
            Allowed::Destination => Destination::EXPECTED.into(),
            Allowed::Utc => Utc::EXPECTED.into(),
        }
    }

    fn refused(&self, found: String) -> Refused {
        let unit = self.unit;
        let expected = match self.allowed {
            Allowed::Number(..) => format!("a number from {} {unit}", self.range()),
            Allowed::Whole(..) => format!("a whole number from {} {unit}", self.range()),
            Allowed::Name(_)
            | Allowed::Utc
            | Allowed::Region
            | Allowed::Source
            | Allowed::Destination => self.range(),
            Allowed::Text => "a text".into(),
        };
        Refused {
            key: self.key.into(),
            expected: expected.trim_end().into(),
            found,
        }
    }
}

/// Names in quotes: "a", "b" or "c".
fn listed(names: &[&str]) -> String {
    let quoted: Vec<String> = names.iter().map(|name| format!("{name:?}")).collect();
    match quoted.split_last() {
        Some((last, rest)) if !rest.is_empty() => format!("{} or {last}", rest.join(", ")),
        _ => quoted.concat(),
    }
}
