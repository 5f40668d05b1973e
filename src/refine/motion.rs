//! A path between frames: place, speed and acceleration, each axis on its own. The Sun moves so over the plate, and the gondola's body in
//! roll and pitch.
//!
//! Its unit is about the size of the frames' errors: a mil on the plate, a hundredth of a degree in roll and pitch.
//!
//! The acceleration is a random walk. How far it walks, the process noise, changes with what the gondola does: it rests, swings, begins
//! and ends a slew, steps. So each axis has a process noise of its own at every frame:
//!
//! 1. The path is smoothed with each of a scale of constant process noises.
//! 2. Each frame says how well each of them foretells it from all other frames: the logarithm of its likelihood.
//! 3. The noise of greatest likelihood over the flight, where every change has a price (Viterbi 1967), times nine
//!    for caution.
//!
//! Too much process noise costs little at a frame, for the place then follows the frame's own; too little is wrong with
//! confidence.

use crate::estimation::{Gaussian, Process, Step, median, smooth};
use nalgebra::{Matrix1, Matrix3, RowVector3, Vector1, Vector3};
use rayon::prelude::*;

/// A moment of the path, with what was measured then, if anything was: place and variance in each axis. Errors of moments are
/// independent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    pub time_s: f64,
    pub measured: Option<[(f64, f64); 2]>,
}

/// The path at a moment, per axis: place, its variance, and speed a second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    pub place: [f64; 2],
    pub variance: [f64; 2],
    pub speed: [f64; 2],
}

/// The path of a flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    pub points: Vec<PathPoint>,
    /// The same with the likeliest process noise: where to look, not what to state.
    pub likeliest: Vec<PathPoint>,
    /// The likeliest process noise, the median over moments and axes: square root of its density, unit/s^2.5. The acceleration walks
    /// by so many unit/s^2 in a second.
    pub process_noise: f64,
}

/// The process noises that gondolas may have, unit/s^2.5: the least, the factor from each to the next, and how many.
const LEAST_NOISE: f64 = 0.1;
const NOISE_FACTOR: f64 = 3.0;
const NOISES: usize = 20;
/// What a change to the next larger or smaller noise costs, natural logarithm of the likelihood.
const CHANGE_COST: f64 = 2.0;
/// The noise that foretells best leaves a path that is off by as much by its stiffness as by the frames' errors: so many times
/// it, and only the errors are left.
const CAUTION: f64 = 9.0;
/// In a gap the process noise is that of so many times its length before and after.
const GAP_REACH: f64 = 5.0;
/// Frames so many usual steps apart make a gap.
const GAP_STEPS: f64 = 2.5;
/// What is known of place, speed (unit/s) and acceleration (unit/s^2) before the first frame.
const FIRST_SIGMA: [f64; 3] = [1e4, 1e3, 1e3];
/// Over longer gaps nothing is said about the path.
const LONGEST_GAP_S: f64 = 10.0;

/// The smoothed path through moments in the order of time. `None` where nothing was measured.
pub fn path(moments: &[Moment]) -> Option<Path> {
    moments.iter().find(|moment| moment.measured.is_some())?;
    let (x, y) = rayon::join(|| process_noise(moments, 0), || process_noise(moments, 1));
    let likeliest = [x, y];
    let cautious = likeliest.clone().map(|mut noise| {
        noise.iter_mut().for_each(|noise| *noise *= CAUTION);
        noise
    });
    Some(Path {
        points: points(moments, &cautious)?,
        likeliest: points(moments, &likeliest)?,
        process_noise: median(likeliest.into_iter().flatten())?,
    })
}

/// The smoothed points, with a process noise for each axis and step.
fn points(moments: &[Moment], [x_noise, y_noise]: &[Vec<f64>; 2]) -> Option<Vec<PathPoint>> {
    let (x, y) = (
        smoothed(moments, 0, x_noise)?,
        smoothed(moments, 1, y_noise)?,
    );
    let point = |(x, y): (Gaussian<3>, Gaussian<3>)| PathPoint {
        place: [x.mean.x, y.mean.x],
        variance: [x.covariance.m11, y.covariance.m11],
        speed: [x.mean.y, y.mean.y],
    };
    Some(x.into_iter().zip(y).map(point).collect())
}

/// The likeliest process noise of the step to each moment along an axis.
fn process_noise(moments: &[Moment], axis: usize) -> Vec<f64> {
    let measured = moments.iter().filter(|moment| moment.measured.is_some());
    let measured: Vec<Moment> = measured.copied().collect();
    let by_noise: Vec<Vec<f32>> = (0..NOISES)
        .into_par_iter()
        .map(|level| foretold(&measured, axis, noise(level)))
        .collect();
    let of_moment = |n: usize| std::array::from_fn(|level| by_noise[level][n]);
    let scores: Vec<Scores> = (0..measured.len()).map(of_moment).collect();
    let levels = likeliest_levels(&scores);
    // A step's noise is the larger of its two frames'.
    let steps = (0..levels.len()).map(|n| levels[n].max(levels[n.saturating_sub(1)]));
    let steps: Vec<f64> = steps.map(noise).collect();
    let steps = over_gaps(&measured, steps);
    let step_to = |moment: &Moment| {
        let next = measured.partition_point(|m| m.time_s < moment.time_s);
        steps[next.min(steps.len() - 1)]
    };
    moments.iter().map(step_to).collect()
}

