//! Starts the threads of a flight, each with the values that it shares with the others.

use super::archiver::{self, Archive};
use super::camera_thread::CameraThread;
use super::flight::{Flight, FlightCamera, Navigation};
use super::housekeeping::HousekeepingSource;
use super::line::{self, Line};
use super::messages::{
    LatestBrightness, LinkEvent, NavigationRows, ReceivesFrames, ReceivesSamples, SolvedFrame,
    Station, UnsolvedFrame,
};
use super::navigation::{Inputs, Navigator};
use super::outputs::{self, Outputs};
use super::priority::Rank;
use super::shared::Shared;
use super::solver_thread::SolverThread;
use super::solvers::{Results, SolverFactory, State};
use super::tallies::{CameraTallies, Tallies};
use super::tally::FlightTally;
use super::watch::{Signals, Watch};
use super::worker::Worker;
use crate::commands::controls::{Controls, SavedValues, ValueSaver};
use crate::config::Host;
use crate::link::{Connection, Counters};
use crate::provenance::sha256;
use crate::sky::Ephemeris;
use crossbeam_channel::{Receiver, Sender, bounded};
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Frames that may wait for the solver: a third of a second at 26 frames/s.
const UNSOLVED: usize = 8;
/// Events that may wait for the line.
const LINK_EVENTS: usize = 256;
/// Silence after which a camera counts as hung. It shows that it is alive each second, and may take two seconds to be set.
const CAMERA_TIMEOUT: Duration = Duration::from_secs(10);
/// The same for a solver. It takes 0.01 s for a frame.
const SOLVER_TIMEOUT: Duration = Duration::from_secs(5);
/// Rows of the navigation that may wait for the archive: one for each second of its three logs.
const NAVIGATION_ROWS: usize = 64;

/// Longest wait for the saved values at the start, and for the last of them to be saved at the end.
pub(super) const SAVED_VALUES: Duration = Duration::from_millis(500);

/// A running service.
pub struct Service {
    pub(super) watch: JoinHandle<FlightTally>,
    /// `None` if values set by command are not saved.
    pub(super) values: Option<JoinHandle<u64>>,
    pub(super) controls: Controls,
    pub(super) tallies: Tallies,
    pub(super) signals: Arc<Signals>,
}

/// Starts the threads of a flight; every solved frame goes to the sink, too.
pub(super) fn launch(mut flight: Flight, sink: Option<Sender<SolvedFrame>>) -> io::Result<Service> {
    let cameras = flight.cameras.iter().map(|one| &one.camera);
    let controls = Controls::of_flight(flight.config.clone(), flight.target, cameras);
    let signals = Arc::<Signals>::default();
    let values = keep_values(&mut flight, &controls, &signals)?;
    let configuration = flight.configuration_toml();
    let stations = flight.stations(&configuration);
    let counters = Arc::<Counters>::default();
    let stores = std::mem::take(&mut flight.stores);
    let context = archiver::ArchiveContext {
        stations: &stations,
        controls: &controls,
        ephemeris: &flight.ephemeris,
        navigation_toml: flight.navigation.as_ref().map(|one| &*one.settings_toml),
        counters: &counters,
    };
    let (archive, disks) = archiver::start(stores, &context)?;
    flight.config.host.hold();
    let (outputs, output_gauges, writers) =
        outputs::start(&flight.config.outputs, &signals.closing)?;
    let (to_line, events) = bounded(LINK_EVENTS);
    let mut workers = Workers {
        host: flight.config.host,
        controls: controls.clone(),
        ephemeris: flight.ephemeris,
        to_line,
        sink,
        signals: Arc::clone(&signals),
        tallies: Tallies {
            counters,
            archive: archive.gauges(),
            outputs: output_gauges,
            ..Tallies::default()
        },
        archive,
        outputs,
        results: Results::default(),
        inputs: None,
        cameras: Vec::new(),
        solvers: Vec::new(),
    };
    let navigation = workers.start_navigation(flight.navigation, &stations)?;
    let line = workers.start_line(flight.line, events)?;
    for (station, camera) in stations.iter().zip(flight.cameras) {
        workers.add(station, camera)?;
    }
    let tallies = workers.tallies.clone();
    let threads = (disks, line, writers);
    let watch = workers.watch(navigation, threads, &sha256(&configuration));
    Ok(Service {
        watch: spawn("watch", move || watch.run())?,
        values,
        controls,
        tallies,
        signals,
    })
}

