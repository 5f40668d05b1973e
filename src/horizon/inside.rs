//! Check that the light inside an edge continues, or fades, as an Earth's does. The light of a strut or of a flare ends as
//! sharply as it begins.

use super::edge::EdgePoint;
use super::profile::{interpolated, is_inside, read_along};
use crate::frame::{Region, Sample, View};
use crate::kernels::LANES;
use crate::kernels::paths::OnPath;
use crate::reasons::horizon as reasons;
use crate::units::Rejected;
use nalgebra::Vector2;

/// Spacing of the samples in scale heights, its minimum in px, and the number of samples.
const APART_SCALES: f64 = 3.0;
const APART_PX: f64 = 4.0;
const SAMPLES: usize = 30;
/// Every `EVERY`-th place is checked.
const EVERY: usize = 3;
/// The light ends where it falls from one sample to the next by more than `LEAST_FALL` of the edge's own fall, to less than
/// `MOST_LEFT` of it, and stays that low for most of the remaining samples.
const LEAST_FALL: f32 = 0.5;
const MOST_LEFT: f32 = 0.2;
/// Maximum share of the places where it ends, for example at a strut.
const MOST_ENDING: f64 = 0.4;

/// Checks that light continues inside an edge whose own light falls to 1/e over `scale_px`.
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
    let mut groups = [OnPath::default(); SAMPLES.div_ceil(LANES)];
    let mut light = [0.0; SAMPLES.next_multiple_of(LANES)];
    let ends = |point: &&EdgePoint| {
        let path = [point.at.vector(), point.inward * apart_px, Vector2::zeros()];
        let is_seen = |n: &usize| is_inside(view, mask, (path[0] + path[1] * (*n as f64)).into());
        let before = path[0] - path[1];
        if !is_inside(view, mask, before.into()) || !is_seen(&1) {
            return false;
        }
        let dark = interpolated(view, before.into());
        let count = (1..SAMPLES).take_while(is_seen).count();
        let groups = &mut groups[..count.div_ceil(LANES)];
        read_along(view, &path, 1.0, groups, &mut light);
        let inwards = &light[..count];
        let fall = inwards[0] - dark;
        let is_dark = |light: &f32| light - dark < MOST_LEFT * fall;
        inwards.windows(2).enumerate().any(|(n, pair)| {
            let rest = &inwards[n + 1..];
            let dark = || rest.iter().filter(|light| is_dark(light)).count();
            pair[0] - pair[1] > LEAST_FALL * fall && is_dark(&pair[1]) && 2 * dark() > rest.len()
        })
    };
    let some = || edge.iter().step_by(EVERY);
    let ending = some().filter(ends).count() as f64 / some().count().max(1) as f64;
    Rejected::at_most(MOST_ENDING, ending, reasons::LIGHT_ENDS)
}
