//! The service between a camera, disks and a gondola that fail on command.

use crate::camera::{CameraFault, Frames, Ring, RingCamera};
use crate::faults::Fault;
use crate::files::{Files, LogBytes};
use crate::line::{Gondola, Heard};
use crate::machine::{self, MemoryLog, ProcessorTimes};
use crate::navigation::{self, ImuBench};
use crate::stderr::Stderr;
use anyhow::Context;
use solaspect::archive::Store;
use solaspect::archive::faulty::FaultyDisk;
use solaspect::camera::{Camera, FrameSource};
use solaspect::commands::controls::{SavedError, SavedValues};
use solaspect::config::{Config, Outputs, Switch};
use solaspect::fits::Compression;
use solaspect::instrument::{Instrument, MountedCamera, Role, Sees};
use solaspect::service::{Flight, FlightCamera, FlightTally, Service};
use std::cell::{Cell, RefCell};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant, SystemTime};

/// Interval of the checks.
const CHECK_EVERY: Duration = Duration::from_millis(20);
/// Number of snapshots, of which the one with the fewest packets in transit is used.
const SNAPSHOTS: usize = 20;

pub struct Rig {
    pub service: Service,
    pub gondola: Gondola,
    pub rate_hz: f64,
    /// Folder of the saved values.
    pub values: PathBuf,
    pub memory: RefCell<MemoryLog>,
    pub files: RefCell<Files>,
    pub roll_files: RefCell<Option<Files>>,
    ring: Arc<Ring>,
    roll_ring: Option<Arc<Ring>>,
    disks: Vec<(PathBuf, FaultyDisk)>,
    imu: Option<ImuBench>,
    stderr: Option<Stderr>,
    checked: Cell<Instant>,
    processor: RefCell<ProcessorTimes>,
    number: Cell<u16>,
}

/// All counts at one time.
#[derive(Debug, Clone)]
pub struct Counts {
    pub time: Instant,
    pub frames: Frames,
    pub roll_frames: Frames,
    pub tally: FlightTally,
    pub waiting: usize,
    pub stored_on: Vec<u64>,
    pub logs: Vec<LogBytes>,
    pub heard: Heard,
    pub garbled_solutions: u64,
    pub values_saved: Option<SystemTime>,
}

impl Counts {
    /// Number of solutions that were sent and have not arrived.
    pub fn missing(&self) -> u64 {
        let sent = self.tally.counts.solutions;
        sent.saturating_sub(self.heard.solutions)
    }
}

/// The camera that observes the horizon.
pub struct RollParts {
    pub ring: Arc<Ring>,
    pub camera: MountedCamera,
}

/// The parts of a rig.
pub struct Parts {
    pub ring: Ring,
    pub instrument: Instrument,
    pub roll: Option<RollParts>,
    pub navigation: Option<navigation::Parts>,
    pub realtime: Option<u8>,
    pub outputs: Outputs,
    pub roots: Vec<PathBuf>,
    pub values: PathBuf,
    pub keep: bool,
    pub rate_hz: f64,
    pub stderr: Option<Stderr>,
}

impl Rig {
    /// Tries to fly a second time on the same archive, and on the same saved values.
    ///
    /// # Errors
    /// If one of them was allowed.
    pub fn start_second(&self) -> anyhow::Result<()> {
        let mut config = Config::default();
        config.link.saved_values = Some(self.values.join("values.toml"));
        let values = SavedValues::of(&config).map(|file| file.claim());
        let refused = matches!(values, Some(Err(SavedError::Taken { .. })));
        anyhow::ensure!(
            refused,
            "expected the saved values to be taken, found {values:?}"
        );
        let archive = Store::open(self.root(0), "demo", Compression::Rice);
        anyhow::ensure!(
            archive.is_err(),
            "expected the archive to be taken, found it free"
        );
        Ok(())
    }

