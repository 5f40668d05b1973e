//! A table of an existing file that is amended: it is copied into a file of its own, where cfitsio changes it, and is copied from there into the copy
//! of the file.
//!
//! In the whole file cfitsio would change more than requested: in each HDU that it passes, it rewrites the lengths in TFORMn and the fill.

use super::by_cfitsio::{called, open_disk_file, unopened};
use super::disk_file::{DiskFile, DiskHdu, NumberColumn, copy};
use super::layout::{CHECKSUM, DATASUM, Layout, NO_CHECKSUM};
use super::stream::StoredColumn;
use super::structure::BLOCK;
use super::write::begin_primary;
use super::{FileError, Problem, unit};
use fitsio::sys::{self, fitsfile};
use fitsio::{FileOpenMode, FitsFile};
use std::ffi::CString;
use std::io::Write;
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// Largest number of steps by which a number that a column cannot represent is moved further.
const MOST_STEPS: i32 = 64;

/// A table being written, in a temporary file of its own. Rows count from 1, as in FITS.
pub struct AmendedTable {
    /// Path of the file in messages, and name of the table.
    path: PathBuf,
    name: String,
    file: FitsFile,
    own: NamedTempFile,
}

/// Direction in which a number is rounded that its column cannot represent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Inward {
    Up,
    Down,
}

impl DiskFile {
    /// The table of an HDU, to be amended; its temporary file is made in `folder`.
    ///
    /// # Errors
    /// If files cannot be read or written, or cfitsio does not read the table.
    pub fn amended(&self, hdu: &DiskHdu, folder: &Path) -> Result<AmendedTable, FileError> {
        let mut own = begun(folder).map_err(|problem| problem.in_file(folder))?;
        self.copy(hdu, own.as_file_mut())?;
        AmendedTable::open(own, self.path(), hdu.name(), |file, status| {
            // SAFETY: cfitsio accepts a null pointer for the kind of the HDU.
            unsafe { sys::ffmahd(file, 2, std::ptr::null_mut(), status) };
        })
    }
}

/// A file with a primary HDU and nothing else.
fn begun(folder: &Path) -> Result<NamedTempFile, Problem> {
    let mut primary = Layout::new(BLOCK);
    begin_primary(&mut primary)?;
    primary.end_header();
    primary.end();
    let mut builder = tempfile::Builder::new();
    let file = builder
        .prefix(".table-")
        .suffix(".fits")
        .tempfile_in(folder);
    let mut file = file.map_err(Problem::unwritten)?;
    let written = file.write_all(&primary.into_bytes());
    written.map_err(Problem::unwritten)?;
    Ok(file)
}

