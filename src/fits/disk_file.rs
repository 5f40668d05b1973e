//! A FITS file of any size whose data stay on disk: its HDUs are copied unchanged, or one at a time as a table that is amended.

use super::by_cfitsio::{called, open_disk_file, unopened};
use super::form::Form;
use super::header::CARD;
use super::structure::data_size;
use super::{FileError, Header, Problem, Value, checked_fits};
use crate::files;
use fitsio::{FileOpenMode, FitsFile, sys};
use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// The longest header that is read, bytes.
const MOST_HEADER: u64 = 16 << 20;

/// A FITS file, open for reading.
#[derive(Debug)]
pub struct DiskFile {
    path: PathBuf,
    file: File,
    bytes: u64,
    hdus: Vec<DiskHdu>,
}

/// A header, and the range of its HDU.
#[derive(Debug)]
pub struct DiskHdu {
    pub header: Header,
    /// The bytes of the header, with its END and fill.
    cards: Vec<u8>,
    /// Range in the file, with the fill of the last block, which the end of a file may lack.
    bytes: Range<u64>,
    /// Whether it is a binary table, and no compressed image.
    pub is_table: bool,
}

/// A column with one number in each row.
#[derive(Debug, Clone, PartialEq)]
pub struct NumberColumn {
    /// Number of the column, from 1.
    pub number: i32,
    /// Whether its cells are integers.
    pub is_whole: bool,
    /// Value of TTYPEn.
    pub name: String,
    /// Value of TUNITn.
    pub unit: Option<String>,
}

impl DiskFile {
    /// Reads the headers of a file; messages name it by `shown`. Names are those of files on disk, whatever characters they have.
    ///
    /// # Errors
    /// A file that cannot be read, is no FITS file, or is shorter than its headers promise.
    pub fn open(path: &Path, shown: &Path) -> Result<Self, FileError> {
        Self::read(path, shown).map_err(|problem| problem.in_file(shown))
    }

    fn read(path: &Path, shown: &Path) -> Result<Self, Problem> {
        let file = files::open_regular(path).map_err(Problem::of_unread)?;
        let mut found = Self {
            path: shown.into(),
            bytes: file.metadata().map_err(Problem::unread)?.len(),
            file,
            hdus: Vec::new(),
        };
        checked_fits(&found.at_most(0, CARD as u64)?, "a FITS file")?;
        let opened = open_disk_file(path, FileOpenMode::READONLY);
        let mut by_cfitsio =
            opened.map_err(|cause| Problem::content("a FITS file", unopened(cause)))?;
        let mut end = 0;
        // Bytes after the last HDU that are no extension do not belong to the file's content (FITS 4.0, 3.5).
        while end == 0 || found.at_most(end, 8)? == b"XTENSION" {
            let hdu = found.next_hdu(&mut by_cfitsio)?;
            end = hdu.bytes.end;
            found.hdus.push(hdu);
        }
        Ok(found)
    }

    /// The HDU after those already read.
    fn next_hdu(&self, file: &mut FitsFile) -> Result<DiskHdu, Problem> {
        let number = self.hdus.len() as i32 + 1;
        let (mut kind, mut start, mut data, mut end) = (0, 0, 0, 0);
        called(file, &format!("find HDU {number}"), |file, status| {
            // SAFETY: everything that is pointed to outlives the calls.
            unsafe {
                sys::ffmahd(file, number, &raw mut kind, status);
                sys::ffghadll(file, &raw mut start, &raw mut data, &raw mut end, status)
            }
        })?;
        let [start, data, end] = [start, data, end].map(|place| place as u64);
        if data - start > MOST_HEADER {
            let expected = format!("a header of at most {MOST_HEADER} bytes in HDU {number}");
            return Err(Problem::content(expected, (data - start).to_string()));
        }
        let cards = self.at_most(start, data - start)?;
        let (header, _) = Header::parse(&cards).unwrap_or_default();
        let (promised, present) = (data_size(&header)?, self.bytes.saturating_sub(data));
        if promised > present {
            return Err(Problem::field(
                "NAXISn",
                format!("{promised} bytes of data after the header at byte {start}"),
                format!("{present} before the end of the file"),
            ));
        }
        Ok(DiskHdu {
            header,
            cards,
            bytes: start..end,
            is_table: kind == sys::BINARY_TBL as i32,
        })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn hdus(&self) -> &[DiskHdu] {
        &self.hdus
    }

    /// `bytes` bytes from `start` on, or fewer at the end of the file.
    fn at_most(&self, start: u64, bytes: u64) -> Result<Vec<u8>, Problem> {
        let mut read = vec![0; bytes.min(self.bytes.saturating_sub(start)) as usize];
        let filled = self.file.read_exact_at(&mut read, start);
        filled.map_err(Problem::unread).map(|()| read)
    }

    /// Copies an HDU unchanged.
    ///
    /// # Errors
    /// Bytes that cannot be read or written.
    pub fn copy(&self, hdu: &DiskHdu, to: &mut impl Write) -> Result<(), FileError> {
        let Range { start, end } = hdu.bytes;
        let copied = copy(&self.file, start..end.min(self.bytes), to);
        // The last block of a file may lack its fill, which the next HDU needs.
        let fill = vec![0; end.saturating_sub(self.bytes) as usize];
        let copied = copied.and_then(|()| to.write_all(&fill).map_err(uncopied));
        copied.map_err(|problem| problem.in_file(&self.path))
    }

    /// Copies the bytes after the last HDU.
    ///
    /// # Errors
    /// Bytes that cannot be read or written.
    pub fn copy_rest(&self, to: &mut impl Write) -> Result<(), FileError> {
        let end = self.hdus.last().map_or(0, |hdu| hdu.bytes.end);
        let copied = copy(&self.file, end.min(self.bytes)..self.bytes, to);
        copied.map_err(|problem| problem.in_file(&self.path))
    }
}

/// Copies a part of a file.
pub(super) fn copy(from: &File, part: Range<u64>, to: &mut impl Write) -> Result<(), Problem> {
    let mut from = from;
    let bytes = part.end - part.start;
    let mut copied = || {
        from.seek(SeekFrom::Start(part.start))?;
        match io::copy(&mut io::Read::take(from, bytes), to)? {
            copied if copied == bytes => Ok(()),
            _ => Err(io::Error::other("it became shorter")),
        }
    };
    copied().map_err(uncopied)
}

fn uncopied(cause: io::Error) -> Problem {
    let action = "copy";
    Problem::Io { action, cause }
}

impl DiskHdu {
    fn text(&self, keyword: &str) -> Option<String> {
        self.header.text(keyword).ok().flatten()
    }

