//! A frame, extra keywords and tables as the bytes of a FITS file.
//!
//! The primary HDU is without data; the pixels stand in an image extension, with every keyword beside them, and
//! tables follow. Uncompressed pixels too, so that a reader finds the same layout in every file.

use super::header::{CARD, Card, Value};
use super::info::{format_time, info_cards};
use super::keyword::{self, Kind};
use super::raw::{Compression, MemoryFile};
use super::{FileError, Problem, unit};
use crate::frame::Frame;
use crate::provenance::{COMMIT, PROGRAM};
use jiff::Timestamp;
use std::collections::BTreeSet;
use std::path::Path;

/// The extension that holds the pixels.
pub const FRAME_EXTENSION: &str = "FRAME";

/// The name of the primary HDU, which is without data.
const PRIMARY_NAME: &str = "PRIMARY";

/// A binary table, written after the pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Name of the extension.
    pub name: String,
    pub columns: Vec<Column>,
}

/// A column of a table. All columns of a table have the same length.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    pub name: String,
    /// Unit, as FITS writes it where it knows it; empty for values without.
    pub unit: String,
    /// What the values are, as TCOMMn tells it.
    pub meaning: String,
    pub values: Values,
}

/// The values of a column.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// NaN, in FITS, is a value that is not known.
    Float(Vec<f64>),
    Integer(Vec<i64>),
    Text(Vec<String>),
}

impl Values {
    pub fn len(&self) -> usize {
        match self {
            Self::Float(values) => values.len(),
            Self::Integer(values) => values.len(),
            Self::Text(values) => values.len(),
        }
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// What the values are, in words.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Float(_) => "floating-point numbers",
            Self::Integer(_) => "whole numbers",
            Self::Text(_) => "texts",
        }
    }

    /// The column's TFORM.
    fn form(&self) -> String {
        match self {
            Self::Float(_) => "1D".into(),
            Self::Integer(_) => "1K".into(),
            Self::Text(texts) => {
                let longest = texts.iter().map(|text| text.chars().count()).max();
                format!("{}A", longest.unwrap_or(1).max(1))
            }
        }
    }
}

/// Writes a frame with further keywords and tables to a file, replacing what stood there.
///
/// The keywords that [`FrameInfo`](crate::frame::FrameInfo) fills are written from it; `cards` go beside them, each
/// with the unit and comment of the [`keyword`] table. Every HDU carries its checksums. For a file that must be whole
/// or absent, see [`archive`](crate::archive).
///
/// # Errors
/// A card whose keyword is not in the table or has another kind of value, a number that is not finite, columns of
/// unequal length, or a file that cannot be written.
pub fn write_frame(
    path: &Path,
    frame: &Frame,
    cards: &[Card],
    tables: &[Table],
    compression: Compression,
) -> Result<(), FileError> {
    let bytes =
        encode_frame(frame, cards, tables, compression).map_err(|problem| problem.in_file(path))?;
    std::fs::write(path, bytes).map_err(|cause| {
        let action = "write";
        Problem::Io { action, cause }.in_file(path)
    })
}

/// The bytes of the file that [`write_frame`] writes.
pub fn encode_frame(
    frame: &Frame,
    cards: &[Card],
    tables: &[Table],
    compression: Compression,
) -> Result<Vec<u8>, Problem> {
    if frame.saturation_dn() == 0 {
        return Err(Problem::field("SATURATE", "a level from 1 to 65535 DN", 0));
    }
    let provenance = provenance();
    let mut all = provenance.clone();
    all.extend(info_cards(frame));
    refuse_duplicates(&all, cards)?;
    all.extend_from_slice(cards);

    let pixels = frame.pixels();
    let pixel_bytes = pixels.len() * pixels.bits() as usize / 8;
    let file = MemoryFile::create(pixel_bytes + OTHER_BYTES)?;
    file.create_primary()?;
    put_cards(&file, &name_cards(PRIMARY_NAME, Holds::Other))?;
    put_cards(&file, &provenance)?;
    file.put_checksums()?;
    file.create_image([frame.width(), frame.height()], pixels, compression)?;
    file.reserve_keywords(all.len() + OTHER_CARDS)?;
    put_cards(&file, &name_cards(FRAME_EXTENSION, Holds::Observation))?;
    put_cards(&file, &all)?;
    file.put_pixels(pixels)?;
    file.put_checksums()?;
    for table in tables {
        put_table(&file, table)?;
        put_cards(&file, &[obs_hdu(Holds::Other)])?;
        file.put_checksums()?;
    }
    file.into_bytes()
}

/// The bytes of a file of binary tables alone, behind a primary HDU without data but with these cards. Nothing in it tells when it was made:
/// the same tables give the same bytes. Each is asked for when its turn comes, and dropped. Where the tables need no more than
/// `expected_bytes`, memory is never moved.
///
/// # Errors
/// Columns of unequal length.
pub fn encode_tables(
    expected_bytes: usize,
    cards: &[Card],
    tables: impl IntoIterator<Item = Table>,
) -> Result<Vec<u8>, Problem> {
    let file = MemoryFile::create(OTHER_BYTES + expected_bytes)?;
    file.create_primary()?;
    put_cards(&file, &name_cards(PRIMARY_NAME, Holds::Other))?;
    put_cards(&file, &program())?;
    put_cards(&file, cards)?;
    file.put_datasum()?;
    for table in tables {
        put_table(&file, &table)?;
        drop(table);
        file.put_datasum()?;
    }
    file.into_bytes()
}

