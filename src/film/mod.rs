//! A film of the telescope's pointing on the Sun.
//!
//! ```text
//! pointing history -> Track -> Painter (Panels, Context) -> pictures -> Writer
//! ```
//!
//! Each picture shows the Sun, north up and west to the right, as a [`Context`] image or limb-darkened, with the path up to its time, the
//! boresight and the target; below it a strip of text. If the path is small an inset magnifies the target's surroundings. The frame
//! nearest in time may be shown beside it.

mod context;
mod form;
mod panel;
mod picture;
#[cfg(test)]
mod tests;
mod track;
mod wcs;
mod writers;

pub use context::Context;
pub use form::{Destination, Form};

use crate::fits::FileError;
use crate::observe::Watch;
use crate::pointing::Target;
use crate::pointing_history::PointingHistory;
use crate::sky::{Ephemeris, SkyError};
use context::Words;
use image::RgbImage;
use jiff::Timestamp;
use picture::{Layout, Moment, Painter};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::PathBuf;
use track::Track;
use writers::Writer;

/// Approximate number of pictures of a film without a stated step.
const PICTURES: f64 = 300.0;
/// Least time between pictures.
pub const LEAST_STEP_S: f64 = 0.01;
/// Number of frames read and solved at a time, for each thread.
const TOGETHER: usize = 4;

/// Settings of a film.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    pub destination: Destination,
    /// Time between pictures, at least [`LEAST_STEP_S`]; by default such that there are about 300, and no more than frames.
    pub step_s: Option<f64>,
    /// A solar image with helioprojective coordinates; by default a limb-darkened disc.
    pub context: Option<PathBuf>,
    /// Whether the frame nearest in time is shown beside the map.
    pub has_frames: bool,
}

/// A film that can be made.
#[derive(Debug)]
pub struct Film {
    options: Options,
    context: Option<Context>,
}

/// Frames of a flight in the order of time.
pub trait Frames: Sync {
    /// The frame nearest to a time, s since 1970, if it is within `within_s`.
    fn nearest(&self, unix_s: f64, within_s: f64) -> Option<usize>;

    /// The picture of a frame with its results.
    ///
    /// # Errors
    /// The reason why there is none, in words.
    fn overlay(&self, frame: usize) -> Result<RgbImage, String>;
}

/// Inputs of a film.
pub struct Flight<'a> {
    pub title: String,
    /// Name that distinguishes its camera; none for a single one.
    pub label: Option<&'a str>,
    pub pointing: &'a PointingHistory,
    pub target: Target,
    pub ephemeris: Ephemeris,
    /// Time between frames.
    pub frame_step_s: f64,
    pub frames: &'a dyn Frames,
}

/// A film that was made.
#[derive(Debug, Clone, PartialEq)]
pub struct Made {
    pub path: PathBuf,
    pub pictures: usize,
    pub step_s: f64,
}

impl fmt::Display for Made {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            path,
            pictures,
            step_s,
        } = self;
        let path = path.display();
        write!(
            out,
            "film: {pictures} pictures, one each {step_s:.3} s: {path}"
        )
    }
}

