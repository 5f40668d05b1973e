//! Stamps of frames whose true times are known.

use super::super::flags::Order;
use super::*;

const START_NS: i64 = 1_379_786_400_000_000_000;

/// Frames taken at these times, s, numbered from 100, of a uniformly moving object; stamped in whole microseconds.
fn taken(times_s: impl Iterator<Item = f64>) -> Vec<Stamp> {
    let stamp = |(n, time_s): (usize, f64)| Stamp {
        utc_ns: Some(START_NS + (time_s * 1e6).round() as i64 * 1000),
        exposure_s: None,
        monotonic_s: None,
        number: Some(100 + n as u64),
        place: Some([3.0 * time_s, -time_s]),
    };
    times_s.enumerate().map(stamp).collect()
}

/// Frames at 4 Hz, with the jitter of a computer.
fn steady(frames: usize) -> Vec<Stamp> {
    taken((0..frames).map(|n| n as f64 / 4.0 + 1e-3 * (n * 7919 % 11) as f64))
}

fn true_s(stamp: &Stamp) -> f64 {
    stamp.place.unwrap()[0] / 3.0
}

fn shift(stamp: &mut Stamp, by_s: f64) {
    stamp.utc_ns = stamp.utc_ns.map(|utc_ns| utc_ns + (by_s * 1e9) as i64);
}

/// The stamps quantised in steps.
fn in_steps(mut stamps: Vec<Stamp>, step_s: f64) -> Vec<Stamp> {
    let step_ns = (step_s * 1e9) as i64;
    for stamp in &mut stamps {
        stamp.utc_ns = stamp.utc_ns.map(|utc_ns| utc_ns / step_ns * step_ns);
    }
    stamps
}

/// Each frame's error in time, s, and its flag.
fn judged(stamps: &[Stamp]) -> Vec<(f64, Timing)> {
    let times = Times::of(stamps);
    let one = |(stamp, timing): (&Stamp, Timing)| {
        let utc_ns = timing.utc_ns(stamp.utc_ns).unwrap_or(START_NS);
        ((utc_ns - START_NS) as f64 / 1e9 - true_s(stamp), timing)
    };
    stamps.iter().zip(times.timings).map(one).collect()
}

fn flagged(stamps: &[Stamp]) -> Vec<usize> {
    let judged = judged(stamps).into_iter().enumerate();
    let found = judged.filter(|(_, (_, timing))| timing.flag.is_some());
    found.map(|(n, _)| n).collect()
}

/// Checks that all time errors are within three of their sigmas, and below `most_s`.
fn expect_corrected(stamps: &[Stamp], expected: &[usize], most_s: f64) {
    assert_eq!(flagged(stamps), expected);
    for (n, (error_s, timing)) in judged(stamps).iter().enumerate() {
        let sigma_s = timing.sigma_s.unwrap_or(1e-3);
        assert!(
            error_s.abs() < most_s && error_s.abs() < 3.0 * sigma_s + 1e-3,
            "{n} {error_s} {timing:?}"
        );
    }
}

#[test]
fn good_times_are_left_alone() {
    for frames in [1, 2, 3, 300] {
        assert!(flagged(&steady(frames)).is_empty(), "{frames}");
    }
    let exact = |rate_hz: f64| taken((0..60).map(move |n| n as f64 / rate_hz));
    for rate_hz in [0.5, 1.0, 2.0, 4.0, 10.0, 26.0] {
        assert!(flagged(&exact(rate_hz)).is_empty(), "{rate_hz}");
    }
    // A pause, missing frames, another rate, and no numbers.
    let mut paused: Vec<Stamp> = steady(200);
    paused[120..]
        .iter_mut()
        .for_each(|stamp| shift(stamp, 45.0));
    paused.drain(60..67);
    assert!(flagged(&paused).is_empty());
    let faster = (0..100).map(|n| {
        if n < 50 {
            n as f64
        } else {
            50.0 + (n - 50) as f64 / 8.0
        }
    });
    assert!(flagged(&taken(faster)).is_empty());
    paused.iter_mut().for_each(|stamp| stamp.number = None);
    assert!(flagged(&paused).is_empty());
}

