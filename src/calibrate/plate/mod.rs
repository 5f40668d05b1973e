//! The plate as it is, not as it was drawn: every mark's position, the lens's distortion and the camera's poses, from many
//! frames with the Sun all over the plate.
//!
//! # Method
//! Within a pose, camera and plate are one rigid body, so all frames of a pose share one mapping. One robust bundle
//! adjustment estimates the marks' displacements from the drawing, the lens (radial and decentring terms, as many as the
//! data support) and the mapping of every pose (shift, rotation and one scale; keystone where the data demand it). The
//! shift, rotation and scale that the measured marks have in common are no property of the plate and are held at zero.
//!
//! What is known beforehand enters as priors: marks lie within the drawing's sigma of their drawn place, each term of the
//! lens moves the sensor's corner by less than [`LENS_PRIOR_PX`]. Where the frames tell a plate's errors from the lens's
//! distortion (the camera was moved between poses) these do not matter; where they do not, they split the two, and
//! [`Separation`] says so.

mod adjust;
mod blurred;
mod camera;
mod choose;
mod consensus;
mod fit;
mod input;
mod lit;
mod measure;
mod poses;
mod refusal;
mod report;
mod robust;
mod second;
mod sighting;
mod summary;
mod write;

pub use choose::Choice;
pub use fit::{LENS_PRIOR_PX, MeasuredMark, PlateFit, PoseFit, Residual, Separation, fit};
pub use input::{Folder, InputError, folders};
pub use measure::{FileFacts, Sightings, measure};
pub use poses::Pose;
pub use refusal::Refusal;
pub use report::html;
pub use sighting::{FrameSightings, Sighting, Spoiled};
pub use summary::summary;

use crate::calibrate::frames::sha256_of_all;
use crate::instrument::Instrument;
use crate::units::{PlateMil, SensorPx};
use jiff::Timestamp;
use poses::Posed;
use std::path::PathBuf;

/// A plate calibration: the fit and what it rests on.
#[derive(Debug, Clone)]
pub struct Calibration {
    pub poses: Vec<Pose>,
    pub frames: Vec<FrameSightings>,
    /// How many of them could be read with the plate as found only.
    pub read_later: usize,
    pub fit: PlateFit,
    /// Every frame that was not used.
    pub spoiled: Vec<Spoiled>,
    /// SHA-256 over the sorted SHA-256 of all files read, hexadecimal: whatever their names and order.
    pub frames_sha256: String,
    /// When the last frame was taken.
    pub last: Option<Timestamp>,
    /// The pose nearest to where the start's mounting states the camera: the others were made for the calibration.
    pub mounted_pose: usize,
    /// The sensor's middle.
    pub middle_px: SensorPx,
}

/// Each look at the frames that could not be read knows the plate better than the one before.
const LOOKS: usize = 3;

/// Calibrates plate, lens and poses from frames and folders; `each` is called after every frame.
///
/// # Errors
/// A [`Refusal`] says what is wrong with the set of frames and what to take instead. Single bad frames are listed in
/// [`Calibration::spoiled`].
pub fn calibrate(
    given: &[PathBuf],
    start: &Instrument,
    begin: &dyn Fn(usize),
    each: &(dyn Fn() + Sync),
) -> Result<Calibration, Refusal> {
    let folders = folders(given)?;
    begin(folders.iter().map(|folder| folder.files.len()).sum());
    let mut sightings = measure(&folders, start, each);
    let mut blurred = blurred::take_blurred(&mut sightings.frames);
    refusal::check_files(&sightings, start)?;
    refusal::check_coverage(&sightings, start)?;
    let Sightings {
        mut frames,
        spoiled: mut unread,
        files,
    } = sightings;
    let mut posed = poses::find(&folders, &frames, &start.plate)?;
    let mut fit = settle(&mut posed, start)?;
    let mut read_later = 0;
    for _ in 0..LOOKS {
        let mut read = second::look(&unread, &folders, (&posed, &fit), start);
        if read.is_empty() {
            break;
        }
        unread.retain(|spoiled| read.iter().all(|frame| frame.file != spoiled.file));
        read_later += read.len();
        frames.append(&mut read);
        blurred.extend(blurred::take_blurred(&mut frames));
        posed = poses::find(&folders, &frames, &start.plate)?;
        fit = settle(&mut posed, start)?;
    }
    refusal::check_scales(&posed.poses, &fit)?;
    let mut spoiled = [blurred, unread, posed.spoiled, fit.spoiled.clone()].concat();
    spoiled.sort_by(|a, b| a.file.cmp(&b.file));
    Ok(Calibration {
        last: posed.frames.iter().filter_map(|frame| frame.utc).max(),
        mounted_pose: mounted_pose(&fit, start),
        middle_px: SensorPx::new(
            (start.camera.width_px as f64 - 1.0) / 2.0,
            (start.camera.height_px as f64 - 1.0) / 2.0,
        ),
        frames_sha256: sha256_of_all(files.iter().map(|file| file.sha256).collect()),
        poses: posed.poses,
        frames: posed.frames,
        read_later,
        fit,
        spoiled,
    })
}

/// The pose whose picture of the plate is nearest to the stated one.
fn mounted_pose(fit: &PlateFit, start: &Instrument) -> usize {
    let Some(stated) = start.nominal_mapping() else {
        return 0;
    };
    let corners = [(-2000.0, -2000.0), (2000.0, -2000.0), (0.0, 2000.0)];
    let corners = corners.map(|(x, y)| PlateMil::new(x, y));
    let apart_px = |pose: &PoseFit| -> f64 {
        let apart = corners.map(|at| pose.mapping.to_sensor(at).distance(stated.to_sensor(at)));
        apart.iter().sum()
    };
    let poses = fit.poses.iter().map(apart_px).enumerate();
    let nearest = poses.min_by(|a, b| a.1.total_cmp(&b.1));
    nearest.map_or(0, |(n, _)| n)
}

/// Fits, without the poses of which most frames contradict the others.
fn settle(posed: &mut Posed, start: &Instrument) -> Result<PlateFit, Refusal> {
    loop {
        let fit = fit(&posed.frames, posed.poses.len(), start).ok_or(Refusal::Undetermined)?;
        if posed.leave_out(&fit)? == 0 {
            return Ok(fit);
        }
    }
}
