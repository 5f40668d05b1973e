//! What a configuration and the options of the command line make fly.

use crate::camera::Source;
use crate::commands::CameraRole;
use crate::config::{self, Config, Switch};
use crate::instrument::{Dated, Instrument, SkyCamera};
use crate::pointing::{Feature, HelioprojectiveArcsec, PointingError, Target};
use crate::sky::TableError;
use crate::sky::{Ephemeris, OrientationTable, SkyError};
use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;

/// What the command line says instead of the configuration.
#[derive(Debug, Clone, Default)]
pub struct Options {
    pub instrument: Option<PathBuf>,
    pub camera: Option<Source>,
    /// The controller's port.
    pub serial: Option<String>,
    /// The archive's folders, the second one if any; empty where the configuration's hold.
    pub archive: Vec<PathBuf>,
}

impl Options {
    /// Puts what was said over the configuration.
    pub fn over(&self, config: &mut Config) {
        let mut folders = self.archive.iter().cloned();
        if let Some(first) = folders.next() {
            config.archive.directory = Some(first);
            config.archive.second_directory = folders.next();
        }
        if let Some(instrument) = &self.instrument {
            config.camera.instrument = Some(instrument.clone());
        }
        if let Some(source) = &self.camera {
            config.camera.source = Some(source.clone());
        }
        if let Some(port) = &self.serial {
            config.link.port = Some(port.clone());
        }
    }
}

/// A camera that is to fly.
#[derive(Debug, Clone)]
pub struct PlannedCamera {
    /// The configuration's table.
    pub table: &'static str,
    pub role: CameraRole,
    pub source: Source,
    pub config: config::Camera,
    /// The camera's own; of a camera that sees no plate the demo, for want of one that describes it.
    pub instrument: Instrument,
    /// What a roll or Moon camera sees the sky with.
    pub sky: Option<SkyCamera>,
    /// When the instrument's mounting was measured.
    pub dates: Vec<Dated>,
}

/// What is to fly.
#[derive(Debug, Clone)]
pub struct Plan {
    pub config: Config,
    pub cameras: Vec<PlannedCamera>,
    pub orientation: Arc<OrientationTable>,
    pub target: Target,
}

impl Plan {
    pub fn ephemeris(&self) -> Ephemeris {
        Ephemeris::new(Arc::clone(&self.orientation))
    }

    /// The archive's folders, the preferred one first.
    pub fn folders(&self) -> Vec<PathBuf> {
        let archive = &self.config.archive;
        let both = [&archive.directory, &archive.second_directory];
        both.into_iter().flatten().cloned().collect()
    }
}

impl fmt::Display for PlannedCamera {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let config::Camera {
            rate_hz,
            exposure_us,
            pixel_format,
            ..
        } = &self.config;
        write!(
            out,
            "{}: {} at {rate_hz} Hz, {exposure_us} us{}, {}",
            self.table,
            self.source,
            match self.config.auto_exposure() {
                Some(_) => " to begin with",
                None => "",
            },
            pixel_format.name()
        )?;
        match self.role {
            CameraRole::PitchYaw => write!(out, ", instrument \"{}\"", self.instrument.name),
            CameraRole::Roll if self.sky.is_some() => write!(out, ", solved for roll"),
            CameraRole::Moon if self.sky.is_some() => write!(out, ", solved for the Moon"),
            CameraRole::Roll | CameraRole::Moon => write!(out, ", stored and not solved"),
        }
    }
}

/// One line for each part of the flight.
impl fmt::Display for Plan {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for camera in &self.cameras {
            writeln!(out, "{camera}")?;
        }
        let link = &self.config.link;
        match &link.port {
            Some(port) => writeln!(
                out,
                "link: {port}, {} baud, computer {}",
                link.baud, link.computer
            )?,
            None => writeln!(out, "link: none")?,
        }
        let navigation = &self.config.navigation;
        if navigation.is_enabled() {
            writeln!(
                out,
                "navigation: {} Hz, IMU by {}, GPS by {}, offsets {}",
                navigation.rate_hz,
                navigation.imu_port.as_deref().unwrap_or("link"),
                navigation.gps_port.as_deref().unwrap_or("nobody"),
                match navigation.send {
                    Switch::On => "sent",
                    Switch::Off => "not sent",
                }
            )?;
        }
        let archive = &self.config.archive;
        let folders: Vec<String> = self
            .folders()
            .iter()
            .map(|f| f.display().to_string())
            .collect();
        match folders.as_slice() {
            [] => writeln!(out, "archive: none")?,
            [one] => writeln!(out, "archive: {one}, {}", archive.compression.name())?,
            both => {
                let (sharing, compression) = (archive.sharing.name(), archive.compression.name());
                writeln!(
                    out,
                    "archive: {}, {sharing}, {compression}",
                    both.join(" and ")
                )?;
            }
        }
        let target = &self.config.target;
        write!(
            out,
            "target: {}, {} arcsec",
            target.x_arcsec, target.y_arcsec
        )?;
        match target.epoch_utc {
            Some(epoch) => write!(out, " at {epoch}, turning with the Sun"),
            None => Ok(()),
        }
    }
}

/// The ephemeris with the configured table of Earth orientation, else the program's own.
///
/// # Errors
/// A table that is refused.
pub fn ephemeris(config: &Config) -> Result<Ephemeris, TableError> {
    orientation(config).map(Ephemeris::new)
}

pub(super) fn orientation(config: &Config) -> Result<Arc<OrientationTable>, TableError> {
    match &config.sky.earth_orientation {
        Some(path) => OrientationTable::read(path).map(Arc::new),
        None => Ok(OrientationTable::built_in()),
    }
}

/// Why a configured target cannot be pointed at.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoTarget {
    #[error("target.epoch_utc: {0}")]
    Epoch(#[from] SkyError),
    #[error("target: {0}")]
    Place(#[from] PointingError),
}

/// The configured target; with an epoch, the feature that stood there then.
///
/// # Errors
/// An epoch of which the sky is not known, a feature off the disc.
pub fn target(config: &Config, ephemeris: &mut Ephemeris) -> Result<Target, NoTarget> {
    let at = HelioprojectiveArcsec {
        x: config.target.x_arcsec,
        y: config.target.y_arcsec,
    };
    let Some(epoch) = config.target.epoch_utc else {
        return Ok(Target::Fixed(at));
    };
    let disc = ephemeris.disc(epoch)?;
    Ok(Target::Feature(Feature::seen(at, epoch, &disc)?))
}
