//! When the camera slipped: the moments at which it moved in its mount, too little to be another pose at a glance.
//!
//! # Algorithm
//! While the camera rests, a mark is seen in one place, whatever the lens and wherever the mark was drawn. So each mark that is seen on
//! both sides of a moment, last before it and first after it, tells what happened in between ([`Pair`]).
//!
//! 1. An even drift (shift, turn and stretch by the hour) explains the pairs of all moments as well as it can. The adjustment
//!    knows such a drift ([`State`](super::adjust::State)).
//! 2. For each moment, what the drift leaves of the pairs about it is fitted by one sudden shift, turn and stretch. The moment at which
//!    this is the most significant is a slip, if it is significant enough.
//! 3. The same for the frames before it and for those after it.
//! 4. Of several slips each is sought again between its neighbours, where no pair shows another slip beside it.
//!
//! Both fits are robust: a frame that stands alone, and marks taken for others, do not make a slip.

use super::observation::FrameObservation;
use crate::estimation::{
    FitError, Fitted, LeastSquares, Linearised, Loss, Prior, Scale, TUKEY_SIGMAS_2D,
};
use crate::plate::MarkId;
use nalgebra::{Matrix2x4, Vector2, Vector4};
use std::collections::BTreeMap;

/// Fewest frames on either side of a slip.
const LEAST_FRAMES: usize = 3;
/// Fewest marks seen on both sides of it.
const LEAST_PAIRS: usize = 8;
/// Pairs that are farther off than this do not count.
const LOSS: Loss = Loss::Tukey(TUKEY_SIGMAS_2D);
/// A slip has chi^2 of four so large. Rest reaches 40 at one moment in 20 million.
const SLIP_CHI2: f64 = 40.0;
/// Turns and stretches are told as displacements at this distance from the middle of the marks, px.
const REACH_PX: f64 = 500.0;

/// A mark seen twice, and not in between.
#[derive(Debug, Clone, Copy)]
struct Pair {
    /// Places of the two frames in the order of time.
    frames: [usize; 2],
    hours: f64,
    /// From the first place to the second, px.
    moved: Vector2<f64>,
    /// 1 sigma of it per axis.
    sigma_px: f64,
    /// Where it was seen, from the middle of all marks.
    at: Vector2<f64>,
}

impl Pair {
    /// Displacement of the mark by one px of shift x, shift y, turn and stretch.
    fn slopes(&self) -> Matrix2x4<f64> {
        let at = self.at / REACH_PX;
        Matrix2x4::new(1.0, 0.0, -at.y, at.x, 0.0, 1.0, at.x, at.y)
    }

    /// What a sudden motion leaves of it, in its sigmas.
    fn left_by(&self, motion: &Vector4<f64>) -> Vector2<f64> {
        (self.moved - self.slopes() * motion) / self.sigma_px
    }

    /// What it says of a motion that the pair shows in part: by the hour, or all at once.
    fn of_motion(&self, share: f64) -> Linearised<2, 4> {
        Linearised {
            residual: self.moved / self.sigma_px,
            jacobian: self.slopes() * (share / self.sigma_px),
        }
    }
}

/// The frames of a pose, in the order of time, by runs between slips. Frames of the same time are not parted.
pub(super) fn runs(frames: &[FrameObservation], of_pose: &[usize]) -> Vec<Vec<usize>> {
    let mut order = of_pose.to_vec();
    order.sort_by_key(|n| (frames[*n].utc, *n));
    let mut runs = parted(frames, order);
    for later in 1..runs.len() {
        let both = [runs[later - 1].as_slice(), &runs[later]].concat();
        if let Some(first_after) = slip(frames, &both) {
            let (before, after) = both.split_at(first_after);
            (runs[later - 1], runs[later]) = (before.to_vec(), after.to_vec());
        }
    }
    runs
}

/// Parts frames at the most significant slip, then each part again.
fn parted(frames: &[FrameObservation], order: Vec<usize>) -> Vec<Vec<usize>> {
    let Some(first_after) = slip(frames, &order) else {
        return vec![order];
    };
    let (before, after) = order.split_at(first_after);
    [before, after]
        .map(|part| parted(frames, part.to_vec()))
        .concat()
}

