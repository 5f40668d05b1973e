//! The frames that an instrument's file is based on already: each frame is used once only.

use crate::calibrate::revision::Revision;
use crate::observe::Hash;
use std::collections::BTreeSet;
use toml_edit::{Item, value};

/// Digits of a frame's SHA-256 that distinguish it from others: in one of five million sets of 10,000 frames two are confused.
const DIGITS: usize = 12;
/// Key of their list in the file.
const KEY: &str = "calibration.plate.frame_hashes";

/// The frames that a file's marks are based on.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct UsedFrames {
    /// Common hash of all frames of the last calibration; none for older files without it.
    of_all: Option<String>,
    frames: BTreeSet<String>,
}

impl UsedFrames {
    /// The frames listed in an instrument's file.
    pub fn of(revision: &Revision) -> Self {
        let text = |key: &str| revision.get(key).and_then(Item::as_str);
        let frames = text(KEY).unwrap_or_default().split_whitespace();
        Self {
            of_all: text("calibration.plate.frames_sha256").map(str::to_owned),
            frames: frames.map(str::to_owned).collect(),
        }
    }

    /// Whether they are exactly the given frames, whose common hash is `frames_sha256`.
    pub(super) fn are(&self, frames_sha256: &str) -> bool {
        self.of_all.as_deref() == Some(frames_sha256)
    }

    pub(super) fn holds(&self, frame: &Hash) -> bool {
        self.frames.contains(&digits(frame))
    }

    /// Adds further frames.
    pub(super) fn with<'a>(&self, frames: impl Iterator<Item = &'a Hash>) -> Self {
        let frames = self.frames.iter().cloned().chain(frames.map(digits));
        Self {
            of_all: None,
            frames: frames.collect(),
        }
    }

    pub(super) fn list(&self, revision: &mut Revision) {
        let frames: Vec<&str> = self.frames.iter().map(String::as_str).collect();
        revision.put(KEY, value(frames.join(" ")));
    }
}

fn digits(hash: &Hash) -> String {
    let bytes = hash.iter().take(DIGITS / 2);
    bytes.map(|byte| format!("{byte:02x}")).collect()
}
