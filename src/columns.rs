//! Tables whose columns are declared once, each with name, unit, meaning and value; FITS, CSV and the manual's page are
//! generated from the declaration.

use crate::fits::{Card, CellForm, FileError, Problem, StoredColumn, StoredRow, TableFile};
use crate::provenance;
use std::borrow::{Borrow, Cow};
use std::fs::{self, File, Permissions};
use std::io::{self, BufWriter};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use tempfile::NamedTempFile;

/// A column: its values have one type in all rows, and are either always present or optional.
pub struct Column<T> {
    pub name: &'static str,
    /// Unit in FITS notation if FITS knows it; empty for dimensionless values.
    pub unit: &'static str,
    pub meaning: &'static str,
    pub value: Value<T>,
}

/// A column's value in a row. An unknown value is empty in CSV; in FITS it is NaN, or the integer named by TNULLn.
pub enum Value<T> {
    Text(fn(&T) -> Cow<'_, str>),
    Integer(fn(&T) -> Option<i64>),
    Float(fn(&T) -> Option<f64>),
    /// 1 or 0 in CSV.
    Logical(fn(&T) -> bool),
}

pub const fn text<T>(
    name: &'static str,
    meaning: &'static str,
    value: fn(&T) -> Cow<'_, str>,
) -> Column<T> {
    Column {
        name,
        unit: "",
        meaning,
        value: Value::Text(value),
    }
}

pub const fn integer<T>(
    name: &'static str,
    meaning: &'static str,
    value: fn(&T) -> Option<i64>,
) -> Column<T> {
    Column {
        name,
        unit: "",
        meaning,
        value: Value::Integer(value),
    }
}

pub const fn float<T>(
    name: &'static str,
    unit: &'static str,
    meaning: &'static str,
    value: fn(&T) -> Option<f64>,
) -> Column<T> {
    Column {
        name,
        unit,
        meaning,
        value: Value::Float(value),
    }
}

pub const fn logical<T>(
    name: &'static str,
    meaning: &'static str,
    value: fn(&T) -> bool,
) -> Column<T> {
    Column {
        name,
        unit: "",
        meaning,
        value: Value::Logical(value),
    }
}

impl<T> Column<T> {
    /// The value in CSV format: floats are the shortest that read back as the same number.
    fn csv<'a>(&self, row: &'a T) -> Cow<'a, str> {
        match self.value {
            Value::Text(value) => value(row),
            Value::Integer(value) => value(row).map_or(String::new(), |n| n.to_string()).into(),
            Value::Float(value) => value(row)
                .map_or(String::new(), |x| format!("{x:?}"))
                .into(),
            Value::Logical(value) => if value(row) { "1" } else { "0" }.into(),
        }
    }

    fn form(&self, characters: usize) -> CellForm {
        match self.value {
            Value::Text(_) => CellForm::Text(characters),
            Value::Integer(_) => CellForm::Integer,
            Value::Float(_) => CellForm::Float,
            Value::Logical(_) => CellForm::Logical,
        }
    }

    fn store(&self, row: &T, characters: usize, stored: &mut StoredRow) {
        match self.value {
            Value::Text(value) => stored.text(&value(row), characters),
            Value::Integer(value) => stored.integer(value(row)),
            Value::Float(value) => stored.float(value(row)),
            Value::Logical(value) => stored.logical(value(row)),
        }
    }
}

/// Maximum number of characters of each column's texts; FITS needs it before the first row.
#[derive(Debug, Clone)]
pub struct Widths(Vec<usize>);

impl Widths {
    /// For a table without rows.
    pub fn new<T>(columns: &[Column<T>]) -> Self {
        Self::of(columns, 1)
    }

    /// All texts have at most `characters` characters.
    pub fn of<T>(columns: &[Column<T>], characters: usize) -> Self {
        Self(vec![characters; columns.len()])
    }

    /// Widens the columns to fit a row.
    pub fn hold<T>(&mut self, columns: &[Column<T>], row: &T) {
        for (width, column) in self.0.iter_mut().zip(columns) {
            if let Value::Text(value) = column.value {
                *width = value(row).chars().count().max(*width);
            }
        }
    }
}

