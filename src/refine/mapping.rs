//! The mapping of the whole flight: one slowly varying view of the plate, with jumps, from the marks of all frames.
//!
//! 1. A reference: the median of what the fine frames' own mappings say.
//! 2. Frames that are far from their neighbours are put aside: a median over a few frames keeps a jump's edge and shows
//!    what stands alone.
//! 3. The view as a random walk; how fast it wanders is what makes the marks most likely.
//! 4. Jumps, one after the other, where one explains more than wandering can.
//! 5. Single marks that disagree lose their weight (Tukey), and what scatter is left raises the sigmas of all.

use super::drift::{Drift, Estimate, Moment, Sight, Wander};
use super::record::{FrameRecord, Grade};
use super::view::{Reference, State};
use crate::geometry::{Distortion, Mapping};
use crate::instrument::Instrument;
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

/// Why a frame's marks do not count for the flight's mapping.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// No marks were read.
    Unmarked,
    /// They agree with the flight's.
    Agrees,
    /// The plate stands elsewhere than in the frames before and after: the camera was knocked, or is about to be.
    Alone,
    /// They are read wrongly: so far off no camera is knocked.
    Misread,
}

/// A sudden change of the mapping.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jump {
    /// The first frame after it, and the last one before it whose marks were read.
    pub after: usize,
    pub before: usize,
    /// Change of the plate's centre on the sensor.
    pub shift_px: Vector2<f64>,
    /// Change of rotation.
    pub turn_deg: f64,
}

/// What the mapping did in a flight.
#[derive(Debug, Clone, PartialEq)]
pub struct MappingFacts {
    pub jumps: Vec<Jump>,
    /// How fast the view wanders, px after a second: shift; turn at 1000 mil from the plate's centre.
    pub wander_px: [f64; 2],
    /// By how much the marks' sigmas were raised.
    pub raised: f64,
}

/// The mapping of a flight, frame by frame.
pub struct FlightMapping {
    reference: Reference,
    estimates: Vec<Estimate>,
    pub standing: Vec<Standing>,
    pub facts: MappingFacts,
}

/// The mapping in numbers that people read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MappingNumbers {
    pub centre_px: [Measured; 2],
    pub rotation_deg: f64,
    pub scale_mil_per_px: f64,
}

impl FlightMapping {
    /// The mapping at each of the frames, which are in the order of time, `time_s` of each beside it. `None` where no frame
    /// has marks.
    pub fn estimate(
        frames: &[&FrameRecord],
        time_s: &[f64],
        instrument: &Instrument,
    ) -> Option<Self> {
        let reference = reference(frames, instrument.camera.distortion)?;
        let moments = moments(frames, time_s, instrument, &reference);
        let mut work = Work {
            reference,
            moments,
            wander: FIRST_WANDER,
            jumps: Vec::new(),
            raised: 1.0,
            away_px: vec![0.0; frames.len()],
        };
        work.put_aside(None, 0);
        for stage in 1..ALONE_PX.len() {
            let (estimates, _) = work.drift().smoothed()?;
            work.put_aside(Some(&estimates), stage);
        }
        work.settle_wander();
        work.find_jumps()?;
        work.settle_reference()?;
        for _ in 0..2 {
            let (estimates, _) = work.drift().smoothed()?;
            work.weigh(&estimates);
            work.settle_wander();
        }
        let (estimates, _) = work.drift().smoothed()?;
        Some(work.finished(estimates, frames))
    }

    /// The mapping at a frame. `None` where it cannot be inverted.
    pub fn at(&self, frame: usize) -> Option<Mapping> {
        self.reference.mapping(&self.estimates[frame].state)
    }

    /// Covariance of a plate position got through the mapping of a frame, mil^2.
    pub fn covariance_mil2(&self, frame: usize, at: PlateMil, mapping: &Mapping) -> Matrix2<f64> {
        let covariance = &self.estimates[frame].covariance;
        let own = self.reference.covariance_mil2(at, mapping, covariance);
        match self.own_jump(frame) {
            Some(size_px) => {
                let scale = mapping.scale_mil_per_px(mapping.to_sensor(at));
                own + Matrix2::identity() * (size_px * scale / 2.0).powi(2)
            }
            None => own,
        }
    }

    /// The size of the jump that happened at a frame, or since the last marked one before it, px.
    pub fn own_jump(&self, frame: usize) -> Option<f64> {
        let jump = self.facts.jumps.iter();
        let mut own = jump.filter(|jump| (jump.before + 1..=jump.after).contains(&frame));
        own.next().map(|jump| jump.shift_px.norm())
    }

