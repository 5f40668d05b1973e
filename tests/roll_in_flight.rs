//! The roll camera's horizon provides the gondola's roll to the solutions of the Sun, and does not affect them if it is
//! lost.

use crate::common::flight::frames_in;
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, unbounded};
use jiff::Timestamp;
use nalgebra::{Matrix3, Rotation3};
use solaspect::archive::Store;
use solaspect::aspect::Quality;
use solaspect::camera::{Camera, CameraError, CameraSettings, Exposure, FrameSource, Take};
use solaspect::config::Switch;
use solaspect::fits::{Compression, FitsFile, Value};
use solaspect::frame::{Frame, Pixels, Region};
use solaspect::instrument::{DirectionCamera, MountedCamera, Role, Sees, builtin};
use solaspect::pointing::{Offset, Roll};
use solaspect::reasons::horizon as reasons;
use solaspect::service::{Flight, FlightCamera, FlightTally, Service, SolvedFrame};
use solaspect::simulate::earth::{Aim, EarthConditions, EarthScene, SwingingGondola};
use solaspect::simulate::{Conditions, FORT_SUMNER, RandomScenes};
use solaspect::units::{Measured, Place};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// A camera that returns its next frame on demand and records the exposures set, us.
struct Stepped {
    frames: VecDeque<Frame>,
    go: Receiver<()>,
    set_us: Arc<Mutex<Vec<u32>>>,
}

impl FrameSource for Stepped {
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        match self.go.recv_timeout(Duration::from_millis(20)) {
            Err(RecvTimeoutError::Timeout) => return Ok(Take::NotYet),
            Err(RecvTimeoutError::Disconnected) => return Ok(Take::End),
            Ok(()) => {}
        }
        let announced = Timestamp::now();
        starts(announced);
        Ok(match self.frames.pop_front() {
            Some(frame) => Take::Exposure(Box::new(Exposure { frame, announced })),
            None => Take::End,
        })
    }

    fn apply(&mut self, settings: &CameraSettings) -> Result<(), CameraError> {
        self.set_us.lock().unwrap().push(settings.exposure_us);
        Ok(())
    }

    fn frames_wait(&self) -> bool {
        true
    }
}

/// A scene of a rolling gondola over a limb that varies by 2 % in brightness and 100 m in height.
fn gondola(number: u64) -> EarthScene {
    let conditions = EarthConditions {
        aim: Aim::Horizon { most_roll_deg: 3.0 },
        ..EarthConditions::clear(38_405.0).varying(0.02, 100.0)
    };
    conditions.scene(7, number)
}

/// A roll camera that points along the gondola's first axis.
fn roll_camera() -> MountedCamera {
    let conditions = gondola(0).conditions;
    let forward = Matrix3::new(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0);
    MountedCamera {
        optics: DirectionCamera {
            width_px: conditions.width_px,
            height_px: conditions.height_px,
            lens: conditions.camera,
            body_from_camera: None,
            mask: Vec::new(),
        },
        body_from_camera: Rotation3::from_matrix_unchecked(forward),
    }
}

/// Frames with the Sun on the plate, all at the same time.
fn suns(count: usize) -> VecDeque<Frame> {
    let demo = builtin("demo").unwrap();
    let scenes = RandomScenes::new(&demo, &Conditions::of(&demo), 5).unwrap();
    let frame = |number| {
        let mut frame = scenes.scene(number).unwrap().frame().unwrap();
        frame.info.mid_exposure = Some("2013-09-21T18:00:00Z".parse().unwrap());
        frame
    };
    (0..count as u64).map(frame).collect()
}

/// A saturated picture of the same size.
fn white(like: &Frame) -> Frame {
    let pixels = Pixels::U8(vec![255; like.width() * like.height()]);
    Frame::new(like.width(), like.height(), pixels, 255, like.info.clone()).unwrap()
}

/// A flight with a plate camera and a roll camera that take frames on demand.
struct Stepwise {
    service: Service,
    solved: Receiver<SolvedFrame>,
    take: [Sender<()>; 2],
    set_us: Arc<Mutex<Vec<u32>>>,
}

