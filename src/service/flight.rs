//! What a flight is made of.

use super::control::Seat;
use super::shutter::Opener;
use crate::archive::Store;
use crate::camera::FrameSource;
use crate::config::Config;
use crate::instrument::Instrument;
use crate::link::Connection;
use crate::pointing::Target;
use crate::sky::Ephemeris;
use std::path::PathBuf;

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
    /// The archives on the disks; none where frames are not kept.
    pub stores: Vec<Store>,
}

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
            stores: Vec::new(),
        }
    }

    pub(super) fn cameras(&self) -> impl Iterator<Item = &Camera> {
        std::iter::once(&self.camera).chain(&self.other_cameras)
    }
}

/// A camera of a flight.
pub struct Camera {
    pub seat: Seat,
    pub instrument: Instrument,
    /// Of its frames and logs under the archive's root; empty for the root itself.
    pub folder: PathBuf,
    /// Where its frames come from, if it is open already.
    pub source: Option<Box<dyn FrameSource>>,
    /// Opens it, and opens it again when its thread has failed.
    pub open: Option<Opener>,
}

impl Camera {
    /// A pitch-yaw camera that cannot be opened again.
    pub fn new(instrument: Instrument, source: impl FrameSource + 'static) -> Self {
        Self {
            seat: Seat::PitchYaw,
            instrument,
            folder: PathBuf::new(),
            source: Some(Box::new(source)),
            open: None,
        }
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
}

impl Station {
    /// As the link counts cameras, from 1.
    pub(super) fn camera_number(&self) -> u16 {
        self.index as u16 + 1
    }

    /// Whether its frames are solved; a roll camera's wait for a solver of horizons.
    pub(super) fn is_solved(&self) -> bool {
        self.seat != Seat::Roll
    }
}
