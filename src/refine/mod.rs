//! The best aspect history from a flight's archive.

mod first_pass;
mod journal;
mod record;

pub use first_pass::{Done, Recipe, Shard, Span, inputs};
pub use journal::{Journal, JournalError};
pub use record::{DiscRecord, FrameRecord, Grade, InFlight, Input, MarkRecord, PackedPoint, Record};
mod drift;
mod mapping;
mod view;
pub use mapping::{FlightMapping, Jump, MappingNumbers, Standing};
