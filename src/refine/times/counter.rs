//! Times checked against the frames' numbers.
//!
//! A camera's frame number increases with time. The longest subsequence of frames whose times rise with their numbers is correct; the other
//! frames were stamped wrongly, unless the counter restarted. So were frames between a jump of time and its return, if the camera's
//! frame rate is steady otherwise. Wrong times are replaced by times interpolated with the numbers from the frames before and after.

use super::super::flags::SIGMA_PER_WIDTH;
use crate::estimation::median;
use crate::units::Measured;

/// If a larger part of the frames shares its number with others, the counter restarted or gives no order.
const MOST_REPEATED: f64 = 0.1;
/// If times and numbers contradict each other in a larger part of the frames, neither can correct the other.
const MOST_WRONG: f64 = 0.4;
/// A camera is steady if the scatter of its steps is less than this part of a step; a step that is off by more than the second part is then
/// a jump.
const STEADY: f64 = 0.05;
const JUMP: f64 = 0.25;
/// The return of a jump equals the jump within this part of a step.
const SAME_JUMP: f64 = 0.1;
/// Numbers that are below or above the others by more than this belong to another start of the counter.
const FAR: u64 = 2;
/// Fewer frames do not determine an order.
const LEAST_FRAMES: usize = 4;

/// A frame with a number and a time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Numbered {
    pub frame: usize,
    pub number: u64,
    pub time_s: f64,
    pub place: Option<[f64; 2]>,
    /// Whether the monotonic clock confirms the time.
    pub is_confirmed: bool,
}

/// Result of checking the times against the numbers.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Found {
    /// Frames, and the correction to add to their times.
    pub corrections_s: Vec<(usize, Measured)>,
    /// Frames whose times cannot be corrected, and 1 sigma of these, s.
    pub shuffled: Vec<(usize, f64)>,
}

/// Takes frames in any order. Confirmed times are never corrected.
pub(super) fn examine(frames: Vec<Numbered>) -> Found {
    let mut is_confirmed = vec![false; frames.iter().map(|f| f.frame + 1).max().unwrap_or(0)];
    for frame in &frames {
        is_confirmed[frame.frame] = frame.is_confirmed;
    }
    let mut found = examine_all(frames);
    found.corrections_s.retain(|(n, _)| !is_confirmed[*n]);
    found.shuffled.retain(|(n, _)| !is_confirmed[*n]);
    found
}

fn examine_all(mut frames: Vec<Numbered>) -> Found {
    frames.sort_by(|a, b| (a.number.cmp(&b.number)).then(a.time_s.total_cmp(&b.time_s)));
    let repeated = frames.windows(2).filter(|p| p[0].number == p[1].number);
    let repeated = repeated.count();
    if frames.len() < LEAST_FRAMES || repeated as f64 > MOST_REPEATED * frames.len() as f64 {
        return Found::default();
    }
    let mut found = Found::default();
    // If the counter restarted, steps of its two starts may alternate.
    if repeated == 0 {
        for (n, shift) in displaced(&frames) {
            found.corrections_s.push((frames[n].frame, shift));
            frames[n].time_s += shift.value;
        }
    }
    let wrong = wrong(&frames, &longest_rising(&frames));
    let count = wrong.iter().filter(|is_wrong| **is_wrong).count();
    match count as f64 > MOST_WRONG * frames.len() as f64 {
        true => found.shuffled = shuffled(&frames),
        false => found.corrections_s.extend(replaced(&frames, &wrong)),
    }
    found
}

/// The longest subsequence of rising times.
fn longest_rising(frames: &[Numbered]) -> Vec<bool> {
    // For each length, the frame with the earliest time at which a rising sequence of that length ends.
    let mut ends: Vec<usize> = Vec::new();
    let mut before = vec![None; frames.len()];
    for (n, frame) in frames.iter().enumerate() {
        let length = ends.partition_point(|end| frames[*end].time_s < frame.time_s);
        before[n] = length.checked_sub(1).map(|shorter| ends[shorter]);
        match ends.get_mut(length) {
            // Of frames with equal times keep the first: the clock stood still after it.
            Some(end) if frames[*end].time_s == frame.time_s => {}
            Some(end) => *end = n,
            None => ends.push(n),
        }
    }
    let mut is_rising = vec![false; frames.len()];
    let mut next = ends.last().copied();
    while let Some(n) = next {
        is_rising[n] = true;
        next = before[n];
    }
    is_rising
}

/// The frames that are not rising, except for those of other starts of the counter: blocks in time whose numbers repeat those of the
/// rising ones, or are far from all of theirs.
fn wrong(frames: &[Numbered], rising: &[bool]) -> Vec<bool> {
    let mut wrong = vec![false; frames.len()];
    let mut numbers = (0..frames.len())
        .filter(|n| rising[*n])
        .map(|n| frames[n].number);
    let first = numbers.next();
    let Some((first, last)) = first.map(|first| (first, numbers.next_back().unwrap_or(first)))
    else {
        return wrong;
    };
    let is_repeated = |n: usize| {
        let number = frames[n].number;
        let near = [n.checked_sub(1), Some(n + 1)];
        let mut near = near.into_iter().flatten().filter_map(|n| frames.get(n));
        near.any(|other| other.number == number)
    };
    let mut in_time: Vec<usize> = (0..frames.len()).collect();
    in_time.sort_by(|a, b| frames[*a].time_s.total_cmp(&frames[*b].time_s));
    for block in in_time.chunk_by(|a, b| rising[*a] == rising[*b]) {
        if rising[block[0]] {
            continue;
        }
        let numbers = || block.iter().map(|n| frames[*n].number);
        let is_before = numbers().all(|number| number + FAR < first);
        let is_behind = numbers().all(|number| number > last + FAR);
        let is_other_start = block.iter().any(|n| is_repeated(*n)) || is_before || is_behind;
        block.iter().for_each(|n| wrong[*n] = !is_other_start);
    }
    wrong
}

