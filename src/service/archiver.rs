//! The archive's thread: one file per frame, with its solution.

use super::solver::Answer;
use super::tally::{ArchiveTally, worth_a_line};
use crate::archive::{ArchiveError, Record, Store, instrument_cards, sky_cards, tables};
use crate::instrument::Instrument;
use crate::sky::Ephemeris;
use crossbeam_channel::Receiver;
use std::path::PathBuf;

/// Stores until the solver ends: in the first store that takes the frame. Without a store, answers are let go.
pub(super) fn run(
    stores: &[Store],
    instrument: &Instrument,
    mut ephemeris: Ephemeris,
    answers: &Receiver<Answer>,
) -> ArchiveTally {
    let mut tally = ArchiveTally::default();
    for answer in answers {
        let stored = stores.iter().any(|store| {
            match keep(store, instrument, &mut ephemeris, &answer) {
                Ok(path) => {
                    tracing::debug!(file = %path.display(), "stored");
                    true
                }
                Err(error) => {
                    tally.refused += 1;
                    if worth_a_line(tally.refused) {
                        tracing::error!(%error, refused = tally.refused, "a disk refused a frame");
                    }
                    false
                }
            }
        });
        if stored {
            tally.stored += 1;
        } else if !stores.is_empty() {
            tally.failed += 1;
        }
    }
    tally
}

fn keep(
    store: &Store,
    instrument: &Instrument,
    ephemeris: &mut Ephemeris,
    answer: &Answer,
) -> Result<PathBuf, ArchiveError> {
    let frame = &answer.exposure.frame;
    let utc = frame.info.mid_exposure;
    let solution = &answer.solution;
    let record = Record::new("", utc, solution, answer.offset, Some(answer.solve_time));
    let mut cards = record.cards();
    cards.extend(instrument_cards(instrument));
    cards.extend(sky_cards(
        &frame.info,
        solution,
        instrument,
        &answer.target,
        ephemeris,
    ));
    store.write(frame, &cards, &tables(solution))
}
