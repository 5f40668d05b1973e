//! Stamps quantised in steps, such as whole seconds, that hold several frames.
//!
//! A stamp states that a frame was taken between it and the next one. The quantity that orders the frames (the monotonic clock, their
//! numbers, else the files) increases evenly with time: a straight line of time through as many frames as their steps allow, then the
//! next line.

use super::super::flags::Order;
use super::Stamp;
use crate::estimation::median;
use std::collections::HashMap;

/// Known steps of camera clocks, us.
const STEPS_US: [i64; 7] = [
    60_000_000, 10_000_000, 2_000_000, 1_000_000, 100_000, 15_625, 10_000,
];
/// Part of the stamps that must lie on the steps.
const ON_STEPS: f64 = 0.95;
/// If a smaller part of the frames shares its stamp, the cause is not quantisation.
const LEAST_SHARING: f64 = 0.1;
/// Part of the steps that must be in order.
const IN_ORDER: f64 = 0.9;
/// The pace of the order is measured over at most this many stamps.
const LONGEST_BASE: usize = 200;
/// Largest deviation of the monotonic clock's apparent pace from one.
const MONOTONIC_PACE: f64 = 0.1;

/// Result of spreading quantised stamps.
#[derive(Debug, PartialEq)]
pub(super) struct Spread {
    pub step_s: f64,
    /// The order used; none if nothing orders the frames.
    pub by: Option<Order>,
    /// Correction of each frame's stamp; none where the frame cannot be placed.
    pub shifts_s: Vec<Option<f64>>,
}

/// Frames with quantised stamps.
struct Stepped {
    step_us: i64,
    /// Stamp and frame, in the order of both.
    stamps: Vec<(i64, usize)>,
}

/// A frame with its ordering key.
#[derive(Clone, Copy)]
struct Ordered {
    stamp_us: f64,
    key: f64,
    frame: usize,
}

/// Spreads the frames over steps that hold several of them; `None` if there is no such step. Twins are not placed.
pub(super) fn spread(stamps: &[Stamp], copies: &[bool]) -> Option<Spread> {
    // The camera stamps either the start of the exposure or its middle.
    let both = [0.5, 0.0].map(|part| Stepped::of(stamps, part));
    let stepped = both.into_iter().flatten();
    let stepped = stepped.max_by_key(|stepped| stepped.step_us)?;
    let line = [Order::Monotonic, Order::Number, Order::Files]
        .into_iter()
        .find_map(|by| Some((by, stepped.ordered(stamps, copies, by)?)));
    let sharing = stepped.sharing() > LEAST_SHARING;
    let mut spread = Spread {
        step_s: stepped.step_us as f64 / 1e6,
        by: None,
        shifts_s: vec![None; stamps.len()],
    };
    let Some((by, (frames, pace))) = line else {
        return sharing.then_some(spread);
    };
    let times = times(&frames, pace, stepped.step_us as f64);
    let shifts = || frames.iter().zip(&times.us).map(|(f, us)| us - f.stamp_us);
    if !sharing && (by == Order::Files || !times.is_uneven(shifts(), &stepped)) {
        return None;
    }
    spread.by = Some(by);
    for (frame, shift_us) in frames.iter().zip(shifts()) {
        spread.shifts_s[frame.frame] = Some(shift_us / 1e6);
    }
    Some(spread)
}

impl Stepped {
    /// Finds the longest step on which the stamps lie, after subtracting `part` of the exposure.
    fn of(stamps: &[Stamp], part: f64) -> Option<Self> {
        let stamp_us = |stamp: &Stamp| {
            let before_ns = (stamp.exposure_s.unwrap_or(0.0) * part * 1e9).round() as i64;
            Some((stamp.utc_ns? - before_ns + 500).div_euclid(1000))
        };
        let frames = stamps.iter().enumerate();
        let mut stamps: Vec<(i64, usize)> = frames
            .filter_map(|(n, stamp)| Some((stamp_us(stamp)?, n)))
            .collect();
        stamps.sort_unstable();
        let mut steps = HashMap::<i64, usize>::new();
        for pair in stamps.windows(2).filter(|pair| pair[0].0 < pair[1].0) {
            *steps.entry(pair[1].0 - pair[0].0).or_default() += 1;
        }
        let most_common = steps
            .into_iter()
            .max_by_key(|(step, times)| (*times, *step));
        let (most_common, _) = most_common?;
        let least = STEPS_US[STEPS_US.len() - 1];
        let mut steps = STEPS_US.to_vec();
        steps.extend((most_common >= least).then_some(most_common));
        steps.sort_unstable_by_key(|step| -step);
        let on = |step: &i64| {
            let mut counts = HashMap::<i64, usize>::new();
            for (stamp, _) in &stamps {
                *counts.entry(stamp.rem_euclid(*step)).or_default() += 1;
            }
            let most = counts.into_values().max().unwrap_or(0);
            most as f64 >= ON_STEPS * stamps.len() as f64
        };
        let step_us = steps.into_iter().find(on)?;
        Some(Self { step_us, stamps })
    }

