//! The swings of an axis, by maximum likelihood: frequency, damping and drive of each, in addition to the random walk of the acceleration.
//!
//! 1. Select the stretch of the flight with enough frames that has the least events.
//! 2. Find a further swing in the periodogram of the residuals after the swings so far.
//! 3. Fit process noise and swings by maximum likelihood from there, while the likelihood justifies the three parameters of a further swing
//!    (Schwarz 1978).
//! 4. Determine the damping times that the stretch allows: those that are less likely by at most 2 sigma. If an undamped swing is
//!    among them, the damping time is not determined. For a swing driven by wind it is determined within a stretch some four times as long.

use super::process::{Axis, MOST_SWINGS, Moments, Swing};
use super::{Damping, Moment, SharedErrors};
use crate::estimation::{median, spectrum};
use std::f64::consts::TAU;

/// Number of frames used for the likelihood, and the least time between them.
const FRAMES: usize = 1024;
const LEAST_STEP_S: f64 = 0.12;
/// Fewer frames do not determine a swing.
const LEAST_FRAMES: usize = 64;
/// Where more than this multiple of the flight's median process noise is needed, the motion is not a swing.
const EVENT: f64 = 9.0;
/// Least gain in likelihood for a swing, in logarithms of the number of frames: 1/2 each for damping and drive, and 3/2 for the rate,
/// whose error decreases as that number to the power of 3/2 (Djuric 1996).
const SWING_COST: f64 = 2.5;
/// Peaks of the periodogram that are tried, and their width in bins with a Hann window.
const PEAKS: usize = 2;
const PEAK_WIDTH: f64 = 1.5;
/// Initial values at a peak: damping time in periods; drive as a multiple of the one that gives the peak's power. The process noise of
/// the walk is scaled by the same multiple.
const FIRST_DAMPING_PERIODS: f64 = 10.0;
const FIRST_DRIVES: [f64; 3] = [1.0, 0.1, 0.01];
/// Initial process noise of the walk, unit/s^2.5.
const FIRST_NOISE: f64 = 1.0;
/// Least process noise and drive, and range of the damping time, in periods.
const LEAST_NOISE: f64 = 1e-4;
const LEAST_DRIVE: f64 = 1e-4;
const DAMPING_PERIODS: [f64; 2] = [1.0, 1e7];
/// Decrease of the log-likelihood at 2 sigma, and the factor to which the bound of a damping time is determined.
const TWO_SIGMA: f64 = 2.0;
const DAMPING_FACTOR: f64 = 1.1;
/// The fastest swing, periods in a step.
const MOST_PERIODS_A_STEP: f64 = 0.4;
/// The slowest swing, rad/s.
const SLOWEST: f64 = 0.01;
/// The search ends when its steps have shrunk to this part and a round gains less than this, or after this many rounds.
const FINEST: f64 = 0.1;
const ENOUGH: f64 = 0.05;
const MOST_ROUNDS: usize = 40;

/// A motion with constant process noise along an axis.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fit {
    pub process_noise: f64,
    pub swings: Vec<Swing>,
}

/// A fit with the damping time of each swing.
pub(super) struct Found {
    pub fit: Fit,
    pub dampings: Vec<Damping>,
}

/// A uniform stretch of a flight along one axis.
pub(super) struct Segment<'a> {
    moments: Vec<Moment>,
    axis: usize,
    shared: &'a SharedErrors,
    /// Process noise during events, where it is well above the median; zero elsewhere.
    events: Vec<f64>,
    step_s: f64,
}

impl<'a> Segment<'a> {
    /// Selects the stretch of measured moments with the least number of events, where the process noise without swings is far above the
    /// flight's median. `None` if there are too few frames.
    pub fn of(
        measured: &[Moment],
        noise: &[f64],
        axis: usize,
        shared: &'a SharedErrors,
    ) -> Option<Self> {
        let median_noise = median(noise)?;
        let is_event = |noise: f64| noise > EVENT * median_noise;
        let length_s = |n: usize| measured[n].time_s - measured[n - 1].time_s;
        let median_step_s = median((1..measured.len()).map(length_s))?;
        let every = ((LEAST_STEP_S / median_step_s).ceil().max(1.0)) as usize;
        let length = (FRAMES * every).min(measured.len());
        let events = |first: &usize| {
            noise[*first..first + length]
                .iter()
                .filter(|n| is_event(**n))
                .count()
        };
        let starts = (0..=measured.len() - length).step_by((length / 2).max(1));
        let first = starts.min_by_key(events)?;
        let thinned = || (first..first + length).step_by(every);
        let event = |n: usize| {
            let most = noise[n..measured.len().min(n + every)]
                .iter()
                .copied()
                .fold(0.0, f64::max);
            if is_event(most) { most } else { 0.0 }
        };
        let segment = Self {
            moments: thinned().map(|n| measured[n]).collect(),
            axis,
            shared,
            events: thinned().map(event).collect(),
            step_s: median_step_s * every as f64,
        };
        (segment.moments.len() >= LEAST_FRAMES && segment.step_s > 0.0).then_some(segment)
    }

