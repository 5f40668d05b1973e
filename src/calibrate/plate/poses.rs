//! Which frames were taken in which pose of the camera: a folder holds one pose or several, in whatever order.
//!
//! # Algorithm
//! 1. The mapping that most frames of the folder agree with gathers its frames ([`consensus`]); of those left, again the one
//!    that most agree with, and so on. This separates poses that differ by some 15 px and more anywhere on the plate.
//! 2. Where the camera slipped in the order of time, another pose begins ([`slips`](super::slips)).
//! 3. Within a pose a mark that two frames share is in the same place, whatever the lens and wherever the mark is.
//!    Frames that share marks are linked where these agree; frames so linked that contradict the others are another pose.
//!    Neighbours need to agree, not all frames: a slow drift by less than a pixel is no move. Frames that share too little
//!    belong to the pose before and after them.
//!
//! Fewer than three frames are no pose but outliers, unless one is of the lit plate, which shows all marks.

use super::fit::PlateFit;
use super::measure::Folder;
use super::observation::{FrameObservation, consensus};
use super::refusal::Refusal;
use super::slips;
use crate::observe::RejectedFrame;
use crate::plate::{MarkId, Plate};
use crate::units::SensorPx;
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::PathBuf;

/// The camera at rest.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pose {
    /// The folder that holds its frames.
    pub folder: PathBuf,
    /// Which of the poses found in the folder, from 1; none where it is the only one.
    pub number: Option<usize>,
}

impl fmt::Display for Pose {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}", self.folder.display())?;
        self.number.map_or(Ok(()), |n| write!(out, " ({n})"))
    }
}

/// Frames by pose, and those of none.
#[derive(Debug, Clone, Default)]
pub(super) struct Posed {
    pub poses: Vec<Pose>,
    pub frames: Vec<FrameObservation>,
    pub rejected: Vec<RejectedFrame>,
}

/// Fewest frames of a pose that is not its folder's only one.
const LEAST_FRAMES: usize = 3;
/// A mark is in the same place in two frames of a pose, within this.
const SAME_PLACE_PX: f64 = 0.5;
/// Two frames that share so many marks in their places are linked: one may agree by chance.
const LINKING_MARKS: usize = 2;
/// Each observation of a mark is compared with so many others of it.
const COMPARED: usize = 40;

/// Finds the poses of each folder. The frames come with the index of their folder in the place of the pose.
///
/// # Errors
/// A folder of which half of the frames or more agree with no other.
pub(super) fn find(
    folders: &[Folder],
    frames: &[FrameObservation],
    plate: &Plate,
) -> Result<Posed, Refusal> {
    let mut posed = Posed::default();
    let mut pose_of: Vec<Option<usize>> = vec![None; frames.len()];
    for (n, folder) in folders.iter().enumerate() {
        let of_folder: Vec<usize> = (0..frames.len()).filter(|m| frames[*m].pose == n).collect();
        if of_folder.is_empty() {
            continue;
        }
        let groups = groups(frames, &of_folder, plate);
        let agreeing = groups.iter().map(Vec::len).sum::<usize>();
        if 2 * agreeing <= of_folder.len() {
            return Err(Refusal::NoPose {
                folder: folder.path.clone(),
                agreeing,
                frames: of_folder.len(),
            });
        }
        for group in groups {
            let pose = posed.poses.len();
            group.iter().for_each(|m| pose_of[*m] = Some(pose));
            posed.poses.push(Pose {
                folder: folder.path.clone(),
                number: None,
            });
        }
    }
    posed.number();
    for (frame, pose) in frames.iter().zip(pose_of) {
        match pose {
            Some(pose) => posed.frames.push(FrameObservation {
                pose,
                ..frame.clone()
            }),
            None => posed.rejected.push(RejectedFrame::new(
                &frame.file,
                "its marks lie elsewhere than those of the other frames of its folder",
            )),
        }
    }
    Ok(posed)
}

/// The poses among the frames of a folder, in the order in which they were first taken.
fn groups(frames: &[FrameObservation], of_folder: &[usize], plate: &Plate) -> Vec<Vec<usize>> {
    let enough = |group: &[usize]| {
        let lit = group.iter().any(|n| frames[*n].sun.is_none());
        lit || group.len() >= LEAST_FRAMES || 2 * group.len() > of_folder.len()
    };
    let mut rest = of_folder.to_vec();
    let mut groups = Vec::new();
    while let Some(agreed) = consensus(frames, &rest, plate) {
        if !enough(&agreed.frames) {
            break;
        }
        let gathered: BTreeSet<usize> = agreed.frames.iter().copied().collect();
        rest.retain(|n| !gathered.contains(n));
        let runs = slips::runs(frames, &agreed.frames);
        groups.extend(runs.iter().flat_map(|run| apart(frames, run)));
    }
    let first = |group: &Vec<usize>| group.iter().map(|n| (frames[*n].utc, *n)).min();
    groups.sort_by_key(first);
    groups
}

/// How many of the marks that two frames share are in the same place in both, and how many are not.
#[derive(Debug, Clone, Copy, Default)]
struct Shared {
    same: usize,
    other: usize,
}

