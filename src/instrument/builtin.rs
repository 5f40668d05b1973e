//! The instruments that are built into the program.

use super::toml_file::unreadable;
use super::{Instrument, TomlError, raw};
use crate::files;
use std::path::Path;

const FILES: [(&str, &str); 3] = [
    ("demo", include_str!("../../calibration/demo.toml")),
    (
        "heroes-pyas-f",
        include_str!("../../calibration/heroes-pyas-f.toml"),
    ),
    (
        "heroes-pyas-r",
        include_str!("../../calibration/heroes-pyas-r.toml"),
    ),
];

/// The file of the demonstration's roll camera.
pub const DEMO_HORIZON: &str = include_str!("../../calibration/demo-horizon.toml");

/// Files of cameras that observe the sky.
const SKY_FILES: [(&str, &str); 2] = [
    ("demo-horizon", DEMO_HORIZON),
    (
        "demo-moon",
        include_str!("../../calibration/demo-moon.toml"),
    ),
];

/// Files of the demonstration's navigation.
pub const DEMO_NAVIGATION: &str = include_str!("../../calibration/demo-nav.toml");

/// A built-in instrument by name.
pub fn builtin(name: &str) -> Result<Instrument, TomlError> {
    let path = Path::new(name);
    match builtin_text(name) {
        Some(text) => raw::parse(path, text),
        None => Err(TomlError::new(
            path,
            "",
            format!("a built-in instrument ({})", builtin_names().join(", ")),
            format!("\"{name}\""),
        )),
    }
}

/// The TOML text of a built-in instrument.
pub fn builtin_text(name: &str) -> Option<&'static str> {
    let known = FILES.iter().find(|(known, _)| *known == name);
    known.map(|(_, text)| *text)
}

/// The text of an instrument's file, or of a file of a camera that observes the sky. If no such file exists and `path` is
/// the name of a built-in one, the built-in text. The table of marks named in an instrument's file is inserted into the
/// text.
///
/// # Errors
/// If `path` is neither a file nor the name of a built-in one, or if the file or its table of marks cannot be read.
pub fn text_of(path: &Path) -> Result<String, TomlError> {
    match files::read_text(path) {
        Err(unread) if unread.is_absent() => {}
        Ok(text) => return raw::with_table(path, text),
        Err(unread) => return Err(unreadable(path, &unread)),
    }
    let name = path.to_string_lossy();
    let all = FILES.iter().chain(&SKY_FILES);
    let known = all.clone().find(|(known, _)| *known == name);
    known.map(|(_, text)| (*text).to_owned()).ok_or_else(|| {
        let names: Vec<&str> = all.map(|(name, _)| *name).collect();
        let expected = format!("a file, or a built-in instrument ({})", names.join(", "));
        TomlError::new(path, "", expected, "neither")
    })
}

/// The text of an instrument's file, and the path for error messages; without a file the built-in demo, regardless of
/// existing files.
///
/// # Errors
/// As [`text_of`].
pub fn text_or_demo(file: Option<&Path>) -> Result<(&Path, String), TomlError> {
    match file {
        Some(path) => Ok((path, text_of(path)?)),
        None => Ok((
            Path::new("demo"),
            builtin_text("demo").unwrap_or_default().into(),
        )),
    }
}

/// Names of the built-in instruments.
pub fn builtin_names() -> Vec<&'static str> {
    FILES.iter().map(|(name, _)| *name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_built_in_instrument_is_valid() {
        for name in builtin_names() {
            assert_eq!(builtin(name).unwrap().name, name);
        }
    }
}
