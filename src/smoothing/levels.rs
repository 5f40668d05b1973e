//! The process noise at every frame.

use super::process::{Axis, Moments, Swing};
use super::{Moment, SharedErrors};
use crate::estimation::median;
use rayon::prelude::*;

/// Ratio of successive trial values of process noise, and their number.
const NOISE_FACTOR: f64 = 3.0;
const NOISES: usize = 20;
/// Number of trial values evaluated at a time: the scores of each need memory.
const TOGETHER: usize = 4;
/// Cost of a change to the next larger or smaller noise, natural logarithm of the likelihood.
const CHANGE_COST: f64 = 2.0;
/// In a gap the process noise is the mean over this multiple of its length before and after.
const GAP_REACH: f64 = 5.0;
/// Steps longer than this multiple of the median step are gaps.
const GAP_STEPS: f64 = 2.5;

/// Input for the choice of process noises: one axis of the measured moments, and its swings.
pub(super) struct Levels<'a> {
    pub measured: &'a [Moment],
    pub axis: usize,
    pub shared: &'a SharedErrors,
    pub swings: &'a [Swing],
    /// The least process noise, unit/s^2.5.
    pub least: f64,
}

impl Levels<'_> {
    /// The most likely process noise of the step to each moment.
    pub fn likeliest(&self) -> Vec<f64> {
        let mut scores: Vec<Scores> = vec![[f32::NEG_INFINITY; NOISES]; self.measured.len()];
        let noises: Vec<usize> = (0..NOISES).collect();
        for some in noises.chunks(TOGETHER) {
            let found: Vec<Vec<f32>> = some
                .par_iter()
                .map(|level| self.predicted(self.noise(*level)))
                .collect();
            for (level, found) in some.iter().zip(found) {
                let scores = scores.iter_mut().rev().zip(found);
                scores.for_each(|(scores, score)| scores[*level] = score);
            }
        }
        let levels = likeliest_levels(&scores);
        // A step has the larger noise of its two frames.
        let steps = (0..levels.len()).map(|n| levels[n].max(levels[n.saturating_sub(1)]));
        let steps = steps.map(|level| self.noise(level)).collect();
        over_gaps(self.measured, steps)
    }

    fn noise(&self, level: usize) -> f64 {
        self.least * NOISE_FACTOR.powi(level as i32)
    }

    /// Score of a constant process noise at each measured moment, from the last to the first: logarithm of the likelihood of the moment
    /// given all others, up to a constant. Empty if the filter fails.
    fn predicted(&self, noise: f64) -> Vec<f32> {
        let moments = Moments::Measured(self.measured);
        let axis = Axis {
            moments: &moments,
            axis: self.axis,
            shared: self.shared,
            swings: self.swings,
            process_noise: &vec![noise; self.measured.len()],
        };
        let mut scores = Vec::with_capacity(self.measured.len());
        let smoothed = axis.smooth(|n, state| {
            let score = self.measured[n].measured.map(|measured| {
                let measured = measured[self.axis];
                let variance = measured.variance;
                // The smoothed position includes this measurement: without it, the residual and its variance are larger by the same factor.
                let left = (variance - state.predicted_variance).max(1e-9 * variance);
                let factor = variance / left;
                let chi2 = (measured.place - state.predicted).powi(2) * factor / variance;
                (-(chi2 + (factor * variance).ln()) / 2.0) as f32
            });
            let score = score.filter(|score| score.is_finite());
            scores.push(score.unwrap_or(f32::NEG_INFINITY));
        });
        match smoothed {
            Some(()) => scores,
            None => Vec::new(),
        }
    }
}

/// Score of each process noise at a moment.
type Scores = [f32; NOISES];

/// The sequence of levels with the greatest sum of scores, minus the cost of changes.
fn likeliest_levels(scores: &[Scores]) -> Vec<usize> {
    let Some((first, later)) = scores.split_first() else {
        return Vec::new();
    };
    let mut best = first.map(f64::from);
    let mut predecessors: Vec<[u8; NOISES]> = Vec::with_capacity(later.len());
    for scores in later {
        let before = best;
        let from = std::array::from_fn(|level| {
            let through = |from: usize| before[from] - CHANGE_COST * level.abs_diff(from) as f64;
            let best_from = (0..NOISES).max_by(|a, b| through(*a).total_cmp(&through(*b)));
            let best_from = best_from.unwrap_or(level);
            best[level] = through(best_from) + f64::from(scores[level]);
            best_from as u8
        });
        predecessors.push(from);
    }
    let last = (0..NOISES).max_by(|a, b| best[*a].total_cmp(&best[*b]));
    let mut level = last.unwrap_or(0);
    let mut levels = vec![level];
    for from in predecessors.iter().rev() {
        level = usize::from(from[level]);
        levels.push(level);
    }
    levels.reverse();
    levels
}

/// In a gap the gondola may move as before and after it: uses the mean density of the process noise there.
fn over_gaps(measured: &[Moment], steps: Vec<f64>) -> Vec<f64> {
    let length_s = |n: usize| measured[n].time_s - measured[n - 1].time_s;
    let median_step_s = median((1..measured.len()).map(length_s)).unwrap_or(f64::INFINITY);
    let step = |n: usize| {
        if n == 0 || length_s(n) < GAP_STEPS * median_step_s {
            return steps[n];
        }
        let reach_s = GAP_REACH * length_s(n);
        let (from_s, to_s) = (
            measured[n - 1].time_s - reach_s,
            measured[n].time_s + reach_s,
        );
        let from = measured.partition_point(|m| m.time_s < from_s);
        let to = measured.partition_point(|m| m.time_s <= to_s);
        let densities = steps[from..to].iter().map(|noise| noise.powi(2));
        (densities.sum::<f64>() / (to - from) as f64).sqrt()
    };
    (0..steps.len()).map(step).collect()
}
