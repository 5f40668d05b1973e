//! A designed plate as files: its table of marks, and an instrument's file with it.

use crate::plate::{MarkShape, Plate};
use std::fmt::Write;
use toml_edit::{DocumentMut, InlineTable, Item, Table, TomlError, Value, value};

/// The table of a drawing's marks.
pub fn table(plate: &Plate) -> String {
    let mut text = String::from("i,j,x_mil,y_mil\n");
    for (id, at) in plate.drawn_marks() {
        let _ = writeln!(text, "{},{},{:.3},{:.3}", id.i, id.j, at.x, at.y);
    }
    text
}

/// An instrument's text with this plate in place of its own, the marks in a file `marks.csv` beside it.
///
/// # Errors
/// A text that is no TOML.
pub fn file(text: &str, plate: &Plate, source: &str) -> Result<String, TomlError> {
    let mut document: DocumentMut = text.parse()?;
    let number = |number: f64| {
        let mut entry = InlineTable::new();
        entry.insert("value", Value::from(number));
        entry.insert("source", Value::from(source));
        value(entry)
    };
    let mut table = Table::new();
    table["marks"] = value("marks.csv");
    table["shape"] = value(plate.shape.name());
    match plate.shape {
        MarkShape::Cross(cross) => {
            table["arm_length_mil"] = number(cross.arm_length_mil);
            table["arm_width_mil"] = number(cross.arm_width_mil);
            table["arm_angle_deg"] = number(cross.arm_angle_deg);
        }
        MarkShape::Dot { diameter_mil } => table["dot_diameter_mil"] = number(diameter_mil),
    }
    table["drawing_sigma_mil"] = number(plate.drawing_sigma_mil());
    table["field_radius_mil"] = number(plate.field_radius_mil);
    document["plate"] = Item::Table(table);
    // Its frames are not those of the instrument that it began with.
    let name = document
        .get("name")
        .and_then(Item::as_str)
        .unwrap_or_default();
    document["name"] = value(format!("{name}-designed"));
    Ok(document.to_string())
}
