//! Values of parameters, and their conversion to and from the typed fields of the configuration.

use super::{Memory, Switch};
use crate::archive::{Overflow, Sharing};
use crate::camera::{PixelFormat, Source};
use crate::clock::parse_utc;
use crate::fits::Compression;
use crate::frame::Region;
use crate::instrument::Role;
use crate::output::{Destination, Format};
use jiff::Timestamp;
use std::fmt;
use std::path::PathBuf;

/// The value of a parameter.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    Whole(i64),
    Number(f64),
    Text(String),
}

impl fmt::Display for Value {
    /// In the form of TOML.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Whole(value) => write!(out, "{value}"),
            Self::Number(value) => write!(out, "{value}"),
            Self::Text(value) => write!(out, "{value:?}"),
        }
    }
}

impl Value {
    /// The value in a file, if parameters can have its type.
    pub fn from_toml(value: &toml::Value) -> Option<Self> {
        match value {
            toml::Value::Integer(value) => Some(Self::Whole(*value)),
            toml::Value::Float(value) => Some(Self::Number(*value)),
            toml::Value::String(value) => Some(Self::Text(value.clone())),
            _ => None,
        }
    }
}

/// A value of a file for an error message: on one line.
pub(super) fn found(value: &toml::Value) -> String {
    match Value::from_toml(value) {
        Some(value) => value.to_string(),
        None => format!("a value of type {}", value.type_str()),
    }
}

/// A field of the configuration: `None` means that nothing is set.
pub(super) trait Field: Sized {
    fn value(&self) -> Option<Value>;

    /// The field from a value, if the type can hold it.
    fn from_value(value: Option<Value>) -> Option<Self>;
}

impl Field for f64 {
    fn value(&self) -> Option<Value> {
        Some(Value::Number(*self))
    }

    fn from_value(value: Option<Value>) -> Option<Self> {
        match value? {
            Value::Number(value) => Some(value),
            Value::Whole(value) => Some(value as f64),
            Value::Text(_) => None,
        }
    }
}

macro_rules! whole_field {
    ($($type:ty),*) => {$(
        impl Field for $type {
            fn value(&self) -> Option<Value> {
                i64::try_from(*self).ok().map(Value::Whole)
            }

            fn from_value(value: Option<Value>) -> Option<Self> {
                match value? {
                    Value::Whole(value) => value.try_into().ok(),
                    _ => None,
                }
            }
        }
    )*};
}

whole_field!(i32, i64, u8, u32, u64, usize);

impl Field for String {
    fn value(&self) -> Option<Value> {
        Some(Value::Text(self.clone()))
    }

    fn from_value(value: Option<Value>) -> Option<Self> {
        match value? {
            Value::Text(value) => Some(value),
            _ => None,
        }
    }
}

impl Field for PathBuf {
    fn value(&self) -> Option<Value> {
        self.to_str().map(|path| Value::Text(path.into()))
    }

    fn from_value(value: Option<Value>) -> Option<Self> {
        String::from_value(value).map(Self::from)
    }
}

impl Field for Timestamp {
    fn value(&self) -> Option<Value> {
        Some(Value::Text(self.to_string()))
    }

    fn from_value(value: Option<Value>) -> Option<Self> {
        parse_utc(&String::from_value(value)?).ok()
    }
}

/// A missing value and an empty text both set nothing.
impl<T: Field> Field for Option<T> {
    fn value(&self) -> Option<Value> {
        self.as_ref().and_then(T::value)
    }

    fn from_value(value: Option<Value>) -> Option<Self> {
        match value {
            None => Some(None),
            Some(Value::Text(text)) if text.is_empty() => Some(None),
            value => T::from_value(value).map(Some),
        }
    }
}

macro_rules! named_field {
    ($($type:ty),*) => {$(
        impl Field for $type {
            fn value(&self) -> Option<Value> {
                Some(Value::Text(self.name().into()))
            }

            fn from_value(value: Option<Value>) -> Option<Self> {
                let name = String::from_value(value)?;
                Self::KINDS.iter().copied().find(|kind| kind.name() == name)
            }
        }
    )*};
}

named_field!(
    Compression,
    Format,
    Memory,
    Overflow,
    PixelFormat,
    Role,
    Sharing,
    Switch
);

/// A field that is written as it is read.
macro_rules! parsed_field {
    ($($type:ty),*) => {$(
        impl Field for $type {
            fn value(&self) -> Option<Value> {
                Some(Value::Text(self.to_string()))
            }

            fn from_value(value: Option<Value>) -> Option<Self> {
                String::from_value(value)?.parse().ok()
            }
        }
    )*};
}

parsed_field!(Destination, Region, Source);