fn noise(level: usize) -> f64 {
    LEAST_NOISE * NOISE_FACTOR.powi(level as i32)
}

/// How well each of the process noises foretells a moment.
type Scores = [f32; NOISES];

/// How well a constant process noise foretells each measured moment from all others: logarithm of the likelihood but for a constant. One
/// with which the filter fails foretells nothing.
fn foretold(measured: &[Moment], axis: usize, noise: f64) -> Vec<f32> {
    let Some(states) = smoothed(measured, axis, &vec![noise; measured.len()]) else {
        return vec![f32::NEG_INFINITY; measured.len()];
    };
    let score = |(state, moment): (&Gaussian<3>, &Moment)| {
        let (place, variance) = moment.measured?[axis];
        // The smoothed place holds this measurement: without it, the residual and its variance grow by the same factor.
        let left = (variance - state.covariance.m11).max(1e-9 * variance);
        let factor = variance / left;
        let chi2 = (place - state.mean.x).powi(2) * factor / variance;
        let score = -(chi2 + (factor * variance).ln()) / 2.0;
        score.is_finite().then_some(score as f32)
    };
    let scores = states.iter().zip(measured).map(score);
    scores
        .map(|score| score.unwrap_or(f32::NEG_INFINITY))
        .collect()
}

/// The level of each moment, whose scores together are greatest, less what changes cost.
fn likeliest_levels(scores: &[Scores]) -> Vec<usize> {
    let Some((first, later)) = scores.split_first() else {
        return Vec::new();
    };
    let mut best = first.map(f64::from);
    let mut came_from: Vec<[u8; NOISES]> = Vec::with_capacity(later.len());
    for scores in later {
        let before = best;
        let from = std::array::from_fn(|level| {
            let through = |from: usize| before[from] - CHANGE_COST * level.abs_diff(from) as f64;
            let best_from = (0..NOISES).max_by(|a, b| through(*a).total_cmp(&through(*b)));
            let best_from = best_from.unwrap_or(level);
            best[level] = through(best_from) + f64::from(scores[level]);
            best_from as u8
        });
        came_from.push(from);
    }
    let last = (0..NOISES).max_by(|a, b| best[*a].total_cmp(&best[*b]));
    let mut level = last.unwrap_or(0);
    let mut levels = vec![level];
    for from in came_from.iter().rev() {
        level = usize::from(from[level]);
        levels.push(level);
    }
    levels.reverse();
    levels
}

/// In a gap the gondola may do what it did before and after: the mean density of the process noise there.
fn over_gaps(measured: &[Moment], steps: Vec<f64>) -> Vec<f64> {
    let length_s = |n: usize| measured[n].time_s - measured[n - 1].time_s;
    let usual_s = median((1..measured.len()).map(length_s)).unwrap_or(f64::INFINITY);
    let step = |n: usize| {
        if n == 0 || length_s(n) < GAP_STEPS * usual_s {
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

/// The states along an axis at all moments.
fn smoothed(moments: &[Moment], axis: usize, process_noise: &[f64]) -> Option<Vec<Gaussian<3>>> {
    let axis = Axis {
        moments,
        axis,
        process_noise,
    };
    let mut states = Vec::with_capacity(moments.len());
    smooth(&axis, |_, state, _| states.push(*state))?;
    states.reverse();
    Some(states)
}

/// The path along one axis: place, speed and acceleration.
struct Axis<'a> {
    moments: &'a [Moment],
    axis: usize,
    /// Of the step to each moment.
    process_noise: &'a [f64],
}

impl Process<3> for Axis<'_> {
    fn moments(&self) -> usize {
        self.moments.len()
    }

    fn initial(&self) -> Gaussian<3> {
        let variances = FIRST_SIGMA.map(|sigma| sigma.powi(2));
        Gaussian::new(Vector3::zeros(), &variances.into())
    }

    fn step(&self, moment: usize) -> Option<Step<3>> {
        let step_s = self.moments[moment].time_s - self.moments[moment - 1].time_s;
        let [t, t2, t3, t4, t5] = [1, 2, 3, 4, 5].map(|n| step_s.max(0.0).powi(n));
        // What a random walk of the acceleration leaves.
        let walked = Matrix3::new(
            t5 / 20.0,
            t4 / 8.0,
            t3 / 6.0, //
            t4 / 8.0,
            t3 / 3.0,
            t2 / 2.0, //
            t3 / 6.0,
            t2 / 2.0,
            t,
        );
        (step_s <= LONGEST_GAP_S).then(|| Step {
            transition: Matrix3::new(1.0, t, t2 / 2.0, 0.0, 1.0, t, 0.0, 0.0, 1.0),
            noise: walked * self.process_noise[moment].powi(2),
        })
    }

    fn observe(&self, moment: usize, state: &mut Gaussian<3>) -> Option<f64> {
        let Some(measured) = self.moments[moment].measured else {
            return Some(0.0);
        };
        let (place, variance) = measured[self.axis];
        let residual = Vector1::new(place - state.mean.x);
        let innovation = state.update(
            &residual,
            &RowVector3::new(1.0, 0.0, 0.0),
            &Matrix1::new(variance),
        )?;
        Some(innovation.likelihood.log(f64::INFINITY))
    }
}
