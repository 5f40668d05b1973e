//! Flights of simulated sensors through the filter, as fast as the computer allows.

mod comparison;
mod faults;

use super::*;
use crate::config::{Config, Switch, Value};
use crate::demo::JudgedOffset;
use crate::geometry::attitude::Direction;
use crate::instrument::{self, DEMO_NAVIGATION};
use crate::link::Propagated;
use crate::navigation::nmea::{Nmea, Received, Refusal, TimedFix};
use crate::pointing::sun_in_telescope;
use crate::simulate::navigation::TelescopeFlight;
use crate::simulate::{FORT_SUMNER, SUN_RADIUS_ARCSEC, Trajectory};
use crate::units::{ARCSEC_PER_RAD, PlateMil};
use crossbeam_channel::unbounded;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;
use std::path::Path;

const START: &str = "2013-09-21T18:00:00Z";
/// Error of a frame's Sun, 1 sigma per axis.
const SUN_ARCSEC: f64 = 0.11;
const FRAMES_HZ: u64 = 4;

fn settings() -> NavigationSettings {
    let path = Path::new("NAV.toml");
    NavigationSettings::parse(path, DEMO_NAVIGATION)
        .unwrap()
        .for_flight(path, &Role::table_names())
        .unwrap()
}

fn navigator(config: Config, to_line: Sender<LinkEvent>) -> (Navigator, Receiver<NavigationRows>) {
    let (rows, kept) = unbounded();
    let mounting = instrument::builtin("demo").unwrap().mounting;
    let navigator = Navigator {
        settings: settings(),
        cameras: Role::tables()
            .map(|(name, role)| (name.into(), role))
            .collect(),
        ephemeris: Ephemeris::default(),
        controls: Controls::new(config, crate::pointing::Target::default(), mounting),
        to_line,
        rows,
        tally: Shared::default(),
        counters: Arc::default(),
        ended: Arc::default(),
        clock: FlightClock::starting(START.parse().unwrap()),
    };
    (navigator, kept)
}

fn sending() -> Config {
    let mut config = Config::default();
    config.navigation.send = Switch::On;
    config
}

/// Errors of a flight's offsets by the gyros.
#[derive(Debug, Default)]
struct Judged {
    offsets: usize,
    /// Errors in cross-elevation and elevation, in sigmas.
    sigmas: Vec<f64>,
    arcsec: Vec<(f64, f64)>,
    roll_deg: Vec<f64>,
    /// Time at which each offset was sent, s since the start.
    sent_s: Vec<f64>,
}

impl Judged {
    fn beyond_3_sigma(&self) -> f64 {
        let beyond = self.sigmas.iter().filter(|sigmas| sigmas.abs() > 3.0);
        beyond.count() as f64 / self.sigmas.len() as f64
    }

    fn ratio(&self) -> f64 {
        rms(self.sigmas.iter().copied())
    }

    /// RMS error of the offsets whose last frame has an age in this range, s.
    fn rms_arcsec(&self, ages_s: std::ops::Range<f64>) -> f64 {
        let of_age = self
            .arcsec
            .iter()
            .filter(|(age_s, _)| ages_s.contains(age_s));
        rms(of_age.map(|(_, error)| *error))
    }
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = values.fold((0, 0.0), |(n, sum), v| (n + 1, sum + v * v));
    (sum / f64::from(count)).sqrt()
}

/// A camera's frame at a time since the start.
fn seen(camera: usize, target: Target, since: Duration, direction: Direction) -> ObservedDirection {
    let start: Timestamp = START.parse().unwrap();
    ObservedDirection {
        camera,
        target,
        utc: start + SignedDuration::try_from(since).unwrap(),
        direction,
    }
}

/// The fixes of some sentences, all of which must be fixes.
fn fixes(receiver: &mut Nmea, sentences: &str) -> Vec<TimedFix> {
    let read = receiver.feed(sentences.as_bytes(), START.parse().unwrap());
    let fix = |sentence| match sentence {
        Received::Fix(fix) => fix,
        other => panic!("{other:?}"),
    };
    read.into_iter().map(fix).collect()
}

/// Flies the simulated telescope. Frames show the Sun at times for which `is_seen` is true, and are solved 40 ms late; `corrupt` may change
/// or drop a sample of the IMU, and `receive` a fix.
fn fly(
    duration_s: u64,
    seed: u64,
    is_seen: impl Fn(f64) -> bool,
    corrupt: impl FnMut(u64, ImuPacket) -> Option<ImuPacket>,
    receive: impl FnMut(u64, TimedFix) -> Option<TimedFix>,
) -> (Judged, NavigationTally) {
    let seen = (FRAMES_HZ, is_seen);
    fly_judged(duration_s, seed, seen, corrupt, receive, |_| true, &[])
}

