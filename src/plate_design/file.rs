//! An instrument's file with a designed plate.

use crate::calibrate::revision::Revision;
use crate::instrument::{Instrument, TomlError};
use crate::plate::{MarkShape, Plate};
use std::path::Path;
use toml_edit::{Array, InlineTable, Item, Table, Value, value};

/// An instrument's text with the designed parts replaced: the plate, its marks in a file `marks.csv` beside it, and lens
/// and scale if they changed. `path` is used in error messages.
///
/// # Errors
/// If the text is not TOML.
pub fn file(
    (path, text): (&Path, &str),
    before: &Instrument,
    designed: &Instrument,
    source: &str,
) -> Result<String, TomlError> {
    let mut revision = Revision::of(path, text)?;
    revision.put("plate", Item::Table(plate_table(&designed.plate, source)));
    // Its frames are not those of the original instrument.
    revision.put("name", value(format!("{}-designed", before.name)));
    let field_mil = designed.plate.field_radius_mil;
    let description = format!(
        "{:?} with a plate designed for a field of {field_mil} mil",
        before.name
    );
    revision.put("description", value(description));
    let numbers = |i: &Instrument| {
        [
            ("optics.focal_length_mm", i.optics.focal_length_mm),
            ("optics.plate_distance_mm", i.optics.plate_distance_mm),
            ("mounting.scale_mil_per_px", i.mounting.scale_mil_per_px),
            ("mounting.rotation_deg", i.mounting.rotation_deg),
        ]
    };
    for ((key, found), (_, old)) in numbers(designed).into_iter().zip(numbers(before)) {
        if found != old {
            revision.put(key, entry(found.value.into(), Some(found.sigma), source));
        }
    }
    let (new, old) = (&designed.mounting, &before.mounting);
    if new.boresight_mil != old.boresight_mil {
        let pair = Array::from_iter([new.boresight_mil.x, new.boresight_mil.y]);
        let entry = entry(pair.into(), Some(new.boresight_sigma_mil), source);
        revision.put("mounting.boresight_mil", entry);
    }
    Ok(revision.text())
}

fn plate_table(plate: &Plate, source: &str) -> Table {
    let number = |number: f64| entry(number.into(), None, source);
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
    table
}

/// A value in the format of an instrument's file.
fn entry(number: Value, sigma: Option<f64>, source: &str) -> Item {
    let mut entry = InlineTable::new();
    entry.insert("value", number);
    if let Some(sigma) = sigma {
        entry.insert("sigma", sigma.into());
    }
    entry.insert("source", source.into());
    value(entry)
}
