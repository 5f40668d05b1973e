//! Estimation of the mapping of a flight.
//!
//! 1. A reference: the median of the fine frames' own mappings.
//! 2. Frames that are far from their neighbours are set aside: a median over a few frames preserves a jump's edge and shows
//!    isolated frames.
//! 3. The view as a random walk, with process noise by maximum likelihood.
//! 4. Jumps, one after the other, while one is significant against process noise.
//! 5. The dependence on the camera's temperature, if it explains more than process noise and jumps; then jumps again.
//! 6. Single discrepant marks are down-weighted (Tukey), and the remaining scatter inflates the sigmas of all.

use super::drift::{
    Drift, Estimate, MarkObservation, Observations, ProcessNoise, Smoothed, ThermalCoefficients,
};
use super::frames::{Frames, middle_of};
use super::mapping::{FlightMapping, Jump, MappingFacts, MarkUse, TemperatureDependence};
use super::temperature;
use super::view::{Reference, State};
use crate::estimation::{Loss, MEDIAN_CHI2_2D, TUKEY_SIGMAS_2D, median};
use crate::geometry::Distortion;
use crate::instrument::Instrument;
use crate::units::Measured;
use nalgebra::{Matrix2, Matrix3, Vector2};
use rayon::prelude::*;
use std::mem;

/// Frames this far from their neighbours' median are set aside, px; the first value is used before the drift is known.
const OUTLIER_PX: [f64; 3] = [4.0, 0.3, 0.1];
/// ... if the distance also exceeds this multiple of their own sigma.
const OUTLIER_SIGMAS: f64 = 6.0;
/// Larger displacements, px, are misidentified marks: cameras are not knocked this far and back.
const MISIDENTIFIED_PX: f64 = 10.0;
/// Neighbours to each side for that median.
const NEIGHBOURS: [usize; 3] = [10, 4, 4];
/// Least significance of a jump against process noise: chi^2 of four degrees of freedom.
const JUMP_CHI2: f64 = 60.0;
/// Smaller jumps are treated as process noise, px.
const LEAST_JUMP_PX: f64 = 0.1;
const MOST_JUMPS: usize = 64;
/// The temperature is used if it increases the log-likelihood of the marks by this: a ratio of 150 to 1.
const LEAST_TEMPERATURE_GAIN: f64 = 5.0;
/// Loss of the marks' residuals, which are lengths in two axes.
const LOSS: Loss = Loss::Tukey(TUKEY_SIGMAS_2D);
/// Initial process noise.
const FIRST_NOISE: ProcessNoise = ProcessNoise {
    shift_px: 0.01,
    turn_px: 0.01,
};
/// The least process noise, px after a second.
const LEAST_NOISE_PX: f64 = 1e-4;
/// Factor between trial values of process noise.
const NOISE_STEP: f64 = 2.0;
const MOST_NOISE_TRIALS: usize = 24;

impl FlightMapping {
    /// The mapping at each of the frames, from their marks; `times_s` from the first one. `None` if no frame has any.
    pub(super) fn estimate(
        times_s: &[f64],
        Frames {
            frames,
            marks,
            marks_end,
            mappings,
            ..
        }: &mut Frames,
        instrument: &Instrument,
    ) -> Option<Self> {
        let reference = reference(&mem::take(mappings), instrument.camera.distortion)?;
        let moments = times_s.iter().copied().zip(mem::take(marks_end));
        let observations = Observations::new(mem::take(marks), moments);
        let readings: Vec<Option<f64>> = frames.iter().map(|frame| frame.temperature_c).collect();
        let temperature_c = temperature::from_the_middle(times_s, &readings);
        let mut work = Work::new(reference, observations);
        work.reject_first_outliers()?;
        work.fit_process_noise();
        work.find_jumps()?;
        if let Some(temperature_c) = temperature_c {
            work.fit_temperature(temperature_c)?;
        }
        work.refine_reference()?;
        for _ in 0..2 {
            let estimates = work.drift().smoothed()?.estimates;
            work.weigh(&estimates);
            work.fit_process_noise();
        }
        let smoothed = work.drift().smoothed()?;
        Some(work.finished(smoothed))
    }
}