/// The first frame after the most significant slip, as its place in the order of time.
fn slip(frames: &[FrameObservation], order: &[usize]) -> Option<usize> {
    let pairs = at_rest_but_for_slips(pairs(frames, order)?)?;
    let possible = LEAST_FRAMES..(order.len() + 1).saturating_sub(LEAST_FRAMES);
    let moment = |n: &usize| frames[order[n - 1]].utc < frames[order[*n]].utc;
    let found = possible.filter(moment).filter_map(|first_after| {
        let across = |pair: &&Pair| pair.frames[0] < first_after && first_after <= pair.frames[1];
        let across: Vec<&Pair> = pairs.iter().filter(across).collect();
        let motion = (across.len() >= LEAST_PAIRS).then(|| motion(&across, |_| 1.0))?;
        Some((first_after, explained(&across, &motion.ok()?.parameters)))
    });
    let best = found.max_by(|a, b| a.1.total_cmp(&b.1))?;
    (best.1 > SLIP_CHI2).then_some(best.0)
}

/// All marks that were seen again. `None` where the frames do not tell their times.
fn pairs(frames: &[FrameObservation], order: &[usize]) -> Option<Vec<Pair>> {
    let first = frames[*order.first()?].utc?;
    let places = order.iter().flat_map(|n| &frames[*n].marks);
    let count = places.clone().count().max(1) as f64;
    let middle = places.map(|mark| mark.at.vector()).sum::<Vector2<f64>>() / count;
    let mut last: BTreeMap<MarkId, (usize, f64, Vector2<f64>, f64)> = BTreeMap::new();
    let mut pairs = Vec::new();
    for (place, n) in order.iter().enumerate() {
        let hours = frames[*n].utc?.duration_since(first).as_secs_f64() / 3600.0;
        for mark in &frames[*n].marks {
            let variance = mark.covariance_px2.trace() / 2.0;
            let now = (place, hours, mark.at.vector(), variance);
            if let Some(before) = last.insert(mark.id, now) {
                pairs.push(Pair {
                    frames: [before.0, place],
                    hours: hours - before.1,
                    moved: now.2 - before.2,
                    sigma_px: (before.3 + variance).sqrt(),
                    at: now.2 - middle,
                });
            }
        }
    }
    Some(pairs)
}

/// The pairs without what an even drift explains, their sigmas inflated to what they then scatter.
fn at_rest_but_for_slips(mut pairs: Vec<Pair>) -> Option<Vec<Pair>> {
    let all: Vec<&Pair> = pairs.iter().collect();
    let drift = motion(&all, |pair| pair.hours).ok()?;
    for pair in &mut pairs {
        pair.moved -= pair.slopes() * drift.parameters * pair.hours;
        pair.sigma_px *= drift.scatter.max(1.0);
    }
    Some(pairs)
}

/// Shift x and y, turn and stretch, px, of which each pair shows its share.
fn motion(pairs: &[&Pair], share: impl Fn(&Pair) -> f64) -> Result<Fitted<4>, FitError> {
    // A turn or stretch that the marks do not determine is none.
    const UNKNOWN_PX: f64 = 10.0;
    let fit = LeastSquares {
        start: Vector4::zeros(),
        prior: Prior {
            mean: Vector4::zeros(),
            information: Vector4::repeat(UNKNOWN_PX.powi(-2)),
        },
        loss: LOSS,
        scale: Scale::Median,
        tolerance_sigmas: 1e-2,
    };
    fit.fit(|motion| {
        let row = |pair: &&Pair| {
            let row = pair.of_motion(share(pair));
            Linearised {
                residual: row.residual - row.jacobian * motion,
                ..row
            }
        };
        Some(pairs.iter().map(row).collect())
    })
}

/// By how much a sudden motion lowers the cost of the pairs about a moment, as chi^2. Pairs that it makes worse count against the moment:
/// this tells on which side of the slip a frame was taken.
fn explained(pairs: &[&Pair], motion: &Vector4<f64>) -> f64 {
    let cost = |motion: &Vector4<f64>| -> f64 {
        let sizes = pairs.iter().map(|pair| pair.left_by(motion).norm());
        sizes.map(|size| LOSS.cost(size)).sum()
    };
    cost(&Vector4::zeros()) - cost(motion)
}
