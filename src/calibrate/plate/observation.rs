//! Observations of the frames: the positions of identified marks, by frame and pose.

use crate::calibrate::numbers::median;
use crate::geometry::Mapping;
use crate::observe::RejectedFrame;
use crate::plate::{MarkId, Plate};
use crate::units::{PlateMil, SensorPx};
use jiff::Timestamp;
use nalgebra::Matrix2;
use std::collections::HashMap;
use std::fmt;
use std::path::{Path, PathBuf};

/// A mark observed in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarkObservation {
    pub id: MarkId,
    pub at: SensorPx,
    pub covariance_px2: Matrix2<f64>,
}

/// The marks observed in a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameObservation {
    pub file: PathBuf,
    pub utc: Option<Timestamp>,
    /// The mapping from the frame's own marks.
    pub mapping: Mapping,
    /// Position of the Sun on the plate; none in a frame of the illuminated plate.
    pub sun: Option<PlateMil>,
    pub marks: Vec<MarkObservation>,
}

impl FrameObservation {
    /// The folder of the frame's file.
    pub(super) fn folder(&self) -> &Path {
        folder_of(&self.file)
    }

    /// Number of marks within a distance of their predicted position.
    pub(super) fn count_near(
        &self,
        limit_px: f64,
        expected: impl Fn(MarkId) -> Option<SensorPx>,
    ) -> usize {
        let near = |mark: &&MarkObservation| {
            expected(mark.id).is_some_and(|at| at.distance(mark.at) < limit_px)
        };
        self.marks.iter().filter(near).count()
    }

    /// 1 sigma of the frame's best mark, px per axis.
    fn best_px(&self) -> f64 {
        let variances = self.marks.iter().map(|m| m.covariance_px2.trace() / 2.0);
        variances.fold(f64::INFINITY, f64::min).max(0.0).sqrt()
    }
}

/// The frames taken with the camera at rest in one position.
#[derive(Debug, Clone, PartialEq)]
pub struct Pose {
    /// The folder of its frames.
    pub folder: PathBuf,
    /// Number of the pose among those found in the folder, from 1; none if it is the only one.
    pub number: Option<usize>,
    /// The frame mapping that most frames agree with, before the adjustment.
    pub mapping: Mapping,
    pub frames: Vec<FrameObservation>,
}

impl Pose {
    /// Another pose of the same folder with about the same mapping.
    pub(super) fn with_frames(&self, frames: Vec<FrameObservation>) -> Self {
        Self {
            folder: self.folder.clone(),
            number: None,
            mapping: self.mapping,
            frames,
        }
    }
}

impl fmt::Display for Pose {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}", self.folder.display())?;
        self.number.map_or(Ok(()), |n| write!(out, " ({n})"))
    }
}

/// The folder of a file.
pub(super) fn folder_of(file: &Path) -> &Path {
    file.parent().unwrap_or(Path::new(""))
}

/// Removes the frames in which even the best mark is far less certain than in most frames: blur, haze, smear.
pub(super) fn take_blurred(frames: &mut Vec<FrameObservation>) -> Vec<RejectedFrame> {
    /// The best mark of a sharp frame is as certain as that of the median frame within this factor.
    const SHARP: f64 = 2.0;
    let middle = median(frames.iter().map(FrameObservation::best_px));
    let rejected = |frame: FrameObservation| {
        let reason = format!(
            "not sharp: its best mark is known to {:.3} px, those of most frames to {middle:.3} px",
            frame.best_px()
        );
        RejectedFrame::new(frame.file, reason)
    };
    let blurred = frames.extract_if(.., |frame| frame.best_px() > SHARP * middle);
    blurred.map(rejected).collect()
}

/// Consensus of most frames before the adjustment.
pub(super) struct Consensus {
    pub mapping: Mapping,
    /// The frames that agree, as indices into all frames.
    pub frames: Vec<usize>,
}

/// The mapping that most of the frames agree with; `None` without frames.
pub(super) fn consensus(
    frames: &[&FrameObservation],
    among: &[usize],
    plate: &Plate,
) -> Option<Consensus> {
    /// A frame's mapping is based on a few marks: elsewhere on the sensor it is off by pixels, and the lens adds some more.
    /// Wrong ids are off by 47 px at least.
    const AGREEING_PX: f64 = 15.0;
    /// Greatest number of frames whose mappings are tried.
    const TRIED: usize = 50;
    let agreeing = |mapping: Mapping| {
        let expected: HashMap<MarkId, SensorPx> = plate
            .marks()
            .map(|(id, at)| (id, mapping.to_sensor(at)))
            .collect();
        let agrees = |n: &&usize| {
            let frame = frames[**n];
            let near = frame.count_near(AGREEING_PX, |id| expected.get(&id).copied());
            2 * near > frame.marks.len()
        };
        Consensus {
            mapping,
            frames: among.iter().filter(agrees).copied().collect(),
        }
    };
    let every = among.len().div_ceil(TRIED).max(1);
    let tried = among.iter().step_by(every).rev();
    // In reverse: `max_by_key` returns the last of equals, here the first frame's.
    tried
        .map(|n| agreeing(frames[*n].mapping))
        .max_by_key(|c| c.frames.len())
}
