//! The path of a swinging gondola is more accurate than its frames, as far as the swing model allows, with calibrated
//! uncertainties.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use solaspect::smoothing::{Measurement, Moment, Path, SharedErrors, path};
use std::f64::consts::TAU;

/// Sigma of the independent error of a frame.
const OWN_SIGMA_MIL: f64 = 0.037;
/// Sigma of the mapping's error, correlated over `MAPPING_S` seconds.
const MAPPING_SIGMA_MIL: f64 = 0.008;
const MAPPING_S: f64 = 5.0;
const RATE_HZ: f64 = 4.0;
const FRAMES: usize = 1200;
const PERIODS_S: [f64; 2] = [12.3, 3.7];

type Axes = [f64; 2];

struct Random(Xoshiro256PlusPlus);

impl Random {
    fn new(seed: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }
}

fn time_s(frame: usize) -> f64 {
    frame as f64 / RATE_HZ
}

/// Undamped swings.
fn sines(time_s: f64) -> Axes {
    let swing =
        |mil: f64, phase: f64, which: usize| mil * (TAU * time_s / PERIODS_S[which] + phase).sin();
    [
        300.0 + swing(80.0, 0.4, 0) + swing(20.0, 1.0, 1),
        -150.0 + swing(60.0, 2.0, 0) + swing(15.0, 0.3, 1),
    ]
}

/// Pendulums damped within minutes and driven by the wind.
fn pendulums(seed: u64) -> Vec<Axes> {
    driven(seed, [300.0, 150.0], [0.01, 0.02])
}

/// Pendulums with damping times (s) and wind drive (mil/s^1.5), integrated in small steps.
fn driven(seed: u64, damping_s: [f64; 2], drive: [f64; 2]) -> Vec<Axes> {
    const STEPS: usize = 250;
    let mut random = Random::new(seed);
    let step_s = 1.0 / RATE_HZ / STEPS as f64;
    let mut states = [[(40.0, 10.0), (8.0, -5.0)], [(-30.0, 5.0), (3.0, 9.0)]];
    let mut flown = Vec::new();
    for n in 0..FRAMES * STEPS {
        if n % STEPS == 0 {
            flown.push(states.map(|swings| swings.iter().map(|(place, _)| place).sum()));
        }
        for swings in &mut states {
            for (k, (place, speed)) in swings.iter_mut().enumerate() {
                let rate = TAU / PERIODS_S[k];
                let force = -rate * rate * *place - 2.0 / damping_s[k] * *speed;
                *speed += force * step_s + drive[k] * step_s.sqrt() * random.normal();
                *place += *speed * step_s;
            }
        }
    }
    flown
}

/// Simulated measurements of a path by the frames.
fn measured(flown: &[Axes], seed: u64) -> Vec<Moment> {
    let mut random = Random::new(seed);
    let mut mapping = [0, 1].map(|_| random.normal() * MAPPING_SIGMA_MIL);
    let kept = (-1.0 / RATE_HZ / MAPPING_S).exp();
    let moment = |(n, truth): (usize, &Axes)| Moment {
        time_s: time_s(n),
        time_sigma_s: 0.0,
        measured: Some([0, 1].map(|axis| {
            let step = MAPPING_SIGMA_MIL * (1.0 - kept * kept).sqrt();
            mapping[axis] = kept * mapping[axis] + step * random.normal();
            Measurement {
                place: truth[axis] + mapping[axis] + OWN_SIGMA_MIL * random.normal(),
                variance: OWN_SIGMA_MIL.powi(2),
                shared_variance: MAPPING_SIGMA_MIL.powi(2),
            }
        })),
    };
    flown.iter().enumerate().map(moment).collect()
}

const SHARED: SharedErrors = SharedErrors {
    correlation_s: MAPPING_S,
    jumps_s: Vec::new(),
};

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), v| (sum + v * v, count + 1));
    (sum / f64::from(count)).sqrt()
}

/// Rms error (mil) and rms error over sigma, over both axes.
fn errors(path: &Path, flown: &[Axes]) -> (f64, f64) {
    let times: Vec<f64> = (0..flown.len()).map(time_s).collect();
    let points = path.anywhere(&times).unwrap();
    let both = || {
        points.iter().zip(flown).flat_map(|(p, truth)| {
            [0, 1].map(|axis| (p.place[axis] - truth[axis], p.variance[axis].sqrt()))
        })
    };
    (
        rms(both().map(|(error, _)| error)),
        rms(both().map(|(error, sigma)| error / sigma)),
    )
}

/// Rms over several flights of both results of [`errors`].
fn together(found: &[(f64, f64)]) -> (f64, f64) {
    (
        rms(found.iter().map(|f| f.0)),
        rms(found.iter().map(|f| f.1)),
    )
}

