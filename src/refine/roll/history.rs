//! The body's roll and pitch over the flight.

use super::super::cameras::CameraFrames;
use super::super::first_pass::{Done, Span};
use super::super::follow::ODD_PATH_CHI2;
use super::super::inputs::{InputNotes, InputSummary};
use super::super::journal::JournalError;
use super::super::motion::{self, Measurement, Moment, Path, SharedErrors};
use super::super::oddity::Oddity;
use super::super::record::{Grade, Record};
use super::super::row::Row;
use super::super::times::{Stamp, Times};
use super::row::{RollRow, SmoothedRoll};
use super::{HorizonRecord, RollRecipe};
use crate::estimation::{SIGMA_PER_MEDIAN, median};
use crate::geometry::attitude::Direction;
use crate::pointing::body_nadir;
use crate::units::Measured;
use rayon::prelude::*;

/// What the path counts in: about the error of a frame.
const UNIT_DEG: f64 = 0.01;
/// A roll known worse than this, 1 sigma, is not told.
const MOST_SIGMA_DEG: f64 = 0.5;
/// Fewer differences of neighbours tell nothing, nor do frames of which one step is so many times another.
const LEAST_DIFFERENCES: usize = 20;
const EVEN_STEPS: f64 = 1.5;
/// At least this part of the stated sigmas changes from frame to frame: a camera that repeats a picture has differences of 0, and a path
/// through frames without an error cannot be found.
const LEAST_CHANGING: f64 = 0.05;

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
        let times: Vec<f64> = coarse
            .iter()
            .filter_map(|n| self.rows[*n].unix_s())
            .collect();
        let by_fine = self.smoothed_at(&times, |row| row.quality == Grade::Fine);
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
        let smoothed = self.smoothed_at(&times, |_| true);
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
        let smoothed = self.smoothed_at(times_s, |_| true).into_iter();
        smoothed.map(|smoothed| smoothed.map(nadir)).collect()
    }

    /// The body at times, s since 1970 and in order, by the frames that count; `None` where none of these is near.
    fn smoothed_at(
        &self,
        times_s: &[f64],
        counts: impl Fn(&RollRow) -> bool,
    ) -> Vec<Option<SmoothedRoll>> {
        let measured: Vec<Seen> = self.rows[..self.dated]
            .iter()
            .filter(|row| counts(row))
            .filter_map(Seen::of)
            .collect();
        let (moments, at) = self.moments(&measured, times_s);
        let Some(path) = motion::path(&moments, &SharedErrors::default()) else {
            return vec![None; times_s.len()];
        };
        let point = |(time_s, at): (&f64, usize)| {
            let nearest = Seen::nearest(&measured, *time_s)?;
            let near = (nearest.time_s - time_s).abs() <= self.max_age_s;
            let smoothed = self.smoothed(&path, at, nearest);
            let known = smoothed.roll_deg.sigma < MOST_SIGMA_DEG;
            (near && known).then_some(smoothed)
        };
        times_s.iter().zip(at).map(point).collect()
    }

    /// Frames and times together, in the order of time, and where each of the times stands.
    fn moments(&self, measured: &[Seen], times_s: &[f64]) -> (Vec<Moment>, Vec<usize>) {
        let first_s = measured.first().map_or(0.0, |seen| seen.time_s);
        let mut moments = Vec::with_capacity(measured.len() + times_s.len());
        let frame = |seen: &Seen| {
            let axis = |axis: usize| {
                let sigma = seen.angles_deg[axis].sigma * self.changing[axis];
                Measurement {
                    place: seen.angles_deg[axis].value / UNIT_DEG,
                    variance: (sigma / UNIT_DEG).powi(2),
                    shared_variance: 0.0,
                }
            };
            Moment {
                time_s: seen.time_s - first_s,
                time_sigma_s: seen.time_sigma_s,
                measured: Some([axis(0), axis(1)]),
            }
        };
        let (mut next, mut at) = (measured.iter().peekable(), Vec::new());
        for time_s in times_s {
            while let Some(seen) = next.next_if(|seen| seen.time_s <= *time_s) {
                moments.push(frame(seen));
            }
            at.push(moments.len());
            moments.push(Moment {
                time_s: time_s - first_s,
                time_sigma_s: 0.0,
                measured: None,
            });
        }
        moments.extend(next.map(frame));
        (moments, at)
    }

    /// A point of the path, with the errors that are alike in neighbours.
    fn smoothed(&self, path: &Path, at: usize, nearest: &Seen) -> SmoothedRoll {
        let point = &path.points[at];
        let angle = |axis: usize| {
            let changing = point.variance[axis].max(0.0).sqrt() * UNIT_DEG;
            let alike = (1.0 - self.changing[axis].powi(2)).max(0.0).sqrt();
            let sigma = changing.hypot(nearest.angles_deg[axis].sigma * alike);
            Measured::new(point.place[axis] * UNIT_DEG, sigma)
        };
        SmoothedRoll {
            roll_deg: angle(0),
            pitch_deg: angle(1),
            rates_deg_per_s: point.speed.map(|speed| speed * UNIT_DEG),
        }
    }
}

