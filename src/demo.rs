//! The whole system on one computer without hardware: simulated cameras of Sun and horizon, the real service, a real archive, and
//! a simulated controller at the other end of a pseudo-terminal.

mod faults;
mod line;
mod recent;

pub use faults::{Fault, FaultCost, Faults};

use crate::archive::disk::{Disk, LocalDisk};
use crate::archive::{ArchiveError, Store};
use crate::aspect::Quality;
use crate::camera::{Camera, CameraSettings, SimulatedCamera, TruthLog, View};
use crate::clock::FlightClock;
use crate::config::{Config, Switch};
use crate::fits::Compression;
use crate::instrument::{
    self, DEMO_HORIZON, DEMO_NAVIGATION, Instrument, MountedCamera, Role, Sees, builtin_text,
};
use crate::link::{
    AnyPort, BytePort, Connection, Message, PortError, Propagated, SerialPort, Solution,
};
use crate::navigation;
use crate::service::{
    Flight, FlightCamera, FlightTally, Found, Navigation, Service, SolvedFrame, quantile,
};
use crate::simulate::controller::{Controller, Report};
use crate::simulate::earth::SwingingGondola;
use crate::simulate::navigation::{TelescopeFlight, TelescopeTruth};
use crate::simulate::sensors::Sensors;
use crate::simulate::{EXPOSURE, FORT_SUMNER, FlightScenes, Gondola, Trajectory};
use crate::sky;
use anyhow::anyhow;
use crossbeam_channel::{Receiver, RecvTimeoutError};
use jiff::{Timestamp, civil};
use line::Relayed;
use recent::Recent;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Settings of a demonstration.
#[derive(Debug, Clone)]
pub struct Demo {
    /// `None`: until it is stopped; then the archive keeps only the frames of the last ten minutes.
    pub duration: Option<Duration>,
    pub rate_hz: f64,
    /// The archive's folder.
    pub archive: PathBuf,
    pub seed: u64,
    /// For training: faults that may be injected, and a camera whose pauses are detected, like those of a real one.
    pub faults: Option<Faults>,
}

impl Demo {
    /// A demonstration of this duration without faults, at 4 Hz, with its archive in a folder.
    pub fn lasting(duration: Duration, archive: &Path, seed: u64) -> Self {
        Self {
            duration: Some(duration),
            rate_hz: 4.0,
            archive: archive.into(),
            seed,
            faults: None,
        }
    }
}

/// State for the display while the demonstration runs.
#[derive(Debug, Clone)]
pub struct Progress {
    pub frame: SolvedFrame,
    /// The last offset that the controller received.
    pub received: Option<Solution>,
}

/// Result of a demonstration.
#[derive(Debug, Clone)]
pub struct Summary {
    pub tally: FlightTally,
    pub controller: Report,
    /// Errors of the aspect relative to the truth, fine frames, arcsec.
    pub fine_errors_arcsec: Vec<f64>,
    /// Errors of offsets by the gyros relative to the truth; empty if a ground commands.
    pub propagated: Vec<JudgedOffset>,
    /// The same for the offsets of frames at times for which the horizon gave the roll.
    pub by_sun: Vec<JudgedOffset>,
    /// Errors of the body's roll relative to the truth, frames of the horizon, deg.
    pub roll_errors_deg: Vec<f64>,
    /// Fine or coarse frames in which there was no Sun at all.
    pub false_suns: u64,
    /// Losses caused by a trainer's faults.
    pub fault_cost: FaultCost,
    pub archive: PathBuf,
}

/// An offset by the gyros or by the Sun, compared with the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JudgedOffset {
    /// Age of the last frame on which it rests.
    pub age_s: f64,
    /// Error in cross-elevation and elevation.
    pub error_arcsec: [f64; 2],
    pub sigma_arcsec: f64,
}

impl JudgedOffset {
    /// `None` if the flight has no truth.
    pub fn of(said: &Propagated, flown: &mut TelescopeFlight, start: Timestamp) -> Option<Self> {
        let truth = flown.truth(since(start, &said.solution)?).ok()?;
        Some(Self::against(
            &truth,
            &said.solution,
            f64::from(said.age_ms) / 1e3,
        ))
    }

    /// The offset of a frame, at mid-exposure; `None` if the flight has no truth.
    fn by_sun(solution: &Solution, flown: &mut TelescopeFlight, start: Timestamp) -> Option<Self> {
        let middle = since(start, solution)? + EXPOSURE / 2;
        let truth = flown.truth(middle).ok()?;
        Some(Self::against(&truth, solution, 0.0))
    }