impl Stepwise {
    fn start(horizons: VecDeque<Frame>, max_age_s: f64, archive: Option<&Path>) -> Self {
        let set_us = Arc::<Mutex<Vec<u32>>>::default();
        let (to_sun, sun) = unbounded();
        let (to_roll, roll) = unbounded();
        let source = |frames, go, set_us: &Arc<Mutex<Vec<u32>>>| Stepped {
            frames,
            go,
            set_us: Arc::clone(set_us),
        };
        let demo = builtin("demo").unwrap();
        let camera = Camera {
            folder: PathBuf::from("sun"),
            ..Camera::of_plate(demo)
        };
        let sees = Sees::Horizon(roll_camera());
        let of_horizon = Camera::new("roll_camera", Role::Roll, sees);
        let mut flight = Flight::of(vec![
            FlightCamera::new(camera, source(suns(4), sun, &Arc::default())),
            FlightCamera::new(of_horizon, source(horizons, roll, &set_us)),
        ]);
        let open = |root| Store::open(root, "demo", Compression::Rice).unwrap();
        flight.stores = archive.map(open).into_iter().collect();
        flight.config.roll.max_age_s = max_age_s;
        let roll = flight.config.cameras.named_mut("roll_camera").unwrap();
        roll.auto_exposure = Switch::On;
        let (service, solved) = Service::start_watched(flight).unwrap();
        Self {
            service,
            solved,
            take: [to_sun, to_roll],
            set_us,
        }
    }

    fn next(&self, camera: usize) -> SolvedFrame {
        self.take[camera].send(()).unwrap();
        let frame = self.solved.recv_timeout(Duration::from_secs(60)).unwrap();
        assert_eq!(frame.station.index, camera);
        frame
    }

    fn sun(&self) -> SolvedFrame {
        self.next(0)
    }

    fn horizon(&self) -> SolvedFrame {
        self.next(1)
    }

    fn end(self) -> FlightTally {
        drop(self.take);
        self.service.join().unwrap()
    }
}

fn roll(frame: &SolvedFrame) -> Option<Measured> {
    frame.solved.roll.map(|roll| roll.deg)
}

fn offset(frame: &SolvedFrame) -> Offset {
    frame.sun().unwrap().offset.unwrap()
}

fn number(path: &Path, keyword: &str) -> Option<f64> {
    match FitsFile::open(path)
        .unwrap()
        .keywords()
        .unwrap()
        .get(keyword)
    {
        Some(Value::Float(value)) => Some(*value),
        _ => None,
    }
}

/// Frames of the horizon this far apart determine no roll rate: until the next frame the body's roll keeps the last value.
const NO_RATE: Duration = Duration::from_secs(2);

