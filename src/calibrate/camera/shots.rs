//! Frames in memory, and what lights them.

use super::CameraError;
use crate::aspect::{self, Expected, Origin, Quality};
use crate::calibrate::frames::LeftOut;
use crate::fits;
use crate::frame::Frame;
use crate::instrument::Instrument;
use crate::units::SensorPx;
use anyhow::Context;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// So many frames of a kind are kept in memory, evenly chosen by pairs.
const MOST_KEPT: usize = 32;
/// Light scattered about the disc reaches so far beyond its limb, in its radii.
const GLOW_RADII: f64 = 1.5;

/// A frame and the part of it that the Sun lights.
#[derive(Debug, Clone)]
pub struct Shot {
    pub name: String,
    pub frame: Frame,
    /// The disc: centre and radius, px; none in a frame without Sun.
    pub disc: Option<(SensorPx, f64)>,
    /// Where the plate's marks are seen.
    pub marks: Vec<SensorPx>,
}

impl Shot {
    /// How far from the disc's centre, in its radii; none without a disc.
    pub fn radii(&self, x: usize, y: usize) -> Option<f64> {
        let (centre, radius) = self.disc?;
        Some(SensorPx::new(x as f64, y as f64).distance(centre) / radius)
    }

    /// Whether the Sun leaves a pixel dark.
    pub fn is_unlit(&self, x: usize, y: usize) -> bool {
        self.radii(x, y).is_none_or(|radii| radii > GLOW_RADII)
    }
}

/// Frames of one kind.
#[derive(Debug, Clone, Default)]
pub struct Shots {
    pub frames: Vec<Shot>,
}

impl Shots {
    /// Frames that follow each other, at equal exposure and gain: each in one pair at most.
    pub(super) fn pairs(&self) -> Vec<(&Shot, &Shot)> {
        let setting = |shot: &Shot| {
            let info = &shot.frame.info;
            (info.exposure, info.analogue_gain, info.preamp_gain)
        };
        let mut pairs = Vec::new();
        let mut rest = self.frames.iter().peekable();
        while let Some(shot) = rest.next() {
            if let Some(next) = rest.next_if(|next| setting(next) == setting(shot)) {
                pairs.push((shot, next));
            }
        }
        pairs
    }
}

/// What one frame of the Sun gave.
#[derive(Debug, Clone, PartialEq)]
pub struct SunShot {
    pub name: String,
    pub sun_px: SensorPx,
    /// The disc's bright part above the background.
    pub light_dn: f64,
    pub exposure_s: Option<f64>,
    /// Blur of the limb, 1 sigma.
    pub blur_px: Option<f64>,
    /// Of the frame's own marks.
    pub scale_mil_per_px: Option<f64>,
    pub temperature_c: Option<f64>,
}

/// Reads frames that show no Sun; those that cannot be read are listed.
///
/// # Errors
/// A frame of another size than the instrument's.
pub fn load(files: &[PathBuf], instrument: &Instrument) -> anyhow::Result<(Shots, Vec<LeftOut>)> {
    let (mut frames, mut left_out) = (Vec::new(), Vec::new());
    for file in kept(files) {
        let name = file.display().to_string();
        match fits::read_frame(file) {
            Ok(frame) => {
                check_size(&frame, instrument, &name)?;
                frames.push(Shot {
                    name,
                    frame,
                    disc: None,
                    marks: Vec::new(),
                });
            }
            Err(error) => left_out.push(LeftOut {
                name,
                reason: error.problem.to_string(),
            }),
        }
    }
    Ok((Shots { frames }, left_out))
}

/// Pixels are told by their place on the whole sensor: a part of it does not do.
fn check_size(frame: &Frame, instrument: &Instrument, name: &str) -> anyhow::Result<()> {
    let seen = instrument.seen_by(frame);
    let seen = seen.with_context(|| format!("mixed instruments: {name}"))?;
    let (width, height) = (instrument.camera.width_px, instrument.camera.height_px);
    anyhow::ensure!(
        seen.camera.width_px == width && seen.camera.height_px == height,
        "{name}: expected frames of the whole sensor, {width} x {height} px, found a part of it; take them without a region"
    );
    Ok(())
}

/// Some of the files, two and two that follow each other.
fn kept(files: &[PathBuf]) -> Vec<&PathBuf> {
    let pairs: Vec<&[PathBuf]> = files.chunks(2).collect();
    let step = files.len().div_ceil(MOST_KEPT).max(1);
    pairs.into_iter().step_by(step).flatten().collect()
}

