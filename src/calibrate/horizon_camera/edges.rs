//! The limb's edge in frames, and the parts of the picture that it crosses.

use crate::calibrate::parts::{PARTS, named, part};
use crate::calibrate::roll_camera::Horizons;
use crate::horizon::{EdgeHeight, EdgeRays, Sphere};
use crate::instrument::DirectionCamera;
use crate::observe::{InputError, RejectedFrame, Watch, each_frame};
use jiff::Timestamp;
use std::collections::BTreeSet;
use std::path::PathBuf;

/// The edge of the limb in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Limb {
    pub file: PathBuf,
    pub utc: Option<Timestamp>,
    pub sphere: Sphere,
    pub edge: EdgeRays,
}

/// The limbs of frames, in the order of time, and the frames that show none. If the camera is only roughly known, the edge's height is
/// fitted so that the search follows an edge distorted by the camera's errors.
///
/// # Errors
/// [`InputError::Cancelled`].
pub(super) fn collect(
    files: &[PathBuf],
    horizons: &Horizons<'_>,
    height: EdgeHeight,
    watch: &dyn Watch,
) -> Result<(Vec<Limb>, Vec<RejectedFrame>), InputError> {
    let size_px = horizons.camera.size_px();
    let observed = each_frame(files.to_vec(), size_px, watch, |file, frame| {
        let (sphere, solution) = horizons.solved(&frame, height)?;
        match (height, solution.nadir) {
            (EdgeHeight::Given, Err(stopped)) => Err(stopped.to_string()),
            (_, Err(stopped)) if solution.edge.rays.is_empty() => Err(stopped.to_string()),
            _ => Ok(Limb {
                file: file.into(),
                utc: frame.info.mid_exposure,
                sphere,
                edge: solution.edge,
            }),
        }
    })?;
    let (mut limbs, rejected) = observed.split();
    limbs.sort_by_key(|limb| limb.utc);
    Ok((limbs, rejected))
}

/// Fewest frames whose limb crosses a part.
const LEAST_FRAMES: usize = 3;

/// The parts of the picture that hardly any limb crosses.
pub(super) fn uncrossed(limbs: &[Limb], camera: &DirectionCamera) -> Vec<&'static str> {
    let mut frames = [0; PARTS.len()];
    for limb in limbs {
        let size = [camera.width_px, camera.height_px].map(|size| size as f64);
        let rays = limb.edge.rays.iter();
        let crossed: BTreeSet<usize> = rays
            .map(|ray| part(ray.at.x / size[0], ray.at.y / size[1]))
            .collect();
        crossed.into_iter().for_each(|part| frames[part] += 1);
    }
    named(|part| frames[part] < LEAST_FRAMES)
}
