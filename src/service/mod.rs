//! The flight service: every long-lived thread, channel, bound and overflow rule on one page.
//!
//! ```text
//!             frames (8)               pictures (queue_frames)
//!  camera-1 ---------------> solver-1 ------------------------> archive-1, archive-2    frames
//!     |  ^                     | |  | \_______ rows (10,000) ______> log-1, log-2         log, telemetry, housekeeping
//!     |  \__ Glimpse __________/ |  |
//!     |                          |  \___ directions __
//!     |     LinkEvent (256)      |                    v
//!     +--------------------------+-> link --- IMU --> navigation <--- gps, imu     sensors with lines of their own
//!                                    ^ ^     inputs (1024)  |
//!        controller, over a byte port| \_____ offsets ______/
//!
//!  Controls (shared): what the ground sets; values: saves it
//!  watch: looks after all of them, tells link and logs the housekeeping each second, feeds systemd's watchdog
//! ```
//!
//! Each camera has a thread and a solver of its own; camera and solver of the second pitch-yaw camera, the roll camera and the Moon camera
//! are numbered on. The roll camera's solver tells no controller: it leaves the latest nadir where the other solvers look. The Moon camera's
//! leaves what it saw where the link looks, which answers requests for the Moon with it. Where a navigation filter flies, its thread takes what
//! IMU, GPS and solvers say, and tells the link an offset at some of the IMU's samples. Every disk of the archive has two threads; while it
//! compresses a picture, the first may start `archive.threads` less one for it.
//!
//! | channel | holds | when it is full |
//! |---|---|---|
//! | frames | frames to solve | the frame is lost and counted: a camera does not wait |
//! | Glimpse | brightness of the last frame | the newer takes the place of the older |
//! | pictures | solved frames to store | by the rule `archive.overflow` a picture is given up, and counted; solving goes on |
//! | rows | rows of the log | the row is lost and counted |
//! | commands | rows of the command log, from link and values to watch (1024), and on among the rows | the row is lost and counted |
//! | inputs | samples, fixes and directions for the filter | the input is lost and counted: no solver and no line waits for the filter |
//! | navigation's rows | what the archive keeps of it, a second at a time, from navigation to watch (64), and on among the rows | the rows are lost and counted |
//! | LinkEvent | exposures about to start, solutions, offsets by the gyros, housekeeping | the event is dropped and counted: the line is stuck |
//!
//! A thread ends when the channel it reads from is closed: the camera ends first, then solver and archive, each after
//! the last of its work. The link goes on answering commands until the service is joined.
//!
//! A thread that panics is started again. So is a camera, a solver or the filter that shows no sign of life for a while, with the
//! same channels; the one that hangs is left alone. While three of them hang, the next is not replaced; where no camera is solved
//! any more, the program ends in order, and systemd starts it again. A stop of the whole program counts against no thread. A
//! thread blocked on a disk is not restarted: the other disk's goes on. Where watch or link hang, systemd's watchdog is not
//! fed, and it starts the program again.
//!
//! The program's log has a queue and a thread of its own ([`crate::log`]): no thread here waits for standard error.

mod answer;
mod archiver;
pub mod demo;
mod flight;
mod housekeeping;
mod line;
mod moon;
pub mod navigation;
mod outlet;
pub mod priority;
mod roll;
mod shared;
mod shutter;
mod silence;
mod solver;
mod systemd;
mod tallies;
mod tally;
mod watch;
mod worker;

pub use answer::{Answer, SolvedMoon};
pub use archiver::DiskHealth;
pub use flight::{Camera, CameraFactory, ClaimError, Flight, Navigation, Station};
pub use tally::{
    ArchiveTally, CameraTally, FlightTally, LineTally, MoonTally, RollTally, SolverTally, quantile,
};

