//! Flights with dark frames, frame by frame, and the resulting files on a disk.

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use jiff::{SignedDuration, Timestamp};
use solaspect::archive::Store;
use solaspect::camera::{CameraError, Exposure, FrameSource, Take};
use solaspect::config::{self, Config};
use solaspect::fits;
use solaspect::frame::{Frame, FrameInfo, Pixels};
use solaspect::instrument::{self, Instrument};
use solaspect::link::Connection;
use solaspect::pointing::Target;
use solaspect::service::{Flight, FlightCamera, FlightTally, Service};
use solaspect::sky::Ephemeris;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A camera that takes a dark frame for each number it receives.
struct DarkCamera {
    instrument: Instrument,
    numbers: Receiver<u64>,
}

impl FrameSource for DarkCamera {
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        let number = match self.numbers.recv_timeout(Duration::from_millis(100)) {
            Ok(number) => number,
            Err(RecvTimeoutError::Timeout) => return Ok(Take::NotYet),
            Err(RecvTimeoutError::Disconnected) => return Ok(Take::End),
        };
        let announced = Timestamp::now();
        starts(announced);
        let frame = dark_frame(&self.instrument, number);
        Ok(Take::Exposure(Box::new(Exposure { frame, announced })))
    }

    fn frames_wait(&self) -> bool {
        true
    }
}

/// A dark frame; its time is `number` quarters of a second after the start.
pub fn dark_frame(instrument: &Instrument, number: u64) -> Frame {
    let (width, height) = (instrument.camera.width_px, instrument.camera.height_px);
    let start: Timestamp = "2013-09-21T17:59:55.000Z".parse().unwrap();
    let info = FrameInfo {
        number: Some(number),
        mid_exposure: Some(start + SignedDuration::from_millis(250 * number as i64)),
        ..FrameInfo::default()
    };
    let pixels = Pixels::U8(vec![7; width * height]);
    Frame::new(width, height, pixels, 255, info).unwrap()
}

/// Flies `frames` dark frames with a `pause` before each. Calls `each` with the number of every frame before it is taken, when all
/// earlier ones have been solved and offered to the archive, and once more at the end.
pub fn dark(
    stores: Vec<Store>,
    archive: config::Archive,
    frames: u64,
    pause: Duration,
    each: impl FnMut(u64),
) -> FlightTally {
    let (service, gate) = gated(stores, archive, frames, pause, each);
    drop(gate);
    service.join().unwrap()
}

/// As [`dark`], but the flight is asked to stop after the last frame and abandons unfinished work at once.
pub fn dark_asked_to_end(
    stores: Vec<Store>,
    archive: config::Archive,
    frames: u64,
    pause: Duration,
    each: impl FnMut(u64),
) -> FlightTally {
    let (service, gate) = gated(stores, archive, frames, pause, each);
    service.stop_within(Duration::ZERO);
    drop(gate);
    service.join().unwrap()
}

/// A flight that has solved all its frames, and the sender that keeps its camera open.
fn gated(
    stores: Vec<Store>,
    archive: config::Archive,
    frames: u64,
    pause: Duration,
    mut each: impl FnMut(u64),
) -> (Service, Sender<u64>) {
    let instrument = instrument::builtin("demo").unwrap();
    let (gate, numbers) = bounded(0);
    let camera = DarkCamera {
        instrument: instrument.clone(),
        numbers,
    };
    let config = Config {
        archive,
        ..Config::default()
    };
    let flight = Flight {
        config,
        stores,
        ..Flight::of(vec![FlightCamera::of_plate(instrument, camera)])
    };
    let (service, answers) = Service::start_watched(flight).unwrap();
    let was_checked = |service: &Service| {
        let disks = service.disks();
        disks
            .iter()
            .all(|disk| disk.free_percent.is_some() || disk.failing)
    };
    while !was_checked(&service) {
        std::thread::yield_now();
    }
    for number in 0..frames {
        each(number);
        std::thread::sleep(pause);
        gate.send(number).unwrap();
        answers.recv().unwrap();
    }
    each(frames);
    (service, gate)
}

/// The files of frames under a folder, sorted by name.
pub fn frames_in(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "fits") {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// The numbers of the frames under a folder, in the order of their file names; reads each file and verifies its checksums.
pub fn numbers_in(folder: &Path) -> Vec<u64> {
    let number = |path: &PathBuf| {
        fits::check_sums(path).unwrap();
        fits::read_frame(path).unwrap().info.number.unwrap()
    };
    frames_in(folder).iter().map(number).collect()
}

/// Number of rows of the only solution log in a folder.
pub fn rows_in(root: &Path) -> usize {
    let entries = fs::read_dir(root)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let is_log = |path: &PathBuf| {
        let name = path.file_name().unwrap().to_string_lossy();
        name.starts_with("solutions_") && name.ends_with(".csv")
    };
    let logs: Vec<PathBuf> = entries.filter(is_log).collect();
    assert_eq!(logs.len(), 1, "{logs:?}");
    let mut log = csv::Reader::from_path(&logs[0]).unwrap();
    log.records().map(Result::unwrap).count()
}
