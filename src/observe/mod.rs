//! One pass over frames: each file is opened once, several at a time, and its result is kept.
//!
//! - [`Pass`]: frames of an archive, a folder or an object store. Each result is a [`Record`] in a [`Journal`], appended at once: a run that
//!   was killed goes on where it was, shards of several machines are merged. [`Done`] gives each record again.
//! - [`cameras`]: which camera took which frame, by a first pass over the headers, without the [copies](CopiedFrame) of other frames.
//! - [`over`]: frames that are named one by one, or by their folders; the results are in memory.
//! - [`InputSummary`]: parts of the files that were not used as they stand.
//! - [`Watch`] follows a pass, and may end it.

mod cameras;
mod copies;
mod files;
mod headers;
mod inputs;
mod journal;
mod pass;

pub use cameras::{CameraFrames, Cameras, cameras};
pub use copies::{CopiedFrame, Distinct};
pub use files::{
    Depth, Hash, InputError, Observed, RejectedFrame, hashes, in_order, list, named, over, sha256,
    sha256_of,
};
pub use inputs::{FrameFacts, InputNotes, InputSummary};
pub use journal::{Journal, JournalError, Place, Record};
pub use pass::{
    Done, Observer, Pass, PassError, Records, Shard, Span, Unsolved, Watch, hash_of, key,
    with_frame,
};