use crate::archive::disk::Lock;
use crate::camera::FrameSource;
use crate::commands::Seat;
use crate::commands::controls::{Controls, SavedValues, ValueSaver};
use crate::config::Host;
use crate::instrument::{DirectionCamera, MountedCamera, SkyCamera};
use crate::link::{Connection, Counters, Housekeeping};
use crate::provenance::sha256;
use crate::sky::Ephemeris;
use answer::Recent;
use crossbeam_channel::{Receiver, Sender, bounded, unbounded};
use flight::UnsolvedFrame;
use housekeeping::HousekeepingSource;
use line::{Line, LinkEvent};
use moon::{MoonDesk, MoonSolver};
use navigation::{Inputs, Navigator};
use outlet::Outlet;
use priority::Rank;
use roll::{LatestNadir, RollSolver};
use shared::Shared;
use shutter::{Glimpse, Shutter};
use solver::Solver;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use tallies::Tallies;
use watch::{Signals, Watch};
use worker::{Life, Worker};

/// Frames that may wait for the solver: a third of a second at 26 frames/s.
const UNSOLVED: usize = 8;
/// Events that may wait for the line.
const LINK_EVENTS: usize = 256;
/// A camera that gives no word for so long hangs. It gives one each second, and may take two to be set.
const CAMERA_PATIENCE: Duration = Duration::from_secs(10);
/// So does a solver. It takes a hundredth of a second for a frame.
const SOLVER_PATIENCE: Duration = Duration::from_secs(5);
/// Of the navigation, for the archive: seconds of three logs.
const NAVIGATION_ROWS: usize = 64;

/// How long the start waits for the saved values, and the end for the last of them to be saved.
const SAVED_VALUES: Duration = Duration::from_millis(500);

/// A running service.
pub struct Service {
    watch: JoinHandle<FlightTally>,
    /// Only where values set by command are saved.
    values: Option<JoinHandle<u64>>,
    controls: Controls,
    gauges: archiver::Gauges,
    tallies: Tallies,
    signals: Arc<Signals>,
}

