//! Reasons for which a calibration is refused, and which frames to take instead.

use super::observation::Pose;
use crate::calibrate::frames::WrongFrames;
use crate::calibrate::parts::{named, part};
use crate::instrument::WrongSize;
use crate::observe::InputError;
use crate::plate::{MarkId, Plate};
use crate::units::{PlateMil, counted};
use std::collections::BTreeSet;
use std::fmt;
use std::path::PathBuf;

/// Reasons for which a set of frames gives no calibration.
#[derive(Debug, thiserror::Error)]
pub enum Refusal {
    #[error(transparent)]
    Input(#[from] InputError),
    #[error(transparent)]
    WrongFrames(#[from] WrongFrames),
    #[error(
        "{file}: expected frames of one instrument, found {scale:.3} mil/px in this pose and {other:.3} mil/px in {other_file}; give the frames of one camera and lens only",
        file = .file.display(), other_file = .other_file.display()
    )]
    MixedScales {
        file: PathBuf,
        scale: f64,
        other_file: PathBuf,
        other: f64,
    },
    #[error("{}: {wrong}; give --instrument of the camera that took the frames", .file.display())]
    WrongSize { file: PathBuf, wrong: WrongSize },
    #[error(
        "none of the {frames} frames states its time; take frames with DATE-OBS or DATE-AVG (UTC), which says how large the Sun is and when the camera was in which pose"
    )]
    NoTime { frames: usize },
    #[error(
        "none of the {frames} frames shows enough marks (first: {first}); take frames with the whole Sun on the plate, in focus and not saturated"
    )]
    NothingRead { frames: usize, first: String },
    #[error(
        "too few marks: {} in {}, {again} of them more than once, expected at least {limit} seen more than once; take more frames, with the Sun all over the plate",
        counted(*.marks as u64, "mark"), counted(*.frames as u64, "frame")
    )]
    TooFewMarks {
        frames: usize,
        marks: usize,
        again: usize,
        limit: usize,
    },
    #[error(
        "all {frames} frames show the Sun in one place of the plate, within {reach_mil:.0} mil; take frames with the Sun all over the plate"
    )]
    OnePlace { frames: usize, reach_mil: f64 },
    #[error(
        "{folder}: {agreeing} of {frames} frames agree with others where the plate is, expected more than half; let the camera rest for several frames in each pose",
        folder = .folder.display()
    )]
    NoPose {
        folder: PathBuf,
        agreeing: usize,
        frames: usize,
    },
    #[error("the frames do not determine the plate: {}", .0.iter().map(MissingCoverage::to_string).collect::<Vec<_>>().join("; "))]
    Undetermined(Vec<MissingCoverage>),
}

/// Coverage missing from a pose's frames.
#[derive(Debug, Clone, PartialEq)]
pub struct MissingCoverage {
    pub pose: String,
    pub frames: usize,
    pub marks: usize,
    /// Parts of the plate in which they show at most one mark; see [`PARTS`](crate::calibrate::parts::PARTS).
    pub unseen: Vec<&'static str>,
}

impl fmt::Display for MissingCoverage {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [frames, marks] = [(self.frames, "frame"), (self.marks, "mark")]
            .map(|(count, name)| counted(count as u64, name));
        write!(out, "{} has {frames} that show {marks}", self.pose)?;
        match &self.unseen[..] {
            [] => write!(out, "; take more of them in it"),
            parts => write!(
                out,
                "; take frames in it with the Sun in {} of the plate",
                parts.join(", ")
            ),
        }
    }
}

impl Refusal {
    /// Error for poses that do not determine the plate: those with the fewest marks, and the parts to photograph.
    pub(super) fn undetermined(poses: &[Pose], plate: &Plate) -> Self {
        const LISTED: usize = 3;
        /// Fewer marks do not determine the position of a part.
        const LEAST_MARKS: usize = 2;
        let reach = plate.reach_mil();
        let part_of = |id: MarkId| {
            let PlateMil { x, y } = plate.position(id)?;
            Some(part((x / reach + 1.0) / 2.0, (1.0 - y / reach) / 2.0))
        };
        let coverage = |pose: &Pose| {
            let marks = pose.frames.iter().flat_map(|frame| &frame.marks);
            let marks: BTreeSet<MarkId> = marks.map(|mark| mark.id).collect();
            let count = |n: usize| marks.iter().filter(|id| part_of(**id) == Some(n)).count();
            MissingCoverage {
                pose: pose.to_string(),
                frames: pose.frames.len(),
                marks: marks.len(),
                unseen: named(|n| count(n) < LEAST_MARKS),
            }
        };
        let mut missing: Vec<MissingCoverage> = poses.iter().map(coverage).collect();
        missing.sort_by_key(|coverage| coverage.marks);
        missing.truncate(LISTED);
        Self::Undetermined(missing)
    }
}
