//! A frame, extra keywords and tables as the bytes of a FITS file.
//!
//! The primary HDU is without data; the pixels are in an image extension, with every keyword beside them, and
//! tables follow. This also holds for uncompressed pixels, so that a reader finds the same layout in every file.

use super::cards::{format_time, info_cards};
use super::header::{Card, Value};
use super::keyword::{self, Keyword, Kind};
use super::layout::{Layout, printable};
use super::pack::{self, Packing};
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
    /// Unit in the form of FITS, if FITS knows it; empty for values without.
    pub unit: String,
    /// Meaning of the values, for TCOMMn.
    pub meaning: String,
    pub values: Values,
}

/// The values of a column.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// NaN means, in FITS, a value that is not known.
    Float(Vec<f64>),
    /// Stored unchanged; TNULLn is not used.
    Integer(Vec<i64>),
    Logical(Vec<bool>),
    Text(Vec<String>),
}

impl Values {
    pub fn len(&self) -> usize {
        match self {
            Self::Float(values) => values.len(),
            Self::Integer(values) => values.len(),
            Self::Logical(values) => values.len(),
            Self::Text(values) => values.len(),
        }
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Type of the values, in words.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Float(_) => "floating-point numbers",
            Self::Integer(_) => "whole numbers",
            Self::Logical(_) => "truth values",
            Self::Text(_) => "texts",
        }
    }

    /// The column's TFORM.
    fn form(&self) -> String {
        match self {
            Self::Float(_) => "1D".into(),
            Self::Integer(_) => "1K".into(),
            Self::Logical(_) => "1L".into(),
            Self::Text(_) => format!("{}A", self.bytes()),
        }
    }

    /// Bytes of a value.
    fn bytes(&self) -> usize {
        match self {
            Self::Float(_) | Self::Integer(_) => 8,
            Self::Logical(_) => 1,
            Self::Text(texts) => {
                let longest = texts.iter().map(|text| text.chars().count()).max();
                longest.unwrap_or(1).max(1)
            }
        }
    }

    /// Writes each value into its cell, which is blank.
    fn write<'a>(&self, cells: impl Iterator<Item = &'a mut [u8]>) {
        match self {
            Self::Float(values) => {
                let pairs = cells.zip(values);
                pairs.for_each(|(cell, value)| cell.copy_from_slice(&value.to_be_bytes()));
            }
            Self::Integer(values) => {
                let pairs = cells.zip(values);
                pairs.for_each(|(cell, value)| cell.copy_from_slice(&value.to_be_bytes()));
            }
            Self::Logical(values) => {
                let pairs = cells.zip(values);
                pairs.for_each(|(cell, value)| cell[0] = if *value { b'T' } else { b'F' });
            }
            Self::Text(texts) => {
                for (cell, text) in cells.zip(texts) {
                    let pairs = cell.iter_mut().zip(text.chars());
                    pairs.for_each(|(byte, c)| *byte = printable(c));
                }
            }
        }
    }
}

/// Writes a frame with further keywords and tables to a file, replacing an existing one.
///
/// The keywords that [`FrameInfo`](crate::frame::FrameInfo) determines are written from it; `cards` are added to them, each
/// with the unit and comment of the [`keyword`] table. Every HDU has its checksums. For a file that must be complete
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
    packing: impl Into<Packing>,
) -> Result<(), FileError> {
    let bytes =
        encode_frame(frame, cards, tables, packing).map_err(|problem| problem.in_file(path))?;
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
    packing: impl Into<Packing>,
) -> Result<Vec<u8>, Problem> {
    let packing = packing.into();
    if frame.saturation_dn() == 0 {
        return Err(Problem::field("SATURATE", "a level from 1 to 65535 DN", 0));
    }
    let provenance = provenance();
    let mut all = provenance.clone();
    all.extend(info_cards(frame));
    refuse_duplicates(&all, cards)?;
    all.extend_from_slice(cards);

    let (pixels, width) = (frame.pixels(), frame.width());
    let pixel_bytes = pixels.len() * pixels.bits() as usize / 8;
    let mut file = Layout::new(pixel_bytes + OTHER_BYTES);
    begin_primary(&mut file)?;
    put_cards(&mut file, &provenance)?;
    file.end_header();
    file.end();
    pack::begin(&mut file, pixels, width, packing.compression);
    put_cards(&mut file, &name_cards(FRAME_EXTENSION, Holds::Observation))?;
    put_cards(&mut file, &all)?;
    file.end_header();
    let packed = pack::put(&mut file, pixels, width, packing);
    let action = "compress the pixels";
    packed.map_err(|cause| Problem::Io { action, cause })?;
    file.end();
    for table in tables {
        put_table(&mut file, table, &[obs_hdu(Holds::Other)])?;
    }
    Ok(file.into_bytes())
}