/// Median time between successive numbers, s.
fn period<'a>(frames: impl Iterator<Item = &'a Numbered>) -> Option<f64> {
    let frames: Vec<&Numbered> = frames.collect();
    let steps = frames.windows(2).filter_map(|pair| {
        let numbers = pair[1].number - pair[0].number;
        (numbers > 0).then(|| (pair[1].time_s - pair[0].time_s) / numbers as f64)
    });
    median(steps.collect::<Vec<f64>>()).filter(|period_s| *period_s > 0.0)
}

/// Corrections of wrong times: whole runs of evenly spaced frames are shifted to fit the frames before and after.
fn replaced(frames: &[Numbered], wrong: &[bool]) -> Vec<(usize, Measured)> {
    let mut found = Vec::new();
    let right = frames.iter().zip(wrong).filter(|(_, wrong)| !**wrong);
    let Some(period_s) = period(right.map(|(frame, _)| frame)) else {
        return found;
    };
    let step_s = |a: &Numbered, b: &Numbered| period_s * (b.number - a.number) as f64;
    let goes_on = |a: usize, b: usize| {
        let (a, b) = (&frames[a], &frames[b]);
        (b.time_s - a.time_s - step_s(a, b)).abs() < 0.5 * period_s
    };
    let all: Vec<usize> = (0..frames.len()).collect();
    for run in all.chunk_by(|a, b| wrong[*a] && wrong[*b] && goes_on(*a, *b)) {
        let (first, last) = (run[0], run[run.len() - 1]);
        if !wrong[first] {
            continue;
        }
        let before = (0..first).rfind(|n| !wrong[*n]).map(|n| &frames[n]);
        let behind = (last..frames.len())
            .find(|n| !wrong[*n])
            .map(|n| &frames[n]);
        let (first, last) = (&frames[first], &frames[last]);
        let by_before = before.map(|before| before.time_s + step_s(before, first) - first.time_s);
        let by_behind = behind.map(|behind| behind.time_s - step_s(last, behind) - last.time_s);
        let shifts: Vec<f64> = by_before.into_iter().chain(by_behind).collect();
        let (Some(one), Some(other)) = (shifts.first(), shifts.last()) else {
            continue;
        };
        let sigma_s = (one - other).abs().max(period_s) * SIGMA_PER_WIDTH;
        let shift = Measured::new((one + other) / 2.0, sigma_s);
        found.extend(run.iter().map(|n| (frames[*n].frame, shift)));
    }
    found
}

/// Frames of a steady camera between a jump of time and its return, by index, with their correction.
fn displaced(frames: &[Numbered]) -> Vec<(usize, Measured)> {
    let Some(period_s) = period(frames.iter()) else {
        return Vec::new();
    };
    let ahead = |pair: &[Numbered]| {
        let numbers = (pair[1].number - pair[0].number) as f64;
        pair[1].time_s - pair[0].time_s - period_s * numbers
    };
    let ahead: Vec<f64> = frames.windows(2).map(ahead).collect();
    let scatter = median(ahead.iter().map(|s| s.abs()).collect::<Vec<f64>>());
    if scatter.is_none_or(|scatter| scatter > STEADY * period_s) {
        return Vec::new();
    }
    let jumps: Vec<usize> = (0..ahead.len())
        .filter(|n| ahead[*n].abs() > JUMP * period_s)
        .collect();
    let mut found = Vec::new();
    let mut rest = jumps.as_slice();
    while let [jump, back, others @ ..] = rest {
        let apart = ahead[*jump] + ahead[*back];
        let is_return = apart.abs() < SAME_JUMP * period_s && 2 * (back - jump) < frames.len();
        if !is_return {
            rest = &rest[1..];
            continue;
        }
        let shift = Measured::new(-ahead[*jump], period_s * SIGMA_PER_WIDTH);
        found.extend((jump + 1..=*back).map(|n| (n, shift)));
        rest = others;
    }
    found
}

/// Frames whose times and numbers contradict each other throughout, with 1 sigma of their times, s. Empty if the object's motion shows that
/// the numbers are wrong: its path is longer in the wrong order.
fn shuffled(frames: &[Numbered]) -> Vec<(usize, f64)> {
    let way = |frames: &[Numbered]| {
        let places: Vec<[f64; 2]> = frames.iter().filter_map(|frame| frame.place).collect();
        let step = |pair: &[[f64; 2]]| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]);
        places.windows(2).map(step).sum::<f64>()
    };
    let mut in_time = frames.to_vec();
    in_time.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    if way(&in_time) <= way(frames) {
        tracing::warn!("the frames' numbers do not follow their times: they are not used");
        return Vec::new();
    }
    let (first, last) = (in_time[0], in_time[in_time.len() - 1]);
    let sigma_s = (last.time_s - first.time_s) * SIGMA_PER_WIDTH;
    frames.iter().map(|frame| (frame.frame, sigma_s)).collect()
}
