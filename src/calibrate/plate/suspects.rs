//! Marks that were illuminated but not identified: they are not printed at their expected position, or something covers them.

use super::fit::{PlateFit, PoseFit};
use super::observation::{FrameObservation, Pose};
use crate::instrument::{Instrument, SMALLEST_SUN_ARCSEC};
use crate::plate::MarkId;
use crate::units::PlateMil;
use std::collections::BTreeMap;
use std::fmt;

/// A mark that was illuminated but hardly ever identified.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SuspectMark {
    pub id: MarkId,
    /// Number of frames in which the Sun or a lamp illuminated all of it.
    pub lit: usize,
    /// Number of frames in which it was identified at the position found from the others.
    pub read: usize,
}

impl fmt::Display for SuspectMark {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { id, lit, read } = self;
        write!(out, "{id} lit in {lit} frames, identified in {read}")
    }
}

/// Fewest frames in which a suspect was illuminated.
const LEAST_LIT: usize = 3;
/// A mark is identified in more than this share of the frames that illuminate it.
const LEAST_READ: f64 = 0.1;
/// Marks nearer to the sensor's border may be cut off, px.
const BORDER_PX: f64 = 20.0;

/// The suspect marks, by id.
pub(super) fn suspects(poses: &[Pose], fit: &PlateFit, start: &Instrument) -> Vec<SuspectMark> {
    let mut read: BTreeMap<MarkId, usize> = BTreeMap::new();
    for residual in fit.kept() {
        *read.entry(residual.id).or_default() += 1;
    }
    let suspect = |(id, at): (MarkId, PlateMil)| {
        let lit = poses.iter().zip(&fit.poses).map(|(pose, found)| {
            let frames = pose.frames.iter();
            let lit = frames.filter(|frame| is_lit(at, frame, found, start));
            lit.count()
        });
        let (lit, read) = (lit.sum(), read.get(&id).copied().unwrap_or(0));
        let is_suspect = lit >= LEAST_LIT && (read as f64) < LEAST_READ * lit as f64;
        is_suspect.then_some(SuspectMark { id, lit, read })
    };
    start.plate.marks().filter_map(suspect).collect()
}

/// Whether all of a mark is illuminated and on the sensor.
fn is_lit(at: PlateMil, frame: &FrameObservation, pose: &PoseFit, start: &Instrument) -> bool {
    let reach_mil = start.optics.radius_mil(SMALLEST_SUN_ARCSEC) - start.plate.shape.size_mil();
    let by_sun = frame.sun.is_none_or(|sun| sun.distance(at) < reach_mil);
    let seen = pose.mapping.to_sensor(at);
    let inside = |along: f64, size: usize| along > BORDER_PX && along < size as f64 - BORDER_PX;
    by_sun && inside(seen.x, start.camera.width_px) && inside(seen.y, start.camera.height_px)
}
