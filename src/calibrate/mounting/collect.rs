//! From frames to sights.

use super::log::PointingLog;
use super::observation::SunObservation;
use crate::aspect::{self, Expected, Quality, Solution};
use crate::calibrate::frames::LeftOut;
use crate::fits;
use crate::frame::Frame;
use crate::geometry::Handedness;
use crate::instrument::Instrument;
use crate::pointing::Horizontal;
use crate::sky::{Air, Ephemeris, SkyError, SunPosition};
use crate::units::Place;
use anyhow::{Context, bail, ensure};
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Frames from which the plate's handedness is told, where the stated one reads none.
const SAMPLE: usize = 24;

/// Fewer sights than this want an explanation.
const FEW: usize = 5;

/// What the frames are looked at with.
#[derive(Debug, Clone)]
pub struct Frames<'a> {
    pub instrument: &'a Instrument,
    /// Where the frames were taken, for those that do not say so.
    pub place: Option<Place>,
    /// Where the telescope pointed; none in a drift scan.
    pub log: Option<&'a PointingLog>,
    /// Whether the log's elevations hold refraction already, as a theodolite reads them.
    pub apparent: bool,
    /// The air about the observer; none for the standard atmosphere's at the place's height.
    pub air: Option<Air>,
    pub ephemeris: Ephemeris,
}

/// A frame's sight, or why it gives none.
enum Outcome {
    Sun(Box<SunObservation>),
    LeftOut(Lack, String),
}

/// What made a frame, as far as it says.
#[derive(Debug, Clone, Default)]
struct Maker {
    camera: Option<String>,
    /// The value at which its pixels saturate: that of 8 or of 12 bits.
    saturation_dn: Option<u16>,
}

/// What a frame lacks; where all of them lack the same, that is why there is no calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Lack {
    Time,
    Place,
    Pointing,
    Other,
}

/// Solves the frames and gathers their sights, in the order of the files, and tells which frames give none. The plate's
/// handedness is the instrument's, unless only the other reads the marks.
///
/// # Errors
/// Frames of several cameras, of another size than the instrument's, or all without what every one needs.
pub fn collect(
    files: &[PathBuf],
    frames: &Frames<'_>,
) -> anyhow::Result<(Vec<SunObservation>, Vec<LeftOut>, Handedness)> {
    let handedness = told_handedness(files, frames.instrument);
    let mut instrument = frames.instrument.clone();
    instrument.mounting.handedness = handedness;
    let frames = Frames {
        instrument: &instrument,
        ..frames.clone()
    };
    let outcomes: Vec<_> = files
        .par_iter()
        .map_with(frames.ephemeris.clone(), |ephemeris, file| {
            frames.look(file, ephemeris)
        })
        .collect::<anyhow::Result<_>>()?;
    one_instrument(&outcomes)?;
    let (mut sights, mut left_out, mut lacks) = (Vec::new(), Vec::new(), Vec::new());
    for (file, (_, outcome)) in files.iter().zip(outcomes) {
        match outcome {
            Outcome::Sun(sight) => sights.push(*sight),
            Outcome::LeftOut(lack, reason) => {
                lacks.push(lack);
                let name = file.display().to_string();
                left_out.push(LeftOut { name, reason });
            }
        }
    }
    if sights.len() < FEW {
        explain(&lacks, &left_out, sights.len())?;
    }
    Ok((sights, left_out, handedness))
}

/// Why hardly a frame gave a sight, where most of them lack the same.
fn explain(lacks: &[Lack], left_out: &[LeftOut], sights: usize) -> anyhow::Result<()> {
    let all = lacks.len() + sights;
    let most = |lack: Lack| 2 * lacks.iter().filter(|l| **l == lack).count() > all;
    if most(Lack::Time) {
        bail!(
            "frames without time: expected DATE-AVG or DATE-OBS in every frame, found none; take FITS frames with their UTC"
        );
    }
    if most(Lack::Place) {
        bail!(
            "frames without place: expected OBSGEO-L, -B, -H in every frame, or --place LAT,LON,HEIGHT_M"
        );
    }
    if most(Lack::Pointing) {
        let first = left_out.first().map_or("", |l| &l.reason);
        bail!(
            "frames without pointing: expected pointings at the frames' times, found every frame outside them (the first is {first})"
        );
    }
    match left_out.first() {
        _ if sights > 0 => Ok(()),
        Some(first) => bail!(
            "no frame shows the Sun on the plate; the first, {}: {}",
            first.name,
            first.reason
        ),
        None => bail!("expected frames, found none"),
    }
}

