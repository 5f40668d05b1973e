//! Frames in memory, and their illumination.

use crate::aspect::{self, Expected, Quality};
use crate::calibrate::frames::{FramesError, Setting};
use crate::frame::Frame;
use crate::instrument::Instrument;
use crate::observe::{RejectedFrame, Watch, each_frame};
use crate::units::SensorPx;
use std::path::{Path, PathBuf};

/// Radius of the light scattered around the disc, in radii of its limb.
const GLOW_RADII: f64 = 1.5;

/// A frame and the part of it illuminated by the Sun.
#[derive(Debug, Clone)]
pub struct Shot {
    pub file: PathBuf,
    pub frame: Frame,
    /// The disc: centre and radius, px; none in a frame without Sun.
    pub disc: Option<(SensorPx, f64)>,
    /// Sensor positions of the plate's marks.
    pub marks: Vec<SensorPx>,
}

impl Shot {
    fn without_sun(file: &Path, frame: Frame) -> Self {
        Self {
            file: file.into(),
            frame,
            disc: None,
            marks: Vec::new(),
        }
    }

    /// Frames of different gain have different DN for the same light.
    pub(super) fn setting(&self) -> Setting {
        Setting::of(&self.file, &self.frame).with_gains(&self.frame)
    }

    /// Distance from the disc's centre, in its radii; none without a disc.
    pub fn radii(&self, x: usize, y: usize) -> Option<f64> {
        let (centre, radius) = self.disc?;
        Some(SensorPx::new(x as f64, y as f64).distance(centre) / radius)
    }

    /// Whether a pixel is not illuminated by the Sun.
    pub fn is_unlit(&self, x: usize, y: usize) -> bool {
        self.radii(x, y).is_none_or(|radii| radii > GLOW_RADII)
    }
}

/// Side of the squares in which light and noise are measured, px.
pub(super) const TILE_PX: usize = 32;

/// The squares of a frame: column and row of their first pixel.
pub(super) fn tiles(frame: &Frame) -> impl Iterator<Item = (usize, usize)> + use<> {
    let last = |pixels: usize| pixels - pixels % TILE_PX;
    let (right, bottom) = (last(frame.width()), last(frame.height()));
    let rows = (0..bottom).step_by(TILE_PX);
    rows.flat_map(move |y| (0..right).step_by(TILE_PX).map(move |x| (x, y)))
}

/// Columns and rows of a square, every n-th pixel in both axes.
pub(super) fn inside(
    (x0, y0): (usize, usize),
    step: usize,
) -> impl Iterator<Item = (usize, usize)> {
    let rows = (y0..y0 + TILE_PX).step_by(step);
    rows.flat_map(move |y| (x0..x0 + TILE_PX).step_by(step).map(move |x| (x, y)))
}

/// Frames of one kind.
#[derive(Debug, Clone, Default)]
pub struct Shots {
    pub frames: Vec<Shot>,
}

