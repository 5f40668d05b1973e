//! Properties of the Sun's path of a simulated flight.

use solaspect::instrument::{Instrument, builtin, builtin_names};
use solaspect::simulate::{FlightScenes, MAX_SLEW_DEG_PER_S, SUN_RADIUS_ARCSEC, Trajectory};
use solaspect::units::SensorPx;
use std::time::Duration;

fn radius_mil(instrument: &Instrument) -> f64 {
    instrument.optics.radius_mil(SUN_RADIUS_ARCSEC)
}

/// Times in steps of 0.05 s up to the duration.
fn moments(duration_s: f64) -> impl Iterator<Item = (f64, Duration)> {
    (0..(duration_s * 20.0) as u32)
        .map(|n| f64::from(n) / 20.0)
        .map(|t| (t, Duration::from_secs_f64(t)))
}

/// Distance of the Sun's centre inwards from the sensor's nearest edge, in solar radii.
fn depth(seen: SensorPx, radius_px: f64) -> f64 {
    let x = (seen.x + 0.5).min(1295.5 - seen.x);
    let y = (seen.y + 0.5).min(965.5 - seen.y);
    x.min(y) / radius_px
}

fn depths(scenes: &FlightScenes, duration_s: f64) -> Vec<(f64, f64)> {
    moments(duration_s)
        .map(|(t, time)| {
            let truth = scenes.scene(0, time).unwrap().truth();
            let sun = truth.sun.unwrap();
            (t, depth(sun.px, sun.radius_px))
        })
        .collect()
}

#[test]
fn in_the_demonstration_the_sun_is_gone_between_60_and_75_percent_and_whole_otherwise() {
    for name in builtin_names() {
        let instrument = builtin(name).unwrap();
        let radius = radius_mil(&instrument);
        for (seed, duration_s) in [(1, 20.0), (2, 20.0), (3, 5.0), (4, 60.0), (5, 600.0)] {
            let duration = Duration::from_secs_f64(duration_s);
            let path = Trajectory::demo(&instrument, radius, duration, seed).unwrap();
            let scenes = FlightScenes::new(&instrument, path, radius, seed).unwrap();
            let mut gone_s = 0.0;
            for (t, depth) in depths(&scenes, duration_s) {
                let part = t / duration_s;
                if !(0.60..=0.75).contains(&part) {
                    assert!(depth > 1.0, "{name} seed {seed}: depth {depth} at {t} s");
                } else if depth < -1.0 {
                    gone_s += 0.05;
                }
            }
            assert!(
                gone_s > 0.3 * 0.15 * duration_s,
                "{name}: gone for {gone_s} s"
            );
        }
    }
}

#[test]
fn an_endless_flight_keeps_the_sun_whole_for_nine_minutes_and_repeats_without_a_jump() {
    let instrument = builtin("demo").unwrap();
    let radius = radius_mil(&instrument);
    for seed in 0..5 {
        let path = Trajectory::flight(&instrument, radius, seed).unwrap();
        let scenes = FlightScenes::new(&instrument, path.clone(), radius, seed).unwrap();
        assert!(depths(&scenes, 540.0).iter().all(|(_, depth)| *depth > 1.0));
        let [before, after] = [899.999, 900.001].map(Duration::from_secs_f64);
        assert!(path.position(before).distance(path.position(after)) < 2.0);
    }
}

#[test]
fn the_sun_never_moves_faster_than_the_gondola_slews() {
    let instrument = builtin("demo").unwrap();
    let radius = radius_mil(&instrument);
    let limit = MAX_SLEW_DEG_PER_S * 3600.0 / instrument.optics.arcsec_per_mil();
    let duration = Duration::from_secs(150);
    let mut fastest = 0.0_f64;
    for seed in 0..5 {
        let path = Trajectory::demo(&instrument, radius, duration, seed).unwrap();
        for (_, time) in moments(150.0) {
            fastest = fastest.max(path.velocity_mil_per_s(time).norm());
        }
    }
    assert!(fastest < limit, "{fastest} mil/s");
    assert!(fastest > 0.7 * limit, "{fastest} mil/s");
}

#[test]
fn in_a_short_demonstration_the_sun_keeps_to_that_speed_while_the_whole_disc_is_in_view() {
    let instrument = builtin("demo").unwrap();
    let radius = radius_mil(&instrument);
    let limit = MAX_SLEW_DEG_PER_S * 3600.0 / instrument.optics.arcsec_per_mil();
    let path = Trajectory::demo(&instrument, radius, Duration::from_secs(20), 1).unwrap();
    for (t, time) in moments(20.0).filter(|(t, _)| !(12.0..=15.0).contains(t)) {
        assert!(path.velocity_mil_per_s(time).norm() < limit, "at {t} s");
    }
}

#[test]
fn velocity_is_the_slope_of_the_position() {
    let instrument = builtin("heroes-pyas-f").unwrap();
    let path = Trajectory::flight(&instrument, radius_mil(&instrument), 3).unwrap();
    for (_, time) in moments(600.0).step_by(37) {
        let h = Duration::from_micros(500);
        let (before, after) = (path.position(time), path.position(time + 2 * h));
        let slope = (after.vector() - before.vector()) / 1e-3;
        assert!((slope - path.velocity_mil_per_s(time + h)).norm() < 0.05);
    }
}

#[test]
fn in_flight_marks_are_lit_and_the_frame_knows_its_number_and_place() {
    let instrument = builtin("demo").unwrap();
    let radius = radius_mil(&instrument);
    let path = Trajectory::flight(&instrument, radius, 2).unwrap();
    let scenes = FlightScenes::new(&instrument, path, radius, 2).unwrap();
    let mut whole = Vec::new();
    for (_, time) in moments(540.0).step_by(20) {
        let marks = scenes.scene(0, time).unwrap().truth().marks;
        whole.push(marks.iter().filter(|m| m.depth_mil > 60.0).count());
    }
    whole.sort_unstable();
    assert!(whole[whole.len() / 20] >= 3, "fewest {whole:?}");
    let info = scenes.scene(17, Duration::from_secs(1)).unwrap().info;
    assert_eq!(info.number, Some(17));
    assert_eq!(info.exposure, Some(Duration::from_millis(15)));
    assert_eq!(info.place.unwrap().height_m, 38_405.0);
}
