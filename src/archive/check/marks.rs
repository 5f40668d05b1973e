//! The table of marks that an archived file carries (FITS 4.0, section 7.3).

use super::field;
use crate::fits::{self, FileError, Problem};
use std::collections::BTreeMap;
use std::path::Path;

const BLOCK: usize = 2880;
const CARD: usize = 80;

/// A mark as the file has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    pub id: [i64; 2],
    pub px: [f64; 2],
    /// Per axis.
    pub sigma_px: f64,
}

/// Reads the marks of a file that [`Store`](crate::archive::Store) wrote; none where it has no such table.
///
/// # Errors
/// A file whose structure or checksums are wrong, or whose table of marks has other columns.
pub fn marks(path: &Path) -> Result<Vec<Mark>, FileError> {
    // From here on the structure is known to be whole.
    fits::check_sums(path)?;
    let bytes = std::fs::read(path).map_err(|cause| {
        let action = "read";
        Problem::Io { action, cause }.in_file(path)
    })?;
    read(&bytes).map_err(|problem| problem.in_file(path))
}

fn read(bytes: &[u8]) -> Result<Vec<Mark>, Problem> {
    for start in (0..bytes.len()).step_by(BLOCK) {
        if bytes[start..].starts_with(b"XTENSION= 'BINTABLE'") {
            let (cards, data) = header(&bytes[start..]);
            if cards.get("EXTNAME").is_some_and(|name| name == "MARKS") {
                return rows(&cards, data);
            }
        }
    }
    Ok(Vec::new())
}

/// Keywords with their values, quotes and blanks taken off, and the bytes after the header.
fn header(bytes: &[u8]) -> (BTreeMap<String, String>, &[u8]) {
    let mut cards = BTreeMap::new();
    for (n, card) in bytes.chunks_exact(CARD).enumerate() {
        if card.starts_with(b"END     ") {
            let end = ((n + 1) * CARD).next_multiple_of(BLOCK).min(bytes.len());
            return (cards, &bytes[end..]);
        }
        let card = String::from_utf8_lossy(card);
        if let Some((keyword, rest)) = card.split_once("= ") {
            let value = rest.split('/').next().unwrap_or_default();
            let value = value.trim().trim_matches('\'').trim();
            cards
                .entry(keyword.trim().into())
                .or_insert_with(|| value.into());
        }
    }
    (cards, &[])
}

fn rows(cards: &BTreeMap<String, String>, data: &[u8]) -> Result<Vec<Mark>, Problem> {
    // What `archive::tables` writes: all columns have 8 bytes.
    let columns = [
        ("I", "1K"),
        ("J", "1K"),
        ("X", "1D"),
        ("Y", "1D"),
        ("SIGMA", "1D"),
    ];
    for (n, (name, form)) in (1..).zip(columns) {
        for (keyword, expected) in [(format!("TTYPE{n}"), name), (format!("TFORM{n}"), form)] {
            let found = cards.get(&keyword).map_or("nothing", String::as_str);
            // A repeat count of one may be left out.
            if found != expected && format!("1{found}") != expected {
                return Err(field(&format!("MARKS: {keyword}"), expected, found));
            }
        }
    }
    let size = |keyword: &str| {
        let found = cards.get(keyword).map_or("nothing", String::as_str);
        found
            .parse::<usize>()
            .map_err(|_| field(&format!("MARKS: {keyword}"), "a whole number", found))
    };
    let (row_bytes, count) = (size("NAXIS1")?, size("NAXIS2")?);
    if row_bytes < 8 * columns.len() {
        let expected = format!("at least {} bytes", 8 * columns.len());
        return Err(field("MARKS: NAXIS1", expected, row_bytes.to_string()));
    }
    let rows = data.chunks_exact(row_bytes).take(count);
    Ok(rows.map(mark).collect())
}

fn mark(row: &[u8]) -> Mark {
    let words = row.as_chunks::<8>().0;
    let whole = |n: usize| i64::from_be_bytes(words[n]);
    let real = |n: usize| f64::from_be_bytes(words[n]);
    Mark {
        id: [whole(0), whole(1)],
        px: [real(2), real(3)],
        sigma_px: real(4),
    }
}
