//! The best aspect history from a flight's archive, in two passes.
//!
//! 1. Every frame on its own ([`Done::work`]): the fine pipeline without a prior, on all cores. What a frame gave is a compact
//!    [`Record`], appended to a [`Journal`] at once; neither pixels nor solutions are kept. A run that is killed goes on where it was.
//! 2. The flight as a whole ([`second_pass`]): one [`FlightMapping`] from the marks of all frames, each frame's Sun from its own
//!    limb through that mapping, what is odd beside the other frames, the Sun's [path](crate::smoothing) between them, and a second look at
//!    frames that had failed.
//!
//! What comes out ([`write()`], [`Report`]) depends on archive, instrument and settings alone, bit for bit: not on the order in
//! which frames were done, by how many cores or machines, nor on how often the run was killed.

mod allan;
mod camera_headers;
mod cameras;
mod clock;
mod clock_facts;
pub mod columns;
mod copies;
mod disc;
mod drift;
mod drift_report;
mod estimate;
mod first_pass;
mod flight;
mod follow;
mod inputs;
mod jitter_report;
mod journal;
mod load;
mod look;
mod mapping;
mod oddities;
mod oddity;
mod output;
mod radius;
mod record;
mod report;
mod roll;
mod row;
mod sky;
mod stabilisation;
mod temperature;
mod times;
mod view;
mod work;

pub use camera_headers::{CameraHeader, CameraHeaders};
pub use cameras::{CameraFrames, cameras};
pub use clock::ClockStep;
pub use clock_facts::ClockFacts;
pub use copies::{CopiedFrame, Distinct, PixelDigests, distinct, may_be_copied};
pub use disc::PlateDisc;
pub use first_pass::{Done, FirstPass, Recipe, Shard, Span, Unsolved};
pub use flight::{Flight, second_pass};
pub use inputs::InputSummary;
pub use journal::{Journal, JournalError};
pub use mapping::{
    FlightMapping, Jump, MappingFacts, MappingNumbers, Standing, TemperatureDependence,
};
pub use oddity::{Oddity, Order};
pub use output::{OutputError, Summary, write};
pub use radius::RadiusDependence;
pub use record::{
    DiscRecord, FrameFacts, FrameRecord, Grade, InFlight, MarkRecord, PackedPoint, Record,
};
pub use report::Report;
pub use roll::{RollHistory, RollRecipe, RollRow, RollSummary, write_roll};
pub use row::{OwnRow, Row, SkyRow};
pub use sky::Sky;
pub use stabilisation::{RateError, stabilisation, write_stabilisation};