    fn against(truth: &TelescopeTruth, solution: &Solution, age_s: f64) -> Self {
        let across_deg = (solution.azimuth_deg - truth.offset.azimuth_deg)
            * truth.elevation_deg.to_radians().cos();
        let up_deg = solution.elevation_deg - truth.offset.elevation_deg;
        Self {
            age_s,
            error_arcsec: [across_deg * 3600.0, up_deg * 3600.0],
            sigma_arcsec: solution.error_deg * 3600.0,
        }
    }
}

/// Time from the start to the one that a solution states.
fn since(start: Timestamp, solution: &Solution) -> Option<Duration> {
    Duration::try_from(solution.time.duration_since(start)).ok()
}

/// Runs a demonstration; `show` is called with every answer. It ends early when `stopped` returns true. `ground` is the line to a ground
/// that receives a copy of what the controller receives; it is returned, so that the ground closes it first.
pub fn run(
    demo: &Demo,
    ground: &mut Option<AnyPort>,
    mut show: impl FnMut(&Progress),
    stopped: impl Fn() -> bool,
) -> anyhow::Result<Summary> {
    let instrument = instrument::builtin("demo")?;
    let start = launch_day()?;
    let config = configuration(demo);
    let settings = config.cameras.first().settings();
    let (cameras, truth, gondola) = cameras(demo, &instrument, &settings, start)?;
    let (near, line) = SerialPort::pair()?;
    let (gps_near, gps_far) = SerialPort::pair()?;
    let gps = Some(Box::new(gps_far) as Box<dyn BytePort + Send>);
    let sensors = Sensors::new(telescope(demo, &instrument, start)?, gps);
    let store = store(demo, &instrument)?;
    let arcsec_per_mil = instrument.optics.arcsec_per_mil();
    let flight = Flight {
        config,
        line: Connection::over(near),
        stores: vec![store],
        navigation: Some(navigation(Connection::over(gps_near), start)?),
        ..Flight::of(cameras)
    };
    let received = Arc::new(Mutex::new(None));
    let over = Arc::new(AtomicBool::new(false));
    let faults = demo.faults.clone().unwrap_or_default();
    let far = Relayed {
        line,
        ground: ground.take(),
        faults: faults.clone(),
    };
    let controller = control(far, sensors, &received, &over)?;
    let (service, frames) = Service::start_watched(flight)?;
    let mut errors = TruthErrors {
        truth,
        gondola,
        arcsec_per_mil,
        fine_errors_arcsec: Vec::new(),
        roll_errors_deg: Vec::new(),
        false_suns: 0,
    };
    let mut recent = demo.duration.is_none().then(|| Recent::of(&demo.archive));
    watch(&service, &frames, stopped, |frame| {
        recent.iter_mut().for_each(Recent::tidy);
        if let Found::Nadir(_) = frame.solved.found {
            return errors.check_horizon(&frame);
        }
        errors.check(&frame);
        let received = *received.lock().unwrap_or_else(PoisonError::into_inner);
        show(&Progress { frame, received });
    });
    over.store(true, Ordering::Relaxed);
    let controller = controller.join();
    let tally = service.join()?;
    let (controller, (far, _sensors)) =
        controller.map_err(|_| anyhow!("the controller's thread has failed"))??;
    *ground = far.ground;
    let mut telescope = telescope(demo, &instrument, start)?;
    // A ground may have set another target: then a difference from the Sun's centre is no error.
    let is_judged = ground.is_none();
    let propagated = controller.propagated.iter().filter(|_| is_judged);
    let propagated = propagated.filter_map(|one| JudgedOffset::of(one, &mut telescope, start));
    let propagated = propagated.collect();
    // A telescope whose roll is not measured yet is assumed to be level, and sent with a roll of 0.
    let rolled = |solution: &&Solution| is_judged && solution.roll_deg != 0.0;
    let by_sun = controller.solutions.iter().filter(rolled);
    let by_sun = by_sun.filter_map(|one| JudgedOffset::by_sun(one, &mut telescope, start));
    Ok(Summary {
        tally,
        propagated,
        by_sun: by_sun.collect(),
        controller,
        fine_errors_arcsec: errors.fine_errors_arcsec,
        roll_errors_deg: errors.roll_errors_deg,
        false_suns: errors.false_suns,
        fault_cost: faults.cost(),
        archive: demo.archive.clone(),
    })
}

/// The demonstration flies on the day of the HEROES flight.
fn launch_day() -> anyhow::Result<Timestamp> {
    let noon = civil::date(2013, 9, 21).at(18, 0, 0, 0);
    Ok(jiff::tz::Offset::UTC.to_timestamp(noon)?)
}

