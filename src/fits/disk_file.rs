//! A FITS file of any size whose data stay on disk: its HDUs by their headers, and the tables among them.

use super::form::Form;
use super::header::CARD;
use super::number_column::NumberColumn;
use super::structure::{BLOCK, data_size};
use super::{FileError, Header, Problem, checked_fits};
use crate::files;
use std::fs::File;
use std::io::{self, ErrorKind};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// The longest header that is read, bytes.
const MOST_HEADER: usize = 16 << 20;

/// A FITS file, open to be read.
#[derive(Debug)]
pub struct DiskFile {
    path: PathBuf,
    file: File,
    bytes: u64,
    hdus: Vec<DiskHdu>,
}

/// A header, and where its data are.
#[derive(Debug)]
pub struct DiskHdu {
    pub header: Header,
    /// The header as it stands, with its END and fill.
    pub(super) cards: Vec<u8>,
    pub(super) start: u64,
    /// Of its data, without the fill of their last block.
    pub(super) data: u64,
    pub(super) data_bytes: u64,
}

/// How the rows of a binary table are laid out.
#[derive(Debug, Clone)]
pub struct DiskTable {
    pub rows: u64,
    pub row_bytes: usize,
    pub columns: Vec<String>,
    starts: Vec<usize>,
}

impl DiskFile {
    /// Reads the headers of a file. Names are those of files on disk, whatever characters they have.
    ///
    /// # Errors
    /// A file that cannot be read, is no FITS file, or is shorter than its headers promise.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        let file = files::open_regular(path);
        let file = file.map_err(|unread| Problem::of_unread(unread).in_file(path))?;
        Self::of(file, path)
    }

    /// The same of an open file; messages name it by the path.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn of(file: File, path: &Path) -> Result<Self, FileError> {
        Self::read(file, path).map_err(|problem| problem.in_file(path))
    }

    fn read(file: File, path: &Path) -> Result<Self, Problem> {
        let mut found = Self {
            path: path.into(),
            bytes: file.metadata().map_err(Problem::unread)?.len(),
            file,
            hdus: Vec::new(),
        };
        checked_fits(&found.at_most(0, CARD)?, "a FITS file")?;
        let mut at = 0;
        while at == 0 || found.at_most(at, 8)? == b"XTENSION" {
            let hdu = found.hdu_at(at)?;
            at = hdu.end();
            found.hdus.push(hdu);
        }
        Ok(found)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn hdus(&self) -> &[DiskHdu] {
        &self.hdus
    }

    /// Bytes of the file.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    fn hdu_at(&self, start: u64) -> Result<DiskHdu, Problem> {
        let cards = self.header_at(start)?;
        let (header, _) = Header::parse(&cards).unwrap_or_default();
        let data = start + cards.len() as u64;
        let data_bytes = data_size(&header)?;
        let present = self.bytes - data;
        if data_bytes > present {
            return Err(Problem::field(
                "NAXISn",
                format!("{data_bytes} bytes of data after the header at byte {start}"),
                format!("{present} before the end of the file"),
            ));
        }
        Ok(DiskHdu {
            header,
            cards,
            start,
            data,
            data_bytes,
        })
    }

    /// The blocks of a header.
    fn header_at(&self, start: u64) -> Result<Vec<u8>, Problem> {
        let mut header = Vec::new();
        while header.len() < MOST_HEADER {
            let block = self.at_most(start + header.len() as u64, BLOCK)?;
            let ends = |card: &[u8]| card.starts_with(b"END     ");
            let is_last = block.chunks_exact(CARD).any(ends);
            let is_whole = block.len() == BLOCK;
            header.extend(block);
            match (is_last, is_whole) {
                (true, _) => return Ok(header),
                (false, true) => {}
                (false, false) => break,
            }
        }
        let expected = format!("an END card to close the header at byte {start}");
        Err(Problem::content(expected, "none"))
    }

    /// So many bytes from a place on, or fewer at the end of the file.
    fn at_most(&self, start: u64, bytes: usize) -> Result<Vec<u8>, Problem> {
        let rest = self.bytes.saturating_sub(start);
        let mut read = vec![0; bytes.min(usize::try_from(rest).unwrap_or(bytes))];
        self.fill(start, &mut read)?;
        Ok(read)
    }

    /// Reads the bytes from a place on.
    pub(super) fn fill(&self, start: u64, bytes: &mut [u8]) -> Result<(), Problem> {
        let read = self.file.read_exact_at(bytes, start);
        read.map_err(|cause| match cause.kind() {
            ErrorKind::UnexpectedEof => Problem::unread(io::Error::other("it became shorter")),
            _ => Problem::unread(cause),
        })
    }

    /// The rows of a table, for tables that fit into memory.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn rows(&self, hdu: &DiskHdu, table: &DiskTable) -> Result<Vec<u8>, FileError> {
        let bytes = table.rows as usize * table.row_bytes;
        let rows = self.at_most(hdu.data, bytes);
        rows.map_err(|problem| problem.in_file(&self.path))
    }
}

