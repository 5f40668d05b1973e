//! The Moon camera in flight: its frames are solved and stored, and requests over the line are answered with the results.

use crate::common::flight::frames_in;
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, unbounded};
use jiff::Timestamp;
use solaspect::archive::Store;
use solaspect::aspect::Quality;
use solaspect::camera::{Camera, CameraError, Exposure, FrameSource, Take};
use solaspect::fits::{Compression, FitsFile, Value};
use solaspect::frame::Frame;
use solaspect::instrument::{DirectionCamera, Role, Sees, builtin};
use solaspect::link::ground::{Answered, ask_for_moon};
use solaspect::link::moon::{BELOW_HORIZON, FIRST_STAGE, NO_PICTURE};
use solaspect::link::{Connection, MoonOutcome, MoonRequest, SerialPort};
use solaspect::moon::Stage;
use solaspect::service::{Flight, FlightCamera, Found, Service, SolvedFrame};
use solaspect::simulate::FORT_SUMNER;
use solaspect::simulate::moon::{FollowedMoon, MoonConditions, MoonScene};
use std::path::Path;
use std::time::{Duration, Instant};

/// Timeout of waits, far longer than any step takes.
const LONG: Duration = Duration::from_secs(60);
const CAMERA: &str = "[camera]\nwidth_px = 720\nheight_px = 578\ncentre_px = [359.5, 288.5]\nfocal_px = [3300, 3300]\n";
/// Times with a waning Moon high above Fort Sumner, and with the Moon below the horizon there.
const UP: &str = "2013-09-22T10:00:00Z";
const DOWN: &str = "2013-09-22T22:00:00Z";

/// A camera that returns the frames sent to it.
struct Handed(Receiver<Frame>);

impl FrameSource for Handed {
    fn next(&mut self, _: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        let announced = Timestamp::now();
        match self.0.recv_timeout(Duration::from_millis(20)) {
            Ok(frame) => Ok(Take::Exposure(Box::new(Exposure { frame, announced }))),
            Err(RecvTimeoutError::Timeout) => Ok(Take::NotYet),
            Err(RecvTimeoutError::Disconnected) => Ok(Take::End),
        }
    }

    fn frames_wait(&self) -> bool {
        true
    }
}

fn camera() -> DirectionCamera {
    DirectionCamera::parse("moon.toml".as_ref(), CAMERA).unwrap()
}

fn scene(utc: &str) -> MoonScene {
    let mut moon = FollowedMoon::new(&camera(), FORT_SUMNER, 3);
    moon.scene(0, utc.parse().unwrap(), 1.0).unwrap()
}

/// A frame of a scene with this time and without a place.
fn frame(scene: &MoonScene, utc: &str) -> Frame {
    let mut frame = scene.frame().unwrap();
    frame.info.mid_exposure = Some(utc.parse().unwrap());
    frame.info.exposure = Some(Duration::ZERO);
    frame.info.place = None;
    frame
}

/// A flight with a Moon camera that takes the frames sent to it, and the controller's end of its line.
struct Night {
    service: Service,
    solved: Receiver<SolvedFrame>,
    to_camera: Sender<Frame>,
    /// Keeps the plate camera open, which takes no frame; dropped to end it.
    _to_sun: Sender<Frame>,
    far: SerialPort,
    sequence: u16,
}

impl Night {
    fn start(archive: Option<&Path>, answer_within_s: f64) -> Self {
        let (to_sun, sun) = unbounded();
        let (to_camera, moon) = unbounded();
        let (near, far) = SerialPort::pair().unwrap();
        let demo = builtin("demo").unwrap();
        let of_sun = Camera {
            folder: "sun".into(),
            ..Camera::of_plate(demo)
        };
        let of_moon = Camera::new("moon_camera", Role::Moon, Sees::Moon(camera()));
        let mut flight = Flight::of(vec![
            FlightCamera::new(of_sun, Handed(sun)),
            FlightCamera::new(of_moon, Handed(moon)),
        ]);
        let open = |root| Store::open(root, "demo", Compression::Rice).unwrap();
        flight.stores = archive.map(open).into_iter().collect();
        flight.line = Connection::over(near);
        flight.config.moon.answer_within_s = answer_within_s;
        // Every frame is solved with the same place, whether it comes before or after the request.
        flight.config.site = FORT_SUMNER.into();
        let (service, solved) = Service::start_watched(flight).unwrap();
        Self {
            service,
            solved,
            to_camera,
            _to_sun: to_sun,
            far,
            sequence: 0,
        }
    }

    /// Requests the Moon while the camera repeats `frames` until the answer arrives.
    fn ask_while(&mut self, latitude_deg: f64, frames: &[Frame]) -> Result<MoonOutcome, Answered> {
        let request = MoonRequest {
            latitude_deg,
            longitude_deg: FORT_SUMNER.longitude_deg,
            height_m: FORT_SUMNER.height_m,
        };
        self.sequence += 1;
        let (sequence, far) = (self.sequence, &mut self.far);
        let to_camera = &self.to_camera;
        std::thread::scope(|scope| {
            let (done, is_done) = unbounded::<()>();
            scope.spawn(move || {
                for frame in frames.iter().cycle() {
                    to_camera.send(frame.clone()).unwrap();
                    let pause = Duration::from_millis(100);
                    if is_done.recv_timeout(pause) == Err(RecvTimeoutError::Disconnected) {
                        return;
                    }
                }
            });
            let answer = ask_for_moon(far, request, sequence, LONG).unwrap();
            drop(done);
            answer.map(|answer| answer.outcome)
        })
    }

