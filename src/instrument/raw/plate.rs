//! The plate in an instrument's file: its drawing, the shape of its marks, and the measured positions.

use super::{Checker, Entry, IntoPosition};
use crate::files;
use crate::instrument::TomlError;
use crate::instrument::toml_file::unreadable;
use crate::plate::{
    self, Cross, LEAST_APART_SIZES, MOST_MARKS, MarkId, MarkPlace, MarkShape, Pattern, Plate,
    TableError, heroes,
};
use crate::units::PlateMil;
use serde::Deserialize;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// Largest distance of a mark from the plate's axes: plates are at most 1 m wide.
pub(super) const MOST_PLACE_MIL: f64 = 20_000.0;
/// Range of a mark's size for which the camera resolves it and others still fit on the disc, px.
const SIZES_PX: RangeInclusive<f64> = 3.0..=60.0;
/// Minimum visible width of a line, px.
const LEAST_LINE_PX: f64 = 0.1;
/// Minimum number of marks of a plate: this many determine a mapping.
const LEAST_MARKS: usize = 3;
/// A position farther than this from the drawing of 2013 is not a measurement of that drawing: half an arm.
const UNLIKE_DRAWING_MIL: f64 = 45.0;

#[derive(Deserialize)]
pub(super) struct RawPlate {
    pattern: Option<RawPattern>,
    /// File of the drawing's marks, relative to the instrument's file.
    marks: Option<PathBuf>,
    /// Contents of that file, if it has already been read.
    drawing: Option<RawDrawing>,
    #[serde(default)]
    shape: RawShape,
    arm_length_mil: Option<Entry<f64>>,
    arm_width_mil: Option<Entry<f64>>,
    arm_angle_deg: Option<Entry<f64>>,
    dot_diameter_mil: Option<Entry<f64>>,
    drawing_sigma_mil: Entry<f64>,
    field_radius_mil: Option<Entry<f64>>,
    #[serde(default)]
    mark: Vec<RawMark>,
}

#[derive(Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum RawPattern {
    Heroes,
    Listed,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum RawShape {
    #[default]
    Cross,
    Dot,
}

#[derive(Deserialize)]
struct RawDrawing {
    csv: String,
}

/// A mark of the drawing, or a measured one.
#[derive(Deserialize)]
struct RawMark {
    id: [i32; 2],
    position_mil: [f64; 2],
    sigma_mil: Option<[f64; 2]>,
    /// Its drawn position, if a list is the drawing and the position was measured.
    drawn_mil: Option<[f64; 2]>,
}

/// A mark with its id checked.
struct CheckedMark {
    id: MarkId,
    place: MarkPlace,
    drawn: Option<PlateMil>,
}

/// The text of an instrument's file with the table of marks that it names inserted: the text alone then describes the whole
/// plate.
///
/// # Errors
/// The table's file, and the error in it.
pub(in crate::instrument) fn with_table(path: &Path, text: String) -> Result<String, TomlError> {
    // The parser reports text that is not TOML.
    let Ok(mut document) = text.parse::<toml_edit::DocumentMut>() else {
        return Ok(text);
    };
    let plate = document
        .get_mut("plate")
        .and_then(|item| item.as_table_mut());
    let Some(plate) = plate.filter(|plate| !plate.contains_key("drawing")) else {
        return Ok(text);
    };
    let Some(marks) = plate.get("marks").and_then(|item| item.as_str()) else {
        return Ok(text);
    };
    let file = beside(path, Path::new(marks));
    let csv = read_marks(&file)?;
    // Errors in the table are found before it is inserted.
    plate::read_table(&csv, 0.0).map_err(|error| in_table(&file, error))?;
    let mut drawing = toml_edit::Table::new();
    drawing["csv"] = toml_edit::value(csv);
    plate.insert("drawing", toml_edit::Item::Table(drawing));
    Ok(document.to_string())
}

fn read_marks(file: &Path) -> Result<String, TomlError> {
    files::read_text(file).map_err(|unread| unreadable(file, &unread))
}

/// The path of a file named in another one.
fn beside(path: &Path, named: &Path) -> PathBuf {
    path.parent().unwrap_or(Path::new("")).join(named)
}

fn in_table(file: &Path, error: TableError) -> TomlError {
    TomlError::new(file, error.field, error.expected, error.found)
}