impl AmendedTable {
    /// A table without columns and rows; errors name it as one of the file at `path`, its temporary file is made in `folder`.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn create(name: &str, path: &Path, folder: &Path) -> Result<Self, FileError> {
        let own = begun(folder).map_err(|problem| problem.in_file(folder))?;
        let extension = c_text(name);
        let none = std::ptr::null_mut;
        Self::open(own, path, name.into(), |file, status| {
            let kind = sys::BINARY_TBL as i32;
            // SAFETY: there are no columns whose names would be read; the name outlives the call.
            unsafe {
                sys::ffcrtb(
                    file,
                    kind,
                    0,
                    0,
                    none(),
                    none(),
                    none(),
                    extension.as_ptr(),
                    status,
                )
            };
        })
    }

    fn open(
        own: NamedTempFile,
        path: &Path,
        name: String,
        begin: impl FnOnce(*mut fitsfile, &mut i32),
    ) -> Result<Self, FileError> {
        let opened = || {
            let file = open_disk_file(own.path(), FileOpenMode::READWRITE);
            let mut file = file.map_err(|cause| Problem::content("a table", unopened(cause)))?;
            called(&mut file, "open the table", begin)?;
            Ok(file)
        };
        let file = opened().map_err(|problem: Problem| problem.within(&name).in_file(path))?;
        Ok(Self {
            path: path.into(),
            name,
            file,
            own,
        })
    }

    fn called<T>(
        &mut self,
        action: &str,
        call: impl FnOnce(*mut fitsfile, &mut i32) -> T,
    ) -> Result<T, FileError> {
        let given = called(&mut self.file, action, call);
        given.map_err(|problem| problem.within(&self.name).in_file(&self.path))
    }

    /// Number of rows.
    ///
    /// # Errors
    /// If the header does not state it.
    pub fn rows(&mut self) -> Result<u64, FileError> {
        let mut rows = 0;
        self.called("count rows", |file, status| {
            // SAFETY: the number outlives the call.
            unsafe { sys::ffgnrwll(file, &raw mut rows, status) };
        })?;
        Ok(rows as u64)
    }

    /// Numbers of a column, from a row on; NaN for a missing value.
    ///
    /// # Errors
    /// If a row does not exist.
    pub fn read(
        &mut self,
        column: &NumberColumn,
        first: u64,
        numbers: &mut [f64],
    ) -> Result<(), FileError> {
        let count = numbers.len() as i64;
        let mut any = 0;
        self.called(&format!("read column {}", column.name), |file, status| {
            // SAFETY: the buffer has space for this many numbers.
            unsafe {
                sys::ffgcvd(
                    file,
                    column.number,
                    first as i64,
                    1,
                    count,
                    f64::NAN,
                    numbers.as_mut_ptr(),
                    &raw mut any,
                    status,
                )
            };
        })
    }

    /// Puts a number into a cell, rounded if the column cannot represent it.
    ///
    /// # Errors
    /// If the number is beyond the column's range.
    pub fn put(
        &mut self,
        column: &NumberColumn,
        row: u64,
        number: f64,
        inward: Inward,
    ) -> Result<(), FileError> {
        // cfitsio rounds to the nearest. Moving the number by its error, then 2, 4 ... times that, reaches the next value that the column can
        // represent.
        let mut put = number;
        for step in 0..MOST_STEPS {
            let mut read = [put];
            self.called(&format!("write column {}", column.name), |file, status| {
                // SAFETY: one number is read.
                unsafe {
                    sys::ffpcld(
                        file,
                        column.number,
                        row as i64,
                        1,
                        1,
                        read.as_mut_ptr(),
                        status,
                    )
                };
            })?;
            self.read(column, row, &mut read)?;
            let off = number - read[0];
            let is_inward = match inward {
                Inward::Up => off <= 0.0,
                Inward::Down => off >= 0.0,
            };
            if is_inward {
                return Ok(());
            }
            put = number + off * f64::from(step).exp2();
        }
        let field = format!("column {}", column.name);
        let problem = Problem::field(field, "numbers it can hold", number);
        Err(problem.within(&self.name).in_file(&self.path))
    }

    /// The bytes of all rows, for tables that fit into memory.
    ///
    /// # Errors
    /// If a row does not exist.
    pub fn bytes(&mut self) -> Result<Vec<u8>, FileError> {
        let count = self.rows()?.saturating_mul(self.row_bytes()?);
        let mut bytes = vec![0; count as usize];
        self.called("read rows", |file, status| {
            // SAFETY: the buffer has space for this many bytes.
            unsafe { sys::ffgtbb(file, 1, 1, count as i64, bytes.as_mut_ptr(), status) };
        })?;
        Ok(bytes)
    }

    /// The length of a row, bytes.
    ///
    /// # Errors
    /// If the header does not state it.
    pub fn row_bytes(&mut self) -> Result<u64, FileError> {
        let mut bytes = 0;
        self.called("read NAXIS1", |file, status| {
            // SAFETY: the keyword ends with NUL, the number outlives the call, and the comment is not requested.
            unsafe {
                let none = std::ptr::null_mut();
                sys::ffgkyjj(file, c"NAXIS1".as_ptr(), &raw mut bytes, none, status)
            };
        })?;
        Ok(bytes as u64)
    }

    /// Writes bytes into a row, after its first `behind` bytes.
    ///
    /// # Errors
    /// Bytes that cannot be written.
    pub fn put_bytes(&mut self, row: u64, behind: u64, bytes: &[u8]) -> Result<(), FileError> {
        self.called("write a row", |file, status| {
            let (first, count) = (behind as i64 + 1, bytes.len() as i64);
            // SAFETY: cfitsio reads this many bytes and changes none.
            unsafe {
                let bytes = bytes.as_ptr().cast_mut();
                sys::ffptbb(file, row as i64, first, count, bytes, status)
            };
        })
    }

    /// Adds rows at the end, or removes rows from there.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn set_rows(&mut self, rows: u64) -> Result<(), FileError> {
        let now = self.rows()?;
        self.called("change the number of rows", |file, status| {
            let (now, rows) = (now as i64, rows as i64);
            // SAFETY: only numbers are passed.
            unsafe {
                match rows > now {
                    true => sys::ffirow(file, now, rows - now, status),
                    false => sys::ffdrow(file, rows + 1, now - rows, status),
                }
            };
        })
    }

    /// Deletes a row.
    ///
    /// # Errors
    /// If the row does not exist.
    pub fn delete_row(&mut self, row: u64) -> Result<(), FileError> {
        self.called("delete a row", |file, status| {
            // SAFETY: only numbers are passed.
            unsafe { sys::ffdrow(file, row as i64, 1, status) };
        })
    }

    /// Adds columns after the others, without values.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn add_columns(&mut self, columns: &[StoredColumn]) -> Result<(), FileError> {
        let mut before = 0;
        let cards: Vec<_> = columns.iter().map(StoredColumn::cards).collect();
        let names: Vec<CString> = cards.iter().map(|column| c_text(column.name)).collect();
        let forms: Vec<CString> = cards.iter().map(|column| c_text(&column.form)).collect();
        let [mut names, mut forms] = [&names, &forms].map(|texts| {
            let pointers = texts.iter().map(|text| text.as_ptr().cast_mut());
            pointers.collect::<Vec<_>>()
        });
        self.called("add columns", |file, status| {
            let count = names.len() as i32;
            // SAFETY: there are this many names and forms; they end with NUL, outlive the calls, and are only read.
            unsafe {
                sys::ffgncl(file, &raw mut before, status);
                let (names, forms) = (names.as_mut_ptr(), forms.as_mut_ptr());
                sys::fficls(file, before + 1, count, names, forms, status)
            };
        })?;
        for (n, column) in (before + 1..).zip(&cards) {
            if unit::is_known(column.unit) {
                self.keyword(&format!("TUNIT{n}"), column.unit, "")?;
            }
            let comment = unit::column_comment(column.meaning, column.unit);
            self.keyword(&format!("TCOMM{n}"), &comment, "")?;
        }
        Ok(())
    }

    /// Writes a keyword with a text.
    fn keyword(&mut self, keyword: &str, text: &str, comment: &str) -> Result<(), FileError> {
        let [name, text, comment] = [keyword, text, comment].map(c_text);
        self.called(&format!("write {keyword}"), |file, status| {
            // SAFETY: the texts end with NUL and outlive the call.
            unsafe { sys::ffukys(file, name.as_ptr(), text.as_ptr(), comment.as_ptr(), status) };
        })
    }

    /// Adds a card.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn card(&mut self, card: &[u8]) -> Result<(), FileError> {
        let card = c_text(&String::from_utf8_lossy(card));
        self.called("write a card", |file, status| {
            // SAFETY: the card ends with NUL and outlives the call.
            unsafe { sys::ffprec(file, card.as_ptr(), status) };
        })
    }

    /// Adds lines of HISTORY.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn history(&mut self, lines: &[String]) -> Result<(), FileError> {
        for line in lines {
            let line = c_text(line);
            self.called("write HISTORY", |file, status| {
                // SAFETY: the line ends with NUL and outlives the call.
                unsafe { sys::ffphis(file, line.as_ptr(), status) };
            })?;
        }
        Ok(())
    }

    /// Writes the checksums. cfitsio's own function writes the time of day beside them: the same table would not give the same bytes.
    fn seal(&mut self) -> Result<(), FileError> {
        for [keyword, comment] in [DATASUM, CHECKSUM] {
            self.keyword(keyword, NO_CHECKSUM, comment)?;
        }
        let [data, _] = self.sums()?;
        self.keyword(DATASUM[0], &data.to_string(), DATASUM[1])?;
        let [_, whole] = self.sums()?;
        let mut text = [0u8; 17];
        // SAFETY: cfitsio writes 16 characters and NUL.
        unsafe { sys::ffesum(whole, 1, text.as_mut_ptr().cast()) };
        let text = String::from_utf8_lossy(&text[..16]);
        self.keyword(CHECKSUM[0], &text, CHECKSUM[1])
    }

    /// Sums of the data, and of the whole HDU.
    fn sums(&mut self) -> Result<[u64; 2], FileError> {
        let (mut data, mut whole) = (0, 0);
        self.called("sum the table", |file, status| {
            // SAFETY: the numbers outlive the calls.
            unsafe {
                // Ends the header, and fills the last blocks.
                sys::ffflus(file, status);
                sys::ffgcks(file, &raw mut data, &raw mut whole, status)
            };
        })?;
        Ok([data, whole])
    }

    /// Writes the table, with its checksums, at the end of `to`.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn finish(mut self, to: &mut impl Write) -> Result<(), FileError> {
        self.seal()?;
        let (mut start, mut end) = (0, 0);
        self.called("write the table", |file, status| {
            let none = std::ptr::null_mut();
            // SAFETY: the numbers outlive the call; the start of the data is not requested.
            unsafe {
                sys::ffflus(file, status);
                sys::ffghadll(file, &raw mut start, none, &raw mut end, status)
            };
        })?;
        let copied = copy(self.own.as_file(), start as u64..end as u64, to);
        copied.map_err(|problem| problem.within(&self.name).in_file(&self.path))
    }
}

