//! The demonstration: camera, solver, link and archive together, with nothing lost between them.

use solaspect::archive::role_of;
use solaspect::aspect::Quality;
use solaspect::demo::{self, Demo};
use solaspect::fits;
use solaspect::instrument::{Role, builtin};
use solaspect::link::{BytePort, PortError, SerialPort};
use solaspect::simulate::navigation::TelescopeFlight;
use solaspect::simulate::sensors::Sensors;
use solaspect::simulate::{FORT_SUMNER, Trajectory};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else if path.extension().is_some_and(|ending| ending == "fits") {
            found.push(path);
        }
    }
    found.sort();
    found
}

#[test]
fn the_demonstration_loses_nothing_between_camera_controller_and_archive() {
    let folder = tempfile::tempdir().unwrap();
    let settings = Demo::lasting(Duration::from_secs(5), folder.path(), 1);
    let mut shown = 0;
    let summary = demo::run(&settings, &mut None, |_| shown += 1, || false).unwrap();
    println!("{summary}");
    assert_eq!(summary.lost(), 0, "{summary}");
    assert_eq!(summary.tally.counts.taken, 40);
    assert_eq!(shown, 20);

    let solved = summary.tally.solver(Role::PitchYaw);
    assert!(solved.of(Quality::Fine) >= 10, "{summary}");
    assert!(solved.of(Quality::None) >= 1, "the Sun leaves: {summary}");
    let largest = summary
        .fine_errors_arcsec
        .iter()
        .copied()
        .fold(0.0, f64::max);
    assert!(largest < 2.0, "{summary}");
    let rolls_deg = &summary.roll_errors_deg;
    assert_eq!(rolls_deg.len(), 20, "{summary}");
    assert!(rolls_deg.iter().all(|deg| *deg < 0.04), "{summary}");
    assert!(summary.controller.tracking_on >= 1 && summary.controller.tracking_off >= 1);

    let (rolls, stored): (Vec<PathBuf>, Vec<PathBuf>) = files(folder.path())
        .into_iter()
        .partition(|file| role_of(file).is_some());
    assert_eq!((rolls.len(), stored.len()), (20, 20));
    for (number, path) in stored.iter().enumerate() {
        let frame = fits::read_frame(path).unwrap();
        assert_eq!(frame.info.number, Some(number as u64));
        assert!(frame.info.place.is_some());
        let keywords = fits::read_keywords(path).unwrap();
        assert!(keywords.get("QUALITY").is_some());
        fits::check_sums(path).unwrap();
    }
}

#[test]
fn a_demonstration_that_is_stopped_ends_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let settings = Demo::lasting(Duration::from_secs(600), folder.path(), 2);
    let shown = std::cell::Cell::new(0);
    let summary = demo::run(
        &settings,
        &mut None,
        |_| shown.set(shown.get() + 1),
        || shown.get() >= 3,
    );
    assert_eq!(summary.unwrap().lost(), 0);
}

/// A port that accepts all bytes.
struct Sink;

impl BytePort for Sink {
    fn read(&mut self, _buffer: &mut [u8], _timeout: Duration) -> Result<usize, PortError> {
        Ok(0)
    }

    fn write(&mut self, _bytes: &[u8], _timeout: Duration) -> Result<(), PortError> {
        Ok(())
    }
}

#[test]
fn a_flight_that_closes_the_gps_port_before_the_controllers_ends_without_an_error() {
    let instrument = builtin("demo").unwrap();
    let radius_mil = instrument.optics.radius_mil(955.0);
    let course = Trajectory::flight(&instrument, radius_mil, 1).unwrap();
    let start: jiff::Timestamp = "2013-09-21T18:00:00Z".parse().unwrap();
    let flight = TelescopeFlight::new(course, &instrument, FORT_SUMNER, start, 1);
    let (near, far) = SerialPort::pair().unwrap();
    let mut sensors = Sensors::new(flight, Some(Box::new(far)));
    sensors.join(start, Duration::ZERO);
    drop(near);
    for second in 1..4 {
        sensors
            .speak(&mut Sink, Duration::from_secs(second))
            .unwrap();
    }
}
