//! The cameras without hardware: their frames, their frame rate, and their settings.

use jiff::Timestamp;
use solaspect::aspect::{self, Expected, Quality};
use solaspect::camera::{
    self, CameraError, CameraSettings, Exposure, FrameSource, PixelFormat, SimulatedCamera, Source,
    SourceContext, Take, TakenFiles, View,
};
use solaspect::clock::FlightClock;
use solaspect::fits::{self, Compression};
use solaspect::frame::{Frame, FrameInfo, Pixels, Region};
use solaspect::instrument::{self, Sees};
use solaspect::simulate::{FlightScenes, Trajectory};
use std::path::Path;
use std::time::{Duration, Instant};

const RADIUS_MIL: f64 = 547.0;

fn noon() -> Timestamp {
    "2013-09-21T18:00:00Z".parse().unwrap()
}

fn simulated(rate_hz: f64, duration: Option<Duration>) -> SimulatedCamera {
    let instrument = instrument::builtin("demo").unwrap();
    let trajectory = Trajectory::flight(&instrument, RADIUS_MIL, 1).unwrap();
    let scenes = FlightScenes::new(&instrument, trajectory, RADIUS_MIL, 1).unwrap();
    let settings = CameraSettings {
        rate_hz,
        ..CameraSettings::default()
    };
    let view = View::Plate(Box::new(scenes));
    SimulatedCamera::new(view, &settings, noon(), duration)
}

/// The next exposure and the times announced for it; `None` at the end.
fn next(camera: &mut dyn FrameSource) -> Option<(Exposure, Vec<Timestamp>)> {
    let mut announced = Vec::new();
    loop {
        match camera.next(&mut |time| announced.push(time)).unwrap() {
            Take::Exposure(exposure) => return Some((*exposure, announced)),
            Take::NotYet => {}
            Take::End => return None,
        }
    }
}

fn brightest(frame: &Frame) -> u16 {
    match frame.pixels() {
        Pixels::U8(pixels) => pixels.iter().copied().max().unwrap().into(),
        Pixels::U16(pixels) => pixels.iter().copied().max().unwrap(),
    }
}

/// Mean of the disc's bright part, DN above background.
fn disc_dn(frame: &Frame) -> f64 {
    let Pixels::U8(pixels) = frame.pixels() else {
        panic!("not 8 bits");
    };
    let mut sorted = pixels.clone();
    sorted.sort_unstable();
    f64::from(sorted[sorted.len() - sorted.len() / 100]) - 4.0
}

#[test]
fn every_exposure_is_announced_once_with_its_own_start() {
    let mut camera = simulated(50.0, Some(Duration::from_millis(100)));
    for number in 0..5 {
        let (exposure, announced) = next(&mut camera).unwrap();
        let info = &exposure.frame.info;
        assert_eq!(info.number, Some(number));
        assert_eq!(announced, vec![exposure.announced]);
        assert_eq!(info.exposure_start(), Some(exposure.announced));
    }
    assert!(next(&mut camera).is_none());
}

#[test]
fn a_slow_camera_gives_control_back_while_no_frame_is_due() {
    let mut camera = simulated(0.01, None);
    assert!(
        next(&mut camera).is_some(),
        "the first frame is due at once"
    );
    let begun = Instant::now();
    let take = camera.next(&mut |_| panic!("nothing begins")).unwrap();
    assert!(matches!(take, Take::NotYet));
    assert!(begun.elapsed() < Duration::from_secs(50));
}

