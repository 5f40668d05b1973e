//! UTC compared with the monotonic clock of the same computer, which never steps.
//!
//! UTC minus the monotonic time is a straight line, whose slope is the drift between the two; where it jumps between successive
//! frames, the clock was set. The longest run without a step is believed, and so is every run that agrees with it; the times
//! of the others are corrected to it.
//!
//! A computer that reboots restarts its monotonic clock. Frames that are not consecutive on the monotonic clock are
//! assigned to different boots; the times of different boots are not compared.

use crate::estimation::{median_and_scatter, regression};
use crate::units::Measured;
use nalgebra::Vector2;
use serde::Serialize;
use std::ops::Range;

/// UTC has made a step if it changes by more than this between successive frames, s, plus the gain of a slewed clock in
/// a second (adjtimex(2): 500 parts in a million).
const LEAST_STEP_S: f64 = 0.02;
const SLEWED: f64 = 1e-3;
/// Frames this far apart on the monotonic clock are not consecutive, s.
const LONGEST_PAUSE_S: f64 = 60.0;
/// If a larger part of the frames begins with a step, two boots of the computer overlap on the monotonic clock, or it has
/// no meaning as a time.
const MOST_STEPS: f64 = 0.2;
/// The offsets of two boots differ by more than this, s.
const OTHER_START_S: f64 = 30.0;
/// Fewer frames, or a shorter time, do not determine a drift.
const LEAST_READINGS: usize = 20;
const LEAST_DRIFT_S: f64 = 10.0;
/// Largest drift of a crystal, assumed where it was not measured.
const UNKNOWN_DRIFT: f64 = 1e-4;
/// Runs that differ by less than this many sigma, or by less than the least step, agree.
const AGREE_SIGMAS: f64 = 5.0;

/// Both clocks at a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    pub utc_ns: i64,
    pub monotonic_s: f64,
}

impl Reading {
    pub fn of(utc_ns: Option<i64>, monotonic_s: Option<f64>) -> Option<Self> {
        Some(Self {
            utc_ns: utc_ns?,
            monotonic_s: monotonic_s?,
        })
    }
}

/// A time with its correction applied.
pub fn corrected_ns(utc_ns: i64, correction_s: &Measured) -> i64 {
    utc_ns + (correction_s.value * 1e9).round() as i64
}

/// A step of UTC.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ClockStep<Frame> {
    /// The first frame after the step.
    #[serde(rename = "file")]
    pub frame: Frame,
    pub step_s: Measured,
}

/// Findings on the clocks of a flight.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Clocks {
    /// Steps, in the order of the monotonic clock.
    pub steps: Vec<ClockStep<usize>>,
    /// Gain of UTC on the monotonic clock, s per s, from the longest boot; none if all boots were too short.
    pub drift: Option<Measured>,
    /// Correction of each frame's UTC, s; none where the clock is believed.
    pub corrections_s: Vec<Option<Measured>>,
    /// Whether each frame belongs to a boot in which the clocks can be compared.
    pub confirmed: Vec<bool>,
}

impl Clocks {
    /// Compares the clocks of frames in any order; frames without both clocks are ignored.
    pub fn of(readings: &[Option<Reading>]) -> Self {
        let mut clocks = Self {
            corrections_s: vec![None; readings.len()],
            confirmed: vec![false; readings.len()],
            ..Self::default()
        };
        let Some(first_ns) = readings.iter().flatten().map(|r| r.utc_ns).min() else {
            return clocks;
        };
        let moment = |(frame, reading): (usize, &Option<Reading>)| {
            let reading = (*reading)?;
            let monotonic_s = reading.monotonic_s;
            let ahead_s = (reading.utc_ns - first_ns) as f64 / 1e9 - monotonic_s;
            Some(Moment {
                frame,
                monotonic_s,
                ahead_s,
            })
        };
        let mut moments: Vec<Moment> = readings.iter().enumerate().filter_map(moment).collect();
        moments.sort_by(|a, b| a.monotonic_s.total_cmp(&b.monotonic_s));
        let mut longest_s = 0.0;
        for start in boots(&moments) {
            let length_s = start[start.len() - 1].monotonic_s - start[0].monotonic_s;
            let drift = clocks.take_start(&start);
            if length_s > longest_s && drift.is_some() {
                (clocks.drift, longest_s) = (drift, length_s);
            }
        }
        clocks
    }