    pub fn start(parts: Parts) -> anyhow::Result<Self> {
        let ring = Arc::new(parts.ring);
        let instrument = parts.instrument.clone();
        let name = parts.instrument.name.clone();
        let with_disk = |root: &PathBuf| (root.clone(), FaultyDisk::default());
        let disks: Vec<_> = parts.roots.iter().map(with_disk).collect();
        let store = |(root, disk): &(PathBuf, FaultyDisk)| {
            Store::new(Arc::new(disk.clone()), root, &name, Compression::Rice)
        };
        let stores = disks.iter().map(store).collect();
        let mut config = Config::default();
        config.link.saved_values = Some(parts.values.join("values.toml"));
        config.host.realtime_priority = parts.realtime;
        config.outputs = parts.outputs;
        // Each camera's queue holds more than two seconds of frames.
        config.archive.queue_frames *= 1 + usize::from(parts.roll.is_some());
        let (mut flies, mut sensors, mut imu, mut judge) = (None, None, None, None);
        if let Some(parts) = parts.navigation {
            config.navigation.send = Switch::On;
            (flies, sensors) = (Some(parts.flies), Some(parts.sensors));
            (imu, judge) = (Some(parts.imu), Some(parts.judge));
        }
        let (gondola, line) = Gondola::start(sensors, judge);
        let opens = Arc::clone(&ring);
        let open = move || {
            let camera = RingCamera(Arc::clone(&opens));
            Ok(Box::new(camera) as Box<dyn FrameSource>)
        };
        let mut cameras = vec![FlightCamera {
            open: Some(Arc::new(open)),
            ..FlightCamera::of_plate(instrument, RingCamera(Arc::clone(&ring)))
        }];
        let roll_ring = parts.roll.as_ref().map(|roll| Arc::clone(&roll.ring));
        let roll_frames = roll_ring.as_ref().map(|ring| ring.end());
        cameras.extend(parts.roll.map(|RollParts { ring, camera }| {
            let camera = Camera::new("roll_camera", Role::Roll, Sees::Horizon(camera));
            FlightCamera::new(camera, RingCamera(ring))
        }));
        let flight = Flight {
            config,
            line,
            navigation: flies,
            stores,
            ..Flight::of(cameras)
        };
        let frames = ring.end();
        let in_roll_folder = parts.roots.iter().map(|root| root.join("roll"));
        let roll_files =
            roll_frames.map(|frames| Files::new(in_roll_folder.collect(), parts.keep, frames));
        Ok(Self {
            service: Service::start(flight)?,
            gondola,
            rate_hz: parts.rate_hz,
            values: parts.values,
            memory: RefCell::new(MemoryLog::new((frames as f64 / parts.rate_hz) as usize)),
            files: RefCell::new(Files::new(parts.roots, parts.keep, frames)),
            roll_files: RefCell::new(roll_files),
            ring,
            roll_ring,
            disks,
            imu,
            stderr: parts.stderr,
            checked: Cell::new(Instant::now()),
            processor: RefCell::default(),
            number: Cell::new(0),
        })
    }

    pub fn disks(&self) -> usize {
        self.disks.len()
    }

    /// A disk, counted from 0.
    pub fn disk(&self, n: usize) -> &FaultyDisk {
        &self.disks[n].1
    }

    pub fn root(&self, n: usize) -> &Path {
        &self.disks[n].0
    }

    pub fn ring(&self) -> &Ring {
        &self.ring
    }

    /// Processor time of the threads at the last check.
    pub fn processor(&self) -> ProcessorTimes {
        self.processor.borrow().clone()
    }

    /// Applies a fault to the next `count` frames of the camera.
    pub fn fail(&self, fault: CameraFault, count: u64) {
        self.ring.fail(fault, count);
    }

    pub fn stderr(&self) -> anyhow::Result<&Stderr> {
        self.stderr
            .as_ref()
            .context("standard error is not captured")
    }

    pub fn imu(&self) -> anyhow::Result<&ImuBench> {
        self.imu.as_ref().context("imu: expected --navigation")
    }

    /// A fault's name; for the IMU's, its kind.
    pub fn name_of(&self, fault: Fault) -> String {
        match (fault, &self.imu) {
            (Fault::Imu, Some(imu)) => format!("imu: {}", imu.name()),
            _ => fault.name(),
        }
    }

    /// An integer below 1000 that differs from the last one.
    pub fn next_number(&self) -> u16 {
        self.number.set((self.number.get() + 1) % 1000);
        self.number.get()
    }

    /// Monitors files and memory until the given time, or until the flight has ended.
    pub fn wait_until(&self, then: Instant) -> anyhow::Result<()> {
        while Instant::now() < then && !self.service.is_finished() {
            self.check(false)?;
        }
        Ok(())
    }

    /// One check, and a short sleep. `kept`: whether the memory sample counts for its growth.
    pub fn check(&self, kept: bool) -> anyhow::Result<()> {
        thread::sleep(CHECK_EVERY);
        if self.checked.get().elapsed() >= Duration::from_secs(1) {
            self.checked.set(Instant::now());
            self.memory.borrow_mut().note(kept)?;
            self.processor.replace(machine::processor_times()?);
            self.files.borrow_mut().clear()?;
            if let Some(files) = self.roll_files.borrow_mut().as_mut() {
                files.clear()?;
            }
        }
        Ok(())
    }

    pub fn counts(&self) -> Counts {
        let values = self.values.join("values.toml").metadata();
        let mut tally = self.service.tally();
        tally.line.latencies.clear();
        Counts {
            time: Instant::now(),
            frames: self.ring.frames(),
            roll_frames: self
                .roll_ring
                .as_ref()
                .map_or(Frames::default(), |ring| ring.frames()),
            tally,
            waiting: self.service.waiting_pictures(),
            stored_on: self.service.disks().iter().map(|d| d.stored).collect(),
            logs: self.files.borrow().logs(),
            heard: self.gondola.heard(),
            garbled_solutions: self.gondola.garbled_solutions(),
            values_saved: values.and_then(|file| file.modified()).ok(),
        }
    }

    /// The counts at a time with as few packets in transit as possible.
    pub fn counts_between_packets(&self) -> Counts {
        let mut best = self.counts();
        for _ in 1..SNAPSHOTS {
            thread::sleep(Duration::from_millis(5));
            let counts = self.counts();
            if counts.missing() < best.missing() {
                best = counts;
            }
        }
        best
    }
}
