//! Makes observations of the Sun from frames.

use super::log::PointingLog;
use super::observation::SunObservation;
use crate::aspect::{self, Expected, Quality, Solution};
use crate::calibrate::frames::{FramesError, Setting, check_settings};
use crate::fits;
use crate::frame::Frame;
use crate::geometry::Handedness;
use crate::instrument::Instrument;
use crate::observe::{RejectedFrame, Watch, each_frame};
use crate::pointing::Horizontal;
use crate::sky::{Air, Ephemeris, SkyError, SunPosition};
use crate::units::Place;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Instrument, observer's position and pointings with which the frames are solved.
#[derive(Debug, Clone)]
pub struct Frames<'a> {
    pub instrument: &'a Instrument,
    /// Position used for frames that do not state theirs.
    pub place: Option<Place>,
    /// Pointings of the telescope; none in a drift scan.
    pub log: Option<&'a PointingLog>,
    /// Whether the log's elevations include refraction, as a theodolite reads them.
    pub apparent: bool,
    /// The air around the observer; none for the standard atmosphere at the observer's height.
    pub air: Option<Air>,
    pub ephemeris: Ephemeris,
}

/// Missing facts of a frame; if all frames lack the same, this is the reason why there is no calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Missing {
    Time,
    Place,
    Pointing,
    Other,
}

/// The reason why a frame gives no observation.
type Rejection = (Missing, String);

/// Solves the frames; returns their observations in the order of the files, the rejected frames, and the handedness of the camera's view:
/// as the instrument states, unless the marks can be identified only in the other handedness.
///
/// # Errors
/// If the frames are of several cameras or of another size than the instrument's, or all of them lack a required fact.
pub fn collect(
    files: &[PathBuf],
    frames: &Frames<'_>,
    watch: &dyn Watch,
) -> Result<(Vec<SunObservation>, Vec<RejectedFrame>, Handedness), FramesError> {
    let handedness = determined_handedness(files, frames.instrument);
    let mut instrument = frames.instrument.clone();
    instrument.mounting.handedness = handedness;
    let frames = Frames {
        instrument: &instrument,
        ..frames.clone()
    };
    let size_px = instrument.camera.size_px();
    let observed = each_frame(files.to_vec(), size_px, watch, |file, frame| {
        frames.observe(file, &frame, &mut frames.ephemeris.clone())
    })?;
    let (mut observations, mut rejected) = (Vec::new(), Vec::new());
    let (mut settings, mut missing) = (Vec::new(), Vec::new());
    for (file, outcome) in observed.frames {
        let outcome = match outcome {
            Ok(observed) => {
                let (setting, outcome) = observed?;
                settings.push(setting);
                outcome
            }
            Err(unread) => Err((Missing::Other, unread)),
        };
        match outcome {
            Ok(observation) => observations.push(observation),
            Err((fact, reason)) => {
                missing.push(fact);
                rejected.push(RejectedFrame::new(file, reason));
            }
        }
    }
    check_settings(&settings, frames.instrument)?;
    explain(&missing, &rejected, observations.len())?;
    rejected.extend(observed.copies);
    Ok((observations, rejected, handedness))
}

/// The reason why hardly any frame gave an observation, if most of them lack the same fact.
fn explain(
    missing: &[Missing],
    rejected: &[RejectedFrame],
    observations: usize,
) -> Result<(), FramesError> {
    /// With fewer observations an explanation is given.
    const FEW: usize = 5;
    let all = missing.len() + observations;
    let most = |fact: Missing| 2 * missing.iter().filter(|l| **l == fact).count() > all;
    let reason = match rejected.first() {
        _ if observations >= FEW => return Ok(()),
        _ if most(Missing::Time) => "frames without time: expected DATE-AVG or DATE-OBS in every frame, found none; take FITS frames with their UTC".into(),
        _ if most(Missing::Place) => "frames without place: expected OBSGEO-L, -B, -H in every frame, or --place LAT,LON,HEIGHT_M".into(),
        Some(first) if most(Missing::Pointing) => format!(
            "frames without pointing: expected pointings at the frames' times, found every frame outside them (the first is {})",
            first.reason
        ),
        _ if observations > 0 => return Ok(()),
        Some(first) => format!("no frame shows the Sun on the plate; the first, {first}"),
        None => "expected frames, found none".into(),
    };
    Err(FramesError::Missing(reason))
}

