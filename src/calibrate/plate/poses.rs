//! Assigns frames to poses of the camera: a folder contains one pose or several, in any order.
//!
//! # Algorithm
//! 1. The mapping that most frames of the folder agree with gathers its frames ([`consensus`]); the same is repeated with the
//!    remaining frames. This separates poses that differ by some 15 px and more anywhere on the plate.
//! 2. Where the camera slipped in the order of time, another pose begins ([`slips`](super::slips)).
//! 3. Once plate and lens are fitted, poses whose frames are not at rest are split by the plate's position in the frames, regardless
//!    of time ([`Shifts`]).
//!
//! Fewer than three frames are outliers instead of a pose, unless one is of the illuminated plate, which shows all marks.

use super::fit::PlateFit;
use super::observation::{FrameObservation, Pose, consensus};
use super::refusal::Refusal;
use super::rest::{Parts, Shifts};
use super::slips;
use crate::geometry::Mapping;
use crate::observe::RejectedFrame;
use crate::plate::Plate;
use std::collections::BTreeSet;
use std::path::Path;

/// Poses with their frames, and the frames without a pose.
#[derive(Debug, Clone, Default)]
pub struct Posed {
    pub poses: Vec<Pose>,
    pub rejected: Vec<RejectedFrame>,
}

/// Fewest frames of a pose that is not its folder's only one.
const LEAST_FRAMES: usize = 3;

/// Finds the poses of each folder.
///
/// # Errors
/// If at least half of a folder's frames agree with no other frame.
pub(super) fn find(frames: &[FrameObservation], plate: &Plate) -> Result<Posed, Refusal> {
    let mut folders: Vec<(&Path, Vec<&FrameObservation>)> = Vec::new();
    for frame in frames {
        let folder = frame.folder();
        match folders.iter_mut().find(|(path, _)| *path == folder) {
            Some((_, of_folder)) => of_folder.push(frame),
            None => folders.push((folder, vec![frame])),
        }
    }
    let mut posed = Posed::default();
    for (folder, frames) in folders {
        posed.find_in(folder, &frames, plate)?;
    }
    Ok(posed)
}

impl Posed {
    /// Finds the poses among the frames of a folder, in the order in which they were first taken.
    fn find_in(
        &mut self,
        folder: &Path,
        frames: &[&FrameObservation],
        plate: &Plate,
    ) -> Result<(), Refusal> {
        let mut groups = groups(frames, plate);
        let agreeing = groups.iter().map(|(_, group)| group.len()).sum::<usize>();
        if 2 * agreeing <= frames.len() {
            return Err(Refusal::NoPose {
                folder: folder.into(),
                agreeing,
                frames: frames.len(),
            });
        }
        groups.sort_by_key(|(_, group)| group.iter().map(|n| (frames[*n].utc, *n)).min());
        let posed: BTreeSet<usize> = groups.iter().flat_map(|(_, group)| group.clone()).collect();
        let others = (0..frames.len()).filter(|n| !posed.contains(n));
        self.rejected.extend(others.map(|n| displaced(frames[n])));
        let pose = |(mapping, group): (Mapping, Vec<usize>)| Pose {
            folder: folder.into(),
            number: None,
            mapping,
            frames: group.iter().map(|n| frames[*n].clone()).collect(),
        };
        self.poses.extend(groups.into_iter().map(pose));
        self.number();
        Ok(())
    }
}

fn displaced(frame: &FrameObservation) -> RejectedFrame {
    let reason = "its marks lie elsewhere than those of the other frames of its folder";
    RejectedFrame::new(&frame.file, reason)
}

/// The poses among frames of one folder: about the mapping of each, and its frames, in their order.
fn groups(frames: &[&FrameObservation], plate: &Plate) -> Vec<(Mapping, Vec<usize>)> {
    let enough = |group: &[usize]| {
        let lit = group.iter().any(|n| frames[*n].sun.is_none());
        lit || group.len() >= LEAST_FRAMES || 2 * group.len() > frames.len()
    };
    let mut rest: Vec<usize> = (0..frames.len()).collect();
    let mut groups = Vec::new();
    while let Some(agreed) = consensus(frames, &rest, plate) {
        if !enough(&agreed.frames) {
            break;
        }
        let gathered: BTreeSet<usize> = agreed.frames.iter().copied().collect();
        rest.retain(|n| !gathered.contains(n));
        let runs = slips::runs(frames, &agreed.frames).into_iter();
        groups.extend(runs.map(|mut group| {
            group.sort_unstable();
            (agreed.mapping, group)
        }));
    }
    groups
}