impl DiskTable {
    /// Whether there is a column of this name, in capitals or not.
    pub fn has(&self, name: &str) -> bool {
        self.columns
            .iter()
            .any(|column| column.eq_ignore_ascii_case(name))
    }
}

impl DiskHdu {
    /// Where the next one begins.
    pub(super) fn end(&self) -> u64 {
        (self.data + self.data_bytes).next_multiple_of(BLOCK as u64)
    }

    fn text(&self, keyword: &str) -> Option<String> {
        self.header.text(keyword).ok().flatten()
    }

    /// Its EXTNAME, empty where it has none.
    pub fn name(&self) -> String {
        self.text("EXTNAME").unwrap_or_default().trim().into()
    }

    /// Whether a keyword has this text, in capitals or not.
    pub fn says(&self, keyword: &str, text: &str) -> bool {
        let found = self.text(keyword);
        found.is_some_and(|found| found.trim().eq_ignore_ascii_case(text))
    }

    /// Whether it is a binary table, and no compressed image.
    pub fn is_table(&self) -> bool {
        self.says("XTENSION", "BINTABLE") && !self.header.contains("ZIMAGE")
    }

    /// How the rows of the table are laid out.
    ///
    /// # Errors
    /// Columns that FITS does not know, or that make other rows than NAXIS1 says.
    pub fn table(&self) -> Result<DiskTable, Problem> {
        let header = &self.header;
        let mut table = DiskTable {
            rows: header.size("NAXIS2", 0..=i64::MAX)?,
            row_bytes: header.size("NAXIS1", 0..=i64::MAX)? as usize,
            columns: Vec::new(),
            starts: Vec::new(),
        };
        let mut width = 0;
        for n in 1..=header.size("TFIELDS", 0..=999)? {
            let keyword = format!("TFORM{n}");
            let form = header.text(&keyword)?.unwrap_or_default();
            let bytes = Form::parse(&form).and_then(Form::bytes).ok_or_else(|| {
                Problem::field(keyword, "the form of a column", format!("'{form}'"))
            })?;
            let name = header.text(&format!("TTYPE{n}"))?.unwrap_or_default();
            table.columns.push(name.trim().into());
            table.starts.push(width);
            width += bytes;
        }
        if table.row_bytes != width {
            let expected = format!("{width} bytes, as the columns need");
            return Err(Problem::field("NAXIS1", expected, table.row_bytes));
        }
        let most = self.data_bytes / (width as u64).max(1);
        if table.rows > most {
            let expected = format!("at most {most} rows of {width} bytes");
            return Err(Problem::field("NAXIS2", expected, table.rows));
        }
        Ok(table)
    }

    /// The column of numbers of a name, in capitals or not.
    ///
    /// # Errors
    /// None or several of the name, or one that has not one number in each row.
    pub fn column(&self, table: &DiskTable, name: &str) -> Result<NumberColumn, Problem> {
        let named = (0..).zip(&table.columns);
        let mut named = named.filter(|(_, column)| column.eq_ignore_ascii_case(name));
        let wrong = |found| Problem::field(format!("column {name}"), "one of this name", found);
        match (named.next(), named.next()) {
            (Some((n, _)), None) => NumberColumn::of(&self.header, n + 1, table.starts[n]),
            (Some(_), Some(_)) => Err(wrong("several".into())),
            (None, _) => Err(wrong(format!("{} only", table.columns.join(", ")))),
        }
    }
}