/// Solves frames of the Sun, and keeps some of them whole.
///
/// # Errors
/// A frame of another size than the instrument's.
pub fn look(
    files: &[PathBuf],
    instrument: &Instrument,
) -> anyhow::Result<(Shots, Vec<SunShot>, Vec<LeftOut>)> {
    let keep: Vec<&PathBuf> = kept(files);
    let looked: Vec<_> = files
        .par_iter()
        .map(|file| look_at(file, instrument, keep.contains(&file)))
        .collect::<anyhow::Result<_>>()?;
    let (mut shots, mut suns, mut left_out) = (Shots::default(), Vec::new(), Vec::new());
    for (file, outcome) in files.iter().zip(looked) {
        match outcome {
            Ok((shot, sun)) => {
                shots.frames.extend(shot);
                suns.extend(sun);
            }
            Err(reason) => {
                let name = file.display().to_string();
                left_out.push(LeftOut { name, reason });
            }
        }
    }
    Ok((shots, suns, left_out))
}

type Looked = Result<(Option<Shot>, Option<SunShot>), String>;

fn look_at(file: &Path, instrument: &Instrument, keep: bool) -> anyhow::Result<Looked> {
    let name = file.display().to_string();
    let frame = match fits::read_frame(file) {
        Ok(frame) => frame,
        Err(error) => return Ok(Err(error.problem.to_string())),
    };
    check_size(&frame, instrument, &name)?;
    let expected = frame.info.mid_exposure.and_then(Expected::at);
    let solution = aspect::solve(&frame, instrument, expected, None);
    let Some(levels) = solution.levels else {
        // Nothing bright: a dark frame among the others.
        let (disc, marks) = (None, Vec::new());
        let shot = Shot {
            name,
            frame,
            disc,
            marks,
        };
        return Ok(Ok((keep.then_some(shot), None)));
    };
    let (Some(aspect), Some(adopted)) = (solution.aspect, solution.mapping) else {
        let why = solution.stopped.map_or("no Sun".into(), |s| s.to_string());
        return Ok(Err(why));
    };
    let own = adopted.origin == Origin::Frame;
    let fine = solution.quality == Quality::Fine;
    let sun_px = aspect.sun_px.position;
    let sun = SunShot {
        name: name.clone(),
        sun_px,
        light_dn: levels.disc_dn - levels.background_dn,
        exposure_s: frame.info.exposure.map(|e| e.as_secs_f64()),
        blur_px: solution.limb_blur_px.filter(|_| fine),
        scale_mil_per_px: own.then(|| adopted.mapping.scale_mil_per_px(sun_px)),
        temperature_c: frame.info.camera_temperature_c,
    };
    let marks = instrument
        .plate
        .marks()
        .map(|(_, at)| adopted.mapping.to_sensor(at));
    let shot = keep.then(|| Shot {
        name,
        marks: marks.collect(),
        disc: Some((sun_px, aspect.sun_radius_px)),
        frame,
    });
    Ok(Ok((shot, fine.then_some(sun))))
}

/// All frames must count in the same DN: of one camera, depth and gain.
pub(super) fn one_setting<'a>(shots: impl Iterator<Item = &'a Shot>) -> Result<(), CameraError> {
    let mut shots = shots.peekable();
    let Some(first) = shots.peek().map(|shot| (*shot).clone()) else {
        return Ok(());
    };
    for shot in shots {
        let (a, b) = (&first.frame, &shot.frame);
        if a.saturation_dn() != b.saturation_dn() {
            return Err(CameraError::MixedDepth {
                name: shot.name.clone(),
                expected_dn: a.saturation_dn(),
                found_dn: b.saturation_dn(),
            });
        }
        let different =
            |what, a: &dyn std::fmt::Debug, b: &dyn std::fmt::Debug| CameraError::Mixed {
                what,
                a: format!("{a:?}"),
                b: format!("{b:?}"),
            };
        let (a, b) = (&a.info, &b.info);
        if let (Some(a), Some(b)) = (&a.camera, &b.camera)
            && a != b
        {
            return Err(different("camera", a, b));
        }
        for (what, a, b) in [
            ("analogue gain", a.analogue_gain, b.analogue_gain),
            ("pre-amplifier gain", a.preamp_gain, b.preamp_gain),
        ] {
            if let (Some(a), Some(b)) = (a, b)
                && a != b
            {
                return Err(different(what, &a, &b));
            }
        }
    }
    Ok(())
}
