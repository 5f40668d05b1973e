//! Messages between threads, and values that they share. Every stage uses this file, and no other stage.

use super::shared::Shared;
use crate::archive::Flown;
use crate::aspect::{self, Quality};
use crate::camera::{Brightness, Camera, Exposure};
use crate::frame::Levels;
use crate::geometry::attitude::Direction;
use crate::horizon;
use crate::instrument::Instrument;
use crate::link::{
    self, Housekeeping, ImuPacket, MoonOutcome, Picture, Propagated, TelemetryPacket,
};
use crate::moon;
use crate::navigation::Target as ObservedTarget;
use crate::navigation::nmea::TimedFix;
use crate::pointing::{Offset, Target};
use crate::reasons::Stopped;
use crate::units::{Measured, Place};
use jiff::Timestamp;
use nalgebra::Vector3;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A camera's place in the flight.
#[derive(Debug, Clone)]
pub struct Station {
    pub camera: Camera,
    /// Number among the flight's cameras, from 0.
    pub index: usize,
    /// Number among the cameras of its role, from 1.
    pub ordinal: usize,
    /// Number on the line, by which a picture states the camera that took it.
    pub number: u8,
    /// Settings with which its frames are taken and solved.
    pub flown: Arc<Flown>,
}

/// A frame on its way from the camera to the solver, with the moment it arrived.
pub struct UnsolvedFrame {
    pub exposure: Exposure,
    pub arrived: Instant,
    pub middle: MidExposure,
}

/// The middle of an exposure: by the frame's own time stamp, and by its arrival, which a busy computer delays.
#[derive(Debug, Clone, Copy)]
pub struct MidExposure {
    pub utc: Option<Timestamp>,
    pub by_arrival: Instant,
}

/// A frame's brightness and its exposure, us; the solver passes them to the camera's thread.
pub(super) type LatestBrightness = Shared<Option<(Brightness, u32)>>;

/// A solved frame.
#[derive(Debug, Clone)]
pub struct SolvedFrame {
    /// The camera that took the frame.
    pub station: Arc<Station>,
    pub exposure: Arc<Exposure>,
    pub solved: Arc<Solved>,
    /// Target of the offset.
    pub target: Target,
    /// Whether the picture goes to the archive; the row always does.
    pub to_be_stored: bool,
}

/// Result of a frame.
#[derive(Debug, Clone)]
pub struct Solved {
    pub found: Found,
    pub quality: Quality,
    /// Stage and reason if processing stopped; set for a coarse frame, too.
    pub stopped: Option<Stopped<&'static str>>,
    pub levels: Option<Levels>,
    /// Brightness for the automatic exposure.
    pub brightness: Brightness,
    pub roll: Option<BodyRoll>,
    /// Time that the solver alone took.
    pub solve_time: Duration,
}

/// Content of a frame, by the kind of its camera.
#[derive(Debug, Clone)]
pub enum Found {
    Sun(Box<SolvedSun>),
    Nadir(Box<horizon::Solution>),
    Moon(Box<SolvedMoon>),
    /// The frame is stored, and not solved.
    Nothing,
}

#[derive(Debug, Clone)]
pub struct SolvedSun {
    pub solution: aspect::Solution,
    pub offset: Option<Offset>,
    /// The instrument when the frame was taken: with commanded settings, and the part of the sensor that was read.
    pub instrument: Arc<Instrument>,
}

#[derive(Debug, Clone)]
pub struct SolvedMoon {
    pub found: Result<moon::Disc, moon::Stopped>,
    /// Direction in the camera's axes.
    pub direction: Option<Direction>,
}

/// The body's roll, from this frame of the horizon or from the one nearest in time to this frame of the Sun.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyRoll {
    pub deg: Measured,
    /// Arrival of that frame of the horizon.
    pub arrived: Instant,
}

/// A receiver of every solved frame.
pub(super) trait ReceivesFrames: Send + Sync {
    fn receive(&self, frame: &SolvedFrame);
}

