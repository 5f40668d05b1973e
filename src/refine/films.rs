//! The film of a camera's history.

use super::history::History;
use crate::archive::ArchiveReader;
use crate::aspect::{self, Expected};
use crate::estimation::median;
use crate::film::{Film, FilmError, Flight, Frames, Made};
use crate::observe::Watch;
use crate::pointing_history::PointingHistory;
use crate::report::overlay;
use image::RgbImage;

/// Makes the film of a history; `label` distinguishes its camera.
///
/// # Errors
/// As [`Film::make`].
pub fn make_film(
    film: &Film,
    label: Option<&str>,
    (history, pointing): (&History, &PointingHistory),
    archive: &ArchiveReader,
    watch: &dyn Watch,
) -> Result<Option<Made>, FilmError> {
    let frames = HistoryFrames {
        archive,
        history,
        times_s: history.frame_times_s().collect(),
    };
    let steps_s = frames.times_s.windows(2).map(|times| times[1] - times[0]);
    let name = &history.instrument().name;
    let mut flight = Flight {
        title: label.unwrap_or(name).to_owned(),
        label,
        pointing,
        target: history.sky().target,
        ephemeris: history.sky().ephemeris.clone(),
        frame_step_s: median(steps_s).unwrap_or(0.0),
        frames: &frames,
    };
    film.make(&mut flight, watch)
}

/// The dated frames of a history and its archive.
struct HistoryFrames<'a> {
    archive: &'a ArchiveReader,
    history: &'a History,
    times_s: Vec<f64>,
}

impl Frames for HistoryFrames<'_> {
    fn nearest(&self, unix_s: f64, within_s: f64) -> Option<usize> {
        let next = self.times_s.partition_point(|time_s| *time_s < unix_s);
        let away_s = |n: &usize| (self.times_s[*n] - unix_s).abs();
        let around = next.saturating_sub(1)..self.times_s.len().min(next + 1);
        let nearest = around.min_by(|a, b| away_s(a).total_cmp(&away_s(b)));
        nearest.filter(|n| away_s(n) <= within_s)
    }

    /// Solves the frame again by itself: the journal has no pixels.
    fn overlay(&self, frame: usize) -> Result<RgbImage, String> {
        let file = self.history.file(frame).map_err(|why| why.to_string())?;
        let recipe = self.history.recipe();
        let instrument = &recipe.instrument;
        let stored = self.archive.open_file(&file);
        let read = stored.and_then(|stored| stored.of_size(instrument.camera.size_px()).frame());
        let frame = read.map_err(|why| format!("{file}: {}", why.problem))?;
        let size = instrument.check_size(&frame);
        size.map_err(|why| format!("{file}: {why}"))?;
        let expected = frame.info.mid_exposure.and_then(Expected::at);
        let solution = aspect::solve_with(&recipe.settings, &frame, instrument, expected, None);
        Ok(overlay(&frame, &solution, instrument, &file))
    }
}