impl Checker<'_> {
    /// The plate, for a camera with the given scale.
    pub(super) fn plate(&self, raw: RawPlate, scale_mil_per_px: f64) -> Result<Plate, TomlError> {
        let entry = raw.drawing_sigma_mil;
        let sigma = self.measured("plate.drawing_sigma_mil", entry, 0.0..=20.0)?;
        let marks = self.marks(&raw.mark, sigma.value)?;
        let table = self.table(raw.marks.as_deref(), raw.drawing, sigma.value)?;
        let pattern = self.pattern(raw.pattern, table.is_some(), &marks)?;
        let shape = Shape {
            shape: raw.shape,
            arm_length_mil: raw.arm_length_mil,
            arm_width_mil: raw.arm_width_mil,
            arm_angle_deg: raw.arm_angle_deg,
            dot_diameter_mil: raw.dot_diameter_mil,
        };
        let shape = self.shape(shape, scale_mil_per_px)?;
        let field = raw.field_radius_mil.map(|entry| {
            let range = 0.0..=MOST_PLACE_MIL;
            self.measured("plate.field_radius_mil", entry, range)
        });
        let field = field.transpose()?;
        let (mut plate, drawn_by) = match (pattern, table) {
            (Pattern::Listed, _) => {
                self.check_ids(&marks)?;
                let drawn = |mark: &CheckedMark| match mark.drawn {
                    Some(at) => (mark.id, MarkPlace::new(at, sigma.value)),
                    None => (mark.id, mark.place),
                };
                let drawn = marks.iter().map(drawn);
                (Plate::new(pattern, shape, sigma.value, drawn), "plate.mark")
            }
            (Pattern::Table, Some(table)) => (
                Plate::new(pattern, shape, sigma.value, table),
                "plate.marks",
            ),
            _ => (Plate::heroes(shape, sigma.value), "plate.pattern"),
        };
        self.check_drawing(drawn_by, &plate)?;
        if let Some(field) = field {
            plate.field_radius_mil = field.value;
        }
        for (n, mark) in marks.iter().enumerate() {
            if plate.position(mark.id).is_none() {
                let expected = match pattern {
                    Pattern::Heroes => "indices from -7 to 7",
                    Pattern::Table | Pattern::Listed => "a mark of the drawing",
                };
                let field = format!("plate.mark[{n}].id");
                return Err(self.error(&field, expected, mark.id.to_string()));
            }
            plate.set(mark.id, mark.place.at, mark.place.sigma_mil);
        }
        Ok(plate)
    }

    /// The marks of `[[plate.mark]]`.
    fn marks(&self, raw: &[RawMark], sigma_mil: f64) -> Result<Vec<CheckedMark>, TomlError> {
        let mark = |(n, mark): (usize, &RawMark)| {
            let field = format!("plate.mark[{n}]");
            let [i, j] = mark.id;
            let id = MarkId::new(i, j).ok_or_else(|| {
                let expected = format!("indices within {} of 0", plate::MAX_INDEX);
                self.error(&format!("{field}.id"), &expected, format!("[{i}, {j}]"))
            })?;
            let sigma_mil = mark.sigma_mil.unwrap_or([sigma_mil; 2]);
            for (key, values, range) in [
                (
                    "position_mil",
                    Some(mark.position_mil),
                    -MOST_PLACE_MIL..=MOST_PLACE_MIL,
                ),
                (
                    "drawn_mil",
                    mark.drawn_mil,
                    -MOST_PLACE_MIL..=MOST_PLACE_MIL,
                ),
                ("sigma_mil", Some(sigma_mil), 0.0..=1e3),
            ] {
                for value in values.into_iter().flatten() {
                    self.within(&format!("{field}.{key}"), value, range.clone(), "mil")?;
                }
            }
            Ok(CheckedMark {
                id,
                place: MarkPlace {
                    at: mark.position_mil.into_position(),
                    sigma_mil,
                },
                drawn: mark.drawn_mil.map(IntoPosition::into_position),
            })
        };
        raw.iter().enumerate().map(mark).collect()
    }

    /// The marks of the table that the file names.
    fn table(
        &self,
        marks: Option<&Path>,
        drawing: Option<RawDrawing>,
        sigma_mil: f64,
    ) -> Result<Option<Vec<(MarkId, MarkPlace)>>, TomlError> {
        let file = beside(self.path, marks.unwrap_or(Path::new("")));
        let csv = match (drawing, marks) {
            (Some(drawing), _) => drawing.csv,
            (None, Some(_)) => read_marks(&file)?,
            (None, None) => return Ok(None),
        };
        let table = plate::read_table(&csv, sigma_mil).map_err(|error| in_table(&file, error))?;
        for (id, MarkPlace { at, sigma_mil }) in &table {
            let field = |name: &str| format!("mark {id}: {name}");
            let places = -MOST_PLACE_MIL..=MOST_PLACE_MIL;
            let table = Checker { path: &file };
            table.within(&field("x"), at.x, places.clone(), "mil")?;
            table.within(&field("y"), at.y, places, "mil")?;
            table.within(&field("sigma"), sigma_mil[0], 0.0..=1e3, "mil")?;
        }
        Ok(Some(table))
    }

    /// Source of the plate's drawing. Marks at other positions than those of 2013 are a separate drawing.
    fn pattern(
        &self,
        stated: Option<RawPattern>,
        has_table: bool,
        marks: &[CheckedMark],
    ) -> Result<Pattern, TomlError> {
        let of_heroes = |mark: &&CheckedMark| {
            let drawn = heroes::position(mark.id);
            heroes::holds(mark.id) && drawn.distance(mark.place.at) < UNLIKE_DRAWING_MIL
        };
        match stated {
            Some(pattern) if has_table => {
                let found = match pattern {
                    RawPattern::Heroes => "pattern = \"heroes\" beside marks",
                    RawPattern::Listed => "pattern = \"listed\" beside marks",
                };
                let expected = "one drawing, by marks or by pattern";
                Err(self.error("plate.pattern", expected, found))
            }
            Some(RawPattern::Heroes) => Ok(Pattern::Heroes),
            Some(RawPattern::Listed) => Ok(Pattern::Listed),
            None if has_table => Ok(Pattern::Table),
            None if 2 * marks.iter().filter(of_heroes).count() >= marks.len() => {
                Ok(Pattern::Heroes)
            }
            None => Ok(Pattern::Listed),
        }
    }

    /// Checks that no two marks of a list have the same id.
    fn check_ids(&self, marks: &[CheckedMark]) -> Result<(), TomlError> {
        let mut known = std::collections::HashMap::new();
        for (n, mark) in marks.iter().enumerate() {
            if let Some(first) = known.insert(mark.id, n) {
                let field = format!("plate.mark[{n}].id");
                let found = format!("{} of plate.mark[{first}] again", mark.id);
                return Err(self.error(&field, "an id that no other mark has", found));
            }
        }
        Ok(())
    }

    /// Checks that a drawing has enough marks, not too many, and no two so close that the camera cannot separate them.
    fn check_drawing(&self, field: &str, plate: &Plate) -> Result<(), TomlError> {
        let count = plate.count();
        if !(LEAST_MARKS..=MOST_MARKS).contains(&count) {
            let expected = format!("{LEAST_MARKS} to {MOST_MARKS} marks");
            return Err(self.error(field, &expected, count.to_string()));
        }
        let least_mil = LEAST_APART_SIZES * plate.shape.size_mil();
        let marks: Vec<(MarkId, PlateMil)> = plate.drawn_marks().collect();
        for (n, (a, at)) in marks.iter().enumerate() {
            let near = marks[..n]
                .iter()
                .find(|(_, other)| other.distance(*at) < least_mil);
            if let Some((b, other)) = near {
                let expected = format!("marks at least {least_mil} mil apart, twice a mark's size");
                let found = format!("{b} and {a} {:.1} mil apart", other.distance(*at));
                return Err(self.error(field, &expected, found));
            }
        }
        Ok(())
    }

    fn shape(&self, raw: Shape, scale_mil_per_px: f64) -> Result<MarkShape, TomlError> {
        let px = |range: RangeInclusive<f64>| {
            range.start() * scale_mil_per_px..=range.end() * scale_mil_per_px
        };
        let needed = |key: &str, entry: Option<Entry<f64>>, range: RangeInclusive<f64>| {
            let field = format!("plate.{key}");
            let entry = entry.ok_or_else(|| self.error(&field, "a value", "none"))?;
            Ok::<f64, TomlError>(self.measured(&field, entry, range)?.value)
        };
        let foreign = |key: &str, entry: bool, shape: &str| match entry {
            true => Err(self.error(
                &format!("plate.{key}"),
                &format!("none of marks of shape \"{shape}\""),
                "a value",
            )),
            false => Ok(()),
        };
        match raw.shape {
            RawShape::Cross => {
                foreign("dot_diameter_mil", raw.dot_diameter_mil.is_some(), "cross")?;
                let length = needed("arm_length_mil", raw.arm_length_mil, px(SIZES_PX))?;
                let widths = LEAST_LINE_PX * scale_mil_per_px..=length / 2.0;
                let angle = raw
                    .arm_angle_deg
                    .map(|angle| self.measured("plate.arm_angle_deg", angle, super::TURN_DEG));
                Ok(MarkShape::Cross(Cross {
                    arm_length_mil: length,
                    arm_width_mil: needed("arm_width_mil", raw.arm_width_mil, widths)?,
                    arm_angle_deg: angle.transpose()?.map_or(0.0, |angle| angle.value),
                }))
            }
            RawShape::Dot => {
                foreign("arm_length_mil", raw.arm_length_mil.is_some(), "dot")?;
                foreign("arm_width_mil", raw.arm_width_mil.is_some(), "dot")?;
                foreign("arm_angle_deg", raw.arm_angle_deg.is_some(), "dot")?;
                Ok(MarkShape::Dot {
                    diameter_mil: needed("dot_diameter_mil", raw.dot_diameter_mil, px(SIZES_PX))?,
                })
            }
        }
    }
}

/// Shape of the marks in a file.
struct Shape {
    shape: RawShape,
    arm_length_mil: Option<Entry<f64>>,
    arm_width_mil: Option<Entry<f64>>,
    arm_angle_deg: Option<Entry<f64>>,
    dot_diameter_mil: Option<Entry<f64>>,
}
