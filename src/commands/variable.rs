//! The numbers sent with commands, and the settings that they change.

use super::setting::Setting;
use crate::link::code::{angle_code, angle_from_code};
use crate::link::number::Number;
use std::fmt;

/// Encoding of a number in the 16 bits of a variable or a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Unsigned, from 0 to 65535.
    Unsigned,
    /// Signed, from -32768 to 32767.
    Signed,
    /// As an angle code: in steps of 1/8 from -1024 to 7167.875.
    Angle,
    /// 1 for on, 0 for off.
    Switch,
}

impl Kind {
    /// The 16-bit code of a number in its natural unit; `None` if the code cannot represent it.
    pub fn code(self, value: f64) -> Option<u16> {
        let whole = |low: f64, high: f64| {
            let fits = value.fract() == 0.0 && (low..=high).contains(&value);
            fits.then_some(value as i32 as u16)
        };
        match self {
            Self::Unsigned => whole(0.0, u16::MAX.into()),
            Self::Signed => whole(i16::MIN.into(), i16::MAX.into()),
            Self::Angle => angle_code(value).filter(|code| angle_from_code(*code) == value),
            Self::Switch => whole(0.0, 1.0),
        }
    }

    /// The code of the nearest number that 16 bits can represent: the value that a read returns.
    pub fn nearest_code(self, value: f64) -> Option<u16> {
        match self {
            Self::Unsigned | Self::Switch => Some(value.round() as u16),
            Self::Signed => Some((value.round() as i16).cast_unsigned()),
            Self::Angle => angle_code(value),
        }
    }

    /// The number that a 16-bit code represents.
    pub fn value(self, code: u16) -> f64 {
        match self {
            Self::Unsigned | Self::Switch => code.into(),
            Self::Signed => code.cast_signed().into(),
            Self::Angle => angle_from_code(code),
        }
    }

    /// The 16 bits as a number.
    pub fn number(self) -> Number {
        match self {
            Self::Unsigned | Self::Angle | Self::Switch => Number::U16,
            Self::Signed => Number::I16,
        }
    }

    /// The smallest and the largest number, and the step between numbers.
    pub fn limits(self) -> (f64, f64, f64) {
        match self {
            Self::Unsigned => (0.0, 65_535.0, 1.0),
            Self::Signed => (-32_768.0, 32_767.0, 1.0),
            Self::Angle => (-1024.0, 7167.875, 0.125),
            Self::Switch => (0.0, 1.0, 1.0),
        }
    }

    /// Range of the number, in words.
    pub fn range(self) -> &'static str {
        match self {
            Self::Unsigned => "a whole number from 0 to 65535",
            Self::Signed => "a whole number from -32768 to 32767",
            Self::Angle => "a number from -1024 to 7167.875 in steps of 0.125",
            Self::Switch => "1 (on) or 0 (off)",
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Unsigned => "u16",
            Self::Signed => "i16",
            Self::Angle => "angle code",
            Self::Switch => "1 on, 0 off",
        }
    }
}

/// A number that is sent with a command or returned as its result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Variable {
    pub name: &'static str,
    pub kind: Kind,
    /// Empty for counts, switches and the cameras' own scales.
    pub unit: &'static str,
    /// Its setting in a command, and its value in a result.
    pub settings: &'static [Setting],
}

impl fmt::Display for Variable {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            name, kind, unit, ..
        } = self;
        match unit.is_empty() {
            true => write!(out, "{name} ({})", kind.name()),
            false => write!(out, "{name} ({}, {unit})", kind.name()),
        }
    }
}
