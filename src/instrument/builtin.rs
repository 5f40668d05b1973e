//! The instruments that the program carries with it.

use super::toml_file::read_text;
use super::{Instrument, TomlError, raw};
use std::borrow::Cow;
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

/// What the demonstration's navigation rests on.
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

/// The TOML text of a file, or of the built-in instrument of that name where there is no such file.
pub fn file_or_builtin_text(path: &Path) -> Result<Cow<'static, str>, TomlError> {
    match path.to_str().and_then(builtin_text) {
        Some(text) if !path.exists() => Ok(text.into()),
        _ => Ok(read_text(path)?.into()),
    }
}

/// The TOML text of a built-in instrument.
pub fn builtin_text(name: &str) -> Option<&'static str> {
    let known = FILES.iter().find(|(known, _)| *known == name);
    known.map(|(_, text)| *text)
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