#[test]
fn the_horizons_roll_turns_offsets_and_is_in_answers_and_files() {
    let root = tempfile::tempdir().unwrap();
    let scenes = [0, 1, 2].map(gondola);
    let frames = scenes.iter().map(|scene| scene.frame().unwrap()).collect();
    let flight = Stepwise::start(frames, 3600.0, Some(root.path()));
    let before = flight.sun();
    assert_eq!(roll(&before), None);
    assert_eq!(offset(&before).roll, Roll::Stated);
    let (mut horizon_rolls, mut sun_rolls) = (Vec::new(), Vec::new());
    for scene in &scenes {
        std::thread::sleep(NO_RATE);
        let seen = flight.horizon();
        let seen_roll = roll(&seen).unwrap();
        let off_deg = seen_roll.value - scene.roll_deg;
        assert!(off_deg.abs() < 0.04, "{seen_roll:?} for {}", scene.roll_deg);
        assert!(off_deg.abs() < 5.0 * seen_roll.sigma, "{seen_roll:?}");
        let sun = flight.sun();
        let sun_roll = roll(&sun).unwrap();
        let turned_deg = sun_roll.value - seen_roll.value;
        assert!(turned_deg.abs() < 0.001, "{turned_deg}");
        // The telescope has a higher elevation than the horizon camera, so its roll about the boresight is larger.
        let Roll::Measured(about_boresight) = offset(&sun).roll else {
            panic!("{:?}", offset(&sun));
        };
        assert!(about_boresight.value / seen_roll.value > 1.2);
        horizon_rolls.push(seen_roll.value);
        sun_rolls.push(sun_roll.value);
    }
    let tally = flight.end();
    assert_eq!(tally.solver(Role::Roll).of(Quality::Fine), 3, "{tally}");
    assert_eq!((tally.solved(), tally.lost()), (4, 0), "{tally}");
    for (folder, missing, expected) in [("sun", 1, &sun_rolls), ("roll", 0, &horizon_rolls)] {
        let files = frames_in(&root.path().join(folder));
        let rolls: Vec<f64> = files
            .iter()
            .filter_map(|file| number(file, "BODYROLL"))
            .collect();
        assert_eq!(files.len() - rolls.len(), missing, "{folder}");
        assert_eq!(&rolls, expected, "{folder}");
    }
    let log = std::fs::read_dir(root.path().join("sun")).unwrap();
    let mut logs = log.map(|entry| entry.unwrap().path());
    let log = logs
        .find(|path| path.extension().is_some_and(|e| e == "csv"))
        .unwrap();
    let mut log = csv::Reader::from_path(log).unwrap();
    let columns = log.headers().unwrap().clone();
    let column = columns.iter().position(|name| name == "roll_deg").unwrap();
    let rows = log.records().map(|row| row.unwrap()[column].to_owned());
    let rolls: Vec<f64> = rows.filter_map(|text| text.parse().ok()).collect();
    assert_eq!(rolls, sun_rolls);
}

#[test]
fn a_horizon_that_is_overexposed_or_old_costs_the_sun_nothing() {
    let horizon = gondola(3).frame().unwrap();
    let frames = VecDeque::from([horizon.clone(), white(&horizon)]);
    let flight = Stepwise::start(frames, 0.01, None);
    assert!(roll(&flight.horizon()).is_some());
    std::thread::sleep(Duration::from_millis(50));
    let sun = flight.sun();
    assert_eq!(roll(&sun), None, "older than roll.max_age_s");
    assert_eq!(offset(&sun).roll, Roll::Stated);
    assert_eq!(roll(&flight.horizon()), None);
    assert!(flight.sun().sun().unwrap().offset.is_some());
    // The exposure is adjusted to the limb's brightness and is reduced at once when the frame is too bright.
    let falls = |set_us: &[u32]| set_us.last().is_some_and(|us| *us < 15_000);
    let start = Instant::now();
    while !falls(&flight.set_us.lock().unwrap()) {
        assert!(start.elapsed() < Duration::from_secs(60), "it never falls");
        std::thread::sleep(Duration::from_millis(5));
    }
    let tally = flight.end();
    assert_eq!(
        tally.solver(Role::Roll).because(reasons::TOO_BRIGHT),
        1,
        "{tally}"
    );
    assert!(
        tally
            .to_string()
            .contains("1 x light: the frame is bright all over"),
        "{tally}"
    );
    assert_eq!(tally.lost(), 0, "{tally}");
}

#[test]
fn a_frame_of_another_size_or_from_below_the_limb_is_stored_with_the_reason() {
    let root = tempfile::tempdir().unwrap();
    let horizon = gondola(4).frame().unwrap();
    let mut low = horizon.clone();
    low.info.place = Some(Place {
        height_m: 1_200.0,
        ..FORT_SUMNER
    });
    let part = horizon.cropped(Region::sized(640, 300, 640, 780)).unwrap();
    let frames = VecDeque::from([low, part, horizon]);
    let flight = Stepwise::start(frames, 3600.0, Some(root.path()));
    let reason = |frame: &SolvedFrame| {
        let stopped = frame.solved.stopped;
        stopped.map(|stopped| stopped.rejected.reason.code)
    };
    for expected in [Some("not_above_the_limb"), Some("wrong_size"), None] {
        let frame = flight.horizon();
        assert_eq!(reason(&frame), expected);
        // Each of them has levels, so the exposure is adjusted by all.
        assert!(frame.solved.levels.is_some());
    }
    let tally = flight.end();
    assert_eq!((tally.counts.stored, tally.lost()), (3, 0), "{tally}");
}

