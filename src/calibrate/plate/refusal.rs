//! Why a calibration is refused, and what to take instead.

use super::observation::Pose;
use crate::calibrate::frames::WrongFrames;
use crate::instrument::WrongSize;
use crate::observe::InputError;
use crate::units::counted;
use std::collections::BTreeSet;
use std::path::PathBuf;

/// A set of frames that gives no calibration.
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
    #[error(
        "the frames do not determine the plate, that of the pose of fewest marks least: {pose} has {} that show {}; take frames with the Sun all over the plate in each pose",
        counted(*.frames as u64, "frame"), counted(*.marks as u64, "mark")
    )]
    Undetermined {
        pose: String,
        frames: usize,
        marks: usize,
    },
}

impl Refusal {
    /// That poses do not determine the plate: names the one that says least of it.
    pub(super) fn undetermined(poses: &[Pose]) -> Self {
        let marks = |pose: &Pose| {
            let marks = pose.frames.iter().flat_map(|frame| &frame.marks);
            marks.map(|mark| mark.id).collect::<BTreeSet<_>>().len()
        };
        let least = poses.iter().min_by_key(|pose| marks(pose));
        Self::Undetermined {
            pose: least.map_or_else(String::new, ToString::to_string),
            frames: least.map_or(0, |pose| pose.frames.len()),
            marks: least.map_or(0, marks),
        }
    }
}
