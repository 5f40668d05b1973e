//! TOML files read strictly: an unknown key or a value out of range is a one-line error that names the file, the
//! field and what was expected there.

use crate::clock::parse_utc;
use crate::files::{self, Unread};
use jiff::Timestamp;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::fmt;
use std::path::{Path, PathBuf};

/// Why a TOML file was rejected: file, field, what was expected there and what was found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{}: {}expected {expected}, found {found}", .path.display(), Field(.field))]
pub struct TomlError {
    pub path: PathBuf,
    /// Dotted path of the field; empty if the error concerns the whole file.
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
            field: printable(&field.into()),
            expected: expected.into(),
            found: printable(&found.into()),
        }
    }
}

/// Text of a file with control characters made visible for the terminal.
fn printable(text: &str) -> String {
    let shown = |c: char| match c.is_control() && c != '\n' {
        true => c.escape_default().to_string(),
        false => c.to_string(),
    };
    text.chars().map(shown).collect()
}

/// An instant in UTC as in all files: quoted or not, with an offset or without one (then UTC); a date alone means its
/// beginning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(try_from = "toml::Value")]
pub struct Utc(pub Timestamp);

impl Utc {
    pub const EXPECTED: &str = "a date or a time such as 2013-09-21T18:00:00Z";
}

impl TryFrom<toml::Value> for Utc {
    type Error = &'static str;

    fn try_from(value: toml::Value) -> Result<Self, &'static str> {
        let text = match value {
            toml::Value::String(text) => text,
            toml::Value::Datetime(time) => time.to_string(),
            _ => return Err(Self::EXPECTED),
        };
        parse_utc(&text).map(Self).map_err(|_| Self::EXPECTED)
    }
}

/// The text of a file, or an error that names it: not a regular file, too large for a text, or on a disk that hangs.
pub fn read_text(path: &Path) -> Result<String, TomlError> {
    files::read_text(path).map_err(|unread| unreadable(path, &unread))
}

pub(super) fn unreadable(path: &Path, unread: &Unread) -> TomlError {
    TomlError::new(path, "", unread.expected(), unread.found())
}

/// Parses `text` into `T`. Keys that `T` does not know are errors that name the nearest of `known_keys` (dotted paths, from
/// the shipped example). Infinite numbers and NaN are errors as well, for any `T`.
pub fn parse_strict<T: DeserializeOwned>(
    path: &Path,
    text: &str,
    known_keys: &[String],
) -> Result<T, TomlError> {
    let parsed = parse_loosely(path, text, known_keys)?;
    check_finite(path, text)?;
    Ok(parsed)
}

/// The same for a text whose numbers the caller checks, each against its own range.
pub fn parse_loosely<T: DeserializeOwned>(
    path: &Path,
    text: &str,
    known_keys: &[String],
) -> Result<T, TomlError> {
    let document = document(path, text)?;
    let mut unknown = Vec::new();
    let mut track = serde_path_to_error::Track::new();
    let tracked = serde_path_to_error::Deserializer::new(document, &mut track);
    let parsed = serde_ignored::deserialize(tracked, |key| unknown.push(key.to_string()));
    if let Some(key) = unknown.first() {
        return Err(unknown_key(path, key, known_keys));
    }
    parsed.map_err(|error| {
        let standing = Standing {
            line: line_of(text, error.span()),
            text: error
                .span()
                .and_then(|span| text.get(span))
                .unwrap_or_default(),
        };
        misfit(path, &track.path().to_string(), error.message(), &standing)
    })
}

/// Rejects the first number that is infinite or `nan`: TOML allows them, but no value here may have them.
fn check_finite(path: &Path, text: &str) -> Result<(), TomlError> {
    let found = text.parse::<toml::Table>();
    let found = found.ok().and_then(|table| infinite(&table.into()));
    found.map_or(Ok(()), |(key, number)| {
        let key = key.trim_start_matches('.');
        Err(TomlError::new(
            path,
            key,
            "a finite number",
            number.to_string(),
        ))
    })
}

/// The dotted key of the first number that is not finite, with a dot before it, and the number.
fn infinite(value: &toml::Value) -> Option<(String, f64)> {
    let within = |step: String, value| {
        let (key, number) = infinite(value)?;
        Some((step + &key, number))
    };
    match value {
        toml::Value::Float(number) => (!number.is_finite()).then(|| (String::new(), *number)),
        toml::Value::Array(values) => (0..)
            .zip(values)
            .find_map(|(n, value)| within(format!("[{n}]"), value)),
        toml::Value::Table(values) => values
            .iter()
            .find_map(|(key, value)| within(format!(".{key}"), value)),
        _ => None,
    }
}

/// Parses a text as TOML.
///
/// # Errors
/// The line that is not TOML.
pub fn document<'a>(path: &Path, text: &'a str) -> Result<toml::Deserializer<'a>, TomlError> {
    toml::Deserializer::parse(text).map_err(|error| {
        let line = line_of(text, error.span());
        TomlError::new(path, line, "valid TOML", error.message())
    })
}

