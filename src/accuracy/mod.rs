//! The Monte Carlo test of the pipeline: frames with known truth, solved one by one under many conditions, and compared
//! with requirements.
//!
//! The same program runs in two sizes: small in the tests, where every row has limits, and full on all cores for the
//! figures and tables of the documentation. Every frame has a seed: row and seed reproduce the frame, on any number of
//! threads.
//!
//! # Method
//! 1. A row of the table is a name, conditions and requirements ([`AccuracyRow`]). Its conditions turn a seed into a
//!    [`Recipe`], and a recipe into a scene. Rows share their seeds: the same seed puts the Sun at the same position
//!    wherever the conditions allow it.
//! 2. A [`Trial`] renders the scene, solves the frame without a prior and compares with the truth: an [`Outcome`].
//! 3. A [`Summary`] has quantiles of the radial error (the Sun's centre on the plate, arcsec), the rms of the ratio of
//!    error to stated sigma, and a list of errors; a [`Demand`] evaluates it. Rows about one effect are compared with ideal
//!    frames with the same seeds.
//! 4. For some frames of a row, the Cramer-Rao bound gives the smallest possible error ([`bound`]).
//!
//! In addition to the rows: the errors and the sub-pixel bias of single marks ([`marks`]); series of mixed frames and of
//! frames with a moving Sun, which search for wrong ids and for wrong fine frames ([`mixed`]); and pictures of the Moon
//! ([`MoonRow`]) and of the Earth's limb ([`HorizonRow`]). [`figures`] draws the figures.
//!
//! ```text
//! recipe <- conditions; bound, recipe <- trial; chance, trial <- outcome <- demand; conditions, demand <- rows
//! rows <- plate_rows <- design_rows; chance, demand <- moon <- moon_rows; chance, demand <- horizon <- horizon_rows
//! all of these <- marks, mixed, figures <- report <- program <- table
//! ```

pub mod bound;
pub mod chance;
pub mod conditions;
pub mod demand;
mod design_rows;
pub mod figures;
mod horizon;
mod horizon_rows;
pub mod marks;
pub mod mixed;
mod moon;
mod moon_rows;
pub mod outcome;
mod plate_rows;
mod program;
mod recipe;
mod report;
mod rows;
mod table;
mod trial;

pub use demand::{Demand, Precision};
pub use horizon::{HorizonDemand, HorizonReport, HorizonRow, HorizonSummary};
pub use moon::{Knowledge, MoonDemand, MoonReport, MoonRow, MoonSummary};
pub use outcome::{About, Summary};
pub use program::{AccuracyError, Case, Figures, Program, names};
pub use recipe::{Recipe, Vary, View};
pub use report::{MarksReport, Report, ReportedFrame, RowReport, RunReport, frame_columns};
pub use rows::{
    AccuracyRow, DESIGNS, HORIZON, Ideal, MARKS, MIXED, MOON, MOTION, PLATES, Run, Size, rows, runs,
};
pub use table::{Page, case_text, text};
pub use trial::{AspectError, Bounded, MarkError, Outcome, Trial};
