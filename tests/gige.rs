//! The GigE Vision camera, against a fake one on loopback that carries the simulator's frames over the real protocol.
//! UDP port 3956 belongs to one fake at a time: the tests take turns.

use crate::common::camera::{TIMEOUT, absent, frame, next};
use crate::common::flight::frames_in;
use solaspect::camera::{CameraSettings, Device, FrameSource, GenicamCamera, PixelFormat};
use solaspect::fits;
use solaspect::frame::{Frame, Pixels, Region};
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

const ADDRESS: &str = "127.0.0.1";

static PORT: Mutex<()> = Mutex::new(());

fn port() -> MutexGuard<'static, ()> {
    PORT.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A simulated camera, killed when dropped.
struct Fake(Child);

impl Fake {
    fn start(options: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_fake-camera"))
            .args(["--interface", ADDRESS, "--pictures", "4"])
            .args(options)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let output = child.stdout.as_mut().unwrap();
        BufReader::new(output).read_line(&mut line).unwrap();
        assert!(line.starts_with("listening"), "{line:?}");
        Self(child)
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

fn at(address: &str) -> Device {
    Device::Gige(address.into())
}

fn settings() -> CameraSettings {
    CameraSettings {
        rate_hz: 20.0,
        exposure_us: 7_500,
        region: Some(Region::sized(100, 50, 640, 480)),
        ..CameraSettings::default()
    }
}

/// Brightness of the disc's bright part as a fraction of full scale.
fn brightness(frame: &Frame) -> f64 {
    let mut sorted: Vec<u16> = match frame.pixels() {
        Pixels::U8(pixels) => pixels.iter().map(|&dn| dn.into()).collect(),
        Pixels::U16(pixels) => pixels.clone(),
    };
    sorted.sort_unstable();
    f64::from(sorted[sorted.len() * 99 / 100]) / f64::from(frame.saturation_dn())
}

fn assert_settings_hold(frame: &Frame, settings: &CameraSettings) {
    let region = settings.region.unwrap();
    assert_eq!(
        (frame.width(), frame.height()),
        (region.width(), region.height())
    );
    assert_eq!(frame.info.corner_px, Some((region.x0, region.y0)));
    assert_eq!(frame.info.exposure, Some(settings.exposure()));
}

#[test]
fn frames_come_with_their_settings_times_and_temperature() {
    let _turn = port();
    let _fake = Fake::start(&[]);
    let wanted = CameraSettings {
        analogue_gain: Some(3.0),
        preamp_gain: Some(-3.0),
        ..settings()
    };
    let mut camera = GenicamCamera::new(at(ADDRESS), &wanted);
    let first = next(&mut camera, &mut Vec::new());
    assert_settings_hold(&first.frame, &wanted);
    let info = &first.frame.info;
    assert_eq!(info.analogue_gain, Some(3.0));
    assert_eq!(info.preamp_gain, Some(-3.0));
    assert_eq!(info.camera_temperature_c, Some(20.5));
    assert_eq!(info.number, Some(0));
    let start = info.exposure_start().unwrap();
    let late = start.duration_since(first.announced);
    assert!(!late.is_negative() && late.as_secs() < 1, "{late}");

    let second = frame(&mut camera).info;
    assert!(second.camera_clock > info.camera_clock);
    assert!(second.monotonic > info.monotonic);
    assert_eq!(second.number, Some(1));
    assert_eq!(camera.health().refused_settings, 0);
    assert_eq!(camera.health().temperature_c, Some(20.5));
}

#[test]
fn settings_are_taken_in_flight_and_a_refused_one_is_reported() {
    let _turn = port();
    let _fake = Fake::start(&[]);
    let mut camera = GenicamCamera::new(at(ADDRESS), &settings());
    let before = brightness(&frame(&mut camera));

    let longer = CameraSettings {
        exposure_us: 15_000,
        region: Some(Region::sized(0, 0, 1296, 966)),
        pixel_format: PixelFormat::Mono12,
        ..settings()
    };
    camera.apply(&longer).unwrap();
    let after = frame(&mut camera);
    assert_settings_hold(&after, &longer);
    assert_eq!(after.saturation_dn(), 4095);
    assert!(brightness(&after) > before.min(0.5), "{before}");

    let impossible = CameraSettings {
        analogue_gain: Some(400.0),
        ..longer.clone()
    };
    let message = camera.apply(&impossible).unwrap_err().to_string();
    assert!(
        message.starts_with("camera.analogue_gain: expected 400"),
        "{message}"
    );
    assert_eq!(camera.health().refused_settings, 1);
    assert_settings_hold(&frame(&mut camera), &longer);
}

#[test]
fn a_camera_that_dies_is_brought_back_with_every_setting() {
    let _turn = port();
    let fake = Fake::start(&[]);
    let wanted = settings();
    let mut camera = GenicamCamera::new(at(ADDRESS), &wanted);
    let last = (0..5).map(|_| frame(&mut camera)).last().unwrap();

    drop(fake);
    let begun = Instant::now();
    let mut noticed = false;
    while !noticed && begun.elapsed() < TIMEOUT {
        let asked = Instant::now();
        noticed = camera.next(&mut |_| {}).is_err();
        assert!(asked.elapsed() < Duration::from_secs(5), "it blocks");
    }
    assert!(noticed);

    // The new camera does not have the settings of the previous one.
    let _fake = Fake::start(&["--serial", "SECOND"]);
    let exposure = next(&mut camera, &mut Vec::new());
    assert_settings_hold(&exposure.frame, &wanted);
    assert!(exposure.frame.info.number > last.info.number);
    assert!(exposure.frame.info.monotonic > last.info.monotonic);
    assert_eq!(camera.health().reconnects, 1);
    assert_eq!(camera.health().refused_settings, 0);
}

#[test]
fn incomplete_frames_are_counted_and_never_given() {
    let _turn = port();
    // A frame has 228 packets, so one frame in three is complete.
    let _fake = Fake::start(&["--lost", "5"]);
    let mut camera = GenicamCamera::new(at(ADDRESS), &settings());
    let mut errors = Vec::new();
    let frames: Vec<Frame> = (0..5)
        .map(|_| next(&mut camera, &mut errors).frame)
        .collect();
    while camera.health().incomplete == 0 {
        next(&mut camera, &mut errors);
    }
    for frame in &frames {
        assert_settings_hold(frame, &settings());
    }
    let health = camera.health();
    assert!(health.lost_packets >= health.incomplete, "{health:?}");
    assert!(
        errors.iter().any(|error| error.contains("incomplete")),
        "{errors:?}"
    );
}

#[test]
fn a_camera_is_found_by_its_serial_number_and_by_either_name() {
    let _turn = port();
    let _fake = Fake::start(&["--serial", "BOBCAT7"]);
    for device in [
        Device::Gige("BOBCAT7".into()),
        Device::Genicam("BOBCAT7".into()),
        Device::Genicam(ADDRESS.into()),
    ] {
        let mut camera = GenicamCamera::new(device, &settings());
        let name = frame(&mut camera).info.camera.unwrap();
        assert_eq!(name, "Aravis Fake BOBCAT7");
    }
}

#[test]
fn a_camera_that_is_not_there_is_an_error_that_names_it_as_its_user_does() {
    let _turn = port();
    let nobody = "no camera has this serial number or id; found ";
    for (device, expected) in [
        (at(ADDRESS), "no camera answers at this address"),
        (at("NOBODY"), nobody),
        (Device::Genicam("NOBODY".into()), nobody),
    ] {
        let error = absent(&mut GenicamCamera::new(device.clone(), &settings()));
        let expected = format!("the camera {device}: {expected}");
        assert!(error.starts_with(&expected), "{error}");
    }
}

#[test]
fn a_camera_that_packs_12_bits_is_read_as_one_that_does_not() {
    let _turn = port();
    let deep = CameraSettings {
        pixel_format: PixelFormat::Mono12,
        ..settings()
    };
    let picture = |options: &[&str]| {
        // Both show a Sun of the same size, which changes from one second to the next.
        let scene = ["--pictures", "1", "--utc", "2013-09-21T18:00:00Z"];
        let _fake = Fake::start(&[options, &scene].concat());
        let mut camera = GenicamCamera::new(at(ADDRESS), &deep);
        let frame = frame(&mut camera);
        assert_eq!(camera.health().refused_settings, 0);
        assert_eq!(frame.saturation_dn(), 4095);
        frame.pixels().clone()
    };
    let plain = picture(&[]);
    assert!(plain == picture(&["--packed"]));
}

#[test]
fn a_flight_over_the_real_protocol_solves_the_simulators_frames() {
    let _turn = port();
    let _fake = Fake::start(&[]);
    let archive = tempfile::tempdir().unwrap();
    let run = Command::new(env!("CARGO_BIN_EXE_solaspect"))
        .args([
            "fly",
            "--camera",
            "gige:127.0.0.1",
            "--instrument",
            "calibration/demo.toml",
            "--duration",
            "6s",
            "--archive",
        ])
        .arg(archive.path())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&run.stdout);
    let number_before = |word: &str| -> u64 {
        let words: Vec<&str> = said.split_whitespace().collect();
        let at = words.iter().position(|w| *w == word).unwrap();
        words[at - 1].parse().unwrap()
    };
    assert!(number_before("taken,") >= 3, "{said}");
    assert!(number_before("fine,") >= 3, "{said}");

    let info = fits::read_frame(&frames_in(archive.path())[0])
        .unwrap()
        .info;
    assert_eq!(info.camera.as_deref(), Some("Aravis Fake FLIGHT"));
    assert!(info.camera_clock.is_some() && info.monotonic.is_some());
}
