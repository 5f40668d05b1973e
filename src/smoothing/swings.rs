//! The swings of an axis, by maximum likelihood: frequency, damping and drive of each, beside the random walk of the acceleration.
//!
//! 1. The most even stretch of the flight that holds enough frames.
//! 2. What the swings so far leave: a further one stands in its periodogram.
//! 3. Process noise and swings of greatest likelihood from there, as long as a further swing pays for its three parameters
//!    (Schwarz 1978).
//! 4. The damping times that the stretch leaves possible: those that make it no less likely than 2 sigma do. Where a swing without damping is
//!    among them, its damping time is not determined. Of a swing that a wind drives it is determined within a stretch some four times as long.

use super::process::{Axis, MOST_SWINGS, Moments, Swing};
use super::{Damping, Moment, SharedErrors};
use crate::estimation::{median, spectrum};
use std::f64::consts::TAU;

/// Frames that the likelihood is searched with, and the least time from one to the next.
const FRAMES: usize = 1024;
const LEAST_STEP_S: f64 = 0.12;
/// Fewer determine no swing.
const LEAST_FRAMES: usize = 64;
/// Where so many times the flight's usual process noise is wanted, the gondola does something that is no swing.
const EVENT: f64 = 9.0;
/// What a swing must gain, in logarithms of the number of frames: half of one for damping and drive each, and three halves for the rate, whose
/// error falls as that number to the power of 3/2 (Djuric 1996).
const PRICE: f64 = 2.5;
/// Peaks of the periodogram that are tried, and how many bins wide a Hann window makes them.
const PEAKS: usize = 2;
const PEAK_WIDTH: f64 = 1.5;
/// At a peak the search begins with a swing that dies away in so many periods, driven as its power asks for or by these parts of that. The
/// walk's noise begins with the same part.
const FIRST_DAMPING_PERIODS: f64 = 10.0;
const FIRST_DRIVES: [f64; 3] = [1.0, 0.1, 0.01];
/// The walk's noise before it is estimated, unit/s^2.5.
const FIRST_NOISE: f64 = 1.0;
/// The least noise and drive, and least and most damping time, in periods, that are thought of.
const LEAST_NOISE: f64 = 1e-4;
const LEAST_DRIVE: f64 = 1e-4;
const DAMPING_PERIODS: [f64; 2] = [1.0, 1e7];
/// Cost of 2 sigma, natural logarithm of the likelihood, and the factor to which the bound of a damping time is found.
const TWO_SIGMA: f64 = 2.0;
const DAMPING_FACTOR: f64 = 1.1;
/// The fastest swing, periods in a step.
const MOST_PERIODS_A_STEP: f64 = 0.4;
/// The slowest swing, rad/s.
const SLOWEST: f64 = 0.01;
/// The search ends where its steps have shrunk by so much and a round gains less than this, or after so many rounds.
const FINEST: f64 = 0.1;
const ENOUGH: f64 = 0.05;
const MOST_ROUNDS: usize = 40;

/// A process of constant noise along an axis.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fit {
    pub process_noise: f64,
    pub swings: Vec<Swing>,
}

/// A fit with what it knows of each swing's damping.
pub(super) struct Found {
    pub fit: Fit,
    pub dampings: Vec<Damping>,
}

/// An even stretch of a flight along one axis.
pub(super) struct Stretch<'a> {
    moments: Vec<Moment>,
    axis: usize,
    shared: &'a SharedErrors,
    /// The process noise where the gondola does more than elsewhere, zero where it does not.
    events: Vec<f64>,
    step_s: f64,
}

impl<'a> Stretch<'a> {
    /// The stretch of measured moments where the process noise that suffices without swings is least beside the flight's usual one. `None` of
    /// too few frames.
    pub fn of(
        measured: &[Moment],
        noise: &[f64],
        axis: usize,
        shared: &'a SharedErrors,
    ) -> Option<Self> {
        let usual = median(noise)?;
        let is_event = |noise: f64| noise > EVENT * usual;
        let length_s = |n: usize| measured[n].time_s - measured[n - 1].time_s;
        let usual_s = median((1..measured.len()).map(length_s))?;
        let every = ((LEAST_STEP_S / usual_s).ceil().max(1.0)) as usize;
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
        let stretch = Self {
            moments: thinned().map(|n| measured[n]).collect(),
            axis,
            shared,
            events: thinned().map(event).collect(),
            step_s: usual_s * every as f64,
        };
        (stretch.moments.len() >= LEAST_FRAMES && stretch.step_s > 0.0).then_some(stretch)
    }

    /// The process of greatest likelihood, each swing at its price; without swings where none pays.
    pub fn fit(&self) -> Option<Found> {
        let price = PRICE * (self.moments.len() as f64).ln();
        let (mut fit, mut likelihood) = self.climb(Fit {
            process_noise: FIRST_NOISE,
            swings: Vec::new(),
        })?;
        while fit.swings.len() < MOST_SWINGS {
            let starts = self.starts(&fit)?.into_iter();
            let starts = starts.filter_map(|start| Some((self.log_likelihood(&start)?, start)));
            let Some((_, start)) = starts.max_by(|a, b| a.0.total_cmp(&b.0)) else {
                break;
            };
            let (further, gained) = self.climb(start)?;
            if gained < likelihood + price {
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

    /// Bounds of a swing's damping, all else as it was found.
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

    /// The process with a further swing, at peaks of the periodogram of what the swings so far leave.
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

    /// Goes up the likelihood, one parameter after the other with steps that grow and shrink.
    fn climb(&self, start: Fit) -> Option<(Fit, f64)> {
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
    /// With one parameter changed: process noise and drive and damping by a factor, rates by a difference.
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

/// Values at even times, on straight lines between those there are.
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

/// The peaks that stand highest above what is about them, within an octave to each side: frequency and density.
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
