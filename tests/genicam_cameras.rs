//! Cameras opened by Aravis, with any interface, tested with Aravis's fake device: it is not a GigE Vision camera, and has
//! neither pre-amplifier nor thermometer.

use crate::common::camera::{absent, frame, next};
use crate::common::flight::numbers_in;
use solaspect::camera::{CameraHealth, CameraSettings, Device, FrameSource, GenicamCamera};
use solaspect::camera::{PixelFormat, Source};
use solaspect::frame::{Frame, Region};
use solaspect::plan::{Options, Plan, Replay};
use solaspect::service::{Flight, FlightTally, Service};
use std::path::Path;
use std::time::{Duration, Instant};

fn fake() -> Device {
    Device::Genicam("Fake_1".into())
}

fn settings() -> CameraSettings {
    CameraSettings {
        rate_hz: 100.0,
        exposure_us: 7_500,
        analogue_gain: Some(3.0),
        region: Some(Region::sized(100, 50, 640, 480)),
        ..CameraSettings::default()
    }
}

/// The device draws a diagonal ramp: the neighbours to the right and below are equal, and neighbours in a row differ.
fn assert_shows_the_ramp(frame: &Frame) {
    let (width, height) = (frame.width(), frame.height());
    for (x, y) in [
        (0, 0),
        (7, 3),
        (width / 2, height / 2),
        (width - 2, height - 2),
    ] {
        assert_eq!(frame.dn(x + 1, y), frame.dn(x, y + 1), "{x} {y}");
    }
    let row = frame.row_dn(0, 0..width);
    let steps = row.windows(2).filter(|pair| pair[0] != pair[1]);
    // A bright ramp is saturated over a large part of its length.
    assert!(steps.count() > width / 8);
}

#[test]
fn the_fake_device_gives_frames_with_their_settings_and_loses_none() {
    let mut camera = GenicamCamera::new(fake(), &settings());
    // The device's frame ids wrap past 65,535 during this loop.
    for number in 0..150 {
        let exposure = next(&mut camera, &mut Vec::new());
        let info = &exposure.frame.info;
        assert_eq!(info.number, Some(number));
        assert_eq!(info.exposure, Some(Duration::from_micros(7_500)));
        assert_eq!(info.analogue_gain, Some(3.0));
        assert_eq!(info.corner_px, Some((100, 50)));
        assert!(info.is_simulated() && info.camera_clock.is_some());
        assert_eq!(info.camera_temperature_c, None);
        let late = info
            .exposure_start()
            .unwrap()
            .duration_since(exposure.announced);
        assert!(!late.is_negative() && late.as_secs() < 1, "{late}");
        if number % 50 == 0 {
            assert_eq!(exposure.frame.saturation_dn(), 255);
            assert_eq!(
                (exposure.frame.width(), exposure.frame.height()),
                (640, 480)
            );
            assert_shows_the_ramp(&exposure.frame);
        }
    }
    assert_eq!(camera.health(), CameraHealth::default());
}

#[test]
fn a_camera_of_16_bits_is_read_with_its_full_scale() {
    let mut camera = GenicamCamera::new(fake(), &settings());
    assert_eq!(frame(&mut camera).bits(), 8);
    let deep = CameraSettings {
        pixel_format: PixelFormat::Mono16,
        region: None,
        ..settings()
    };
    camera.apply(&deep).unwrap();
    let frame = frame(&mut camera);
    assert_eq!((frame.bits(), frame.saturation_dn()), (16, 65_535));
    // The whole sensor.
    assert_eq!((frame.width(), frame.height()), (2048, 2048));
    assert_eq!(frame.info.corner_px, None);
    assert_shows_the_ramp(&frame);
    assert_eq!(camera.health(), CameraHealth::default());
}

