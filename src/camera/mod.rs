//! Sources of frames, all behind the same trait: a GenICam camera, a folder of files, a folder that another program fills, the simulator, or a camera
//! supplied by the user.

mod auto_exposure;
mod device;
mod folder;
mod folder_watch;
mod followed;
#[cfg(feature = "gige")]
mod genicam;
mod identity;
mod mono;
mod pace;
mod settings;
mod simulated;
mod source;
mod taken_files;

pub use auto_exposure::{AutoExposure, AutoExposureSettings, Brightness};
pub use device::Device;
pub use folder::FolderCamera;
pub use followed::{Backlog, FollowedFolder};
#[cfg(feature = "gige")]
pub use genicam::GenicamCamera;
pub use identity::{Camera, give_names};
pub use mono::MonoFormat;
pub use settings::{CameraSettings, PixelFormat};
pub use simulated::{SimulatedCamera, TruthLog, View};
pub use source::{NoSource, Source, SourceContext, open, simulated_course};
pub use taken_files::TakenFiles;

use crate::fits::FileError;
use crate::frame::Frame;
use crate::instrument::TomlError;
use crate::simulate::SceneError;
use crate::sky::SkyError;
use jiff::Timestamp;
use std::error::Error;
use std::path::PathBuf;

/// Reason why a source gave no frame, or did not take its settings.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// One file is bad; the next may be readable.
    #[error(transparent)]
    File(#[from] FileError),
    #[error("{}: expected a folder of frames, found {found}", .folder.display())]
    Folder { folder: PathBuf, found: String },
    #[error("the simulated camera: {0}")]
    Scene(#[from] SceneError),
    #[error("the simulated camera: {0}")]
    Time(#[from] jiff::Error),
    #[error("the simulated camera: {0}")]
    Sky(#[from] SkyError),
    /// The file of a flight is bad.
    #[error(transparent)]
    Path(#[from] TomlError),
    #[error("this build has no GigE Vision or USB3 cameras: build it with `--features gige`")]
    NotBuilt,
    #[error(
        "a source \"own\" is a camera that a program of one's own brings; this program brings none"
    )]
    NotSupplied,
    /// Error of a user's driver: see [`CameraError::own`].
    #[error("the camera: {0}")]
    Own(Box<dyn Error + Send + Sync>),
    /// Problem of the camera, with the name that its user gives it, or of this frame.
    #[error("the camera {camera}: {problem}")]
    Device { camera: String, problem: String },
    #[error("camera.{setting}: expected {expected}, found {found}")]
    Setting {
        setting: &'static str,
        expected: String,
        found: String,
    },
}

impl CameraError {
    /// The error of a user's camera: any error, or a text.
    pub fn own(error: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        Self::Own(error.into())
    }

    /// A problem of a camera, or of a frame of it.
    pub fn of(device: &Device, problem: impl ToString) -> Self {
        Self::Device {
            camera: device.to_string(),
            problem: problem.to_string(),
        }
    }
}

/// A frame with the data of its exposure.
#[derive(Debug, Clone)]
pub struct Exposure {
    pub frame: Frame,
    /// The time that was announced before the exposure began.
    pub announced: Timestamp,
}

/// Result of a request for a frame.
#[derive(Debug, Clone)]
pub enum Take {
    // Boxed, because the other variants carry no data.
    Exposure(Box<Exposure>),
    /// No frame is due or complete yet: call again.
    NotYet,
    /// There are no more frames.
    End,
}

/// Counts and temperature of a camera.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CameraHealth {
    /// Frames that arrived with parts missing, and were not used.
    pub incomplete: u64,
    /// Exposures for which no frame arrived.
    pub missing: u64,
    /// Packets that never arrived, including resent ones; only GigE Vision counts them.
    pub lost_packets: u64,
    /// Frames for which no buffer was free.
    pub underruns: u64,
    /// Settings that the camera did not take.
    pub refused_settings: u64,
    /// Number of times that the camera was lost and reconnected.
    pub reconnects: u64,
    pub temperature_c: Option<f64>,
}

/// A source of frames.
pub trait FrameSource: Send {
    /// Waits for the next frame, for at most 1 s. `starts` is called with the time of the exposure just before it
    /// begins, which may be in an earlier call than the one that gives the frame. A source that learns of an exposure only from its frame calls it
    /// then.
    ///
    /// # Errors
    /// If this one frame cannot be obtained. The next call tries the next frame.
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError>;

    /// Takes the frames from now on with these settings, as far as they apply to the source. Returns within 2 s.
    ///
    /// # Errors
    /// If a setting was not taken; the others are.
    fn apply(&mut self, _settings: &CameraSettings) -> Result<(), CameraError> {
        Ok(())
    }

    /// Whether frames wait to be taken, as those of a folder and the simulator do: then a pause loses none. Frames that a camera
    /// does not deliver in time are lost.
    fn frames_wait(&self) -> bool {
        false
    }

    /// Whether frames should come at the configured rate, so that a long gap means a silent camera.
    fn falls_silent(&self) -> bool {
        !self.frames_wait()
    }

    /// Status of the camera; the default if the source is not a camera.
    fn health(&self) -> CameraHealth {
        CameraHealth::default()
    }
}