    /// The mapping of a frame in numbers. `None` where it cannot be inverted.
    pub fn numbers(&self, frame: usize) -> Option<MappingNumbers> {
        let mapping = self.at(frame)?;
        let middle = PlateMil::new(0.0, 0.0);
        let centre = mapping.to_sensor(middle);
        let variance = self.estimates[frame].covariance;
        Some(MappingNumbers {
            centre_px: [
                Measured::new(centre.x, variance[(0, 0)].max(0.0).sqrt()),
                Measured::new(centre.y, variance[(1, 1)].max(0.0).sqrt()),
            ],
            rotation_deg: mapping.rotation_deg(centre),
            scale_mil_per_px: mapping.scale_mil_per_px(centre),
        })
    }
}

/// The middle of what the fine frames' own mappings say of four corners of the plate.
fn reference(frames: &[&FrameRecord], distortion: Distortion) -> Option<Reference> {
    let own: Vec<Matrix3<f64>> = frames
        .iter()
        .filter(|frame| frame.quality == Grade::Fine)
        .filter_map(|frame| {
            let to_plate = frame.disc.as_ref()?.to_plate?;
            Matrix3::from_row_slice(&to_plate).try_inverse()
        })
        .collect();
    let middle = |corner: PlateMil| {
        let seen = |axis: usize| {
            let at = own.iter().map(|m| {
                let h = m * corner.vector().push(1.0);
                h[axis] / h.z
            });
            median(at.collect())
        };
        Some(Vector2::new(seen(0)?, seen(1)?))
    };
    let [a, b, c, d] = Reference::corners().map(middle);
    Reference::through(&[a?, b?, c?, d?], distortion)
}

/// The middle one of some values.
pub(super) fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

fn moments(
    frames: &[&FrameRecord],
    time_s: &[f64],
    instrument: &Instrument,
    reference: &Reference,
) -> Vec<Moment> {
    let sights = |frame: &FrameRecord| {
        let sight = |mark: &super::record::MarkRecord| {
            Some(Sight {
                seen: reference.ideal(mark.at()),
                printed: instrument.plate.position(mark.id()),
                information: mark.covariance().try_inverse()?,
                weight: 1.0,
            })
        };
        let mut sights: Vec<Sight> = match frame.quality {
            Grade::Fine => frame.marks.iter().filter_map(sight).collect(),
            Grade::Coarse | Grade::None => Vec::new(),
        };
        sights.shrink_to_fit();
        sights
    };
    let moment = |(frame, time_s): (&&FrameRecord, &f64)| Moment {
        time_s: *time_s,
        sights: sights(frame),
    };
    frames.iter().zip(time_s).map(moment).collect()
}

/// The mapping in the making.
struct Work {
    reference: Reference,
    moments: Vec<Moment>,
    wander: Wander,
    jumps: Vec<usize>,
    raised: f64,
    /// How far each moment's marks are from their neighbours', px.
    away_px: Vec<f64>,
}

