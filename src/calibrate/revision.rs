//! A revision of an instrument's file, or of NAV.toml: some entries are replaced, every other line, comment and their order stay.

use crate::calibrate::numbers::value_text;
use crate::instrument::{Instrument, TomlError};
use crate::observe::sha256;
use crate::provenance::{self, COMMIT, PROGRAM};
use crate::units::Measured;
use jiff::Timestamp;
use jiff::civil::Date;
use jiff::tz::TimeZone;
use nalgebra::SMatrix;
use std::path::{Path, PathBuf};
use toml_edit::{DocumentMut, InlineTable, Item, Table, TableLike, Value, value};

/// Provenance of new values, for people: it is written beside each value.
#[derive(Debug, Clone, PartialEq)]
pub struct Provenance {
    /// The name of the calibration: the table `[calibration.NAME]` describes its inputs.
    pub name: &'static str,
    /// Description of the method, with the number of frames.
    pub source: String,
    /// Date of the frames; none if they do not state it.
    pub date: Option<Date>,
    pub frames: usize,
    /// Hash over the sorted SHA-256 of the files.
    pub frames_sha256: String,
    /// The camera's name stated in the frames.
    pub camera: Option<String>,
}

impl Provenance {
    /// Provenance from the number of frames, their times and files: the method, and the time span.
    pub fn of_frames(
        name: &'static str,
        done: &str,
        frames: usize,
        times: impl Iterator<Item = Timestamp> + Clone,
        files: &[PathBuf],
    ) -> Self {
        let first = times.clone().min().unwrap_or_default();
        let last = times.max().unwrap_or_default();
        Self {
            name,
            source: format!("{done}, {frames} frames from {first:.0} to {last:.0}"),
            date: Some(TimeZone::UTC.to_datetime(last).date()),
            frames,
            frames_sha256: sha256(files),
            camera: None,
        }
    }

    fn date_value(&self) -> Option<Value> {
        self.date?.to_string().parse().ok()
    }
}

/// An instrument's file, open for changes.
#[derive(Debug, Clone)]
pub struct Revision {
    path: PathBuf,
    /// SHA-256 of the original text.
    sha256: String,
    document: DocumentMut,
}

impl Revision {
    /// Parses an instrument's text; errors name `path`.
    pub fn of(path: &Path, text: &str) -> Result<Self, TomlError> {
        let document = text.parse().map_err(|error: toml_edit::TomlError| {
            TomlError::new(path, "", "valid TOML", error.message())
        })?;
        Ok(Self {
            path: path.into(),
            sha256: provenance::sha256(text),
            document,
        })
    }

    /// Replaces a number; both it and its sigma are written to two digits of the sigma.
    pub fn set_measured(&mut self, key: &str, found: Measured, provenance: &Provenance) {
        let value = number(found.value, found.sigma);
        self.set(key, value, Some(found.sigma), provenance);
    }

    /// Replaces a pair of numbers that share a sigma.
    pub fn set_pair(&mut self, key: &str, pair: [f64; 2], sigma: f64, provenance: &Provenance) {
        let numbers = pair.map(|value| number(value, sigma));
        let value = Value::Array(numbers.into_iter().collect());
        self.set(key, value, Some(sigma), provenance);
    }

    /// Replaces an entry by its dotted key: its value, sigma, source and date. Missing tables are created.
    pub fn set(&mut self, key: &str, value: Value, sigma: Option<f64>, provenance: &Provenance) {
        let mut entry = InlineTable::new();
        entry.insert("value", value);
        if let Some(sigma) = sigma {
            entry.insert("sigma", number(sigma, sigma));
        }
        entry.insert("source", provenance.source.as_str().into());
        if let Some(date) = provenance.date_value() {
            entry.insert("date", date);
        }
        self.put(key, Item::Value(Value::InlineTable(entry)));
    }

    /// Records the inputs of the calibration, and the camera's name.
    pub fn sign(&mut self, provenance: &Provenance) {
        if let Some(camera) = &provenance.camera {
            self.set("camera.name", camera.into(), None, provenance);
        }
        self.note(provenance, Table::new());
    }

    /// Records the inputs of the calibration, with further results.
    pub fn note(&mut self, provenance: &Provenance, more: Table) {
        let mut table = more;
        table["frames"] = value(provenance.frames as i64);
        table["frames_sha256"] = value(&provenance.frames_sha256);
        if let Some(date) = provenance.date_value() {
            table["date"] = value(date);
        }
        table["program"] = value(PROGRAM);
        if let Some(commit) = COMMIT {
            table["commit"] = value(commit);
        }
        table["instrument_sha256"] = value(&self.sha256);
        table["note"] = value(&provenance.source);
        self.put(
            &format!("calibration.{}", provenance.name),
            Item::Table(table),
        );
        let calibrations = self.document.get_mut("calibration");
        if let Some(table) = calibrations.and_then(Item::as_table_mut) {
            table.set_implicit(true);
        }
    }

    /// Sets an item at a dotted key, replacing any existing one.
    pub fn put(&mut self, key: &str, item: Item) {
        let (tables, last) = key.rsplit_once('.').unwrap_or(("", key));
        let mut table = self.document.as_table_mut();
        for name in tables.split('.').filter(|name| !name.is_empty()) {
            let inner = table.entry(name).or_insert(Item::Table(Table::new()));
            if !inner.is_table() {
                *inner = Item::Table(Table::new());
            }
            match inner.as_table_mut() {
                Some(inner) => table = inner,
                None => return,
            }
        }
        match table.get_mut(last) {
            // The key keeps its comments and its position.
            Some(old) => *old = item,
            None => {
                table.insert(last, item);
            }
        }
    }

