//! How the mapping of a flight is estimated.
//!
//! 1. A reference: the median of what the fine frames' own mappings say.
//! 2. Frames that are far from their neighbours are put aside: a median over a few frames keeps a jump's edge and shows
//!    what stands alone.
//! 3. The view as a random walk; how fast it wanders is what makes the marks most likely.
//! 4. Jumps, one after the other, where one explains more than wandering can.
//! 5. What the camera's temperature does, where that explains more than wandering and jumps can; then jumps again.
//! 6. Single marks that disagree lose their weight (Tukey), and what scatter is left raises the sigmas of all.

use super::drift::{Drift, Estimate, Sight, Sightings, Smoothed, Wander, Warmth};
use super::load::Entry;
use super::mapping::{FlightMapping, Jump, MappingFacts, Standing, WarmthFacts};
use super::temperature;
use super::view::{Reference, State};
use crate::geometry::Distortion;
use crate::instrument::Instrument;
use crate::statistics::median;
use crate::units::{Measured, PlateMil};
use nalgebra::{Matrix2, Matrix3, Vector2};
use rayon::prelude::*;

/// A frame so far from its neighbours' median is put aside, px, before and after the drift is known.
const ALONE_PX: [f64; 3] = [4.0, 0.3, 0.1];
/// ... if it is also so many of its own sigmas away.
const ALONE_SIGMAS: f64 = 6.0;
/// Cameras are not knocked this far and back, px.
const MISREAD_PX: f64 = 10.0;
/// Neighbours to each side whose median it is held against.
const NEIGHBOURS: [usize; 3] = [10, 4, 4];
/// A jump explains so much more than wandering: chi^2 of four.
const JUMP_CHI2: f64 = 60.0;
/// Smaller jumps are wandering, px.
const LEAST_JUMP_PX: f64 = 0.1;
const MOST_JUMPS: usize = 64;
/// The temperature counts where it makes the marks so much more likely, natural logarithm: 150 to 1.
const LEAST_WARMTH_GAIN: f64 = 5.0;
const TUKEY_SIGMAS: f64 = 5.0;
/// How fast views wander at first.
const FIRST_WANDER: Wander = Wander {
    shift_px: 0.01,
    turn_px: 0.01,
};
/// The least that views wander, px after a second.
const LEAST_WANDER_PX: f64 = 1e-4;
/// Factor between values of wander that are tried.
const WANDER_STEP: f64 = 2.0;
const MOST_WANDER_TRIALS: usize = 24;

impl FlightMapping {
    /// The mapping at each of the frames, which are in the order of time, from their marks. `None` where no frame has any.
    pub(super) fn estimate(
        entries: &[Entry],
        sights: Vec<Sight>,
        instrument: &Instrument,
    ) -> Option<Self> {
        let reference = reference(entries, instrument.camera.distortion)?;
        let sightings = sightings(entries, sights);
        let readings: Vec<Option<f64>> = entries.iter().map(|e| e.row.temperature_c).collect();
        let warmth_c = temperature::from_the_middle(&sightings.times_s(), &readings);
        let mut work = Work::new(reference, sightings);
        work.put_aside_at_first()?;
        work.settle_wander();
        work.find_jumps()?;
        if let Some(warmth_c) = warmth_c {
            work.take_temperature(warmth_c)?;
        }
        work.settle_reference()?;
        for _ in 0..2 {
            let estimates = work.drift().smoothed()?.estimates;
            work.weigh(&estimates);
            work.settle_wander();
        }
        let smoothed = work.drift().smoothed()?;
        Some(work.finished(smoothed))
    }
}

/// The middle of what the fine frames' own mappings say of four corners of the plate.
fn reference(entries: &[Entry], distortion: Distortion) -> Option<Reference> {
    let own: Vec<Matrix3<f64>> = entries
        .iter()
        .filter_map(|entry| Matrix3::from_row_slice(&entry.own_mapping?).try_inverse())
        .collect();
    let middle = |corner: PlateMil| {
        let seen = |axis: usize| {
            let at = own.iter().map(|m| {
                let h = m * corner.vector().push(1.0);
                h[axis] / h.z
            });
            median(at)
        };
        Some(Vector2::new(seen(0)?, seen(1)?))
    };
    let [a, b, c, d] = Reference::corners().map(middle);
    Reference::through(&[a?, b?, c?, d?], distortion)
}