#[test]
fn a_counter_that_began_anew_contradicts_nothing() {
    for (first, other, begins) in [
        (200, 50, 100),
        (200, 50, 1000),
        (50, 200, 100),
        (100, 100, 0),
        (500, 210, 580),
        (210, 120, 0),
    ] {
        let mut both = steady(first + other);
        for (n, stamp) in both[first..].iter_mut().enumerate() {
            stamp.number = Some(begins + n as u64);
            shift(stamp, 30.0);
        }
        both.remove(17);
        assert!(flagged(&both).is_empty(), "{first} {other} {begins}");
    }
}

#[test]
fn frames_of_a_whole_second_are_spread_over_it() {
    let keys: [fn(&mut Stamp); 3] = [
        |stamp| stamp.monotonic_s = Some(77.0 + stamp.place.unwrap()[0] / 3.0),
        |_| {},
        |stamp| stamp.number = None,
    ];
    let orders = [Order::Monotonic, Order::Number, Order::Files];
    for (key, by) in keys.into_iter().zip(orders) {
        for (rate_hz, step_s) in [
            (4.0, 1.0),
            (3.7, 1.0),
            (1.3, 1.0),
            (26.0, 0.1),
            (2.0, 60.0),
            (1.0, 2.0),
        ] {
            let frames = (200.0_f64.max(5.0 * step_s * rate_hz)) as usize;
            let taken = taken((0..frames).map(|n| 0.013 + n as f64 / rate_hz));
            let mut stamps = in_steps(taken, step_s);
            stamps.iter_mut().for_each(key);
            for (n, (error_s, timing)) in judged(&stamps).iter().enumerate() {
                let step_us = (step_s * 1e6) as u64;
                assert_eq!(
                    timing.flag,
                    Some(TimeFlag::CoarseTime { step_us, by }),
                    "{rate_hz}"
                );
                let sigma_s = timing.sigma_s.unwrap();
                assert!((sigma_s - step_s / 12_f64.sqrt()).abs() < 1e-3 * step_s);
                // Evenly spaced frames are spread as accurately as their steps allow.
                assert!(
                    error_s.abs() < 0.6 / rate_hz,
                    "{by:?} {rate_hz} {n}: {error_s}"
                );
            }
        }
    }
}

#[test]
fn the_start_of_the_exposure_may_be_what_is_stamped() {
    let mut stamps = in_steps(steady(100), 1.0);
    for (n, stamp) in stamps.iter_mut().enumerate() {
        let exposure_s = 0.01 + 1e-4 * (n % 7) as f64;
        stamp.exposure_s = Some(exposure_s);
        shift(stamp, exposure_s / 2.0);
    }
    assert_eq!(flagged(&stamps).len(), 100);
}

#[test]
fn what_nothing_orders_is_not_of_the_path() {
    let mut stamps = in_steps(steady(100), 1.0);
    stamps.iter_mut().for_each(|stamp| stamp.number = None);
    stamps.sort_by_key(|stamp| (true_s(stamp) * 7919.0) as i64 % 101);
    let judged = judged(&stamps);
    assert!(
        judged
            .iter()
            .all(|(_, timing)| timing.flag == Some(TimeFlag::SharedTime))
    );
    assert!(
        judged
            .iter()
            .all(|(error_s, timing)| error_s.abs() < 2.0 * timing.sigma_s.unwrap())
    );
}