/// Writes rows as CSV, below a line with the columns' names; returns the widths of their texts.
///
/// # Errors
/// Errors of a row, or a file that cannot be written.
pub fn write_csv<T, R: Borrow<T>, E: From<FileError>>(
    path: &Path,
    columns: &[Column<T>],
    rows: impl Iterator<Item = Result<R, E>>,
) -> Result<Widths, E> {
    let mut widths = Widths::new(columns);
    let mut outcome = Ok(());
    let written = whole(path, |file| {
        let mut csv = csv::Writer::from_writer(file);
        csv.write_record(columns.iter().map(|column| column.name))?;
        for row in rows {
            let row = row.map_err(|error| {
                outcome = Err(error);
                io::Error::other("a row is missing")
            })?;
            widths.hold(columns, row.borrow());
            csv.write_record(columns.iter().map(|c| c.csv(row.borrow()).into_owned()))?;
        }
        csv.flush()
    });
    outcome?;
    written?;
    Ok(widths)
}

/// Appends rows as a table of a FITS file.
///
/// # Errors
/// Errors of a row, or a file that cannot be written.
pub fn write_fits<T, R: Borrow<T>, E: From<FileError>>(
    file: &mut TableFile,
    name: &str,
    columns: &[Column<T>],
    widths: &Widths,
    rows: impl Iterator<Item = Result<R, E>>,
) -> Result<(), E> {
    let heads = stored_columns(columns, widths);
    file.table(name, &heads, rows, |row, stored| {
        store(columns, widths, row.borrow(), stored);
    })
}

/// The columns in FITS format.
pub fn stored_columns<T>(columns: &[Column<T>], widths: &Widths) -> Vec<StoredColumn> {
    let stored = |(column, width): (&Column<T>, &usize)| StoredColumn {
        name: column.name,
        unit: column.unit,
        meaning: column.meaning,
        form: column.form(*width),
    };
    columns.iter().zip(&widths.0).map(stored).collect()
}

/// Adds a row's cells.
pub fn store<T>(columns: &[Column<T>], widths: &Widths, row: &T, stored: &mut StoredRow) {
    let cells = columns.iter().zip(&widths.0);
    cells.for_each(|(column, width)| column.store(row, *width, stored));
}

/// Writes tables to a FITS file that is either complete or absent; `cards` are added to all of its headers.
///
/// # Errors
/// Errors of `fill`, or a file that cannot be written.
pub fn write_tables<E: From<FileError>>(
    path: &Path,
    cards: &[Card],
    fill: impl FnOnce(&mut TableFile) -> Result<(), E>,
) -> Result<(), E> {
    let part = path.with_extension("part");
    let mut file = TableFile::create(&part, cards)?;
    fill(&mut file)?;
    file.finish()?;
    fs::rename(&part, path).map_err(|cause| refused(path, cause))?;
    Ok(())
}

/// Writes a file that is either complete or absent.
///
/// # Errors
/// If the file cannot be written.
pub fn whole(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), FileError> {
    let part = path.with_extension("part");
    let make = || {
        let mut file = BufWriter::with_capacity(1 << 16, File::create(&part)?);
        write(&mut file)?;
        file.into_inner()?.sync_all()?;
        fs::rename(&part, path)
    };
    make().map_err(|cause| refused(path, cause))
}

/// The folder that a path is in.
pub fn folder_of(path: &Path) -> &Path {
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    folder.unwrap_or(Path::new("."))
}

/// A temporary file beside another one, to be renamed when it is complete; otherwise it is removed with the run.
///
/// # Errors
/// If no file can be created in the folder.
pub fn part_beside(path: &Path) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    let builder = builder.prefix(".solaspect-").suffix(".part");
    // Permissions of a new file, reduced by the umask.
    let builder = builder.permissions(Permissions::from_mode(0o666));
    builder.tempfile_in(folder_of(path))
}

/// The error for a file that could not be written.
pub fn refused(path: &Path, cause: io::Error) -> FileError {
    Problem::unwritten(cause).in_file(path)
}

/// SHA-256 of a file, hexadecimal.
///
/// # Errors
/// If the file cannot be read.
pub fn sha256(path: &Path) -> Result<String, FileError> {
    provenance::sha256_of_file(path).map_err(|cause| Problem::unread(cause).in_file(path))
}

/// The table of columns of a page of the manual, in Markdown.
pub fn markdown<T>(columns: &[Column<T>]) -> String {
    let line = |c: &Column<T>| format!("| `{}` | {} | {} |\n", c.name, c.unit, c.meaning);
    let head = "| column | unit | meaning |\n|---|---|---|\n";
    head.to_owned() + &columns.iter().map(line).collect::<String>()
}
