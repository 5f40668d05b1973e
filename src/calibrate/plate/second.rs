//! A second look at the frames that the first could not read: with the plate, the lens and the pose as found so far, marks
//! that two readings explained alike, or that lie far from where they were drawn, can be told.

use super::fit::{PlateFit, PoseFit};
use super::measure::measure_one;
use super::poses::Posed;
use super::sighting::{FrameSightings, Spoiled};
use crate::instrument::Instrument;
use rayon::prelude::*;
use std::path::Path;

/// A pose is known so well that nothing else can be meant, yet not so well that its keystone were in the way.
const CENTRE_SIGMA_PX: f64 = 1.0;
const ROTATION_SIGMA_DEG: f64 = 0.1;

/// The frames that can be read now.
pub(super) fn look(
    unread: &[Spoiled],
    posed: &Posed,
    fit: &PlateFit,
    start: &Instrument,
) -> Vec<FrameSightings> {
    let stated = |pose: &PoseFit| stating(pose, fit, start);
    let instruments: Vec<Instrument> = fit.poses.iter().map(stated).collect();
    let in_pose = |file: &Path, pose: usize| {
        let here = file.parent() == Some(&posed.poses[pose].folder);
        here.then(|| measure_one(pose, file, &instruments[pose]))?
    };
    let one = |spoiled: &Spoiled| {
        let readings = (0..posed.poses.len()).filter_map(|pose| in_pose(&spoiled.file, pose));
        readings.max_by_key(|frame| frame.sightings.len())
    };
    unread.par_iter().filter_map(one).collect()
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
