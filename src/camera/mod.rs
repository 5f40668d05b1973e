//! Where frames come from, each behind the same trait: a folder of files, or the simulator.

mod folder;
mod pace;
mod simulated;

pub use folder::FolderCamera;
pub use simulated::{SimulatedCamera, TruthLog};

use crate::fits::FileError;
use crate::frame::Frame;
use crate::simulate::SceneError;
use jiff::Timestamp;
use std::path::PathBuf;

/// Why a source gave no frame.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// One file is bad; the next may be good.
    #[error(transparent)]
    File(#[from] FileError),
    #[error("{}: expected a folder of frames, found {found}", .folder.display())]
    Folder { folder: PathBuf, found: String },
    #[error("the simulated camera: {0}")]
    Scene(#[from] SceneError),
    #[error("the simulated camera: {0}")]
    Time(#[from] jiff::Error),
}

/// A frame with what belongs to this exposure alone.
#[derive(Debug, Clone)]
pub struct Exposure {
    pub frame: Frame,
    /// The time that was announced before the exposure began.
    pub announced: Timestamp,
}

/// A source of frames.
pub trait FrameSource: Send {
    /// Waits for the next frame. `starts` is called with the time of the exposure just before it begins. `None` when
    /// there are no more frames.
    ///
    /// # Errors
    /// Where this one frame cannot be had. The next call tries the next frame.
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Option<Exposure>, CameraError>;
}