/// Starts the thread that reads and saves values set by command, if configured, and waits a moment for the saved values.
fn keep_values(
    flight: &mut Flight,
    controls: &Controls,
    signals: &Signals,
) -> io::Result<Option<JoinHandle<u64>>> {
    let lock = flight.saved_values.take();
    let Some(file) = SavedValues::of(&flight.config) else {
        return Ok(None);
    };
    let name = file.path().display().to_string();
    let saver = ValueSaver::new(controls.clone(), file, lock);
    let ends = Arc::clone(&signals.closing);
    let (restored, wait) = bounded(1);
    let values = spawn("values", move || saver.run(&restored, &ends))?;
    if wait.recv_timeout(SAVED_VALUES).is_err() {
        tracing::error!(
            file = name,
            "the disk hangs: starting without the saved values"
        );
    }
    Ok(Some(values))
}

/// The threads of cameras and solvers so far, and what all threads share.
struct Workers {
    host: Host,
    controls: Controls,
    ephemeris: Ephemeris,
    archive: Archive,
    outputs: Outputs,
    to_line: Sender<LinkEvent>,
    sink: Option<Sender<SolvedFrame>>,
    signals: Arc<Signals>,
    tallies: Tallies,
    /// Results of the first camera of each role.
    results: Results,
    /// The inputs of the navigation filter; `None` without one.
    inputs: Option<Inputs>,
    cameras: Vec<Worker>,
    solvers: Vec<Worker>,
}

impl Workers {
    /// Starts the filter and its sensors, if the flight has a filter.
    fn start_navigation(
        &mut self,
        navigation: Option<Navigation>,
        stations: &[Arc<Station>],
    ) -> io::Result<(Vec<Worker>, Receiver<NavigationRows>)> {
        let (rows, kept) = bounded(NAVIGATION_ROWS);
        let Some(navigation) = navigation else {
            return Ok((Vec::new(), kept));
        };
        let (tally, counters) = (&self.tallies.navigation, &self.tallies.counters);
        let (inputs, queue) = Inputs::new(tally.clone(), Arc::clone(counters));
        let cameras = stations.iter().map(|station| &station.camera);
        let navigator = Navigator {
            settings: navigation.settings,
            cameras: cameras.map(|one| (one.name.clone(), one.role)).collect(),
            ephemeris: self.ephemeris.clone(),
            controls: self.controls.clone(),
            to_line: self.to_line.clone(),
            rows,
            tally: tally.clone(),
            counters: Arc::clone(counters),
            ended: Arc::clone(&self.signals.cameras_ended),
            clock: navigation.clock,
        };
        let (imu, gps) = (navigation.imu, navigation.gps);
        let workers = navigator.start(imu, gps, &inputs, &queue, self.host)?;
        self.inputs = Some(inputs);
        Ok((workers, kept))
    }

    fn start_line(
        &self,
        connection: Connection,
        events: Receiver<LinkEvent>,
    ) -> io::Result<Worker> {
        let navigation = self.inputs.clone();
        let context = line::LineContext {
            controls: self.controls.clone(),
            tally: self.tallies.line.clone(),
            counters: Arc::clone(&self.tallies.counters),
            moon_state: self.results.moon.clone(),
            navigation: navigation.map(|inputs| Arc::new(inputs) as Arc<dyn ReceivesSamples>),
            outputs: Arc::new(self.outputs.clone()),
        };
        let (host, closing) = (self.host, Arc::clone(&self.signals.closing));
        // Restarts of the thread share it: the port outlives a thread that panicked.
        let connection = Arc::new(Mutex::new(connection));
        Worker::start("link", None, move || {
            let (context, connection) = (context.clone(), Arc::clone(&connection));
            let (events, closing) = (events.clone(), Arc::clone(&closing));
            host.realtime(Rank::Higher, move |heartbeat| {
                let mut connection = connection.lock().unwrap_or_else(PoisonError::into_inner);
                Line::new(&mut connection, context).run(&events, &closing, heartbeat);
            })
        })
    }