/// Parts of some frames of nearly one mapping, in the order of time, that contradict each other in the marks that they share.
/// Islands, which neither agree with a part nor are one, belong to the part that was taken before and after them.
fn apart(frames: &[FrameObservation], group: &[usize]) -> Vec<Vec<usize>> {
    let shared = shared(frames, group);
    let mut parts: Vec<Vec<usize>> = Vec::new();
    let mut islands = Vec::new();
    for linked in linked(group, &shared) {
        let found: Vec<Agreement> = parts
            .iter()
            .map(|part| agreement(&linked, part, &shared))
            .collect();
        let same = found.iter().position(|found| *found == Agreement::Same);
        let other = found.iter().all(|found| *found == Agreement::Other);
        match same {
            Some(part) => parts[part].extend(linked),
            None if parts.is_empty() || (other && linked.len() >= LEAST_FRAMES) => {
                parts.push(linked)
            }
            None => islands.extend(linked),
        }
    }
    if let [only] = parts.as_mut_slice() {
        // The adjustment judges an outlier.
        only.append(&mut islands);
    }
    let told = islands.iter().map(|n| part_about(*n, &parts, frames));
    let told: Vec<Option<usize>> = told.collect();
    for (island, part) in islands.into_iter().zip(told) {
        if let Some(part) = part {
            parts[part].push(island);
        }
    }
    parts
}

/// The part of the last frame before a frame and of the first after it, where both are of the same.
fn part_about(frame: usize, parts: &[Vec<usize>], frames: &[FrameObservation]) -> Option<usize> {
    let utc = frames[frame].utc?;
    let of_parts = parts.iter().enumerate();
    let times =
        of_parts.flat_map(|(n, part)| part.iter().filter_map(move |m| Some((frames[*m].utc?, n))));
    let before = times.clone().filter(|(time, _)| *time < utc).max()?;
    let after = times.filter(|(time, _)| *time > utc).min()?;
    (before.1 == after.1).then_some(before.1)
}

/// Pairs of frames, by index, that share marks.
fn shared(frames: &[FrameObservation], group: &[usize]) -> BTreeMap<(usize, usize), Shared> {
    let mut by_mark: BTreeMap<MarkId, Vec<(usize, SensorPx)>> = BTreeMap::new();
    for n in group {
        for mark in &frames[*n].marks {
            by_mark.entry(mark.id).or_default().push((*n, mark.at));
        }
    }
    let mut shared: BTreeMap<(usize, usize), Shared> = BTreeMap::new();
    for places in by_mark.values() {
        for (k, (a, at)) in places.iter().enumerate() {
            for (b, there) in places[k + 1..].iter().take(COMPARED) {
                let pair = shared.entry((*a, *b)).or_default();
                match at.distance(*there) < SAME_PLACE_PX {
                    true => pair.same += 1,
                    false => pair.other += 1,
                }
            }
        }
    }
    shared
}

/// Frames linked through others, the largest part first.
fn linked(group: &[usize], shared: &BTreeMap<(usize, usize), Shared>) -> Vec<Vec<usize>> {
    let mut neighbours: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    let links = |pair: &Shared| pair.same >= LINKING_MARKS && pair.same > pair.other;
    for ((a, b), _) in shared.iter().filter(|(_, pair)| links(pair)) {
        neighbours.entry(*a).or_default().push(*b);
        neighbours.entry(*b).or_default().push(*a);
    }
    let mut left: BTreeSet<usize> = group.iter().copied().collect();
    let mut runs = Vec::new();
    while let Some(first) = left.pop_first() {
        let mut run = vec![first];
        let mut next = 0;
        while let Some(here) = run.get(next) {
            let linked = neighbours.get(here).into_iter().flatten();
            let new: Vec<usize> = linked.copied().filter(|n| left.remove(n)).collect();
            run.extend(new);
            next += 1;
        }
        runs.push(run);
    }
    runs.sort_by_key(|run| std::cmp::Reverse(run.len()));
    runs
}

/// What the marks that two parts share say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Agreement {
    Same,
    Other,
    /// Too little, or both.
    Open,
}

/// Whether more pairs of frames across two parts have their marks in the same place than in different ones.
fn agreement(a: &[usize], b: &[usize], shared: &BTreeMap<(usize, usize), Shared>) -> Agreement {
    let (mut same, mut other) = (0, 0);
    for (n, m) in a.iter().flat_map(|n| b.iter().map(move |m| (n, m))) {
        if let Some(pair) = shared.get(&(*n.min(m), *n.max(m))) {
            same += usize::from(pair.same > pair.other);
            other += usize::from(pair.other > pair.same);
        }
    }
    match same.cmp(&other) {
        Ordering::Greater => Agreement::Same,
        Ordering::Less => Agreement::Other,
        Ordering::Equal => Agreement::Open,
    }
}