    fn groups(&self) -> impl Iterator<Item = &[(i64, usize)]> {
        self.stamps.chunk_by(|a, b| a.0 == b.0)
    }

    /// Part of the frames that share their stamp with others.
    fn sharing(&self) -> f64 {
        let sharing = self.groups().filter(|group| group.len() > 1);
        sharing.map(<[_]>::len).sum::<usize>() as f64 / self.stamps.len() as f64
    }

    /// The frames sorted by `by`, and the time per unit of its key, us; `None` if it does not order them.
    fn ordered(&self, stamps: &[Stamp], copies: &[bool], by: Order) -> Option<(Vec<Ordered>, f64)> {
        let mut keys = 0;
        let mut in_order = [0, 0];
        let mut frames: Vec<Ordered> = Vec::with_capacity(self.stamps.len());
        for group in self.groups() {
            let begin = frames.len();
            for (stamp_us, n) in group.iter().filter(|(_, n)| !copies[*n]) {
                let key = match by {
                    Order::Monotonic => stamps[*n].monotonic_s,
                    Order::Number => stamps[*n].number.map(|number| number as f64),
                    Order::Files => Some(*n as f64),
                };
                keys += 1;
                frames.extend(key.map(|key| Ordered {
                    stamp_us: *stamp_us as f64,
                    key,
                    frame: *n,
                }));
            }
            frames[begin..].sort_by(|a, b| a.key.total_cmp(&b.key));
            let pairs = begin.checked_sub(1).zip(frames.get(begin));
            if let Some((last, first)) = pairs {
                in_order[0] += 1;
                in_order[1] += usize::from(frames[last].key < first.key);
            }
        }
        if by == Order::Files {
            // The files of one stamp may be anywhere among those of other cameras: use their rank.
            (0..frames.len()).for_each(|rank| frames[rank].key = rank as f64);
        }
        let enough = |part: usize, all: usize| part as f64 >= IN_ORDER * all as f64;
        if !enough(frames.len(), keys) || !enough(in_order[1], in_order[0]) || in_order[0] == 0 {
            return None;
        }
        let pace = pace(&frames).unwrap_or_default();
        match by {
            Order::Monotonic if (pace / 1e6 - 1.0).abs() < MONOTONIC_PACE => Some((frames, 1e6)),
            Order::Number | Order::Files if pace > 0.0 => Some((frames, pace)),
            _ => None,
        }
    }
}

/// Time per unit of the ordering key, us.
///
/// The first frame of each stamp is near the stamp, except for the first stamp of all, of which frames may be missing.
fn pace(frames: &[Ordered]) -> Option<f64> {
    let groups = frames.chunk_by(|a, b| a.stamp_us == b.stamp_us).skip(1);
    let firsts: Vec<Ordered> = groups.map(|group| group[0]).collect();
    let base = (firsts.len() / 2).clamp(1, LONGEST_BASE);
    let paces = firsts.windows(base + 1).filter_map(|part| {
        let (first, last) = (part[0], part[base]);
        let pace = (last.stamp_us - first.stamp_us) / (last.key - first.key);
        (last.key > first.key).then_some(pace)
    });
    median(paces.collect::<Vec<f64>>())
}

/// Times of frames, fitted by straight lines.
struct Lines {
    us: Vec<f64>,
    lines: usize,
}

impl Lines {
    /// Whether the frames are so even, and their stamps so uneven, that only quantisation explains it.
    fn is_uneven(&self, shifts: impl Iterator<Item = f64>, stepped: &Stepped) -> bool {
        let (least, most) = shifts.fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), s| {
            (least.min(s), most.max(s))
        });
        10 * self.lines <= self.us.len() && most - least > stepped.step_us as f64 / 2.0
    }
}

/// Fits lines: each passes through as many frames as possible within their steps; of the possible lines, the middle one.
fn times(frames: &[Ordered], pace: f64, step_us: f64) -> Lines {
    let mut found = Lines {
        us: Vec::with_capacity(frames.len()),
        lines: 0,
    };
    let mut rest = frames;
    while let Some(first) = rest.first() {
        // No earlier than the previous frame.
        let begin = found
            .us
            .last()
            .map_or(first.stamp_us, |us| first.stamp_us.max(*us));
        let (mut least, mut most) = (begin - pace * first.key, f64::INFINITY);
        let fitting = rest.iter().take_while(|frame| {
            let at = frame.stamp_us - pace * frame.key;
            let (low, high) = (least.max(at), most.min(at + step_us));
            let fits = low <= high;
            if fits {
                (least, most) = (low, high);
            }
            fits
        });
        let count = fitting.count().max(1);
        let line = (least + most.min(least + step_us)) / 2.0;
        let (through, others) = rest.split_at(count);
        found
            .us
            .extend(through.iter().map(|frame| line + pace * frame.key));
        found.lines += 1;
        rest = others;
    }
    found
}
