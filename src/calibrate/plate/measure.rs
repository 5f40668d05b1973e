//! From files to sightings: each frame is read, solved and forgotten but for its marks.

use super::input::Folder;
use super::lit::{by_lamp, lit_levels};
use super::sighting::{FrameSightings, Sighting, Spoiled};
use crate::aspect::{self, Expected, Origin, Solution};
use crate::calibrate::frames::sha256_of;
use crate::fits;
use crate::frame::Frame;
use crate::instrument::Instrument;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// What all frames gave.
#[derive(Debug, Clone, Default)]
pub struct Sightings {
    pub frames: Vec<FrameSightings>,
    pub spoiled: Vec<Spoiled>,
    /// Of every file that could be read: its SHA-256, the camera that it names, its size and depth.
    pub files: Vec<FileFacts>,
}

/// What a file is, whatever its frame shows.
#[derive(Debug, Clone, PartialEq)]
pub struct FileFacts {
    pub file: PathBuf,
    pub sha256: [u8; 32],
    pub camera: Option<String>,
    pub size_px: (usize, usize),
    /// The value at which its pixels saturate: that of 8 or of 12 bits.
    pub saturation_dn: u16,
    pub timed: bool,
}

/// Fewest marks of a frame that is used.
const LEAST_MARKS: usize = 3;

/// Reads and solves all frames of all folders, several at a time; `each` is called after every one.
pub fn measure(folders: &[Folder], instrument: &Instrument, each: &(dyn Fn() + Sync)) -> Sightings {
    let files: Vec<(usize, &PathBuf)> = folders
        .iter()
        .enumerate()
        .flat_map(|(n, folder)| folder.files.iter().map(move |file| (n, file)))
        .collect();
    let one = |(folder, file): &(usize, &PathBuf)| {
        let facts_and_frame = one(*folder, file, instrument);
        each();
        facts_and_frame
    };
    let all: Vec<_> = files.par_iter().map(one).collect();
    let mut sightings = Sightings::default();
    for (facts, frame) in all {
        sightings.files.extend(facts);
        match frame {
            Ok(frame) => sightings.frames.push(frame),
            Err(spoiled) => sightings.spoiled.push(spoiled),
        }
    }
    sightings
}

/// Solves a frame as one of a pose, with an instrument that states the pose.
pub(super) fn measure_one(pose: usize, file: &Path, posed: &Instrument) -> Option<FrameSightings> {
    one(pose, file, posed).1.ok()
}

type One = (Option<FileFacts>, Result<FrameSightings, Spoiled>);

fn one(pose: usize, file: &Path, instrument: &Instrument) -> One {
    let spoiled = |reason: String| Spoiled {
        file: file.into(),
        reason,
    };
    let frame = match fits::read_frame(file) {
        Ok(frame) => frame,
        Err(error) => return (None, Err(spoiled(error.problem.to_string()))),
    };
    let facts = match std::fs::read(file) {
        Ok(bytes) => FileFacts {
            file: file.into(),
            sha256: sha256_of(&bytes),
            camera: frame.info.camera.clone(),
            size_px: (frame.width(), frame.height()),
            saturation_dn: frame.saturation_dn(),
            timed: frame.info.mid_exposure.is_some(),
        },
        Err(error) => return (None, Err(spoiled(format!("cannot read: {error}")))),
    };
    let sightings = instrument
        .check_size(&frame)
        .map_err(|wrong| wrong.to_string())
        .and_then(|()| match lit_levels(&frame) {
            Some(levels) => by_lamp(pose, file, &frame, &levels, instrument),
            None => by_sun(pose, file, &frame, instrument),
        });
    (Some(facts), sightings.map_err(spoiled))
}

/// The marks of a frame of the Sun.
fn by_sun(
    pose: usize,
    file: &Path,
    frame: &Frame,
    instrument: &Instrument,
) -> Result<FrameSightings, String> {
    let Some(utc) = frame.info.mid_exposure else {
        return Err("no time: expected DATE-OBS or DATE-AVG in a frame of the Sun".into());
    };
    let solution = aspect::solve(frame, instrument, Expected::at(utc), None);
    let stopped = || match &solution.stopped {
        Some(stopped) => stopped.to_string(),
        None => "no mapping of its own".into(),
    };
    let own = solution.mapping.as_ref();
    let own = own.filter(|adopted| adopted.origin == Origin::Frame);
    let (Some(own), Some(aspect)) = (own, &solution.aspect) else {
        return Err(stopped());
    };
    let sightings = sightings(&solution);
    if sightings.len() < LEAST_MARKS {
        let count = sightings.len();
        return Err(format!("{count} marks, expected {LEAST_MARKS}"));
    }
    Ok(FrameSightings {
        file: file.into(),
        pose,
        utc: Some(utc),
        mapping: own.mapping,
        sun: Some(aspect.sun_plate.position),
        sightings,
    })
}

/// Marks that the limb cuts too: their own pixels placed them, in the light that the limb tells.
fn sightings(solution: &Solution) -> Vec<Sighting> {
    let marks = solution.marks.iter();
    marks
        .map(|mark| Sighting {
            id: mark.id,
            at: mark.at,
            covariance_px2: mark.covariance_px2,
        })
        .collect()
}