/// Room for headers and tables.
const OTHER_BYTES: usize = 1 << 17;

/// What an HDU holds, for SOLARNET.
#[derive(Clone, Copy)]
enum Holds {
    Observation,
    Other,
}

fn obs_hdu(holds: Holds) -> Card {
    Card::new("OBS_HDU", i64::from(matches!(holds, Holds::Observation)))
}

fn name_cards(name: &str, holds: Holds) -> [Card; 2] {
    [Card::new("EXTNAME", name), obs_hdu(holds)]
}

/// The extension's name, its checksums, and what cfitsio adds of its own.
const OTHER_CARDS: usize = 16;

/// The program that writes the file.
fn program() -> Vec<Card> {
    let mut cards = vec![
        Card::new("ORIGIN", "solaspect"),
        Card::new("CREATOR", PROGRAM),
    ];
    cards.extend(COMMIT.map(|commit| Card::new("SWCOMMIT", commit)));
    cards
}

/// Where the file comes from.
fn provenance() -> Vec<Card> {
    let now = Timestamp::from_second(Timestamp::now().as_second()).unwrap_or_default();
    let mut cards = program();
    cards.push(Card::new("DATE", format_time(now)));
    // In part: SOLARNET wants WAVEUNIT as a power of ten, where FITS and sunpy want a unit.
    cards.push(Card::new("SOLARNET", 0.5));
    cards
}

/// A keyword stands once in a header; one from above may not contradict the frame's own.
fn refuse_duplicates(own: &[Card], extra: &[Card]) -> Result<(), Problem> {
    let mut seen: BTreeSet<&str> = own.iter().map(|card| card.keyword).collect();
    seen.extend(["EXTNAME", "OBS_HDU"]);
    match extra.iter().find(|card| !seen.insert(card.keyword)) {
        Some(card) => Err(Problem::field(card.keyword, "one value", "a second")),
        None => Ok(()),
    }
}

fn put_cards(file: &MemoryFile, cards: &[Card]) -> Result<(), Problem> {
    cards.iter().try_for_each(|card| put_card(file, card))
}

fn put_card(file: &MemoryFile, card: &Card) -> Result<(), Problem> {
    let row = keyword::find(card.keyword)
        .ok_or_else(|| Problem::field(card.keyword, "a keyword of the table", "another"))?;
    let comment = row.comment();
    let number = match (&card.value, row.kind) {
        (Value::Text(text), Kind::Text | Kind::Time) => {
            return file.put_text(card.keyword, text, &comment);
        }
        (Value::Integer(number), Kind::Integer | Kind::Float) => number.to_string(),
        (Value::Float(number), Kind::Float) if number.is_finite() => float(*number),
        (Value::Logical(truth), Kind::Logical) => Value::Logical(*truth).to_string(),
        (value, kind) => {
            return Err(Problem::field(card.keyword, format!("{kind:?}"), value));
        }
    };
    let mut text = format!("{:<8}= {number:>20} / {comment}", card.keyword);
    text.truncate(CARD);
    file.put_card(&text)
}

/// The shortest number that reads back as the same one, with a decimal point, as every FITS reader knows it.
fn float(number: f64) -> String {
    let text = format!("{number:?}").replace('e', "E");
    match text.split_once('E') {
        Some((digits, exponent)) if !digits.contains('.') => format!("{digits}.0E{exponent}"),
        _ => text,
    }
}

/// Name, TFORM and TUNIT of a column; a unit that FITS does not know stands in its comment alone.
fn specification(column: &Column) -> [String; 3] {
    let unit = match unit::is_known(&column.unit) {
        true => column.unit.clone(),
        false => String::new(),
    };
    [column.name.clone(), column.values.form(), unit]
}

fn put_table(file: &MemoryFile, table: &Table) -> Result<(), Problem> {
    let rows = table
        .columns
        .first()
        .map_or(0, |column| column.values.len());
    let specifications: Vec<[String; 3]> = table.columns.iter().map(specification).collect();
    file.create_table(&table.name, &specifications)?;
    for (n, column) in table.columns.iter().enumerate() {
        let comment = unit::column_comment(&column.meaning, &column.unit);
        file.put_text(&format!("TCOMM{}", n + 1), &comment, "")?;
    }
    for (n, column) in table.columns.iter().enumerate() {
        if column.values.len() != rows {
            let field = format!("column {} of {}", column.name, table.name);
            let expected = format!("{rows} values, as in the first");
            return Err(Problem::field(field, expected, column.values.len()));
        }
        if rows == 0 {
            continue;
        }
        match &column.values {
            Values::Float(values) => file.put_floats(n + 1, values)?,
            Values::Integer(values) => file.put_integers(n + 1, values)?,
            Values::Text(values) => file.put_texts(n + 1, values)?,
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_float_reads_back_as_the_same_number() {
        for number in [
            0.015,
            1e-7,
            1.5e300,
            -104.2218,
            3.0,
            f64::MIN_POSITIVE,
            0.1 + 0.2,
        ] {
            let text = float(number);
            assert_eq!(text.parse(), Ok(number), "{text}");
            assert!(text.contains('.'), "{text}");
            assert!(!text.contains('e'), "{text}");
        }
        assert_eq!(float(1e-7), "1.0E-7");
    }
}
