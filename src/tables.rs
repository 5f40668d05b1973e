//! Rows of CSV tables and logs, as written by instruments and people, and possibly damaged by power cuts. Rows that cannot
//! be read are rejected, counted by kind, and reported once per kind: one bad row must not cost the whole flight.

use crate::files::open_log;
use csv::ByteRecord;
use std::collections::BTreeMap;
use std::fmt;
use std::io::{self, BufRead, BufReader};
use std::path::{Path, PathBuf};

/// Maximum length of a line, bytes: a file without line ends must not fill the memory.
const LONGEST_LINE: usize = 1 << 16;
const BUFFER: usize = 1 << 16;
/// Maximum length of a quoted text, characters.
const LONGEST_QUOTE: usize = 60;

/// Error in a table: file and line, the column, what was expected there and what was found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{}, line {line}: {column}: expected {expected}, found {found}", .path.display())]
pub struct TableError {
    pub path: PathBuf,
    pub line: u64,
    pub column: String,
    pub expected: String,
    pub found: String,
}

/// Kinds of rejected rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Columns are missing, or there are too many; or the file ends within the row.
    Cut,
    /// Zero bytes, left by a power cut in a page that was not written.
    ZeroBytes,
    /// A text that is not a valid value of its column.
    Unreadable,
    /// An impossible value.
    OutOfRange,
    /// It has the time of a previous row.
    Repeated,
    /// Earlier than the previous row.
    OutOfOrder,
    /// A time far from that of the rows before and after.
    Stray,
    /// The clock was set back: other rows have the same time.
    CoveredTwice,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Cut => "cut",
            Self::ZeroBytes => "zero bytes",
            Self::Unreadable => "unreadable",
            Self::OutOfRange => "out of range",
            Self::Repeated => "repeated",
            Self::OutOfOrder => "out of order",
            Self::Stray => "of another time",
            Self::CoveredTwice => "of a time that other rows have, too",
        }
    }
}

/// Why a row is rejected.
#[derive(Debug, Clone, PartialEq)]
pub struct BadRow {
    pub kind: Kind,
    pub column: String,
    pub expected: String,
    pub found: String,
}

impl BadRow {
    pub fn new(
        kind: Kind,
        column: impl Into<String>,
        expected: impl Into<String>,
        found: impl ToString,
    ) -> Self {
        Self {
            kind,
            column: column.into(),
            expected: expected.into(),
            found: found.to_string(),
        }
    }

    pub fn at(self, path: &Path, line: u64) -> TableError {
        TableError {
            path: path.into(),
            line,
            column: self.column,
            expected: self.expected,
            found: self.found,
        }
    }
}

/// The rejected rows of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct LeftOut {
    path: PathBuf,
    /// Number of each kind, and the first of them.
    kinds: BTreeMap<Kind, (u64, TableError)>,
}

impl LeftOut {
    pub fn of(path: &Path) -> Self {
        Self {
            path: path.into(),
            kinds: BTreeMap::new(),
        }
    }

    pub fn note(&mut self, line: u64, bad: BadRow) {
        let kind = bad.kind;
        let first = || (0, bad.at(&self.path, line));
        self.kinds.entry(kind).or_insert_with(first).0 += 1;
    }

    pub fn rows(&self) -> u64 {
        self.kinds.values().map(|(rows, _)| rows).sum()
    }

    /// Error of the first rejected row: the reason if a file has no good one.
    pub fn first(&self) -> Option<&TableError> {
        let firsts = self.kinds.values().map(|(_, first)| first);
        firsts.min_by_key(|first| first.line)
    }

    /// Logs a line for each kind.
    pub fn warn(&self) {
        for line in self.lines() {
            tracing::warn!("{line}");
        }
    }

    fn lines(&self) -> impl Iterator<Item = String> {
        self.kinds.iter().map(|(kind, (rows, first))| {
            let (kind, rows) = (kind.name(), crate::units::counted(*rows, "row"));
            format!("{first}; {rows} rejected: {kind}")
        })
    }
}

