//! Flights of simulated sensors through the filter, at the speed of the computer.

use super::*;
use crate::config::{Config, Switch};
use crate::geometry::attitude::Direction;
use crate::instrument::{self, DEMO_NAVIGATION};
use crate::navigation::nmea::Nmea;
use crate::pointing::sun_in_telescope;
use crate::service::demo::JudgedOffset;
use crate::simulate::navigation::TelescopeFlight;
use crate::simulate::{FORT_SUMNER, SUN_RADIUS_ARCSEC, Trajectory};
use crate::units::{ARCSEC_PER_RAD, PlateMil};
use crossbeam_channel::unbounded;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;

const START: &str = "2013-09-21T18:00:00Z";
/// 1 sigma per axis of a frame's Sun.
const SUN_ARCSEC: f64 = 0.11;
const FRAMES_HZ: u64 = 4;

fn settings() -> Settings {
    let path = Path::new("NAV.toml");
    checked(path, Settings::parse(path, DEMO_NAVIGATION).unwrap()).unwrap()
}

fn navigator(config: Config, to_line: Sender<LinkEvent>) -> (Navigator, Receiver<NavigationRows>) {
    let (rows, kept) = unbounded();
    let mounting = instrument::builtin("demo").unwrap().mounting;
    let navigator = Navigator {
        settings: settings(),
        ephemeris: Ephemeris::default(),
        controls: Controls::new(config, crate::pointing::Target::default(), mounting),
        to_line,
        rows,
        tally: Shared::default(),
        ended: Arc::default(),
    };
    (navigator, kept)
}

fn sending() -> Config {
    let mut config = Config::default();
    config.navigation.send = Switch::On;
    config
}

/// What a flight's offsets by the gyros were worth.
#[derive(Debug, Default)]
struct Judged {
    offsets: usize,
    /// Of cross-elevation and elevation: errors in their sigmas, and in arcsec with their age.
    sigmas: Vec<f64>,
    arcsec: Vec<(f64, f64)>,
    roll_deg: Vec<f64>,
    status: Option<Status>,
}

impl Judged {
    fn beyond_3_sigma(&self) -> f64 {
        let beyond = self.sigmas.iter().filter(|sigmas| sigmas.abs() > 3.0);
        beyond.count() as f64 / self.sigmas.len() as f64
    }

    fn ratio(&self) -> f64 {
        rms(self.sigmas.iter().copied())
    }

    /// Of those whose last frame is so old, s.
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

/// Flies the simulated telescope. Frames show the Sun where `is_seen` says so of their time, and are solved 40 ms late; `spoil` may change what
/// the IMU says, or lose it.
fn fly(
    duration_s: u64,
    seed: u64,
    is_seen: impl Fn(f64) -> bool,
    mut spoil: impl FnMut(u64, ImuPacket) -> Option<ImuPacket>,
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
    let mut filter = Filter::new(&navigator, start);
    let mut receiver = Nmea::default();
    let mut judged = Judged::default();
    let (mut late, rate) = (VecDeque::new(), flown.rate_hz());
    for n in 1..=duration_s * rate {
        let since = Duration::from_millis(n * 1000 / rate);
        if n % rate == 0 {
            let sentences = flown.sentences(n / rate).unwrap();
            for fix in receiver.feed(sentences.as_bytes()) {
                filter.fix(&fix);
            }
        }
        if n % (rate / FRAMES_HZ) == 0 && is_seen(since.as_secs_f64()) {
            let sun = flown.sun_on_plate(since);
            let sigma_mil = SUN_ARCSEC / instrument.optics.arcsec_per_mil();
            let sun = PlateMil::new(sun.x + sigma_mil * normal(), sun.y + sigma_mil * normal());
            let unit = sun_in_telescope(sun, &instrument);
            late.push_back((
                n + 4,
                Seen {
                    seat: Seat::PitchYaw,
                    target: Target::Sun,
                    utc: start + SignedDuration::try_from(since).unwrap(),
                    direction: Direction::new(unit, SUN_ARCSEC / ARCSEC_PER_RAD),
                },
            ));
        }
        while late.front().is_some_and(|(due, _)| *due <= n) {
            filter.seen(&late.pop_front().unwrap().1);
        }
        if let Some(sample) = spoil(n, flown.sample(n).unwrap()) {
            filter.sample(&sample, Instant::now());
        }
        for event in line.try_iter() {
            if let LinkEvent::Propagated(event) = event {
                judged.note(&event.propagated, &mut flown, start);
            }
        }
    }
    judged.status = navigator.tally.copy().status;
    let tally = navigator.tally.copy();
    (judged, tally)
}

impl Judged {
    /// Holds an offset against the flight's own attitude.
    fn note(&mut self, said: &Propagated, flown: &mut TelescopeFlight, start: Timestamp) {
        let judged = JudgedOffset::of(said, flown, start).unwrap();
        for error_arcsec in judged.error_arcsec {
            self.sigmas.push(error_arcsec / judged.sigma_arcsec);
            self.arcsec.push((judged.age_s, error_arcsec));
        }
        self.roll_deg.push(said.solution.roll_deg);
        self.offsets += 1;
    }
}

#[test]
fn offsets_between_frames_and_through_gaps_are_as_certain_as_they_say() {
    let is_seen = |t_s: f64| !(100.0..160.0).contains(&t_s) && !(240.0..360.0).contains(&t_s);
    let (judged, tally) = fly(420, 1, is_seen, |_, sample| Some(sample));
    println!(
        "{} offsets, beyond 3 sigma {:.4}, error/sigma {:.2}, arcsec {:.3} fresh, {:.2} at 50-60 s, {:.2} at 110-120 s, roll {:.4} deg; {tally:?}",
        judged.offsets,
        judged.beyond_3_sigma(),
        judged.ratio(),
        judged.rms_arcsec(0.0..0.4),
        judged.rms_arcsec(50.0..60.0),
        judged.rms_arcsec(110.0..120.1),
        rms(judged.roll_deg.iter().copied()),
    );
    assert!(judged.offsets > 8000);
    assert!(judged.beyond_3_sigma() < 0.01);
}
