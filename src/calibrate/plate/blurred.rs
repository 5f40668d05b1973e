//! Frames far less sharp than the others.

use super::sighting::{FrameSightings, Spoiled};
use crate::calibrate::numbers::median;

/// The best mark of a sharp frame is known as well as those of the other frames, within this factor.
const SHARP: f64 = 2.0;

/// Takes out the frames of which even the best mark is known far less well than in most frames: blur, haze, smear.
pub(super) fn take_blurred(frames: &mut Vec<FrameSightings>) -> Vec<Spoiled> {
    let middle = median(frames.iter().map(best_px));
    let blurred = |frame: &mut FrameSightings| best_px(frame) > SHARP * middle;
    let spoiled = |frame: FrameSightings| Spoiled {
        reason: format!(
            "not sharp: its best mark is known to {:.3} px, those of most frames to {middle:.3} px",
            best_px(&frame)
        ),
        file: frame.file,
    };
    frames.extract_if(.., blurred).map(spoiled).collect()
}

/// 1 sigma of the frame's best mark, per axis.
fn best_px(frame: &FrameSightings) -> f64 {
    let sigmas = frame
        .sightings
        .iter()
        .map(|s| s.covariance_px2.trace() / 2.0);
    sigmas.fold(f64::INFINITY, f64::min).max(0.0).sqrt()
}
