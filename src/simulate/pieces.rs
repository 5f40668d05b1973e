//! A path that is described piece by piece, in a file.

use crate::instrument::toml_file::{TomlError, parse_strict, read_text};
use crate::units::PlateMil;
use nalgebra::Vector2;
use serde::Deserialize;
use std::path::Path;

/// A path made of pieces, each from its own start to that of the next; the last one never ends, unless the path repeats.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Pieces {
    /// Period of the path, s, if it repeats.
    pub repeat_s: Option<f64>,
    #[serde(default, rename = "piece")]
    pub pieces: Vec<Piece>,
}

/// Conditions from `start_s` of the run on.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Piece {
    pub start_s: f64,
    /// Position of the Sun on the plate at the start of the piece, mil.
    pub sun_mil: [f64; 2],
    /// Its velocity from there, mil/s.
    #[serde(default)]
    pub slew_mil_per_s: [f64; 2],
    /// Rotation of the picture about the plate's centre, from +x towards +y.
    #[serde(default)]
    pub roll_deg: f64,
    /// Fraction of the light that the clouds absorb, 0 to 1.
    #[serde(default)]
    pub cloud: f64,
}

/// Keys of a file, for errors that suggest the nearest one.
const KEYS: [&str; 7] = [
    "repeat_s",
    "piece",
    "piece.start_s",
    "piece.sun_mil",
    "piece.slew_mil_per_s",
    "piece.roll_deg",
    "piece.cloud",
];

impl Pieces {
    /// Reads a path.
    ///
    /// # Errors
    /// If the file cannot be read, has unknown keys or values out of range, or its pieces are not in the order of time from 0 s
    /// on.
    pub fn read(path: &Path) -> Result<Self, TomlError> {
        Self::parse(path, &read_text(path)?)
    }

    /// As [`read`](Self::read), from a text; `path` is for the errors.
    pub fn parse(path: &Path, text: &str) -> Result<Self, TomlError> {
        let pieces: Self = parse_strict(path, text, &KEYS.map(str::to_owned))?;
        let refuse = |field: String, expected: &str, found: f64| {
            Err(TomlError::new(path, field, expected, found.to_string()))
        };
        let Some(last) = pieces.pieces.last() else {
            let expected = "one [[piece]] or more";
            return Err(TomlError::new(path, "piece", expected, "none"));
        };
        let mut before_s = None;
        for (n, piece) in pieces.pieces.iter().enumerate() {
            let field = |name: &str| format!("piece[{n}].{name}");
            match before_s {
                None if piece.start_s != 0.0 => {
                    return refuse(field("start_s"), "0 for the first piece", piece.start_s);
                }
                Some(before_s) if !(piece.start_s > before_s && piece.start_s.is_finite()) => {
                    return refuse(field("start_s"), "more than that before it", piece.start_s);
                }
                _ => before_s = Some(piece.start_s),
            }
            for (name, value, limit) in [
                ("sun_mil", piece.sun_mil[0], 1e5),
                ("sun_mil", piece.sun_mil[1], 1e5),
                ("slew_mil_per_s", piece.slew_mil_per_s[0], 1e5),
                ("slew_mil_per_s", piece.slew_mil_per_s[1], 1e5),
                ("roll_deg", piece.roll_deg, 360.0),
            ] {
                if !(-limit..=limit).contains(&value) {
                    let expected = format!("a number from {} to {limit}", -limit);
                    return refuse(field(name), &expected, value);
                }
            }
            if !(0.0..=1.0).contains(&piece.cloud) {
                return refuse(field("cloud"), "a fraction from 0 to 1", piece.cloud);
            }
        }
        match pieces.repeat_s {
            Some(repeat_s) if !(repeat_s > last.start_s && repeat_s.is_finite()) => {
                refuse("repeat_s".into(), "more than the last start_s", repeat_s)
            }
            _ => Ok(pieces),
        }
    }

