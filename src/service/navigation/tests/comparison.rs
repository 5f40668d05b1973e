//! Comparison of cameras with gyros: flights of a telescope that swings, with Sun and horizon, whose directions are shifted for a while.

use super::*;
use crate::geometry::earth::ecef_m;
use crate::instrument::Instrument;
use crate::navigation::{Agreement, Axis};
use crate::simulate::Gondola;
use nalgebra::UnitVector3;
use std::ops::Range;

/// Error of the nadir, 1 sigma, in each of its two angles.
const NADIR_DEG: f64 = 0.02;
/// Delay of answers, in samples of the IMU.
const LATE: u64 = 4;
const FRAME_S: f64 = 1.0 / FRAMES_HZ as f64;

const OTHER_CAMERAS: &str = r#"
[[camera]]
name = "second_camera"
body_from_camera = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
[[camera]]
name = "roll_camera"
body_from_camera = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
"#;

/// The cameras, in the order of [`navigator`].
const SUN: usize = 0;
const SECOND_SUN: usize = 1;
const HORIZON: usize = 2;

/// Shift of a camera's directions along the telescope's right, for a time.
struct Moved {
    camera: usize,
    rad: f64,
    time_s: Range<f64>,
}

impl Moved {
    fn sun(arcsec: f64, time_s: Range<f64>) -> Self {
        Self {
            camera: SUN,
            rad: arcsec / ARCSEC_PER_RAD,
            time_s,
        }
    }
}

/// State after each sample of the IMU.
struct Known {
    t_s: f64,
    agreement: Option<Agreement>,
    status: Option<Status>,
}

#[derive(Default)]
struct Compared {
    known: Vec<Known>,
    /// The differences of each axis, in sigmas.
    sigmas: [Vec<f64>; 3],
    /// Time at which each axis was compared last, s.
    compared_s: [Option<f64>; 3],
    tally: NavigationTally,
}

impl Compared {
    fn note(&mut self, t_s: f64, filter: &Filter, tally: &NavigationTally) {
        for (axis, _, one) in filter.live.comparison().latest() {
            let last_s = &mut self.compared_s[axis as usize];
            if last_s.is_none_or(|last_s| one.t_s > last_s) {
                *last_s = Some(one.t_s);
                self.sigmas[axis as usize].push(one.sigmas);
            }
        }
        self.known.push(Known {
            t_s,
            agreement: tally.agreement,
            status: tally.status,
        });
    }

    /// First and last time at which the comparison had this agreement, s.
    fn span_s(&self, agreement: Agreement) -> Option<(f64, f64)> {
        let is_so = |known: &&Known| known.agreement == Some(agreement);
        let first = self.known.iter().find(is_so)?;
        let last = self.known.iter().rfind(is_so)?;
        Some((first.t_s, last.t_s))
    }
}

/// The nadir in the telescope's axes; its cameras measure the direction to the Earth's centre.
fn nadir(flown: &mut TelescopeFlight, since: Duration) -> UnitVector3<f64> {
    let down = UnitVector3::new_normalize(-ecef_m(&FORT_SUMNER));
    flown.attitude(since).unwrap().inverse() * down
}

/// A camera's frame, without error but with its sigma.
fn shown(
    camera: usize,
    flown: &mut TelescopeFlight,
    since: Duration,
    instrument: &Instrument,
) -> ObservedDirection {
    let (target, unit, sigma_rad) = match camera {
        HORIZON => {
            let sigma_rad = NADIR_DEG.to_radians();
            (Target::Nadir, nadir(flown, since), sigma_rad)
        }
        _ => {
            let sun = sun_in_telescope(flown.sun_on_plate(since), instrument);
            (Target::Sun, sun, SUN_ARCSEC / ARCSEC_PER_RAD)
        }
    };
    seen(camera, target, since, Direction::new(unit, sigma_rad))
}