/// Serde's names of kinds of values, and the usual names for them.
const KINDS: [(&str, &str); 7] = [
    ("struct Entry", "a table such as { value = 1 }"),
    ("struct", "a table"),
    ("map", "a table"),
    ("sequence", "a list"),
    ("an array of length", "a list of"),
    ("f64", "a number"),
    ("string", "a text"),
];

/// Value in a file, with its position.
struct Standing<'a> {
    line: String,
    text: &'a str,
}

/// The error for a value of the wrong kind, from serde's message about it.
fn misfit(path: &Path, field: &str, message: &str, standing: &Standing) -> TomlError {
    if let Some(name) = message.strip_prefix("missing field ") {
        let name = name.trim_matches('`');
        let key = match field {
            "." => name.to_owned(),
            table => format!("{table}.{name}"),
        };
        return TomlError::new(path, key, "a value", "none");
    }
    let wrong = ["invalid type: ", "invalid value: ", "unknown variant "];
    let said = wrong.iter().find_map(|begin| message.strip_prefix(begin));
    match said.and_then(|said| said.rsplit_once(", expected ")) {
        Some((found, expected)) => {
            // The value, preceded by the name of its kind if it is a single value.
            let value = found.trim_start_matches(|c: char| c.is_alphabetic() || c == ' ');
            let found = if value.is_empty() {
                in_plain_words(found)
            } else {
                value.replace('`', "")
            };
            let found = format!("{found} on {}", standing.line);
            TomlError::new(path, field, in_plain_words(expected), found)
        }
        // A type with its own description of the expected value.
        None => {
            let first = standing.text.lines().next().unwrap_or_default();
            let found = format!("{first} on {}", standing.line);
            TomlError::new(path, field, message.replace('\n', " "), found)
        }
    }
}

fn in_plain_words(kind: &str) -> String {
    let is_whole = |kind: &str| {
        let bits = kind.trim_start_matches(['u', 'i']);
        kind.len() > bits.len() && (bits == "size" || bits.parse::<u8>().is_ok())
    };
    let named = KINDS.iter().find(|(serde, _)| kind.starts_with(serde));
    match named {
        _ if is_whole(kind) => "a whole number".into(),
        Some((serde, plain)) if serde.ends_with("length") => kind.replacen(serde, plain, 1),
        Some((_, plain)) => (*plain).into(),
        None => kind.replace('`', "\""),
    }
}

/// Keys with a similarity below this, from 0 to 1, are not treated as misspellings of each other.
const UNLIKE: f64 = 0.7;

/// The error for an unknown key, with the nearest known key if one is similar.
pub fn unknown_key(path: &Path, key: &str, known_keys: &[String]) -> TomlError {
    // A key of the same name in another table counts as near, however different the tables' names are.
    let is_namesake = |known: &str| known.rsplit('.').next() == key.rsplit('.').next();
    let likeness =
        |known: &String| strsim::jaro_winkler(known, key) + f64::from(u8::from(is_namesake(known)));
    let near = known_keys.iter().filter(|known| likeness(known) > UNLIKE);
    let nearest = near.max_by(|a, b| likeness(a).total_cmp(&likeness(b)));
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

#[cfg(test)]
mod tests {
    use super::*;

    fn utc(value: &str) -> Option<String> {
        let document: toml::Table = format!("at = {value}").parse().unwrap();
        let utc = Utc::try_from(document["at"].clone());
        utc.ok().map(|utc| utc.0.to_string())
    }

    #[test]
    fn an_error_commands_no_terminal() {
        let refused = unknown_key(Path::new("a.toml"), "evil\u{1b}[2Jkey", &[]);
        let error = refused.to_string();
        assert!(
            !error.contains('\u{1b}') && error.contains("u{1b}"),
            "{error:?}"
        );
    }

    #[test]
    fn a_time_is_the_same_in_quotes_and_without_them() {
        for (text, instant) in [
            ("2013-09-21T18:00:00Z", "2013-09-21T18:00:00Z"),
            ("2013-09-21T18:00:00.25", "2013-09-21T18:00:00.25Z"),
            ("2013-09-21 18:00:00", "2013-09-21T18:00:00Z"),
            ("2013-09-21", "2013-09-21T00:00:00Z"),
            ("2013-09-21T20:00:00-06:00", "2013-09-22T02:00:00Z"),
            ("2013-09-21t18:00:00+05:30", "2013-09-21T12:30:00Z"),
        ] {
            assert_eq!(utc(text).as_deref(), Some(instant), "{text}");
            assert_eq!(
                utc(&format!("\"{text}\"")).as_deref(),
                Some(instant),
                "{text}"
            );
        }
        for none in [
            "18:00:00",
            "\"18:00:00\"",
            "\"yesterday\"",
            "\"\"",
            "\"2013-02-30\"",
            "2013",
            "true",
        ] {
            assert_eq!(utc(none), None, "{none}");
        }
    }
}
