//! The best aspect history from a flight's archive.

mod first_pass;
mod journal;
mod record;

pub use first_pass::{Done, Recipe, Shard, Span, inputs};
pub use journal::{Journal, JournalError};
pub use record::{
    DiscRecord, FrameRecord, Grade, InFlight, Input, MarkRecord, PackedPoint, Record,
};
mod drift;
mod mapping;
mod view;
pub use mapping::{FlightMapping, Jump, MappingNumbers, Standing};
mod disc;
pub mod motion;
pub use disc::PlateDisc;
mod flight;
mod row;
pub use flight::{Flight, second_pass};
pub use row::{Oddity, OwnRow, Row, SkyRow};
pub mod columns;
mod output;
mod sky;
pub use output::{OutputError, Summary, write};
pub use sky::Sky;
mod report;
pub mod spectrum;
pub use report::write_report;
