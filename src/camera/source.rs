//! A camera by its name on the command line or in the configuration.

#[cfg(feature = "gige")]
use super::genicam::GenicamCamera;
use super::{
    Backlog, CameraError, CameraSettings, Device, FolderCamera, FollowedFolder, FrameSource,
    SimulatedCamera, TakenFiles, View,
};
use crate::clock::FlightClock;
use crate::instrument::{Instrument, Sees, builtin};
use crate::simulate::earth::SwingingGondola;
use crate::simulate::moon::FollowedMoon;
use crate::simulate::{Course, FORT_SUMNER, FlightScenes, Pieces, Trajectory};
use crate::sky;
use jiff::Timestamp;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

/// Source of frames.
#[derive(Debug, Clone, PartialEq)]
pub enum Source {
    Device(Device),
    /// The frames of a folder.
    Folder(PathBuf),
    /// The frames that another program writes into a folder.
    Followed(PathBuf, Backlog),
    /// The simulator's standard flight, or the flight in a file.
    Simulated(Option<PathBuf>),
    /// A camera supplied by the program that uses this library.
    Own,
}

/// A text that names no source.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("expected {expected}, found {0:?}", expected = Source::EXPECTED)]
pub struct NoSource(String);

impl Source {
    /// Forms of a source's name, for error messages.
    pub const EXPECTED: &str = "gige:ADDRESS, gige:SERIAL, genicam:ID, folder:DIR, folder:DIR?follow, folder:DIR?follow=all, simulated, simulated:FILE.toml or own";

    /// Whether its frames are simulated, and must be marked so.
    pub fn is_simulated(&self) -> bool {
        match self {
            Self::Simulated(_) => true,
            Self::Device(device) => device.is_fake(),
            Self::Folder(_) | Self::Followed(..) | Self::Own => false,
        }
    }

    /// Whether it is a real camera. It can be opened only once, and its frames have their times from this computer's clock.
    pub fn is_real(&self) -> bool {
        matches!(self, Self::Device(_) | Self::Own) && !self.is_simulated()
    }

    /// The source of `DIR`, `DIR?follow` or `DIR?follow=all`. A question mark before the last slash is part of the name.
    fn of_folder(text: &str) -> Option<Self> {
        let (folder, how) = match text.rsplit_once('?') {
            Some((folder, how)) if !how.contains('/') => (folder, Some(how)),
            _ => (text, None),
        };
        let backlog = match how {
            _ if folder.is_empty() => return None,
            None => return Some(Self::Folder(folder.into())),
            Some("follow") => Backlog::Skipped,
            Some("follow=all") => Backlog::Taken,
            Some(_) => return None,
        };
        Some(Self::Followed(folder.into(), backlog))
    }
}

impl FromStr for Source {
    type Err = NoSource;

    fn from_str(text: &str) -> Result<Self, NoSource> {
        match text.split_once(':') {
            None if text == "simulated" => Ok(Self::Simulated(None)),
            None if text == "own" => Ok(Self::Own),
            Some(("simulated", file)) if !file.is_empty() => Ok(Self::Simulated(Some(file.into()))),
            Some(("folder", folder)) => {
                Self::of_folder(folder).ok_or_else(|| NoSource(text.into()))
            }
            // gige://ADDRESS would be a serial number that no camera has.
            Some(("gige", id)) if !id.is_empty() && !id.contains('/') => {
                Ok(Self::Device(Device::Gige(id.into())))
            }
            Some(("genicam", id)) if !id.is_empty() && !id.starts_with('/') => {
                Ok(Self::Device(Device::Genicam(id.into())))
            }
            _ => Err(NoSource(text.into())),
        }
    }
}

impl fmt::Display for Source {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Device(device) => write!(out, "{device}"),
            Self::Folder(folder) => {
                let name = folder.display().to_string();
                // Otherwise the text after the question mark is the mode.
                let is_bare = name
                    .rsplit('/')
                    .next()
                    .is_some_and(|last| last.contains('?'));
                write!(out, "folder:{name}{}", if is_bare { "/" } else { "" })
            }
            Self::Followed(folder, backlog) => {
                let how = match backlog {
                    Backlog::Skipped => "follow",
                    Backlog::Taken => "follow=all",
                };
                write!(out, "folder:{}?{how}", folder.display())
            }
            Self::Simulated(None) => write!(out, "simulated"),
            Self::Own => write!(out, "own"),
            Self::Simulated(Some(file)) => write!(out, "simulated:{}", file.display()),
        }
    }
}