/// The same after commands; only offsets at times for which `is_judged` is true count.
fn fly_judged(
    duration_s: u64,
    seed: u64,
    (frames_hz, is_seen): (u64, impl Fn(f64) -> bool),
    mut corrupt: impl FnMut(u64, ImuPacket) -> Option<ImuPacket>,
    mut receive: impl FnMut(u64, TimedFix) -> Option<TimedFix>,
    is_judged: impl Fn(&Propagated) -> bool,
    commanded: &[(&str, Value)],
) -> (Judged, NavigationTally) {
    let start: Timestamp = START.parse().unwrap();
    let instrument = instrument::builtin("demo").unwrap();
    let radius_mil = instrument.optics.radius_mil(SUN_RADIUS_ARCSEC);
    let course = Trajectory::flight(&instrument, radius_mil, seed).unwrap();
    let mut flown = TelescopeFlight::new(course, &instrument, FORT_SUMNER, start, seed);
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut normal = move || random.sample::<f64, _>(StandardNormal);
    let (to_line, line) = unbounded();
    let (navigator, _rows) = navigator(sending(), to_line);
    navigator.controls.set(commanded).unwrap();
    let mut filter = Filter::new(&navigator, start);
    let mut receiver = Nmea::default();
    let mut judged = Judged::default();
    let (mut late, rate) = (VecDeque::new(), flown.rate_hz());
    for n in 1..=duration_s * rate {
        let since = Duration::from_millis(n * 1000 / rate);
        if n % rate == 0 {
            let sentences = flown.sentences(n / rate).unwrap();
            let fixes = fixes(&mut receiver, &sentences).into_iter();
            let received = fixes.filter_map(|fix| receive(n / rate, fix));
            received.for_each(|fix| filter.fix(&fix));
        }
        if n % (rate / frames_hz) == 0 && is_seen(since.as_secs_f64()) {
            let sun = flown.sun_on_plate(since);
            let sigma_mil = SUN_ARCSEC / instrument.optics.arcsec_per_mil();
            let sun = PlateMil::new(sun.x + sigma_mil * normal(), sun.y + sigma_mil * normal());
            let unit = sun_in_telescope(sun, &instrument);
            let direction = Direction::new(unit, SUN_ARCSEC / ARCSEC_PER_RAD);
            late.push_back((n + 4, seen(0, Target::Sun, since, direction)));
        }
        while late.front().is_some_and(|(due, _)| *due <= n) {
            filter.direction(&late.pop_front().unwrap().1);
        }
        if let Some(sample) = corrupt(n, flown.sample(n).unwrap()) {
            filter.sample(&sample, Instant::now());
        }
        for event in line.try_iter() {
            if let LinkEvent::Propagated(event) = event
                && is_judged(&event.propagated)
            {
                judged.note(&event.propagated, &mut flown, start);
                judged.sent_s.push(since.as_secs_f64());
            }
        }
    }
    (judged, navigator.tally.copy())
}

impl Judged {
    /// Compares an offset with the flight's true attitude.
    fn note(&mut self, sent: &Propagated, flown: &mut TelescopeFlight, start: Timestamp) {
        let judged = JudgedOffset::of(sent, flown, start).unwrap();
        for error_arcsec in judged.error_arcsec {
            self.sigmas.push(error_arcsec / judged.sigma_arcsec);
            self.arcsec.push((judged.age_s, error_arcsec));
        }
        self.roll_deg.push(sent.solution.roll_deg);
        self.offsets += 1;
    }
}

/// Prints the results, so that a failure can be understood.
fn print(judged: &Judged, tally: &NavigationTally) {
    println!(
        "{} offsets, beyond 3 sigma {:.4}, error/sigma {:.2}; arcsec: {:.2} within 0.4 s, {:.2} after 50 to 60 s, {:.2} after more; roll {:.4} deg; {tally:?}",
        judged.offsets,
        judged.beyond_3_sigma(),
        judged.ratio(),
        judged.rms_arcsec(0.0..0.4),
        judged.rms_arcsec(50.0..60.0),
        judged.rms_arcsec(60.0..100.0),
        rms(judged.roll_deg.iter().copied()),
    );
}

/// A gap of 60 s every five minutes, and one camera outage of two minutes.
fn with_gaps(t_s: f64) -> bool {
    !(100.0..160.0).contains(&(t_s % 300.0)) && !(1800.0..1920.0).contains(&t_s)
}

fn as_received(_: u64, fix: TimedFix) -> Option<TimedFix> {
    Some(fix)
}

