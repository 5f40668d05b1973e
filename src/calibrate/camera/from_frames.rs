//! Calibrates the camera from files.

use super::calibration::{CameraCalibration, CameraError, Inputs, calibrate};
use super::report::page;
use super::shots::{load, solve};
use crate::calibrate::frames::{CalibrateError, FramesError};
use crate::calibrate::revision::{Provenance, Revision};
use crate::instrument::Instrument;
use crate::observe::{Depth, RejectedFrame, Watch, list, sha256};
use crate::report::plot::PlotError;
use jiff::tz::TimeZone;
use std::path::PathBuf;

/// Frames and folders of frames, by kind.
#[derive(Debug, Clone, Copy, Default)]
pub struct InputFiles<'a> {
    /// Dark frames, at equal exposure.
    pub dark: &'a [PathBuf],
    /// Evenly illuminated frames, two at each of several exposures.
    pub flat: &'a [PathBuf],
    /// Frames of the Sun on the plate.
    pub sun: &'a [PathBuf],
}

/// A camera calibrated from frames, and the inputs.
#[derive(Debug, Clone)]
pub struct FromFrames {
    pub calibration: CameraCalibration,
    pub rejected: Vec<RejectedFrame>,
    pub provenance: Provenance,
    instrument: String,
    /// Description of the inputs, for people.
    given: String,
}

/// Calibrates the camera of an instrument from frames and folders of them.
///
/// # Errors
/// If the frames are not the instrument's, or determine nothing.
pub fn from_frames(
    given: InputFiles<'_>,
    stated: &Instrument,
    watch: &dyn Watch,
) -> Result<FromFrames, CalibrateError<CameraError>> {
    let files = |given| list(given, Depth::All).map_err(FramesError::from);
    let (dark, flat, sun) = (files(given.dark)?, files(given.flat)?, files(given.sun)?);
    let (dark_shots, dark_rejected) = load(&dark, stated, watch)?;
    let (flat_shots, flat_rejected) = load(&flat, stated, watch)?;
    let (sun_shots, suns, sun_rejected) = solve(&sun, stated, watch)?;
    let rejected = [dark_rejected, flat_rejected, sun_rejected].concat();
    let inputs = Inputs {
        dark: dark_shots,
        flat: flat_shots,
        sun: sun_shots,
        suns,
    };
    let calibration =
        calibrate(&inputs, stated).map_err(CalibrateError::undetermined(&rejected))?;
    let all = given.sun.iter().chain(given.dark).chain(given.flat);
    let all: Vec<String> = all.map(|path| path.display().to_string()).collect();
    Ok(FromFrames {
        calibration,
        rejected,
        provenance: provenance(&inputs, &[dark, flat, sun].concat()),
        instrument: stated.name.clone(),
        given: all.join(", "),
    })
}

impl FromFrames {
    /// Writes the determined values into an instrument's file; the other values stay.
    pub fn revise(&self, revision: &mut Revision) {
        self.calibration.revise(revision, &self.provenance);
    }

    /// # Errors
    /// If a figure cannot be drawn.
    pub fn page(&self) -> Result<String, PlotError> {
        let source = format!("{} ({})", self.provenance.source, self.given);
        page(&self.calibration, &self.instrument, &source, &self.rejected)
    }
}

fn provenance(inputs: &Inputs, files: &[PathBuf]) -> Provenance {
    let shots = || {
        let all = [&inputs.dark, &inputs.flat, &inputs.sun].into_iter();
        all.flat_map(|s| &s.frames)
    };
    let last = shots().filter_map(|s| s.frame.info.mid_exposure).max();
    Provenance {
        name: "camera",
        source: format!(
            "camera calibration, {} dark, {} evenly lit and {} frames of the Sun",
            inputs.dark.frames.len(),
            inputs.flat.frames.len(),
            inputs.suns.len()
        ),
        date: last.map(|last| TimeZone::UTC.to_datetime(last).date()),
        frames: files.len(),
        frames_sha256: sha256(files),
        camera: shots().find_map(|s| s.frame.info.camera.clone()),
    }
}
