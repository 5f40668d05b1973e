//! The best aspect history of a flight from its archive: [`refine`].
//!
//! 1. Every frame on its own ([`observe`](crate::observe)): the pipeline without a tracking prior, on all cores. Its result is a compact
//!    [`FrameRecord`] in a journal; neither pixels nor solutions are kept. A run that is killed resumes where it stopped.
//! 2. The flight as a whole ([`History::new`]). Each stage adds a column for the dated frames:
//!
//! | stage | |
//! |---|---|
//! | `timeline` | their times, checked against the monotonic clock, the frames' numbers and each other, and their order |
//! | `frames` | the result of each on its own, as far as other frames are compared with it |
//! | `mapping` | one slowly varying view of the plate, with jumps, from the marks of all |
//! | `suns` | each frame's Sun from its own limb and that mapping |
//! | `outliers` | flags of frames that differ from the others |
//! | `path` | the Sun's path between them ([`smoothing`](crate::smoothing)) |
//! | `second_pass` | solves failed frames again |
//! | `roll`, `sky` | the body's roll where the horizon was seen; azimuth, elevation and the offset from the target |
//!
//! 3. A [`RefinedRow`] is assembled from the columns and the record on request ([`History::rows`]), and never
//!    changed.
//!
//! ```no_run
//! use solaspect::refine::{Options, refine};
//! use std::path::Path;
//!
//! let options = Options {
//!     out: "best".into(),
//!     ..Options::default()
//! };
//! // `()` follows nothing and cancels nothing; see [`Watch`](solaspect::observe::Watch).
//! let refined = refine(Path::new("flight"), &options, &())?;
//! for camera in &refined.cameras {
//!     println!("{} of {} fine", camera.summary.counts.fine, camera.summary.counts.files);
//! }
//! # Ok::<(), anyhow::Error>(())
//! ```
//!
//! The results depend on archive, instrument and settings alone, bit for bit: not on the order in which frames were processed, the number
//! of cores or machines, or interruptions of the run.

mod allan;
mod attitude;
mod clock;
mod clock_facts;
pub mod columns;
mod comparison;
mod disc;
mod drift;
mod drift_report;
mod estimate;
mod files;
mod films;
mod flags;
mod frames;
mod history;
mod jitter_report;
mod mapping;
mod navigation;
mod outliers;
mod output;
mod path;
mod pointing;
mod pointing_report;
mod radius;
mod recipe;
mod record;
mod report;
mod roll;
mod roll_output;
mod roll_report;
mod row;
mod run;
mod second_pass;
mod sky;
mod solar_path;
mod stabilisation;
mod suns;
mod temperature;
mod timeline;
mod times;
mod view;

pub use attitude::{Attitude, AttitudeFound, Basis, NavigationFile, Wanted, add_attitude};
pub use clock::ClockStep;
pub use clock_facts::ClockFacts;
pub use comparison::{Compared, ComparedAxis, Contradiction};
pub use disc::PlateDisc;
pub use files::Overrides;
pub use flags::{FrameFlag, FrameFlags, Order, TimeFlag};
pub use history::{History, HistoryError};
pub use mapping::{Jump, MappingFacts, MappingNumbers, TemperatureDependence};
pub use navigation::Navigation;
pub use output::{
    Counts, MappingSummary, NamedJump, OutputError, PointingFacts, Summary, Written, write,
    write_rows, write_stabilisation,
};
pub use radius::RadiusDependence;
pub use recipe::Recipe;
pub use record::{DiscRecord, FrameRecord, Grade, InFlight, MarkRecord, PackedPoint};
pub use report::{Report, Rows};
pub use roll::{HorizonRecord, RollHistory, RollRecipe, RollRow};
pub use roll_output::RollSummary;
pub use row::{RefinedRow, SkyRow};
pub use run::{Options, Refined, RefinedCamera, RefinedRoll, ShardDone, Stabilised, refine};
pub use sky::Sky;
pub use solar_path::{OnTarget, SolarPath, SolarStep};
pub use stabilisation::{RateError, StabilisationRow, stabilisation};
pub use times::Timing;
