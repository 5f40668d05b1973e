//! Tables whose columns are declared once, each with name, unit, meaning and value: FITS, CSV and the manual's page are made from the
//! declaration.

use crate::fits::{Card, CellForm, FileError, Problem, StoredColumn, StoredRow, TableFile};
use crate::provenance;
use std::borrow::{Borrow, Cow};
use std::fs::{self, File, Permissions};
use std::io::{self, BufWriter};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use tempfile::NamedTempFile;

/// A column: its values are of one type, whatever a row holds, and whether there is one.
pub struct Column<T> {
    pub name: &'static str,
    /// As FITS writes it where it knows it; empty for values without.
    pub unit: &'static str,
    pub meaning: &'static str,
    pub value: Value<T>,
}

/// A column's value in a row. What is not known is empty in CSV; in FITS it is NaN, or the integer that TNULLn names.
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
    /// As CSV has it: floats are the shortest that read back as the same number.
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

/// How many characters the longest text of each column has; FITS must know before the first row.
#[derive(Debug, Clone)]
pub struct Widths(Vec<usize>);

impl Widths {
    /// Of a table without rows.
    pub fn new<T>(columns: &[Column<T>]) -> Self {
        Self::of(columns, 1)
    }

    /// All texts have so many characters at most.
    pub fn of<T>(columns: &[Column<T>], characters: usize) -> Self {
        Self(vec![characters; columns.len()])
    }

    /// Widens the columns for a row.
    pub fn hold<T>(&mut self, columns: &[Column<T>], row: &T) {
        for (width, column) in self.0.iter_mut().zip(columns) {
            if let Value::Text(value) = column.value {
                *width = value(row).chars().count().max(*width);
            }
        }
    }
}

/// Writes rows as CSV, below a line of the columns' names; gives the widths of their texts.
///
/// # Errors
/// Errors of a row; a file that cannot be written.
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

/// Adds rows as a table of a FITS file.
///
/// # Errors
/// Errors of a row; a file that cannot be written.
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

/// The columns as FITS stores them.
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

/// Writes tables to a FITS file that is whole or absent; `cards` go into every header of it.
///
/// # Errors
/// Errors of `fill`; a file that cannot be written.
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

/// Writes a file that is whole or absent.
///
/// # Errors
/// A file that cannot be written.
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

/// A file beside another, which it becomes when it is whole; until then it goes with the run.
///
/// # Errors
/// A folder that takes no file.
pub fn part_beside(path: &Path) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    let builder = builder.prefix(".solaspect-").suffix(".part");
    // As of any new file: the umask takes its share.
    let builder = builder.permissions(Permissions::from_mode(0o666));
    builder.tempfile_in(folder_of(path))
}

/// That a file could not be written.
pub fn refused(path: &Path, cause: io::Error) -> FileError {
    Problem::unwritten(cause).in_file(path)
}

/// SHA-256 of a file, hexadecimal.
///
/// # Errors
/// A file that cannot be read.
pub fn sha256(path: &Path) -> Result<String, FileError> {
    provenance::sha256_of_file(path).map_err(|cause| Problem::unread(cause).in_file(path))
}

/// The table of columns of a page of the manual, in Markdown.
pub fn markdown<T>(columns: &[Column<T>]) -> String {
    let line = |c: &Column<T>| format!("| `{}` | {} | {} |\n", c.name, c.unit, c.meaning);
    let head = "| column | unit | meaning |\n|---|---|---|\n";
    head.to_owned() + &columns.iter().map(line).collect::<String>()
}
