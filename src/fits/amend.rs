//! A FITS file copied with some of its tables amended: with more columns, or other rows. Every other HDU stays as it is, byte for byte, and
//! so does what an amended table has besides: its other columns, its heap, and the cards of its header but for those that state its
//! size, the new columns and the checksums.

use super::disk_file::{DiskFile, DiskHdu, DiskTable};
use super::header::CARD;
use super::layout::{Layout, value_card};
use super::stream::{DataSum, StoredColumn, StoredRow};
use super::structure::BLOCK;
use super::write::{ColumnCards, begin_table_header, put_column};
use super::{FileError, Problem};
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Bytes that are copied at a time.
const PIECE: usize = 1 << 20;
/// Rows that are read at a time.
const ROWS: u64 = 1000;

/// The copy in the making.
#[derive(Debug)]
pub struct Amended<'a> {
    from: &'a DiskFile,
    path: PathBuf,
    file: BufWriter<File>,
}

/// What of a table's header changes.
struct Size {
    rows: u64,
    row_bytes: usize,
    columns: usize,
}

impl<'a> Amended<'a> {
    /// Begins a copy in an empty file; errors name it by the path.
    pub fn new(from: &'a DiskFile, file: File, path: &Path) -> Self {
        Self {
            from,
            path: path.into(),
            file: BufWriter::with_capacity(PIECE, file),
        }
    }

    /// Copies an HDU as it is.
    ///
    /// # Errors
    /// A file that cannot be read or written.
    pub fn copy(&mut self, hdu: &DiskHdu) -> Result<(), FileError> {
        let end = hdu.end().min(self.from.bytes());
        self.pieces(hdu.start, end, |_| {})?;
        // The last block of a file may lack its fill, which what follows needs.
        let with = if hdu.data_bytes == 0 { b' ' } else { 0 };
        self.pad(end - hdu.start, with)
    }

    /// Copies a table with more columns. `fill` reads each row's bytes and adds the cells of the new columns; `history` says why they are there.
    ///
    /// # Errors
    /// What `fill` gives; a file that cannot be read or written.
    pub fn widen<E: From<FileError>>(
        &mut self,
        hdu: &DiskHdu,
        table: &DiskTable,
        columns: &[StoredColumn],
        history: &[String],
        mut fill: impl FnMut(&[u8], &mut StoredRow) -> Result<(), E>,
    ) -> Result<(), E> {
        let added: usize = columns.iter().map(|column| column.form.bytes()).sum();
        let size = Size {
            rows: table.rows,
            row_bytes: table.row_bytes + added,
            columns: table.columns.len() + columns.len(),
        };
        let mut header = header(hdu, table, &size);
        for (n, column) in (table.columns.len() + 1..).zip(columns) {
            put_column(&mut header, n, &column.cards());
        }
        let start = self.begin(&mut header, history)?;
        let (mut sum, mut row) = (DataSum::default(), StoredRow::default());
        let mut read = Vec::new();
        for first in (0..table.rows).step_by(ROWS as usize) {
            let count = ROWS.min(table.rows - first) as usize;
            read.resize(count * table.row_bytes, 0);
            self.read(hdu.data + first * table.row_bytes as u64, &mut read)?;
            row.bytes().clear();
            for n in 0..count {
                let own = &read[n * table.row_bytes..][..table.row_bytes];
                row.bytes().extend_from_slice(own);
                fill(own, &mut row)?;
            }
            sum.add(row.bytes());
            self.write(row.bytes())?;
        }
        Ok(self.end(hdu, table, header, start, sum)?)
    }

    /// Copies a table with other rows, each of as many bytes as before.
    ///
    /// # Errors
    /// A file that cannot be read or written.
    pub fn replace(
        &mut self,
        hdu: &DiskHdu,
        table: &DiskTable,
        rows: &[u8],
        history: &[String],
    ) -> Result<(), FileError> {
        let size = Size {
            rows: (rows.len() / table.row_bytes.max(1)) as u64,
            row_bytes: table.row_bytes,
            columns: table.columns.len(),
        };
        let mut header = header(hdu, table, &size);
        let start = self.begin(&mut header, history)?;
        let mut sum = DataSum::default();
        sum.add(rows);
        self.write(rows)?;
        self.end(hdu, table, header, start, sum)
    }

    /// Adds a table of double-precision columns; cards of those keywords are copied from the headers, the first that has one.
    ///
    /// # Errors
    /// A file that cannot be read or written.
    pub fn add<const N: usize>(
        &mut self,
        name: &str,
        columns: [(&str, &str, &str); N],
        rows: &[[f64; N]],
        (keywords, headers): (&[&str], &[&DiskHdu]),
        history: &[String],
    ) -> Result<(), FileError> {
        let cards = columns.iter().map(|(name, unit, meaning)| ColumnCards {
            name,
            form: "1D".into(),
            unit,
            meaning,
            null: None,
        });
        let mut header = Layout::new(BLOCK);
        begin_table_header(&mut header, name, cards, [8 * N, rows.len()]);
        for keyword in keywords {
            if let Some(card) = headers.iter().find_map(|hdu| hdu.card(keyword)) {
                header.foreign_card(card);
            }
        }
        let start = self.begin(&mut header, history)?;
        let numbers = rows.iter().flatten();
        let data: Vec<u8> = numbers.flat_map(|number| number.to_be_bytes()).collect();
        let mut sum = DataSum::default();
        sum.add(&data);
        self.write(&data)?;
        self.seal(header, start, sum)
    }

