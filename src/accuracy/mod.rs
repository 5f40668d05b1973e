//! The Monte Carlo that judges the pipeline: frames with truth, condition by condition, solved one by one and held against
//! what is demanded.
//!
//! The same program runs in two sizes: small in the tests, where it bounds every row, and full on all cores for the
//! figures and tables of the documentation. Every frame has a seed: row and seed give the same frame again, on any
//! number of threads.
//!
//! # Method
//! 1. A row of the table is a name, conditions and demands ([`AccuracyRow`]). Its conditions make a [`Recipe`] of a seed,
//!    and a recipe a scene. Rows share their seeds: the same seed puts the Sun at the same place wherever the conditions
//!    allow it.
//! 2. A [`Trial`] renders the scene, solves the frame without a prior and compares with the truth: an [`Outcome`].
//! 3. A [`Summary`] has quantiles of the radial error (the Sun's centre on the plate, arcsec), the rms of error over
//!    stated sigma, and what is wrong; a [`Demand`] judges it. Rows about one effect are compared with ideal frames of the same seeds.
//! 4. For some frames of a row, the Cramer-Rao bound says how small the error could be ([`bound`]).
//!
//! Beside the rows: the errors and the sub-pixel bias of single marks ([`marks`]), and runs of mixed frames and of frames whose Sun moves,
//! which search for wrong ids and for fine frames that are not ([`mixed`]), and pictures of the Moon
//! ([`MoonRow`]) and of the Earth's limb ([`HorizonRow`]). [`figures`] draws what a table cannot show.
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