    /// The process of greatest likelihood, where each swing must gain at least its cost; without swings if none does.
    pub fn fit(&self) -> Option<Found> {
        let cost = SWING_COST * (self.moments.len() as f64).ln();
        let (mut fit, mut likelihood) = self.maximise(Fit {
            process_noise: FIRST_NOISE,
            swings: Vec::new(),
        })?;
        while fit.swings.len() < MOST_SWINGS {
            let starts = self.starts(&fit)?.into_iter();
            let starts = starts.filter_map(|start| Some((self.log_likelihood(&start)?, start)));
            let Some((_, start)) = starts.max_by(|a, b| a.0.total_cmp(&b.0)) else {
                break;
            };
            let (further, gained) = self.maximise(start)?;
            if gained < likelihood + cost {
                break;
            }
            (fit, likelihood) = (further, gained);
        }
        let dampings = (0..fit.swings.len()).map(|swing| self.damping(&fit, swing, likelihood));
        Some(Found {
            dampings: dampings.collect(),
            fit,
        })
    }

    /// Bounds of a swing's damping time, with the other parameters fixed.
    fn damping(&self, fit: &Fit, swing: usize, likelihood: f64) -> Damping {
        let found_s = fit.swings[swing].damping_s;
        let [shortest_s, longest_s] =
            DAMPING_PERIODS.map(|periods| periods * fit.swings[swing].period_s());
        let is_possible = |damping_s: f64| {
            let mut tried = fit.clone();
            tried.swings[swing].damping_s = damping_s;
            let tried = self.log_likelihood(&tried);
            tried.is_some_and(|tried| tried >= likelihood - TWO_SIGMA)
        };
        let (mut possible_s, mut bound_s) = (found_s, shortest_s);
        if is_possible(shortest_s) {
            possible_s = shortest_s;
        }
        while possible_s > DAMPING_FACTOR * bound_s {
            let middle_s = (possible_s * bound_s).sqrt();
            match is_possible(middle_s) {
                true => possible_s = middle_s,
                false => bound_s = middle_s,
            }
        }
        Damping {
            found_s: (!is_possible(longest_s)).then_some(found_s),
            least_s: possible_s,
        }
    }

    fn log_likelihood(&self, fit: &Fit) -> Option<f64> {
        let noise: Vec<f64> = self
            .events
            .iter()
            .map(|event| event.max(fit.process_noise))
            .collect();
        let moments = Moments::Measured(&self.moments);
        self.along(&moments, fit, &noise).log_likelihood()
    }

