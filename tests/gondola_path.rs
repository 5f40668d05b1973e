//! The path of a gondola that rests, swings, slews and steps is determined with calibrated uncertainties, whatever it does
//! next.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use solaspect::smoothing::{Measurement, Moment, PathPoint, SharedErrors, path};
use std::f64::consts::TAU;

const SIGMA_MIL: f64 = 0.1;
/// 0.25 deg/s.
const SLEW_MIL_PER_S: f64 = 515.0;

/// Motion of the gondola during a part of the flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Segment {
    Rest,
    Swing,
    /// Slews that start and stop instantly.
    Slew,
    /// A slew that accelerates and decelerates smoothly.
    SmoothSlew,
    /// Jumps from one position to another between two frames.
    Steps,
    /// A random jolt at every frame.
    Wind,
    Tremble,
    /// A swing in which 30 % of the frames are missing.
    Holes,
    /// A swing with three seconds of missing frames.
    Gap,
    /// The Sun leaves the sensor and comes back.
    Gone,
}

use Segment::{Gap, Gone, Holes, Rest, Slew, SmoothSlew, Steps, Swing, Tremble, Wind};

/// The truth at a moment: at a frame, or half-way between two.
struct Truth {
    time_s: f64,
    at_mil: [f64; 2],
    segment: usize,
    /// Whether a frame shows the Sun at this moment.
    seen: bool,
}

fn flight(segments: &[(Segment, f64)], rate_hz: f64, seed: u64) -> Vec<Truth> {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let (mut flown, mut begin_s, mut begin_mil) = (Vec::new(), 0.0, [0.0; 2]);
    for (n, (segment, length_s)) in segments.iter().enumerate() {
        let mut at_mil: [f64; 2] = begin_mil;
        let (mut until_s, mut speed, mut jolted) = (0.0, [0.0; 2], [0.0; 2]);
        for half_step in 0..(2.0 * length_s * rate_hz) as usize {
            let (time_s, is_frame) = (half_step as f64 / (2.0 * rate_hz), half_step % 2 == 0);
            let part = time_s / length_s;
            let swing = |mil: f64, period_s: f64| mil * (TAU * time_s / period_s).sin();
            let slow = [swing(80.0, 12.3), swing(-60.0, 13.1)];
            let mut away = [0.0; 2];
            let mut seen = is_frame;
            match segment {
                Rest => {}
                Swing => away = [slow[0] + swing(20.0, 3.7), slow[1] + swing(15.0, 4.1)],
                Slew if time_s >= until_s => {
                    until_s = time_s + rng.random_range(1.0..4.0);
                    let towards: f64 = rng.random_range(0.0..TAU);
                    speed = match speed == [0.0; 2] {
                        true => [towards.cos(), towards.sin()].map(|v| v * SLEW_MIL_PER_S),
                        false => [0.0; 2],
                    };
                }
                Slew => {}
                SmoothSlew => {
                    let done = part - (TAU * part).sin() / TAU;
                    away = [900.0 * done, -500.0 * done];
                }
                Steps if time_s >= until_s => {
                    until_s = time_s + rng.random_range(1.0..6.0);
                    at_mil = at_mil.map(|v| v + rng.random_range(-300.0..300.0));
                }
                Steps => {}
                Wind => {
                    if is_frame {
                        jolted = jolted.map(|v| 0.9 * v + rng.random_range(-3.0..3.0));
                    }
                    away = jolted;
                }
                Tremble => away = [swing(10.0, 1.1), swing(5.0, 0.7)],
                Holes => {
                    away = slow;
                    seen &= rng.random_range(0.0..1.0) > 0.3;
                }
                Gap => {
                    away = slow;
                    seen &= !(0.4 * length_s..0.4 * length_s + 3.0).contains(&time_s);
                }
                Gone => {
                    away[1] = 1250.0 * (1.0 - (TAU * part).cos());
                    seen &= !(0.2..0.8).contains(&part);
                }
            }
            at_mil = [0, 1].map(|axis| at_mil[axis] + speed[axis] / (2.0 * rate_hz));
            begin_mil = [0, 1].map(|axis| at_mil[axis] + away[axis]);
            flown.push(Truth {
                time_s: begin_s + time_s,
                at_mil: begin_mil,
                segment: n,
                seen,
            });
        }
        begin_s += length_s;
    }
    flown
}

fn measured(flown: &[Truth], seed: u64) -> Vec<Moment> {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut noisy = |v: f64| {
        let error: f64 = StandardNormal.sample(&mut rng);
        Measurement {
            place: v + SIGMA_MIL * error,
            variance: SIGMA_MIL.powi(2),
            shared_variance: 0.0,
        }
    };
    let moment = |truth: &Truth| Moment {
        time_s: truth.time_s,
        time_sigma_s: 0.0,
        measured: truth.seen.then(|| truth.at_mil.map(&mut noisy)),
    };
    flown.iter().map(moment).collect()
}

