//! A second look at the frames that the first could not read: with the plate, the lens and the pose as found so far, marks
//! that two readings explained alike, or that lie far from where they were drawn, can be told.

use super::fit::{PlateFit, PoseFit};
use super::input::Folder;
use super::measure::measure_one;
use super::poses::Posed;
use super::sighting::{FrameSightings, Spoiled};
use crate::instrument::Instrument;
use rayon::prelude::*;

/// A pose is known so well that nothing else can be meant, yet not so well that its keystone were in the way.
const CENTRE_SIGMA_PX: f64 = 1.0;
const ROTATION_SIGMA_DEG: f64 = 0.1;

/// A mark this near to where a pose puts it is the one meant: others are 47 px off.
const MEANT_PX: f64 = 5.0;

/// The frames that can be read now, of each the reading that agrees best with the pose it was made with. They come with the
/// index of their folder in the place of the pose.
pub(super) fn look(
    unread: &[Spoiled],
    folders: &[Folder],
    (posed, fit): (&Posed, &PlateFit),
    start: &Instrument,
) -> Vec<FrameSightings> {
    let stated = |pose: &PoseFit| stating(pose, fit, start);
    let instruments: Vec<Instrument> = fit.poses.iter().map(stated).collect();
    let one = |spoiled: &Spoiled| {
        let file = &spoiled.file;
        let folder = folders.iter().position(|f| f.files.contains(file))?;
        let here = |pose: &usize| posed.poses[*pose].folder == folders[folder].path;
        let readings = (0..instruments.len()).filter(here).filter_map(|pose| {
            let found = &instruments[pose];
            let frame = measure_one(folder, file, found)?;
            Some((meant(&frame, &fit.poses[pose], found), frame))
        });
        let best = readings.max_by_key(|(meant, frame)| (*meant, frame.sightings.len()));
        Some(best?.1)
    };
    unread.par_iter().filter_map(one).collect()
}

/// How many marks are seen where a pose puts them.
fn meant(frame: &FrameSightings, pose: &PoseFit, found: &Instrument) -> usize {
    let near = frame.sightings.iter().filter(|sighting| {
        let expected = pose.mapping.to_sensor(found.plate.position(sighting.id));
        expected.distance(sighting.at) < MEANT_PX
    });
    near.count()
}

/// The start with plate, lens and mounting as found.
fn stating(pose: &PoseFit, fit: &PlateFit, start: &Instrument) -> Instrument {
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
