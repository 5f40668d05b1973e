//! Binary tables that are written to a file row by row (FITS 4.0, section 7.3): they may be larger than memory.

use super::checksum;
use super::header::Card;
use super::layout::{Layout, printable};
use super::structure::BLOCK;
use super::write::{ColumnCards, begin_primary, program, put_cards, put_table_header};
use super::{FileError, Problem};
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Storage of a column's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CellForm {
    /// Text of this many characters.
    Text(usize),
    /// 64 bits; TNULLn means none.
    Integer,
    /// Double precision; NaN means none.
    Float,
    Logical,
}

/// Value of TNULLn.
pub(super) const NO_INTEGER: i64 = i64::MIN;

impl CellForm {
    fn tform(self) -> String {
        match self {
            Self::Text(characters) => format!("{characters}A"),
            Self::Integer => "1K".into(),
            Self::Float => "1D".into(),
            Self::Logical => "1L".into(),
        }
    }

    fn bytes(self) -> usize {
        match self {
            Self::Text(characters) => characters,
            Self::Integer | Self::Float => 8,
            Self::Logical => 1,
        }
    }
}

/// A column of a table whose rows follow.
#[derive(Debug, Clone, Copy)]
pub struct StoredColumn {
    pub name: &'static str,
    /// Unit in the form of FITS, if FITS knows it; empty for values without.
    pub unit: &'static str,
    /// Meaning of the values, for TCOMMn.
    pub meaning: &'static str,
    pub form: CellForm,
}

impl StoredColumn {
    pub(super) fn cards(&self) -> ColumnCards<'_> {
        ColumnCards {
            name: self.name,
            form: self.form.tform(),
            unit: self.unit,
            meaning: self.meaning,
            null: (self.form == CellForm::Integer).then_some(NO_INTEGER),
        }
    }
}

/// A row being written: a cell for each column, in their order.
#[derive(Debug, Default)]
pub struct StoredRow(Vec<u8>);

impl StoredRow {
    /// The bytes of the cells so far.
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }

    /// Empties the row for the next one.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    pub fn text(&mut self, text: &str, characters: usize) {
        let end = self.0.len() + characters;
        self.0.extend(text.chars().take(characters).map(printable));
        self.0.resize(end, b' ');
    }

    pub fn integer(&mut self, value: Option<i64>) {
        self.0.extend(value.unwrap_or(NO_INTEGER).to_be_bytes());
    }

    pub fn float(&mut self, value: Option<f64>) {
        self.0.extend(value.unwrap_or(f64::NAN).to_be_bytes());
    }

    pub fn logical(&mut self, value: bool) {
        self.0.push(if value { b'T' } else { b'F' });
    }
}

/// A file of binary tables after a primary HDU without data, being written. It contains no time of writing: the same tables give
/// the same bytes.
#[derive(Debug)]
pub struct TableFile {
    path: PathBuf,
    file: BufWriter<File>,
    /// Cards of every header.
    cards: Vec<Card>,
}

impl TableFile {
    /// Begins a file, replacing an existing one; `cards` go into every header.
    ///
    /// # Errors
    /// If a card is not of a keyword of the table, or the file cannot be written.
    pub fn create(path: &Path, cards: &[Card]) -> Result<Self, FileError> {
        let begun = || {
            let mut header = Layout::new(BLOCK);
            begin_primary(&mut header)?;
            put_cards(&mut header, &program())?;
            put_cards(&mut header, cards)?;
            header.end_header();
            header.end();
            let mut file =
                BufWriter::with_capacity(1 << 20, File::create(path).map_err(Problem::unwritten)?);
            file.write_all(&header.into_bytes())
                .map_err(Problem::unwritten)?;
            Ok(file)
        };
        Ok(Self {
            path: path.into(),
            cards: cards.to_vec(),
            file: begun().map_err(|problem: Problem| problem.in_file(path))?,
        })
    }

