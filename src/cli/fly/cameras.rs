//! The cameras of a flight, as the configuration names them.

use crate::archive::{self, MOON_CAMERA, ROLL_CAMERA};
use crate::camera::{self, CameraError, FrameSource, Settings, Source, Surroundings};
use crate::cli::options;
use crate::commands::Seat;
use crate::config::{self, Config};
use crate::instrument::{
    DirectionCamera, Instrument, MountedCamera, SECOND, SkyCamera, TomlError, text_of,
};
use crate::service::{Camera, CameraFactory};
use jiff::Timestamp;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// The first pitch-yaw camera, and the others that are configured: a second one, the roll camera, the Moon camera; none is open yet.
///
/// With one camera its frames go to the archive's root; with several each has a folder of its own. The simulator ends after
/// `duration`; a folder is replayed `speed` times faster than it was taken.
pub(super) fn of(
    config: &Config,
    duration: Option<Duration>,
    speed: f64,
) -> anyhow::Result<(Camera, Vec<Camera>)> {
    let Some(source) = config.camera.source.clone() else {
        anyhow::bail!("camera.source: expected a camera, found none");
    };
    let common = Common {
        seed: config.simulation.seed,
        start: config.simulation.start_utc,
        duration,
        speed,
    };
    let mut first = common.camera(Seat::PitchYaw, &config.camera, source)?;
    let mut others = Vec::new();
    if let Some(source) = config.second_camera.source.clone() {
        let mut second = common.camera(Seat::SecondPitchYaw, &config.second_camera, source)?;
        if folder(&second.instrument) == folder(&first.instrument) {
            second.instrument.name += SECOND;
        }
        second.folder = folder(&second.instrument);
        others.push(second);
    }
    if let Some(source) = config.roll_camera.source.clone() {
        let roll = common.camera(Seat::Roll, &config.roll_camera, source)?;
        others.push(roll.named(ROLL_CAMERA));
    }
    if let Some(source) = config.moon_camera.source.clone() {
        let moon = common.camera(Seat::Moon, &config.moon_camera, source)?;
        others.push(moon.named(MOON_CAMERA));
    }
    if !others.is_empty() {
        first.folder = folder(&first.instrument);
    }
    Ok((first, others))
}

/// Where frames and logs of one of several cameras go, under the archive's root.
fn folder(instrument: &Instrument) -> PathBuf {
    archive::plain(&instrument.name).into()
}

/// The file of a camera that looks at the sky.
fn sky_camera(seat: Seat, path: &Path, text: &str) -> Result<SkyCamera, TomlError> {
    match seat {
        Seat::Moon => DirectionCamera::parse(path, text).map(SkyCamera::Moon),
        _ => MountedCamera::parse(path, text).map(SkyCamera::Horizon),
    }
}

/// What all cameras of a run share.
#[derive(Clone, Copy)]
struct Common {
    seed: u64,
    start: Option<Timestamp>,
    duration: Option<Duration>,
    speed: f64,
}

impl Common {
    fn camera(self, seat: Seat, table: &config::Camera, source: Source) -> anyhow::Result<Camera> {
        let file = table.instrument.as_deref();
        let (instrument, toml, sky) = match seat {
            Seat::PitchYaw | Seat::SecondPitchYaw => {
                let (instrument, text) = options::instrument_with_text(file)?;
                (instrument, Some(text), None)
            }
            Seat::Roll | Seat::Moon => {
                let text = file.map(text_of).transpose()?;
                let sky = file.zip(text.as_deref());
                let sky = sky.map(|(path, text)| sky_camera(seat, path, text));
                (
                    options::instrument_with_text(None)?.0,
                    text,
                    sky.transpose()?,
                )
            }
        };
        let settings = table.settings();
        let again = (instrument.clone(), sky.clone());
        let open: CameraFactory =
            Arc::new(move || self.open(&source, &settings, &again.0, again.1.as_ref()));
        Ok(Camera {
            seat,
            instrument,
            instrument_toml: toml,
            folder: PathBuf::new(),
            sky,
            source: None,
            open: Some(open),
        })
    }

    fn open(
        self,
        source: &Source,
        settings: &Settings,
        instrument: &Instrument,
        sky: Option<&SkyCamera>,
    ) -> Result<Box<dyn FrameSource>, CameraError> {
        let around = Surroundings {
            instrument,
            sky,
            seed: self.seed,
            start: self.start,
            duration: self.duration,
            speed: self.speed,
        };
        camera::open(source, settings, &around)
    }
}