/// Several flights: the errors of one flight are correlated, for example by the biases of its accelerometers, which turn all offsets about the Sun.
fn fly_all(
    duration_s: u64,
    seeds: u64,
    corrupt: impl Fn(u64) -> bool + Copy,
) -> (Judged, NavigationTally) {
    let mut all = Judged::default();
    let mut counts = NavigationTally::default();
    for seed in 1..=seeds {
        let lose = |n: u64, sample| (!corrupt(n)).then_some(sample);
        let (judged, tally) = fly(duration_s, seed, with_gaps, lose, as_received);
        all.offsets += judged.offsets;
        all.sigmas.extend(judged.sigmas);
        all.arcsec.extend(judged.arcsec);
        all.roll_deg.extend(judged.roll_deg);
        counts.lost_samples += tally.lost_samples;
        counts.restarts += tally.restarts;
        counts.refused += tally.refused;
        counts.out_of_time += tally.out_of_time;
    }
    print(&all, &counts);
    (all, counts)
}

#[test]
fn offsets_between_frames_and_through_gaps_are_as_certain_as_they_say() {
    let (judged, tally) = fly_all(250, 12, |_| false);
    // 20 per second, except for the first seconds.
    assert!(judged.offsets > 12 * 4900);
    assert!(judged.beyond_3_sigma() < 0.01);
    assert!((0.8..1.25).contains(&judged.ratio()));
    assert!(judged.rms_arcsec(50.0..60.0) < 10.0);
    assert_eq!(
        (tally.restarts, tally.refused, tally.out_of_time),
        (0, 0, 0)
    );
}

/// The full size: an hour each.
#[test]
#[ignore = "minutes"]
fn offsets_of_an_hour_are_as_certain_as_they_say() {
    let (judged, tally) = fly_all(3600, 24, |_| false);
    assert!(judged.beyond_3_sigma() < 0.01);
    assert!((0.8..1.25).contains(&judged.ratio()));
    assert_eq!(tally.restarts, 0);
}

#[test]
fn lost_samples_make_an_offset_less_certain_and_not_wrong() {
    // One in ten at random, and 0.2 s every half minute.
    let is_lost =
        |n: u64| n % 3000 > 2980 || n.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32 & 0xff < 26;
    let (judged, tally) = fly_all(250, 12, is_lost);
    assert!(tally.lost_samples > 12 * 2500);
    assert!(judged.beyond_3_sigma() < 0.01);
    assert!((0.8..1.25).contains(&judged.ratio()));
    assert_eq!(tally.restarts, 0);
}

#[test]
fn a_clock_that_steps_and_samples_that_no_vehicle_feels_begin_the_filter_anew_at_most() {
    let corrupt = |n: u64, mut sample: ImuPacket| {
        if n % 1000 == 500 {
            sample.force_m_s2[1] = 1e30;
        }
        // For two seconds the IMU's clock is of another day, and later for one sample.
        if (5000..5200).contains(&n) || n == 7000 {
            sample.time -= SignedDuration::from_hours(24);
        }
        Some(sample)
    };
    let (judged, tally) = fly(90, 3, |_| true, corrupt, as_received);
    print(&judged, &tally);
    assert_eq!((tally.unreadable, tally.restarts), (9, 2));
    assert_eq!(tally.status, Some(Status::Aligned));
    assert!(judged.offsets > 1600);
    assert!(judged.beyond_3_sigma() < 0.01);
}

#[test]
fn fixes_that_jump_are_stale_or_do_not_come_move_no_offset() {
    let mut held = None;
    let receive = move |second: u64, mut fix: TimedFix| match second {
        // Five kilometres off for ten seconds.
        60..70 => {
            fix.place.latitude_deg += 0.045;
            Some(fix)
        }
        // A receiver that repeats the same fix.
        120..150 => Some(*held.get_or_insert(fix)),
        180..240 => None,
        _ => Some(fix),
    };
    let (judged, tally) = fly(300, 4, |_| true, |_, sample| Some(sample), receive);
    print(&judged, &tally);
    assert!((10..25).contains(&tally.refused), "{tally:?}");
    assert_eq!(tally.gps.refused(Refusal::Repeated), 29);
    assert_eq!(tally.restarts, 0);
    assert!(judged.beyond_3_sigma() < 0.01);
}

#[test]
fn fixes_without_velocity_begin_the_filter_and_keep_it() {
    let receive = |_, fix| {
        Some(TimedFix {
            level_m_s: None,
            ..fix
        })
    };
    let (judged, tally) = fly(250, 7, with_gaps, |_, sample| Some(sample), receive);
    print(&judged, &tally);
    // Until the roll is known their sigma is above the limit.
    assert!(judged.offsets > 4600, "{}", judged.offsets);
    assert!(judged.beyond_3_sigma() < 0.01);
    assert_eq!((tally.restarts, tally.refused), (0, 0));
}

