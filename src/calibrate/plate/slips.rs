//! Detects slips of the camera: moments at which it moved in its mount, too little to be obvious as another pose.
//!
//! # Algorithm
//! While the camera is at rest, a mark stays at one sensor position, whatever the lens and wherever the mark was drawn. So each mark that is
//! observed on both sides of a moment, last before it and first after it, measures the motion in between ([`Pair`]).
//!
//! 1. A slow drift (a shift polynomial in time, rotation and stretch linear in time) is fitted to the pairs of all moments. The adjustment
//!    models such a shift ([`State`](super::adjust::State)).
//! 2. For each moment, the residuals of the pairs around it are fitted by one sudden shift, rotation and stretch. The moment at which
//!    this is most significant is a slip, if it is significant enough.
//! 3. The same for the frames before it and for those after it.
//! 4. Each of several slips is searched again between its neighbours, where no pair includes another slip.
//!
//! Both fits are robust: an isolated frame, or misidentified marks, do not make a slip.

use super::adjust::{DRIFT, drift_terms};
use super::motion::{Displacement, LOSS, motion};
use super::observation::FrameObservation;
use crate::plate::MarkId;
use nalgebra::{SMatrix, Vector2, Vector4};
use std::collections::BTreeMap;

/// Fewest frames on either side of a slip.
const LEAST_FRAMES: usize = 3;
/// Fewest marks observed on both sides of it.
const LEAST_PAIRS: usize = 8;
/// Least chi^2, of four degrees of freedom, of a slip. A camera at rest reaches 40 at one moment in 20 million.
const SLIP_CHI2: f64 = 40.0;

/// Derivatives of a mark's position by shift, rotation and stretch linear in time, and by the shift's further terms.
type Matrix2xDrift = SMatrix<f64, 2, { 4 + 2 * (DRIFT - 1) }>;

/// A mark observed twice, and not in between.
#[derive(Debug, Clone, Copy)]
struct Pair {
    /// Indices of the two frames in the order of time.
    frames: [usize; 2],
    /// Change of the drift terms in between.
    terms: [f64; DRIFT],
    moved: Displacement,
}

impl Pair {
    /// Displacement of the mark for one px of each term of a drift: shift, rotation and stretch linear in time, then the shift's further terms.
    fn drift_slopes(&self) -> Matrix2xDrift {
        let [even, further @ ..] = self.terms;
        let mut slopes = Matrix2xDrift::zeros();
        let evenly = self.moved.slopes() * even;
        slopes.fixed_columns_mut::<4>(0).copy_from(&evenly);
        for (n, term) in further.into_iter().enumerate() {
            slopes[(0, 4 + 2 * n)] = term;
            slopes[(1, 5 + 2 * n)] = term;
        }
        slopes
    }
}

/// The frames of a pose, in the order of time, as runs between slips. Frames of the same time are not separated.
pub(super) fn runs(frames: &[&FrameObservation], of_pose: &[usize]) -> Vec<Vec<usize>> {
    let mut order = of_pose.to_vec();
    order.sort_by_key(|n| (frames[*n].utc, *n));
    let mut runs = split(frames, order);
    for later in 1..runs.len() {
        let both = [runs[later - 1].as_slice(), &runs[later]].concat();
        if let Some(first_after) = slip(frames, &both) {
            let (before, after) = both.split_at(first_after);
            (runs[later - 1], runs[later]) = (before.to_vec(), after.to_vec());
        }
    }
    runs
}

/// Splits frames at the most significant slip, then each part again.
fn split(frames: &[&FrameObservation], order: Vec<usize>) -> Vec<Vec<usize>> {
    let Some(first_after) = slip(frames, &order) else {
        return vec![order];
    };
    let (before, after) = order.split_at(first_after);
    [before, after]
        .map(|part| split(frames, part.to_vec()))
        .concat()
}

/// The first frame after the most significant slip, as its index in the order of time.
fn slip(frames: &[&FrameObservation], order: &[usize]) -> Option<usize> {
    let pairs = without_drift(pairs(frames, order)?)?;
    let possible = LEAST_FRAMES..(order.len() + 1).saturating_sub(LEAST_FRAMES);
    let moment = |n: &usize| frames[order[n - 1]].utc < frames[order[*n]].utc;
    let found = possible.filter(moment).filter_map(|first_after| {
        let across = |pair: &&Pair| pair.frames[0] < first_after && first_after <= pair.frames[1];
        let across: Vec<&Pair> = pairs.iter().filter(across).collect();
        let slopes = across.iter().map(|pair| (&pair.moved, pair.moved.slopes()));
        let motion = (across.len() >= LEAST_PAIRS).then(|| motion(slopes))?;
        Some((first_after, explained(&across, &motion.ok()?.parameters)))
    });
    let best = found.max_by(|a, b| a.1.total_cmp(&b.1))?;
    (best.1 > SLIP_CHI2).then_some(best.0)
}

/// All marks that were observed again. `None` if the frames do not state their times.
fn pairs(frames: &[&FrameObservation], order: &[usize]) -> Option<Vec<Pair>> {
    let first = frames[*order.first()?].utc?;
    let places = order.iter().flat_map(|n| &frames[*n].marks);
    let count = places.clone().count().max(1) as f64;
    let middle = places.map(|mark| mark.at.vector()).sum::<Vector2<f64>>() / count;
    let last_s = frames[*order.last()?]
        .utc?
        .duration_since(first)
        .as_secs_f64();
    let mut last: BTreeMap<MarkId, (usize, [f64; DRIFT], Vector2<f64>, f64)> = BTreeMap::new();
    let mut pairs = Vec::new();
    for (place, n) in order.iter().enumerate() {
        let since_first_s = frames[*n].utc?.duration_since(first).as_secs_f64();
        let terms = drift_terms(2.0 * since_first_s / last_s.max(1e-3) - 1.0);
        for mark in &frames[*n].marks {
            let variance = mark.covariance_px2.trace() / 2.0;
            let now = (place, terms, mark.at.vector(), variance);
            if let Some(before) = last.insert(mark.id, now) {
                pairs.push(Pair {
                    frames: [before.0, place],
                    terms: std::array::from_fn(|n| terms[n] - before.1[n]),
                    moved: Displacement {
                        at: now.2 - middle,
                        moved_px: now.2 - before.2,
                        sigma_px: (before.3 + variance).sqrt(),
                    },
                });
            }
        }
    }
    Some(pairs)
}

/// The pairs with slow drift removed, their sigmas inflated to the remaining scatter.
fn without_drift(mut pairs: Vec<Pair>) -> Option<Vec<Pair>> {
    let slopes = pairs.iter().map(|pair| (&pair.moved, pair.drift_slopes()));
    let drift = motion(slopes).ok()?;
    for pair in &mut pairs {
        pair.moved.moved_px -= pair.drift_slopes() * drift.parameters;
        pair.moved.sigma_px *= drift.scatter.max(1.0);
    }
    Some(pairs)
}

/// Decrease of the cost of the pairs around a moment by a sudden motion, as chi^2. Pairs that it makes worse count against the moment:
/// this determines on which side of the slip a frame was taken.
fn explained(pairs: &[&Pair], motion: &Vector4<f64>) -> f64 {
    let cost = |motion: &Vector4<f64>| -> f64 {
        let sizes = pairs.iter().map(|pair| pair.moved.residual(motion).norm());
        sizes.map(|size| LOSS.cost(size)).sum()
    };
    cost(&Vector4::zeros()) - cost(motion)
}