/// Errors of the path in both axes, in mil and in sigmas.
#[derive(Default)]
struct Errors {
    mil: Vec<f64>,
    ratios: Vec<f64>,
}

impl Errors {
    fn of(path: &[PathPoint], flown: &[Truth], wanted: impl Fn(usize) -> bool) -> Self {
        let mut errors = Self::default();
        for n in (0..flown.len()).filter(|n| wanted(*n)) {
            for axis in 0..2 {
                let error = path[n].place[axis] - flown[n].at_mil[axis];
                errors.mil.push(error);
                errors.ratios.push(error / path[n].variance[axis].sqrt());
            }
        }
        errors
    }

    fn largest_ratio(&self) -> f64 {
        self.ratios
            .iter()
            .fold(0.0, |most, ratio| ratio.abs().max(most))
    }
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// The smoothed path at each moment.
fn points(moments: &[Moment]) -> Vec<PathPoint> {
    let times: Vec<f64> = moments.iter().map(|moment| moment.time_s).collect();
    let path = path(moments.iter().copied(), SharedErrors::default()).unwrap();
    path.anywhere(&times).unwrap()
}

/// Simulates the segments and compares the path with the truth in each.
fn judge(segments: &[(Segment, f64)], rate_hz: f64, seed: u64) {
    let flown = flight(segments, rate_hz, seed);
    let moments = measured(&flown, seed + 1);
    let path = points(&moments);
    for (n, (segment, _)) in segments.iter().enumerate() {
        let name = format!("{rate_hz} Hz, seed {seed}, {n}: {segment:?}");
        let errors = |seen: bool| {
            Errors::of(&path, &flown, |m| {
                flown[m].segment == n && flown[m].seen == seen
            })
        };
        let (at_frames, between) = (errors(true), errors(false));
        let (error_mil, ratio) = (rms(&at_frames.mil), rms(&at_frames.ratios));
        println!(
            "{name}: rms {error_mil:.4} mil, error/sigma {ratio:.3}, largest {:.2}, between frames {:.2}",
            at_frames.largest_ratio(),
            between.largest_ratio()
        );
        assert!((0.8..1.25).contains(&ratio), "{name}");
        assert!(at_frames.largest_ratio() < 6.0, "{name}");
        // The motion between a jolt at a frame and the next frame is not defined, so it is not compared.
        assert!(*segment == Wind || between.largest_ratio() < 7.0, "{name}");
        let own = (0..flown.len()).filter(|m| flown[*m].segment == n);
        let own = own.filter_map(|m| Some((moments[m].measured?, flown[m].at_mil)));
        let own: Vec<f64> = own
            .flat_map(|(seen, truth)| [0, 1].map(|axis| seen[axis].place - truth[axis]))
            .collect();
        // Comparing the errors with the measurements' own needs two axes of 200 frames.
        assert!(own.len() < 400 || error_mil <= rms(&own), "{name}");
    }
}

#[test]
fn the_path_is_known_as_well_as_it_says_in_rest_swing_slew_steps_and_gaps() {
    let minute = |segment| (segment, 60.0);
    let slow = [
        Rest, Swing, Slew, Rest, Steps, Wind, Tremble, Holes, Slew, Swing,
    ];
    let slow: Vec<_> = slow.map(minute).into();
    let gaps = [
        (Swing, 30.0),
        (Gap, 20.0),
        (SmoothSlew, 30.0),
        (Gone, 20.0),
        (Rest, 30.0),
        (Gap, 20.0),
    ];
    for seed in [3, 4] {
        judge(&[&slow[..], &gaps].concat(), 4.0, seed);
    }
    let fast = [Rest, Slew, Swing, Steps, Holes].map(|segment| (segment, 12.0));
    judge(&[&fast[..], &gaps[2..4]].concat(), 26.0, 5);
}

#[test]
fn where_nothing_was_seen_the_sigma_grows_with_the_gap() {
    let flown = flight(&[(Swing, 30.0), (Gap, 20.0), (Swing, 30.0)], 4.0, 7);
    let path = points(&measured(&flown, 8));
    let sigma = |time_s: f64| {
        let n = flown.partition_point(|truth| truth.time_s < time_s);
        path[n].variance[0].sqrt()
    };
    let (frame, early, middle) = (sigma(30.0), sigma(38.25), sigma(39.5));
    assert!(frame < SIGMA_MIL, "{frame}");
    assert!(
        early > 2.0 * SIGMA_MIL && middle > 2.0 * early,
        "{early} {middle}"
    );
}

#[test]
fn a_path_without_a_measured_moment_is_none() {
    let nothing = Moment {
        time_s: 0.0,
        time_sigma_s: 0.0,
        measured: None,
    };
    assert_eq!(path([nothing; 3], SharedErrors::default()), None);
}
