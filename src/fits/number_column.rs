//! A column of numbers in the rows of a binary table: any width, any scaling (FITS 4.0, sections 7.3.2 and 7.3.3).

use super::form::Form;
use super::{Header, Problem};

/// A column with one number in each row.
#[derive(Debug, Clone, PartialEq)]
pub struct NumberColumn {
    /// As TTYPEn has it.
    pub name: String,
    /// As TUNITn has it.
    pub unit: Option<String>,
    /// Of its first byte in a row.
    start: usize,
    kind: Kind,
    scale: f64,
    zero: f64,
    /// The stored integer that stands for none.
    null: Option<i64>,
}

/// How a number is stored, big-endian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Unsigned.
    Byte,
    Short,
    Int,
    Long,
    Single,
    Double,
}

/// Which way a number is rounded that its column cannot hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Inward {
    Up,
    Down,
}

impl NumberColumn {
    /// The nth column of a table, from 1 on, that begins at a byte of the row.
    pub(super) fn of(header: &Header, n: usize, start: usize) -> Result<Self, Problem> {
        let keyword = |name: &str| format!("{name}{n}");
        let text = |name| header.text(&keyword(name));
        let form = text("TFORM")?.unwrap_or_default();
        let name = text("TTYPE")?.unwrap_or_default();
        let kind = match Form::parse(&form) {
            Some(Form {
                repeat: 1, letter, ..
            }) => Kind::of(letter),
            _ => None,
        };
        let kind = kind.ok_or_else(|| {
            let expected = "one number in each row (B, I, J, K, E or D)";
            Problem::field(format!("column {name}"), expected, format!("'{form}'"))
        })?;
        let number = |name, default| Ok(header.number(&keyword(name))?.unwrap_or(default));
        Ok(Self {
            unit: text("TUNIT")?.filter(|unit| !unit.trim().is_empty()),
            scale: number("TSCAL", 1.0)?,
            zero: number("TZERO", 0.0)?,
            null: header
                .integer(&keyword("TNULL"))?
                .filter(|_| kind.is_integer()),
            name,
            start,
            kind,
        })
    }

    /// The number in a row; `None` where there is none. A row too short for it has none.
    pub fn get(&self, row: &[u8]) -> Option<f64> {
        let cell = row.get(self.start..)?;
        let stored = match self.kind {
            Kind::Single => f64::from(f32::from_be_bytes(*cell.first_chunk()?)),
            Kind::Double => f64::from_be_bytes(*cell.first_chunk()?),
            integer => {
                let stored = integer.integer(cell)?;
                if self.null == Some(stored) {
                    return None;
                }
                stored as f64
            }
        };
        Some(stored * self.scale + self.zero).filter(|number| !number.is_nan())
    }

    /// Puts a number into a row, rounded to what the column can hold.
    pub fn put(&self, number: f64, inward: Inward, row: &mut [u8]) {
        let stored = (number - self.zero) / self.scale;
        let up = (inward == Inward::Up) == (self.scale > 0.0);
        let whole = if up { stored.ceil() } else { stored.floor() };
        match self.kind {
            Kind::Byte => self.write(row, [whole as u8]),
            Kind::Short => self.write(row, (whole as i16).to_be_bytes()),
            Kind::Int => self.write(row, (whole as i32).to_be_bytes()),
            Kind::Long => self.write(row, (whole as i64).to_be_bytes()),
            Kind::Single => {
                let nearest = stored as f32;
                let rounded = match f64::from(nearest) {
                    below if up && below < stored => nearest.next_up(),
                    above if !up && above > stored => nearest.next_down(),
                    _ => nearest,
                };
                self.write(row, rounded.to_be_bytes());
            }
            Kind::Double => self.write(row, stored.to_be_bytes()),
        }
    }

    fn write<const N: usize>(&self, row: &mut [u8], bytes: [u8; N]) {
        if let Some(cell) = row.get_mut(self.start..self.start + N) {
            cell.copy_from_slice(&bytes);
        }
    }
}

impl Kind {
    fn of(letter: char) -> Option<Self> {
        Some(match letter {
            'B' => Self::Byte,
            'I' => Self::Short,
            'J' => Self::Int,
            'K' => Self::Long,
            'E' => Self::Single,
            'D' => Self::Double,
            _ => return None,
        })
    }

    fn is_integer(self) -> bool {
        !matches!(self, Self::Single | Self::Double)
    }

    /// The integer that a cell begins with; `None` where it holds none.
    fn integer(self, cell: &[u8]) -> Option<i64> {
        Some(match self {
            Self::Byte => (*cell.first()?).into(),
            Self::Short => i16::from_be_bytes(*cell.first_chunk()?).into(),
            Self::Int => i32::from_be_bytes(*cell.first_chunk()?).into(),
            Self::Long => i64::from_be_bytes(*cell.first_chunk()?),
            Self::Single | Self::Double => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(letter: char, scale: f64) -> NumberColumn {
        NumberColumn {
            name: "START".into(),
            unit: None,
            start: 1,
            kind: Kind::of(letter).unwrap(),
            scale,
            zero: 3.0,
            null: Some(7),
        }
    }

    #[test]
    fn what_is_put_reads_back_inward_of_the_number_by_less_than_a_step() {
        for (letter, scale, step) in [
            ('B', 0.5, 0.5),
            ('I', 0.5, 0.5),
            ('J', -0.25, 0.25),
            ('K', 1e-3, 1e-3),
            ('E', 1.0, 1e-5),
            ('D', 1.0, 0.0),
            ('D', -2.0, 0.0),
        ] {
            let column = column(letter, scale);
            for number in [3.0, 50.123_456_7, 29.0, 30.6] {
                let read = |inward| {
                    let mut row = [0; 9];
                    column.put(number, inward, &mut row);
                    column.get(&row).unwrap()
                };
                let (up, down) = (read(Inward::Up), read(Inward::Down));
                let (above, below) = (up - number, number - down);
                assert!(
                    (-1e-14..=step + 1e-14).contains(&above),
                    "{letter} {number} {up}"
                );
                assert!(
                    (-1e-14..=step + 1e-14).contains(&below),
                    "{letter} {number} {down}"
                );
            }
        }
    }

    #[test]
    fn the_null_and_nan_are_no_numbers_and_a_short_row_has_none() {
        assert_eq!(column('I', 1.0).get(&[0, 0, 7]), None);
        assert_eq!(column('I', 1.0).get(&[0, 0, 8]), Some(11.0));
        assert_eq!(column('I', 1.0).get(&[0, 0]), None);
        let mut row = [0; 9];
        row[1..].copy_from_slice(&f64::NAN.to_be_bytes());
        assert_eq!(column('D', 1.0).get(&row), None);
    }
}
