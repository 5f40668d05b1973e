//! An initial mounting, robust against any minority of wrong observations.
//!
//! If the sky were flat near the Sun, the plate would be a picture of it rotated by the clocking and scaled with the distance: a
//! similarity from the Sun's position predicted for an unrotated instrument to the observed one. Every pair of observations gives one.

use super::observation::SunObservation;
use super::side::Side;
use crate::calibrate::numbers::median;
use crate::instrument::Instrument;
use crate::pointing::Horizontal;
use crate::units::{Measured, PlateMil};
use nalgebra::{Rotation2, Vector2};

/// Number of pairs of observations that are tried: with a third of them wrong, one right pair is almost certainly among them.
const MOST_PAIRS: usize = 400;
/// A pair closer than this part of the observations' spread does not determine an angle.
const LEAST_SPREAD: f64 = 0.3;

/// A similarity on the plate: rotation, scale, shift.
#[derive(Debug, Clone, Copy)]
pub(super) struct Start {
    pub turn_deg: f64,
    pub stretch: f64,
    pub shift: Vector2<f64>,
    /// The observation that it fits best.
    pub best: usize,
}

/// The similarity of least median distance; `None` if no two observations determine an angle.
///
/// `telescope` gives the assumed pointing of the telescope at each observation.
pub(super) fn start(
    observations: &[SunObservation],
    telescope: impl Fn(&SunObservation) -> Horizontal,
    stated: &Instrument,
    side: Side,
) -> Option<Start> {
    let mut centred = stated.clone();
    centred.mounting.clocking_deg = Measured::new(0.0, 0.0);
    centred.mounting.boresight_mil = PlateMil::new(0.0, 0.0);
    let (places, pairs): (Vec<usize>, Vec<Pair>) = observations
        .iter()
        .enumerate()
        .filter_map(|(n, sun)| {
            let expected = side.shift(telescope(sun), &centred, &sun.sun)?;
            Some((n, (expected, sun.sun_plate.position.vector())))
        })
        .unzip();
    let least = LEAST_SPREAD * spread(&pairs);
    let candidates = indices(pairs.len()).filter_map(|(m, n)| through(&pairs[m], &pairs[n], least));
    let judged = candidates.map(|candidate| (median_distance(&candidate, &pairs), candidate));
    let (_, mut start) = judged.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let distance = |n: &usize| distance(&start, &pairs[*n]);
    let best = (0..pairs.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    start.best = places[best];
    Some(start)
}

type Pair = (Vector2<f64>, Vector2<f64>);

/// Deterministic pairs of indices, at all distances.
fn indices(count: usize) -> impl Iterator<Item = (usize, usize)> {
    let pairs = if count > 0 { MOST_PAIRS } else { 0 };
    // Steps by the golden section and by the square root of two visit all indices without a period.
    (0..pairs).map(move |k| {
        let part = |step: f64| (((k as f64 + 0.5) * step).fract() * count as f64) as usize;
        (part(0.618_034), part(0.414_214))
    })
}

/// The median distance of the predicted positions from their middle.
fn spread(pairs: &[Pair]) -> f64 {
    let middle = Vector2::new(
        median(pairs.iter().map(|p| p.0.x)),
        median(pairs.iter().map(|p| p.0.y)),
    );
    median(pairs.iter().map(|p| (p.0 - middle).norm()))
}

fn through(a: &Pair, b: &Pair, least: f64) -> Option<Start> {
    let (from, to) = (b.0 - a.0, b.1 - a.1);
    if from.norm() <= least || to.norm() <= f64::EPSILON {
        return None;
    }
    let turn = (to.y.atan2(to.x)) - (from.y.atan2(from.x));
    let stretch = to.norm() / from.norm();
    // The plate's distance is known better than within a factor of two.
    if !(0.5..2.0).contains(&stretch) {
        return None;
    }
    Some(Start {
        turn_deg: turn.to_degrees(),
        stretch,
        shift: a.1 - Rotation2::new(turn) * a.0 * stretch,
        best: 0,
    })
}

fn distance(start: &Start, (expected, seen): &Pair) -> f64 {
    let turn = Rotation2::new(start.turn_deg.to_radians());
    (turn * expected * start.stretch + start.shift - seen).norm()
}

fn median_distance(start: &Start, pairs: &[Pair]) -> f64 {
    median(pairs.iter().map(|pair| distance(start, pair)))
}