    /// Checks one boot; returns the drift, if it is determined.
    fn take_start(&mut self, moments: &[Moment]) -> Option<Measured> {
        for moment in moments {
            self.confirmed[moment.frame] = true;
        }
        let runs = runs(moments);
        let length_s =
            |run: &Range<usize>| moments[run.end - 1].monotonic_s - moments[run.start].monotonic_s;
        let longest =
            (0..runs.len()).max_by(|a, b| length_s(&runs[*a]).total_cmp(&length_s(&runs[*b])))?;
        let drift = drift(&moments[runs[longest].clone()]);
        let fitted = drift.unwrap_or(Measured::new(0.0, UNKNOWN_DRIFT));
        let offsets: Vec<Offset> = runs
            .iter()
            .map(|run| Offset::of(&moments[run.clone()], fitted.value))
            .collect();
        for n in 1..runs.len() {
            let step_s = offsets[n].from(&offsets[n - 1], fitted.sigma);
            let frame = moments[runs[n].start].frame;
            self.steps.push(ClockStep { frame, step_s });
        }
        for (run, offset) in runs.iter().zip(&offsets) {
            let ahead = offset.from(&offsets[longest], fitted.sigma);
            if ahead.value.abs() < LEAST_STEP_S.max(AGREE_SIGMAS * ahead.sigma) {
                continue;
            }
            for moment in &moments[run.clone()] {
                self.corrections_s[moment.frame] = Some(Measured::new(-ahead.value, ahead.sigma));
            }
        }
        drift
    }
}

/// A frame on the monotonic clock.
#[derive(Debug, Clone, Copy)]
struct Moment {
    frame: usize,
    monotonic_s: f64,
    /// UTC minus the monotonic time, up to a constant.
    ahead_s: f64,
}

/// Whether UTC steps between two successive moments.
fn is_step(pair: &[Moment]) -> bool {
    let passed_s = pair[1].monotonic_s - pair[0].monotonic_s;
    (pair[1].ahead_s - pair[0].ahead_s).abs() > LEAST_STEP_S + SLEWED * passed_s
}

/// Splits moments into boots, in the order of the monotonic clock.
fn boots(moments: &[Moment]) -> Vec<Vec<Moment>> {
    let mut apart = vec![moments.to_vec()];
    if steps(moments) > most_steps(moments) {
        let mut by_offset = moments.to_vec();
        by_offset.sort_by(|a, b| a.ahead_s.total_cmp(&b.ahead_s));
        let near = by_offset.chunk_by(|a, b| b.ahead_s - a.ahead_s < OTHER_START_S);
        apart = near.map(<[Moment]>::to_vec).collect();
    }
    let pauses = |mut moments: Vec<Moment>| {
        moments.sort_by(|a, b| a.monotonic_s.total_cmp(&b.monotonic_s));
        let following = moments.chunk_by(|a, b| b.monotonic_s - a.monotonic_s < LONGEST_PAUSE_S);
        following.map(<[Moment]>::to_vec).collect::<Vec<_>>()
    };
    let boots = apart.into_iter().flat_map(pauses);
    boots
        .filter(|moments| steps(moments) <= most_steps(moments))
        .collect()
}

fn steps(moments: &[Moment]) -> usize {
    moments.windows(2).filter(|pair| is_step(pair)).count()
}

/// Greatest number of steps; with more the two clocks are unrelated.
fn most_steps(moments: &[Moment]) -> usize {
    ((MOST_STEPS * moments.len() as f64) as usize).max(2)
}

/// Runs of moments without a step.
fn runs(moments: &[Moment]) -> Vec<Range<usize>> {
    let mut runs = Vec::new();
    let mut start = 0;
    for end in 1..=moments.len() {
        if end == moments.len() || is_step(&moments[end - 1..=end]) {
            runs.push(start..end);
            start = end;
        }
    }
    runs
}

/// The slope of a run: gain of UTC, s per s.
fn drift(run: &[Moment]) -> Option<Measured> {
    let middle = run[run.len() / 2];
    let length_s = run[run.len() - 1].monotonic_s - run[0].monotonic_s;
    if run.len() < LEAST_READINGS || length_s < LEAST_DRIFT_S {
        return None;
    }
    let terms = run
        .iter()
        .map(|m| Vector2::new(1.0, m.monotonic_s - middle.monotonic_s));
    let ahead = run.iter().map(|m| m.ahead_s - middle.ahead_s);
    let (terms, ahead): (Vec<_>, Vec<_>) = (terms.collect(), ahead.collect());
    let line = regression(&terms, &ahead, &vec![1.0; run.len()]).ok()?;
    Some(line.measured(1))
}