/// The controller's thread, which returns its ends of the lines with its report: the service must close the line first.
type ControllerThread = JoinHandle<Result<(Report, (Relayed, Controller)), PortError>>;

fn control(
    mut far: Relayed,
    sensors: Sensors,
    received: &Arc<Mutex<Option<Solution>>>,
    over: &Arc<AtomicBool>,
) -> io::Result<ControllerThread> {
    let (received, over) = (Arc::clone(received), Arc::clone(over));
    let run = move || {
        let on_message = |message: &Message| {
            if let Message::Solution(solution) = message {
                *received.lock().unwrap_or_else(PoisonError::into_inner) = Some(*solution);
            }
        };
        let mut controller = Controller::new().with_sensors(sensors);
        let over = || over.load(Ordering::Relaxed);
        let report = controller.run(&mut far, over, on_message).cloned();
        report.map(|report| (report, (far, controller)))
    };
    thread::Builder::new().name("controller".into()).spawn(run)
}

/// The archive, on a disk with faults for training.
fn store(demo: &Demo, instrument: &Instrument) -> Result<Store, ArchiveError> {
    let disk: Arc<dyn Disk> = match &demo.faults {
        Some(faults) => Arc::new(faults.disk()),
        None => Arc::new(LocalDisk),
    };
    Store::open_on(disk, &demo.archive, &instrument.name, Compression::Rice)
}

fn configuration(demo: &Demo) -> Config {
    let mut config = Config::default();
    config.cameras.first_mut().rate_hz = demo.rate_hz;
    config.navigation.send = Switch::On;
    config
}

/// The camera of the plate with its truth, and the roll camera with its swinging gondola.
fn cameras(
    demo: &Demo,
    instrument: &Instrument,
    settings: &CameraSettings,
    start: Timestamp,
) -> anyhow::Result<(Vec<FlightCamera>, TruthLog, SwingingGondola)> {
    let simulated = |view, settings: &CameraSettings| {
        SimulatedCamera::new(view, settings, start, demo.duration)
    };
    let course = trajectory(demo, instrument, start)?;
    let radius_mil = radius_mil(instrument, start)?;
    let scenes = FlightScenes::new(instrument, course, radius_mil, demo.seed)?;
    let sun = simulated(View::Plate(Box::new(scenes)), settings);
    let truth = sun.truth();
    let plate = Camera {
        toml: builtin_text("demo").map(str::to_owned),
        ..Camera::of_plate(instrument.clone())
    };
    let mounted = MountedCamera::parse(Path::new("demo-horizon"), DEMO_HORIZON)?;
    let gondola = SwingingGondola::new(&mounted, &FORT_SUMNER, demo.seed);
    let horizon = simulated(
        View::Horizon(Box::new(gondola.clone())),
        &CameraSettings::default(),
    );
    let roll = Camera {
        toml: Some(DEMO_HORIZON.into()),
        ..Camera::new("roll_camera", Role::Roll, Sees::Horizon(mounted))
    };
    let sun = match &demo.faults {
        Some(faults) => FlightCamera::new(plate, faults.on_camera(sun)),
        None => FlightCamera::new(plate, sun),
    };
    let cameras = vec![sun, FlightCamera::new(roll, horizon)];
    Ok((cameras, truth, gondola))
}

fn trajectory(
    demo: &Demo,
    instrument: &Instrument,
    start: Timestamp,
) -> anyhow::Result<Trajectory> {
    let radius_mil = radius_mil(instrument, start)?;
    Ok(match demo.duration {
        Some(duration) => Trajectory::demo(instrument, radius_mil, duration, demo.seed)?,
        None => Trajectory::flight(instrument, radius_mil, demo.seed)?,
    })
}

fn radius_mil(instrument: &Instrument, start: Timestamp) -> anyhow::Result<f64> {
    Ok(instrument
        .optics
        .radius_mil(sky::sun_angular_radius(start)?))
}

/// The telescope that carries the camera, with its IMU and GPS receiver.
fn telescope(
    demo: &Demo,
    instrument: &Instrument,
    start: Timestamp,
) -> anyhow::Result<TelescopeFlight> {
    let course = trajectory(demo, instrument, start)?;
    let (place, seed) = (FORT_SUMNER, demo.seed);
    let flight = TelescopeFlight::new(course, instrument, place, start, seed);
    Ok(flight.on(Gondola::Swinging))
}

fn navigation(gps: Connection, start: Timestamp) -> anyhow::Result<Navigation> {
    let path = Path::new("demo-nav");
    Ok(Navigation {
        settings: navigation::NavigationSettings::parse(path, DEMO_NAVIGATION)?
            .for_flight(path, &Role::table_names())?,
        settings_toml: DEMO_NAVIGATION.into(),
        imu: None,
        gps: Some(gps),
        clock: FlightClock::starting(start),
    })
}