/// Begins the primary HDU, which is without data.
pub(super) fn begin_primary(file: &mut Layout) -> Result<(), Problem> {
    file.begin();
    file.value("SIMPLE", "T", "a FITS file");
    file.value("BITPIX", "8", "bits of a value");
    file.value("NAXIS", "0", "no data here");
    file.value("EXTEND", "T", "extensions follow");
    put_cards(file, &name_cards(PRIMARY_NAME, Holds::Other))
}

/// Space for headers and tables.
const OTHER_BYTES: usize = 1 << 17;

/// Content of an HDU, for SOLARNET.
#[derive(Clone, Copy)]
enum Holds {
    Observation,
    Other,
}

fn obs_hdu(holds: Holds) -> Card {
    Card::new(
        &keyword::OBS_HDU,
        i64::from(matches!(holds, Holds::Observation)),
    )
}

fn name_cards(name: &str, holds: Holds) -> [Card; 2] {
    [Card::new(&keyword::EXTNAME, name), obs_hdu(holds)]
}

/// The program that writes the file.
pub(super) fn program() -> Vec<Card> {
    let mut cards = vec![
        Card::new(&keyword::ORIGIN, "solaspect"),
        Card::new(&keyword::CREATOR, PROGRAM),
    ];
    cards.extend(COMMIT.map(|commit| Card::new(&keyword::SWCOMMIT, commit)));
    cards
}

/// Origin of the file.
fn provenance() -> Vec<Card> {
    let now = Timestamp::from_second(Timestamp::now().as_second()).unwrap_or_default();
    let mut cards = program();
    cards.push(Card::new(&keyword::DATE, format_time(now)));
    // In part: SOLARNET requires WAVEUNIT as a power of ten, but FITS and sunpy require a unit.
    cards.push(Card::new(&keyword::SOLARNET, 0.5));
    cards
}

/// A keyword may occur only once in a header; a caller's card may not contradict the frame's own.
fn refuse_duplicates(own: &[Card], extra: &[Card]) -> Result<(), Problem> {
    let mut seen: BTreeSet<&str> = own.iter().map(|card| card.keyword.name).collect();
    seen.extend([keyword::EXTNAME, keyword::OBS_HDU].map(|keyword| keyword.name));
    match extra.iter().find(|card| !seen.insert(card.keyword.name)) {
        Some(card) => Err(Problem::field(card.keyword.name, "one value", "a second")),
        None => Ok(()),
    }
}

pub(super) fn put_cards(file: &mut Layout, cards: &[Card]) -> Result<(), Problem> {
    cards.iter().try_for_each(|card| put_card(file, card))
}

fn put_card(file: &mut Layout, card: &Card) -> Result<(), Problem> {
    let Keyword { name, kind, .. } = *card.keyword;
    let comment = card.keyword.comment();
    let number = match (&card.value, kind) {
        (Value::Text(text), Kind::Text | Kind::Time) => {
            file.text(name, text, &comment);
            return Ok(());
        }
        (Value::Integer(number), Kind::Integer | Kind::Float) => number.to_string(),
        (Value::Float(number), Kind::Float) if number.is_finite() => float(*number),
        (Value::Logical(truth), Kind::Logical) => Value::Logical(*truth).to_string(),
        (value, kind) => {
            return Err(Problem::field(name, format!("{kind:?}"), value));
        }
    };
    file.value(name, &number, &comment);
    Ok(())
}

