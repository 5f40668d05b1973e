//! Target of a flight camera according to its file.

use super::{Dated, DirectionCamera, Instrument, MountedCamera, Role, TomlError, text_or_demo};
use crate::frame::Frame;
use std::path::Path;

/// A camera's target, and the settings to find it.
#[derive(Debug, Clone, PartialEq)]
pub enum Sees {
    /// The Sun on the plate.
    Plate(Box<Instrument>),
    /// The horizon, for roll.
    Horizon(MountedCamera),
    Moon(DirectionCamera),
    /// No file states the target: its frames are stored but not solved.
    Unstated,
}

/// A camera's target, and the text of its file.
#[derive(Debug, Clone, PartialEq)]
pub struct Stated {
    pub sees: Sees,
    /// The file's text, verbatim; `None` if there is no file.
    pub toml: Option<String>,
    /// Dates at which values of an instrument were measured.
    pub dates: Vec<Dated>,
}

impl Stated {
    /// Reads the file of a camera of a role, or a built-in one by name. Without a file, a camera of a plate is the built-in
    /// demo.
    ///
    /// # Errors
    /// The file, the field, and what was expected there.
    pub fn read(role: Role, file: Option<&Path>) -> Result<Self, TomlError> {
        if file.is_none() && role != Role::PitchYaw {
            return Ok(Self {
                sees: Sees::Unstated,
                toml: None,
                dates: Vec::new(),
            });
        }
        let (path, text) = text_or_demo(file)?;
        let (sees, dates) = match role {
            Role::PitchYaw => {
                let (instrument, dates) = Instrument::parse_with_dates(path, &text)?;
                (Sees::Plate(Box::new(instrument)), dates)
            }
            Role::Roll => (
                Sees::Horizon(MountedCamera::parse(path, &text)?),
                Vec::new(),
            ),
            Role::Moon => (Sees::Moon(DirectionCamera::parse(path, &text)?), Vec::new()),
        };
        let toml = Some(text);
        Ok(Self { sees, toml, dates })
    }
}

impl Sees {
    pub fn plate(&self) -> Option<&Instrument> {
        match self {
            Self::Plate(instrument) => Some(instrument),
            _ => None,
        }
    }

    pub fn horizon(&self) -> Option<&MountedCamera> {
        match self {
            Self::Horizon(camera) => Some(camera),
            _ => None,
        }
    }

    /// Use of its frames, in words.
    pub fn in_words(&self) -> String {
        match self {
            Self::Plate(instrument) => format!("instrument \"{}\"", instrument.name),
            Self::Horizon(_) => "solved for roll".into(),
            Self::Moon(_) => "solved for the Moon".into(),
            Self::Unstated => "stored and not solved".into(),
        }
    }

    /// Width and height of its frames, px, if a file states them.
    pub fn size_px(&self) -> Option<[usize; 2]> {
        match self {
            Self::Plate(instrument) => Some(instrument.camera.size_px()),
            Self::Horizon(camera) => Some(camera.optics.size_px()),
            Self::Moon(camera) => Some(camera.size_px()),
            Self::Unstated => None,
        }
    }

    /// Checks that a frame has this camera's size, or is a part of its sensor where that is allowed.
    ///
    /// # Errors
    /// Both sizes, in words.
    pub fn check(&self, frame: &Frame) -> Result<(), String> {
        let wrong = match self {
            Self::Plate(instrument) => instrument.seen_by(frame).err().map(|e| e.to_string()),
            Self::Horizon(camera) => camera.optics.check(frame).err().map(|e| e.to_string()),
            Self::Moon(camera) => camera.check(frame).err().map(|e| e.to_string()),
            Self::Unstated => None,
        };
        wrong.map_or(Ok(()), Err)
    }
}
