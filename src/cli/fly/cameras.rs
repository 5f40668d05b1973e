//! The cameras of a flight, as the configuration names them.

use crate::archive::{self, ROLL_CAMERA};
use crate::camera::{self, CameraError, FrameSource, Settings, Source, Surroundings};
use crate::cli::options;
use crate::config::{self, Config};
use crate::instrument::toml_file::read_text;
use crate::instrument::{Instrument, MountedCamera, SECOND};
use crate::service::{Camera, CameraFactory, Seat};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// The first pitch-yaw camera, and the others that are configured; none is open yet.
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
        let mut roll = common.camera(Seat::Roll, &config.roll_camera, source)?;
        roll.instrument.name = ROLL_CAMERA.into();
        roll.folder = ROLL_CAMERA.into();
        others.push(roll);
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

/// What all cameras of a run share.
#[derive(Clone, Copy)]
struct Common {
    seed: u64,
    duration: Option<Duration>,
    speed: f64,
}

impl Common {
    fn camera(self, seat: Seat, table: &config::Camera, source: Source) -> anyhow::Result<Camera> {
        let (plate, horizon) = match seat {
            Seat::Roll => (None, table.instrument.as_deref()),
            _ => (table.instrument.as_deref(), None),
        };
        let (instrument, text) = options::instrument_with_text(plate)?;
        let horizon_text = horizon.map(read_text).transpose()?;
        let parsed = horizon.zip(horizon_text.as_deref());
        let horizon = parsed.map(|(path, text)| MountedCamera::parse(path, text));
        let horizon = horizon.transpose()?;
        let settings = table.settings();
        let again = (instrument.clone(), horizon.clone());
        let open: CameraFactory =
            Arc::new(move || self.open(&source, &settings, &again.0, again.1.as_ref()));
        Ok(Camera {
            seat,
            instrument,
            instrument_toml: match seat {
                Seat::Roll => horizon_text,
                _ => Some(text),
            },
            folder: PathBuf::new(),
            horizon,
            source: None,
            open: Some(open),
        })
    }

    fn open(
        self,
        source: &Source,
        settings: &Settings,
        instrument: &Instrument,
        horizon: Option<&MountedCamera>,
    ) -> Result<Box<dyn FrameSource>, CameraError> {
        let around = Surroundings {
            instrument,
            horizon,
            seed: self.seed,
            duration: self.duration,
            speed: self.speed,
        };
        camera::open(source, settings, &around)
    }
}