/// The shortest number that reads back as the same one, with a decimal point, as every FITS reader accepts it.
fn float(number: f64) -> String {
    let text = format!("{number:?}").replace('e', "E");
    match text.split_once('E') {
        Some((digits, exponent)) if !digits.contains('.') => format!("{digits}.0E{exponent}"),
        _ => text,
    }
}

/// Adds a binary table; `cards` are added to its header, too.
fn put_table(file: &mut Layout, table: &Table, cards: &[Card]) -> Result<(), Problem> {
    let columns = &table.columns;
    let rows = columns.first().map_or(0, |column| column.values.len());
    for column in columns {
        if column.values.len() != rows {
            let field = format!("column {} of {}", column.name, table.name);
            let expected = format!("{rows} values, as in the first");
            return Err(Problem::field(field, expected, column.values.len()));
        }
    }
    let widths: Vec<usize> = columns.iter().map(|column| column.values.bytes()).collect();
    let row_bytes: usize = widths.iter().sum();
    let column_cards = columns.iter().map(|column| ColumnCards {
        name: &column.name,
        form: column.values.form(),
        unit: &column.unit,
        meaning: &column.meaning,
        null: None,
    });
    put_table_header(file, &table.name, column_cards, [row_bytes, rows], cards)?;
    let bytes = file.bytes();
    let start = bytes.len();
    bytes.resize(start + rows * row_bytes, b' ');
    let mut first = start;
    for (column, width) in columns.iter().zip(widths) {
        // Without rows there are no bytes.
        let rows = bytes.get_mut(first..).unwrap_or_default();
        let cells = rows.chunks_mut(row_bytes.max(1));
        column.values.write(cells.map(|row| &mut row[..width]));
        first += width;
    }
    file.end();
    Ok(())
}

/// Header cards of a table's column.
pub(super) struct ColumnCards<'a> {
    pub name: &'a str,
    /// Its TFORM.
    pub form: String,
    pub unit: &'a str,
    pub meaning: &'a str,
    /// The number that means none.
    pub null: Option<i64>,
}

/// Adds the header of a binary table, with its bytes per row and its number of rows.
pub(super) fn put_table_header<'a>(
    file: &mut Layout,
    name: &str,
    columns: impl ExactSizeIterator<Item = ColumnCards<'a>>,
    [row_bytes, rows]: [usize; 2],
    cards: &[Card],
) -> Result<(), Problem> {
    file.begin();
    file.text("XTENSION", "BINTABLE", "a table");
    for (keyword, value, comment) in [
        ("BITPIX", 8, "bits of a value"),
        ("NAXIS", 2, "axes"),
        ("NAXIS1", row_bytes, "bytes of a row"),
        ("NAXIS2", rows, "rows"),
        ("PCOUNT", 0, "no more data"),
        ("GCOUNT", 1, "one group"),
        ("TFIELDS", columns.len(), "columns"),
    ] {
        file.value(keyword, &value.to_string(), comment);
    }
    for (n, column) in (1..).zip(columns) {
        put_column(file, n, &column);
    }
    file.text("EXTNAME", name, "name of this extension");
    put_cards(file, cards)?;
    file.end_header();
    Ok(())
}

/// Name, kind, unit and meaning of a column; a unit that FITS does not know is only in its comment.
fn put_column(file: &mut Layout, n: usize, column: &ColumnCards<'_>) {
    let mut text = |keyword: &str, text: &str| file.text(&format!("{keyword}{n}"), text, "");
    text("TTYPE", column.name);
    text("TFORM", &column.form);
    if unit::is_known(column.unit) {
        text("TUNIT", column.unit);
    }
    let comment = unit::column_comment(column.meaning, column.unit);
    if !comment.is_empty() {
        text("TCOMM", &comment);
    }
    if let Some(null) = column.null {
        file.value(&format!("TNULL{n}"), &null.to_string(), "");
    }
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