/// A thread of the service that ended by a panic.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("the {0} thread of the service has failed")]
pub struct ThreadFailed(&'static str);

impl Service {
    /// Starts the threads of a flight.
    pub fn start(flight: Flight) -> std::io::Result<Self> {
        Self::launch(flight, None)
    }

    /// Starts the threads of a flight; every answer goes to the watcher, too.
    pub fn start_watched(flight: Flight) -> std::io::Result<(Self, Receiver<Answer>)> {
        let (watcher, answers) = unbounded();
        Ok((Self::launch(flight, Some(watcher))?, answers))
    }

    fn launch(mut flight: Flight, watcher: Option<Sender<Answer>>) -> std::io::Result<Self> {
        let controls = controls(&flight);
        let signals = Arc::<Signals>::default();
        let lock = flight.saved_values.take();
        let values = SavedValues::of(&flight.config)
            .map(|file| keep_values(file, lock, &controls, &signals))
            .transpose()?;
        let configuration = flight.configuration_toml();
        let stations: Vec<Arc<Station>> = flight.stations(&configuration).map(Arc::new).collect();
        let counters = Arc::<Counters>::default();
        let navigation_toml = flight.navigation.as_ref();
        let navigation_toml = navigation_toml.map(|navigation| &*navigation.settings_toml);
        let (stores, ephemeris) = (flight.stores, &flight.ephemeris);
        let (archive, disks) = archiver::start(
            stores,
            &stations,
            &controls,
            ephemeris,
            navigation_toml,
            &counters,
        )?;
        let gauges = archive.gauges();
        let (to_line, events) = bounded(LINK_EVENTS);
        let tallies = Tallies {
            counters: Arc::clone(&counters),
            cameras: Vec::new(),
            silences: Vec::new(),
            solvers: Vec::new(),
            unsolved: Vec::new(),
            archive: gauges.clone(),
            line: Shared::default(),
            roll: Shared::default(),
            moon: Shared::default(),
            navigation: Shared::default(),
        };
        let (inputs, queue) = Inputs::new(tallies.navigation.clone(), Arc::clone(&counters));
        let inputs = flight.navigation.is_some().then_some(inputs);
        let moon_desk = Shared::<MoonDesk>::default();
        let host = flight.config.host;
        host.hold();
        let line = Talk {
            controls: controls.clone(),
            tally: tallies.line.clone(),
            counters: Arc::clone(&counters),
            moon_desk: moon_desk.clone(),
            navigation: inputs.clone(),
            events,
            hang_up: Arc::clone(&signals.hang_up),
        };
        let line = line.start(flight.line, host)?;
        let (to_rows, navigation_rows) = bounded(NAVIGATION_ROWS);
        let navigation = match (flight.navigation, &inputs) {
            (Some(navigation), Some(inputs)) => {
                let navigator = Navigator {
                    settings: navigation.settings.clone(),
                    ephemeris: flight.ephemeris.clone(),
                    controls: controls.clone(),
                    to_line: to_line.clone(),
                    rows: to_rows,
                    tally: tallies.navigation.clone(),
                    counters: Arc::clone(&counters),
                    ended: Arc::clone(&signals.cameras_ended),
                    clock: navigation.clock,
                };
                navigator.start(navigation.imu, navigation.gps, inputs, &queue, host)?
            }
            _ => Vec::new(),
        };
        let mut workers = Workers {
            host,
            controls: controls.clone(),
            ephemeris: flight.ephemeris,
            archive: archive.clone(),
            to_line: to_line.clone(),
            watcher,
            signals: Arc::clone(&signals),
            tallies,
            recent: Vec::new(),
            nadir: LatestNadir::default(),
            moon_desk: moon_desk.clone(),
            inputs,
            cameras: Vec::new(),
            solvers: Vec::new(),
        };
        let cameras = std::iter::once(flight.camera).chain(flight.other_cameras);
        for (station, camera) in stations.iter().zip(cameras) {
            workers.add(station, camera)?;
        }
        let tallies = workers.tallies.clone();
        let watch = Watch {
            cameras: workers.cameras,
            solvers: workers.solvers,
            navigation,
            navigation_rows,
            disks,
            line,
            archive: Some(archive),
            to_line,
            controls: controls.clone(),
            housekeeping: HousekeepingSource::new(
                controls.clone(),
                workers.recent,
                moon_desk,
                &sha256(&configuration),
            ),
            tallies: workers.tallies,
            signals: Arc::clone(&signals),
            gave_up: false,
            landed: None,
        };
        Ok(Self {
            watch: spawn("watch", move || watch.run())?,
            values,
            controls,
            gauges,
            tallies,
            signals,
        })
    }

    /// What the ground sets and reads.
    pub fn controls(&self) -> &Controls {
        &self.controls
    }

    /// Asks the cameras to end after the frames they are taking; everything else follows.
    pub fn stop(&self) {
        self.signals.stop.store(true, Ordering::Relaxed);
    }

    /// As [`stop`](Self::stop); what is not finished after this time is given up.
    pub fn stop_within(&self, time: Duration) {
        self.stop();
        self.signals
            .deadline
            .lock()
            .get_or_insert(Instant::now() + time);
    }

    /// Whether the last frame has been solved and stored.
    pub fn is_finished(&self) -> bool {
        self.signals.finished.load(Ordering::Acquire) || self.watch.is_finished()
    }

    /// What the ground was told last; `None` in the first second.
    pub fn housekeeping(&self) -> Option<Housekeeping> {
        self.signals.housekeeping.copy()
    }

    /// What has happened so far, with the latencies of the last moment.
    pub fn tally(&self) -> FlightTally {
        let mut tally = self.tallies.brief();
        tally.restarts = self.signals.restarts.load(Ordering::Relaxed);
        tally
    }

    /// How the archive's disks are.
    pub fn disks(&self) -> Vec<DiskHealth> {
        self.gauges.disks()
    }

    /// Pictures that wait for a disk.
    pub fn waiting_pictures(&self) -> usize {
        self.gauges.waiting()
    }

    /// Waits for the last frame, hangs up, and says what happened.
    pub fn join(self) -> Result<FlightTally, ThreadFailed> {
        self.signals.awaited.store(true, Ordering::Relaxed);
        let tally = self.watch.join().map_err(|_| ThreadFailed("watch"));
        // A watch that has failed has told nobody.
        self.signals.hang_up.store(true, Ordering::Relaxed);
        let begin = Instant::now();
        let is_saving = |values: &JoinHandle<u64>| !values.is_finished();
        while self.values.as_ref().is_some_and(is_saving) && begin.elapsed() < SAVED_VALUES {
            thread::sleep(Duration::from_millis(1));
        }
        tally
    }
}

/// What the ground may set.
fn controls(flight: &Flight) -> Controls {
    let mounting = flight.camera.instrument.mounting;
    let controls = Controls::new(flight.config.clone(), flight.target, mounting);
    let seats = flight.cameras().map(|camera| camera.seat);
    controls.note_cameras(&seats.map(Seat::role).collect::<Vec<_>>());
    controls.note_instrument(&flight.camera.instrument);
    controls
}

/// Starts the thread that reads and saves what commands set, and waits a moment for what was saved.
fn keep_values(
    file: SavedValues,
    lock: Option<Lock>,
    controls: &Controls,
    signals: &Signals,
) -> std::io::Result<JoinHandle<u64>> {
    let name = file.path().display().to_string();
    let saver = ValueSaver::new(controls.clone(), file, lock);
    let ends = Arc::clone(&signals.hang_up);
    let (restored, wait) = bounded(1);
    let values = spawn("values", move || saver.run(&restored, &ends))?;
    if wait.recv_timeout(SAVED_VALUES).is_err() {
        tracing::error!(
            file = name,
            "the disk hangs: starting without the saved values"
        );
    }
    Ok(values)
}

/// The threads of cameras and solvers, and what they share.
struct Workers {
    host: Host,
    controls: Controls,
    ephemeris: Ephemeris,
    archive: archiver::Archive,
    to_line: Sender<LinkEvent>,
    watcher: Option<Sender<Answer>>,
    signals: Arc<Signals>,
    tallies: Tallies,
    recent: Vec<Shared<Recent>>,
    nadir: LatestNadir,
    moon_desk: Shared<MoonDesk>,
    inputs: Option<Inputs>,
    cameras: Vec<Worker>,
    solvers: Vec<Worker>,
}

impl Workers {
    fn add(&mut self, station: &Arc<Station>, camera: Camera) -> std::io::Result<()> {
        let (to_solver, unsolved) = bounded(UNSOLVED);
        let glimpse = Glimpse::default();
        let outlet = Outlet {
            controls: self.controls.clone(),
            archive: self.archive.clone(),
            to_line: self.to_line.clone(),
            watcher: self.watcher.clone(),
            glimpse: glimpse.clone(),
            recent: Shared::default(),
            navigation: self.inputs.clone(),
        };
        self.recent.push(outlet.recent.clone());
        self.tallies.unsolved.push(unsolved.clone());
        match station.sky.clone() {
            Some(SkyCamera::Horizon(camera)) => {
                self.add_roll_solver(station, camera, outlet, unsolved)?;
            }
            Some(SkyCamera::Moon(camera)) => {
                self.add_moon_solver(station, camera, outlet, unsolved)?;
            }
            None => self.add_solver(station, outlet, unsolved)?,
        }
        self.add_camera(station, &glimpse, to_solver, camera.source, camera.open)
    }

    fn add_solver(
        &mut self,
        station: &Arc<Station>,
        outlet: Outlet,
        unsolved: Receiver<UnsolvedFrame>,
    ) -> std::io::Result<()> {
        let solver = Solver {
            station: Arc::clone(station),
            ephemeris: self.ephemeris.clone(),
            outlet,
            cameras_ended: Arc::clone(&self.signals.cameras_ended),
            nadir: self.nadir.clone(),
            calibration: Shared::default(),
            tally: Shared::default(),
            counters: Arc::clone(&self.tallies.counters),
        };
        self.tallies.solvers.push(solver.tally.clone());
        self.start_solver(station, move |life| solver.clone().run(&unsolved, life))
    }

    fn add_roll_solver(
        &mut self,
        station: &Arc<Station>,
        camera: MountedCamera,
        outlet: Outlet,
        unsolved: Receiver<UnsolvedFrame>,
    ) -> std::io::Result<()> {
        let solver = RollSolver {
            station: Arc::clone(station),
            camera,
            outlet,
            cameras_ended: Arc::clone(&self.signals.cameras_ended),
            latest: self.nadir.clone(),
            tally: self.tallies.roll.clone(),
            counters: Arc::clone(&self.tallies.counters),
        };
        self.start_solver(station, move |life| solver.clone().run(&unsolved, life))
    }

    fn add_moon_solver(
        &mut self,
        station: &Arc<Station>,
        camera: DirectionCamera,
        outlet: Outlet,
        unsolved: Receiver<UnsolvedFrame>,
    ) -> std::io::Result<()> {
        let solver = MoonSolver {
            station: Arc::clone(station),
            camera,
            ephemeris: self.ephemeris.clone(),
            outlet,
            cameras_ended: Arc::clone(&self.signals.cameras_ended),
            desk: self.moon_desk.clone(),
            tally: self.tallies.moon.clone(),
        };
        self.start_solver(station, move |life| solver.clone().run(&unsolved, life))
    }

    fn start_solver(
        &mut self,
        station: &Station,
        run: impl Fn(&Life) + Clone + Send + 'static,
    ) -> std::io::Result<()> {
        let host = self.host;
        let name = format!("solver-{}", station.camera_number());
        self.solvers
            .push(Worker::start(name, Some(SOLVER_PATIENCE), move || {
                host.hurried(Rank::Solver, run.clone())
            })?);
        Ok(())
    }

    fn add_camera(
        &mut self,
        station: &Arc<Station>,
        glimpse: &Glimpse,
        to_solver: Sender<UnsolvedFrame>,
        mut source: Option<Box<dyn FrameSource>>,
        open: Option<CameraFactory>,
    ) -> std::io::Result<()> {
        let shutter = Shutter {
            station: Arc::clone(station),
            controls: self.controls.clone(),
            to_solver,
            to_line: self.to_line.clone(),
            glimpse: glimpse.clone(),
            tally: Shared::default(),
            counters: Arc::clone(&self.tallies.counters),
            silence: Shared::default(),
            stop: Arc::clone(&self.signals.stop),
        };
        self.tallies.cameras.push(shutter.tally.clone());
        self.tallies.silences.push(shutter.silence.clone());
        let host = self.host;
        let name = format!("camera-{}", station.camera_number());
        self.cameras
            .push(Worker::start(name, Some(CAMERA_PATIENCE), move || {
                let (shutter, source, open) = (shutter.clone(), source.take(), open.clone());
                host.hurried(Rank::First, move |life| shutter.run(source, open, life))
            })?);
        Ok(())
    }
}

/// What the link's thread shares with the others.
#[derive(Clone)]
struct Talk {
    controls: Controls,
    tally: Shared<LineTally>,
    counters: Arc<Counters>,
    moon_desk: Shared<MoonDesk>,
    navigation: Option<Inputs>,
    events: Receiver<LinkEvent>,
    hang_up: Arc<AtomicBool>,
}

impl Talk {
    fn start(self, connection: Connection, host: Host) -> std::io::Result<Worker> {
        // Held by one life after the other: the port outlives a thread that panicked.
        let connection = Arc::new(Mutex::new(connection));
        Worker::start("link", None, move || {
            let (talk, connection) = (self.clone(), Arc::clone(&connection));
            host.hurried(Rank::First, move |life| {
                let mut connection = connection.lock().unwrap_or_else(PoisonError::into_inner);
                let (events, hang_up) = (talk.events, talk.hang_up);
                let (controls, tally, counters) = (talk.controls, talk.tally, talk.counters);
                let (moon_desk, navigation) = (talk.moon_desk, talk.navigation);
                Line::new(
                    &mut connection,
                    controls,
                    tally,
                    counters,
                    moon_desk,
                    navigation,
                )
                .run(&events, &hang_up, life);
            })
        })
    }
}

fn spawn<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> std::io::Result<JoinHandle<T>> {
    thread::Builder::new().name(name.into()).spawn(work)
}