/// A row being read.
pub struct TableRow<'a> {
    pub line: u64,
    record: &'a ByteRecord,
    /// The file ends within it, or after it without a line end: its last number may be truncated.
    is_last: bool,
}

impl TableRow<'_> {
    /// Number of columns.
    pub fn width(&self) -> usize {
        self.record.len()
    }

    /// The text of a column; empty if it has none, or is not valid text.
    pub fn text(&self, column: usize) -> &str {
        let bytes = self.record.get(column).unwrap_or_default();
        let text = str::from_utf8(bytes).unwrap_or_default();
        text.trim_start_matches('\u{feff}').trim_matches(['"', ' '])
    }

    /// Rejects a row damaged by a power cut.
    ///
    /// # Errors
    /// Zero bytes; fewer columns than `least` or more than `most`; no line end.
    pub fn check(&self, least: usize, most: usize) -> Result<(), BadRow> {
        let is_zero = self.record.iter().any(|field| field.contains(&0));
        if is_zero {
            let (expected, found) = ("text", "zero bytes");
            return Err(BadRow::new(Kind::ZeroBytes, "row", expected, found));
        }
        if !(least..=most).contains(&self.width()) {
            let expected = format!("{least} columns");
            return Err(BadRow::new(Kind::Cut, "row", expected, self.width()));
        }
        if self.is_last {
            let (expected, found) = ("an end of line", "the file's end");
            return Err(BadRow::new(Kind::Cut, "row", expected, found));
        }
        Ok(())
    }

    /// # Errors
    /// If the text is not a finite number.
    pub fn number(&self, n: usize, column: &str) -> Result<f64, BadRow> {
        let text = self.text(n);
        let number: Option<f64> = text.parse().ok();
        let bad = || {
            let found = quoted(text);
            BadRow::new(Kind::Unreadable, column, "a finite number", found)
        };
        number.filter(|number| number.is_finite()).ok_or_else(bad)
    }
}

impl fmt::Display for TableRow<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let texts: Vec<&str> = (0..self.width()).map(|n| self.text(n)).collect();
        out.write_str(&texts.join(","))
    }
}

/// A text in quotes, truncated to the length for a line of a log.
pub fn quoted(text: &str) -> String {
    match text.char_indices().nth(LONGEST_QUOTE) {
        Some((end, _)) => format!("\"{}...\"", &text[..end]),
        None => format!("\"{text}\""),
    }
}

