//! What a flight is made of.

use super::worker::Life;
use crate::archive::disk::Lock;
use crate::archive::{ArchiveError, Flown, MOON_CAMERA, ROLL_CAMERA, Store};
use crate::bounded::within;
use crate::camera::{CameraError, Exposure, FrameSource};
use crate::commands::controls::{SavedError, SavedValues, Seat};
use crate::config::{Config, FlightClock};
use crate::frame::FrameInfo;
use crate::instrument::{DirectionCamera, Instrument, MountedCamera, SkyCamera};
use crate::link::{Connection, picture};
use crate::navigation::Settings;
use crate::pointing::Target;
use crate::provenance::sha256;
use crate::sky::Ephemeris;
use crossbeam_channel::{Receiver, RecvTimeoutError};
use jiff::Timestamp;
use std::fmt::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long a solver waits for a frame before it shows that it is at work.
const PATIENCE: Duration = Duration::from_millis(200);

/// What a flight is made of.
pub struct Flight {
    pub config: Config,
    /// Where the telescope should point until a command says otherwise.
    pub target: Target,
    pub ephemeris: Ephemeris,
    /// The pitch-yaw camera that commands speak of.
    pub camera: Camera,
    pub other_cameras: Vec<Camera>,
    /// The line to the controller.
    pub line: Connection,
    /// How the attitude goes on between frames; `None` where no filter flies.
    pub navigation: Option<Navigation>,
    /// The archives on the disks; none where frames are not kept.
    pub stores: Vec<Store>,
    /// The lock of the saved values, where they are [claimed](Self::claim).
    pub saved_values: Option<Lock>,
}

/// Why a flight does not begin: another one may go on.
#[derive(Debug, thiserror::Error)]
pub enum ClaimError {
    #[error(transparent)]
    Archive(#[from] ArchiveError),
    #[error(transparent)]
    SavedValues(#[from] SavedError),
}

/// How long a disk is waited for at the start. One that hangs keeps nothing from starting.
const CLAIM: Duration = Duration::from_millis(500);

impl Flight {
    /// A flight of one camera with the defaults for everything else: no line, no archive, the disc's centre as target.
    pub fn of(camera: Camera) -> Self {
        Self {
            config: Config::default(),
            target: Target::default(),
            ephemeris: Ephemeris::default(),
            camera,
            other_cameras: Vec::new(),
            line: Connection::none(),
            navigation: None,
            stores: Vec::new(),
            saved_values: None,
        }
    }

    /// Takes archives and saved values for this program alone, before anything is sent or a camera opened. Disks that are not there, or
    /// hang, are left for later.
    ///
    /// # Errors
    /// Another program flies with one of them, or the file of saved values is something else.
    pub fn claim(&mut self) -> Result<(), ClaimError> {
        for store in &self.stores {
            store.claim_within(CLAIM)?;
        }
        if let Some(file) = SavedValues::of(&self.config) {
            self.saved_values = within(CLAIM, move || file.claim()).unwrap_or(Ok(None))?;
        }
        Ok(())
    }

    /// The effective configuration as a file that gives it again. Comments at its head name the cameras' instruments with their
    /// hashes, so that the hash of this text is of the instruments, too.
    pub fn configuration_toml(&self) -> String {
        let mut text = String::new();
        for (number, camera) in (1..).zip(self.cameras()) {
            let sha256 = camera.instrument_toml.as_ref().map(sha256);
            let sha256 = sha256.map_or("without a file".into(), |sha256| {
                format!("SHA-256 {sha256}")
            });
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "# camera {number}: instrument {:?}, {sha256}",
                camera.instrument.name
            );
        }
        if let Some(navigation) = &self.navigation {
            let sha256 = sha256(&navigation.settings_toml);
            let _ = writeln!(text, "# navigation: SHA-256 {sha256}");
        }
        text + &self.config.to_toml()
    }

    /// The cameras' places, `configuration` being [that of the flight](Self::configuration_toml).
    pub(super) fn stations(&self, configuration: &str) -> impl Iterator<Item = Station> {
        self.cameras().enumerate().map(|(index, camera)| Station {
            index,
            seat: camera.seat,
            instrument: camera.instrument.clone(),
            folder: camera.folder.clone(),
            sky: camera.sky.clone(),
            flown: Arc::new(Flown::new(
                configuration.into(),
                camera.instrument_toml.clone(),
            )),
        })
    }

    /// Opens the cameras that are not open.
    ///
    /// # Errors
    /// That of the first which cannot be opened.
    pub fn open_cameras(&mut self) -> Result<(), CameraError> {
        for camera in std::iter::once(&mut self.camera).chain(&mut self.other_cameras) {
            if let (None, Some(open)) = (&camera.source, &camera.open) {
                camera.source = Some(open()?);
            }
        }
        Ok(())
    }

    pub(super) fn cameras(&self) -> impl Iterator<Item = &Camera> {
        std::iter::once(&self.camera).chain(&self.other_cameras)
    }
}

/// The navigation of a flight.
pub struct Navigation {
    pub settings: Settings,
    /// The file of the settings, letter by letter, for the archive.
    pub settings_toml: String,
    /// The IMU's own line; none where it speaks on the controller's.
    pub imu: Option<Connection>,
    pub gps: Option<Connection>,
    /// By which the date of a fix is judged.
    pub clock: FlightClock,
}

/// A camera of a flight.
pub struct Camera {
    pub seat: Seat,
    pub instrument: Instrument,
    /// The instrument's file, letter by letter, for the archive; `None` where no file describes it.
    pub instrument_toml: Option<String>,
    /// Of its frames and logs under the archive's root; empty for the root itself.
    pub folder: PathBuf,
    /// What a roll or Moon camera sees the sky with; `None` where it sees a plate, or its frames are stored and not solved.
    pub sky: Option<SkyCamera>,
    /// Where its frames come from, if it is open already.
    pub source: Option<Box<dyn FrameSource>>,
    /// Opens it, and opens it again when its thread has failed.
    pub open: Option<CameraFactory>,
}

impl Camera {
    /// A pitch-yaw camera that cannot be opened again.
    pub fn new(instrument: Instrument, source: impl FrameSource + 'static) -> Self {
        Self {
            seat: Seat::PitchYaw,
            instrument,
            instrument_toml: None,
            folder: PathBuf::new(),
            sky: None,
            source: Some(Box::new(source)),
            open: None,
        }
    }