#[test]
fn what_a_camera_lacks_is_a_refused_setting_that_is_counted_and_named() {
    let wanted = CameraSettings {
        pixel_format: PixelFormat::Mono12,
        preamp_gain: Some(2.0),
        ..settings()
    };
    let mut camera = GenicamCamera::new(fake(), &wanted);
    let first = frame(&mut camera);
    // The camera works with its own values, and its frames record them.
    assert_eq!((first.bits(), first.saturation_dn()), (8, 255));
    assert_eq!(first.info.preamp_gain, None);
    assert_eq!(camera.health().refused_settings, 2);
    let no_gain =
        "camera.preamp_gain: expected 2, found no feature named PreAmpRaw, PreAmpGain, PreAmp";
    assert_eq!(camera.apply(&wanted).unwrap_err().to_string(), no_gain);
    let other = CameraSettings {
        pixel_format: PixelFormat::Mono10,
        ..settings()
    };
    let refused = camera.apply(&other).unwrap_err().to_string();
    let expected = "camera.pixel_format: expected Mono10 or Mono10p or Mono10Packed, found ";
    assert!(refused.starts_with(expected), "{refused}");
    assert!(
        refused.contains("Mono8") && refused.contains("Mono16"),
        "{refused}"
    );
    assert_eq!(camera.health().refused_settings, 4);
    assert_shows_the_ramp(&frame(&mut camera));
}

#[test]
fn no_camera_but_the_fake_device_itself_is_the_fake_device() {
    for id in ["Fake", "Fake_2", "fake_1"] {
        let device = Device::Genicam(id.into());
        let error = absent(&mut GenicamCamera::new(device, &settings()));
        let expected = format!("the camera genicam:{id}: no camera has this serial number or id");
        assert!(error.starts_with(&expected), "{error}");
        // The fake device is not in the list either.
        assert!(!error.contains("Fake_1"), "{error}");
    }
    let gige: Source = "gige:Fake_1".parse().unwrap();
    assert!(!gige.is_simulated());
}

/// Tally of a flight of the fake device at the size of the demo's camera.
fn flown(folder: &Path, rate_hz: u64, seconds: u64) -> FlightTally {
    let file = folder.join("flight.toml");
    let archive = folder.join("archive");
    std::fs::create_dir(&archive).unwrap();
    let text = format!(
        "[camera]\nsource = \"genicam:Fake_1\"\nrate_hz = {rate_hz}\nregion_px = \"0,0,1296,966\"\n\
         [archive]\ndirectory = {:?}\n",
        archive.display().to_string()
    );
    std::fs::write(&file, text).unwrap();
    let (plan, remarks) = Plan::survey(Some(&file), &Options::default());
    assert!(!remarks.has_errors(), "{:?}", remarks.list);
    let flight = Flight::of_plan(&plan, Replay::default()).unwrap();
    let service = Service::start(flight).unwrap();
    let start = Instant::now();
    let mut marked = false;
    while start.elapsed() < Duration::from_secs(seconds) {
        std::thread::sleep(Duration::from_millis(100));
        marked |= service
            .housekeeping()
            .is_some_and(|housekeeping| housekeeping.simulated);
    }
    service.stop();
    let tally = service.join().unwrap();
    assert!(
        marked,
        "housekeeping does not say that the frames are simulated"
    );
    tally
}

/// Asserts that no frame is missing between camera and disk; returns their number.
fn assert_lost_nothing(tally: &FlightTally, archive: &Path) -> u64 {
    assert_eq!(tally.lost(), 0, "{tally}");
    assert_eq!(tally.camera.health, CameraHealth::default(), "{tally}");
    let taken = tally.counts.taken;
    assert_eq!(
        (tally.solved(), tally.counts.stored),
        (taken, taken),
        "{tally}"
    );
    assert_eq!(numbers_in(archive), (0..taken).collect::<Vec<_>>());
    taken
}

#[test]
fn a_flight_of_the_fake_device_loses_nothing_and_is_marked_as_simulated() {
    let folder = tempfile::tempdir().unwrap();
    let tally = flown(folder.path(), 4, 3);
    let taken = assert_lost_nothing(&tally, &folder.path().join("archive"));
    assert!(taken > 0, "{tally}");
}

#[test]
#[ignore = "ten minutes at 26 frames/s, on a machine that has nothing else to do"]
fn ten_minutes_of_the_fake_device_at_full_rate_lose_nothing() {
    const RATE_HZ: u64 = 26;
    const SECONDS: u64 = 600;
    let folder = tempfile::tempdir().unwrap();
    let tally = flown(folder.path(), RATE_HZ, SECONDS);
    println!("{tally}");
    let taken = assert_lost_nothing(&tally, &folder.path().join("archive"));
    // The camera needs time to open, then keeps its rate.
    assert!(taken + RATE_HZ >= RATE_HZ * SECONDS, "{taken} frames");
}