/// Handedness of the camera's view: the coded marks can be identified in one handedness only.
fn determined_handedness(files: &[PathBuf], instrument: &Instrument) -> Handedness {
    /// Number of frames that are tried.
    const SAMPLE: usize = 24;
    let stated = instrument.mounting.handedness;
    let other = stated.other();
    let step = files.len().div_ceil(SAMPLE).max(1);
    let sample: Vec<PathBuf> = files.iter().step_by(step).cloned().collect();
    let frames = sample.len();
    let size_px = instrument.camera.size_px();
    let fine_in = |frame: &Frame, handedness: Handedness| {
        let mut instrument = instrument.clone();
        instrument.mounting.handedness = handedness;
        let seen = instrument.seen_by(frame);
        seen.is_ok_and(|seen| solve(frame, &seen).quality == Quality::Fine)
    };
    let fine = sample.par_iter().filter_map(|file| {
        let frame = fits::read_frame_of_size(file, size_px).ok()?;
        Some([stated, other].map(|handedness| usize::from(fine_in(&frame, handedness))))
    });
    let [as_stated, as_other] = fine.reduce(|| [0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
    match 4 * as_stated < frames && as_other > 2 * as_stated {
        true => other,
        false => stated,
    }
}

fn solve(frame: &Frame, instrument: &Instrument) -> Solution {
    let expected = frame.info.mid_exposure.and_then(Expected::at);
    aspect::solve(frame, instrument, expected, None)
}

impl Frames<'_> {
    /// A frame's setting and observation. A frame of another size aborts the calibration: it is another instrument's.
    fn observe(
        &self,
        file: &Path,
        frame: &Frame,
        ephemeris: &mut Ephemeris,
    ) -> Result<(Setting, Result<SunObservation, Rejection>), FramesError> {
        let seen = self.instrument.seen_by(frame);
        let seen = seen.map_err(|wrong| FramesError::Size {
            file: file.into(),
            wrong,
        })?;
        let observation = self.sun(file, (frame, &seen), ephemeris);
        Ok((Setting::of(file, frame), observation))
    }

    fn sun(
        &self,
        file: &Path,
        (frame, seen): (&Frame, &Instrument),
        ephemeris: &mut Ephemeris,
    ) -> Result<SunObservation, Rejection> {
        let info = &frame.info;
        let utc = info.mid_exposure.ok_or((Missing::Time, "no time".into()))?;
        let place = info.place.or(self.place);
        let place = place.ok_or((Missing::Place, "no place".into()))?;
        let air = self.air.unwrap_or(Air::standard(place.height_m));
        let pointing = self.log.map(|log| log.at(utc)).transpose();
        let pointing = pointing.map_err(|reason| (Missing::Pointing, reason))?;
        let pointing = pointing.map(|p| if self.apparent { p } else { apparent(p, &air) });
        let sun = apparent_sun(ephemeris, utc, place, &air)
            .map_err(|error| (Missing::Other, error.to_string()))?;
        let solution = solve(frame, seen);
        let fine = solution.quality == Quality::Fine;
        let aspect = solution.aspect.filter(|_| fine).ok_or_else(|| {
            let why = solution.stopped.map(|stopped| stopped.to_string());
            (Missing::Other, why.unwrap_or("no Sun".into()))
        })?;
        Ok(SunObservation {
            file: file.into(),
            utc,
            sun_plate: aspect.sun_plate,
            sun,
            pointing,
        })
    }
}

/// Apparent direction, with refraction.
fn apparent(direction: Horizontal, air: &Air) -> Horizontal {
    Horizontal {
        elevation_deg: direction.elevation_deg + air.lift_deg(direction.elevation_deg),
        ..direction
    }
}

/// Apparent direction of the Sun, with refraction.
fn apparent_sun(
    ephemeris: &mut Ephemeris,
    utc: jiff::Timestamp,
    place: Place,
    air: &Air,
) -> Result<SunPosition, SkyError> {
    let sun = ephemeris.sun(utc, place)?;
    Ok(SunPosition {
        elevation_deg: sun.elevation_deg + air.lift_deg(sun.elevation_deg),
        ..sun
    })
}
