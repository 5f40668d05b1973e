//! Times of the frames: their stamps checked against the monotonic clock, the frames' numbers and each other.
//!
//! A stamp that contradicts these does not improve the path. The checks, in this order:
//!
//! 1. A clock that gives all frames the same time is stopped: the frames have no time.
//! 2. If stamps are quantised in [steps](quantum) that hold several frames, the frames are spread over the step in their order.
//! 3. Steps of UTC against the [monotonic clock](super::clock) are corrected.
//! 4. Times that run back, or jump and return, while the frames' [numbers](counter) increase are corrected by these.
//! 5. Frames that still share a time keep it, with the time to the next stamp as its uncertainty; the smoothed path ignores them.

mod counter;
mod quantum;

use super::clock::{Clocks, Reading, corrected_ns};
use super::flags::{SIGMA_PER_WIDTH, TimeFlag};
use crate::observe::FrameFacts;
use crate::units::{Measured, counted};
use counter::Numbered;
use quantum::Spread;
use std::collections::{BTreeMap, HashMap};

/// The meaning of a time's sigma, in tables.
pub(super) const TIME_SIGMA: &str =
    "1 sigma of the time, where the header's contradicts others; none where it is accepted";

/// Fewer frames may have been taken at the same time.
const LEAST_STUCK: usize = 3;

/// A frame's time as stated in its file, and the position of its object, in any unit.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Stamp {
    pub utc_ns: Option<i64>,
    pub exposure_s: Option<f64>,
    pub monotonic_s: Option<f64>,
    pub number: Option<u64>,
    pub place: Option<[f64; 2]>,
}

impl Stamp {
    pub fn of(facts: &FrameFacts, place: Option<[f64; 2]>) -> Self {
        Self {
            utc_ns: facts.utc_ns,
            exposure_s: facts.exposure_s,
            monotonic_s: facts.monotonic_s,
            number: facts.number,
            place,
        }
    }
}

/// Timing of a frame's stamp.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Timing {
    /// Correction of the stamp, s.
    pub correction_s: Option<Measured>,
    /// 1 sigma of the time; none where the stamp is believed.
    pub sigma_s: Option<f64>,
    /// Why the time is flagged.
    pub flag: Option<TimeFlag>,
}

impl Timing {
    fn corrected(shift_s: f64, sigma_s: f64, flag: TimeFlag) -> Self {
        Self {
            correction_s: Some(Measured::new(shift_s, sigma_s)),
            sigma_s: Some(sigma_s),
            flag: Some(flag),
        }
    }

    /// The corrected time of a stamp; none where the clock was stopped.
    pub fn utc_ns(&self, stamped_ns: Option<i64>) -> Option<i64> {
        let stamped_ns = stamped_ns.filter(|_| self.flag != Some(TimeFlag::StoppedClock))?;
        Some(match &self.correction_s {
            Some(correction_s) => corrected_ns(stamped_ns, correction_s),
            None => stamped_ns,
        })
    }
}

/// Timing of the stamps of a camera's frames.
#[derive(Debug, Default)]
pub(super) struct Times {
    /// Timing of each frame.
    pub timings: Vec<Timing>,
    /// Clock corrections by the monotonic clock.
    pub clocks: Clocks,
}

impl Times {
    /// Takes frames in the order of their files.
    pub fn of(stamps: &[Stamp]) -> Self {
        let mut times = Self {
            timings: vec![Timing::default(); stamps.len()],
            clocks: Clocks::default(),
        };
        if is_stopped(stamps) {
            times.note(stamps, TimeFlag::StoppedClock);
            times.warn();
            return times;
        }
        let copies = copies(stamps);
        match quantum::spread(stamps, &copies) {
            Some(spread) => times.spread(stamps, &spread),
            None => times.by_monotonic_clock(stamps),
        }
        times.by_number(stamps, &copies);
        times.shared(stamps);
        times.warn();
        times
    }

    /// Logs one warning of each kind.
    fn warn(&self) {
        let mut kinds: BTreeMap<TimeFlag, u64> = BTreeMap::new();
        for flag in self.timings.iter().filter_map(|timing| timing.flag) {
            *kinds.entry(flag).or_default() += 1;
        }
        for (flag, frames) in kinds {
            tracing::warn!("{}: {flag}", counted(frames, "frame"));
        }
    }

    fn note(&mut self, stamps: &[Stamp], flag: TimeFlag) {
        for (timing, stamp) in self.timings.iter_mut().zip(stamps) {
            timing.flag = stamp.utc_ns.map(|_| flag);
        }
    }

