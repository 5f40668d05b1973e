//! The table of marks in an archived file.

use super::field;
use crate::fits::{Column, FileError, FitsFile, Problem, Table, Values};

/// A mark in a file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    pub id: [i64; 2],
    pub px: [f64; 2],
    /// 1 sigma per axis.
    pub sigma_px: f64,
}

/// The marks of a file, in the layout of [`tables`](crate::archive::tables); none if it has no such table.
///
/// # Errors
/// If a table of marks lacks one of the columns, or has values of another type in it.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let column = |name: &str, values| Column {
            name: name.into(),
            unit: String::new(),
            meaning: String::new(),
            values,
        };
        Table {
            name: "MARKS".into(),
            columns: vec![
                column("J", Values::Integer(vec![12])),
                column("I", Values::Integer(vec![-3])),
                column("X", Values::Float(vec![640.25])),
                column("Y", Values::Float(vec![1e-3])),
                column("SIGMA", Values::Float(vec![0.05])),
            ],
        }
    }

    #[test]
    fn a_mark_is_two_whole_numbers_and_three_real_ones_found_by_their_names() {
        let expected = Mark {
            id: [-3, 12],
            px: [640.25, 1e-3],
            sigma_px: 0.05,
        };
        assert_eq!(rows(&table()).unwrap(), [expected]);
    }

    #[test]
    fn a_table_of_another_make_is_an_error_that_names_the_column() {
        let mut texts = table();
        texts.columns[3].values = Values::Text(vec!["1".into()]);
        let mut renamed = table();
        renamed.columns[4].name = "S".into();
        for (table, message) in [
            (
                texts,
                "MARKS: Y: expected floating-point numbers, found texts",
            ),
            (renamed, "MARKS: expected a column SIGMA, found none"),
        ] {
            assert_eq!(rows(&table).unwrap_err().to_string(), message);
        }
    }
}