#[test]
fn the_simulator_takes_exposure_region_format_and_rate_in_flight() {
    let mut camera = simulated(50.0, None);
    let (first, _) = next(&mut camera).unwrap();
    let shorter = CameraSettings {
        rate_hz: 20.0,
        exposure_us: 7_500,
        ..CameraSettings::default()
    };
    camera.apply(&shorter).unwrap();
    let (second, _) = next(&mut camera).unwrap();
    assert_eq!(second.frame.info.exposure, Some(shorter.exposure()));
    let ratio = disc_dn(&second.frame) / disc_dn(&first.frame);
    assert!((ratio - 0.5).abs() < 0.03, "{ratio}");

    let part = CameraSettings {
        exposure_us: 60_000,
        region: Some(Region::sized(100, 50, 640, 480)),
        pixel_format: PixelFormat::Mono12,
        ..shorter
    };
    camera.apply(&part).unwrap();
    let (third, _) = next(&mut camera).unwrap();
    let since = third.announced.duration_since(second.announced);
    assert_eq!(since.as_millis(), 50);
    assert_eq!((third.frame.width(), third.frame.height()), (640, 480));
    assert_eq!(third.frame.info.corner_px, Some((100, 50)));
    assert_eq!(third.frame.saturation_dn(), 4095);
    assert_eq!(
        brightest(&third.frame),
        4095,
        "four times the light saturates"
    );
}

#[test]
fn a_frame_of_any_depth_knows_its_full_scale_and_shows_the_sun() {
    let instrument = instrument::builtin("demo").unwrap();
    let mut camera = simulated(50.0, None);
    let full_scales = [255, 1023, 4095, 65_535];
    for (format, saturation_dn) in PixelFormat::KINDS.into_iter().zip(full_scales) {
        let settings = CameraSettings {
            pixel_format: format,
            ..CameraSettings::default()
        };
        camera.apply(&settings).unwrap();
        let (Exposure { frame, .. }, _) = next(&mut camera).unwrap();
        assert_eq!(frame.saturation_dn(), saturation_dn, "{format:?}");
        assert_eq!(format.bytes() * 8, frame.bits() as usize);
        let expected = frame.info.mid_exposure.and_then(Expected::at);
        let solved = aspect::solve(&frame, &instrument, expected, None);
        assert_eq!(solved.quality, Quality::Fine, "{format:?}");
        let truth = camera.truth().of(frame.info.number.unwrap()).flatten();
        let sun = solved.aspect.unwrap().sun_plate;
        let off_mil = sun.position.distance(truth.unwrap().plate);
        let [across, along] = sun.sigma();
        let limit_mil = 5.0 * across.hypot(along);
        assert!(
            off_mil < limit_mil,
            "{format:?}: {off_mil} mil, {limit_mil}"
        );
    }
}

#[test]
fn a_region_that_reaches_over_the_sensor_is_an_error_and_a_good_one_mends_it() {
    let mut camera = simulated(50.0, None);
    let wrong = CameraSettings {
        region: Some(Region::sized(1000, 0, 640, 480)),
        ..CameraSettings::default()
    };
    camera.apply(&wrong).unwrap();
    let message = camera.next(&mut |_| {}).unwrap_err().to_string();
    assert_eq!(
        message,
        "camera.region_px: expected a part of the sensor's 1296 x 966 px, found 1000,0,640,480"
    );
    camera.apply(&CameraSettings::default()).unwrap();
    assert!(next(&mut camera).is_some());
}

fn opened(source: &str, speed: f64) -> Result<Box<dyn FrameSource>, CameraError> {
    opened_at(source, speed, FlightClock::default())
}

fn opened_at(
    source: &str,
    speed: f64,
    clock: FlightClock,
) -> Result<Box<dyn FrameSource>, CameraError> {
    let instrument = instrument::builtin("demo").unwrap();
    let context = SourceContext {
        sees: Sees::Plate(Box::new(instrument)),
        seed: 1,
        clock,
        duration: None,
        speed,
        taken: TakenFiles::default(),
    };
    let settings = CameraSettings {
        rate_hz: 50.0,
        ..CameraSettings::default()
    };
    camera::open(&source.parse::<Source>().unwrap(), &settings, &context)
}