/// Reads the rows of a file, without comments (#) and empty lines; `each` takes every row, including the heading. Fields
/// are not quoted: a stray quote would take everything after it as one field.
///
/// # Errors
/// If the file cannot be read, or if `each` returns an error.
pub fn read_rows(
    path: &Path,
    mut each: impl FnMut(&TableRow) -> Result<(), TableError>,
) -> Result<(), TableError> {
    let mut line = 0;
    let unreadable = |line, error: io::Error| {
        BadRow::new(Kind::Unreadable, "table", "a readable file", error).at(path, line)
    };
    let file = open_log(path).map_err(|unread| {
        let (expected, found) = (unread.expected(), unread.found());
        BadRow::new(Kind::Unreadable, "table", expected, found).at(path, line)
    })?;
    let mut file = BufReader::with_capacity(BUFFER, file);
    let (mut bytes, mut record) = (Vec::new(), ByteRecord::new());
    let mut before = End::OfLine(b'\n');
    loop {
        let end = next_line(&mut file, &mut bytes).map_err(|error| unreadable(line, error))?;
        let is_rest_of_end =
            before == End::OfLine(b'\r') && end == End::OfLine(b'\n') && bytes.is_empty();
        line += u64::from(!is_rest_of_end);
        before = end;
        let text = bytes.trim_ascii();
        if !text.is_empty() && !text.starts_with(b"#") {
            record.clear();
            let fields = text.split(|byte| *byte == b',');
            fields.for_each(|field| record.push_field(field.trim_ascii()));
            each(&TableRow {
                line,
                record: &record,
                is_last: end == End::OfFile,
            })?;
        }
        if end == End::OfFile {
            return Ok(());
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    /// A line feed or a carriage return: some programs end lines with the latter alone.
    OfLine(u8),
    OfFile,
}

/// Reads up to the next line end; of an overlong line only the beginning is kept.
fn next_line(file: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<End> {
    line.clear();
    loop {
        let bytes = file.fill_buf()?;
        if bytes.is_empty() {
            return Ok(End::OfFile);
        }
        let end = bytes.iter().position(|byte| matches!(byte, b'\n' | b'\r'));
        let part = &bytes[..end.unwrap_or(bytes.len())];
        line.extend(&part[..part.len().min(LONGEST_LINE - line.len())]);
        let end = end.map(|at| (End::OfLine(bytes[at]), at + 1));
        let used = end.map_or(bytes.len(), |(_, used)| used);
        file.consume(used);
        if let Some((end, _)) = end {
            return Ok(end);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(text: &[u8]) -> (Vec<f64>, Vec<String>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.csv");
        std::fs::write(&path, text).unwrap();
        let (mut good, mut left_out) = (Vec::new(), LeftOut::of(Path::new("log.csv")));
        let read = read_rows(&path, |row| {
            let number = row.check(2, 2).and_then(|()| row.number(1, "b"));
            match number {
                Ok(number) => good.push(number),
                Err(bad) => left_out.note(row.line, bad),
            }
            Ok(())
        });
        read.unwrap();
        (good, left_out.lines().collect())
    }

    #[test]
    fn bad_rows_are_left_out_and_each_kind_has_one_line() {
        let text =
            b"# a comment\n0,1\n0,nan\n0\n\n0,2\n\"0\",\"3\"\n0,x\n0,\0\0\0\0,4\r\n0,5\r\n0,6";
        let (good, lines) = rows(text);
        assert_eq!(good, [1.0, 2.0, 3.0, 5.0]);
        let wanted = [
            "log.csv, line 4: row: expected 2 columns, found 1; 2 rows rejected: cut",
            "log.csv, line 9: row: expected text, found zero bytes; 1 row rejected: zero bytes",
            "log.csv, line 3: b: expected a finite number, found \"nan\"; 2 rows rejected: unreadable",
        ];
        assert_eq!(lines, wanted);
    }

    #[test]
    fn a_last_row_without_an_end_of_line_may_be_cut() {
        assert_eq!(rows(b"0,1\n0,1.5\n").0, [1.0, 1.5]);
        assert_eq!(rows(b"0,1\n0,1.5").0, [1.0]);
        let (good, lines) = rows(b"0,1\n0,1.5e-5\n\0\0\0\0\0\0");
        assert_eq!((good.len(), lines.len()), (2, 1), "{lines:?}");
    }

    #[test]
    fn lines_end_as_each_program_ends_them() {
        for end in ["\n", "\r\n", "\r"] {
            let text = "\u{feff}0,1\n\n0,x\n0,2\n".replace('\n', end);
            let (good, lines) = rows(text.as_bytes());
            assert_eq!(good, [1.0, 2.0], "{end:?}");
            assert!(lines[0].starts_with("log.csv, line 3: b"), "{lines:?}");
        }
    }

    #[test]
    fn a_file_without_ends_of_line_does_not_fill_the_memory() {
        let mut text = b"0,1\n".to_vec();
        text.extend(vec![0; 10 * LONGEST_LINE]);
        text.extend(b"\n0,2\n");
        let (good, lines) = rows(&text);
        assert_eq!((good, lines.len()), (vec![1.0, 2.0], 1));
    }

    #[test]
    fn a_quote_that_garbage_opens_takes_no_rows_with_it() {
        let (good, lines) = rows(b"0,1\n0,\"\n0,2\n0,3\n");
        assert_eq!((good, lines.len()), (vec![1.0, 2.0, 3.0], 1));
    }
}