    /// Adds a table; `fill` writes each of its rows.
    ///
    /// # Errors
    /// Errors of `fill`; a row without a cell for each column; a file that cannot be written.
    pub fn table<R, E: From<FileError>>(
        &mut self,
        name: &str,
        columns: &[StoredColumn],
        rows: impl Iterator<Item = Result<R, E>>,
        mut fill: impl FnMut(&R, &mut StoredRow),
    ) -> Result<(), E> {
        let row_bytes: usize = columns.iter().map(|column| column.form.bytes()).sum();
        let start = self.kept(|file| file.stream_position().map_err(Problem::unwritten))?;
        let cards = std::mem::take(&mut self.cards);
        let header = |rows: usize| header(name, columns, &cards, [row_bytes, rows]);
        let unfinished = self.kept(|_| header(0))?;
        let bytes = unfinished.into_bytes();
        self.kept(|file| file.write_all(&bytes).map_err(Problem::unwritten))?;
        let (mut count, mut row, mut sum) = (0, StoredRow::default(), DataSum::default());
        for item in rows {
            let item = item?;
            row.clear();
            fill(&item, &mut row);
            if row.0.len() != row_bytes {
                let expected = format!("{row_bytes} bytes, as the columns need");
                let wrong = Problem::field(format!("row of {name}"), expected, row.0.len());
                return Err(wrong.in_file(&self.path).into());
            }
            sum.add(&row.0);
            self.kept(|file| file.write_all(&row.0).map_err(Problem::unwritten))?;
            count += 1;
        }
        self.kept(|file| {
            let data = count * row_bytes;
            let fill = vec![0; data.next_multiple_of(BLOCK) - data];
            file.write_all(&fill).map_err(Problem::unwritten)?;
            let end = file.stream_position().map_err(Problem::unwritten)?;
            let mut finished = header(count)?;
            finished.seal(sum.finish());
            file.seek(SeekFrom::Start(start))
                .map_err(Problem::unwritten)?;
            file.write_all(&finished.into_bytes())
                .map_err(Problem::unwritten)?;
            file.seek(SeekFrom::Start(end))
                .map_err(Problem::unwritten)?;
            Ok(())
        })?;
        self.cards = cards;
        Ok(())
    }

    /// Completes the file and syncs it to the disk.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn finish(mut self) -> Result<(), FileError> {
        self.kept(|file| {
            file.flush().map_err(Problem::unwritten)?;
            file.get_ref().sync_all().map_err(Problem::unwritten)
        })
    }

    fn kept<T>(
        &mut self,
        write: impl FnOnce(&mut BufWriter<File>) -> Result<T, Problem>,
    ) -> Result<T, FileError> {
        write(&mut self.file).map_err(|problem| problem.in_file(&self.path))
    }
}

/// The header of a table with this number of rows.
fn header(
    name: &str,
    columns: &[StoredColumn],
    cards: &[Card],
    bytes_and_rows: [usize; 2],
) -> Result<Layout, Problem> {
    let heads = columns.iter().map(StoredColumn::cards);
    let mut header = Layout::new(BLOCK);
    put_table_header(&mut header, name, heads, bytes_and_rows, cards)?;
    Ok(header)
}

/// The sum of data that arrive in pieces.
#[derive(Default)]
struct DataSum {
    sum: u32,
    /// Bytes of an incomplete word.
    rest: Vec<u8>,
}

impl DataSum {
    fn add(&mut self, bytes: &[u8]) {
        self.rest.extend_from_slice(bytes);
        let whole = self.rest.len() / 4 * 4;
        self.sum = checksum::added(self.sum, checksum::sum(&self.rest[..whole]));
        self.rest.drain(..whole);
    }

    fn finish(self) -> u32 {
        checksum::added(self.sum, checksum::sum(&self.rest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fits;

    #[test]
    fn an_empty_table_keeps_the_kinds_of_its_columns_and_every_hdu_its_checksums() {
        let column = |name, form| StoredColumn {
            name,
            unit: "",
            meaning: "",
            form,
        };
        let columns = [
            column("FILE", CellForm::Text(5)),
            column("N", CellForm::Integer),
            column("X", CellForm::Float),
            column("VALID", CellForm::Logical),
        ];
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tables.fits");
        let mut file = TableFile::create(&path, &[]).unwrap();
        let rows = |count: i64| (0..count).map(Ok::<_, FileError>);
        for (name, count) in [("FULL", 1000), ("EMPTY", 0)] {
            let fill = |n: &i64, row: &mut StoredRow| {
                row.text("some text", 5);
                row.integer((*n != 3).then_some(*n));
                row.float((*n != 4).then_some(*n as f64 / 7.0));
                row.logical(*n == 5);
            };
            file.table(name, &columns, rows(count), fill).unwrap();
        }
        file.finish().unwrap();
        let checked = fits::FitsFile::open(&path).unwrap().checksums().unwrap();
        assert_eq!((checked.hdus, checked.guarded), (3, 3));
        for (name, count) in [("FULL", 1000), ("EMPTY", 0)] {
            let table = fits::read_table(&path, name).unwrap().unwrap();
            let kinds = table.columns.iter().map(|c| c.values.kind());
            let expected = [
                "texts",
                "whole numbers",
                "floating-point numbers",
                "truth values",
            ];
            assert_eq!(kinds.collect::<Vec<_>>(), expected);
            assert!(table.columns.iter().all(|c| c.values.len() == count));
        }
    }
}
