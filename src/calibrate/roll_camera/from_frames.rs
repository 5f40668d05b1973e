//! Calibrates the camera's orientation in the body from files.

use super::collect::{Horizons, collect, with_attitude, with_sun};
use super::fit::{Turn, TurnError, fit};
use super::observation::{Horizon, HorizonObservation};
use super::report::NAME;
use crate::archive::role_of;
use crate::calibrate::frames::{CalibrateError, FramesError};
use crate::calibrate::mounting::{self, AttitudeLog, Frames, SunObservation};
use crate::calibrate::revision::{Provenance, Revision};
use crate::instrument::{Directions, MountedCamera, Role};
use crate::observe::{Depth, RejectedFrame, Watch, list};
use nalgebra::Rotation3;
use std::path::PathBuf;

/// Reference for the body's attitude, other than the horizon.
#[derive(Debug, Clone, Copy)]
pub enum Reference<'a> {
    Attitude(&'a AttitudeLog),
    /// The Sun, observed with a telescope on the same body.
    Sun(&'a Frames<'a>),
}

/// A camera's rotation determined from frames, and the inputs.
#[derive(Debug, Clone)]
pub struct FromFrames {
    pub turn: Turn,
    pub rejected: Vec<RejectedFrame>,
    pub provenance: Provenance,
    stated: Rotation3<f64>,
}

/// Calibrates the orientation in the body of a camera that sees the horizon, from frames and folders of frames.
///
/// # Errors
/// If the frames are not the cameras', or do not determine the rotation.
pub fn from_frames(
    given: &[PathBuf],
    camera: &MountedCamera,
    horizons: &Horizons<'_>,
    reference: Reference<'_>,
    watch: &dyn Watch,
) -> Result<FromFrames, CalibrateError<TurnError>> {
    let files = list(given, Depth::All)?;
    let (of_horizon, of_sun): (Vec<PathBuf>, Vec<PathBuf>) = match reference {
        Reference::Attitude(_) => (files.clone(), Vec::new()),
        Reference::Sun(_) => files
            .iter()
            .cloned()
            .partition(|file| role_of(file).is_some_and(|(role, _)| role == Role::Roll)),
    };
    if of_horizon.is_empty() {
        let missing = "expected frames of the roll camera (named roll_*), found none; with --attitude any name will do";
        return Err(FramesError::Missing(missing.into()).into());
    }
    let (seen, mut rejected) = collect(&of_horizon, horizons, watch)?;
    let (observations, more) = match reference {
        Reference::Attitude(log) => with_attitude(seen, log),
        Reference::Sun(frames) => by_sun(&of_sun, frames, seen, watch)?,
    };
    rejected.extend(more);
    let stated = camera.body_from_camera;
    let turn = fit(&observations, &stated).map_err(CalibrateError::undetermined(&rejected))?;
    let done = match reference {
        Reference::Attitude(_) => "body_from_camera, known attitude",
        Reference::Sun(_) => "body_from_camera, Sun and horizon together",
    };
    let times = observations
        .iter()
        .map(|observation| observation.horizon.utc);
    Ok(FromFrames {
        provenance: Provenance::of_frames(NAME, done, turn.taken, times, &files),
        turn,
        rejected,
        stated,
    })
}

impl FromFrames {
    /// Writes the rotation into the camera's file.
    pub fn revise(&self, revision: &mut Revision) {
        self.turn.revise(revision, &self.provenance);
    }

    /// For people, without the rejected frames.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![self.turn.to_string()];
        let more = self.turn.from_stated_deg(&self.stated).into_iter();
        let more = more.zip(self.turn.sigmas_deg());
        lines.extend(["forward", "right", "down"].iter().zip(more).map(
            |(axis, (deg, sigma))| {
                format!("turn from the stated one about the body's {axis} axis: {deg:+.4} +- {sigma:.4} deg")
            },
        ));
        lines
    }
}

fn by_sun(
    files: &[PathBuf],
    frames: &Frames<'_>,
    seen: Vec<Horizon>,
    watch: &dyn Watch,
) -> Result<(Vec<HorizonObservation>, Vec<RejectedFrame>), FramesError> {
    let directions = frames.instrument.mounting.directions;
    if directions != Directions::Telescope {
        return Err(FramesError::Missing(format!(
            "mounting.directions: expected \"telescope\" to know the Sun's direction in the telescope's axes, found \"{}\"",
            directions.name()
        )));
    }
    if files.is_empty() {
        let missing = "expected frames of the Sun beside those of the roll camera, found none; --attitude gives the body's attitude without them";
        return Err(FramesError::Missing(missing.into()));
    }
    let (mut suns, mut rejected, _) = mounting::collect(files, frames, watch)?;
    suns.sort_by_key(|sun: &SunObservation| sun.utc);
    let (observations, more) = with_sun(seen, &suns, frames.instrument);
    rejected.extend(more);
    Ok((observations, rejected))
}
