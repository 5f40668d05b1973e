//! Description of a payload: its numbers, their types and meanings.

use std::str::FromStr;

/// Type of a number as sent, little-endian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Number {
    U8,
    U16,
    I16,
    U32,
    F32,
    F64,
}

impl Number {
    /// Its length.
    pub const fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Smallest and largest value of an integer type.
    pub fn range(self) -> Option<(f64, f64)> {
        match self {
            Self::U8 => Some((0.0, u8::MAX.into())),
            Self::U16 => Some((0.0, u16::MAX.into())),
            Self::I16 => Some((i16::MIN.into(), i16::MAX.into())),
            Self::U32 => Some((0.0, u32::MAX.into())),
            Self::F32 | Self::F64 => None,
        }
    }

    /// The name of its type.
    pub const fn name(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::U32 => "u32",
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }

    /// The bytes of a number that a person has written; `None` if the text is no number of this type.
    pub fn bytes_of(self, text: &str) -> Option<Vec<u8>> {
        fn parsed<T: FromStr>(text: &str) -> Option<T> {
            text.parse().ok()
        }
        Some(match self {
            Self::U8 => parsed::<u8>(text)?.to_le_bytes().to_vec(),
            Self::U16 => parsed::<u16>(text)?.to_le_bytes().to_vec(),
            Self::I16 => parsed::<i16>(text)?.to_le_bytes().to_vec(),
            Self::U32 => parsed::<u32>(text)?.to_le_bytes().to_vec(),
            Self::F32 => parsed::<f32>(text)?.to_le_bytes().to_vec(),
            Self::F64 => parsed::<f64>(text)?.to_le_bytes().to_vec(),
        })
    }

    /// Appends a number, which must be within the range of its type.
    pub fn write(self, number: f64, bytes: &mut Vec<u8>) {
        match self {
            Self::U8 => bytes.push(number as u8),
            Self::U16 => bytes.extend((number as u16).to_le_bytes()),
            Self::I16 => bytes.extend((number as i16).to_le_bytes()),
            Self::U32 => bytes.extend((number as u32).to_le_bytes()),
            Self::F32 => bytes.extend((number as f32).to_le_bytes()),
            Self::F64 => bytes.extend(number.to_le_bytes()),
        }
    }

    /// The number with which some bytes begin, and the remaining bytes; `None` if there are too few.
    pub fn read(self, bytes: &[u8]) -> Option<(f64, &[u8])> {
        let (own, rest) = bytes.split_at_checked(self.bytes())?;
        let value = match self {
            Self::U8 => (*own.first()?).into(),
            Self::U16 => u16::from_le_bytes(own.try_into().ok()?).into(),
            Self::I16 => i16::from_le_bytes(own.try_into().ok()?).into(),
            Self::U32 => u32::from_le_bytes(own.try_into().ok()?).into(),
            Self::F32 => f32::from_le_bytes(own.try_into().ok()?).into(),
            Self::F64 => f64::from_le_bytes(own.try_into().ok()?),
        };
        Some((value, rest))
    }
}

/// Meaning of the numbers of a field: number, name and meaning.
#[derive(Debug, PartialEq, Eq)]
pub struct Codes {
    pub name: &'static str,
    pub rows: &'static [(u16, &'static str, &'static str)],
}

impl Codes {
    /// Meaning of a number.
    pub fn meaning(&self, number: u16) -> Option<&'static str> {
        let row = self.rows.iter().find(|(known, ..)| *known == number)?;
        Some(row.2)
    }

    /// Each number with its meaning.
    pub fn in_words(&self) -> String {
        let rows = self.rows.iter();
        let rows: Vec<String> = rows
            .map(|(number, _, meaning)| format!("{number} {meaning}"))
            .collect();
        rows.join(", ")
    }
}

/// A field of a payload: one number, or several of a type.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Field {
    pub name: &'static str,
    pub number: Number,
    pub count: usize,
    /// Empty for counts and codes.
    pub unit: &'static str,
    pub documentation: &'static str,
    /// Meanings of its numbers, if it is a code.
    pub codes: Option<&'static Codes>,
    /// Range for a person's input; its type may hold more.
    pub range: Option<(f64, f64)>,
}