    fn ask(&mut self, frames: &[Frame]) -> MoonOutcome {
        self.ask_while(FORT_SUMNER.latitude_deg, frames).unwrap()
    }
}

fn number(path: &Path, keyword: &str) -> Option<f64> {
    let file = FitsFile::open(path).unwrap();
    match file.keywords().unwrap().get(keyword) {
        Some(Value::Float(value)) => Some(*value),
        _ => None,
    }
}

#[test]
fn a_request_for_the_moon_is_answered_by_the_next_picture() {
    let mut night = Night::start(None, 60.0);
    let up = scene(UP);
    let outcome = night.ask(&[frame(&up, UP)]);
    let MoonOutcome::Found(fix) = outcome else {
        panic!("{outcome:?}");
    };
    let off = [fix.x_px - up.centre.x, fix.y_px - up.centre.y];
    assert!(off.iter().all(|off| off.abs() < 0.3), "{off:?}");
    let [xx, xy, yy] = fix.covariance_px2;
    assert!(xx > 0.0 && xx * yy > xy * xy, "{fix:?}");
    let ray = camera().lens.ray(up.centre).unwrap();
    let towards = nalgebra::Vector3::from(fix.direction);
    assert!(ray.angle(&towards) < 1e-4);
    assert_eq!(fix.time, UP.parse().unwrap());
    let outcome = night.ask(&[frame(&scene(DOWN), DOWN)]);
    let code = BELOW_HORIZON;
    assert_eq!(outcome, MoonOutcome::NotVisible { code });
    let stars = MoonScene {
        conditions: MoonConditions {
            peak_dn: 0.0,
            ..up.conditions.clone()
        },
        ..up.clone()
    };
    let outcome = night.ask(&[frame(&stars, UP)]);
    let code = FIRST_STAGE + 1;
    assert_eq!(outcome, MoonOutcome::NotFound { code });
    // Near the South Pole the Moon does not rise at that time.
    let outcome = night.ask_while(-89.0, &[frame(&up, UP)]);
    let code = BELOW_HORIZON;
    assert_eq!(outcome, Ok(MoonOutcome::NotVisible { code }));
    let refused = night.ask_while(91.0, &[]);
    assert_eq!(refused.unwrap_err().value, 2);
    let Night {
        service, to_camera, ..
    } = night;
    drop(to_camera);
    service.stop();
    let tally = service.join().unwrap();
    assert_eq!(tally.line.moon_requests, 4);
    let moon = tally.solver(Role::Moon);
    let hidden = moon.stopped_at(Stage::Sky);
    assert!(hidden >= 1 && moon.of(Quality::None) > hidden, "{tally}");
    assert_eq!(tally.lost(), 0, "{tally}");
}

#[test]
fn a_request_without_a_picture_is_answered_in_time() {
    let mut night = Night::start(None, 0.1);
    let start = Instant::now();
    let outcome = night.ask(&[]);
    let code = NO_PICTURE;
    assert_eq!(outcome, MoonOutcome::NotFound { code });
    assert!(start.elapsed() >= Duration::from_millis(100));
    night.service.stop();
}

#[test]
fn what_the_moon_camera_saw_is_in_files_log_telemetry_and_housekeeping() {
    let root = tempfile::tempdir().unwrap();
    let mut night = Night::start(Some(root.path()), 60.0);
    let up = scene(UP);
    night.ask(&[frame(&up, UP)]);
    let solved = night.solved.try_iter().last().unwrap();
    let Found::Moon(found) = &solved.solved.found else {
        panic!("{solved:?}");
    };
    let centre = found.found.as_ref().unwrap().centre.position;
    let end = Instant::now() + LONG;
    let housekeeping = loop {
        let housekeeping = night.service.housekeeping();
        if let Some(housekeeping) =
            housekeeping.filter(|housekeeping| housekeeping.moon_x_px.is_some())
        {
            break housekeeping;
        }
        assert!(Instant::now() < end);
        std::thread::sleep(Duration::from_millis(50));
    };
    assert_eq!(housekeeping.night, Some(1));
    assert_eq!(housekeeping.moon_x_px, Some(centre.x as f32));
    assert!(housekeeping.moon_found >= 1);
    let Night {
        service, to_camera, ..
    } = night;
    drop(to_camera);
    service.stop();
    service.join().unwrap();
    let folder = root.path().join("moon");
    let files = frames_in(&folder);
    assert!(!files.is_empty());
    for file in &files {
        assert_eq!(number(file, "MOONPX-X"), Some(centre.x));
        assert_eq!(number(file, "MOONPX-Y"), Some(centre.y));
        assert!(number(file, "MOONDIRZ").unwrap() > 0.99);
        let phase_deg = number(file, "MOONPHAS").unwrap();
        assert!((phase_deg - up.phase_angle_deg).abs() < 1.0, "{phase_deg}");
        assert_eq!(number(file, "SUNPX-X"), None);
    }
    let entries = std::fs::read_dir(&folder).unwrap();
    let paths: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    let named = |start: &str| {
        let is_named = |path: &&std::path::PathBuf| {
            path.file_name()
                .unwrap()
                .to_string_lossy()
                .starts_with(start)
        };
        paths.iter().find(is_named).unwrap()
    };
    let mut log = csv::Reader::from_path(named("solutions_")).unwrap();
    let columns = log.headers().unwrap().clone();
    let column = columns.iter().position(|name| name == "moon_x_px").unwrap();
    let row = log.records().next().unwrap().unwrap();
    assert_eq!(row[column].parse::<f64>().unwrap(), centre.x);
    let samples = std::fs::read(named("telemetry_").join("MOON_X")).unwrap();
    assert_eq!(samples[..8], centre.x.to_le_bytes());
}