    /// Its EXTNAME, empty if it has none.
    pub fn name(&self) -> String {
        self.text("EXTNAME").unwrap_or_default().trim().into()
    }

    /// Whether a keyword has this text, ignoring case.
    pub fn says(&self, keyword: &str, text: &str) -> bool {
        let found = self.text(keyword);
        found.is_some_and(|found| found.trim().eq_ignore_ascii_case(text))
    }

    /// Number of rows of a table.
    ///
    /// # Errors
    /// If the header does not state it.
    pub fn rows(&self) -> Result<u64, Problem> {
        self.header.size("NAXIS2", 0..=i64::MAX)
    }

    /// The first card of a keyword.
    pub fn card(&self, keyword: &str) -> Option<&[u8]> {
        let cards = self.cards.chunks_exact(CARD);
        let mut cards = cards.take_while(|card| !card.starts_with(b"END     "));
        cards.find(|card| card[..8].trim_ascii_end() == keyword.as_bytes())
    }

    /// The names of a table's columns.
    ///
    /// # Errors
    /// Names that are no texts.
    pub fn columns(&self) -> Result<Vec<String>, Problem> {
        let count = self.header.size("TFIELDS", 0..=999)?;
        let name = |n| {
            let name = self.header.text(&format!("TTYPE{n}"))?;
            Ok(name.unwrap_or_default().trim().into())
        };
        (1..=count).map(name).collect()
    }

    /// The column of numbers with this name, ignoring case.
    ///
    /// # Errors
    /// If none or several have the name, or the column does not have one number in each row.
    pub fn column(&self, name: &str) -> Result<NumberColumn, Problem> {
        let columns = self.columns()?;
        let field = || format!("column {name}");
        let wrong = |found: &str| Problem::field(field(), "one of this name", found);
        let mut named = (1..)
            .zip(&columns)
            .filter(|(_, column)| column.eq_ignore_ascii_case(name));
        let (number, stored) = match (named.next(), named.next()) {
            (Some(one), None) => one,
            (Some(_), Some(_)) => return Err(wrong("several")),
            (None, _) => return Err(wrong(&format!("{} only", columns.join(", ")))),
        };
        let text = |keyword| self.header.text(&format!("{keyword}{number}"));
        let form = text("TFORM")?.unwrap_or_default();
        let is_number = |form: &Form| {
            form.repeat == 1 && matches!(form.letter, 'B' | 'I' | 'J' | 'K' | 'E' | 'D')
        };
        let Some(parsed) = Form::parse(&form).filter(is_number) else {
            let expected = "one number in each row (B, I, J, K, E or D)";
            return Err(Problem::field(field(), expected, format!("'{form}'")));
        };
        // cfitsio ignores values that it cannot read.
        for keyword in ["TSCAL", "TZERO"] {
            self.header.number(&format!("{keyword}{number}"))?;
        }
        let null = format!("TNULL{number}");
        match self.header.get(&null) {
            None if !self.header.contains(&null) => {}
            Some(Value::Integer(_)) => {}
            other => {
                let found = other.map_or("none".into(), Value::to_string);
                return Err(Problem::field(
                    null,
                    "a whole number without a point",
                    found,
                ));
            }
        }
        Ok(NumberColumn {
            number,
            name: stored.clone(),
            is_whole: !matches!(parsed.letter, 'E' | 'D'),
            unit: text("TUNIT")?.filter(|unit| !unit.trim().is_empty()),
        })
    }
}
