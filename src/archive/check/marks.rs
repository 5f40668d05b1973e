//! The table of marks that an archived file carries.

use super::field;
use crate::fits::{Column, FileError, FitsFile, Problem, Table, Values};

/// A mark as the file has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    pub id: [i64; 2],
    pub px: [f64; 2],
    /// Per axis.
    pub sigma_px: f64,
}

/// The marks of a file, as [`tables`](crate::archive::tables) lays them out; none where it has no such table.
///
/// # Errors
/// A table of marks without one of the columns, or with another kind of values in it.
pub fn marks(file: &FitsFile) -> Result<Vec<Mark>, FileError> {
    match file.table("MARKS")? {
        None => Ok(Vec::new()),
        Some(table) => rows(&table).map_err(|problem| problem.in_file(file.path())),
    }
}

fn rows(table: &Table) -> Result<Vec<Mark>, Problem> {
    let (i, j) = (whole(table, "I")?, whole(table, "J")?);
    let (x, y, sigma) = (real(table, "X")?, real(table, "Y")?, real(table, "SIGMA")?);
    let mark = |n: usize| Mark {
        id: [i[n], j[n]],
        px: [x[n], y[n]],
        sigma_px: sigma[n],
    };
    // All columns of a table have the same length.
    Ok((0..i.len()).map(mark).collect())
}

fn whole<'a>(table: &'a Table, name: &str) -> Result<&'a [i64], Problem> {
    match column(table, name)? {
        Values::Integer(values) => Ok(values),
        other => Err(wrong(name, "whole numbers", other)),
    }
}

fn real<'a>(table: &'a Table, name: &str) -> Result<&'a [f64], Problem> {
    match column(table, name)? {
        Values::Float(values) => Ok(values),
        other => Err(wrong(name, "floating-point numbers", other)),
    }
}

fn column<'a>(table: &'a Table, name: &str) -> Result<&'a Values, Problem> {
    let named = |column: &&Column| column.name == name;
    match table.columns.iter().find(named) {
        Some(column) => Ok(&column.values),
        None => Err(field("MARKS", format!("a column {name}"), "none")),
    }
}

fn wrong(name: &str, expected: &str, found: &Values) -> Problem {
    field(&format!("MARKS: {name}"), expected, found.kind())
}