#[test]
fn a_fix_of_another_time_than_the_imus_is_counted_as_such() {
    let late = SignedDuration::from_secs(18);
    let receive = |second: u64, mut fix: TimedFix| {
        // A receiver that does not know the leap seconds for a while.
        if (10..15).contains(&second) {
            fix.utc += late;
        }
        Some(fix)
    };
    let (judged, tally) = fly(40, 8, |_| true, |_, sample| Some(sample), receive);
    assert_eq!(tally.gps.refused(Refusal::OutOfTime), 5);
    assert!(judged.beyond_3_sigma() < 0.01);
}

#[test]
fn a_packet_of_the_imu_that_comes_twice_is_used_and_logged_once() {
    let start: Timestamp = START.parse().unwrap();
    let (to_line, _line) = unbounded();
    let (navigator, kept) = navigator(sending(), to_line);
    let mut filter = Filter::new(&navigator, start);
    for n in [1, 2, 2, 3] {
        let sample = ImuPacket {
            time: start + SignedDuration::from_millis(10 * n),
            counter: n as u16,
            force_m_s2: [0.0, 0.0, -9.8],
            rate_rad_s: [0.0; 3],
        };
        filter.sample(&sample, Instant::now());
    }
    filter.send_rows();
    let rows: usize = kept.try_iter().map(|rows| rows.rows.len()).sum();
    assert_eq!(rows, 3);
}

#[test]
fn a_clock_that_is_set_back_for_good_silences_no_offset() {
    let corrupt = |n: u64, mut sample: ImuPacket| {
        if n < 3000 {
            sample.time += SignedDuration::from_secs(600);
        }
        Some(sample)
    };
    let start: Timestamp = START.parse().unwrap();
    let is_judged = |sent: &Propagated| sent.solution.time < start + SignedDuration::from_secs(90);
    let (judged, tally) = fly_judged(
        60,
        5,
        (FRAMES_HZ, |_| true),
        corrupt,
        as_received,
        is_judged,
        &[],
    );
    assert_eq!((tally.restarts, tally.status), (1, Some(Status::Aligned)));
    assert!(judged.offsets > 480, "{}", judged.offsets);
}

#[test]
fn what_commands_set_of_the_filter_changes_what_is_sent() {
    let sent = |commanded: &[(&str, Value)]| {
        let corrupt = |_, sample| Some(sample);
        let (judged, tally) = fly_judged(
            40,
            6,
            (FRAMES_HZ, |_| true),
            corrupt,
            as_received,
            |_| true,
            commanded,
        );
        (judged.offsets, tally.uncertain)
    };
    let (as_it_is, _) = sent(&[]);
    let (slow, _) = sent(&[("navigation.rate_hz", Value::Number(5.0))]);
    assert!((as_it_is / 4).abs_diff(slow) < 3, "{as_it_is} and {slow}");
    let (strict, uncertain) = sent(&[("navigation.max_sigma_arcsec", Value::Number(0.25))]);
    assert!(
        strict < as_it_is / 2 && uncertain > 100,
        "{strict}, {uncertain}"
    );
}

#[test]
fn inputs_that_do_not_fit_into_the_filters_queue_are_counted_and_nobody_waits() {
    let counters = Arc::<Counters>::default();
    let (inputs, _queue) = Inputs::new(Shared::default(), Arc::clone(&counters));
    let start: Timestamp = START.parse().unwrap();
    let sample = ImuPacket {
        time: start,
        counter: 0,
        force_m_s2: [0.0; 3],
        rate_rad_s: [0.0; 3],
    };
    // The filter hangs.
    (0..3000).for_each(|_| inputs.take(Input::Imu(sample, Instant::now())));
    assert_eq!(counters.navigation_lost.get(), 3000 - 1024);
}

#[test]
fn a_file_that_cannot_fly_is_refused_by_its_field() {
    let path = Path::new("NAV.toml");
    let refused = |text: &str| {
        let settings = NavigationSettings::parse(path, text).unwrap();
        settings
            .for_flight(path, &Role::table_names())
            .unwrap_err()
            .to_string()
    };
    let camera = |name: &str, more: &str| {
        format!(
            "[[camera]]\nname = \"{name}\"\nbody_from_camera = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n{more}"
        )
    };
    let noise = "[imu]\nvelocity_random_walk = 1e-4\nangular_random_walk = 3e-6\n[gps]\nposition_sigma_m = 5\nvelocity_sigma_m_s = 0.05\n";
    assert!(refused(noise).contains("expected one named \"camera\""));
    assert!(refused("").contains("imu.velocity_random_walk: expected more than 0"));
    assert!(refused(&camera("pyas", "")).contains("one of camera, second_camera"));
    let loose = noise.to_owned() + &camera("camera", "misalignment_sigma_deg = 0.1\n");
    assert!(refused(&loose).contains("misalignment_sigma_deg: expected 0"));
}