/// Days on which the Sun is smallest and largest.
#[test]
fn a_simulated_flight_on_another_day_has_frames_of_that_day_with_its_sun() {
    let instrument = instrument::builtin("demo").unwrap();
    for start in ["2013-07-05T18:00:00Z", "2014-01-04T18:00:00Z"] {
        let start: Timestamp = start.parse().unwrap();
        let clock = FlightClock::starting(start);
        let mut before = start;
        // A camera reopened, as after a fault, continues.
        for _ in 0..2 {
            let mut camera = opened_at("simulated", 1.0, clock).unwrap();
            let (exposure, _) = next(camera.as_mut()).unwrap();
            let utc = exposure.frame.info.mid_exposure.unwrap();
            assert!(before < utc && utc.duration_since(start).as_secs() < 3600);
            before = utc;
            let expected = Expected::at(utc);
            let solution = aspect::solve(&exposure.frame, &instrument, expected, None);
            assert_eq!(solution.quality, Quality::Fine, "{utc}");
        }
    }
}

/// Writes frames of a few pixels, each at a time in milliseconds after noon or without a time.
fn store(folder: &Path, times_ms: &[Option<i64>]) {
    for (n, time_ms) in times_ms.iter().enumerate() {
        let info = FrameInfo {
            mid_exposure: time_ms.map(|ms| noon() + jiff::SignedDuration::from_millis(ms)),
            ..FrameInfo::default()
        };
        let frame = Frame::new(2, 1, Pixels::U8(vec![n as u8, 7]), 255, info).unwrap();
        let path = folder.join(format!("{n}.fits"));
        fits::write_frame(&path, &frame, &[], &[], Compression::None).unwrap();
    }
}

/// Duration of the replay of a folder from its first frame to its last.
fn replay(folder: &Path, speed: f64, frames: usize) -> Duration {
    let mut camera = opened(&format!("folder:{}", folder.display()), speed).unwrap();
    assert!(next(camera.as_mut()).is_some());
    let begun = Instant::now();
    for _ in 1..frames {
        assert!(next(camera.as_mut()).is_some());
    }
    assert!(next(camera.as_mut()).is_none());
    begun.elapsed()
}

#[test]
fn a_folder_is_replayed_at_its_own_times_and_faster_by_the_speed() {
    let folder = tempfile::tempdir().unwrap();
    // A day's gap, a time that runs back, and a frame without a time: the wait is at most 10 s, or one period of the rate.
    let times_ms = [Some(0), Some(600), Some(86_400_000), Some(100), None];
    store(folder.path(), &times_ms);
    let alive = replay(folder.path(), 20.0, times_ms.len());
    let expected = Duration::from_millis((600 + 10_000 + 20 + 20) / 20);
    // The replay is never early; how late it is depends on the machine.
    assert!(alive > expected - Duration::from_millis(20), "{alive:?}");
    assert!(alive < Duration::from_secs(10), "{alive:?}");
}

#[test]
fn a_folders_bad_file_is_reported_and_the_rest_is_replayed() {
    let folder = tempfile::tempdir().unwrap();
    store(folder.path(), &[None, None]);
    std::fs::write(folder.path().join("1a.fits"), "no picture").unwrap();
    let mut camera = opened(&format!("folder:{}", folder.path().display()), 1.0).unwrap();
    assert!(next(camera.as_mut()).is_some() && next(camera.as_mut()).is_some());
    let message = camera.next(&mut |_| {}).unwrap_err().to_string();
    assert!(message.contains("1a.fits"), "{message}");
    assert!(next(camera.as_mut()).is_none());
}

#[test]
fn the_simulator_flies_the_path_of_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("path.toml");
    std::fs::write(
        &path,
        "[[piece]]\nstart_s = 0\nsun_mil = [200, 100]\n\
         [[piece]]\nstart_s = 0.02\nsun_mil = [200, 100]\ncloud = 0.5\n\
         [[piece]]\nstart_s = 0.04\nsun_mil = [99000, 0]\n",
    )
    .unwrap();
    let mut camera = opened(&format!("simulated:{}", path.display()), 1.0).unwrap();
    let mut disc = || disc_dn(&next(camera.as_mut()).unwrap().0.frame);
    let (clear, clouded, away) = (disc(), disc(), disc());
    assert!((clouded / clear - 0.5).abs() < 0.05, "{clear} {clouded}");
    assert!(away < 0.2 * clear, "{away}");
}

