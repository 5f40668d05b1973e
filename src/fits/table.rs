//! A binary table of a file, as columns (FITS 4.0, section 7.3).

use super::form::Form;
use super::header::printable;
use super::structure::{Content, Hdu};
use super::{Column, Header, Problem, Table, Value, Values};

/// The most values, rows times columns, that are read.
const MOST_VALUES: usize = 1 << 22;

/// Type and storage of a column's values.
#[derive(Debug, Clone, Copy)]
enum Kind {
    Integer,
    Float,
    Logical,
    Text,
}

/// Position of a column in a row.
struct Field {
    name: String,
    unit: String,
    meaning: String,
    kind: Kind,
    start: usize,
    bytes: usize,
}

/// Reads the first binary table with this name; `None` if the file has none.
pub(super) fn read_table(bytes: &[u8], hdus: &[Hdu], name: &str) -> Result<Option<Table>, Problem> {
    let named = |hdu: &&Hdu| {
        let text = |keyword| match hdu.header.get(keyword) {
            Some(Value::Text(text)) => Some(text.as_str()),
            _ => None,
        };
        text("XTENSION") == Some("BINTABLE")
            && text("EXTNAME") == Some(name)
            && hdu.content() == Content::Other
    };
    let Some(hdu) = hdus.iter().find(named) else {
        return Ok(None);
    };
    let columns = columns(&hdu.header, &bytes[hdu.data_bytes.clone()])
        .map_err(|problem| problem.within(name))?;
    Ok(Some(Table {
        name: name.into(),
        columns,
    }))
}

fn columns(header: &Header, data: &[u8]) -> Result<Vec<Column>, Problem> {
    let fields = fields(header)?;
    let width: usize = fields.iter().map(|field| field.bytes).sum();
    let row_bytes = header.size("NAXIS1", 0..=i64::MAX)? as usize;
    if row_bytes != width {
        let expected = format!("{width} bytes, as the columns need");
        return Err(Problem::field("NAXIS1", expected, row_bytes));
    }
    let rows = header.size("NAXIS2", 0..=i64::MAX)? as usize;
    // Every column has bytes, so only a table without columns has rows without bytes.
    let most = (MOST_VALUES / fields.len().max(1)).min(data.len() / width.max(1));
    if rows > most && width > 0 {
        let expected = format!("at most {most} rows of {width} bytes");
        return Err(Problem::field("NAXIS2", expected, rows));
    }
    let column = |field: Field| {
        let cells = data.chunks_exact(width).take(rows);
        let cells = cells.map(|row| &row[field.start..][..field.bytes]);
        Column {
            values: match field.kind {
                Kind::Integer => Values::Integer(cells.map(integer).collect()),
                Kind::Float => Values::Float(cells.map(float).collect()),
                Kind::Logical => Values::Logical(cells.map(|cell| cell == b"T").collect()),
                Kind::Text => Values::Text(cells.map(text).collect()),
            },
            name: field.name,
            unit: field.unit,
            meaning: field.meaning,
        }
    };
    Ok(fields.into_iter().map(column).collect())
}

fn fields(header: &Header) -> Result<Vec<Field>, Problem> {
    let mut start = 0;
    let field = |n| {
        let text = |name: &str| Ok(header.text(&format!("{name}{n}"))?.unwrap_or_default());
        for (scaling, plain) in [("TSCAL", 1.0), ("TZERO", 0.0)] {
            let keyword = format!("{scaling}{n}");
            let found = header.number(&keyword)?.unwrap_or(plain);
            if found != plain {
                return Err(Problem::field(keyword, plain.to_string(), found));
            }
        }
        let form = text("TFORM")?;
        let Some((kind, bytes)) = kind(&form) else {
            let expected = "one number (B, I, J, K, E or D), a truth (L) or a text (A)";
            return Err(Problem::field(
                format!("TFORM{n}"),
                expected,
                format!("'{form}'"),
            ));
        };
        let field = Field {
            name: text("TTYPE")?,
            unit: text("TUNIT")?,
            meaning: text("TCOMM")?,
            kind,
            start,
            bytes,
        };
        start += bytes;
        Ok(field)
    };
    (1..=header.size("TFIELDS", 0..=999)?).map(field).collect()
}

/// The kind and the bytes of a column of this form.
fn kind(form: &str) -> Option<(Kind, usize)> {
    let form = Form::parse(form)?;
    let kind = match (form.repeat, form.letter) {
        (1.., 'A') => Kind::Text,
        (1, 'B' | 'I' | 'J' | 'K') => Kind::Integer,
        (1, 'E' | 'D') => Kind::Float,
        (1, 'L') => Kind::Logical,
        _ => return None,
    };
    Some((kind, form.bytes()?))
}

/// A big-endian number: unsigned if it is one byte, signed otherwise.
fn integer(cell: &[u8]) -> i64 {
    let first = match cell {
        [byte] => i64::from(*byte),
        [byte, ..] => i64::from(*byte as i8),
        [] => 0,
    };
    cell.iter()
        .skip(1)
        .fold(first, |number, byte| number << 8 | i64::from(*byte))
}

fn float(cell: &[u8]) -> f64 {
    match (cell.first_chunk(), cell.first_chunk()) {
        (Some(double), _) => f64::from_be_bytes(*double),
        (None, Some(single)) => f64::from(f32::from_be_bytes(*single)),
        (None, None) => f64::NAN,
    }
}

/// A text ends at a NUL; trailing blanks do not count.
fn text(cell: &[u8]) -> String {
    let end = cell.iter().position(|byte| *byte == 0);
    let mut text = printable(&cell[..end.unwrap_or(cell.len())]);
    text.truncate(text.trim_end().len());
    text
}