/// Flies a telescope that swings with its gondola. At 4 Hz its cameras observe the Sun, at times for which `is_seen` is true, and the nadir.
fn fly_compared(
    duration_s: u64,
    seed: u64,
    cameras: &[usize],
    is_seen: impl Fn(f64) -> bool,
    moved: &Moved,
) -> Compared {
    let start: Timestamp = START.parse().unwrap();
    let instrument = instrument::builtin("demo").unwrap();
    let radius_mil = instrument.optics.radius_mil(SUN_RADIUS_ARCSEC);
    let course = Trajectory::flight(&instrument, radius_mil, seed).unwrap();
    let flown = TelescopeFlight::new(course, &instrument, FORT_SUMNER, start, seed);
    let mut flown = flown.on(Gondola::Swinging);
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut normal = move || random.sample::<f64, _>(StandardNormal);
    let (to_line, _line) = unbounded();
    let (mut navigator, _rows) = navigator(Config::default(), to_line);
    let path = Path::new("NAV.toml");
    let toml = DEMO_NAVIGATION.to_owned() + OTHER_CAMERAS;
    navigator.settings = NavigationSettings::parse(path, &toml).unwrap();
    let mut filter = Filter::new(&navigator, start);
    let mut receiver = Nmea::default();
    let mut late = VecDeque::new();
    let mut compared = Compared::default();
    let rate = flown.rate_hz();
    for n in 1..=duration_s * rate {
        let since = Duration::from_millis(n * 1000 / rate);
        let t_s = since.as_secs_f64();
        if n % rate == 0 {
            let sentences = flown.sentences(n / rate).unwrap();
            fixes(&mut receiver, &sentences)
                .iter()
                .for_each(|fix| filter.fix(fix));
        }
        for camera in cameras.iter().filter(|_| n % (rate / FRAMES_HZ) == 0) {
            let mut shown = shown(*camera, &mut flown, since, &instrument);
            if shown.target == Target::Sun && !is_seen(t_s) {
                continue;
            }
            let sigma_rad = shown.direction.sigma_rad();
            let mut error = Vector3::from_fn(|_, _| sigma_rad * normal());
            if *camera == moved.camera && moved.time_s.contains(&t_s) {
                error.y += moved.rad;
            }
            let unit = UnitVector3::new_normalize(shown.direction.unit.into_inner() + error);
            shown.direction = Direction::new(unit, sigma_rad);
            late.push_back((n + LATE, shown));
        }
        while late.front().is_some_and(|(due, _)| *due <= n) {
            filter.direction(&late.pop_front().unwrap().1);
        }
        filter.sample(&flown.sample(n).unwrap(), Instant::now());
        compared.note(t_s, &filter, &navigator.tally.lock());
    }
    compared.tally = navigator.tally.copy();
    compared
}

fn near(found_s: f64, expected_s: f64) -> bool {
    let late_s = LATE as f64 / 100.0;
    (found_s - expected_s - late_s).abs() < 0.011
}

/// Flies with normal errors. At most this number of single differences are beyond 5 sigma.
fn fly_clean(duration_s: u64, seeds: u64, most_beyond: usize) {
    let never = Moved::sun(0.0, 0.0..0.0);
    let mut sigmas: [Vec<f64>; 3] = Default::default();
    for seed in 1..=seeds {
        let cameras = [SUN, HORIZON];
        let compared = fly_compared(duration_s, seed, &cameras, with_gaps, &never);
        let lasting = compared.span_s(Agreement::LastingContradiction);
        assert_eq!(
            (
                lasting,
                compared.tally.contradicted,
                compared.tally.restarts
            ),
            (None, 0, 0),
            "{seed}"
        );
        for (all, own) in sigmas.iter_mut().zip(compared.sigmas) {
            all.extend(own);
        }
    }
    let beyond = sigmas.iter().flatten().filter(|sigmas| sigmas.abs() > 5.0);
    let beyond = beyond.count();
    assert!(beyond <= most_beyond, "{beyond}");
    for (axis, sigmas) in Axis::ALL.into_iter().zip(sigmas) {
        let (count, rms) = (sigmas.len(), rms(sigmas.into_iter()));
        println!("{}: {count} differences, rms {rms:.3} sigma", axis.name());
        assert!(count as u64 > 3 * duration_s * seeds, "{axis:?}: {count}");
        assert!((0.8..1.25).contains(&rms), "{axis:?}: {rms}");
    }
}

#[test]
fn cameras_and_gyros_of_a_clean_flight_agree_in_its_whole_length_by_their_own_sigmas() {
    fly_clean(600, 4, 0);
}

/// The full size: an hour each. Of a million normal differences 0.6 are expected beyond 5 sigma; more than four have a
/// probability of 1 in 2,500.
#[test]
#[ignore = "minutes"]
fn cameras_and_gyros_of_an_hour_agree_in_its_whole_length_by_their_own_sigmas() {
    fly_clean(3600, 24, 4);
}

