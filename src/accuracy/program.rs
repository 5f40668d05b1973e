//! The program: the parts to run, with their numbers of frames, on all cores.

use super::demand::Precision;
use super::design_rows::design_rows;
use super::figures::{self, Sweeps};
use super::horizon::HorizonRow;
use super::horizon_rows::horizon_rows;
use super::marks::{self, MarkSummary};
use super::mixed::MixedSummary;
use super::moon::MoonRow;
use super::moon_rows::moon_rows;
use super::outcome::{About, AgainstIdeal, Summary};
use super::plate_rows::plate_rows;
use super::recipe::Recipe;
use super::report::{MarksReport, Report, RowReport, RunReport};
use super::rows::{
    AccuracyRow, DESIGNS, FIGURES, HORIZON, Ideal, MARKS, MARKS_ROW, MOON, PLATES, ROWS, Run, Size,
    rows, runs,
};
use super::trial::{Bounded, Outcome, Trial, outcomes};
use crate::aspect::SolverSettings;
use crate::frame::FrameError;
use crate::instrument::{Instrument, TomlError, builtin};
use crate::simulate::{Scene, SceneError};

/// Number of frames for each phase of the bias map.
const FRAMES_PER_PHASE: [u64; 2] = [16, 100];
/// Number of frames of a row for which the bound is computed: it costs several times as much as the frame, and the small
/// size has no requirement for it.
const BOUNDED_FRAMES: [u64; 2] = [0, 200];

/// Why the program cannot run.
#[derive(Debug, thiserror::Error)]
pub enum AccuracyError {
    #[error("expected one of {}, found \"{found}\"", known.join(", "))]
    Name {
        found: String,
        known: Vec<&'static str>,
    },
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(transparent)]
    Frame(#[from] FrameError),
    #[error(transparent)]
    Instrument(#[from] TomlError),
}

/// Parts to run.
#[derive(Debug, Clone)]
pub struct Program {
    pub size: Size,
    trial: Trial,
    /// Whether the instrument is the demo, for which the limits in arcsec are valid.
    is_demo: bool,
    rows: Vec<AccuracyRow>,
    plates: Vec<AccuracyRow>,
    designs: Vec<AccuracyRow>,
    marks: bool,
    runs: Vec<Run>,
    moons: Vec<MoonRow>,
    horizons: Vec<HorizonRow>,
    sweeps: bool,
}

/// Whether the measurements for the figures are made as well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Figures {
    Drawn,
    Left,
}

impl Program {
    /// All parts, or the named ones; the figures' only if they are drawn. For an instrument other than the demo,
    /// only the parts that apply to it: no other plates, no Moon and no horizon, and no limits in arcsec, which are valid
    /// for the demo only.
    pub fn new(
        size: Size,
        only: &[String],
        figures: Figures,
        instrument: Option<Instrument>,
    ) -> Result<Self, AccuracyError> {
        if let Some(found) = only.iter().find(|name| !names().contains(&name.as_str())) {
            return Err(unknown(found));
        }
        let wanted = |name: &str| only.is_empty() || only.iter().any(|o| o == name);
        let is_demo = instrument.is_none();
        let rows = (rows().into_iter()).filter(|row| wanted(ROWS) || wanted(row.name));
        let of_demo = |part: &str, rows: Vec<AccuracyRow>| -> Vec<AccuracyRow> {
            let is_wanted = |row: &AccuracyRow| wanted(part) || wanted(row.name);
            let rows = rows.into_iter();
            rows.filter(|row| is_demo && is_wanted(row)).collect()
        };
        Ok(Self {
            size,
            trial: Trial {
                instrument: instrument.map_or_else(|| builtin("demo"), Ok)?,
                settings: SolverSettings::default(),
            },
            rows: match is_demo {
                true => rows.collect(),
                false => rows.map(AccuracyRow::without_arcsec).collect(),
            },
            is_demo,
            plates: of_demo(PLATES, plate_rows()),
            designs: of_demo(DESIGNS, design_rows()),
            marks: wanted(MARKS),
            runs: runs().into_iter().filter(|r| wanted(r.name)).collect(),
            moons: match is_demo && wanted(MOON) {
                true => moon_rows(),
                false => Vec::new(),
            },
            horizons: match is_demo && wanted(HORIZON) {
                true => horizon_rows(),
                false => Vec::new(),
            },
            sweeps: figures == Figures::Drawn && wanted(FIGURES),
        })
    }

