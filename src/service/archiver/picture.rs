//! A solved frame on its way to the disks, and the report of its storage.

use crate::archive::Encoded;
use crate::link::Counters;
use crate::service::messages::SolvedFrame;
use crossbeam_channel::{Receiver, Sender, bounded};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

/// A frame that is to be stored. Copies of it share their fate and their bytes.
#[derive(Clone)]
pub(super) struct StoredPicture {
    pub frame: SolvedFrame,
    pub report: Arc<StorageReport>,
    /// The file's bytes, made by the first disk that needs them.
    pub encoded: Arc<OnceLock<Encoded>>,
}

impl StoredPicture {
    pub fn new(frame: SolvedFrame, report: StorageReport) -> Self {
        Self {
            frame,
            report: Arc::new(report),
            encoded: Arc::default(),
        }
    }
}

/// Counts of frames by their result, over all disks.
#[derive(Debug, Default)]
pub(super) struct FrameCounts {
    pub offered: AtomicU64,
    pub counters: Arc<Counters>,
}

/// Location of a stored frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct StoredAt {
    /// The path relative to the archive's root.
    pub file: String,
    /// The disk's number on this computer, from 0.
    pub disk: usize,
}

/// Reports to the logs where a frame is stored. If it is dropped before that, the frame was not stored.
pub(super) struct StorageReport {
    stored: AtomicBool,
    to_logs: Vec<Sender<StoredAt>>,
    counts: Arc<FrameCounts>,
}

impl StorageReport {
    /// A fate, and one receiver for each of `logs` logs.
    pub fn new(logs: usize, counts: &Arc<FrameCounts>) -> (Self, Vec<Receiver<StoredAt>>) {
        counts.offered.fetch_add(1, Ordering::Relaxed);
        let (to_logs, receivers) = (0..logs).map(|_| bounded(1)).unzip();
        let report = Self {
            stored: AtomicBool::new(false),
            to_logs,
            counts: Arc::clone(counts),
        };
        (report, receivers)
    }

    /// Reports that the frame is in this file on this disk; if there are several, only the first is reported.
    pub fn stored(&self, file: &str, disk: usize) {
        if self.stored.swap(true, Ordering::Relaxed) {
            return;
        }
        self.counts.counters.stored.count();
        for log in &self.to_logs {
            // A log that no longer listens has written its row without the name.
            let file = file.to_owned();
            let _ = log.try_send(StoredAt { file, disk });
        }
    }
}

impl Drop for StorageReport {
    fn drop(&mut self) {
        if !self.stored.load(Ordering::Relaxed) {
            self.counts.counters.unstored.count();
        }
    }
}
