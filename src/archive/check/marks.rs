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

#[cfg(test)]
mod tests {
    use super::*;

    /// A file of one table: its keywords and data.
    fn table(cards: &[(&str, &str)], data: &[u8]) -> Vec<u8> {
        let mut text = format!("{:<80}", "XTENSION= 'BINTABLE'");
        for (keyword, value) in cards {
            text += &format!("{:<80}", format!("{keyword:<8}= {value:<20} / comment"));
        }
        text += &format!("{:<80}", "END");
        let mut bytes = text.into_bytes();
        bytes.resize(bytes.len().next_multiple_of(BLOCK), b' ');
        bytes.extend(data);
        bytes
    }

    const CARDS: [(&str, &str); 13] = [
        ("NAXIS1", "40"),
        ("NAXIS2", "1"),
        ("EXTNAME", "'MARKS   '"),
        ("TTYPE1", "'I       '"),
        ("TFORM1", "'K       '"),
        ("TTYPE2", "'J       '"),
        ("TFORM2", "'1K      '"),
        ("TTYPE3", "'X       '"),
        ("TFORM3", "'1D      '"),
        ("TTYPE4", "'Y       '"),
        ("TFORM4", "'D       '"),
        ("TTYPE5", "'SIGMA   '"),
        ("TFORM5", "'1D      '"),
    ];

    #[test]
    fn a_row_is_two_whole_numbers_and_three_real_ones() {
        let ids = [-3i64, 12].map(i64::to_be_bytes).concat();
        let numbers = [640.25f64, 1e-3, 0.05].map(f64::to_be_bytes).concat();
        let file = table(&CARDS, &[ids, numbers].concat());
        let expected = Mark {
            id: [-3, 12],
            px: [640.25, 1e-3],
            sigma_px: 0.05,
        };
        assert_eq!(read(&file).unwrap(), [expected]);
    }

    #[test]
    fn a_table_of_another_make_is_an_error_that_names_the_field() {
        for (keyword, value, message) in [
            (
                "NAXIS1",
                "39",
                "MARKS: NAXIS1: expected at least 40 bytes, found 39",
            ),
            (
                "NAXIS2",
                "many",
                "MARKS: NAXIS2: expected a whole number, found many",
            ),
            ("TFORM3", "'1E'", "MARKS: TFORM3: expected 1D, found 1E"),
            ("TTYPE5", "'S'", "MARKS: TTYPE5: expected SIGMA, found S"),
        ] {
            let mut cards = CARDS;
            let card = cards.iter_mut().find(|(name, _)| *name == keyword);
            card.unwrap().1 = value;
            let error = read(&table(&cards, &[0; 80])).unwrap_err();
            assert_eq!(error.to_string(), message);
        }
    }

    #[test]
    fn rows_that_are_promised_and_not_there_are_not_read() {
        let mut cards = CARDS;
        cards[1].1 = "1000000";
        assert_eq!(read(&table(&cards, &[0; 79])).unwrap().len(), 1);
        assert_eq!(read(&table(&cards, &[])).unwrap(), []);
    }
}
