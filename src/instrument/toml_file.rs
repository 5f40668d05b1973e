//! TOML files read strictly: an unknown key or a value out of range is a one-line error that names the file, the
//! field and what was expected there.

use serde::de::DeserializeOwned;
use std::fmt;
use std::path::{Path, PathBuf};

/// Why a TOML file was refused: which file, which field, what was expected there and what was found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{}: {}expected {expected}, found {found}", .path.display(), Field(.field))]
pub struct TomlError {
    pub path: PathBuf,
    /// Dotted path of the field; empty when the file as a whole is meant.
    pub field: String,
    pub expected: String,
    pub found: String,
}

struct Field<'a>(&'a str);

impl fmt::Display for Field<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            Ok(())
        } else {
            write!(out, "{}: ", self.0)
        }
    }
}

impl TomlError {
    pub fn new(
        path: &Path,
        field: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self {
            path: path.into(),
            field: field.into(),
            expected: expected.into(),
            found: found.into(),
        }
    }
}

/// The text of a file, or an error that names it.
pub fn read_text(path: &Path) -> Result<String, TomlError> {
    std::fs::read_to_string(path)
        .map_err(|error| TomlError::new(path, "", "a readable text file", error.to_string()))
}

/// Parses `text` into `T`. Keys that `T` does not know are errors that name the nearest of `known_keys`
/// (dotted paths, from the shipped example).
pub fn parse_strict<T: DeserializeOwned>(
    path: &Path,
    text: &str,
    known_keys: &[String],
) -> Result<T, TomlError> {
    let document = toml::Deserializer::parse(text).map_err(|error| {
        TomlError::new(
            path,
            line_of(text, error.span()),
            "valid TOML",
            error.message(),
        )
    })?;
    let mut unknown = Vec::new();
    let mut track = serde_path_to_error::Track::new();
    let tracked = serde_path_to_error::Deserializer::new(document, &mut track);
    let parsed = serde_ignored::deserialize(tracked, |key| unknown.push(key.to_string()));
    if let Some(key) = unknown.first() {
        return Err(unknown_key(path, key, known_keys));
    }
    parsed.map_err(|error| {
        let expected = error.message().replace('\n', " ");
        let found = line_of(text, error.span());
        TomlError::new(
            path,
            track.path().to_string(),
            format!("a valid value ({expected})"),
            found,
        )
    })
}

/// The error for a key that nothing knows, naming the nearest that is known.
pub fn unknown_key(path: &Path, key: &str, known_keys: &[String]) -> TomlError {
    let nearest = known_keys.iter().max_by(|a, b| {
        let likeness = |known: &str| strsim::jaro_winkler(known, key);
        likeness(a).total_cmp(&likeness(b))
    });
    let expected = match nearest {
        Some(nearest) => format!("a known key (the nearest is \"{nearest}\")"),
        None => "a known key".into(),
    };
    TomlError::new(path, key, expected, "an unknown key")
}

/// The dotted keys of a TOML text, down to the tables that hold values.
pub fn keys_of(text: &str) -> Vec<String> {
    fn walk(table: &toml::Table, prefix: &str, keys: &mut Vec<String>) {
        for (key, value) in table {
            let full = if prefix.is_empty() {
                key.clone()
            } else {
                format!("{prefix}.{key}")
            };
            if let toml::Value::Table(inner) = value {
                walk(inner, &full, keys);
            }
            keys.push(full);
        }
    }
    let mut keys = Vec::new();
    if let Ok(table) = text.parse::<toml::Table>() {
        walk(&table, "", &mut keys);
    }
    keys
}

fn line_of(text: &str, span: Option<std::ops::Range<usize>>) -> String {
    match span {
        Some(span) => {
            let line = text[..span.start.min(text.len())].matches('\n').count() + 1;
            format!("line {line}")
        }
        None => "another".into(),
    }
}
