//! Calibrates a plate from files: observes the frames, finds the poses, fits, and checks the result.

use super::fit::{PlateFit, PoseFit, fit};
use super::measure::{self, measure};
use super::observation::{FrameObservation, Pose, folder_of, take_blurred};
use super::poses::{self, Posed};
use super::refusal::Refusal;
use super::rest::Shifts;
use super::suspects::{SuspectMark, suspects};
use super::used_frames::UsedFrames;
use crate::fits;
use crate::instrument::Instrument;
use crate::observe::{Depth, Hash, InputError, RejectedFrame, Watch, hashes, list, sha256_of};
use crate::units::PlateMil;
use jiff::Timestamp;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::path::PathBuf;

/// A plate calibration: the fit and its inputs.
#[derive(Debug, Clone)]
pub struct Calibration {
    /// The initial instrument.
    pub start: Instrument,
    pub start_from: StartFrom,
    /// Poses with their frames.
    pub poses: Vec<Pose>,
    /// Number of frames that could only be identified with the measured plate.
    pub read_later: usize,
    pub fit: PlateFit,
    pub rejected: Vec<RejectedFrame>,
    /// Marks that were illuminated but not identified.
    pub suspects: Vec<SuspectMark>,
    /// Hash over the sorted SHA-256 of the given files, independent of their names and order.
    pub frames_sha256: String,
    /// The frames that the new file is based on.
    pub used_frames: UsedFrames,
    /// The camera's name stated in the frames.
    pub camera: Option<String>,
    /// The pose nearest to the camera's position in the start's mounting: the others were made for the calibration.
    pub mounted_pose: usize,
}

/// Initial positions of the marks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StartFrom {
    /// Positions in the file.
    File,
    /// Drawn positions, because the file is based on exactly the given frames.
    Drawing,
}

impl Calibration {
    /// The frames of all poses, in the order of [`Residual::frame`](super::Residual::frame).
    pub fn frames(&self) -> impl Iterator<Item = &FrameObservation> {
        self.poses.iter().flat_map(|pose| &pose.frames)
    }

    /// Times of the first and the last frame.
    pub fn span(&self) -> Option<[Timestamp; 2]> {
        let times = || self.frames().filter_map(|frame| frame.utc);
        Some([times().min()?, times().max()?])
    }
}

/// Greatest number of times that poses whose frames are not at rest are split.
const MOST_SPLITS: usize = 4;
/// Passes over the rejected frames after the first: each uses the plate measured by the previous one.
const LATER_PASSES: usize = 3;

/// The files of frames and folders, without repetition.
fn files(given: &[PathBuf]) -> Result<Vec<PathBuf>, Refusal> {
    let mut known = BTreeSet::new();
    let mut files = list(given, Depth::Nearest)?;
    files.retain(|file| known.insert(file.clone()));
    Ok(files)
}

/// Calibrates plate, lens and poses from frames and folders, each frame once: frames that the start's file is based on are excluded.
///
/// # Errors
/// A [`Refusal`] says why the set of frames is unsuitable and which frames to take instead. Single bad frames are listed in
/// [`Calibration::rejected`].
pub fn calibrate(
    given: &[PathBuf],
    start: &Instrument,
    used_frames: &UsedFrames,
    watch: &dyn Watch,
) -> Result<Calibration, Refusal> {
    let Inputs {
        files,
        start,
        start_from,
        known,
        frames_sha256,
        used_frames,
    } = Inputs::new(files(given)?, start, used_frames);
    let start = &start;
    let (mut observations, copies) = measure(files, start, watch)?;
    let mut blurred = take_blurred(&mut observations.frames);
    observations.check_files(start)?;
    observations.check_coverage(start)?;
    let camera = observations.camera();
    let (mut frames, mut unread) = (observations.frames, observations.rejected);
    let (mut posed, mut fit) = fit_frames(&frames, start)?;
    let mut read_later = 0;
    for _ in 0..LATER_PASSES {
        let mut read = identify_again(&unread, &posed.poses, &fit, start);
        if watch.is_cancelled() {
            return Err(InputError::Cancelled.into());
        }
        if read.is_empty() {
            break;
        }
        unread.retain(|rejected| read.iter().all(|frame| frame.file != rejected.file));
        read_later += read.len();
        frames.append(&mut read);
        blurred.extend(take_blurred(&mut frames));
        (posed, fit) = fit_frames(&frames, start)?;
    }
    check_scales(&posed.poses, &fit)?;
    let mut rejected = [
        known,
        copies,
        blurred,
        unread,
        posed.rejected,
        fit.rejected.clone(),
    ]
    .concat();
    rejected.sort_by(|a, b| a.file.cmp(&b.file));
    Ok(Calibration {
        camera,
        mounted_pose: mounted_pose(&fit, start),
        start_from,
        used_frames,
        suspects: suspects(&posed.poses, &fit, start),
        frames_sha256,
        poses: posed.poses,
        read_later,
        fit,
        rejected,
        start: start.clone(),
    })
}