    /// Total number of frames to solve.
    pub fn frames(&self) -> u64 {
        let of_row = |row: &AccuracyRow| match row.ideal {
            Some(Ideal::Of(_)) => 2 * self.size.of(row.frames),
            Some(Ideal::Standard) | None => self.size.of(row.frames),
        };
        let rows = self.rows.iter().chain(&self.plates).chain(&self.designs);
        let rows: u64 = rows.map(of_row).sum();
        let borrowed = self.rows.iter().any(|row| row.name == MARKS_ROW);
        let marks_row = rows_named(MARKS_ROW).filter(|_| !borrowed);
        let phases = (marks::PHASES * marks::PHASES) as u64;
        let marks =
            self.size.of(FRAMES_PER_PHASE) * phases + marks_row.map(|r| of_row(&r)).sum::<u64>();
        let of_run = |run: &Run| self.size.of(run.frames);
        let runs: u64 = self.runs.iter().map(of_run).sum();
        let moons: u64 = self.moons.iter().map(|row| self.size.of(row.frames)).sum();
        let horizons = self.horizons.iter().map(|row| self.size.of(row.frames));
        rows + u64::from(self.marks) * marks
            + runs
            + moons
            + horizons.sum::<u64>()
            + self.standard_frames()
            + u64::from(self.sweeps) * figures::frames(self.size)
    }

    fn precision(&self) -> Precision {
        match self.size {
            Size::Small => Precision::OfCount,
            Size::Full => Precision::Measured,
        }
    }

    /// Number of standard frames with which rows are compared.
    fn standard_frames(&self) -> u64 {
        let compared = |row: &&AccuracyRow| matches!(row.ideal, Some(Ideal::Standard));
        let frames = self
            .rows
            .iter()
            .filter(compared)
            .map(|r| self.size.of(r.frames));
        frames.max().unwrap_or(0)
    }

    /// Runs it on all cores; `done` is called after every frame.
    pub fn run(&self, done: &(dyn Fn() + Sync)) -> Result<Report, AccuracyError> {
        let standard = self
            .trial
            .outcomes(|_, _, _| (), self.standard_frames(), done)?;
        let rows = self.rows.iter().map(|row| self.row(row, &standard, done));
        let rows = rows.collect::<Result<Vec<_>, _>>()?;
        let [plates, designs] = [&self.plates, &self.designs].map(|rows| {
            let rows = rows.iter().map(|row| self.row(row, &[], done));
            rows.collect::<Result<Vec<_>, _>>()
        });
        let marks = self.marks.then(|| self.marks(&rows, done)).transpose()?;
        let runs = self.runs.iter().map(|run| self.search(run, done));
        let precision = self.precision();
        let moons = (self.moons.iter()).map(|row| row.run(self.size, precision, done));
        let horizons = self.horizons.iter();
        let horizons = horizons.map(|row| row.run(self.size, precision, done));
        let sweeps = || Sweeps::run(&self.trial, self.size, done);
        Ok(Report {
            size: self.size,
            rows,
            plates: plates?,
            designs: designs?,
            marks,
            runs: runs.collect::<Result<_, _>>()?,
            moons: moons.collect::<Result<_, _>>()?,
            horizons: horizons.collect::<Result<_, _>>()?,
            sweeps: self.sweeps.then(sweeps).transpose()?,
        })
    }

    fn row(
        &self,
        row: &AccuracyRow,
        standard: &[Outcome],
        done: &(dyn Fn() + Sync),
    ) -> Result<RowReport, SceneError> {
        // The accuracy of a frame without marks is limited by the borrowed mapping.
        let with_bound = match row.about {
            About::Fine => self.size.of(BOUNDED_FRAMES),
            About::Coarse | About::Solved => 0,
        };
        let frames = self.size.of(row.frames);
        let seeds = 0..self.size.of(row.instruments).max(1);
        let trial = |seed| row.trial(&self.trial, self.size, seed);
        let trials: Vec<Trial> = seeds.map(trial).collect();
        let outcomes = outcomes(frames, done, |seed| {
            let trial = &trials[seed as usize % trials.len()];
            let recipe = Recipe::drawn(row.vary, &trial.instrument, seed);
            trial.outcome(&recipe, seed, Bounded::up_to(with_bound, seed))
        })?;
        // All have the same lens.
        let arcsec_per_mil = trials[0].instrument.optics.arcsec_per_mil();
        let mut summary = Summary::of(&outcomes, row.about, arcsec_per_mil);
        summary.ideal = match row.ideal {
            None => None,
            Some(Ideal::Standard) => AgainstIdeal::of(&outcomes, standard, row.about),
            Some(Ideal::Of(vary)) => {
                let ideal = trials[0].outcomes(vary, frames, done)?;
                AgainstIdeal::of(&outcomes, &ideal, row.about)
            }
        };
        let demands = row.demands.iter();
        let unmet = demands.filter_map(|d| d.unmet(&summary, self.precision()));
        Ok(RowReport {
            unmet: unmet.collect(),
            row: row.clone(),
            outcomes,
            summary,
        })
    }

