//! The columns of the history, in one place: `aspect.fits`, `aspect.csv` and `docs/refine.md` are made from these tables.

mod aspect;
mod roll;
mod smoothed;
mod stabilisation;

pub use aspect::{ASPECT, ASPECT_COLUMNS};
pub use roll::{ROLL, ROLL_COLUMNS};
pub use smoothed::{SMOOTHED, SMOOTHED_COLUMNS, SmoothedRow};
pub use stabilisation::{STABILISATION, STABILISATION_COLUMNS, StabilisationRow};

use crate::fits::{Column, Table, Values};

/// A column's value in one row.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    Text(String),
    Integer(i64),
    /// NaN in the table where there is none.
    Float(Option<f64>),
}

/// One column.
pub struct ColumnRow<T> {
    pub name: &'static str,
    /// As FITS writes it where it knows it; empty for values without.
    pub unit: &'static str,
    pub meaning: &'static str,
    pub value: fn(&T) -> Cell,
}

/// The meaning of a time's sigma.
const TIME_SIGMA: &str =
    "1 sigma of the time, where the header's contradicts others; NaN where it is believed";

const fn column<T>(
    name: &'static str,
    unit: &'static str,
    meaning: &'static str,
    value: fn(&T) -> Cell,
) -> ColumnRow<T> {
    ColumnRow {
        name,
        unit,
        meaning,
        value,
    }
}

/// A table of rows.
pub fn table<T>(name: &str, columns: &[ColumnRow<T>], rows: &[T]) -> Table {
    let column = |column: &ColumnRow<T>| Column {
        name: column.name.into(),
        unit: column.unit.into(),
        meaning: column.meaning.into(),
        values: values(rows, column.value),
    };
    Table {
        name: name.into(),
        columns: columns.iter().map(column).collect(),
    }
}

/// The values of a column; its first row tells of which kind they are.
fn values<T>(rows: &[T], value: fn(&T) -> Cell) -> Values {
    match rows.first().map(value) {
        Some(Cell::Text(_)) => Values::Text(rows.iter().map(|row| text(&value(row))).collect()),
        Some(Cell::Integer(_)) => {
            let integer = |row| match value(row) {
                Cell::Integer(integer) => integer,
                _ => -1,
            };
            Values::Integer(rows.iter().map(integer).collect())
        }
        _ => {
            let float = |row| match value(row) {
                Cell::Float(float) => float.unwrap_or(f64::NAN),
                _ => f64::NAN,
            };
            Values::Float(rows.iter().map(float).collect())
        }
    }
}

/// A cell as CSV has it: nothing where nothing is known. Floats are the shortest that read back as the same number.
pub fn text(cell: &Cell) -> String {
    match cell {
        Cell::Text(text) => text.clone(),
        Cell::Integer(integer) => integer.to_string(),
        Cell::Float(Some(float)) => format!("{float:?}"),
        Cell::Float(None) => String::new(),
    }
}

/// The page's tables of columns, in Markdown.
pub fn markdown() -> String {
    fn lines<T>(columns: &[ColumnRow<T>]) -> String {
        let line = |c: &ColumnRow<T>| format!("| `{}` | {} | {} |\n", c.name, c.unit, c.meaning);
        let head = "| column | unit | meaning |\n|---|---|---|\n";
        head.to_owned() + &columns.iter().map(line).collect::<String>()
    }
    format!(
        "### {ASPECT}\n\n{}\n### {SMOOTHED}\n\n{}\n### {STABILISATION}\n\n{}\n### {ROLL}\n\n{}",
        lines(ASPECT_COLUMNS),
        lines(SMOOTHED_COLUMNS),
        lines(STABILISATION_COLUMNS),
        lines(ROLL_COLUMNS)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// With SOLASPECT_WRITE_DOCS set, the page's tables are written instead.
    #[test]
    fn the_page_of_columns_is_that_of_the_tables() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/refine.md");
        let page = std::fs::read_to_string(path).unwrap();
        let (before, rest) = page.split_once(&format!("### {ASPECT}\n")).unwrap();
        let after = rest.find("\n## ").map_or("", |at| &rest[at..]);
        let wanted = format!("{before}{}{after}", markdown());
        if std::env::var_os("SOLASPECT_WRITE_DOCS").is_some() {
            std::fs::write(path, &wanted).unwrap();
        } else {
            let told =
                "docs/refine.md has other columns: run this test with SOLASPECT_WRITE_DOCS=1";
            assert!(page == wanted, "{told}");
        }
    }

    #[test]
    fn names_differ_and_are_as_fits_wants_them() {
        let names = ASPECT_COLUMNS.iter().map(|column| column.name);
        let mut names: Vec<&str> = names.collect();
        let all = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), all);
        let legal = |b: u8| b.is_ascii_uppercase() || b.is_ascii_digit() || b == b'_';
        assert!(names.iter().all(|name| name.bytes().all(legal)));
    }
}
