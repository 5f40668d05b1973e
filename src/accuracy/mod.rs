//! The Monte Carlo that judges the pipeline: frames with truth, condition by condition, solved one by one and held against
//! what is demanded.
//!
//! The same program runs in two sizes: small in the tests, where it bounds every row, and full on all cores for the
//! figures and tables of the documentation. Every frame has a seed: row and seed give the same frame again, on any
//! number of threads.
//!
//! # Method
//! 1. A row of the table is a name, conditions and demands ([`Row`]). Its conditions make a [`Recipe`] of a seed, and
//!    a recipe a scene. Rows share their seeds: the same seed puts the Sun at the same place wherever the conditions
//!    allow it.
//! 2. A [`Trial`] renders the scene, solves the frame without a prior and compares with the truth: an [`Outcome`].
//! 3. A [`Summary`] tells quantiles of the radial error (the Sun's centre on the plate, arcsec), the rms of error over
//!    stated sigma, and what is wrong; a [`Demand`] judges it.
//! 4. For some frames of a row, the Cramer-Rao bound says how small the error could be ([`bound`]).
//!
//! Beside the rows: the errors and the sub-pixel bias of single marks ([`marks`]), and one mixed run that looks for
//! wrong ids and for fine frames that are not ([`mixed`]). [`figures`] draws what a table cannot show.

pub mod bound;
pub mod conditions;
pub mod figures;
pub mod marks;
pub mod mixed;
pub mod outcome;
mod rows;
mod table;
mod trial;

pub use conditions::Recipe;
pub use outcome::{About, Demand, Summary};
pub use rows::rows;
pub use table::{markdown, text};
pub use trial::{AspectError, Bounded, MarkError, Outcome, Trial};

use crate::aspect::Settings;
use crate::instrument::{TomlError, builtin};
use crate::report::plot::PlotError;
use crate::simulate::SceneError;
use conditions::mixed as everything;
use figures::Sweeps;
use marks::{BiasMap, MarkSummary};
use mixed::MixedSummary;
use rayon::prelude::*;

/// How many frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Size {
    /// For the tests: a minute.
    Small,
    /// For the documentation: an hour of one core.
    Full,
}

impl Size {
    /// Of a number for the small size and one for the full.
    fn of<T: Copy>(self, [small, full]: [T; 2]) -> T {
        match self {
            Self::Small => small,
            Self::Full => full,
        }
    }
}

/// Frames of the mixed run.
const MIXED_FRAMES: [u64; 2] = [300, 20_000];
/// Frames for each phase of the bias map.
const FRAMES_PER_PHASE: [u64; 2] = [8, 60];
/// Frames of a row whose bound is computed.
const BOUNDED_FRAMES: [u64; 2] = [12, 200];
/// The row whose marks are judged one by one.
const MARKS_ROW: &str = "standard";
/// The name of the part about single marks.
pub const MARKS: &str = "marks";
/// The name of the mixed run.
pub const MIXED: &str = "mixed";

/// A row of the table.
#[derive(Debug, Clone)]
pub struct Row {
    pub name: &'static str,
    pub title: &'static str,
    /// The frames that the errors are of.
    pub about: About,
    /// How many frames: in the small size, in the full.
    pub frames: [u64; 2],
    /// How the row's frames depart from the standard one.
    pub vary: conditions::Vary,
    pub demands: &'static [Demand],
}

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
    Instrument(#[from] TomlError),
}

/// The name of every part of the program: the rows, the marks, the mixed run.
pub fn names() -> Vec<&'static str> {
    let rows = rows().into_iter().map(|row| row.name);
    rows.chain([MARKS, MIXED]).collect()
}

/// What is to be run.
#[derive(Debug, Clone)]
pub struct Program {
    pub size: Size,
    trial: Trial,
    rows: Vec<Row>,
    marks: bool,
    mixed: bool,
    sweeps: bool,
}

/// Whether the measurements for the figures are taken, too.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Figures {
    Drawn,
    Left,
}

/// What came of a row.
#[derive(Debug, Clone)]
pub struct RowReport {
    pub row: Row,
    pub outcomes: Vec<Outcome>,
    pub summary: Summary,
    /// Why the row's demands are not met.
    pub unmet: Vec<String>,
}

/// What came of the marks.
#[derive(Debug, Clone)]
pub struct MarksReport {
    pub summary: Option<MarkSummary>,
    pub bias: BiasMap,
    pub unmet: Vec<String>,
}

/// What came of the mixed run.
#[derive(Debug, Clone)]
pub struct MixedReport {
    pub summary: MixedSummary,
    pub unmet: Option<String>,
}

/// What came of it all.
#[derive(Debug, Clone)]
pub struct Report {
    pub size: Size,
    pub rows: Vec<RowReport>,
    pub marks: Option<MarksReport>,
    pub mixed: Option<MixedReport>,
    /// What the figures need beyond the rows.
    pub sweeps: Option<Sweeps>,
}

impl Report {
    /// Everything that is demanded and not met: where, and why.
    pub fn unmet(&self) -> Vec<(&'static str, &str)> {
        let rows = self.rows.iter().map(|r| (r.row.name, &r.unmet));
        let rows = rows.flat_map(|(name, unmet)| unmet.iter().map(move |u| (name, u.as_str())));
        let marks = self.marks.iter().flat_map(|m| &m.unmet);
        let mixed = self.mixed.iter().filter_map(|m| m.unmet.as_deref());
        rows.chain(marks.map(|u| (MARKS, u.as_str())))
            .chain(mixed.map(|u| (MIXED, u)))
            .collect()
    }