/// Reference from the medians of the fine frames' own mappings at four points of the plate.
fn reference(mappings: &[Matrix3<f64>], distortion: Distortion) -> Option<Reference> {
    let [a, b, c, d] = Reference::corners().map(|corner| middle_of(mappings, corner));
    Reference::through(&[a?, b?, c?, d?], distortion)
}

/// State of the estimation.
struct Work {
    reference: Reference,
    observations: Observations,
    process_noise: ProcessNoise,
    jumps: Vec<usize>,
    inflated: f64,
    /// Distance of each moment's marks from their neighbours', px.
    away_px: Vec<f64>,
    /// The temperature at each moment, if it is used, and the gain in log-likelihood of the marks, if the headers state it.
    temperature_c: Option<Vec<f64>>,
    temperature_gain: Option<f64>,
}

impl Work {
    fn new(reference: Reference, observations: Observations) -> Self {
        Self {
            reference,
            process_noise: FIRST_NOISE,
            jumps: Vec::new(),
            inflated: 1.0,
            away_px: vec![0.0; observations.len()],
            observations,
            temperature_c: None,
            temperature_gain: None,
        }
    }

    fn drift(&self) -> Drift<'_> {
        Drift {
            reference: &self.reference,
            observations: &self.observations,
            process_noise: self.process_noise,
            jumps: &self.jumps,
            temperature_c: self.temperature_c.as_deref(),
        }
    }

    /// A moment's mean residual from a state, px, and its 1 sigma.
    fn mean_residual(&self, moment: usize, state: &State) -> Option<(Vector2<f64>, f64)> {
        let mut information = Matrix2::zeros();
        let mut sum = Vector2::zeros();
        for mark in self.observations.at(moment) {
            let (picture, slopes) = self.reference.picture(mark.printed);
            information += mark.information();
            sum += mark.information() * (mark.observed - picture - slopes * state);
        }
        let covariance = information.try_inverse()?;
        Some((covariance * sum, covariance.trace().max(0.0).sqrt()))
    }

    /// Sets isolated frames aside before the drift is known.
    fn reject_first_outliers(&mut self) -> Option<()> {
        self.reject_outliers(None, 0);
        for stage in 1..OUTLIER_PX.len() {
            let estimates = self.drift().smoothed()?.estimates;
            self.reject_outliers(Some(&estimates), stage);
        }
        Some(())
    }

    /// Sets the weight of isolated frames to 0, and that of all others to 1.
    fn reject_outliers(&mut self, estimates: Option<&[Estimate]>, stage: usize) {
        let state = |n: usize| estimates.map_or(State::zeros(), |estimates| estimates[n].state);
        let residuals: Vec<(usize, Vector2<f64>, f64)> = (0..self.observations.len())
            .filter_map(|n| {
                let (residual, sigma) = self.mean_residual(n, &state(n))?;
                Some((n, residual, sigma))
            })
            .collect();
        let reach = NEIGHBOURS[stage];
        let outliers: Vec<(usize, f64, bool)> = residuals
            .par_iter()
            .enumerate()
            .map(|(k, (n, residual, sigma))| {
                let near = &residuals[k.saturating_sub(reach)..residuals.len().min(k + reach + 1)];
                let middle = |axis: usize| median(near.iter().map(|(_, r, _)| r[axis]));
                let middle = Vector2::new(middle(0).unwrap_or(0.0), middle(1).unwrap_or(0.0));
                let away = (residual - middle).norm();
                let limit = OUTLIER_PX[stage].max(OUTLIER_SIGMAS * sigma * self.inflated);
                (*n, away, away > limit)
            })
            .collect();
        for (n, away, is_outlier) in outliers {
            self.away_px[n] = away;
            let weight = if is_outlier { 0.0 } else { 1.0 };
            let marks = self.observations.at_mut(n).iter_mut();
            marks.for_each(|mark| mark.weight = weight);
        }
    }

    /// Determines the process noise by maximum likelihood.
    fn fit_process_noise(&mut self) {
        let likelihood = |noise: &ProcessNoise| {
            Drift {
                process_noise: *noise,
                ..self.drift()
            }
            .likelihood()
        };
        let Some(mut best) = likelihood(&self.process_noise) else {
            return;
        };
        let mut noise = self.process_noise;
        for _ in 0..MOST_NOISE_TRIALS {
            let ProcessNoise { shift_px, turn_px } = noise;
            let tried = [
                (shift_px * NOISE_STEP, turn_px),
                (shift_px / NOISE_STEP, turn_px),
                (shift_px, turn_px * NOISE_STEP),
                (shift_px, turn_px / NOISE_STEP),
            ];
            let tried = tried.map(|(shift_px, turn_px)| ProcessNoise {
                shift_px: shift_px.max(LEAST_NOISE_PX),
                turn_px: turn_px.max(LEAST_NOISE_PX),
            });
            let found: Vec<Option<f64>> = tried.par_iter().map(likelihood).collect();
            let better = found
                .iter()
                .zip(tried)
                .filter_map(|(l, noise)| Some(((*l)?, noise)));
            match better.max_by(|a, b| a.0.total_cmp(&b.0)) {
                Some((found, better)) if found > best => (best, noise) = (found, better),
                _ => break,
            }
        }
        self.process_noise = noise;
    }

    fn find_jumps(&mut self) -> Option<()> {
        for _ in 0..MOST_JUMPS {
            let candidate = self.drift().smoothed()?.jump;
            let Some(candidate) = candidate.filter(|c| c.chi2 > JUMP_CHI2) else {
                break;
            };
            let at = self.jumps.partition_point(|jump| *jump < candidate.moment);
            self.jumps.insert(at, candidate.moment);
            let estimates = self.drift().smoothed()?.estimates;
            let [before, after] = [candidate.moment - 1, candidate.moment]
                .map(|n| estimates[n].state.fixed_rows::<4>(0).into_owned());
            if (after - before).norm() < LEAST_JUMP_PX {
                self.jumps.remove(at);
                break;
            }
            self.fit_process_noise();
        }
        Some(())
    }

    /// Uses the temperature if it explains the marks far better than process noise alone; with less process noise smaller jumps become
    /// significant.
    fn fit_temperature(&mut self, temperature_c: Vec<f64>) -> Option<()> {
        let (noise, without) = (self.process_noise, self.drift().likelihood()?);
        self.temperature_c = Some(temperature_c);
        self.fit_process_noise();
        let gain = self.drift().likelihood()? - without;
        self.temperature_gain = Some(gain);
        if gain < LEAST_TEMPERATURE_GAIN {
            self.temperature_c = None;
            self.process_noise = noise;
            return Some(());
        }
        self.find_jumps()
    }

    fn temperature_dependence(
        &self,
        thermal: Option<ThermalCoefficients>,
    ) -> TemperatureDependence {
        match (self.temperature_gain, thermal) {
            (None, _) => TemperatureDependence::NotObservable,
            (Some(gain), None) => TemperatureDependence::Insignificant { gain },
            (Some(gain), Some(thermal)) => TemperatureDependence::Linear {
                gain,
                px_per_degc: std::array::from_fn(|n| {
                    let sigma = thermal.covariance[(n, n)].max(0.0).sqrt();
                    Measured::new(thermal.px_per_degc[n], sigma)
                }),
            },
        }
    }

    /// Frames near a jump that were set aside determine its time better than the walk does.
    fn time_jumps(&mut self) -> Option<()> {
        let estimates = self.drift().smoothed()?.estimates;
        let residual = |n: usize, side: usize| {
            let mean = self.mean_residual(n, &estimates[side].state);
            mean.map_or(0.0, |(residual, _)| residual.norm())
        };
        let marked = |n: &usize| self.observations.counts(*n);
        let timed = |jump: &usize| {
            let sides = (0..*jump).rev().find(marked);
            let Some((before, after)) = sides.zip((*jump..self.observations.len()).find(marked))
            else {
                return *jump;
            };
            let (mut best, mut least, mut cost) = (before + 1, 0.0, 0.0);
            for n in before + 1..after {
                cost += residual(n, before) - residual(n, after);
                if cost <= least {
                    (best, least) = (n + 1, cost);
                }
            }
            best
        };
        self.jumps = self.jumps.iter().map(timed).collect();
        Some(())
    }

    /// Sets aside frames that are isolated with the jumps included, and moves the reference to the middle of the flight.
    fn refine_reference(&mut self) -> Option<()> {
        self.time_jumps()?;
        let estimates = self.drift().smoothed()?.estimates;
        self.reject_outliers(Some(&estimates), 2);
        self.move_reference(&estimates)
    }

    /// Moves the reference to the median of the estimates, where the derivatives are then exact.
    fn move_reference(&mut self, estimates: &[Estimate]) -> Option<()> {
        let middle = |n: usize| median(estimates.iter().map(|e| e.state[n]));
        let state = State::from_fn(|n, _| middle(n).unwrap_or(0.0));
        self.reference = self.reference.moved(&state)?;
        Some(())
    }

    /// Weights single marks, and inflates their sigmas to their scatter.
    fn weigh(&mut self, estimates: &[Estimate]) {
        let reference = self.reference;
        let chi2 = |mark: &MarkObservation, state: &State| {
            let (picture, slopes) = reference.picture(mark.printed);
            let residual = mark.observed - picture - slopes * state;
            residual.dot(&(mark.information() * residual))
        };
        let all = estimates.iter().enumerate().flat_map(|(n, estimate)| {
            let counted = self.observations.at(n).iter().filter(|s| s.weight > 0.0);
            counted.map(|mark| chi2(mark, &estimate.state))
        });
        let scatter = median(all).unwrap_or(0.0) / MEDIAN_CHI2_2D;
        let inflation = scatter.max(1.0 / self.inflated.powi(2));
        self.inflated *= inflation.sqrt();
        for (n, estimate) in estimates.iter().enumerate() {
            let counted = self.observations.at_mut(n).iter_mut();
            for mark in counted.filter(|mark| mark.weight > 0.0) {
                mark.information = mark.information.map(|part| part / inflation as f32);
                let residual = chi2(mark, &estimate.state).sqrt();
                mark.weight = LOSS.weight(residual).max(1e-6) as f32;
            }
        }
    }

    fn finished(self, smoothed: Smoothed) -> FlightMapping {
        let Smoothed {
            mut estimates,
            thermal,
            ..
        } = smoothed;
        let scale = self.reference.view.unit_px();
        let marked = |n: &usize| self.observations.counts(*n);
        let jump = |after: &usize| {
            let before = (0..*after).rev().find(marked);
            let before = before.unwrap_or(after - 1);
            let step = estimates[*after].state - estimates[before].state;
            let after = (*after..estimates.len()).find(marked);
            Jump {
                after: after.unwrap_or(estimates.len() - 1),
                before,
                shift_px: [step[0], step[1]],
                turn_deg: (step[3] / scale).to_degrees(),
            }
        };
        let jumps: Vec<Jump> = self.jumps.iter().map(jump).collect();
        for jump in &jumps {
            self.spread(jump, &mut estimates);
        }
        FlightMapping {
            facts: MappingFacts {
                jumps,
                process_noise_px: [self.process_noise.shift_px, self.process_noise.turn_px],
                inflation: self.inflated,
                temperature: self.temperature_dependence(thermal),
            },
            mark_use: (0..estimates.len()).map(|n| self.mark_use(n)).collect(),
            reference: self.reference,
            estimates,
        }
    }

    /// Mixes the estimates of the unmarked frames about a jump. The plate may have moved at any time between the marked frames about it,
    /// suddenly or not; all times are taken as equally likely.
    fn spread(&self, jump: &Jump, estimates: &mut [Estimate]) {
        let between = jump.before + 1..jump.after;
        let since_s: Vec<f64> = (between.start..=jump.after)
            .scan(0.0, |since_s, n| {
                *since_s += self.observations.step_s(n);
                Some(*since_s)
            })
            .collect();
        let (after, length_s) = (estimates[jump.after], since_s.last().copied());
        for (n, since_s) in between.zip(&since_s) {
            let part = length_s
                .filter(|length_s| *length_s > 0.0)
                .map_or(0.5, |length_s| since_s / length_s);
            if self.mark_use(n) == MarkUse::Unmarked {
                estimates[n] = estimates[n].or(&after, part);
            }
        }
    }

    fn mark_use(&self, n: usize) -> MarkUse {
        match (
            self.observations.at(n).is_empty(),
            self.observations.counts(n),
        ) {
            (true, _) => MarkUse::Unmarked,
            (false, true) => MarkUse::Agrees,
            (false, false) if self.away_px[n] > MISIDENTIFIED_PX => MarkUse::WrongIds,
            (false, false) => MarkUse::Displaced,
        }
    }
}