/// Reasons for which there is no film.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    #[error(transparent)]
    File(#[from] FileError),
    #[error(transparent)]
    Sky(#[from] SkyError),
    #[error("cancelled: there is no film; what was refined is whole, run again to make it")]
    Cancelled,
}

impl Film {
    /// Reads the inputs of a film other than the flight.
    ///
    /// # Errors
    /// If the context is no solar image, or has an observer far from the Earth.
    pub fn new(options: &Options) -> Result<Self, FileError> {
        let context = options.context.as_deref().map(Context::read);
        Ok(Self {
            options: options.clone(),
            context: context.transpose()?,
        })
    }

    /// Makes the film of a flight; `None` if its pointing is not known at any time.
    ///
    /// # Errors
    /// If a file cannot be written, a date is before the table of Earth orientation, or the watch cancels: there is no film then.
    pub fn make(
        &self,
        flight: &mut Flight<'_>,
        watch: &dyn Watch,
    ) -> Result<Option<Made>, FilmError> {
        let ends_s = flight.pointing.ends_s();
        let all_s = ends_s.map_or(0.0, |[first, last]| last - first);
        let default_s = || (all_s / PICTURES).max(flight.frame_step_s);
        let step_s = self.options.step_s.unwrap_or_else(default_s);
        let step_s = step_s.max(LEAST_STEP_S);
        let Some(track) = Track::of(flight.pointing, step_s) else {
            tracing::warn!("there is no film: nothing is known of where the telescope pointed");
            return Ok(None);
        };
        let layout = self.layout(&track, flight)?;
        let destination = match flight.label {
            Some(label) => self.options.destination.of_camera(label),
            None => self.options.destination.clone(),
        };
        let pictures = track.pictures();
        let mut painter = Painter::new(&track, layout);
        let mut writer = Writer::begin(&destination, painter.size_px(), pictures)?;
        let mut frames = FramePictures {
            within_s: step_s.max(2.0 * flight.frame_step_s),
            shown: BTreeMap::new(),
        };
        watch.begin(pictures, "pictures");
        let together = TOGETHER * rayon::current_num_threads();
        for first in (0..pictures).step_by(together) {
            let some = first..pictures.min(first + together);
            if self.options.has_frames {
                let times_s = some
                    .clone()
                    .map(|n| track.points[track.at_picture(n)].unix_s);
                frames.prepare(times_s, flight.frames, &painter);
            }
            for number in some {
                if watch.is_cancelled() {
                    return Err(FilmError::Cancelled);
                }
                let moment = moment(track.at_picture(number), &track, flight)?;
                let unix_s = track.points[moment.index].unix_s;
                let frame = frames.frame(unix_s, flight.frames);
                let picture = painter.picture(&track, &moment, frame);
                writer.add(&picture)?;
                watch.step();
            }
        }
        writer.finish()?;
        watch.end();
        Ok(Some(Made {
            path: destination.path,
            pictures,
            step_s,
        }))
    }

    /// Elements common to all pictures; warns of a misleading context.
    fn layout(&self, track: &Track, flight: &mut Flight<'_>) -> Result<Layout<'_>, SkyError> {
        let utc = timestamp(track.middle_s());
        let disc = flight.ephemeris.disc(utc)?;
        let plain = || Words {
            text: "a limb-darkened disc".into(),
            is_warning: false,
        };
        let words = self.context.as_ref().map(|context| context.words(utc));
        if let Some((context, words)) = self.context.as_ref().zip(words.as_ref())
            && words.is_warning
        {
            tracing::warn!(
                "{}: {}: features may have been elsewhere",
                context.path().display(),
                words.text
            );
        }
        Ok(Layout {
            title: flight.title.clone(),
            disc,
            target: flight.target.on_disc(utc, &disc).ok(),
            context: self.context.as_ref(),
            words: words.unwrap_or_else(plain),
            shows_frame: self.options.has_frames,
        })
    }
}

/// Time and target of a picture.
fn moment(index: usize, track: &Track, flight: &mut Flight<'_>) -> Result<Moment, SkyError> {
    let utc = timestamp(track.points[index].unix_s);
    let disc = flight.ephemeris.disc(utc)?;
    let target = flight.target.on_disc(utc, &disc);
    Ok(Moment {
        index,
        utc,
        target: target.map_err(|why| why.to_string()),
    })
}

/// Rounds to a millisecond: times in seconds since 1970 are not more accurate.
fn timestamp(unix_s: f64) -> Timestamp {
    let ms = (unix_s * 1e3).round() as i64;
    Timestamp::from_millisecond(ms).unwrap_or_default()
}

/// The frames' pictures beside the map.
struct FramePictures {
    within_s: f64,
    shown: BTreeMap<Option<usize>, RgbImage>,
}

impl FramePictures {
    /// Solves the frames needed for pictures at these times, and drops others.
    fn prepare(
        &mut self,
        times_s: impl Iterator<Item = f64>,
        frames: &dyn Frames,
        painter: &Painter<'_>,
    ) {
        let nearest = times_s.map(|unix_s| frames.nearest(unix_s, self.within_s));
        let wanted: BTreeSet<Option<usize>> = nearest.collect();
        self.shown.retain(|frame, _| wanted.contains(frame));
        let missing = wanted
            .into_iter()
            .filter(|frame| !self.shown.contains_key(frame));
        let missing: Vec<Option<usize>> = missing.collect();
        let overlay = |frame: Option<usize>| {
            let none = || Err(format!("no frame within {:.1} s", self.within_s));
            let picture = frame.map_or_else(none, |frame| frames.overlay(frame));
            (frame, painter.frame(picture))
        };
        let new: Vec<_> = missing.into_par_iter().map(overlay).collect();
        self.shown.extend(new);
    }

    fn frame(&self, unix_s: f64, frames: &dyn Frames) -> Option<&RgbImage> {
        if self.shown.is_empty() {
            return None;
        }
        self.shown.get(&frames.nearest(unix_s, self.within_s))
    }
}
