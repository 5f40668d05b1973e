//! The keywords of archived frames: check of their types, a line of a list, and a row of a table.

use super::field;
use crate::archive::keywords;
use crate::fits::keyword::{Keyword, Kind};
use crate::fits::{FileError, FitsFile, Header, Problem, Value};
use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;
use serde::Serialize;
use std::path::Path;

/// Checks that each keyword of the table has a value of its type.
fn check_kinds(header: &Header) -> Result<(), Problem> {
    let known = header
        .iter()
        .filter_map(|(name, value)| Some((keywords::find(name)?, value)));
    for (keyword, value) in known {
        let expected = match (keyword.kind, value) {
            (Kind::Text, Value::Text(_)) | (Kind::Logical, Value::Logical(_)) => continue,
            (Kind::Time, Value::Text(text)) if time(text).is_some() => continue,
            (Kind::Integer | Kind::Float, Value::Integer(_)) => continue,
            (Kind::Float, Value::Float(number)) if number.is_finite() => continue,
            (Kind::Integer, Value::Float(number)) if number.fract() == 0.0 => continue,
            (Kind::Text, _) => "a text in quotes",
            (Kind::Time, _) => "a UTC date and time YYYY-MM-DDThh:mm:ss[.s...]",
            (Kind::Integer, _) => "a whole number",
            (Kind::Float, _) => "a finite number",
            (Kind::Logical, _) => "T or F",
        };
        return Err(field(keyword.name, expected, value.to_string()));
    }
    Ok(())
}

/// A time in the form of FITS, UTC.
fn time(text: &str) -> Option<Timestamp> {
    let civil: DateTime = text.strip_suffix('Z').unwrap_or(text).parse().ok()?;
    TimeZone::UTC.to_timestamp(civil).ok()
}

/// The keywords of a file, with their types checked.
pub(super) fn checked(file: &FitsFile) -> Result<Header, FileError> {
    let header = file.keywords()?;
    match check_kinds(&header) {
        Ok(()) => Ok(header),
        Err(problem) => Err(problem.in_file(file.path())),
    }
}

/// A frame's line in a list of the archive. A value that the frame does not state is `None`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KeywordRow {
    pub file: String,
    /// Mid-exposure.
    pub utc: Option<String>,
    pub quality: Option<String>,
    pub reason: Option<String>,
    pub sun_plate_mil: Option<[f64; 2]>,
    pub number: Option<i64>,
}

impl KeywordRow {
    /// Reads the line from a file's keywords.
    ///
    /// # Errors
    /// If the file is no FITS file with a picture, or a keyword has another type than the table states.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let header = checked(&FitsFile::open(path)?)?;
        let text = |name| match header.get(name)? {
            Value::Text(text) => Some(text.clone()),
            _ => None,
        };
        let number = |name| match header.get(name)? {
            Value::Float(number) => Some(*number),
            Value::Integer(number) => Some(*number as f64),
            _ => None,
        };
        Ok(Self {
            file: path.display().to_string(),
            utc: text("DATE-AVG")
                .and_then(|text| time(&text))
                .map(|utc| format!("{utc:.3}")),
            quality: text("QUALITY"),
            reason: text("REASON"),
            sun_plate_mil: number("SUNMIL-X")
                .zip(number("SUNMIL-Y"))
                .map(|(x, y)| [x, y]),
            number: match header.get("FRAMENUM") {
                Some(Value::Integer(number)) => Some(*number),
                Some(Value::Float(number)) => Some(*number as i64),
                _ => None,
            },
        })
    }
}

/// Keywords of one group: name, value and comment.
pub struct Group {
    pub title: &'static str,
    pub cards: Vec<(String, String, String)>,
}

/// The keywords of a file in the groups of the table; those that are not in the table come last.
///
/// # Errors
/// As [`KeywordRow::read`].
pub fn grouped(file: &FitsFile) -> Result<Vec<Group>, FileError> {
    let header = checked(file)?;
    let own = |(title, keywords): (&'static str, Vec<&Keyword>)| Group {
        title,
        cards: keywords
            .iter()
            .filter_map(|row| {
                let value = header.get(row.name)?.to_string();
                Some((row.name.into(), value, row.comment()))
            })
            .collect(),
    };
    let others = header
        .iter()
        .filter(|(name, _)| keywords::find(name).is_none())
        .map(|(name, value)| (name.into(), value.to_string(), String::new()));
    let mut groups: Vec<Group> = keywords::groups().map(own).collect();
    groups.push(Group {
        title: "Structure and others",
        cards: others.collect(),
    });
    groups.retain(|group| !group.cards.is_empty());
    Ok(groups)
}

/// The keywords that have columns: all except those about the file itself.
fn columns() -> impl Iterator<Item = &'static Keyword> {
    let about_frames = keywords::groups().filter(|(title, _)| *title != "File");
    about_frames.flat_map(|(_, keywords)| keywords)
}

/// The names of the columns, each with its unit: `file`, the keywords, `error`.
pub fn csv_header() -> Vec<String> {
    let title = |keyword: &Keyword| match keyword.unit {
        "" => keyword.name.into(),
        unit => format!("{} [{unit}]", keyword.name),
    };
    let mut names = vec!["file".into()];
    names.extend(columns().map(title));
    names.push("error".into());
    names
}

/// A file's row: values that it does not state are empty; if the file cannot be read, only name and error are given.
pub fn csv_row(path: &Path) -> Vec<String> {
    let mut row = vec![path.display().to_string()];
    match FitsFile::open(path).and_then(|file| checked(&file)) {
        Ok(header) => {
            row.extend(columns().map(|keyword| match header.get(keyword.name) {
                Some(Value::Text(text)) => text.clone(),
                Some(value) => value.to_string(),
                None => String::new(),
            }));
            row.push(String::new());
        }
        Err(error) => {
            row.extend(columns().map(|_| String::new()));
            row.push(error.problem.to_string());
        }
    }
    row
}