/// Inputs of a calibration.
struct Inputs {
    files: Vec<PathBuf>,
    start: Instrument,
    start_from: StartFrom,
    /// Frames that the start's file is based on.
    known: Vec<RejectedFrame>,
    frames_sha256: String,
    used_frames: UsedFrames,
}

impl Inputs {
    fn new(files: Vec<PathBuf>, start: &Instrument, used_frames: &UsedFrames) -> Self {
        let hashes = hashes(&files);
        let frames_sha256 = sha256_of(&hashes);
        let is_known = |hash: &Option<Hash>| hash.is_some_and(|hash| used_frames.holds(&hash));
        let again = used_frames.are(&frames_sha256) || hashes.iter().all(is_known);
        let mut inputs = Self {
            files: Vec::new(),
            start: start.clone(),
            start_from: StartFrom::File,
            known: Vec::new(),
            frames_sha256,
            used_frames: used_frames.with(hashes.iter().flatten()),
        };
        if again {
            inputs.files = files;
            inputs.start.plate = start.plate.as_drawn();
            inputs.start_from = StartFrom::Drawing;
            inputs.used_frames = UsedFrames::default().with(hashes.iter().flatten());
            return inputs;
        }
        for (file, hash) in files.into_iter().zip(&hashes) {
            match is_known(hash) {
                true => inputs
                    .known
                    .push(RejectedFrame::new(file, "the file rests on it already")),
                false => inputs.files.push(file),
            }
        }
        inputs
    }
}

/// The part of [`calibrate`] after reading the frames: finds the poses of each folder, excludes those in which at least half of the
/// frames contradict the others, and fits.
///
/// # Errors
/// As [`calibrate`].
pub fn fit_frames(
    frames: &[FrameObservation],
    start: &Instrument,
) -> Result<(Posed, PlateFit), Refusal> {
    let found = poses::find(frames, &start.plate)?;
    let by_time = fit_and_split(found.clone(), start, 0);
    let moving = |fitted: &(Posed, PlateFit)| Shifts::of(&fitted.1).moving();
    let displaced = by_time.as_ref().map_or(usize::MAX, moving);
    if displaced == 0 {
        return by_time;
    }
    match fit_and_split(found.joined(), start, MOST_SPLITS) {
        Ok(by_place) if moving(&by_place) < displaced => Ok(by_place),
        _ => by_time,
    }
}

/// Fits the poses. Splits those that are not at rest, up to `splits` times, by the plate's position in their frames, and excludes poses
/// in which at least half of the frames contradict the others.
fn fit_and_split(
    mut posed: Posed,
    start: &Instrument,
    splits: usize,
) -> Result<(Posed, PlateFit), Refusal> {
    let mut split = 0;
    loop {
        let fit = fit(&posed.poses, start)
            .ok_or_else(|| Refusal::undetermined(&posed.poses, &start.plate))?;
        if split < splits && posed.part(&fit) {
            split += 1;
        } else if posed.reject(&fit)? == 0 {
            return Ok((posed, fit));
        }
    }
}

/// A later pass over rejected frames: with the plate, the lens and the pose found so far, marks can be identified for which two
/// hypotheses fitted equally well, or which lie far from their drawn position. Each frame keeps the solution that agrees best with the
/// pose used for it.
fn identify_again(
    rejected: &[RejectedFrame],
    poses: &[Pose],
    fit: &PlateFit,
    start: &Instrument,
) -> Vec<FrameObservation> {
    /// A mark this near to its position predicted by a pose is the right one: others are 47 px off.
    const RIGHT_PX: f64 = 5.0;
    let with_pose = |pose: &PoseFit| as_found(pose, fit, start);
    let instruments: Vec<Instrument> = fit.poses.iter().map(with_pose).collect();
    let one = |RejectedFrame { file, .. }: &RejectedFrame| {
        let frame = fits::read_frame_of_size(file, start.camera.size_px()).ok()?;
        let of_folder = |pose: &usize| poses[*pose].folder == folder_of(file);
        let poses = (0..instruments.len()).filter(of_folder);
        let solved = poses.filter_map(|pose| {
            let found = &instruments[pose];
            let read = measure::read(file, &frame, found).1.ok()?;
            let mapping = fit.poses[pose].mapping;
            let expected = |id| Some(mapping.to_sensor(found.plate.position(id)?));
            Some((read.count_near(RIGHT_PX, expected), read))
        });
        let best = solved.max_by_key(|(right, frame)| (*right, frame.marks.len()));
        Some(best?.1)
    };
    rejected.par_iter().filter_map(one).collect()
}

/// The start with plate, lens and mounting as found. The pose's sigmas exclude other poses, but are large enough not to contradict a
/// frame's keystone.
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
    /// Relative difference of the scales of one camera's poses is below this.
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

/// The pose whose mapping of the plate is nearest to the stated one.
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