fn watch(
    service: &Service,
    frames: &Receiver<SolvedFrame>,
    stopped: impl Fn() -> bool,
    mut take: impl FnMut(SolvedFrame),
) {
    loop {
        match frames.recv_timeout(Duration::from_millis(100)) {
            Ok(frame) => take(frame),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        if stopped() || service.controls().quit_requested() {
            service.stop();
        }
    }
}

/// Compares solved frames with the simulator's truth.
struct TruthErrors {
    truth: TruthLog,
    gondola: SwingingGondola,
    arcsec_per_mil: f64,
    fine_errors_arcsec: Vec<f64>,
    roll_errors_deg: Vec<f64>,
    false_suns: u64,
}

impl TruthErrors {
    fn check_horizon(&mut self, frame: &SolvedFrame) {
        let since_start = frame.exposure.frame.info.monotonic;
        if let Some((roll, since_start)) = frame.solved.roll.zip(since_start) {
            let error_deg = roll.deg.value - self.gondola.roll_deg(since_start);
            self.roll_errors_deg.push(error_deg.abs());
        }
    }

    fn check(&mut self, frame: &SolvedFrame) {
        let number = frame.exposure.frame.info.number;
        let Some(aspect) = frame.sun().and_then(|sun| sun.solution.aspect.as_ref()) else {
            return;
        };
        match number.and_then(|number| self.truth.of(number)) {
            Some(Some(sun)) if frame.solved.quality == Quality::Fine => {
                let error_mil = aspect.sun_plate.position.distance(sun.plate);
                self.fine_errors_arcsec
                    .push(error_mil * self.arcsec_per_mil);
            }
            Some(None) => self.false_suns += 1,
            _ => {}
        }
    }
}

impl Summary {
    /// Number of lost and damaged items; 0 if all went well.
    pub fn lost(&self) -> u64 {
        let sent = self.tally.counts.solutions;
        let arrived = self.controller.solutions.len() as u64;
        let unstored =
            self.tally.counts.taken - self.tally.counts.stored.min(self.tally.counts.taken);
        self.tally.lost().max(unstored)
            + sent.abs_diff(arrived)
            + self.controller.faults.total()
            + self.false_suns
            + self.fault_cost.frames_withheld
            + u64::from(self.fault_cost.bytes_cut > 0)
            + u64::from(sent == 0)
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "{}", self.tally)?;
        writeln!(out, "archive    {}", self.archive.display())?;
        if self.fault_cost != FaultCost::default() {
            writeln!(out, "{}", self.fault_cost)?;
        }
        writeln!(
            out,
            "received   {} solutions, {} errors by the controller; {} faults",
            self.controller.solutions.len(),
            self.controller.errors,
            self.controller.faults.total(),
        )?;
        let oldest_s = self.propagated.iter().map(|one| one.age_s);
        let oldest_s = oldest_s.fold(0.0, f64::max);
        let offsets = |of: &[JudgedOffset]| of.iter().flat_map(|one| one.error_arcsec).collect();
        let rows: [(String, Vec<f64>); 3] = [
            (
                "aspect     error of fine frames".into(),
                self.fine_errors_arcsec.clone(),
            ),
            (
                "offsets    error of those by the Sun".into(),
                offsets(&self.by_sun),
            ),
            (
                format!("gyros      error of offsets up to {oldest_s:.1} s after a frame"),
                offsets(&self.propagated),
            ),
        ];
        for (what, mut errors) in rows {
            errors.iter_mut().for_each(|error| *error = error.abs());
            let mut arcsec = |fraction| quantile(&mut errors, fraction);
            if let (Some(median), Some(most), Some(max)) = (arcsec(0.5), arcsec(0.95), arcsec(1.0))
            {
                writeln!(
                    out,
                    "{what}: median {median:.3}, 95 % {most:.3}, max {max:.3} arcsec"
                )?;
            }
        }
        let mut errors = self.roll_errors_deg.clone();
        let mut deg = |fraction| quantile(&mut errors, fraction);
        if let (Some(median), Some(most), Some(max)) = (deg(0.5), deg(0.95), deg(1.0)) {
            writeln!(
                out,
                "roll       error by the horizon: median {median:.4}, 95 % {most:.4}, max {max:.4} deg"
            )?;
        }
        match self.lost() {
            0 => write!(out, "nothing was lost"),
            lost => write!(out, "LOST or damaged: {lost}"),
        }
    }
}
