//! From files to a plate calibration.

use super::fit::{PlateFit, PoseFit, fit};
use super::measure::{self, Folder, measure};
use super::observation::{FrameObservation, take_blurred};
use super::poses::{self, Pose, Posed};
use super::refusal::Refusal;
use super::suspects::{SuspectMark, suspects};
use crate::fits;
use crate::instrument::Instrument;
use crate::observe::{Depth, RejectedFrame, Watch, list, sha256};
use crate::units::{PlateMil, SensorPx};
use jiff::Timestamp;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// A plate calibration: the fit and what it rests on.
#[derive(Debug, Clone)]
pub struct Calibration {
    pub poses: Vec<Pose>,
    pub frames: Vec<FrameObservation>,
    /// How many of them could be identified with the plate as found only.
    pub read_later: usize,
    pub fit: PlateFit,
    pub rejected: Vec<RejectedFrame>,
    /// Marks that were lit and not read.
    pub suspects: Vec<SuspectMark>,
    /// Of the files that were given; see [`frames_sha256`].
    pub frames_sha256: String,
    /// When the last frame was taken.
    pub last: Option<Timestamp>,
    /// The camera's name, as the frames have it.
    pub camera: Option<String>,
    /// The pose nearest to where the start's mounting states the camera: the others were made for the calibration.
    pub mounted_pose: usize,
    /// The sensor's middle.
    pub middle_px: SensorPx,
}

/// SHA-256 over the sorted SHA-256 of all files among frames and folders, hexadecimal: whatever their names and order.
///
/// # Errors
/// A path that cannot be read, a folder without frames.
pub fn frames_sha256(given: &[PathBuf]) -> Result<String, Refusal> {
    Ok(sha256_of(&measure::folders(list(given, Depth::Nearest)?)))
}

fn sha256_of(folders: &[Folder]) -> String {
    let files: Vec<&PathBuf> = folders.iter().flat_map(|folder| &folder.files).collect();
    sha256(&files)
}

/// Calibrates plate, lens and poses from frames and folders.
///
/// # Errors
/// A [`Refusal`] says what is wrong with the set of frames and what to take instead. Single bad frames are listed in
/// [`Calibration::rejected`].
pub fn calibrate(
    given: &[PathBuf],
    start: &Instrument,
    watch: &dyn Watch,
) -> Result<Calibration, Refusal> {
    /// Later passes over the rejected frames: each uses the plate as the one before measured it.
    const LATER_PASSES: usize = 3;
    let files = list(given, Depth::Nearest)?;
    let folders = measure::folders(files);
    let frames_sha256 = sha256_of(&folders);
    let files = folders
        .iter()
        .flat_map(|folder| folder.files.iter().cloned());
    let (mut observations, copies) = measure(files.collect(), &folders, start, watch);
    let mut blurred = take_blurred(&mut observations.frames);
    observations.check_files(start)?;
    observations.check_coverage(start)?;
    let camera = observations.camera();
    let (mut frames, mut unread) = (observations.frames, observations.rejected);
    let (mut posed, mut fit) = settle(&folders, &frames, start)?;
    let mut read_later = 0;
    for _ in 0..LATER_PASSES {
        let mut read = identify_again(&unread, &folders, (&posed, &fit), start);
        if read.is_empty() {
            break;
        }
        unread.retain(|rejected| read.iter().all(|frame| frame.file != rejected.file));
        read_later += read.len();
        frames.append(&mut read);
        blurred.extend(take_blurred(&mut frames));
        (posed, fit) = settle(&folders, &frames, start)?;
    }
    check_scales(&posed.poses, &fit)?;
    let mut rejected = [
        copies,
        blurred,
        unread,
        posed.rejected,
        fit.rejected.clone(),
    ]
    .concat();
    rejected.sort_by(|a, b| a.file.cmp(&b.file));
    Ok(Calibration {
        last: posed.frames.iter().filter_map(|frame| frame.utc).max(),
        camera,
        mounted_pose: mounted_pose(&fit, start),
        middle_px: start.camera.middle_px(),
        suspects: suspects(&posed.frames, &fit, start),
        frames_sha256,
        poses: posed.poses,
        frames: posed.frames,
        read_later,
        fit,
        rejected,
    })
}

