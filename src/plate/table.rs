//! A list of marks as a table: `i,j,x_mil,y_mil` and optionally `sigma_mil`, or `x_mm,y_mm` and `sigma_mm`.

use super::{MAX_INDEX, MarkId, MarkPlace, Plate};
use crate::units::{MIL_MM, PlateMil};
use std::collections::HashMap;

/// Error in a table of marks.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field}: expected {expected}, found {found}")]
pub struct TableError {
    /// The line, and the column if only one is wrong.
    pub field: String,
    pub expected: String,
    pub found: String,
}

impl TableError {
    fn new(
        field: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self {
            field: field.into(),
            expected: expected.into(),
            found: found.into(),
        }
    }
}

/// Reads marks with their positions; a mark without a sigma gets `sigma_mil`. Lines that begin with `#` are comments.
///
/// # Errors
/// The line, the column and what was expected there: a column name, a number, or an id that no other line has.
pub fn read_table(text: &str, sigma_mil: f64) -> Result<Vec<(MarkId, MarkPlace)>, TableError> {
    // Spreadsheets begin their files with a byte order mark.
    let text = text.trim_start_matches('\u{feff}');
    let mut reader = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes());
    let unreadable = |error: &csv::Error| {
        let line = error.position().map_or(1, csv::Position::line);
        TableError::new(
            format!("line {line}"),
            "as many values as the first line has names",
            error.to_string(),
        )
    };
    let names = reader.headers().map_err(|error| unreadable(&error))?;
    let columns = Columns::of(names)?;
    let (mut marks, mut lines) = (Vec::new(), HashMap::new());
    for record in reader.records() {
        let record = record.map_err(|error| unreadable(&error))?;
        let line = record.position().map_or(0, csv::Position::line);
        let (id, place) = columns.mark(&record, line, sigma_mil)?;
        if let Some(first) = lines.insert(id, line) {
            let expected = "an id that no other mark has";
            let found = format!("{id} of line {first} again");
            return Err(TableError::new(format!("line {line}"), expected, found));
        }
        marks.push((id, place));
    }
    Ok(marks)
}

/// The table of a drawing, rounded to 0.001 mil.
pub fn table_text(plate: &Plate) -> String {
    let mut text = String::from("i,j,x_mil,y_mil\n");
    for (id, at) in plate.drawn_marks() {
        text += &format!("{},{},{:.3},{:.3}\n", id.i, id.j, at.x, at.y);
    }
    text
}

/// Indices of the columns of a table.
struct Columns {
    i: usize,
    j: usize,
    x: usize,
    y: usize,
    sigma: Option<usize>,
    /// "mil" or "mm".
    unit: &'static str,
    unit_mil: f64,
}

impl Columns {
    fn of(names: &csv::StringRecord) -> Result<Self, TableError> {
        let at = |name: &str| names.iter().position(|known| known == name);
        let unit = if at("x_mm").is_some() { "mm" } else { "mil" };
        let [x, y, sigma] = ["x", "y", "sigma"].map(|name| format!("{name}_{unit}"));
        let known = ["i", "j", x.as_str(), y.as_str(), sigma.as_str()];
        let joined = names.iter().collect::<Vec<_>>().join(",");
        let expected =
            || "columns i,j,x_mil,y_mil and optionally sigma_mil, or x_mm,y_mm and sigma_mm";
        let wrong = || TableError::new("line 1", expected(), format!("\"{joined}\""));
        let mut seen = Vec::new();
        for name in names {
            if !known.contains(&name) || seen.contains(&name) {
                return Err(wrong());
            }
            seen.push(name);
        }
        let column = |name: &str| at(name).ok_or_else(wrong);
        Ok(Self {
            i: column("i")?,
            j: column("j")?,
            x: column(&x)?,
            y: column(&y)?,
            sigma: at(&sigma),
            unit,
            unit_mil: if unit == "mm" { 1.0 / MIL_MM } else { 1.0 },
        })
    }

    fn mark(
        &self,
        record: &csv::StringRecord,
        line: u64,
        sigma_mil: f64,
    ) -> Result<(MarkId, MarkPlace), TableError> {
        let value = |column: usize| record.get(column).unwrap_or_default();
        let index = |name: &str, column: usize| {
            let text = value(column);
            let within = |n: &i32| (-MAX_INDEX..=MAX_INDEX).contains(n);
            let index: Option<i32> = text.parse().ok().filter(within);
            index.ok_or_else(|| {
                let expected = format!("a whole number from -{MAX_INDEX} to {MAX_INDEX}");
                TableError::new(
                    format!("line {line}: {name}"),
                    expected,
                    format!("\"{text}\""),
                )
            })
        };
        let number = |name: &str, column: usize| {
            let text = value(column);
            let number: Option<f64> = text.parse().ok().filter(|v: &f64| v.is_finite());
            number.map(|v| v * self.unit_mil).ok_or_else(|| {
                let field = format!("line {line}: {name}_{}", self.unit);
                TableError::new(field, "a number", format!("\"{text}\""))
            })
        };
        let id = MarkId {
            i: index("i", self.i)?,
            j: index("j", self.j)?,
        };
        let sigma_mil = match self.sigma {
            Some(column) => number("sigma", column)?,
            None => sigma_mil,
        };
        let at = PlateMil::new(number("x", self.x)?, number("y", self.y)?);
        Ok((id, MarkPlace::new(at, sigma_mil)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_in_mm_is_the_same_as_one_in_mil() {
        let mil = "i,j,x_mil,y_mil\n1,0,1000,-500\n# a comment\n-2,3,0,40\n";
        let mm = "\u{feff}sigma_mm, x_mm, y_mm, i, j\n0.0254, 25.4, -12.7, 1, 0\n0.0127, 0, 1.016, -2, 3\n";
        let (mil, mm) = (read_table(mil, 1.0).unwrap(), read_table(mm, 9.0).unwrap());
        for ((id, a), (same, b)) in mil.iter().zip(&mm) {
            assert_eq!(id, same);
            assert!(a.at.distance(b.at) < 1e-9);
        }
        assert!((mm[0].1.sigma_mil[0] - 1.0).abs() < 1e-12 && mil[1].1.sigma_mil == [1.0; 2]);
    }

    #[test]
    fn what_is_wrong_names_line_and_column() {
        for (text, error) in [
            (
                "",
                "line 1: expected columns i,j,x_mil,y_mil and optionally sigma_mil, or x_mm,y_mm and sigma_mm, found \"\"",
            ),
            (
                "i,j,x,y\n",
                "line 1: expected columns i,j,x_mil,y_mil and optionally sigma_mil, or x_mm,y_mm and sigma_mm, found \"i,j,x,y\"",
            ),
            (
                "i,j,x_mil,y_mil\n1,0,2,3\n1,0,500,3\n",
                "line 3: expected an id that no other mark has, found (1, 0) of line 2 again",
            ),
            (
                "i,j,x_mil,y_mil\n1,0,far,3\n",
                "line 2: x_mil: expected a number, found \"far\"",
            ),
            (
                "i,j,x_mm,y_mm\n10000,0,2,3\n",
                "line 2: i: expected a whole number from -9999 to 9999, found \"10000\"",
            ),
        ] {
            assert_eq!(read_table(text, 1.0).unwrap_err().to_string(), error);
        }
        let short = read_table("i,j,x_mil,y_mil\n1,0,2\n", 1.0).unwrap_err();
        assert!(
            short
                .to_string()
                .starts_with("line 2: expected as many values"),
            "{short}"
        );
    }
}
