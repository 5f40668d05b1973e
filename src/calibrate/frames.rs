//! Properties that all frames of a calibration must share: one camera, which is the instrument's, at one setting.

use crate::frame::{Frame, TakenBy};
use crate::instrument::{Instrument, WrongCamera, WrongSize};
use crate::observe::{InputError, RejectedFrame};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Properties common to all frames of one calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting {
    file: PathBuf,
    /// Instrument and camera stated in the frame.
    taken_by: TakenBy,
    /// Name and value of each property that the frame states.
    properties: Vec<(&'static str, String)>,
}

impl Setting {
    /// The camera and the depth of a frame.
    pub fn of(file: &Path, frame: &Frame) -> Self {
        let depth = format!("pixels that saturate at {} DN", frame.saturation_dn());
        let camera = frame.info.camera.as_ref();
        let camera = camera.map(|name| ("camera", format!("camera \"{name}\"")));
        Self {
            file: file.into(),
            taken_by: frame.info.taken_by(),
            properties: camera.into_iter().chain([("depth", depth)]).collect(),
        }
    }

    /// The camera's name stated in the frame.
    pub fn camera(&self) -> Option<String> {
        self.taken_by.camera.clone()
    }

    /// Adds the frame's size.
    pub fn with_size(mut self, frame: &Frame) -> Self {
        let size = format!("{} x {} px", frame.width(), frame.height());
        self.properties.push(("size", size));
        self
    }

    /// Adds the frame's gains.
    pub fn with_gains(mut self, frame: &Frame) -> Self {
        let gains = [
            ("analogue gain", frame.info.analogue_gain),
            ("pre-amplifier gain", frame.info.preamp_gain),
        ];
        let stated = gains
            .into_iter()
            .filter_map(|(name, gain)| Some((name, gain?)));
        let stated = stated.map(|(name, gain)| (name, format!("{name} {gain}")));
        self.properties.extend(stated);
        self
    }
}

/// Two frames that differ in a property that all must share.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "mixed instruments: expected frames of one {what}, found {found} in {} and {other} in {}; give the frames of one camera and setting only",
    .file.display(), .other_file.display()
)]
pub struct Mixed {
    pub what: &'static str,
    pub file: PathBuf,
    pub found: String,
    pub other_file: PathBuf,
    pub other: String,
}

/// Frames that are unsuitable for a calibration of an instrument.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WrongFrames {
    #[error(transparent)]
    Mixed(#[from] Box<Mixed>),
    #[error("{}: {wrong}; name the instrument of these frames with --instrument", .file.display())]
    Foreign {
        file: PathBuf,
        wrong: Box<WrongCamera>,
    },
}

/// Reasons for which files give no frames for a calibration.
#[derive(Debug, thiserror::Error)]
pub enum FramesError {
    #[error(transparent)]
    Input(#[from] InputError),
    #[error(transparent)]
    Wrong(#[from] WrongFrames),
    #[error("mixed instruments: {}: {wrong}", .file.display())]
    Size { file: PathBuf, wrong: WrongSize },
    #[error(
        "{}: expected frames of the whole sensor, {} x {} px, found a part of it; take them without a region",
        .file.display(), .size_px[0], .size_px[1]
    )]
    Region { file: PathBuf, size_px: [usize; 2] },
    /// All of them lack a required fact.
    #[error("{0}")]
    Missing(String),
}

/// Reasons for which frames give no calibration.
#[derive(Debug, thiserror::Error)]
pub enum CalibrateError<E: std::fmt::Display> {
    #[error(transparent)]
    Frames(#[from] FramesError),
    /// The frames do not determine it; the rejected ones may show why.
    #[error("{rejected}: {cause}")]
    Undetermined { rejected: String, cause: E },
}

impl<E: std::fmt::Display> CalibrateError<E> {
    pub(super) fn undetermined(rejected: &[RejectedFrame]) -> impl FnOnce(E) -> Self {
        let rejected = RejectedFrame::count_and_first(rejected);
        |cause| Self::Undetermined { rejected, cause }
    }
}

impl<E: std::fmt::Display> From<InputError> for CalibrateError<E> {
    fn from(error: InputError) -> Self {
        Self::Frames(error.into())
    }
}

/// Checks that one camera, which is the instrument's, took all frames at one setting.
///
/// # Errors
/// The first two frames that differ, or the first of another instrument or camera.
pub fn check_settings<'a>(
    settings: impl IntoIterator<Item = &'a Setting>,
    instrument: &Instrument,
) -> Result<(), WrongFrames> {
    let mut known: BTreeMap<&str, (&Path, &str)> = BTreeMap::new();
    for setting in settings {
        let Setting {
            file,
            taken_by,
            properties,
        } = setting;
        instrument
            .check_taken_by(taken_by)
            .map_err(|wrong| WrongFrames::Foreign {
                file: file.clone(),
                wrong: Box::new(wrong),
            })?;
        for (what, value) in properties {
            let (first, found) = known.entry(what).or_insert((file, value));
            if *found != value {
                return Err(WrongFrames::from(Box::new(Mixed {
                    what,
                    file: first.to_path_buf(),
                    found: (*found).into(),
                    other_file: file.clone(),
                    other: value.clone(),
                })));
            }
        }
    }
    Ok(())
}