/// Finds the poses and fits, without the poses of which most frames contradict the others. The frames come with the index of their
/// folder in the place of the pose.
fn settle(
    folders: &[Folder],
    frames: &[FrameObservation],
    start: &Instrument,
) -> Result<(Posed, PlateFit), Refusal> {
    let mut posed = poses::find(folders, frames, &start.plate)?;
    loop {
        let fit = fit(&posed.frames, posed.poses.len(), start).ok_or(Refusal::Undetermined)?;
        if posed.reject(&fit)? == 0 {
            return Ok((posed, fit));
        }
    }
}

/// What [`calibrate`] makes of frames of one folder that are read: their poses and the fit.
///
/// # Errors
/// As [`calibrate`].
pub fn fit_folder(
    path: &Path,
    frames: &[FrameObservation],
    start: &Instrument,
) -> Result<(Vec<Pose>, PlateFit), Refusal> {
    let folder = Folder {
        path: path.into(),
        files: Vec::new(),
    };
    let of_folder = |frame: &FrameObservation| FrameObservation {
        pose: 0,
        ..frame.clone()
    };
    let frames: Vec<_> = frames.iter().map(of_folder).collect();
    let (posed, fit) = settle(&[folder], &frames, start)?;
    Ok((posed.poses, fit))
}

/// A later pass over rejected frames: with the plate, the lens and the pose as found so far, marks can be identified for which
/// two hypotheses were alike, or which lie far from where they were drawn. Of each frame the solution that agrees best with the
/// pose it was made with. They come with the index of their folder in the place of the pose.
fn identify_again(
    rejected: &[RejectedFrame],
    folders: &[Folder],
    (posed, fit): (&Posed, &PlateFit),
    start: &Instrument,
) -> Vec<FrameObservation> {
    /// A mark this near to where a pose puts it is the right one: others are 47 px off.
    const RIGHT_PX: f64 = 5.0;
    let with_pose = |pose: &PoseFit| as_found(pose, fit, start);
    let instruments: Vec<Instrument> = fit.poses.iter().map(with_pose).collect();
    let one = |RejectedFrame { file, .. }: &RejectedFrame| {
        let frame = fits::read_frame_of_size(file, start.camera.size_px()).ok()?;
        let folder = measure::folder_of(folders, file);
        let of_folder = |pose: &usize| posed.poses[*pose].folder == folders[folder].path;
        let poses = (0..instruments.len()).filter(of_folder);
        let solved = poses.filter_map(|pose| {
            let found = &instruments[pose];
            let read = measure::read(folder, file, &frame, found).1.ok()?;
            let mapping = fit.poses[pose].mapping;
            let expected = |id| Some(mapping.to_sensor(found.plate.position(id)));
            Some((read.count_near(RIGHT_PX, expected), read))
        });
        let best = solved.max_by_key(|(right, frame)| (*right, frame.marks.len()));
        Some(best?.1)
    };
    rejected.par_iter().filter_map(one).collect()
}

/// The start with plate, lens and mounting as found. The pose is so certain that no other can be meant, yet not so certain that
/// a frame's keystone contradicts it.
fn as_found(pose: &PoseFit, fit: &PlateFit, start: &Instrument) -> Instrument {
    const CENTRE_SIGMA_PX: f64 = 1.0;
    const ROTATION_SIGMA_DEG: f64 = 0.1;
    let mut found = start.clone();
    for mark in &fit.marks {
        found.plate.set(mark.id, mark.position, mark.sigma_mil);
    }
    found.camera.distortion = fit.distortion;
    found.mounting.scale_mil_per_px.value = pose.scale_mil_per_px.value;
    found.mounting.rotation_deg.value = pose.rotation_deg.value;
    found.mounting.rotation_deg.sigma = ROTATION_SIGMA_DEG;
    found.mounting.plate_centre_px = pose.plate_centre_px;
    found.mounting.plate_centre_sigma_px = CENTRE_SIGMA_PX;
    found
}

/// Refuses poses of different scale.
fn check_scales(poses: &[Pose], fit: &PlateFit) -> Result<(), Refusal> {
    /// Scales of one camera's poses differ by less than this part.
    const SAME_SCALE: f64 = 0.05;
    let scale = |pose: usize| fit.poses[pose].scale_mil_per_px.value;
    match (0..poses.len()).find(|n| (scale(*n) / scale(0) - 1.0).abs() > SAME_SCALE) {
        None => Ok(()),
        Some(other) => Err(Refusal::MixedScales {
            file: poses[0].folder.clone(),
            scale: scale(0),
            other_file: poses[other].folder.clone(),
            other: scale(other),
        }),
    }
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