    /// The marks of the standard row's frames, and their bias map.
    fn marks(
        &self,
        rows: &[RowReport],
        done: &(dyn Fn() + Sync),
    ) -> Result<MarksReport, SceneError> {
        let mut summary = None;
        for row in rows_named(MARKS_ROW) {
            let at_hand = rows.iter().find(|report| report.row.name == row.name);
            let outcomes = match at_hand {
                Some(report) => report.outcomes.clone(),
                None => self.row(&row, &[], done)?.outcomes,
            };
            let instrument = &self.trial.instrument;
            let scale = instrument.mounting.scale_mil_per_px.value;
            summary = MarkSummary::of(&outcomes, scale * instrument.optics.arcsec_per_mil());
        }
        let bias = marks::bias_map(&self.trial, self.size.of(FRAMES_PER_PHASE), done)?;
        Ok(MarksReport {
            unmet: match self.is_demo {
                true => marks::unmet(summary.as_ref(), &bias),
                false => Vec::new(),
            },
            summary,
            bias,
        })
    }

    fn search(&self, run: &Run, done: &(dyn Fn() + Sync)) -> Result<RunReport, SceneError> {
        let outcomes = self
            .trial
            .outcomes(run.vary, self.size.of(run.frames), done)?;
        let summary = MixedSummary::of(&outcomes);
        Ok(RunReport {
            run: run.clone(),
            unmet: summary.unmet(),
            summary,
            outcomes,
        })
    }
}

/// One frame of a row or of a run, for inspection.
#[derive(Debug, Clone)]
pub struct Case {
    pub recipe: Recipe,
    pub scene: Scene,
    pub outcome: Outcome,
}

impl Case {
    /// The frame of a seed; `part` is the name of a row or of a run. Without an instrument, the demo is used.
    pub fn new(
        part: &str,
        seed: u64,
        instrument: Option<Instrument>,
    ) -> Result<Self, AccuracyError> {
        let usual = Trial {
            instrument: instrument.map_or_else(|| builtin("demo"), Ok)?,
            settings: SolverSettings::default(),
        };
        let mut all = all_rows();
        let row = all.find(|row| row.name == part);
        let run = runs().into_iter().find(|run| run.name == part);
        let (trial, vary) = match (row, run) {
            (Some(row), _) => (row.trial(&usual, Size::Full, seed), row.vary),
            (None, Some(run)) => (usual, run.vary),
            (None, None) => return Err(unknown(part)),
        };
        let recipe = Recipe::drawn(vary, &trial.instrument, seed);
        Ok(Self {
            scene: recipe.scene(&trial.instrument, seed)?,
            outcome: trial.outcome(&recipe, seed, Bounded::Yes)?,
            recipe,
        })
    }
}

/// All rows of all parts.
fn all_rows() -> impl Iterator<Item = AccuracyRow> {
    let rows = rows().into_iter().chain(plate_rows());
    rows.chain(design_rows())
}

/// The names of all parts of the program, and of its rows and runs.
pub fn names() -> Vec<&'static str> {
    let rows = all_rows().map(|row| row.name);
    let runs = runs().into_iter().map(|run| run.name);
    rows.chain([ROWS, MARKS, PLATES, DESIGNS, FIGURES])
        .chain(runs)
        .chain([MOON, HORIZON])
        .collect()
}

fn unknown(name: &str) -> AccuracyError {
    AccuracyError::Name {
        found: name.into(),
        known: names(),
    }
}

fn rows_named(name: &str) -> impl Iterator<Item = AccuracyRow> + '_ {
    rows().into_iter().filter(move |row| row.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::rows::{MIXED, MOTION};

    #[test]
    fn every_part_has_a_name_of_its_own() {
        let mut unique = names();
        unique.sort_unstable();
        unique.dedup();
        assert_eq!(unique.len(), names().len());
    }

    #[test]
    fn a_seed_gives_the_same_frame_and_outcome_again() {
        let [one, again] = [(); 2].map(|()| Case::new(MIXED, 3, None).unwrap());
        assert_eq!(one.scene, again.scene);
        assert_eq!(one.outcome, again.outcome);
        assert_ne!(one.scene, Case::new(MIXED, 4, None).unwrap().scene);
    }

    #[test]
    fn only_what_has_frames_by_seed_gives_a_frame() {
        assert!(Case::new(MARKS, 1, None).is_err());
        assert!(Case::new(ROWS, 1, None).is_err());
        assert!(Case::new("standard", 1, None).is_ok());
        assert!(Case::new(MOTION, 1, None).is_ok());
    }
}
