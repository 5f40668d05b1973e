//! From files to a camera's optics.

use super::edges::collect;
use super::fit::{Optics, OpticsError, fit};
use crate::calibrate::frames::CalibrateError;
use crate::calibrate::revision::Provenance;
use crate::calibrate::roll_camera::Horizons;
use crate::geometry::camera::Camera;
use crate::horizon::EdgeHeight;
use crate::instrument::DirectionCamera;
use crate::observe::{Depth, RejectedFrame, Watch, list};
use crate::units::SensorPx;
use std::path::PathBuf;

/// A camera that moves a pixel's ray by less is the same, px.
const SAME_PX: f64 = 0.3;
/// The frames are looked at so often at most.
const MOST_PASSES: usize = 6;

/// The name of the calibration in the file.
pub const NAME: &str = "horizon_camera";
/// What was done, for the file.
const DONE: &str = "optics by the limb";

/// A camera's optics that frames gave, and what they were made of.
#[derive(Debug, Clone)]
pub struct FromFrames {
    pub optics: Optics,
    pub rejected: Vec<RejectedFrame>,
    pub provenance: Provenance,
}

/// Calibrates the optics of a camera that sees the horizon, from frames and folders of them. The frames are looked at anew with the camera that
/// they gave until it stays as it is.
///
/// # Errors
/// Frames that are not the camera's, or do not determine its optics.
pub fn from_frames(
    given: &[PathBuf],
    horizons: &Horizons<'_>,
    watch: &dyn Watch,
) -> Result<FromFrames, CalibrateError<OpticsError>> {
    let files = list(given, Depth::All)?;
    let stated = horizons.camera;
    let mut camera = stated.clone();
    // The search follows an edge that a wrong camera bends where the edge's height is free.
    let mut height = EdgeHeight::Fitted;
    for _ in 0..MOST_PASSES {
        let horizons = Horizons {
            camera: &camera,
            ..horizons.clone()
        };
        let (limbs, rejected) = collect(&files, &horizons, height, watch)?;
        let undetermined = CalibrateError::undetermined(&rejected);
        let optics = match fit(&limbs, stated) {
            Ok(optics) => optics,
            Err(error) => return Err(undetermined(error)),
        };
        let is_same = moved_px(&camera.lens, &optics.camera, stated) < SAME_PX;
        if is_same && height == EdgeHeight::Given {
            optics.check_determined(stated).map_err(undetermined)?;
            let times = limbs.iter().filter_map(|limb| limb.utc);
            return Ok(FromFrames {
                provenance: Provenance::over(NAME, DONE, optics.frames, times, &files),
                optics,
                rejected,
            });
        }
        camera.lens = optics.camera;
        height = EdgeHeight::Given;
    }
    Err(CalibrateError::Undetermined {
        rejected: String::new(),
        cause: OpticsError::NoFit,
    })
}

/// By how much a camera has a pixel's ray elsewhere than another, at the most of nine places that both see, px.
fn moved_px(one: &Camera, other: &Camera, size: &DirectionCamera) -> f64 {
    let places = [0.0, 0.5, 1.0].map(|part| [0.0, 0.5, 1.0].map(|other| [part, other]));
    let moved = |[x, y]: &[f64; 2]| {
        let at = SensorPx::new(x * size.width_px as f64, y * size.height_px as f64);
        Some(other.pixel(&one.ray(at)?)?.distance(at))
    };
    let places = places.as_flattened().iter();
    places.filter_map(moved).fold(0.0, f64::max)
}