    fn along<'b>(
        &'b self,
        moments: &'b Moments<'b>,
        fit: &'b Fit,
        process_noise: &'b [f64],
    ) -> Axis<'b> {
        Axis {
            moments,
            axis: self.axis,
            shared: self.shared,
            swings: &fit.swings,
            process_noise,
        }
    }

    /// Initial values with a further swing, at peaks of the periodogram of the residuals after the swings so far.
    fn starts(&self, fit: &Fit) -> Option<Vec<Fit>> {
        let noise: Vec<f64> = self
            .events
            .iter()
            .map(|event| event.max(fit.process_noise))
            .collect();
        let (moments, mut left) = (Moments::Measured(&self.moments), Vec::new());
        self.along(&moments, fit, &noise).smooth(|n, state| {
            let moment = &self.moments[n];
            let place = moment.measured.map(|measured| measured[self.axis].place);
            let swung = state.swings.iter().sum::<f64>();
            left.extend(place.map(|place| (moment.time_s, place - swung)));
        })?;
        left.reverse();
        let left = evenly(&left, self.step_s);
        let spectrum = spectrum::density(&[left], self.step_s);
        let mut starts = Vec::new();
        for (frequency_hz, density) in peaks(&spectrum) {
            let rate = TAU * frequency_hz;
            let rms = (density * spectrum[0].0 * PEAK_WIDTH).sqrt();
            for part in FIRST_DRIVES {
                let mut start = fit.clone();
                start.process_noise *= part;
                start.swings.push(Swing {
                    rate_rad_per_s: rate,
                    damping_s: FIRST_DAMPING_PERIODS * TAU / rate,
                    drive: (part * rms * rate * (rate / FIRST_DAMPING_PERIODS).sqrt())
                        .max(LEAST_DRIVE),
                });
                starts.push(start);
            }
        }
        Some(starts)
    }

    /// Maximises the likelihood one parameter after the other, with adaptive step sizes.
    fn maximise(&self, start: Fit) -> Option<(Fit, f64)> {
        let mut best = self.log_likelihood(&start)?;
        let mut fit = start;
        let bin = TAU / (self.step_s * self.moments.len() as f64);
        let mut steps: Vec<f64> = (0..1 + 3 * fit.swings.len())
            .map(|n| {
                if n > 0 && (n - 1) % 3 == 0 {
                    bin / 4.0
                } else {
                    1.0
                }
            })
            .collect();
        let finest: Vec<f64> = steps.iter().map(|step| step * FINEST).collect();
        for _ in 0..MOST_ROUNDS {
            let before = best;
            for (n, size) in steps.iter_mut().enumerate() {
                let tried = [*size, -*size].map(|step| {
                    let tried = fit.moved(n, step, MOST_PERIODS_A_STEP * TAU / self.step_s);
                    Some((self.log_likelihood(&tried)?, tried))
                });
                let better = tried
                    .into_iter()
                    .flatten()
                    .filter(|(likelihood, _)| *likelihood > best);
                match better.max_by(|a, b| a.0.total_cmp(&b.0)) {
                    Some((likelihood, better)) => {
                        (best, fit) = (likelihood, better);
                        *size *= 1.5;
                    }
                    None => *size /= 2.5,
                }
            }
            let fine = |(n, step): (usize, &f64)| *step < finest[n];
            if best - before < ENOUGH && steps.iter().enumerate().all(fine) {
                break;
            }
        }
        Some((fit, best))
    }
}

impl Fit {
    /// The fit with one parameter changed: process noise, drive and damping by a factor, rates by a difference.
    fn moved(&self, parameter: usize, by: f64, fastest: f64) -> Self {
        let mut moved = self.clone();
        if parameter == 0 {
            moved.process_noise = (self.process_noise * by.exp()).max(LEAST_NOISE);
            return moved;
        }
        let swing = &mut moved.swings[(parameter - 1) / 3];
        match (parameter - 1) % 3 {
            0 => {
                swing.rate_rad_per_s =
                    (swing.rate_rad_per_s + by).clamp(SLOWEST, fastest.max(SLOWEST))
            }
            1 => swing.damping_s *= by.exp(),
            _ => swing.drive = (swing.drive * by.exp()).max(LEAST_DRIVE),
        }
        let [least, most] = DAMPING_PERIODS.map(|periods| periods * swing.period_s());
        swing.damping_s = swing.damping_s.clamp(least, most);
        moved
    }
}

/// Resamples values at a constant step by linear interpolation.
fn evenly(values: &[(f64, f64)], step_s: f64) -> Vec<f64> {
    let Some(((first_s, _), (last_s, _))) = values.first().zip(values.last()) else {
        return Vec::new();
    };
    let at = |time_s: f64| {
        let next = values
            .partition_point(|(t, _)| *t < time_s)
            .clamp(1, values.len() - 1);
        let ((t0, v0), (t1, v1)) = (values[next - 1], values[next]);
        v0 + (v1 - v0) * (time_s - t0) / (t1 - t0).max(1e-9)
    };
    let count = ((last_s - first_s) / step_s) as usize + 1;
    (0..count)
        .map(|n| at(first_s + n as f64 * step_s))
        .collect()
}

/// The peaks with the greatest ratio to their surroundings within an octave on each side: frequency and density.
fn peaks(spectrum: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let highest =
        |n: &usize| spectrum[n - 1].1 < spectrum[*n].1 && spectrum[*n].1 >= spectrum[n + 1].1;
    let last = spectrum.len().saturating_sub(1);
    let mut found: Vec<(f64, usize)> = (2..last)
        .filter(highest)
        .filter_map(|n| {
            let about = spectrum[n / 2..spectrum.len().min(2 * n + 3)].iter();
            Some((
                spectrum[n].1 / median(about.map(|(_, density)| density))?,
                n,
            ))
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found
        .into_iter()
        .take(PEAKS)
        .map(|(_, n)| spectrum[n])
        .collect()
}
