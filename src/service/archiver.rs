//! The archive's thread: one file per frame, with its solution.

use super::solver::Answer;
use super::tally::ArchiveTally;
use crate::archive::{ArchiveError, Record, Store, tables};
use crossbeam_channel::Receiver;
use std::path::PathBuf;

/// Stores until the solver ends. Without a store, answers are let go.
pub(super) fn run(store: Option<&Store>, answers: &Receiver<Answer>) -> ArchiveTally {
    let mut tally = ArchiveTally::default();
    for answer in answers {
        let Some(store) = store else { continue };
        match keep(store, &answer) {
            Ok(path) => {
                tally.stored += 1;
                tracing::debug!(file = %path.display(), "stored");
            }
            Err(error) => {
                tally.failed += 1;
                tracing::error!(%error, failed = tally.failed, "a frame was not stored");
            }
        }
    }
    tally
}

fn keep(store: &Store, answer: &Answer) -> Result<PathBuf, ArchiveError> {
    let frame = &answer.exposure.frame;
    let utc = frame.info.mid_exposure;
    let solution = &answer.solution;
    let record = Record::new("", utc, solution, answer.offset, Some(answer.solve_time));
    store.write(frame, &record.cards(), &tables(solution))
}