impl Posed {
    /// Merges the poses that slips separated.
    pub(super) fn joined(self) -> Self {
        let join = |poses: Vec<usize>| {
            let frames = poses.iter().flat_map(|n| self.poses[*n].frames.clone());
            self.poses[poses[0]].with_frames(frames.collect())
        };
        let mut joined = Self {
            poses: self.groups().into_iter().map(join).collect(),
            rejected: self.rejected.clone(),
        };
        joined.number();
        joined
    }

    /// Splits the frames of each group of poses that differ by slips again by the plate's position, if they are not at rest in their poses.
    /// Returns whether anything changed.
    pub(super) fn part(&mut self, fit: &PlateFit) -> bool {
        let shifts = Shifts::of(fit);
        let ends = self.poses.iter().scan(0, |end, pose| {
            *end += pose.frames.len();
            Some(*end)
        });
        let firsts: Vec<usize> = [0].into_iter().chain(ends).collect();
        let frames = self.poses.iter().flat_map(|pose| &pose.frames);
        let frames: Vec<&FrameObservation> = frames.collect();
        let mut changed = false;
        let mut split = Vec::new();
        for poses in self.groups() {
            let moving = poses.len() > 1 || shifts.off(poses[0]) > 0;
            let Some(Parts { parts, unassigned }) = moving.then(|| shifts.parts(&poses)).flatten()
            else {
                split.extend(poses.iter().map(|n| self.poses[*n].clone()));
                continue;
            };
            let own = poses.iter().map(|n| (firsts[*n]..firsts[n + 1]).collect());
            changed |= parts != own.collect::<Vec<Vec<usize>>>();
            let pose = &self.poses[poses[0]];
            split.extend(
                parts.iter().map(|part| {
                    pose.with_frames(part.iter().map(|n| frames[*n].clone()).collect())
                }),
            );
            let reason =
                "neither its time nor a mark that other frames show determines which pose it is of";
            let unassigned = unassigned
                .iter()
                .map(|n| RejectedFrame::new(&frames[*n].file, reason));
            self.rejected.extend(unassigned);
        }
        self.poses = split;
        self.number();
        changed
    }

    /// Groups of poses whose frames agree with one mapping: they differ by slips.
    fn groups(&self) -> Vec<Vec<usize>> {
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for (n, pose) in self.poses.iter().enumerate() {
            let is_same = |group: &&mut Vec<usize>| {
                let first = &self.poses[group[0]];
                first.folder == pose.folder && first.mapping == pose.mapping
            };
            match groups.iter_mut().find(is_same) {
                Some(group) => group.push(n),
                None => groups.push(vec![n]),
            }
        }
        groups
    }

    /// Rejects the poses in which at least half of the frames disagree with the others. Returns their number.
    ///
    /// # Errors
    /// If a folder would lose all its poses.
    pub(super) fn reject(&mut self, fit: &PlateFit) -> Result<usize, Refusal> {
        let poses = std::mem::take(&mut self.poses);
        let (kept, lost): (Vec<_>, Vec<_>) = poses
            .into_iter()
            .zip(&fit.poses)
            .partition(|(pose, fit)| 2 * fit.frames > pose.frames.len());
        for (pose, fit) in &lost {
            if !kept.iter().any(|(other, _)| other.folder == pose.folder) {
                return Err(Refusal::NoPose {
                    folder: pose.folder.clone(),
                    agreeing: fit.frames,
                    frames: pose.frames.len(),
                });
            }
        }
        let frames = lost.iter().flat_map(|(pose, _)| &pose.frames);
        let reason = "its marks do not agree with those of the other frames";
        self.rejected
            .extend(frames.map(|frame| RejectedFrame::new(&frame.file, reason)));
        self.poses = kept.into_iter().map(|(pose, _)| pose).collect();
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
    use crate::plate::MarkId;
    use crate::units::{PlateMil, SensorPx};
    use nalgebra::Matrix2;

    /// Marks near a Sun in the middle of the plate, in a picture shifted along x.
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
            utc: None,
            mapping,
            sun: Some(PlateMil::new(0.0, 0.0)),
            marks: seen
                .filter(|s| s.1.distance(sun) < 87.0)
                .map(observation)
                .collect(),
        }
    }

    /// The poses found among frames shifted along x.
    fn found(moved_px: impl Fn(usize) -> f64) -> Result<Posed, Refusal> {
        let demo = builtin("demo").unwrap();
        let frames: Vec<_> = (0..60).map(|n| frame(n, &demo, moved_px(n))).collect();
        find(&frames, &demo.plate)
    }

    #[test]
    fn an_outlier_or_two_are_no_pose() {
        let posed = found(|n| if n % 30 == 7 { 100.0 } else { 0.0 }).unwrap();
        assert_eq!((posed.poses.len(), posed.rejected.len()), (1, 2));
        let refused = found(|n| 40.0 * n as f64).unwrap_err().to_string();
        assert!(refused.starts_with("folder: 0 of 60 frames"), "{refused}");
    }
}