#[test]
fn a_sun_that_is_moved_contradicts_the_gyros_after_10_s_and_until_the_first_frame_that_is_not() {
    for (seed, arcsec) in [(1, 100.0), (2, -100.0)] {
        let cameras = [SUN, HORIZON];
        let moved = Moved::sun(arcsec, 60.0..90.0);
        let compared = fly_compared(150, seed, &cameras, |_| true, &moved);
        let (begin_s, beyond_s) = compared.span_s(Agreement::Beyond).unwrap();
        let (found_s, over_s) = compared.span_s(Agreement::LastingContradiction).unwrap();
        println!("beyond {begin_s} to {beyond_s}, found {found_s} to {over_s}");
        assert!(near(begin_s, 60.0) && near(found_s, 70.0));
        assert!(beyond_s < found_s && near(over_s + 0.01, 90.0));
        assert_eq!(compared.tally.contradicted, 1);
        assert_eq!(compared.tally.agreement, Some(Agreement::Within));
        let first = compared.sigmas[Axis::Right as usize]
            .iter()
            .find(|sigmas| sigmas.abs() > 5.0)
            .unwrap();
        assert_eq!(first.signum(), arcsec.signum());
        let up = compared.sigmas[Axis::Up as usize].iter();
        assert!(up.map(|sigmas| sigmas.abs()).fold(0.0, f64::max) < 5.0);
        // The filter's own doubt begins with the shift, and ends before the contradiction is found: the filter has followed the camera.
        let doubted = |known: &&Known| known.status == Some(Status::Contradicted);
        let first_s = compared.known.iter().find(doubted).unwrap().t_s;
        assert_eq!(first_s, begin_s);
        let at_found = compared.known.iter().find(|known| known.t_s >= found_s);
        assert_eq!(at_found.unwrap().status, Some(Status::Aligned));
    }
}

#[test]
fn a_sun_that_is_moved_for_less_than_10_s_is_no_lasting_contradiction() {
    let moved = Moved::sun(100.0, 60.0..69.9);
    let compared = fly_compared(100, 3, &[SUN, HORIZON], |_| true, &moved);
    assert!(compared.span_s(Agreement::Beyond).is_some());
    assert_eq!(compared.span_s(Agreement::LastingContradiction), None);
    assert_eq!(compared.tally.contradicted, 0);
}

#[test]
fn a_camera_that_stays_moved_is_compared_with_what_the_filter_has_made_of_it_after_ten_minutes() {
    // The uncertainty of the gyros' own drift would hide 100 arcsec before that.
    let moved = Moved::sun(2000.0, 60.0..f64::INFINITY);
    let compared = fly_compared(700, 4, &[SUN, HORIZON], |_| true, &moved);
    let (found_s, _) = compared.span_s(Agreement::LastingContradiction).unwrap();
    assert!(near(found_s, 70.0));
    let at = |t_s: f64| {
        let mut known = compared.known.iter();
        known.find(|known| known.t_s >= t_s).unwrap().agreement
    };
    assert_eq!(at(659.9), Some(Agreement::LastingContradiction));
    // Later slews may show again that the camera is turned.
    assert_eq!(at(660.0 + 2.0 * FRAME_S), Some(Agreement::Within));
}

#[test]
fn a_horizon_that_is_moved_contradicts_the_roll_though_the_filter_begins_anew() {
    let moved = Moved {
        camera: HORIZON,
        rad: 0.5f64.to_radians(),
        time_s: 60.0..90.0,
    };
    let compared = fly_compared(120, 5, &[SUN, HORIZON], |_| true, &moved);
    let (found_s, over_s) = compared.span_s(Agreement::LastingContradiction).unwrap();
    println!("found {found_s} to {over_s}; {:?}", compared.tally);
    assert!(compared.tally.restarts > 0);
    assert!(near(found_s, 70.0) && near(over_s + 0.01, 90.0));
}

#[test]
fn one_of_two_cameras_that_is_moved_is_found_beside_one_that_agrees() {
    let moved = Moved {
        camera: SECOND_SUN,
        ..Moved::sun(100.0, 60.0..90.0)
    };
    let cameras = [SUN, SECOND_SUN, HORIZON];
    let compared = fly_compared(120, 6, &cameras, |_| true, &moved);
    let (found_s, over_s) = compared.span_s(Agreement::LastingContradiction).unwrap();
    println!("found {found_s} to {over_s}; {:?}", compared.tally);
    assert!(near(found_s, 70.0) && near(over_s + 0.01, 90.0));
}
