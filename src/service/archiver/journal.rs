//! A disk's log and telemetry: a thread of their own, so that no row waits for a picture's disk for long.

use crate::archive::{ArchiveError, Dirfile, Log, Row, SolutionLog, Store};
use crate::link::Housekeeping;
use crate::link::housekeeping::{FIELDS, Field};
use crate::service::tally::worth_a_line;
use crossbeam_channel::Receiver;
use jiff::Timestamp;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// What the journal is told.
pub(super) enum Entry {
    Row(RowEntry),
    Housekeeping(Box<Housekeeping>),
}

/// A row on its way to the log.
pub(super) struct RowEntry {
    /// Of the camera, in the order of the flight's.
    pub station: usize,
    pub row: Box<Row>,
    /// Tells the file that the frame is in; `None` where it is not to be stored.
    pub file: Option<Receiver<String>>,
    /// When the row is written without the file's name.
    pub deadline: Instant,
}

/// What the log's thread counts.
#[derive(Debug, Default)]
pub(super) struct JournalTally {
    /// Rows that the disk refused.
    pub refused: AtomicU64,
}

pub(super) struct Journal {
    store: Arc<Store>,
    /// By camera.
    books: Vec<Book>,
    housekeeping: Log,
    tally: Arc<JournalTally>,
}

struct Book {
    folder: PathBuf,
    log: SolutionLog,
    dirfile: Dirfile,
}

impl Journal {
    /// The journals of this start in a store, one in each camera's folder.
    pub fn new(
        store: Arc<Store>,
        folders: &[PathBuf],
        start: Timestamp,
        tally: Arc<JournalTally>,
    ) -> Self {
        let book = |folder: &PathBuf| {
            let root = store.root().join(folder);
            Book {
                folder: folder.clone(),
                log: SolutionLog::new(&root, start),
                dirfile: Dirfile::new(&root, start),
            }
        };
        let books = folders.iter().map(book).collect();
        let name = |field: &Field| match field.unit {
            "" => field.name.to_owned(),
            unit => format!("{} [{unit}]", field.name),
        };
        let columns = std::iter::once("utc".to_owned());
        let columns = columns.chain(FIELDS.iter().map(name)).collect();
        Self {
            housekeeping: Log::new(store.root(), "housekeeping", columns, start),
            store,
            books,
            tally,
        }
    }

    /// Writes what it is told, in its order, until no more comes.
    pub fn run(mut self, entries: &Receiver<Entry>) {
        for entry in entries {
            match entry {
                Entry::Row(row) => self.write_row(row),
                Entry::Housekeeping(told) => self.write_housekeeping(&told),
            }
        }
    }

    fn write_row(&mut self, entry: RowEntry) {
        let mut row = entry.row;
        let told = entry
            .file
            .and_then(|file| file.recv_deadline(entry.deadline).ok());
        row.record.file = told.unwrap_or_default();
        let Some(book) = self.books.get_mut(entry.station) else {
            return;
        };
        let kept = [
            book.note(&self.store, &row, |book, row| book.log.append(row)),
            book.note(&self.store, &row, |book, row| book.dirfile.append(row)),
        ];
        kept.into_iter().for_each(|kept| self.count(kept));
    }

    fn write_housekeeping(&mut self, told: &Housekeeping) {
        let mut fields = vec![format!("{:.3}", Timestamp::now())];
        fields.extend(told.csv_row());
        let there = self.store.prepare();
        let kept = there.and_then(|()| self.housekeeping.append(&fields));
        self.count(kept);
    }

    fn count(&self, kept: Result<(), ArchiveError>) {
        let Err(error) = kept else { return };
        let refused = self.tally.refused.fetch_add(1, Ordering::Relaxed) + 1;
        if worth_a_line(refused) {
            tracing::error!(%error, refused, "a disk refused a row of the log");
        }
    }
}

impl Book {
    fn note(
        &mut self,
        store: &Store,
        row: &Row,
        append: impl FnOnce(&mut Self, &Row) -> Result<(), ArchiveError>,
    ) -> Result<(), ArchiveError> {
        store.enter(&self.folder)?;
        append(self, row)
    }
}