/// A receiver of every telemetry packet that the line carries.
pub(super) trait ReceivesTelemetry: Send + Sync {
    fn receive_telemetry(&self, packet: &TelemetryPacket);
}

/// A receiver of samples of the IMU.
pub(super) trait ReceivesSamples: Send + Sync {
    /// Takes a packet that was read at the time `read`.
    fn receive_sample(&self, packet: &TelemetryPacket, read: Instant);
}

/// Latest nadir from the horizon; the solvers of the other cameras read it.
pub(super) type LatestNadir = Shared<Option<BodyNadir>>;

/// Nadir in the axes of the body that carries the cameras: forward, right, down.
#[derive(Debug, Clone, Copy)]
pub(super) struct BodyNadir {
    pub direction: Direction,
    pub at: MidExposure,
    /// Arrival of the frame.
    pub arrived: Instant,
    /// Turn rate of the nadir in these axes, from the latest frames.
    pub turn_rad_per_s: Vector3<f64>,
    /// The error of a prediction with this rate at this frame, 1 sigma per axis, and the time over which it was predicted.
    pub error_rad: f64,
    pub after_s: f64,
}

/// The line's requests to the Moon camera, and its latest result.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct MoonState {
    /// The platform's place at the latest request.
    pub requested_from: Option<Place>,
    pub result: Option<MoonResult>,
}

/// Result of the Moon camera's last frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct MoonResult {
    /// Start of its exposure.
    pub began: Instant,
    pub outcome: MoonOutcome,
    /// Whether the Sun was below the horizon; `None` if time or place is not known.
    pub is_night: Option<bool>,
}

/// A solver's contribution to the next housekeeping.
#[derive(Debug, Default)]
pub(super) struct Recent {
    pub frame: Option<SolvedFrame>,
    /// Solve times of the frames since the last packet.
    pub solve_times: Vec<Duration>,
}

/// Events for the link.
pub(super) enum LinkEvent {
    ExposureStarts(link::Exposure),
    Outcome(Box<Outcome>),
    /// An offset by the gyros.
    Propagated(PropagatedEvent),
    /// The second's housekeeping, and its time.
    Housekeeping(Timestamp, Box<Housekeeping>),
    /// Counts of cameras that have no fields in the housekeeping, at a time.
    Cameras(Timestamp, Vec<link::CameraCounts>),
    /// Ids of marks that do not fit into the housekeeping, at its time.
    Marks(Timestamp, Vec<link::FrameMarks>),
    /// A picture for the ground: it takes minutes, between other packets. A new one replaces an old one.
    Picture(Box<Picture>),
}

/// An offset by the gyros.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PropagatedEvent {
    pub propagated: Propagated,
    /// Reading time of the sample on which the offset rests.
    pub read: Instant,
}

/// Result of an exposure.
pub(super) struct Outcome {
    pub exposure: link::Exposure,
    /// Arrival of the frame.
    pub arrived: Instant,
    /// Exposure time, if known.
    pub exposure_time: Option<Duration>,
    pub offset: Option<Offset>,
    /// The body's roll, if known.
    pub roll: Option<BodyRoll>,
    pub stopped: Option<aspect::Stopped>,
}

/// A sensor's input to the navigation filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Input {
    /// A sample, and its reading time.
    Imu(ImuPacket, Instant),
    Fix(TimedFix),
    Direction(ObservedDirection),
}

/// A direction observed by a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ObservedDirection {
    /// Number among the flight's cameras, from 0.
    pub camera: usize,
    pub target: ObservedTarget,
    /// Mid-exposure.
    pub utc: Timestamp,
    /// In forward, right and down axes of the telescope or the body that carries the camera; in a Moon camera's own axes.
    pub direction: Direction,
}

/// A log of the navigation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NavigationLog {
    Imu,
    Gps,
    Propagated,
}

/// Rows of a log, covering about a second.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct NavigationRows {
    pub log: NavigationLog,
    pub rows: VecDeque<Vec<String>>,
}

impl NavigationLog {
    pub const ALL: [Self; 3] = [Self::Imu, Self::Gps, Self::Propagated];
}