/// A text up to its first NUL.
fn c_text(text: &str) -> CString {
    let text = text.split('\0').next().unwrap_or_default();
    CString::new(text).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A table with one row and one column.
    fn table(form: &str, scale: f64) -> (AmendedTable, NumberColumn) {
        let folder = std::env::temp_dir();
        let mut table = AmendedTable::create("T", Path::new("t.fits"), &folder).unwrap();
        let form = c_text(form);
        let made = table.called("make a column", |file, status| unsafe {
            let name = c"START".as_ptr().cast_mut();
            sys::fficol(file, 1, name, form.as_ptr().cast_mut(), status);
            sys::ffukyd(file, c"TSCAL1".as_ptr(), scale, -17, c"".as_ptr(), status);
            sys::ffukyd(file, c"TZERO1".as_ptr(), 3.0, -17, c"".as_ptr(), status);
            sys::ffrdef(file, status);
        });
        made.unwrap();
        table.set_rows(1).unwrap();
        let column = NumberColumn {
            is_whole: false,
            number: 1,
            name: "START".into(),
            unit: None,
        };
        (table, column)
    }

    #[test]
    fn what_is_put_reads_back_inward_of_the_number_by_less_than_a_step() {
        for (form, scale, step) in [
            ("1B", 0.5, 0.5),
            ("1I", 0.5, 0.5),
            ("1J", -0.25, 0.25),
            ("1K", 1e-3, 1e-3),
            ("1E", 1.0, 1e-5),
            ("1D", 1.0, 3e-14),
            ("1D", -2.0, 3e-14),
        ] {
            let (mut table, column) = table(form, scale);
            for number in [3.0, 50.123_456_7, 29.0, 30.6] {
                let mut read = |inward| {
                    table.put(&column, 1, number, inward).unwrap();
                    let mut read = [0.0];
                    table.read(&column, 1, &mut read).unwrap();
                    read[0]
                };
                let (up, down) = (read(Inward::Up), read(Inward::Down));
                let within = 0.0..=step * (1.0 + 1e-9);
                assert!(within.contains(&(up - number)), "{form} {number} {up}");
                assert!(within.contains(&(number - down)), "{form} {number} {down}");
            }
        }
    }

    #[test]
    fn numbers_that_a_column_cannot_hold_are_errors() {
        let (mut table, column) = table("1B", 0.5);
        for number in [1000.0, f64::NAN] {
            let error = table.put(&column, 1, number, Inward::Up).unwrap_err();
            assert!(error.to_string().starts_with("t.fits: T: "), "{error}");
        }
    }
}
