//! Calibrates a mounting from files.

use super::calibration::{Mounting, calibrate};
use super::collect::{Frames, collect};
use super::fit::Pointings;
use super::observation::MountingError;
use super::report::page;
use crate::calibrate::frames::CalibrateError;
use crate::calibrate::revision::{Provenance, Revision};
use crate::geometry::Handedness;
use crate::instrument::Instrument;
use crate::observe::{Depth, RejectedFrame, Watch, list};
use crate::report::plot::PlotError;
use std::path::PathBuf;

/// A mounting determined from frames, and its inputs.
#[derive(Debug, Clone)]
pub struct FromFrames {
    pub mounting: Mounting,
    /// The initial instrument, but with the handedness determined from the marks.
    pub oriented: Instrument,
    /// Handedness of the camera's view, if it differs from the instrument's.
    pub other_handedness: Option<Handedness>,
    pub rejected: Vec<RejectedFrame>,
    pub provenance: Provenance,
}

/// Calibrates the mounting of an instrument from frames and folders of them.
///
/// # Errors
/// If the frames are not the instrument's, or do not determine a mounting at all.
pub fn from_frames(
    given: &[PathBuf],
    frames: &Frames<'_>,
    watch: &dyn Watch,
) -> Result<FromFrames, CalibrateError<MountingError>> {
    let files = list(given, Depth::All)?;
    let (observations, mut rejected, handedness) = collect(&files, frames, watch)?;
    let pointings = match frames.log {
        Some(_) => Pointings::Known,
        None => Pointings::Fixed,
    };
    let mut oriented = frames.instrument.clone();
    oriented.mounting.handedness = handedness;
    let mounting = calibrate(&observations, pointings, &oriented)
        .map_err(CalibrateError::undetermined(&rejected))?;
    rejected.extend(mounting.rejected.iter().cloned());
    let stated = frames.instrument.mounting.handedness;
    Ok(FromFrames {
        provenance: provenance(&mounting, &files),
        other_handedness: Some(handedness).filter(|found| *found != stated),
        mounting,
        oriented,
        rejected,
    })
}

impl FromFrames {
    /// Writes the determined values into an instrument's file; the other values stay.
    pub fn revise(&self, revision: &mut Revision) {
        self.mounting.revise(revision, &self.provenance);
        if let Some(found) = self.other_handedness {
            let name = found.name().into();
            revision.set("mounting.handedness", name, None, &self.provenance);
        }
    }

    /// For people, without the rejected frames.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![self.mounting.agreement(&self.oriented)];
        lines.extend(self.mounting.quantities.iter().map(ToString::to_string));
        let found = self.other_handedness.map(Handedness::name);
        lines.extend(found.map(|name| format!("handedness: determined by the marks: {name}")));
        lines
    }

    /// # Errors
    /// If a figure cannot be drawn.
    pub fn page(&self) -> Result<String, PlotError> {
        let source = &self.provenance.source;
        page(&self.mounting, &self.oriented, source, &self.rejected)
    }
}

fn provenance(mounting: &Mounting, files: &[PathBuf]) -> Provenance {
    let way = match mounting.fit.pointings {
        Pointings::Known => "known pointing",
        Pointings::Fixed => "drift scan",
    };
    let times = mounting.fit.residuals.iter().map(|r| r.utc);
    let frames = mounting.fit.accepted();
    let done = format!("mounting calibration, {way}");
    // The Sun's path determines the plate's mounting, not the camera that sees it.
    Provenance::of_frames("mounting", &done, frames, times, files)
}