/// The frames' marks, by time.
fn sightings(entries: &[Entry], sights: Vec<Sight>) -> Sightings {
    let first = entries.first().and_then(|entry| entry.row.utc_ns);
    let since = |utc: i64| (utc - first.unwrap_or(utc)) as f64 / 1e9;
    let moments = entries.iter().map(|entry| {
        let time_s = entry.row.utc_ns.map_or(0.0, since);
        (time_s, entry.marks.clone())
    });
    Sightings::new(sights, moments)
}

/// The mapping in the making.
struct Work {
    reference: Reference,
    sightings: Sightings,
    wander: Wander,
    jumps: Vec<usize>,
    raised: f64,
    /// How far each moment's marks are from their neighbours', px.
    away_px: Vec<f64>,
    /// The temperature at each moment, where it counts, and how much more likely it makes the marks, where it is told.
    warmth_c: Option<Vec<f64>>,
    warmth_gain: Option<f64>,
}

impl Work {
    fn new(reference: Reference, sightings: Sightings) -> Self {
        Self {
            reference,
            wander: FIRST_WANDER,
            jumps: Vec::new(),
            raised: 1.0,
            away_px: vec![0.0; sightings.len()],
            sightings,
            warmth_c: None,
            warmth_gain: None,
        }
    }

    fn drift(&self) -> Drift<'_> {
        Drift {
            reference: &self.reference,
            sightings: &self.sightings,
            wander: self.wander,
            jumps: &self.jumps,
            warmth_c: self.warmth_c.as_deref(),
        }
    }

    /// A moment's mean miss from a state, px, and its 1 sigma.
    fn mean_miss(&self, moment: usize, state: &State) -> Option<(Vector2<f64>, f64)> {
        let mut information = Matrix2::zeros();
        let mut sum = Vector2::zeros();
        for sight in self.sightings.at(moment) {
            let (seen, slopes) = self.reference.picture(sight.printed);
            information += sight.information();
            sum += sight.information() * (sight.seen - seen - slopes * state);
        }
        let covariance = information.try_inverse()?;
        Some((covariance * sum, covariance.trace().max(0.0).sqrt()))
    }

    /// Before the drift is known.
    fn put_aside_at_first(&mut self) -> Option<()> {
        self.put_aside(None, 0);
        for stage in 1..ALONE_PX.len() {
            let estimates = self.drift().smoothed()?.estimates;
            self.put_aside(Some(&estimates), stage);
        }
        Some(())
    }

    /// Takes the weight of frames that stand alone, and gives it back to those that no longer do.
    fn put_aside(&mut self, estimates: Option<&[Estimate]>, stage: usize) {
        let state = |n: usize| estimates.map_or(State::zeros(), |estimates| estimates[n].state);
        let misses: Vec<(usize, Vector2<f64>, f64)> = (0..self.sightings.len())
            .filter_map(|n| {
                let (miss, sigma) = self.mean_miss(n, &state(n))?;
                Some((n, miss, sigma))
            })
            .collect();
        let reach = NEIGHBOURS[stage];
        let alone: Vec<(usize, f64, bool)> = misses
            .par_iter()
            .enumerate()
            .map(|(k, (n, miss, sigma))| {
                let near = &misses[k.saturating_sub(reach)..misses.len().min(k + reach + 1)];
                let middle = |axis: usize| median(near.iter().map(|(_, m, _)| m[axis]));
                let middle = Vector2::new(middle(0).unwrap_or(0.0), middle(1).unwrap_or(0.0));
                let away = (miss - middle).norm();
                let limit = ALONE_PX[stage].max(ALONE_SIGMAS * sigma * self.raised);
                (*n, away, away > limit)
            })
            .collect();
        for (n, away, alone) in alone {
            self.away_px[n] = away;
            let weight = if alone { 0.0 } else { 1.0 };
            let sights = self.sightings.at_mut(n).iter_mut();
            sights.for_each(|sight| sight.weight = weight);
        }
    }

    /// The wander that makes the marks most likely.
    fn settle_wander(&mut self) {
        let likelihood = |wander: &Wander| {
            Drift {
                wander: *wander,
                ..self.drift()
            }
            .likelihood()
        };
        let Some(mut best) = likelihood(&self.wander) else {
            return;
        };
        let mut wander = self.wander;
        for _ in 0..MOST_WANDER_TRIALS {
            let Wander { shift_px, turn_px } = wander;
            let tried = [
                (shift_px * WANDER_STEP, turn_px),
                (shift_px / WANDER_STEP, turn_px),
                (shift_px, turn_px * WANDER_STEP),
                (shift_px, turn_px / WANDER_STEP),
            ];
            let tried = tried.map(|(shift_px, turn_px)| Wander {
                shift_px: shift_px.max(LEAST_WANDER_PX),
                turn_px: turn_px.max(LEAST_WANDER_PX),
            });
            let found: Vec<Option<f64>> = tried.par_iter().map(likelihood).collect();
            let better = found
                .iter()
                .zip(tried)
                .filter_map(|(l, w)| Some(((*l)?, w)));
            match better.max_by(|a, b| a.0.total_cmp(&b.0)) {
                Some((found, better)) if found > best => (best, wander) = (found, better),
                _ => break,
            }
        }
        self.wander = wander;
    }

    fn find_jumps(&mut self) -> Option<()> {
        for _ in 0..MOST_JUMPS {
            let sharpest = self.drift().smoothed()?.sharpest;
            let Some(sharpest) = sharpest.filter(|s| s.chi2 > JUMP_CHI2) else {
                break;
            };
            let at = self.jumps.partition_point(|jump| *jump < sharpest.moment);
            self.jumps.insert(at, sharpest.moment);
            let estimates = self.drift().smoothed()?.estimates;
            let [before, after] = [sharpest.moment - 1, sharpest.moment]
                .map(|n| estimates[n].state.fixed_rows::<4>(0).into_owned());
            if (after - before).norm() < LEAST_JUMP_PX {
                self.jumps.remove(at);
                break;
            }
            self.settle_wander();
        }
        Some(())
    }

    /// The temperature counts where it explains the marks far better than wandering alone; what then wanders less shows
    /// smaller jumps.
    fn take_temperature(&mut self, warmth_c: Vec<f64>) -> Option<()> {
        let (wander, without) = (self.wander, self.drift().likelihood()?);
        self.warmth_c = Some(warmth_c);
        self.settle_wander();
        let gain = self.drift().likelihood()? - without;
        self.warmth_gain = Some(gain);
        if gain < LEAST_WARMTH_GAIN {
            self.warmth_c = None;
            self.wander = wander;
            return Some(());
        }
        self.find_jumps()
    }

    fn warmth_facts(&self, warmth: &Warmth) -> WarmthFacts {
        match (self.warmth_gain, &self.warmth_c) {
            (None, _) => WarmthFacts::Untold,
            (Some(gain), None) => WarmthFacts::Idle { gain },
            (Some(gain), Some(_)) => WarmthFacts::Follows {
                gain,
                px_per_degc: std::array::from_fn(|n| {
                    let sigma = warmth.covariance[(n, n)].max(0.0).sqrt();
                    Measured::new(warmth.px_per_degc[n], sigma)
                }),
            },
        }
    }

    /// Frames about a jump that were put aside tell better than wandering does when it happened.
    fn time_jumps(&mut self) -> Option<()> {
        let estimates = self.drift().smoothed()?.estimates;
        let miss = |n: usize, side: usize| {
            let miss = self.mean_miss(n, &estimates[side].state);
            miss.map_or(0.0, |(miss, _)| miss.norm())
        };
        let marked = |n: &usize| self.sightings.counts(*n);
        let timed = |jump: &usize| {
            let sides = (0..*jump).rev().find(marked);
            let Some((before, after)) = sides.zip((*jump..self.sightings.len()).find(marked))
            else {
                return *jump;
            };
            let (mut best, mut least, mut cost) = (before + 1, 0.0, 0.0);
            for n in before + 1..after {
                cost += miss(n, before) - miss(n, after);
                if cost <= least {
                    (best, least) = (n + 1, cost);
                }
            }
            best
        };
        self.jumps = self.jumps.iter().map(timed).collect();
        Some(())
    }

    /// Frames that stand alone beside the jumps, and the reference in the middle of the flight.
    fn settle_reference(&mut self) -> Option<()> {
        self.time_jumps()?;
        let estimates = self.drift().smoothed()?.estimates;
        self.put_aside(Some(&estimates), 2);
        self.move_reference(&estimates)
    }

    /// Tells states from the middle of the flight, where the slopes are then true.
    fn move_reference(&mut self, estimates: &[Estimate]) -> Option<()> {
        let middle = |n: usize| median(estimates.iter().map(|e| e.state[n]));
        let state = State::from_fn(|n, _| middle(n).unwrap_or(0.0));
        self.reference = self.reference.moved(&state)?;
        Some(())
    }

    /// Weighs single marks, and raises their sigmas to what scatter they show.
    fn weigh(&mut self, estimates: &[Estimate]) {
        let reference = self.reference;
        let chi2 = |sight: &Sight, state: &State| {
            let (seen, slopes) = reference.picture(sight.printed);
            let miss = sight.seen - seen - slopes * state;
            miss.dot(&(sight.information() * miss))
        };
        let all = estimates.iter().enumerate().flat_map(|(n, estimate)| {
            let counted = self.sightings.at(n).iter().filter(|s| s.weight > 0.0);
            counted.map(|sight| chi2(sight, &estimate.state))
        });
        // Half of chi^2 of two lie below 1.386.
        let scatter = median(all).unwrap_or(0.0) / 1.386;
        let raise = scatter.max(1.0 / self.raised.powi(2));
        self.raised *= raise.sqrt();
        for (n, estimate) in estimates.iter().enumerate() {
            let counted = self.sightings.at_mut(n).iter_mut();
            for sight in counted.filter(|sight| sight.weight > 0.0) {
                sight.information = sight.information.map(|part| part / raise as f32);
                let pull2 = chi2(sight, &estimate.state) / TUKEY_SIGMAS.powi(2);
                sight.weight = (1.0 - pull2.min(1.0)).powi(2).max(1e-6) as f32;
            }
        }
    }

    fn finished(self, smoothed: Smoothed) -> FlightMapping {
        let Smoothed {
            estimates, warmth, ..
        } = smoothed;
        let scale = self.reference.view.unit_px();
        let marked = |n: &usize| self.sightings.counts(*n);
        let jump = |after: &usize| {
            let before = (0..*after).rev().find(marked);
            let before = before.unwrap_or(after - 1);
            let step = estimates[*after].state - estimates[before].state;
            let after = (*after..estimates.len()).find(marked);
            Jump {
                after: after.unwrap_or(estimates.len() - 1),
                before,
                shift_px: step.fixed_rows::<2>(0).into_owned(),
                turn_deg: (step[3] / scale).to_degrees(),
            }
        };
        FlightMapping {
            facts: MappingFacts {
                jumps: self.jumps.iter().map(jump).collect(),
                wander_px: [self.wander.shift_px, self.wander.turn_px],
                raised: self.raised,
                warmth: self.warmth_facts(&warmth),
            },
            standing: (0..estimates.len()).map(|n| self.standing(n)).collect(),
            reference: self.reference,
            estimates,
        }
    }

    fn standing(&self, n: usize) -> Standing {
        match (self.sightings.at(n).is_empty(), self.sightings.counts(n)) {
            (true, _) => Standing::Unmarked,
            (false, true) => Standing::Agrees,
            (false, false) if self.away_px[n] > MISREAD_PX => Standing::Misread,
            (false, false) => Standing::Alone,
        }
    }
}
