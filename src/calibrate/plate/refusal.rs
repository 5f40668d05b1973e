//! Why a calibration is refused, and what to take instead.

use super::fit::PlateFit;
use super::input::InputError;
use super::measure::{FileFacts, Sightings};
use super::poses::Pose;
use crate::instrument::Instrument;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A set of frames that gives no calibration.
#[derive(Debug, thiserror::Error)]
pub enum Refusal {
    #[error(transparent)]
    Input(#[from] InputError),
    #[error(
        "{file}: expected frames of one instrument, found camera \"{camera}\" here and \"{other}\" in {other_file}; give the frames of one camera only",
        file = .file.display(), other_file = .other_file.display()
    )]
    MixedCameras {
        file: PathBuf,
        camera: String,
        other_file: PathBuf,
        other: String,
    },
    #[error(
        "{file}: expected frames of one size, found {size_px:?} px here and {other_px:?} px in {other_file}; give the frames of one instrument only",
        file = .file.display(), other_file = .other_file.display()
    )]
    MixedSizes {
        file: PathBuf,
        size_px: (usize, usize),
        other_file: PathBuf,
        other_px: (usize, usize),
    },
    #[error(
        "{file}: expected frames of one depth, found pixels that saturate at {full_dn} DN here and at {other_dn} DN in {other_file}; give the frames of one camera and setting only",
        file = .file.display(), other_file = .other_file.display()
    )]
    MixedDepths {
        file: PathBuf,
        full_dn: u16,
        other_file: PathBuf,
        other_dn: u16,
    },
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
    #[error(
        "{}: expected frames of {expected:?} px as instrument \"{instrument}\" states, found {found:?} px; give --instrument of the camera that took them",
        .file.display()
    )]
    WrongSize {
        file: PathBuf,
        instrument: String,
        expected: (usize, usize),
        found: (usize, usize),
    },
    #[error(
        "none of the {frames} frames tells its time; take frames with DATE-OBS or DATE-AVG (UTC), which says how large the Sun is and when the camera was in which pose"
    )]
    NoTime { frames: usize },
    #[error(
        "none of the {frames} frames shows enough marks (first: {first}); take frames with the whole Sun on the plate, in focus and not saturated"
    )]
    NothingRead { frames: usize, first: String },
    #[error(
        "too few marks: {frames} frames show {marks} marks, {again} of them more than once, expected at least {LEAST_MARKS} seen more than once; take more frames, with the Sun all over the plate"
    )]
    TooFewMarks {
        frames: usize,
        marks: usize,
        again: usize,
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
        "the frames do not determine the plate; take frames with the Sun all over it in each pose"
    )]
    Undetermined,
}

/// Fewest marks seen more than once that a calibration rests on.
const LEAST_MARKS: usize = 12;
/// Scales of one camera's poses differ by less than this part.
const SAME_SCALE: f64 = 0.05;

/// Refuses files of several cameras, sizes or depths, of another instrument's size, or without any time.
pub(super) fn check_files(sightings: &Sightings, instrument: &Instrument) -> Result<(), Refusal> {
    let files = &sightings.files;
    check_alike(files)?;
    let (width, height) = (instrument.camera.width_px, instrument.camera.height_px);
    if let Some(other) = files.iter().find(|f| f.size_px != (width, height)) {
        return Err(Refusal::WrongSize {
            file: other.file.clone(),
            instrument: instrument.name.clone(),
            expected: (width, height),
            found: other.size_px,
        });
    }
    if sightings.frames.is_empty() && !files.is_empty() && files.iter().all(|f| !f.timed) {
        return Err(Refusal::NoTime {
            frames: files.len(),
        });
    }
    Ok(())
}

fn check_alike(files: &[FileFacts]) -> Result<(), Refusal> {
    let mut named = files.iter().filter_map(|f| Some((f, f.camera.as_ref()?)));
    if let Some((first, camera)) = named.next()
        && let Some((other_file, other)) = named.find(|(_, other)| *other != camera)
    {
        return Err(Refusal::MixedCameras {
            file: first.file.clone(),
            camera: camera.clone(),
            other_file: other_file.file.clone(),
            other: other.clone(),
        });
    }
    if let Some(first) = files.first()
        && let Some(other) = files.iter().find(|f| f.size_px != first.size_px)
    {
        return Err(Refusal::MixedSizes {
            file: first.file.clone(),
            size_px: first.size_px,
            other_file: other.file.clone(),
            other_px: other.size_px,
        });
    }
    if let Some(first) = files.first()
        && let Some(other) = files
            .iter()
            .find(|f| f.saturation_dn != first.saturation_dn)
    {
        return Err(Refusal::MixedDepths {
            file: first.file.clone(),
            full_dn: first.saturation_dn,
            other_file: other.file.clone(),
            other_dn: other.saturation_dn,
        });
    }
    Ok(())
}

/// Refuses frames that show too little of the plate.
pub(super) fn check_coverage(
    sightings: &Sightings,
    instrument: &Instrument,
) -> Result<(), Refusal> {
    let frames = &sightings.frames;
    if frames.is_empty() {
        let first = sightings.spoiled.first();
        return Err(Refusal::NothingRead {
            frames: sightings.spoiled.len(),
            first: first.map_or(String::new(), |s| {
                format!("{}: {}", s.file.display(), s.reason)
            }),
        });
    }
    // A frame of the lit plate shows all marks at once.
    if frames.iter().any(|frame| frame.sun.is_none()) {
        return Ok(());
    }
    let suns: Vec<_> = frames.iter().filter_map(|frame| frame.sun).collect();
    let reach_mil = suns
        .iter()
        .map(|sun| sun.distance(suns[0]))
        .fold(0.0, f64::max);
    if frames.len() > 1 && reach_mil < instrument.optics.radius_mil(960.0) {
        return Err(Refusal::OnePlace {
            frames: frames.len(),
            reach_mil,
        });
    }
    let mut seen: BTreeMap<_, usize> = BTreeMap::new();
    for sighting in frames.iter().flat_map(|frame| &frame.sightings) {
        *seen.entry(sighting.id).or_default() += 1;
    }
    let again = seen.values().filter(|times| **times > 1).count();
    if again < LEAST_MARKS {
        return Err(Refusal::TooFewMarks {
            frames: frames.len(),
            marks: seen.len(),
            again,
        });
    }
    Ok(())
}

/// Refuses poses of different scale.
pub(super) fn check_scales(poses: &[Pose], fit: &PlateFit) -> Result<(), Refusal> {
    let scale = |pose: usize| fit.poses[pose].scale_mil_per_px.value;
    let other = (0..poses.len()).find(|n| (scale(*n) / scale(0) - 1.0).abs() > SAME_SCALE);
    match other {
        None => Ok(()),
        Some(other) => Err(Refusal::MixedScales {
            file: poses[0].folder.clone(),
            scale: scale(0),
            other_file: poses[other].folder.clone(),
            other: scale(other),
        }),
    }
}