    /// Copies what follows the last HDU, and writes all through.
    ///
    /// # Errors
    /// A file that cannot be read or written.
    pub fn finish(mut self) -> Result<(), FileError> {
        let end = self.from.hdus().last().map_or(0, DiskHdu::end);
        self.pieces(end, self.from.bytes(), |_| {})?;
        let done = self.file.flush();
        let done = done.and_then(|()| self.file.get_ref().sync_all());
        done.map_err(|cause| self.unwritten(cause))
    }

    /// Writes a header whose checksums are not known yet; gives its place.
    fn begin(&mut self, header: &mut Layout, history: &[String]) -> Result<u64, FileError> {
        for line in history {
            header.card(&format!("HISTORY {line}"));
        }
        header.end_header();
        let start = self.file.stream_position();
        let start = start.map_err(|cause| self.unwritten(cause))?;
        self.write(header.bytes())?;
        Ok(start)
    }

    /// Copies the heap of a table behind its rows, and ends the HDU.
    fn end(
        &mut self,
        hdu: &DiskHdu,
        table: &DiskTable,
        header: Layout,
        start: u64,
        mut sum: DataSum,
    ) -> Result<(), FileError> {
        let rows = table.rows * table.row_bytes as u64;
        let (heap, end) = (hdu.data + rows, hdu.data + hdu.data_bytes);
        self.pieces(heap, end, |piece| sum.add(piece))?;
        self.seal(header, start, sum)
    }

    /// Fills the last block, and writes the header's checksums.
    fn seal(&mut self, mut header: Layout, start: u64, sum: DataSum) -> Result<(), FileError> {
        let end = self.file.stream_position();
        let end = end.map_err(|cause| self.unwritten(cause))?;
        self.pad(end - start, 0)?;
        header.seal(sum.finish());
        let bytes = header.into_bytes();
        self.rewrite(start, &bytes)
            .map_err(|cause| self.unwritten(cause))
    }

    /// Writes bytes at a place, and goes on at the end.
    fn rewrite(&mut self, start: u64, bytes: &[u8]) -> io::Result<()> {
        let end = self.file.stream_position()?;
        self.file.seek(SeekFrom::Start(start))?;
        self.file.write_all(bytes)?;
        self.file.seek(SeekFrom::Start(end)).map(drop)
    }

    fn pad(&mut self, bytes: u64, with: u8) -> Result<(), FileError> {
        let fill = bytes.next_multiple_of(BLOCK as u64) - bytes;
        self.write(&vec![with; fill as usize])
    }

    /// Copies the bytes from a place to another, and shows them.
    fn pieces(
        &mut self,
        start: u64,
        end: u64,
        mut show: impl FnMut(&[u8]),
    ) -> Result<(), FileError> {
        let mut bytes = Vec::new();
        for at in (start..end).step_by(PIECE) {
            bytes.resize((end - at).min(PIECE as u64) as usize, 0);
            self.read(at, &mut bytes)?;
            show(&bytes);
            self.write(&bytes)?;
        }
        Ok(())
    }

    fn read(&self, start: u64, bytes: &mut [u8]) -> Result<(), FileError> {
        let read = self.from.fill(start, bytes);
        read.map_err(|problem| problem.in_file(self.from.path()))
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), FileError> {
        let written = self.file.write_all(bytes);
        written.map_err(|cause| self.unwritten(cause))
    }

    fn unwritten(&self, cause: io::Error) -> FileError {
        Problem::unwritten(cause).in_file(&self.path)
    }
}

impl DiskHdu {
    /// The cards before END.
    fn cards(&self) -> impl Iterator<Item = &[u8]> {
        let cards = self.cards.chunks_exact(CARD);
        cards.take_while(|card| !card.starts_with(b"END     "))
    }

    /// The first card of a keyword.
    fn card(&self, keyword: &str) -> Option<&[u8]> {
        self.cards()
            .find(|card| keyword_of(card) == keyword.as_bytes())
    }
}

fn keyword_of(card: &[u8]) -> &[u8] {
    card[..8].trim_ascii_end()
}

/// The cards of a table, with its new size and without its checksums.
fn header(hdu: &DiskHdu, table: &DiskTable, size: &Size) -> Layout {
    let mut header = Layout::new(hdu.cards.len() + BLOCK);
    header.begin();
    let grown =
        size.rows as i64 * size.row_bytes as i64 - table.rows as i64 * table.row_bytes as i64;
    for card in hdu.cards() {
        let value = match keyword_of(card) {
            b"CHECKSUM" | b"DATASUM" => continue,
            b"NAXIS1" => Some(size.row_bytes as i64),
            b"NAXIS2" => Some(size.rows as i64),
            b"TFIELDS" => Some(size.columns as i64),
            // The heap keeps its distance from the rows.
            b"THEAP" => hdu
                .header
                .integer("THEAP")
                .ok()
                .flatten()
                .map(|at| at + grown),
            _ => None,
        };
        match value {
            Some(value) => header.card(&with_value(card, value)),
            None => header.foreign_card(card),
        }
    }
    header
}

/// A card with another number, and its comment.
fn with_value(card: &[u8], value: i64) -> String {
    let text = String::from_utf8_lossy(card);
    let (keyword, rest) = text.split_at_checked(8).unwrap_or((&text, ""));
    let comment = rest.split_once('/').map_or("", |(_, comment)| comment);
    value_card(keyword.trim_end(), &value.to_string(), comment.trim())
}
