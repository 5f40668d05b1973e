//! How a frame survives: a name that sorts by time, and a file that is whole or absent.
//!
//! Which values of a solution fill which keywords is decided above [`Store::write`], which takes them as cards and
//! tables.

mod name;
mod store;

pub use name::{NameTime, name};
pub use store::{ArchiveError, Store};