#[test]
fn a_clock_that_stands_still_gives_no_time() {
    let mut stamps = steady(40);
    let first = stamps[0].utc_ns;
    stamps.iter_mut().for_each(|stamp| stamp.utc_ns = first);
    for timing in Times::of(&stamps).timings {
        assert_eq!(timing.utc_ns(first), None);
        assert_eq!(timing.flag, Some(TimeFlag::StoppedClock));
    }
    // Stopped for a while only: the numbers show it.
    let mut stamps = steady(200);
    let first = stamps[50].utc_ns;
    stamps[50..70]
        .iter_mut()
        .for_each(|stamp| stamp.utc_ns = first);
    let judged_all = judged(&stamps);
    for (error_s, timing) in &judged_all {
        assert!(error_s.abs() < 0.03, "{error_s} {timing:?}");
    }
    assert!(flagged(&stamps).len() >= 19);
    // Without numbers the uncertainty is the time to the next stamp.
    stamps.iter_mut().for_each(|stamp| stamp.number = None);
    for (error_s, timing) in &judged(&stamps)[50..70] {
        assert_eq!(timing.flag, Some(TimeFlag::SharedTime));
        assert!(error_s.abs() < 4.0 * timing.sigma_s.unwrap());
    }
}

#[test]
fn times_that_leave_the_order_of_the_numbers_are_corrected() {
    for by_s in [3600.0, -3600.0, 86_400.0, 1.0, -1.0, -6.0 * 3600.0] {
        for wrong in [40..41, 60..95] {
            let mut stamps = steady(200);
            stamps[wrong.clone()]
                .iter_mut()
                .for_each(|stamp| shift(stamp, by_s));
            let wrong: Vec<usize> = wrong.collect();
            expect_corrected(&stamps, &wrong, 0.05);
        }
    }
    // The end of a flight stamped in another time zone.
    let mut stamps = steady(200);
    stamps[150..]
        .iter_mut()
        .for_each(|stamp| shift(stamp, -6.0 * 3600.0));
    expect_corrected(&stamps, &(150..200).collect::<Vec<_>>(), 0.05);
    // A shift of one second between frames two seconds apart: no time runs back.
    let mut slow = taken((0..100).map(|n| 2.0 * n as f64));
    slow[30..34].iter_mut().for_each(|stamp| shift(stamp, 1.0));
    expect_corrected(&slow, &[30, 31, 32, 33], 0.05);
}

#[test]
fn of_shuffled_times_and_shuffled_numbers_the_motion_shows_which_is_wrong() {
    let shuffled = |n: usize| n * 37 % 100;
    let good = steady(100);
    let mut times = good.clone();
    (0..100).for_each(|n| times[n].utc_ns = good[shuffled(n)].utc_ns);
    let all = judged(&times);
    assert!(
        all.iter()
            .all(|(_, timing)| timing.flag == Some(TimeFlag::ShuffledTime))
    );
    let mut numbers = good.clone();
    (0..100).for_each(|n| numbers[n].number = good[shuffled(n)].number);
    assert!(flagged(&numbers).is_empty());
}

#[test]
fn of_two_frames_with_one_number_and_time_neither_is_of_the_path() {
    let mut stamps = steady(50);
    stamps[20] = Stamp {
        place: stamps[20].place,
        ..stamps[19]
    };
    let judged = judged(&stamps);
    assert_eq!(flagged(&stamps), [19, 20]);
    for (error_s, timing) in &judged[19..21] {
        assert_eq!(timing.flag, Some(TimeFlag::SharedTime));
        assert!(error_s.abs() < 3.0 * timing.sigma_s.unwrap());
    }
}

#[test]
fn times_that_the_monotonic_clock_confirms_are_believed_whatever_the_numbers() {
    let mut stamps = steady(100);
    for stamp in &mut stamps {
        let since_s = (stamp.utc_ns.unwrap() - START_NS) as f64 / 1e9;
        stamp.monotonic_s = Some(40.0 + since_s);
    }
    stamps[30].number = Some(7);
    stamps[50..60]
        .iter_mut()
        .for_each(|stamp| stamp.number = Some(stamp.number.unwrap() + 900));
    assert!(flagged(&stamps).is_empty());
}
