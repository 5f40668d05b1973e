//! Calibrates a camera's optics from files.

use super::edges::collect;
use super::fit::{Optics, OpticsError, fit};
use crate::calibrate::frames::CalibrateError;
use crate::calibrate::revision::Provenance;
use crate::calibrate::roll_camera::Horizons;
use crate::horizon::EdgeHeight;
use crate::observe::{Depth, RejectedFrame, Watch, list};
use std::path::PathBuf;

/// The camera has converged if no unknown changes by more, in sigmas: with a new camera some points come into view or leave it, so that
/// the solution may alternate between two cameras.
const SAME_SIGMAS: f64 = 1.0;
/// The most passes over the frames.
const MOST_PASSES: usize = 6;

/// The name of the calibration in the file.
pub const NAME: &str = "horizon_camera";
/// Description of the method, for the file.
const DONE: &str = "optics by the limb";

/// A camera's optics determined from frames, and the inputs.
#[derive(Debug, Clone)]
pub struct FromFrames {
    pub optics: Optics,
    pub rejected: Vec<RejectedFrame>,
    pub provenance: Provenance,
}

/// Calibrates the optics of a camera that sees the horizon, from frames and folders of frames. The frames are solved again with the
/// resulting camera until it converges.
///
/// # Errors
/// If the frames are not the camera's, or do not determine its optics.
pub fn from_frames(
    given: &[PathBuf],
    horizons: &Horizons<'_>,
    watch: &dyn Watch,
) -> Result<FromFrames, CalibrateError<OpticsError>> {
    let files = list(given, Depth::All)?;
    let stated = horizons.camera;
    let mut camera = stated.clone();
    // With a free height of the edge the search follows an edge distorted by a wrong camera.
    let (mut height, mut last) = (EdgeHeight::Fitted, None);
    let mut pass = 0;
    loop {
        pass += 1;
        let horizons = Horizons {
            camera: &camera,
            ..horizons.clone()
        };
        let (limbs, rejected) = collect(&files, &horizons, height, watch)?;
        let fitted = fit(&limbs, stated).and_then(|optics| {
            let off = last.map_or(f64::INFINITY, |last: Optics| optics.sigmas_from(&last));
            match off < SAME_SIGMAS {
                true => optics.check_determined(stated).map(|()| (optics, true)),
                false if pass == MOST_PASSES => Err(OpticsError::NoFit),
                false => Ok((optics, false)),
            }
        });
        let (optics, is_same) = fitted.map_err(CalibrateError::undetermined(&rejected))?;
        if is_same {
            let times = limbs.iter().filter_map(|limb| limb.utc);
            return Ok(FromFrames {
                provenance: Provenance::of_frames(NAME, DONE, optics.frames, times, &files),
                optics,
                rejected,
            });
        }
        camera.lens = optics.camera;
        last = (height == EdgeHeight::Given).then_some(optics);
        height = EdgeHeight::Given;
    }
}
