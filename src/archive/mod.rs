//! Storage of frames: a name that sorts by time, and a file that is complete or absent; and beside the files the numbers of every
//! frame, as a log and as telemetry.
//!
//! The assignment of a solution's values to keywords, columns and fields is defined in one place, [`record`](crate::record); the world
//! coordinates of the pixels are computed in [`Helioprojection`]. An archive is read through [`ArchiveReader`], from a folder or an object store.

pub mod check;
mod coordinates;
mod dirfile;
pub mod disk;
pub mod faulty;
mod flown;
mod frame_file;
mod growing;
pub mod keywords;
mod log;
mod name;
#[cfg(feature = "object-store")]
mod objects;
mod policy;
mod reader;
mod storage;
mod store;

pub use coordinates::{Helioprojection, observer_cards, sky_cards};
pub use dirfile::Dirfile;
pub use flown::{
    CONFIGURATION, Flown, FlownFile, FlownFiles, FlownKind, INSTRUMENT, flown_sha256,
    navigation_file,
};
pub use frame_file::{instrument_cards, tables, target_cards};
pub use log::{Log, SolutionLog};
pub use name::{NameTime, name, plain, role_of};
pub use policy::{FreeSpace, Overflow, Sharing, SpaceLimits};
pub use reader::ArchiveReader;
pub use storage::{Listing, StoredFile};
pub use store::{ArchiveError, Encoded, MARK, Store, UNFINISHED};
