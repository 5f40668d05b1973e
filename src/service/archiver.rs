//! The archive's thread: one file per frame, with its solution, and every frame's row in the log and the telemetry.

use super::Filing;
use super::solver::Answer;
use super::tally::{ArchiveTally, worth_a_line};
use crate::archive::{
    ArchiveError, Dirfile, Record, Row, SolutionLog, Store, instrument_cards, sky_cards, tables,
};
use crate::instrument::Instrument;
use crate::sky::Ephemeris;
use crossbeam_channel::Receiver;
use jiff::Timestamp;
use std::path::PathBuf;

/// Stores until the solver ends: in the first store that takes the frame. Without a store, answers are let go.
pub(super) fn run(
    stores: &[Store],
    instrument: &Instrument,
    mut ephemeris: Ephemeris,
    filings: &Receiver<Filing>,
) -> ArchiveTally {
    let mut tally = ArchiveTally::default();
    let mut journal = Journal::new(stores, Timestamp::now());
    for filing in filings {
        let row = match filing {
            Filing::Frame(answer) => {
                store_frame(stores, instrument, &mut ephemeris, &answer, &mut tally)
            }
            Filing::Row(row) => *row,
        };
        journal.note(&row);
    }
    tally
}

/// Stores the frame if a disk takes it, and returns its row.
fn store_frame(
    stores: &[Store],
    instrument: &Instrument,
    ephemeris: &mut Ephemeris,
    answer: &Answer,
    tally: &mut ArchiveTally,
) -> Row {
    let mut row = answer.row();
    let commanded;
    let instrument = match answer.mounting == instrument.mounting {
        true => instrument,
        false => {
            commanded = Instrument {
                mounting: answer.mounting,
                ..instrument.clone()
            };
            &commanded
        }
    };
    let stored = stores.iter().find_map(|store| {
        match keep(store, instrument, ephemeris, answer, &row.record) {
            Ok(path) => {
                tracing::debug!(file = %path.display(), "stored");
                let file = path.strip_prefix(store.root()).unwrap_or(&path);
                Some(file.display().to_string())
            }
            Err(error) => {
                tally.refused += 1;
                if worth_a_line(tally.refused) {
                    tracing::error!(%error, refused = tally.refused, "a disk refused a frame");
                }
                None
            }
        }
    });
    match stored {
        Some(file) => {
            row.record.file = file;
            tally.stored += 1;
        }
        None if stores.is_empty() => {}
        None => tally.failed += 1,
    }
    row
}

fn keep(
    store: &Store,
    instrument: &Instrument,
    ephemeris: &mut Ephemeris,
    answer: &Answer,
    record: &Record,
) -> Result<PathBuf, ArchiveError> {
    let frame = &answer.exposure.frame;
    let solution = &answer.solution;
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

/// The logs and the telemetry of this start, in the folders of the archive. A row goes to the first that takes it.
struct Journal {
    logs: Vec<SolutionLog>,
    dirfiles: Vec<Dirfile>,
    refused: u64,
}

impl Journal {
    fn new(stores: &[Store], start: Timestamp) -> Self {
        let roots = || stores.iter().map(Store::root);
        Self {
            logs: roots().map(|root| SolutionLog::new(root, start)).collect(),
            dirfiles: roots().map(|root| Dirfile::new(root, start)).collect(),
            refused: 0,
        }
    }

    fn note(&mut self, row: &Row) {
        let Self {
            logs,
            dirfiles,
            refused,
        } = self;
        let mut took = |result: Result<(), ArchiveError>| {
            let Err(error) = result else { return true };
            *refused += 1;
            if worth_a_line(*refused) {
                tracing::error!(%error, refused = *refused, "a disk refused a row of the log");
            }
            false
        };
        // `any` ends at the first that takes it.
        logs.iter_mut().any(|log| took(log.append(row)));
        dirfiles.iter_mut().any(|dirfile| took(dirfile.append(row)));
    }
}
