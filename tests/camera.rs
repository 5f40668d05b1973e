//! The cameras that need no camera: their frames, their pace, and what they take of settings.

use jiff::Timestamp;
use solaspect::camera::{Exposure, FrameSource, PixelFormat, Settings, SimulatedCamera, Take};
use solaspect::frame::{Frame, Pixels, Region};
use solaspect::instrument;
use solaspect::simulate::{FlightScenes, Trajectory};
use std::time::{Duration, Instant};

const RADIUS_MIL: f64 = 547.0;

fn noon() -> Timestamp {
    "2013-09-21T18:00:00Z".parse().unwrap()
}

fn simulated(rate_hz: f64, duration: Option<Duration>) -> SimulatedCamera {
    let instrument = instrument::builtin("demo").unwrap();
    let trajectory = Trajectory::flight(&instrument, RADIUS_MIL, 1).unwrap();
    let scenes = FlightScenes::new(&instrument, trajectory, RADIUS_MIL, 1).unwrap();
    SimulatedCamera::new(scenes, rate_hz, noon(), duration)
}

/// The next exposure and the times that were announced for it; `None` at the end.
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

/// Mean of the disc's bright part, DN above the background.
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
    let shorter = Settings {
        rate_hz: 20.0,
        exposure_us: 7_500,
        ..Settings::default()
    };
    camera.apply(&shorter).unwrap();
    let (second, _) = next(&mut camera).unwrap();
    assert_eq!(second.frame.info.exposure, Some(shorter.exposure()));
    let ratio = disc_dn(&second.frame) / disc_dn(&first.frame);
    assert!((ratio - 0.5).abs() < 0.03, "{ratio}");

    let part = Settings {
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
fn a_region_that_reaches_over_the_sensor_is_an_error_and_a_good_one_mends_it() {
    let mut camera = simulated(50.0, None);
    let wrong = Settings {
        region: Some(Region::sized(1000, 0, 640, 480)),
        ..Settings::default()
    };
    camera.apply(&wrong).unwrap();
    let message = camera.next(&mut |_| {}).unwrap_err().to_string();
    assert_eq!(
        message,
        "camera.region: expected a part of the sensor's 1296 x 966 px, found 1000,0,640,480"
    );
    camera.apply(&Settings::default()).unwrap();
    assert!(next(&mut camera).is_some());
}
