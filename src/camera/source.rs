//! A camera by its name on the command line or in the configuration.

#[cfg(feature = "gige")]
use super::gige::GigeCamera;
use super::{CameraError, FolderCamera, FrameSource, Settings, SimulatedCamera};
use crate::instrument::Instrument;
use crate::simulate::{FlightScenes, Trajectory};
use crate::sky;
use jiff::Timestamp;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

/// Where frames come from.
#[derive(Debug, Clone, PartialEq)]
pub enum Source {
    /// A GigE Vision camera, by IP address or serial number.
    Gige(String),
    /// The frames of a folder.
    Folder(PathBuf),
    /// The simulator's flight.
    Simulated,
}

/// A text that names no source.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("expected gige:ADDRESS, gige:SERIAL, folder:DIR or simulated, found {0:?}")]
pub struct NoSource(String);

impl FromStr for Source {
    type Err = NoSource;

    fn from_str(text: &str) -> Result<Self, NoSource> {
        match text.split_once(':') {
            None if text == "simulated" => Ok(Self::Simulated),
            Some(("folder", folder)) if !folder.is_empty() => Ok(Self::Folder(folder.into())),
            Some(("gige", address)) if !address.is_empty() => Ok(Self::Gige(address.into())),
            _ => Err(NoSource(text.into())),
        }
    }
}

impl fmt::Display for Source {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Gige(address) => write!(out, "gige:{address}"),
            Self::Folder(folder) => write!(out, "folder:{}", folder.display()),
            Self::Simulated => write!(out, "simulated"),
        }
    }
}

/// What opening a source needs to know beside its settings.
#[derive(Debug, Clone)]
pub struct Surroundings<'a> {
    pub instrument: &'a Instrument,
    /// Seed of the simulator.
    pub seed: u64,
    /// Length of a simulated run; `None` without end.
    pub duration: Option<Duration>,
}

/// Opens a source and applies the settings. A GigE Vision camera need not be there yet.
///
/// # Errors
/// Where a folder holds no frames or a flight cannot be simulated, and for a kind of source that this build lacks.
pub fn open(
    source: &Source,
    settings: &Settings,
    around: &Surroundings,
) -> Result<Box<dyn FrameSource>, CameraError> {
    let mut camera: Box<dyn FrameSource> = match source {
        #[cfg(feature = "gige")]
        Source::Gige(address) => Box::new(GigeCamera::new(address, settings)),
        #[cfg(not(feature = "gige"))]
        Source::Gige(_) => return Err(CameraError::NotBuilt),
        Source::Folder(folder) => Box::new(FolderCamera::open(folder, settings.rate_hz)?),
        Source::Simulated => Box::new(simulated(settings, around)?),
    };
    camera.apply(settings)?;
    Ok(camera)
}

fn simulated(settings: &Settings, around: &Surroundings) -> Result<SimulatedCamera, CameraError> {
    let start = Timestamp::now();
    let radius_arcsec = sky::sun_angular_radius(start)?;
    let radius_mil = around.instrument.optics.radius_mil(radius_arcsec);
    let trajectory = Trajectory::flight(around.instrument, radius_mil, around.seed)?;
    let scenes = FlightScenes::new(around.instrument, trajectory, radius_mil, around.seed)?;
    Ok(SimulatedCamera::new(
        scenes,
        settings.rate_hz,
        start,
        around.duration,
    ))
}