    /// Every figure that can be drawn of what was measured: file name and SVG.
    pub fn figures(&self) -> Result<Vec<(&'static str, String)>, PlotError> {
        let mut figures = Vec::new();
        if let Some(sweeps) = &self.sweeps {
            figures.push(("error-noise.svg", figures::noise_figure(sweeps)?));
            figures.push(("error-limb.svg", figures::limb_figure(sweeps)?));
        }
        for report in self.rows.iter().filter(|r| r.row.name == MARKS_ROW) {
            let svg = figures::histogram(&report.outcomes, report.row.title)?;
            figures.push(("error-histogram.svg", svg));
        }
        if let Some(marks) = &self.marks {
            figures.push(("mark-bias.svg", figures::bias_figure(&marks.bias)?));
        }
        Ok(figures)
    }
}

impl Program {
    /// All parts, or those of some names; with the sweeps that the figures need, or without.
    pub fn new(size: Size, only: &[String], figures: Figures) -> Result<Self, AccuracyError> {
        if let Some(found) = only.iter().find(|name| !names().contains(&name.as_str())) {
            return Err(AccuracyError::Name {
                found: found.clone(),
                known: names(),
            });
        }
        let wanted = |name: &str| only.is_empty() || only.iter().any(|o| o == name);
        Ok(Self {
            size,
            trial: Trial {
                instrument: builtin("demo")?,
                settings: Settings::default(),
            },
            rows: rows().into_iter().filter(|r| wanted(r.name)).collect(),
            marks: wanted(MARKS),
            mixed: wanted(MIXED),
            sweeps: figures == Figures::Drawn && only.is_empty(),
        })
    }

    /// How many frames there are to solve.
    pub fn frames(&self) -> u64 {
        let of_row = |row: &Row| self.size.of(row.frames);
        let rows: u64 = self.rows.iter().map(of_row).sum();
        let borrowed = self.rows.iter().any(|row| row.name == MARKS_ROW);
        let marks_row = rows_named(MARKS_ROW).filter(|_| !borrowed);
        let phases = (marks::PHASES * marks::PHASES) as u64;
        let marks =
            self.size.of(FRAMES_PER_PHASE) * phases + marks_row.map(|r| of_row(&r)).sum::<u64>();
        rows + u64::from(self.marks) * marks
            + u64::from(self.mixed) * self.size.of(MIXED_FRAMES)
            + u64::from(self.sweeps) * figures::frames(self.size)
    }

    /// Runs it on all cores; `done` is called after every frame.
    pub fn run(&self, done: &(dyn Fn() + Sync)) -> Result<Report, AccuracyError> {
        let rows: Result<Vec<_>, _> = self.rows.iter().map(|row| self.row(row, done)).collect();
        let rows = rows?;
        let marks = self.marks.then(|| self.marks(&rows, done)).transpose()?;
        let mixed = self.mixed.then(|| self.mixed(done)).transpose()?;
        let sweeps = || Sweeps::run(&self.trial, self.size, done);
        Ok(Report {
            size: self.size,
            rows,
            marks,
            mixed,
            sweeps: self.sweeps.then(sweeps).transpose()?,
        })
    }

    fn row(&self, row: &Row, done: &(dyn Fn() + Sync)) -> Result<RowReport, SceneError> {
        // What a frame without marks allows is no more than what it borrows.
        let bounded = match row.about {
            About::Fine => self.size.of(BOUNDED_FRAMES),
            About::Coarse | About::Solved => 0,
        };
        let outcomes = outcomes(self.size.of(row.frames), done, |seed| {
            let recipe = Recipe::drawn(row.vary, &self.trial.instrument, seed);
            let with_bound = match seed < bounded {
                true => Bounded::Yes,
                false => Bounded::No,
            };
            self.trial.outcome(&recipe, seed, with_bound)
        })?;
        let arcsec_per_mil = self.trial.instrument.optics.arcsec_per_mil();
        let summary = Summary::of(&outcomes, row.about, arcsec_per_mil);
        let unmet = row.demands.iter().filter_map(|d| d.unmet(&summary));
        Ok(RowReport {
            unmet: unmet.collect(),
            row: row.clone(),
            outcomes,
            summary,
        })
    }

    /// The marks of the standard row's frames, and the map of their bias.
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
                None => self.row(&row, done)?.outcomes,
            };
            let instrument = &self.trial.instrument;
            let scale = instrument.mounting.scale_mil_per_px.value;
            summary = MarkSummary::of(&outcomes, scale * instrument.optics.arcsec_per_mil());
        }
        let bias = marks::bias_map(&self.trial, self.size.of(FRAMES_PER_PHASE), done)?;
        Ok(MarksReport {
            unmet: marks::unmet(summary.as_ref(), &bias),
            summary,
            bias,
        })
    }

    fn mixed(&self, done: &(dyn Fn() + Sync)) -> Result<MixedReport, SceneError> {
        let outcomes = outcomes(self.size.of(MIXED_FRAMES), done, |seed| {
            let recipe = Recipe::drawn(everything, &self.trial.instrument, seed);
            self.trial.outcome(&recipe, seed, Bounded::No)
        })?;
        let summary = MixedSummary::of(&outcomes);
        Ok(MixedReport {
            unmet: summary.unmet(),
            summary,
        })
    }
}

fn rows_named(name: &str) -> impl Iterator<Item = Row> {
    rows().into_iter().filter(move |row| row.name == name)
}

/// Outcomes by seed, from 0, on all cores.
fn outcomes(
    frames: u64,
    done: &(dyn Fn() + Sync),
    outcome: impl Fn(u64) -> Result<Outcome, SceneError> + Sync,
) -> Result<Vec<Outcome>, SceneError> {
    let counted = |seed| outcome(seed).inspect(|_| done());
    (0..frames).into_par_iter().map(counted).collect()
}