/// UTC minus the monotonic time of a run, drift removed, at its middle.
struct Offset {
    ahead_s: Measured,
    middle_s: f64,
}

impl Offset {
    fn of(run: &[Moment], drift: f64) -> Self {
        let ahead = |m: &Moment| m.ahead_s - drift * m.monotonic_s;
        let all: Vec<f64> = run.iter().map(ahead).collect();
        let (value, scatter) = median_and_scatter(&all).unwrap_or_default();
        Self {
            ahead_s: Measured::new(value, scatter / (run.len() as f64).sqrt()),
            middle_s: (run[0].monotonic_s + run[run.len() - 1].monotonic_s) / 2.0,
        }
    }

    /// Lead of this run over another.
    fn from(&self, other: &Self, drift_sigma: f64) -> Measured {
        let by_drift = drift_sigma * (self.middle_s - other.middle_s);
        let sigma = self
            .ahead_s
            .sigma
            .hypot(other.ahead_s.sigma)
            .hypot(by_drift);
        Measured::new(self.ahead_s.value - other.ahead_s.value, sigma)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DRIFT: f64 = 3e-5;

    /// Frames at 4 Hz whose clock is ahead by the given time.
    fn readings(
        frames: usize,
        booted_s: f64,
        ahead_s: impl Fn(usize) -> f64,
    ) -> Vec<Option<Reading>> {
        let reading = |n: usize| {
            let since_s = n as f64 / 4.0;
            let jitter_s = 1e-5 * (n * 7919 % 11) as f64;
            let utc_s = since_s * (1.0 + DRIFT) + ahead_s(n) + jitter_s;
            Some(Reading {
                utc_ns: 1_379_786_400_000_000_000 + (utc_s * 1e9) as i64,
                monotonic_s: booted_s + since_s,
            })
        };
        (0..frames).map(reading).collect()
    }

    fn is_near(found: Measured, truth: f64) -> bool {
        (found.value - truth).abs() < 5.0 * found.sigma && found.sigma < 1e-3
    }

    #[test]
    fn a_clock_that_never_steps_is_believed_and_its_drift_measured() {
        let mut readings = readings(400, 1000.0, |_| 0.0);
        readings[7] = None;
        let clocks = Clocks::of(&readings);
        assert!(clocks.steps.is_empty());
        assert!(clocks.corrections_s.iter().all(Option::is_none));
        let drift = clocks.drift.unwrap();
        assert!((drift.value - DRIFT).abs() < 5.0 * drift.sigma, "{drift:?}");
        assert_eq!(Clocks::of(&[]), Clocks::default());
    }

    #[test]
    fn between_two_steps_the_times_are_corrected() {
        for step_s in [1.5, -1.5, 0.1, 4e4] {
            let stepped = 180..194;
            let clocks = Clocks::of(&readings(400, 50.0, |n| {
                if stepped.contains(&n) { step_s } else { 0.0 }
            }));
            let found: Vec<usize> = clocks.steps.iter().map(|step| step.frame).collect();
            assert_eq!(found, [180, 194]);
            assert!(is_near(clocks.steps[0].step_s, step_s));
            assert!(is_near(clocks.steps[1].step_s, -step_s));
            for (n, correction) in clocks.corrections_s.iter().enumerate() {
                assert_eq!(correction.is_some(), stepped.contains(&n), "{n}");
                assert!(correction.is_none_or(|shift| is_near(shift, -step_s)));
            }
        }
    }

    #[test]
    fn of_two_runs_the_longer_is_believed() {
        let clocks = Clocks::of(&readings(400, 50.0, |n| if n < 100 { -7.0 } else { 0.0 }));
        assert_eq!(clocks.steps.len(), 1);
        let corrected = clocks.corrections_s.iter().filter_map(|shift| *shift);
        assert!(corrected.clone().all(|shift| is_near(shift, 7.0)));
        assert_eq!(corrected.count(), 100);
    }

    #[test]
    fn a_computer_that_starts_anew_has_not_stepped() {
        let both = |booted_s: f64| {
            let later = readings(200, booted_s, |_| 600.0);
            [readings(200, 50.0, |_| 0.0), later].concat()
        };
        // The second boot overlaps the first, and follows it.
        for booted_s in [60.3, 900.0] {
            let clocks = Clocks::of(&both(booted_s));
            assert!(clocks.steps.is_empty(), "{booted_s}");
            assert!(clocks.corrections_s.iter().all(Option::is_none));
        }
    }
}
