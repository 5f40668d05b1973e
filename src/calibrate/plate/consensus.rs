//! The mapping that most frames of a pose agree with, before anything is adjusted.

use super::sighting::FrameSightings;
use crate::geometry::Mapping;
use crate::plate::{MarkId, Plate};
use crate::units::SensorPx;
use std::collections::HashMap;

/// A frame's mapping rests on a few marks: elsewhere on the sensor it is off by pixels, and the lens adds some more. Wrong
/// ids are off by 47 px at least.
const AGREEING_PX: f64 = 15.0;
/// So many frames' mappings are tried, at most.
const TRIED: usize = 50;

/// What the frames of a pose agree upon.
pub(super) struct Consensus {
    pub mapping: Mapping,
    /// The frames that agree, as indices into all frames.
    pub frames: Vec<usize>,
}

/// The mapping that most of some frames agree with; `None` without frames.
pub(super) fn consensus(
    frames: &[FrameSightings],
    of_pose: &[usize],
    plate: &Plate,
) -> Option<Consensus> {
    let every = of_pose.len().div_ceil(TRIED).max(1);
    of_pose
        .iter()
        .step_by(every)
        .map(|n| {
            let mapping = frames[*n].mapping;
            let marks = plate.marks();
            let expected = marks.map(|(id, at)| (id, mapping.to_sensor(at))).collect();
            let agreeing = of_pose.iter().copied();
            let agreeing = agreeing.filter(|m| agrees(&frames[*m], &expected));
            Consensus {
                mapping,
                frames: agreeing.collect(),
            }
        })
        // The first of the best, so that the order of equals is settled.
        .rev()
        .max_by_key(|c| c.frames.len())
}

/// Whether more than half of a frame's marks were seen near where they are expected.
fn agrees(frame: &FrameSightings, expected: &HashMap<MarkId, SensorPx>) -> bool {
    let near = frame.sightings.iter().filter(|sighting| {
        let expected = expected.get(&sighting.id);
        expected.is_some_and(|at| at.distance(sighting.at) < AGREEING_PX)
    });
    2 * near.count() > frame.sightings.len()
}
