//! A camera and a controller implemented by users fly with configuration, line and archive.

use crate::common::flight::frames_in;
use jiff::Timestamp;
use solaspect::camera::{CameraError, Exposure, FrameSource, Take};
use solaspect::frame::Frame;
use solaspect::instrument::builtin;
use solaspect::link::{Connection, Controller, InProcess, Message};
use solaspect::plan::{Options, Plan, Replay};
use solaspect::service::{Flight, FlightTally, Service};
use solaspect::simulate::{Scene, Sun};
use solaspect::sky;
use solaspect::units::PlateMil;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

const EXPOSURE: Duration = Duration::from_millis(15);

/// A camera that repeats a few pictures at its own rate.
struct OwnCamera {
    pictures: Vec<Frame>,
    period: Duration,
    frames: u64,
    number: u64,
    begin: Option<Instant>,
}

impl OwnCamera {
    fn new(rate_hz: f64, frames: u64) -> Result<Self, CameraError> {
        let demo = builtin("demo").map_err(CameraError::own)?;
        let mapping = demo.nominal_mapping().ok_or("no mapping");
        let mut scene = Scene::new(&demo, mapping.map_err(CameraError::own)?);
        let radius_arcsec = sky::sun_angular_radius(Timestamp::now())?;
        let radius_mil = demo.optics.radius_mil(radius_arcsec);
        let mut pictures = Vec::new();
        for seed in 0..8 {
            let x_mil = -300.0 + 10.0 * seed as f64;
            scene.sun = Some(Sun::new(PlateMil::new(x_mil, 200.0), radius_mil));
            scene.seed = seed;
            pictures.push(scene.frame()?);
        }
        Ok(Self {
            pictures,
            period: Duration::from_secs_f64(1.0 / rate_hz),
            frames,
            number: 0,
            begin: None,
        })
    }
}

impl FrameSource for OwnCamera {
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        if self.number == self.frames {
            return Ok(Take::End);
        }
        let due = self.period * self.number as u32;
        let begin = *self.begin.get_or_insert_with(Instant::now);
        thread::sleep(due.saturating_sub(begin.elapsed()));
        let announced = Timestamp::now();
        starts(announced);
        thread::sleep(EXPOSURE);
        let mut frame = self.pictures[self.number as usize % self.pictures.len()].clone();
        frame.info.number = Some(self.number);
        frame.info.mid_exposure = Some(announced + EXPOSURE / 2);
        frame.info.exposure = Some(EXPOSURE);
        self.number += 1;
        Ok(Take::Exposure(Box::new(Exposure { frame, announced })))
    }
}

#[derive(Clone, Default)]
struct Heard {
    solutions: Arc<AtomicU64>,
    announced: Arc<AtomicU64>,
    telemetry: Arc<AtomicU64>,
}

/// A controller that counts the messages it receives. It requests tracking from the start.
struct OwnController {
    to_say: Option<Message>,
    heard: Heard,
}

impl Controller for OwnController {
    fn hear(&mut self, message: &Message) {
        let count = match message {
            Message::Solution(_) => &self.heard.solutions,
            Message::ExposureStart(_) => &self.heard.announced,
            _ => return,
        };
        count.fetch_add(1, Ordering::Relaxed);
    }

    fn say(&mut self) -> Option<Message> {
        self.to_say.take()
    }

    fn hear_telemetry(&mut self, _: &solaspect::link::TelemetryPacket) {
        self.heard.telemetry.fetch_add(1, Ordering::Relaxed);
    }
}

fn planned(folder: &Path, source: &str) -> Plan {
    let file = folder.join("gondola.toml");
    let archive = folder.join("archive");
    let text = format!(
        "[site]\nlatitude_deg = 34.49\nlongitude_deg = -104.2218\nheight_m = 38405.0\n\
         [camera]\nsource = \"{source}\"\ninstrument = \"demo\"\nrate_hz = 26.0\n\
         [archive]\ndirectory = {archive:?}\n\
         [link]\nmax_solution_age_ms = 60000\n"
    );
    std::fs::write(&file, text).unwrap();
    let (plan, remarks) = Plan::survey(Some(&file), &Options::default());
    remarks.without_errors().unwrap();
    plan
}

/// A flight of this many frames, as a user's own program runs it.
fn flown(folder: &Path, rate_hz: f64, frames: u64) -> (FlightTally, Heard) {
    let plan = planned(folder, "own");
    let mut flight = Flight::of_plan(&plan, Replay::default()).unwrap();
    let open = move || OwnCamera::new(rate_hz, frames);
    flight.bring_camera("camera", open).unwrap();
    let heard = Heard::default();
    flight.line = Connection::over(InProcess::new(OwnController {
        to_say: Some(Message::StartTracking),
        heard: heard.clone(),
    }));
    flight.claim().unwrap();
    flight.open_cameras().unwrap();
    (Service::start(flight).unwrap().join().unwrap(), heard)
}

fn nothing_is_lost(rate_hz: f64, frames: u64) {
    let folder = tempfile::tempdir().unwrap();
    let (tally, heard) = flown(folder.path(), rate_hz, frames);
    println!("{tally}");
    assert_eq!(tally.lost(), 0, "{tally}");
    assert_eq!(tally.counts.taken, frames, "{tally}");
    assert_eq!(
        frames_in(&folder.path().join("archive")).len() as u64,
        frames
    );
    // Exposures are not announced to the controller before tracking starts.
    let solutions = heard.solutions.load(Ordering::Relaxed);
    assert!(solutions >= frames - 1, "{solutions} of {frames}\n{tally}");
    assert!(heard.announced.load(Ordering::Relaxed) >= solutions);
    assert!(heard.telemetry.load(Ordering::Relaxed) > 0, "{tally}");
}

#[test]
fn a_camera_and_a_controller_of_ones_own_fly_and_nothing_is_lost() {
    nothing_is_lost(4.0, 8);
}

#[test]
#[ignore = "ten minutes"]
fn a_camera_of_ones_own_flies_for_ten_minutes_at_26_frames_per_second_and_nothing_is_lost() {
    nothing_is_lost(26.0, 15_600);
}

#[test]
fn a_camera_is_brought_only_where_the_configuration_wants_one() {
    let folder = tempfile::tempdir().unwrap();
    let bring = |source, table: &str| {
        let plan = planned(folder.path(), source);
        let mut flight = Flight::of_plan(&plan, Replay::default()).unwrap();
        let brought = flight.bring_camera(table, || OwnCamera::new(1.0, 1));
        brought.map_err(|error| error.to_string())
    };
    assert_eq!(bring("own", "camera"), Ok(()));
    for (source, table) in [
        ("simulated", "camera"),
        ("own", "roll_camera"),
        ("own", "none"),
    ] {
        let error = bring(source, table).unwrap_err();
        assert!(
            error.starts_with(&format!("[{table}]: expected")),
            "{error}"
        );
    }
}

#[test]
fn a_flight_whose_own_camera_nobody_brings_says_so_before_it_begins() {
    let folder = tempfile::tempdir().unwrap();
    let plan = planned(folder.path(), "own");
    let mut flight = Flight::of_plan(&plan, Replay::default()).unwrap();
    let error = flight.open_cameras().unwrap_err();
    assert!(error.to_string().contains("this program brings none"));
}

#[test]
fn an_error_of_anothers_driver_keeps_its_own_words() {
    let cause = std::io::Error::other("the shutter is jammed");
    let error = CameraError::own(cause).to_string();
    assert_eq!(error, "the camera: the shutter is jammed");
}