/// Rms error of a path modelled only by a random walk of the acceleration.
const WITHOUT_SWINGS_MIL: f64 = 0.034;

/// Rms error for a gondola at rest.
const RESTING_MIL: f64 = 0.026;

#[test]
fn a_swinging_gondola_is_smoothed_by_its_swings() {
    let ideal = |_| (0..FRAMES).map(|n| sines(time_s(n))).collect::<Vec<_>>();
    for (name, flown) in [
        ("sines", &ideal as &dyn Fn(u64) -> Vec<Axes>),
        ("pendulums", &pendulums),
    ] {
        let found: Vec<(f64, f64)> = (0..3)
            .map(|seed| {
                let flown = flown(seed);
                let path = path(measured(&flown, 100 + seed), SHARED).unwrap();
                println!(
                    "{name} {seed}: {:?} {:?}",
                    errors(&path, &flown),
                    path.swings
                );
                errors(&path, &flown)
            })
            .collect();
        let (error_mil, ratio) = together(&found);
        println!("{name}: rms {error_mil:.4} mil, error/sigma {ratio:.3}");
        assert!(error_mil < WITHOUT_SWINGS_MIL / 2.0, "{name}");
        assert!((0.9..1.1).contains(&ratio), "{name}");
    }
}

#[test]
fn a_gondola_at_rest_has_no_swings_and_loses_nothing() {
    for seed in 0..3 {
        let flown = vec![[300.0, -150.0]; FRAMES];
        let path = path(measured(&flown, 200 + seed), SHARED).unwrap();
        let (error_mil, ratio) = errors(&path, &flown);
        println!("rest {seed}: rms {error_mil:.4} mil, error/sigma {ratio:.3}");
        assert_eq!(path.swings, [vec![], vec![]]);
        assert!(error_mil < RESTING_MIL, "{error_mil}");
        assert!((0.9..1.1).contains(&ratio), "{ratio}");
    }
}

#[test]
fn between_frames_the_path_is_given_by_its_swings_and_not_in_long_gaps() {
    const PER_FRAME: usize = 12;
    let flown: Vec<Axes> = (0..FRAMES).map(|n| sines(time_s(n))).collect();
    let gap_s = time_s(600)..time_s(660);
    let times: Vec<f64> = (0..FRAMES * PER_FRAME)
        .map(|n| n as f64 / RATE_HZ / PER_FRAME as f64)
        .collect();
    let mut ratios = Vec::new();
    for seed in 300..304 {
        let mut moments = measured(&flown, seed);
        for moment in moments.iter_mut().filter(|m| gap_s.contains(&m.time_s)) {
            moment.measured = None;
        }
        let points = path(moments, SHARED).unwrap().at(&times);
        for (time_s, point) in times.iter().zip(points) {
            let before_s = gap_s.start - 1.0 / RATE_HZ;
            let in_gap = before_s < *time_s && *time_s < gap_s.end;
            let after = *time_s > self::time_s(FRAMES - 1);
            assert_eq!(point.is_none(), in_gap || after, "{time_s}");
            let Some(point) = point else { continue };
            let truth = sines(*time_s);
            ratios.extend(
                [0, 1].map(|axis| (point.place[axis] - truth[axis]) / point.variance[axis].sqrt()),
            );
        }
    }
    let largest = ratios
        .iter()
        .fold(0.0_f64, |most, ratio| most.max(ratio.abs()));
    let ratio = rms(ratios.into_iter());
    println!("between frames: error/sigma {ratio:.3}, largest {largest:.2}");
    assert!((0.8..1.25).contains(&ratio));
    assert!(largest < 6.0);
}

#[test]
fn a_damping_time_is_given_where_the_flight_determines_it_and_else_how_long_it_is_at_least() {
    let swings = |flown: &[Axes], seed: u64| path(measured(flown, seed), SHARED).unwrap().swings;
    let sines: Vec<Axes> = (0..FRAMES).map(|n| sines(time_s(n))).collect();
    for swing in swings(&sines, 400).iter().flatten() {
        assert_eq!(swing.damping_s, None, "{swing:?}");
        assert!(swing.damping_least_s > 100.0, "{swing:?}");
    }
    let damping_s = [25.0, 12.0];
    for seed in 0..2 {
        let found = swings(&driven(seed, damping_s, [2.0, 4.0]), 410 + seed);
        println!("{found:?}");
        for swing in found.iter().flatten() {
            let near = |period_s: &f64| (swing.period_s / period_s - 1.0).abs() < 0.1;
            let truth_s = damping_s[PERIODS_S.iter().position(near).unwrap()];
            let found_s = swing.damping_s.unwrap();
            assert!((0.4..2.5).contains(&(found_s / truth_s)), "{swing:?}");
            assert!(swing.damping_least_s < truth_s.min(found_s), "{swing:?}");
        }
        assert!(found.iter().flatten().next().is_some());
    }
}