#[test]
fn what_is_no_source_is_an_error_that_says_what_is_one() {
    let message = "usb:1".parse::<Source>().unwrap_err().to_string();
    assert!(
        message.contains("gige:ADDRESS") && message.contains("usb:1"),
        "{message}"
    );
    for source in [
        "gige:",
        "genicam:",
        "genicam://x",
        "folder:",
        "simulated:",
        "",
        "gige",
        "folder:?follow",
    ] {
        assert!(source.parse::<Source>().is_err(), "{source}");
    }
    for source in ["folder:a?fallow", "folder:a?follow=some", "folder:a?"] {
        let message = source.parse::<Source>().unwrap_err().to_string();
        assert!(
            message.contains("folder:DIR?follow=all") && message.contains(source),
            "{message}"
        );
    }
    for (source, is_real, is_simulated) in [
        ("gige:10.0.0.1", true, false),
        ("genicam:The Maker-0123", true, false),
        ("genicam:Fake_1", false, true),
        ("own", true, false),
        ("folder:a:b", false, false),
        ("folder:a/b?follow", false, false),
        ("folder:a/b?follow=all", false, false),
        ("folder:why?follow?follow", false, false),
        ("folder:why?/", false, false),
        ("simulated", false, true),
        ("simulated:x.toml", false, true),
    ] {
        let parsed: Source = source.parse().unwrap();
        assert_eq!(parsed.to_string(), source);
        assert_eq!(parsed.is_real(), is_real, "{source}");
        assert_eq!(parsed.is_simulated(), is_simulated, "{source}");
    }
    let why = Source::Folder("why?follow".into());
    assert_eq!(why.to_string().parse(), Ok(why));
    let message = opened("simulated:/nowhere.toml", 1.0)
        .err()
        .unwrap()
        .to_string();
    assert!(message.contains("/nowhere.toml"), "{message}");
    if cfg!(not(feature = "gige")) {
        for source in ["gige:127.0.0.1", "genicam:Fake_1"] {
            let message = opened(source, 1.0).err().unwrap().to_string();
            assert!(message.contains("--features gige"), "{message}");
        }
    }
}

#[test]
fn a_part_of_the_sensor_gives_the_same_aspect_as_the_whole() {
    let instrument = instrument::builtin("demo").unwrap();
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/frames/standard");
    let whole = fits::read_frame(&data.join("frame_00000.fits")).unwrap();
    let expected = whole.info.mid_exposure.and_then(Expected::at);
    let settings = aspect::SolverSettings::default();
    let solve = |frame: &Frame| {
        let seen = instrument.seen_by(frame).unwrap();
        aspect::solve_with(&settings, frame, &seen, expected, None)
    };
    let of_whole = solve(&whole).aspect.unwrap();
    let sun = of_whole.sun_px.position;
    let corner = (sun.x as usize - 160, sun.y as usize - 150);
    let part = whole
        .cropped(Region::sized(corner.0, corner.1, 320, 300))
        .unwrap();
    let solution = solve(&part);
    assert_eq!(solution.quality, Quality::Fine);
    let of_part = solution.aspect.unwrap();
    let apart_mil = of_part
        .sun_plate
        .position
        .distance(of_whole.sun_plate.position);
    assert!(apart_mil < of_whole.sun_plate.sigma()[0], "{apart_mil} mil");
    let shifted = of_part.sun_px.position;
    assert!(
        (shifted.x + corner.0 as f64 - sun.x).abs() < 0.02,
        "{shifted:?} {sun:?}"
    );
    let stray = whole.cropped(Region::sized(1000, 600, 296, 366)).unwrap();
    let mut info = stray.info.clone();
    info.corner_px = Some((1100, 600));
    let stray = Frame::new(296, 366, stray.pixels().clone(), 255, info).unwrap();
    assert!(
        instrument.seen_by(&stray).is_err(),
        "it reaches over the sensor"
    );
}