impl Work {
    fn drift(&self) -> Drift<'_> {
        Drift {
            reference: &self.reference,
            moments: &self.moments,
            wander: self.wander,
            jumps: &self.jumps,
        }
    }

    /// A moment's mean miss from a state, px, and its 1 sigma.
    fn mean_miss(&self, moment: &Moment, state: &State) -> Option<(Vector2<f64>, f64)> {
        let mut information = Matrix2::zeros();
        let mut sum = Vector2::zeros();
        for sight in &moment.sights {
            let (seen, slopes) = self.reference.picture(sight.printed);
            information += sight.information;
            sum += sight.information * (sight.seen - seen - slopes * state);
        }
        let covariance = information.try_inverse()?;
        Some((covariance * sum, covariance.trace().max(0.0).sqrt()))
    }

    /// Takes the weight of frames that stand alone, and gives it back to those that no longer do.
    fn put_aside(&mut self, estimates: Option<&[Estimate]>, stage: usize) {
        let state = |n: usize| estimates.map_or(State::zeros(), |estimates| estimates[n].state);
        let misses: Vec<(usize, Vector2<f64>, f64)> = (0..self.moments.len())
            .filter_map(|n| {
                let (miss, sigma) = self.mean_miss(&self.moments[n], &state(n))?;
                Some((n, miss, sigma))
            })
            .collect();
        let reach = NEIGHBOURS[stage];
        let alone: Vec<(usize, f64, bool)> = misses
            .par_iter()
            .enumerate()
            .map(|(k, (n, miss, sigma))| {
                let near = &misses[k.saturating_sub(reach)..misses.len().min(k + reach + 1)];
                let middle = |axis: usize| median(near.iter().map(|(_, m, _)| m[axis]).collect());
                let middle = Vector2::new(middle(0).unwrap_or(0.0), middle(1).unwrap_or(0.0));
                let away = (miss - middle).norm();
                let limit = ALONE_PX[stage].max(ALONE_SIGMAS * sigma * self.raised);
                (*n, away, away > limit)
            })
            .collect();
        for (n, away, alone) in alone {
            self.away_px[n] = away;
            let weight = if alone { 0.0 } else { 1.0 };
            let sights = self.moments[n].sights.iter_mut();
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
            let (_, sharpest) = self.drift().smoothed()?;
            let Some(sharpest) = sharpest.filter(|s| s.chi2 > JUMP_CHI2) else {
                break;
            };
            let at = self.jumps.partition_point(|jump| *jump < sharpest.moment);
            self.jumps.insert(at, sharpest.moment);
            let (estimates, _) = self.drift().smoothed()?;
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

    /// Frames that stand alone beside the jumps, and the reference in the middle of the flight.
    fn settle_reference(&mut self) -> Option<()> {
        let (estimates, _) = self.drift().smoothed()?;
        self.put_aside(Some(&estimates), 2);
        self.move_reference(&estimates);
        Some(())
    }

    /// Tells states from the middle of the flight, where the slopes are then true.
    fn move_reference(&mut self, estimates: &[Estimate]) {
        let middle = |n: usize| median(estimates.iter().map(|e| e.state[n]).collect());
        let state = State::from_fn(|n, _| middle(n).unwrap_or(0.0));
        self.reference = self.reference.moved(&state);
    }

    /// Weighs single marks, and raises their sigmas to what scatter they show.
    fn weigh(&mut self, estimates: &[Estimate]) {
        let reference = self.reference;
        let chi2 = |sight: &Sight, state: &State| {
            let (seen, slopes) = reference.picture(sight.printed);
            let miss = sight.seen - seen - slopes * state;
            miss.dot(&(sight.information * miss))
        };
        let moments = self.moments.iter().zip(estimates);
        let all = moments.flat_map(|(moment, estimate)| {
            let counted = moment.sights.iter().filter(|sight| sight.weight > 0.0);
            counted.map(|sight| chi2(sight, &estimate.state))
        });
        // Half of chi^2 of two lie below 1.386.
        let scatter = median(all.collect()).unwrap_or(0.0) / 1.386;
        let raise = scatter.max(1.0 / self.raised.powi(2));
        self.raised *= raise.sqrt();
        for (moment, estimate) in self.moments.iter_mut().zip(estimates) {
            for sight in moment.sights.iter_mut().filter(|sight| sight.weight > 0.0) {
                sight.information /= raise;
                let pull2 = chi2(sight, &estimate.state) / TUKEY_SIGMAS.powi(2);
                sight.weight = (1.0 - pull2.min(1.0)).powi(2).max(1e-6);
            }
        }
    }

    fn finished(self, estimates: Vec<Estimate>, frames: &[&FrameRecord]) -> FlightMapping {
        let scale = self.reference.scale_px();
        let marked = |moment: &Moment| moment.has_marks();
        let jump = |after: &usize| {
            let before = (0..*after).rev().find(|n| marked(&self.moments[*n]));
            let before = before.unwrap_or(after - 1);
            let step = estimates[*after].state - estimates[before].state;
            let after = (*after..frames.len()).find(|n| marked(&self.moments[*n]));
            Jump {
                after: after.unwrap_or(frames.len() - 1),
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
            },
            standing: self
                .moments
                .iter()
                .zip(&self.away_px)
                .map(standing)
                .collect(),
            reference: self.reference,
            estimates,
        }
    }
}

fn standing((moment, away_px): (&Moment, &f64)) -> Standing {
    match (moment.sights.is_empty(), moment.has_marks()) {
        (true, _) => Standing::Unmarked,
        (false, true) => Standing::Agrees,
        (false, false) if *away_px > MISREAD_PX => Standing::Misread,
        (false, false) => Standing::Alone,
    }
}
