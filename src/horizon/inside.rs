//! Whether the light within an edge goes on, or fades, as an Earth's does. That of a strut or of a flare ends as sharply as it began.

use super::edge::EdgePoint;
use super::profile::{interpolated, is_inside};
use crate::frame::{Region, Sample, View};
use crate::reasons::horizon as reasons;
use crate::units::Rejected;

/// Light is read so many scale heights apart, or pixels where these are more, and so often.
const APART_SCALES: f64 = 3.0;
const APART_PX: f64 = 4.0;
const SAMPLES: usize = 30;
/// At one place in so many.
const EVERY: usize = 3;
/// Over the edge's own fall: light that falls by so much from one sample to the next, to less than that, and for
/// most of the way on, ends.
const LEAST_FALL: f64 = 0.5;
const MOST_LEFT: f64 = 0.2;
/// It may end at this share of the places: where a strut hides it.
const MOST_ENDING: f64 = 0.4;

/// Whether light goes on within an edge whose own light falls to 1/e over `scale_px`.
///
/// # Errors
/// The share of the places where it ends.
pub(super) fn goes_on<T: Sample>(
    view: &View<'_, T>,
    mask: &[Region],
    edge: &[EdgePoint],
    scale_px: f64,
) -> Result<(), Rejected> {
    let apart_px = (APART_SCALES * scale_px).max(APART_PX);
    let ends = |point: &&EdgePoint| {
        let light = |n: f64| {
            let at = (point.at.vector() + point.inward * (n * apart_px)).into();
            is_inside(view, mask, at).then(|| f64::from(interpolated(view, at)))
        };
        let (Some(dark), Some(bright)) = (light(-1.0), light(1.0)) else {
            return false;
        };
        let fall = bright - dark;
        let inwards = (1..SAMPLES).map_while(|n| light(n as f64));
        let inwards: Vec<f64> = inwards.collect();
        let is_dark = |light: &f64| light - dark < MOST_LEFT * fall;
        inwards.windows(2).enumerate().any(|(n, pair)| {
            let rest = &inwards[n + 1..];
            let left = rest.iter().filter(|light| is_dark(light)).count();
            pair[0] - pair[1] > LEAST_FALL * fall && is_dark(&pair[1]) && 2 * left > rest.len()
        })
    };
    let some = || edge.iter().step_by(EVERY);
    let ending = some().filter(ends).count() as f64 / some().count().max(1) as f64;
    Rejected::at_most(MOST_ENDING, ending, reasons::LIGHT_ENDS)
}