fn one_instrument(outcomes: &[(Maker, Outcome)]) -> anyhow::Result<()> {
    let cameras: BTreeSet<_> = outcomes
        .iter()
        .filter_map(|o| o.0.camera.as_ref())
        .collect();
    let names: Vec<&str> = cameras.iter().map(|c| c.as_str()).collect();
    let full: BTreeSet<_> = outcomes.iter().filter_map(|o| o.0.saturation_dn).collect();
    ensure!(
        full.len() < 2,
        "mixed instruments: expected frames that all saturate at one value, found {full:?} DN; give the frames of one camera and setting only"
    );
    ensure!(
        names.len() < 2,
        "mixed instruments: expected the frames of one camera, found those of \"{}\"; give each camera's frames with its own instrument",
        names.join("\" and \"")
    );
    Ok(())
}

/// How the camera sees the plate: the coded marks read one way only.
fn told_handedness(files: &[PathBuf], instrument: &Instrument) -> Handedness {
    let stated = instrument.mounting.handedness;
    let other = match stated {
        Handedness::Mirrored => Handedness::Direct,
        Handedness::Direct => Handedness::Mirrored,
    };
    let step = files.len().div_ceil(SAMPLE).max(1);
    let sample: Vec<_> = files.iter().step_by(step).collect();
    let read = |handedness: Handedness| {
        let mut instrument = instrument.clone();
        instrument.mounting.handedness = handedness;
        let fine = |file: &&&PathBuf| {
            let solved = fits::read_frame(file).ok().and_then(|frame| {
                let seen = instrument.seen_by(&frame).ok()?;
                Some(solve(&frame, &seen))
            });
            solved.is_some_and(|solution| solution.quality == Quality::Fine)
        };
        sample.par_iter().filter(fine).count()
    };
    let as_stated = read(stated);
    if 4 * as_stated < sample.len() && read(other) > 2 * as_stated {
        other
    } else {
        stated
    }
}

fn solve(frame: &Frame, instrument: &Instrument) -> Solution {
    let expected = frame.info.mid_exposure.and_then(Expected::at);
    aspect::solve(frame, instrument, expected, None)
}

impl Frames<'_> {
    /// A frame's maker and sight. A frame of another size ends it all: it is another instrument's.
    fn look(&self, file: &Path, ephemeris: &mut Ephemeris) -> anyhow::Result<(Maker, Outcome)> {
        let frame = match fits::read_frame(file) {
            Ok(frame) => frame,
            Err(error) => {
                return Ok((
                    Maker::default(),
                    Outcome::LeftOut(Lack::Other, error.problem.to_string()),
                ));
            }
        };
        let seen = self
            .instrument
            .seen_by(&frame)
            .with_context(|| format!("mixed instruments: {}", file.display()))?;
        let outcome = match self.sight(file, (&frame, &seen), ephemeris) {
            Ok(sight) => Outcome::Sun(Box::new(sight)),
            Err((lack, reason)) => Outcome::LeftOut(lack, reason),
        };
        let maker = Maker {
            saturation_dn: Some(frame.saturation_dn()),
            camera: frame.info.camera,
        };
        Ok((maker, outcome))
    }

    fn sight(
        &self,
        file: &Path,
        (frame, seen): (&Frame, &Instrument),
        ephemeris: &mut Ephemeris,
    ) -> Result<SunObservation, (Lack, String)> {
        let utc = frame
            .info
            .mid_exposure
            .ok_or((Lack::Time, "no time".into()))?;
        let place = frame
            .info
            .place
            .or(self.place)
            .ok_or((Lack::Place, "no place".into()))?;
        let air = self.air.unwrap_or(Air::standard(place.height_m));
        let pointing = self
            .log
            .map(|log| log.at(utc))
            .transpose()
            .map_err(|reason| (Lack::Pointing, reason))?;
        let pointing = pointing.map(|p| if self.apparent { p } else { lifted(p, &air) });
        let sun = seen_sun(ephemeris, utc, place, &air)
            .map_err(|error| (Lack::Other, error.to_string()))?;
        let solution = solve(frame, seen);
        let aspect = solution
            .aspect
            .filter(|_| solution.quality == Quality::Fine);
        let aspect = aspect.ok_or_else(|| {
            let why = solution
                .stopped
                .map_or("no Sun".into(), |stopped| stopped.to_string());
            (Lack::Other, why)
        })?;
        Ok(SunObservation {
            name: file.display().to_string(),
            utc,
            sun_plate: aspect.sun_plate,
            sun,
            pointing,
        })
    }
}

/// A direction as seen through the air.
fn lifted(direction: Horizontal, air: &Air) -> Horizontal {
    Horizontal {
        elevation_deg: direction.elevation_deg + air.lift_deg(direction.elevation_deg),
        ..direction
    }
}

/// The Sun as seen through the air.
pub(super) fn seen_sun(
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