/// Inputs of a source besides its settings.
#[derive(Debug, Clone)]
pub struct SourceContext {
    pub sees: Sees,
    /// Clock of a simulated flight's frames.
    pub clock: FlightClock,
    /// Seed of the simulator.
    pub seed: u64,
    /// Length of a simulated run; `None` without end.
    pub duration: Option<Duration>,
    /// Factor by which a replayed folder is faster than the original.
    pub speed: f64,
    /// Files that this camera has taken from a folder that it follows.
    pub taken: TakenFiles,
}

/// Opens a source and applies the settings. A device, and a folder that is followed, need not exist yet.
///
/// # Errors
/// If a folder holds no frames or a flight cannot be simulated, or this build lacks the kind of source.
pub fn open(
    source: &Source,
    settings: &CameraSettings,
    context: &SourceContext,
) -> Result<Box<dyn FrameSource>, CameraError> {
    let mut camera: Box<dyn FrameSource> = match source {
        #[cfg(feature = "gige")]
        Source::Device(device) => Box::new(GenicamCamera::new(device.clone(), settings)),
        #[cfg(not(feature = "gige"))]
        Source::Device(_) => return Err(CameraError::NotBuilt),
        Source::Folder(folder) => {
            Box::new(FolderCamera::open(folder, settings.rate_hz, context.speed)?)
        }
        Source::Followed(folder, backlog) => {
            Box::new(FollowedFolder::open(folder, *backlog, &context.taken))
        }
        Source::Simulated(file) => Box::new(simulated(file.as_deref(), settings, context)?),
        Source::Own => return Err(CameraError::NotSupplied),
    };
    camera.apply(settings)?;
    Ok(camera)
}

/// A simulated camera above Fort Sumner. A camera of a plate is as far into its flight as the flight's clock is, and begins one now if that has no
/// start; limb and Moon are those at the clock's time, whatever path the Sun takes on the plate of another camera. A camera without a calibration
/// takes the frames of the demo.
fn simulated(
    file: Option<&Path>,
    settings: &CameraSettings,
    context: &SourceContext,
) -> Result<SimulatedCamera, CameraError> {
    let (now, seed) = (context.clock.now(), context.seed);
    let of_plate = |instrument: &Instrument| -> Result<SimulatedCamera, CameraError> {
        let start = context.clock.start().unwrap_or(now);
        let course = simulated_course(file, instrument, start, seed)?;
        let scenes = FlightScenes::new(instrument, course, radius_mil(instrument, start)?, seed)?;
        let ahead = Duration::try_from(now.duration_since(start)).unwrap_or_default();
        let view = View::Plate(Box::new(scenes));
        let camera = SimulatedCamera::new(view, settings, start, context.duration);
        Ok(camera.ahead_by(ahead))
    };
    let of_sky = |view| SimulatedCamera::new(view, settings, now, context.duration);
    Ok(match &context.sees {
        Sees::Plate(instrument) => of_plate(instrument)?,
        Sees::Unstated => of_plate(&builtin("demo")?)?,
        Sees::Horizon(camera) => {
            let gondola = SwingingGondola::new(camera, &FORT_SUMNER, seed);
            of_sky(View::Horizon(Box::new(gondola)))
        }
        Sees::Moon(camera) => {
            let moon = FollowedMoon::new(camera, FORT_SUMNER, seed);
            of_sky(View::Moon(Box::new(moon)))
        }
    })
}

/// Path of the Sun in a simulated flight: from a file, or an endless sequence of rests and slews.
///
/// # Errors
/// If the file describes no flight, or the instrument's picture is too small for one.
pub fn simulated_course(
    file: Option<&Path>,
    instrument: &Instrument,
    start: Timestamp,
    seed: u64,
) -> Result<Course, CameraError> {
    Ok(match file {
        Some(file) => Pieces::read(file)?.into(),
        None => Trajectory::flight(instrument, radius_mil(instrument, start)?, seed)?.into(),
    })
}

fn radius_mil(instrument: &Instrument, at: Timestamp) -> Result<f64, CameraError> {
    let radius_arcsec = sky::sun_angular_radius(at)?;
    Ok(instrument.optics.radius_mil(radius_arcsec))
}