/// A frame that tells roll and pitch.
struct Seen {
    time_s: f64,
    time_sigma_s: f64,
    angles_deg: [Measured; 2],
}

impl Seen {
    fn of(row: &RollRow) -> Option<Self> {
        let is_of_path = row.odd_time.is_none_or(Oddity::is_of_path);
        Some(Self {
            time_s: row.unix_s().filter(|_| is_of_path)?,
            time_sigma_s: row.time_sigma_s.unwrap_or(0.0),
            angles_deg: row.angles_deg()?,
        })
    }

    fn nearest(all: &[Self], time_s: f64) -> Option<&Self> {
        let next = all.partition_point(|seen| seen.time_s < time_s);
        let both = [next.checked_sub(1), Some(next)];
        let both = both.into_iter().flatten().filter_map(|n| all.get(n));
        let away = |seen: &&Self| (seen.time_s - time_s).abs();
        both.min_by(|a, b| away(a).total_cmp(&away(b)))
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

/// Which part of the stated sigmas changes from frame to frame, of roll and pitch: third differences tell, in which slow motion is
/// nothing. All of it, where too few frames tell or the motion is too fast.
fn changing(rows: &[RollRow]) -> [f64; 2] {
    let seen: Vec<Seen> = rows.iter().filter_map(Seen::of).collect();
    let evenly = |four: &&[Seen]| {
        let steps = four.windows(2).map(|pair| pair[1].time_s - pair[0].time_s);
        let (least, most) = steps.fold((f64::INFINITY, 0.0_f64), |(least, most), step| {
            (least.min(step), most.max(step))
        });
        least > 0.0 && most < EVEN_STEPS * least
    };
    [0, 1].map(|axis| {
        let difference = |four: &[Seen]| {
            let weights = [1.0, -3.0, 3.0, -1.0];
            let angles = four.iter().map(|seen| seen.angles_deg[axis]);
            let (sum, variance) = angles
                .zip(weights)
                .fold((0.0, 0.0), |(sum, variance), (a, w)| {
                    (sum + w * a.value, variance + (w * a.sigma).powi(2))
                });
            (sum * sum / variance).sqrt()
        };
        let differences = seen.windows(4).filter(evenly).map(difference);
        let differences: Vec<f64> = differences.collect();
        let told = differences.len() >= LEAST_DIFFERENCES;
        let scatter = median(&differences).filter(|scatter| told && scatter.is_finite());
        scatter.map_or(1.0, |scatter| {
            (scatter * SIGMA_PER_MEDIAN).clamp(LEAST_CHANGING, 1.0)
        })
    })
}

#[cfg(test)]
mod tests {
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