    /// The watch over all threads.
    fn watch(
        self,
        (navigation, navigation_rows): (Vec<Worker>, Receiver<NavigationRows>),
        (disks, line, outputs): (archiver::Threads, Worker, Vec<Worker>),
        configuration_sha256: &str,
    ) -> Watch {
        let (controls, moon_state) = (self.controls.clone(), self.results.moon);
        Watch {
            cameras: self.cameras,
            solvers: self.solvers,
            navigation,
            navigation_rows,
            disks,
            line,
            outputs,
            archive: Some(self.archive),
            to_line: self.to_line,
            controls: self.controls,
            housekeeping: HousekeepingSource::new(controls, moon_state, configuration_sha256),
            tallies: self.tallies,
            signals: self.signals,
            gave_up: false,
            frames_ended: None,
        }
    }

    fn add(&mut self, station: &Arc<Station>, camera: FlightCamera) -> io::Result<()> {
        let (to_solver, unsolved) = bounded(UNSOLVED);
        let tallies = CameraTallies {
            station: Arc::clone(station),
            camera: Shared::default(),
            silence: Shared::default(),
            solver: Shared::default(),
            unsolved,
            recent: Shared::default(),
        };
        let latest = LatestBrightness::default();
        self.add_solver(&tallies, latest.clone())?;
        self.add_camera(&tallies, latest, to_solver, camera)?;
        self.tallies.cameras.push(tallies);
        Ok(())
    }

    fn add_solver(&mut self, tallies: &CameraTallies, latest: LatestBrightness) -> io::Result<()> {
        let station = Arc::clone(&tallies.station);
        let mut receivers: Vec<Arc<dyn ReceivesFrames>> = Vec::new();
        if let Some(inputs) = &self.inputs {
            receivers.push(Arc::new(inputs.clone()));
        }
        receivers.push(Arc::new(tallies.recent.clone()));
        receivers.push(Arc::new(self.archive.clone()));
        receivers.push(Arc::new(self.outputs.clone()));
        if let Some(sink) = &self.sink {
            receivers.push(Arc::new(sink.clone()));
        }
        let solving = SolverThread {
            station: Arc::clone(&station),
            controls: self.controls.clone(),
            frames: tallies.unsolved.clone(),
            cameras_ended: Arc::clone(&self.signals.cameras_ended),
            to_line: self.to_line.clone(),
            brightness: latest,
            receivers,
            tally: tallies.solver.clone(),
        };
        let state = State {
            tally: tallies.solver.clone(),
            ..State::default()
        };
        let (host, ephemeris) = (self.host, self.ephemeris.clone());
        let factory = SolverFactory::new(&station, ephemeris, &self.results, state);
        let name = format!("solver-{}", station.index + 1);
        let worker = Worker::start(name, Some(SOLVER_TIMEOUT), move || {
            let (solving, solver) = (solving.clone(), factory.make());
            host.realtime(Rank::Solver, move |beat| solving.run(solver, beat))
        })?;
        self.solvers.push(worker);
        Ok(())
    }

    fn add_camera(
        &mut self,
        tallies: &CameraTallies,
        latest: LatestBrightness,
        to_solver: Sender<UnsolvedFrame>,
        camera: FlightCamera,
    ) -> io::Result<()> {
        let thread = CameraThread {
            station: Arc::clone(&tallies.station),
            controls: self.controls.clone(),
            to_solver,
            to_line: self.to_line.clone(),
            brightness: latest,
            tally: tallies.camera.clone(),
            counters: Arc::clone(&self.tallies.counters),
            silence: tallies.silence.clone(),
            stop: Arc::clone(&self.signals.stop),
        };
        let (host, mut source) = (self.host, camera.source);
        let name = format!("camera-{}", tallies.station.index + 1);
        let worker = Worker::start(name, Some(CAMERA_TIMEOUT), move || {
            let (thread, source, open) = (thread.clone(), source.take(), camera.open.clone());
            host.realtime(Rank::Higher, move |beat| thread.run(source, open, beat))
        })?;
        self.cameras.push(worker);
        Ok(())
    }
}

fn spawn<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> io::Result<JoinHandle<T>> {
    thread::Builder::new().name(name.into()).spawn(work)
}
