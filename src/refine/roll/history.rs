//! The body's roll and pitch over the flight.

use super::super::cameras::CameraFrames;
use super::super::first_pass::{Done, Span};
use super::super::follow::ODD_PATH_CHI2;
use super::super::inputs::{InputNotes, InputSummary};
use super::super::journal::JournalError;
use super::super::oddity::Oddity;
use super::super::record::{Grade, Record};
use super::super::row::Row;
use super::super::times::{Stamp, Times};
use super::path::{RollPath, Seen, changing};
use super::row::{RollRow, SmoothedRoll};
use super::{HorizonRecord, RollRecipe};
use crate::geometry::attitude::Direction;
use crate::pointing::body_nadir;
use crate::units::Measured;
use rayon::prelude::*;

/// The body's roll and pitch over the flight.
#[derive(Debug, Clone)]
pub struct RollHistory {
    /// In the order of time; frames without a time and files that could not be read come last, by name.
    pub rows: Vec<RollRow>,
    /// How many rows have a time: the first ones.
    pub dated: usize,
    /// Which part of the stated sigmas changes from frame to frame, of roll and pitch. The rest is the limb's own shape and the camera's
    /// height, alike in neighbours.
    pub changing: [f64; 2],
    /// What of the files was not used as it stands.
    pub inputs: InputSummary,
    max_age_s: f64,
    path: Option<RollPath>,
}

/// The body at times, s since 1970 and in order.
fn smoothed(path: Option<&RollPath>, times_s: &[f64]) -> Vec<Option<SmoothedRoll>> {
    path.map_or_else(|| vec![None; times_s.len()], |path| path.at(times_s))
}

impl RollHistory {
    /// The history of all frames that are done.
    ///
    /// # Errors
    /// A journal that cannot be read.
    pub fn new(
        done: &Done<HorizonRecord>,
        camera: &CameraFrames,
        recipe: &RollRecipe,
        span: &Span,
    ) -> Result<Self, JournalError> {
        let records = camera.inputs.par_iter().map(|input| done.record(input));
        let records: Vec<Option<Record<HorizonRecord>>> = records.collect::<Result<_, _>>()?;
        let mut notes = InputNotes::default();
        let mut rows = Vec::with_capacity(records.len());
        for Record { input, outcome } in records.into_iter().flatten() {
            match outcome {
                Ok(record) if !span.holds(record.facts.utc()) => {}
                Ok(record) => {
                    notes.read(&input.file, &record.facts);
                    rows.push(RollRow::of(input, record));
                }
                Err(error) => {
                    notes.unreadable(&error);
                    rows.push(RollRow::unread(input, &error));
                }
            }
        }
        rows.extend(notes.copies(&camera.copies, span).map(RollRow::copied));
        let history = Self::of(rows, recipe.settings.max_age_s);
        Ok(Self {
            inputs: notes.finish(),
            ..history
        })
    }

    fn of(mut rows: Vec<RollRow>, max_age_s: f64) -> Self {
        correct_times(&mut rows);
        let key = |row: &RollRow| (row.facts.utc_ns.is_none(), row.facts.utc_ns);
        rows.sort_by(|a, b| key(a).cmp(&key(b)).then_with(|| a.file.cmp(&b.file)));
        let dated = rows.partition_point(|row| row.facts.utc_ns.is_some());
        let mut history = Self {
            changing: changing(&rows[..dated]),
            rows,
            dated,
            inputs: InputSummary::default(),
            max_age_s,
            path: None,
        };
        history.refuse_what_is_off();
        history.smooth();
        history
    }

    /// Takes the place of coarse frames away that lie off the path of the fine ones.
    fn refuse_what_is_off(&mut self) {
        let is_coarse = |row: &RollRow| row.quality == Grade::Coarse && row.nadir.is_some();
        let coarse: Vec<usize> = (0..self.dated)
            .filter(|n| is_coarse(&self.rows[*n]))
            .collect();
        if coarse.is_empty() {
            return;
        }
        let times: Vec<f64> = coarse
            .iter()
            .filter_map(|n| self.rows[*n].unix_s())
            .collect();
        let by_fine = self.path(|row| row.quality == Grade::Fine);
        let by_fine = smoothed(by_fine.as_ref(), &times);
        for (n, expected) in coarse.into_iter().zip(by_fine) {
            let row = &mut self.rows[n];
            let Some((expected, [roll, pitch])) = expected.zip(row.angles_deg()) else {
                continue;
            };
            let chi2 = |found: Measured, expected: Measured| {
                let sigma = found.sigma.hypot(expected.sigma);
                ((found.value - expected.value) / sigma).powi(2)
            };
            if chi2(roll, expected.roll_deg) + chi2(pitch, expected.pitch_deg) > ODD_PATH_CHI2 {
                row.quality = Grade::None;
                row.nadir = None;
                row.reason = format!("refine: {}", Oddity::Path);
            }
        }
    }

