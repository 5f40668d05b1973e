//! One pass over frames: each file is opened once, several at a time, and its result is kept.
//!
//! - [`Pass`]: frames of an archive, a folder or an object store. Each result is a [`Record`] in a [`Journal`], appended at once: a run that
//!   was killed resumes where it stopped, shards of several machines are merged. [`Recorded`] reads each record again.
//! - [`cameras`]: assigns frames to cameras by a first pass over the headers, without [copies](CopiedFrame) of other frames.
//! - [`each_frame`]: frames given as files or folders; the results are in memory.
//! - [`InputSummary`]: inputs that were not used as they stand.
//! - [`Watch`] follows a pass, and may cancel it.

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
    Depth, Hash, InputError, Observed, RejectedFrame, each_frame, hashes, in_order, list, named,
    sha256, sha256_of,
};
pub use inputs::{FrameFacts, InputNotes, InputSummary};
pub use journal::{Journal, JournalError, Place, Record};
pub use pass::{
    Observer, Pass, PassError, Recorded, Records, Shard, Span, Unsolved, Watch, hash_of, key,
    with_frame,
};