    /// The piece at a time, and the time since its start.
    fn at(&self, time_s: f64) -> Option<(&Piece, f64)> {
        let time_s = self.repeat_s.map_or(time_s, |repeat_s| time_s % repeat_s);
        let begun = self.pieces.partition_point(|piece| piece.start_s <= time_s);
        let piece = self.pieces.get(begun.checked_sub(1)?)?;
        Some((piece, time_s - piece.start_s))
    }

    pub(super) fn position(&self, time_s: f64) -> PlateMil {
        let Some((piece, since_s)) = self.at(time_s) else {
            return PlateMil::new(0.0, 0.0);
        };
        let ([x, y], [u, v]) = (piece.sun_mil, piece.slew_mil_per_s);
        PlateMil::new(x + u * since_s, y + v * since_s)
    }

    pub(super) fn velocity_mil_per_s(&self, time_s: f64) -> Vector2<f64> {
        self.at(time_s)
            .map_or(Vector2::zeros(), |(piece, _)| piece.slew_mil_per_s.into())
    }

    pub(super) fn roll_deg(&self, time_s: f64) -> f64 {
        self.at(time_s).map_or(0.0, |(piece, _)| piece.roll_deg)
    }

    /// Fraction of the light that passes the clouds, 0 to 1.
    pub(super) fn light(&self, time_s: f64) -> f64 {
        self.at(time_s).map_or(1.0, |(piece, _)| 1.0 - piece.cloud)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Pieces, String> {
        Pieces::parse(Path::new("p.toml"), text).map_err(|error| error.to_string())
    }

    #[test]
    fn each_piece_holds_from_its_start_to_the_next() {
        let path = parse(
            "repeat_s = 30\n[[piece]]\nstart_s = 0\nsun_mil = [100, -50]\n\
             [[piece]]\nstart_s = 10\nsun_mil = [100, -50]\nslew_mil_per_s = [20, 5]\n\
             [[piece]]\nstart_s = 20.5\nsun_mil = [310, 2.5]\nroll_deg = 1.5\ncloud = 0.4\n",
        )
        .unwrap();
        assert_eq!(path.position(9.0), PlateMil::new(100.0, -50.0));
        assert_eq!(path.position(15.0), PlateMil::new(200.0, -25.0));
        assert_eq!(path.position(45.0), path.position(15.0));
        assert_eq!(path.velocity_mil_per_s(15.0), Vector2::new(20.0, 5.0));
        assert_eq!((path.roll_deg(15.0), path.light(15.0)), (0.0, 1.0));
        assert_eq!((path.roll_deg(29.0), path.light(29.0)), (1.5, 0.6));
    }

    #[test]
    fn a_bad_path_is_refused_on_one_line_that_names_file_field_and_expectation() {
        let piece = "[[piece]]\nstart_s = 0\nsun_mil = [0, 0]\n";
        for (text, words) in [
            (String::new(), &["piece", "one [[piece]] or more"][..]),
            ("[[piece]]\nsun_mil = [0, 0]\n".into(), &["start_s"]),
            (
                "[[piece]]\nstart_s = 3\nsun_mil = [0, 0]\n".into(),
                &["piece[0].start_s", "0 for the first"],
            ),
            (piece.repeat(2), &["piece[1].start_s", "more than"]),
            (
                format!("{piece}cloud = 1.5\n"),
                &["piece[0].cloud", "0 to 1", "1.5"],
            ),
            (
                format!("{piece}roll_deg = nan\n"),
                &["piece[0].roll_deg", "NaN"],
            ),
            (format!("{piece}clouds = 0.5\n"), &["clouds", "piece.cloud"]),
            (format!("{piece}sun_mil = 3\n"), &["TOML"]),
            (
                format!("repeat_s = 0\n{piece}"),
                &["repeat_s", "last start_s"],
            ),
            (
                "[[piece]]\nstart_s = 0\nsun_mil = [0]\n".into(),
                &["sun_mil"],
            ),
        ] {
            let message = parse(&text).unwrap_err();
            assert!(message.starts_with("p.toml: "), "{message}");
            assert!(!message.contains('\n'), "{message}");
            for word in words {
                assert!(message.contains(word), "{message} lacks {word}");
            }
        }
    }
}