impl Posed {
    /// Rejects the poses of which half of the frames or more do not agree with the other frames. Gives how many.
    ///
    /// # Errors
    /// A folder that would lose all its poses.
    pub(super) fn reject(&mut self, fit: &PlateFit) -> Result<usize, Refusal> {
        let frames_of = |n: usize| self.frames.iter().filter(|f| f.pose == n).count();
        let holds = |n: usize| 2 * fit.poses[n].frames > frames_of(n);
        let (kept, lost): (Vec<usize>, Vec<usize>) = (0..self.poses.len()).partition(|n| holds(*n));
        for n in &lost {
            let folder = &self.poses[*n].folder;
            if !kept.iter().any(|m| self.poses[*m].folder == *folder) {
                return Err(Refusal::NoPose {
                    folder: folder.clone(),
                    agreeing: fit.poses[*n].frames,
                    frames: frames_of(*n),
                });
            }
        }
        let place = |pose: usize| kept.iter().position(|n| *n == pose);
        let others = self.frames.extract_if(.., |f| place(f.pose).is_none());
        let reason = "its marks do not agree with those of the other frames";
        self.rejected
            .extend(others.map(|frame| RejectedFrame::new(frame.file, reason)));
        for frame in &mut self.frames {
            frame.pose = place(frame.pose).unwrap_or_default();
        }
        self.poses = kept.iter().map(|n| self.poses[*n].clone()).collect();
        self.number();
        Ok(lost.len())
    }

    /// Numbers the poses of each folder that holds several.
    fn number(&mut self) {
        for n in 0..self.poses.len() {
            let alike = |pose: &&Pose| pose.folder == self.poses[n].folder;
            let several = self.poses.iter().filter(alike).count() > 1;
            let number = self.poses[..=n].iter().filter(alike).count();
            self.poses[n].number = several.then_some(number);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::plate::observation::MarkObservation;
    use crate::geometry::{Distortion, Mapping, SimilarityParameters};
    use crate::instrument::{Instrument, builtin};
    use crate::units::PlateMil;
    use nalgebra::Matrix2;

    /// Marks near a Sun in the middle of the plate, in a picture moved along x.
    fn frame(n: usize, demo: &Instrument, moved_px: f64) -> FrameObservation {
        let stated = demo.mounting.similarity();
        let at = stated.plate_centre;
        let mapping = Mapping::similarity(
            SimilarityParameters {
                plate_centre: SensorPx::new(at.x + moved_px, at.y),
                ..stated
            },
            Distortion::NONE,
        );
        let mapping = mapping.unwrap();
        let steps = [0.618, 0.755].map(|step| 400.0 * ((step * n as f64) % 1.0 - 0.5));
        let sun = SensorPx::new(at.x + steps[0], at.y + steps[1]);
        let seen = demo
            .plate
            .marks()
            .map(|(id, at)| (id, mapping.to_sensor(at)));
        let observation = |(id, at): (MarkId, SensorPx)| MarkObservation {
            id,
            at,
            covariance_px2: Matrix2::identity() * 4e-4,
        };
        FrameObservation {
            file: format!("folder/{n:03}").into(),
            pose: 0,
            utc: None,
            mapping,
            sun: Some(PlateMil::new(0.0, 0.0)),
            marks: seen
                .filter(|s| s.1.distance(sun) < 87.0)
                .map(observation)
                .collect(),
        }
    }

    /// What is found among frames that lie so far along x.
    fn found(moved_px: impl Fn(usize) -> f64) -> Result<Posed, Refusal> {
        let demo = builtin("demo").unwrap();
        let folder = Folder {
            path: "folder".into(),
            files: Vec::new(),
        };
        let frames: Vec<_> = (0..60).map(|n| frame(n, &demo, moved_px(n))).collect();
        find(&[folder], &frames, &demo.plate)
    }

    #[test]
    fn a_move_of_two_pixels_there_and_back_is_two_poses() {
        let posed = found(|n| if (20..45).contains(&n) { 2.0 } else { 0.0 }).unwrap();
        let numbers: Vec<_> = posed.poses.iter().map(|pose| pose.number).collect();
        assert_eq!(numbers, [Some(1), Some(2)]);
        assert_eq!(posed.poses[1].to_string(), "folder (2)");
        // Frames without time that share too little with the others are of no pose.
        assert!(posed.frames.len() > 54, "{:?}", posed.rejected);
        for frame in &posed.frames {
            let name = frame.file.file_name().unwrap().to_string_lossy();
            let moved = (20..45).contains(&name.parse::<usize>().unwrap());
            assert_eq!(frame.pose == 1, moved, "{name}");
        }
    }

    #[test]
    fn a_slow_drift_is_one_pose() {
        let posed = found(|n| 0.01 * n as f64).unwrap();
        assert_eq!(posed.poses.len(), 1);
        assert_eq!(posed.poses[0].number, None);
        assert!(posed.rejected.is_empty());
    }

    #[test]
    fn an_outlier_or_two_are_no_pose() {
        let posed = found(|n| if n % 30 == 7 { 100.0 } else { 0.0 }).unwrap();
        assert_eq!((posed.poses.len(), posed.rejected.len()), (1, 2));
        let refused = found(|n| 40.0 * n as f64).unwrap_err().to_string();
        assert!(refused.starts_with("folder: 0 of 60 frames"), "{refused}");
    }
}