    /// Replaces a bare value of a table; a comment behind it stays.
    pub fn renew(&mut self, table: &str, key: &str, value: Value) {
        let table = self.document.entry(table);
        let table = table.or_insert(Item::Table(Table::new()));
        if let Some(table) = table.as_table_like_mut() {
            renew(table, key, value);
        }
    }

    /// The same in the table with a given name of an array.
    ///
    /// # Errors
    /// If there is no such table.
    pub fn renew_named(
        &mut self,
        array: &str,
        name: &str,
        key: &str,
        value: Value,
    ) -> Result<(), TomlError> {
        let tables = self.document.get_mut(array);
        let mut tables = tables.and_then(Item::as_array_of_tables_mut).into_iter();
        let is_named = |table: &&mut Table| {
            let own = table.get("name").and_then(Item::as_str);
            own == Some(name)
        };
        let table = tables.find_map(|tables| tables.iter_mut().find(is_named));
        let table = table.ok_or_else(|| {
            let expected = format!("[[{array}]] with name = \"{name}\"");
            TomlError::new(&self.path, array, expected, "none of this form")
        })?;
        renew(table, key, value);
        Ok(())
    }

    /// A value of the original text, by its dotted key.
    pub fn get(&self, key: &str) -> Option<&Item> {
        let mut names = key.split('.');
        let first = self.document.get(names.next()?);
        names.try_fold(first?, |table, name| table.get(name))
    }

    /// SHA-256 of the original text.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// The new text.
    pub fn text(&self) -> String {
        self.document.to_string()
    }

    /// The new text and the instrument parsed from it.
    ///
    /// # Errors
    /// If a value is out of its range; the error names it.
    pub fn finish(&self) -> Result<(String, Instrument), TomlError> {
        let text = self.text();
        let instrument = Instrument::parse(&self.path, &text)?;
        Ok((text, instrument))
    }
}

fn renew(table: &mut dyn TableLike, key: &str, mut value: Value) {
    if let Some(old) = table.get(key).and_then(Item::as_value) {
        *value.decor_mut() = old.decor().clone();
    }
    match table.get_mut(key) {
        Some(old) => *old = Item::Value(value),
        None => _ = table.insert(key, Item::Value(value)),
    }
}

/// A number to two digits of a sigma; all digits if the sigma is zero or infinite.
pub fn number(value: f64, sigma: f64) -> Value {
    let text = value_text(Measured::new(value, sigma));
    text.parse().unwrap_or_else(|_| value.into())
}

/// A matrix, row by row.
pub fn rows<const R: usize, const C: usize>(matrix: &SMatrix<f64, R, C>) -> Value {
    let row = |n: usize| Value::Array(matrix.row(n).iter().copied().collect());
    Value::Array((0..R).map(row).collect())
}

/// Reasons for which a revision is not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    #[error("{}: cannot write: {cause}", .path.display())]
    Io {
        path: PathBuf,
        cause: std::io::Error,
    },
    #[error(transparent)]
    Unreadable(#[from] TomlError),
}

/// Writes a file if the program can read it again; otherwise the existing file stays.
///
/// # Errors
/// If the file cannot be written, or read again.
pub fn write_if(
    path: &Path,
    text: &str,
    read: impl FnOnce(&Path) -> Result<(), TomlError>,
) -> Result<(), WriteError> {
    let cannot_write = |cause| WriteError::Io {
        path: path.into(),
        cause,
    };
    let mut name = path.as_os_str().to_owned();
    name.push(".part");
    let part = PathBuf::from(name);
    std::fs::write(&part, text).map_err(cannot_write)?;
    read(&part)?;
    std::fs::rename(&part, path).map_err(cannot_write)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_renewed_lines_of_a_file_change() {
        let old = include_str!("../../calibration/demo.toml");
        let mut revision = Revision::of(Path::new("a.toml"), old).unwrap();
        let provenance = Provenance {
            name: "test",
            source: "a test".into(),
            date: "2013-09-21".parse().ok(),
            frames: 3,
            frames_sha256: "0af3".into(),
            camera: None,
        };
        let found = Measured::new(-52.123_456, 0.004_2);
        revision.set_measured("mounting.clocking_deg", found, &provenance);
        let (new, instrument) = revision.finish().unwrap();
        let changed: Vec<_> = old
            .lines()
            .zip(new.lines())
            .filter(|(a, b)| a != b)
            .collect();
        assert_eq!(changed.len(), 1, "{changed:?}");
        assert_eq!(
            changed[0].1,
            "clocking_deg = { value = -52.1235, sigma = 0.0042, source = \"a test\", date = 2013-09-21 }"
        );
        assert_eq!(old.lines().count(), new.lines().count());
        assert_eq!(instrument.mounting.clocking_deg.value, -52.1235);
        revision.sign(&provenance);
        let (signed, _) = revision.finish().unwrap();
        assert!(signed.starts_with(&new) && signed.contains("[calibration.test]\nframes = 3\n"));
    }
}