    /// A roll camera that cannot be opened again; its frames and logs stand in a folder of their own and are named after it.
    pub fn of_horizon(
        instrument: Instrument,
        horizon: MountedCamera,
        source: impl FrameSource + 'static,
    ) -> Self {
        Self {
            seat: Seat::Roll,
            sky: Some(SkyCamera::Horizon(horizon)),
            ..Self::new(instrument, source)
        }
        .named(ROLL_CAMERA)
    }

    /// A Moon camera that cannot be opened again; as [`of_horizon`](Self::of_horizon).
    pub fn of_moon(
        instrument: Instrument,
        moon: DirectionCamera,
        source: impl FrameSource + 'static,
    ) -> Self {
        Self {
            seat: Seat::Moon,
            sky: Some(SkyCamera::Moon(moon)),
            ..Self::new(instrument, source)
        }
        .named(MOON_CAMERA)
    }

    /// The same with a folder of its own, by which its frames are named, too.
    pub fn named(mut self, name: &str) -> Self {
        self.instrument.name = name.into();
        self.folder = name.into();
        self
    }
}

/// Opens a camera.
pub type CameraFactory = Arc<dyn Fn() -> Result<Box<dyn FrameSource>, CameraError> + Send + Sync>;

/// A frame on its way from the camera to the solver, with the moment it arrived.
pub(super) struct UnsolvedFrame {
    pub exposure: Exposure,
    pub arrived: Instant,
    pub middle: Middle,
}

/// The middle of an exposure: by the frame's own time, and by its arrival, which a busy computer delays.
#[derive(Debug, Clone, Copy)]
pub(super) struct Middle {
    pub utc: Option<Timestamp>,
    pub by_arrival: Instant,
}

impl Middle {
    /// No frame is delayed by more: the clock has made a step.
    const LONGEST_DELAY_S: f64 = 2.0;

    pub fn of(info: &FrameInfo, arrived: Instant) -> Self {
        let half = info.exposure.unwrap_or_default() / 2;
        Self {
            utc: info.mid_exposure,
            by_arrival: arrived.checked_sub(half).unwrap_or(arrived),
        }
    }

    /// How long after this one another was, s; negative before.
    pub fn until(&self, other: &Self) -> f64 {
        let (from, to) = (self.by_arrival, other.by_arrival);
        let by_arrival = match to.checked_duration_since(from) {
            Some(after) => after.as_secs_f64(),
            None => -from.saturating_duration_since(to).as_secs_f64(),
        };
        let by_utc = self.utc.zip(other.utc);
        let by_utc = by_utc.map(|(from, to)| to.duration_since(from).as_secs_f64());
        let agrees = |by_utc: &f64| (by_utc - by_arrival).abs() < Self::LONGEST_DELAY_S;
        by_utc.filter(agrees).unwrap_or(by_arrival)
    }
}

impl UnsolvedFrame {
    /// The next frame to be solved; `None` when the camera has ended, or another thread has taken over.
    pub fn next(frames: &Receiver<Self>, cameras_ended: &AtomicBool, life: &Life) -> Option<Self> {
        while !life.is_over() {
            life.beat();
            match frames.recv_timeout(PATIENCE) {
                Ok(frame) => return Some(frame),
                Err(_) if cameras_ended.load(Ordering::Relaxed) => return None,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return None,
            }
        }
        None
    }

    /// When the exposure began.
    pub fn began(&self) -> Instant {
        let exposure = self.exposure.frame.info.exposure.unwrap_or_default();
        self.arrived.checked_sub(exposure).unwrap_or(self.arrived)
    }
}

/// A camera's place in the flight.
#[derive(Debug, Clone)]
pub struct Station {
    /// Among the flight's cameras, from 0.
    pub index: usize,
    pub seat: Seat,
    pub instrument: Instrument,
    /// Of its frames and logs under the archive's root; empty for the root itself.
    pub folder: PathBuf,
    /// As [`Camera::sky`].
    pub sky: Option<SkyCamera>,
    /// What its frames are taken and solved with.
    pub flown: Arc<Flown>,
}

impl Station {
    /// As the link counts cameras, from 1.
    pub(super) fn camera_number(&self) -> u16 {
        self.index as u16 + 1
    }

    /// As pictures for the ground count cameras.
    pub(super) fn picture_number(&self) -> u8 {
        match self.seat {
            Seat::Roll => picture::ROLL_CAMERA,
            Seat::Moon => picture::MOON_CAMERA,
            Seat::PitchYaw | Seat::SecondPitchYaw => self.camera_number() as u8,
        }
    }

    /// Whether its frames show the Sun on the plate: of these the controller hears.
    pub(super) fn sees_plate(&self) -> bool {
        matches!(self.seat, Seat::PitchYaw | Seat::SecondPitchYaw)
    }
}