    fn smooth(&mut self) {
        let rows = &self.rows[..self.dated];
        let times: Vec<f64> = rows.iter().filter_map(RollRow::unix_s).collect();
        self.path = self.path(|_| true);
        let smoothed = smoothed(self.path.as_ref(), &times);
        for (row, smoothed) in self.rows.iter_mut().zip(smoothed) {
            row.smoothed = smoothed;
        }
    }

    /// Tells rows of a camera that sees the plate where straight down was in the body's axes when they were taken.
    pub fn fill(&self, rows: &mut [Row]) {
        let of_row = rows.iter().enumerate();
        let dated: Vec<(usize, f64)> = of_row
            .filter_map(|(n, row)| Some((n, row.unix_s()?)))
            .collect();
        let times: Vec<f64> = dated.iter().map(|(_, time_s)| *time_s).collect();
        for ((n, _), nadir) in dated.iter().zip(self.body_nadirs(&times)) {
            rows[*n].body_nadir = nadir;
        }
    }

    /// Straight down in the body's axes at times, s since 1970 and in order; `None` where no frame is near.
    pub fn body_nadirs(&self, times_s: &[f64]) -> Vec<Option<Direction>> {
        let nadir = |s: SmoothedRoll| body_nadir(s.roll_deg, s.pitch_deg);
        let smoothed = smoothed(self.path.as_ref(), times_s).into_iter();
        smoothed.map(|smoothed| smoothed.map(nadir)).collect()
    }

    /// The path through the frames that count; `None` where these tell none.
    fn path(&self, counts: impl Fn(&RollRow) -> bool) -> Option<RollPath> {
        let rows = self.rows[..self.dated].iter();
        let seen = rows.filter(|row| counts(row)).filter_map(Seen::of);
        RollPath::through(seen.collect(), self.changing, self.max_age_s)
    }
}

/// Holds the frames' times against the monotonic clock, their numbers and each other.
fn correct_times(rows: &mut [RollRow]) {
    let place = |row: &RollRow| row.angles_deg().map(|angles| angles.map(|a| a.value));
    let stamps = rows.iter().map(|row| Stamp::of(&row.facts, place(row)));
    let Times { timings, .. } = Times::of(&stamps.collect::<Vec<Stamp>>());
    for (row, timing) in rows.iter_mut().zip(timings) {
        row.facts.utc_ns = timing.utc_ns(row.facts.utc_ns);
        row.utc_correction_s = timing.correction_s;
        row.time_sigma_s = timing.sigma_s;
        row.odd_time = timing.odd;
    }
}

#[cfg(test)]
mod tests {
    use super::super::path::LEAST_CHANGING;
    use super::*;
    use crate::archive::StoredFile;

    /// A fine frame, four a second.
    fn fine(number: u32, roll_deg: f64) -> RollRow {
        let input = StoredFile {
            file: format!("roll_{number:04}.fits"),
            bytes: 0,
            written_ns: 0,
        };
        let [roll, pitch] = [roll_deg, 1.0].map(|deg| Measured::new(deg, 0.01));
        let mut row = RollRow {
            quality: Grade::Fine,
            nadir: Some(body_nadir(roll, pitch)),
            ..RollRow::unread(input, "")
        };
        row.facts.utc_ns = Some(i64::from(number) * 250_000_000);
        row
    }

    #[test]
    fn a_camera_that_repeats_a_picture_still_has_a_smoothed_roll() {
        let stuck = (0..200).map(|number| fine(number, 2.0));
        let swings =
            (200..300).map(|number| fine(number, 2.0 + (f64::from(number - 200) / 9.0).sin()));
        let history = RollHistory::of(stuck.chain(swings).collect(), 1.0);
        assert_eq!(history.changing, [LEAST_CHANGING; 2]);
        for row in &history.rows {
            let roll = row.smoothed.unwrap().roll_deg;
            let own = row.angles_deg().unwrap()[0];
            assert!((roll.value - own.value).abs() < 0.01, "{row:?}");
            assert!(roll.sigma > 0.0099, "{row:?}");
        }
    }
}