impl Shots {
    /// Pairs of successive frames of equal exposure and gain; each frame is in at most one pair.
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

/// Result of one frame of the Sun.
#[derive(Debug, Clone, PartialEq)]
pub struct SunShot {
    pub sun_px: SensorPx,
    /// Level of the disc's bright part above the background.
    pub light_dn: f64,
    /// Blur of the limb, 1 sigma.
    pub blur_px: Option<f64>,
    /// Scale from the frame's own marks.
    pub scale_mil_per_px: Option<f64>,
    pub temperature_c: Option<f64>,
}

/// Reads a selection of frames without Sun; unreadable ones are rejected.
///
/// # Errors
/// If a frame is of another size than the instrument's.
pub fn load(
    files: &[PathBuf],
    instrument: &Instrument,
    watch: &dyn Watch,
) -> Result<(Shots, Vec<RejectedFrame>), FramesError> {
    let keep = kept(files);
    let size_px = instrument.camera.size_px();
    let observed = each_frame(files.to_vec(), size_px, watch, |file, frame| {
        let is_kept = keep.iter().any(|kept| *kept == file);
        let check = check_size(&frame, instrument, file);
        check.map(|()| is_kept.then(|| Shot::without_sun(file, frame)))
    })?;
    let (mut frames, mut rejected) = (Vec::new(), observed.copies);
    for (file, outcome) in observed.frames {
        match outcome {
            Ok(shot) => frames.extend(shot?),
            Err(unread) => rejected.push(RejectedFrame::new(file, unread)),
        }
    }
    Ok((Shots { frames }, rejected))
}

/// Requires the whole sensor: pixels are identified by their position on it.
fn check_size(frame: &Frame, instrument: &Instrument, file: &Path) -> Result<(), FramesError> {
    let (file, size_px) = (file.to_owned(), instrument.camera.size_px());
    match instrument.seen_by(frame) {
        Err(wrong) => Err(FramesError::Size { file, wrong }),
        Ok(seen) if seen.camera.size_px() != size_px => Err(FramesError::Region { file, size_px }),
        Ok(_) => Ok(()),
    }
}

/// The files whose frames are kept in memory: evenly selected pairs of successive frames.
fn kept(files: &[PathBuf]) -> Vec<&PathBuf> {
    const MOST_KEPT: usize = 32;
    let step = files.len().div_ceil(MOST_KEPT).max(1);
    files.chunks(2).step_by(step).flatten().collect()
}

/// Solves frames of the Sun, and keeps the pixels of some of them.
///
/// # Errors
/// If a frame is of another size than the instrument's.
pub fn solve(
    files: &[PathBuf],
    instrument: &Instrument,
    watch: &dyn Watch,
) -> Result<(Shots, Vec<SunShot>, Vec<RejectedFrame>), FramesError> {
    let keep = kept(files);
    let size_px = instrument.camera.size_px();
    let observed = each_frame(files.to_vec(), size_px, watch, |file, frame| {
        let is_kept = keep.iter().any(|kept| *kept == file);
        check_size(&frame, instrument, file).map(|()| solve_one(file, frame, instrument, is_kept))
    })?;
    let (mut shots, mut suns, mut rejected) = (Shots::default(), Vec::new(), observed.copies);
    for (file, outcome) in observed.frames {
        match outcome.unwrap_or_else(|unread| Ok(Err(unread)))? {
            Ok((shot, sun)) => {
                shots.frames.extend(shot);
                suns.extend(sun);
            }
            Err(reason) => rejected.push(RejectedFrame::new(file, reason)),
        }
    }
    Ok((shots, suns, rejected))
}

/// A frame of the Sun, with its pixels if it is kept, and its results; else the reason why it is rejected.
type Solved = Result<(Option<Shot>, Option<SunShot>), String>;

fn solve_one(file: &Path, frame: Frame, instrument: &Instrument, keep: bool) -> Solved {
    let expected = frame.info.mid_exposure.and_then(Expected::at);
    let solution = aspect::solve(&frame, instrument, expected, None);
    let Some(levels) = solution.levels else {
        // Nothing bright: a dark frame among the others.
        return Ok((keep.then(|| Shot::without_sun(file, frame)), None));
    };
    let (Some(aspect), Some(adopted)) = (solution.aspect, solution.mapping) else {
        let why = solution.stopped.map_or("no Sun".into(), |s| s.to_string());
        return Err(why);
    };
    let fine = solution.quality == Quality::Fine;
    let sun_px = aspect.sun_px.position;
    let sun = SunShot {
        sun_px,
        light_dn: levels.disc_dn - levels.background_dn,
        blur_px: solution.limb_blur_px.filter(|_| fine),
        scale_mil_per_px: adopted
            .own()
            .map(|own| own.mapping.scale_mil_per_px(sun_px)),
        temperature_c: frame.info.camera_temperature_c,
    };
    let marks = instrument.plate.marks();
    let shot = keep.then(|| Shot {
        marks: marks
            .map(|(_, at)| adopted.mapping().to_sensor(at))
            .collect(),
        disc: Some((sun_px, aspect.sun_radius_px.value)),
        ..Shot::without_sun(file, frame)
    });
    Ok((shot, fine.then_some(sun)))
}