    fn spread(&mut self, stamps: &[Stamp], spread: &Spread) {
        let sigma_s = spread.step_s * SIGMA_PER_WIDTH;
        let step_us = (spread.step_s * 1e6).round() as u64;
        for n in (0..stamps.len()).filter(|n| stamps[*n].utc_ns.is_some()) {
            let by = spread.by.zip(spread.shifts_s[n]);
            self.timings[n] = match by {
                Some((by, shift_s)) => {
                    Timing::corrected(shift_s, sigma_s, TimeFlag::CoarseTime { step_us, by })
                }
                None => Timing::corrected(spread.step_s / 2.0, sigma_s, TimeFlag::SharedTime),
            };
        }
    }

    fn by_monotonic_clock(&mut self, stamps: &[Stamp]) {
        let reading = |stamp: &Stamp| Reading::of(stamp.utc_ns, stamp.monotonic_s);
        let readings: Vec<Option<Reading>> = stamps.iter().map(reading).collect();
        self.clocks = Clocks::of(&readings);
        for (timing, shift_s) in self.timings.iter_mut().zip(&self.clocks.corrections_s) {
            if let Some(shift_s) = shift_s {
                *timing = Timing::corrected(shift_s.value, shift_s.sigma, TimeFlag::Clock);
            }
        }
    }

    fn by_number(&mut self, stamps: &[Stamp], copies: &[bool]) {
        let first_ns = stamps.iter().filter_map(|stamp| stamp.utc_ns).min();
        let numbered = |(n, stamp): (usize, &Stamp)| {
            let utc_ns = self.timings[n].utc_ns(stamp.utc_ns)?;
            Some(Numbered {
                frame: n,
                number: stamp.number?,
                time_s: (utc_ns - first_ns?) as f64 / 1e9,
                place: stamp.place,
                is_confirmed: self.clocks.confirmed.get(n) == Some(&true),
            })
        };
        let frames = stamps.iter().enumerate().filter(|(n, _)| !copies[*n]);
        let found = counter::examine(frames.filter_map(numbered).collect());
        for (n, correction_s) in found.corrections_s {
            let before_s = self.timings[n]
                .correction_s
                .map_or(0.0, |shift| shift.value);
            let shift_s = before_s + correction_s.value;
            self.timings[n] =
                Timing::corrected(shift_s, correction_s.sigma, TimeFlag::AgainstNumbers);
        }
        for (n, sigma_s) in found.shuffled {
            self.timings[n] = Timing {
                correction_s: None,
                sigma_s: Some(sigma_s),
                flag: Some(TimeFlag::ShuffledTime),
            };
        }
    }

    /// Flags frames that share a time and have no other flag: each was taken at or after it.
    fn shared(&mut self, stamps: &[Stamp]) {
        let time = |n: usize| self.timings[n].utc_ns(stamps[n].utc_ns);
        let mut dated: Vec<(i64, usize)> = (0..stamps.len())
            .filter_map(|n| Some((time(n)?, n)))
            .collect();
        dated.sort_unstable();
        let mut groups = dated.chunk_by(|a, b| a.0 == b.0).peekable();
        while let Some(group) = groups.next() {
            if group.len() < 2 {
                continue;
            }
            let next = groups.peek().map(|next| next[0].0);
            let width_s = next.map(|next| (next - group[0].0) as f64 / 1e9);
            for (_, n) in group {
                let timing = &mut self.timings[*n];
                match width_s {
                    _ if timing.flag.is_some_and(|flag| !flag.is_of_path()) => {}
                    Some(width_s) => {
                        let sigma_s = width_s * SIGMA_PER_WIDTH;
                        timing.sigma_s = Some(sigma_s.max(timing.sigma_s.unwrap_or(0.0)));
                        timing.flag = Some(TimeFlag::SharedTime);
                    }
                    None => timing.flag = Some(TimeFlag::StoppedClock),
                }
            }
        }
    }
}

/// Whether all frames have the same time.
fn is_stopped(stamps: &[Stamp]) -> bool {
    let mut times = stamps.iter().filter_map(|stamp| stamp.utc_ns);
    let first = times.next();
    let mut count = 1;
    let same = times.all(|time| {
        count += 1;
        Some(time) == first
    });
    same && count >= LEAST_STUCK
}

/// Frames that share number and time with another frame: their order cannot be determined.
fn copies(stamps: &[Stamp]) -> Vec<bool> {
    let key = |stamp: &Stamp| stamp.number.zip(stamp.utc_ns);
    let mut counts: HashMap<(u64, i64), u32> = HashMap::new();
    for key in stamps.iter().filter_map(key) {
        *counts.entry(key).or_default() += 1;
    }
    let is_copy = |stamp| key(stamp).is_some_and(|key| counts[&key] > 1);
    stamps.iter().map(is_copy).collect()
}

#[cfg(test)]
mod tests;
