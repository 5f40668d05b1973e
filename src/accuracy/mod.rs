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
mod program;
mod recipe;
mod report;
mod rows;
mod table;
mod trial;

pub use outcome::{About, Demand, Summary};
pub use program::{Case, Figures, Program};
pub use recipe::{Recipe, View};
pub use report::{MarksReport, MixedReport, Report, RowReport};
pub use rows::rows;
pub use table::{case_text, markdown, text};
pub use trial::{AspectError, Bounded, MarkError, Outcome, Trial};

use crate::instrument::TomlError;
use crate::simulate::SceneError;

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
    pub demands: Vec<Demand>,
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