/// A small camera that points along the gondola's first axis.
const SMALL_CAMERA: &str = "[camera]
width_px = 480
height_px = 270
centre_px = [239.5, 134.5]
focal_px = [222.2, 222.2]
body_from_camera = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
";

fn solaspect(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_solaspect"));
    command
        .args(arguments)
        .env_remove("RUST_LOG")
        .output()
        .unwrap()
}

#[test]
fn a_flight_of_two_simulated_cameras_measures_the_gondolas_roll() {
    let root = tempfile::tempdir().unwrap();
    let at = |name: &str| root.path().join(name).display().to_string();
    std::fs::write(at("roll.toml"), SMALL_CAMERA).unwrap();
    let config = format!(
        "[site]\nlatitude_deg = {}\nlongitude_deg = {}\nheight_m = {}\n\
         [camera]\nsource = \"simulated\"\n\
         [roll_camera]\nsource = \"simulated\"\ninstrument = {:?}\n\
         [archive]\ndirectory = {:?}\n",
        FORT_SUMNER.latitude_deg,
        FORT_SUMNER.longitude_deg,
        FORT_SUMNER.height_m,
        at("roll.toml"),
        at("archive"),
    );
    std::fs::write(at("flight.toml"), config).unwrap();
    std::fs::create_dir(at("archive")).unwrap();
    let preflight = solaspect(&["preflight", "--config", &at("flight.toml")]);
    let page = String::from_utf8(preflight.stdout).unwrap();
    assert!(page.contains("roll_camera solves"), "{page}");
    assert!(page.contains("fine: roll "), "{page}");
    let flown = solaspect(&["fly", "--config", &at("flight.toml"), "--duration", "3s"]);
    let said = String::from_utf8(flown.stdout).unwrap();
    assert!(flown.status.success(), "{said}");
    assert!(
        said.contains("roll       12 fine, 0 coarse, 0 none"),
        "{said}"
    );
    let camera = MountedCamera::parse(Path::new("roll.toml"), SMALL_CAMERA).unwrap();
    let gondola = SwingingGondola::new(&camera, &FORT_SUMNER, 1);
    let files = frames_in(&root.path().join("archive").join("roll"));
    assert_eq!(files.len(), 12);
    let mut squares = 0.0;
    for file in &files {
        let of = |keyword| number(file, keyword).unwrap();
        let truth_deg = gondola.roll_deg(Duration::from_secs_f64(of("MONOTIME")));
        squares += ((of("BODYROLL") - truth_deg) / of("BODYRLSG")).powi(2);
    }
    let ratio = (squares / files.len() as f64).sqrt();
    // A small picture has few edge points that show how the limb departs from a sphere, so its sigma is conservative.
    assert!((0.2..1.7).contains(&ratio), "{ratio}");
    // The archive has a copy of the roll camera's file.
    let kept = std::fs::read_dir(root.path().join("archive").join("roll")).unwrap();
    let kept = kept.map(|entry| entry.unwrap().path());
    let instrument = kept.filter(|path| path.extension().is_some_and(|e| e == "toml"));
    let texts: Vec<String> = instrument
        .map(|path| std::fs::read_to_string(path).unwrap())
        .collect();
    assert!(texts.iter().any(|text| text == SMALL_CAMERA));
    // A refinement without the roll camera's file ignores its frames.
    let refined = solaspect(&["refine", &at("archive"), "--out", &at("refined")]);
    assert!(
        refined.status.success(),
        "{}",
        String::from_utf8_lossy(&refined.stderr)
    );
}
