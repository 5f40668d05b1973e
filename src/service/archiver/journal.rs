//! A disk's log and telemetry: a thread of their own, so that no row waits for a picture's disk for long.
//!
//! A row that the disk refuses is retried after a pause, and the rows behind it wait: an outage loses none of them while there
//! is space for them. The telemetry repeats the same numbers, and does not wait.

use super::picture::StoredAt;
use crate::archive::{ArchiveError, Dirfile, Log, SolutionLog, Store};
use crate::backoff::Backoff;
use crate::commands::CommandNote;
use crate::link::Housekeeping;
use crate::link::housekeeping::{FIELDS, Field};
use crate::log::worth_a_line;
use crate::navigation::{PropagatedOffset, files};
use crate::record::LoggedRow;
use crate::service::messages::{NavigationLog, NavigationRows};
use crossbeam_channel::{Receiver, RecvTimeoutError};
use jiff::Timestamp;
use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Longest wait of a row for the result of storing its picture.
pub(super) const STORAGE_TIMEOUT: Duration = Duration::from_secs(5);

/// Entries of the journal.
pub(super) enum Entry {
    Row(RowEntry),
    Housekeeping(Timestamp, Box<Housekeeping>),
    Command(Box<CommandNote>),
    Navigation(NavigationRows),
}

/// A row on its way to the log.
pub(super) struct RowEntry {
    /// Number of the camera, in the order of the flight's.
    pub station: usize,
    pub row: Box<LoggedRow>,
    /// Receives the file in which the frame is stored; `None` if it is not to be stored, or once that is known.
    pub stored_at: Option<Receiver<StoredAt>>,
    /// Time at which the row is written without the file's name.
    pub deadline: Instant,
    /// Shared with the same row on its way to the other log.
    pub report: Arc<RowReport>,
}

/// Counts of rows by their result, over all logs.
#[derive(Debug, Default)]
pub(super) struct RowCounts {
    pub offered: AtomicU64,
    /// Rows in at least one log.
    pub kept: AtomicU64,
    /// Rows in no log.
    pub lost: AtomicU64,
}

/// Whether a row is in any log. If it is dropped without being marked as kept, the row is in none.
pub(super) struct RowReport {
    kept: AtomicBool,
    counts: Arc<RowCounts>,
}

impl RowReport {
    pub fn new(counts: &Arc<RowCounts>) -> Self {
        counts.offered.fetch_add(1, Ordering::Relaxed);
        Self {
            kept: AtomicBool::new(false),
            counts: Arc::clone(counts),
        }
    }

    fn kept(&self) {
        if !self.kept.swap(true, Ordering::Relaxed) {
            self.counts.kept.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Drop for RowReport {
    fn drop(&mut self) {
        if self.kept.load(Ordering::Relaxed) {
            return;
        }
        let lost = self.counts.lost.fetch_add(1, Ordering::Relaxed) + 1;
        if worth_a_line(lost) {
            tracing::error!(lost, "a row was lost: it is in no log");
        }
    }
}

/// Counts of the log's thread.
#[derive(Debug, Default)]
pub(super) struct JournalTally {
    /// Times that the disk refused a row.
    pub refused: AtomicU64,
}

pub(super) struct Journal {
    store: Arc<Store>,
    /// The disk's number on this computer, from 0.
    number: usize,
    /// One per camera.
    cameras: Vec<CameraLogs>,
    housekeeping: Log,
    commands: Log,
    /// In the order of [`NavigationLog::ALL`].
    navigation: [Log; NavigationLog::ALL.len()],
    /// Number of the disk's mount in which the files were opened.
    mount: u64,
    /// Carries no messages; it is closed when the flight ends.
    ended: Receiver<Infallible>,
    tally: Arc<JournalTally>,
    /// Time until which frames may wait for a disk that was away.
    wait_until: Instant,
}

/// First part of the names of a log's files, and its columns; `t_s` counts from 1970, UTC, by the sensors' time stamps.
fn navigation_log(log: NavigationLog) -> (&'static str, Vec<&'static str>) {
    match log {
        NavigationLog::Imu => ("imu", files::IMU.to_vec()),
        NavigationLog::Gps => ("gps", [&files::GPS[..], &[files::CLIMB]].concat()),
        NavigationLog::Propagated => {
            let offset = [
                &["t_s"][..],
                &PropagatedOffset::COLUMNS,
                &["age_s", "status"],
            ];
            ("propagated", offset.concat())
        }
    }
}

struct CameraLogs {
    folder: PathBuf,
    solutions: SolutionLog,
    dirfile: Dirfile,
}

impl Journal {
    /// The journals of this start in a store, one in each camera's folder.
    pub fn new(
        store: Arc<Store>,
        number: usize,
        folders: &[PathBuf],
        start: Timestamp,
        ended: Receiver<Infallible>,
        tally: Arc<JournalTally>,
    ) -> Self {
        let logs = |folder: &PathBuf| {
            let root = store.root().join(folder);
            CameraLogs {
                folder: folder.clone(),
                solutions: SolutionLog::new(store.disk(), &root, start),
                dirfile: Dirfile::new(store.disk(), &root, start),
            }
        };
        let cameras = folders.iter().map(logs).collect();
        let name = |field: &Field| match field.unit {
            "" => field.name.to_owned(),
            unit => format!("{} [{unit}]", field.name),
        };
        let columns = std::iter::once("utc".to_owned());
        let columns = columns.chain(FIELDS.iter().map(name)).collect();
        Self {
            housekeeping: Log::new(store.disk(), store.root(), "housekeeping", columns, start),
            commands: Log::new(
                store.disk(),
                store.root(),
                "commands",
                CommandNote::COLUMNS.map(str::to_owned).to_vec(),
                start,
            ),
            navigation: NavigationLog::ALL.map(|log| {
                let (name, columns) = navigation_log(log);
                let columns = columns.into_iter().map(str::to_owned).collect();
                Log::new(store.disk(), store.root(), name, columns, start)
            }),
            mount: store.visits(),
            store,
            number,
            cameras,
            ended,
            tally,
            wait_until: Instant::now(),
        }
    }

    /// Writes entries in their order until no more come. Rows that the disk refuses are retried until the flight ends.
    pub fn run(mut self, entries: &Receiver<Entry>) {
        for mut entry in entries {
            let mut pauses = Backoff::DISK;
            while let Err(error) = self.write(&mut entry) {
                self.note_refusal(&error);
                if self.ended.recv_timeout(pauses.wait()) == Err(RecvTimeoutError::Disconnected) {
                    break;
                }
            }
        }
    }

    fn write(&mut self, entry: &mut Entry) -> Result<(), ArchiveError> {
        match entry {
            Entry::Row(entry) => self.write_row(entry),
            Entry::Housekeeping(time, housekeeping) => self.write_housekeeping(*time, housekeeping),
            Entry::Command(note) => self.write_command(note),
            Entry::Navigation(rows) => self.write_navigation(rows),
        }
    }

    fn write_row(&mut self, entry: &mut RowEntry) -> Result<(), ArchiveError> {
        if entry.station >= self.cameras.len() {
            return Ok(());
        }
        self.enter(entry.station)?;
        if let Some(stored_at) = entry.stored_at.take() {
            let deadline = entry.deadline.max(self.wait_until);
            let stored_at = stored_at.recv_deadline(deadline).ok();
            entry.row.on_own_disk = stored_at.as_ref().map(|at| at.disk == self.number);
            entry.row.record.file = stored_at.map_or(String::new(), |at| at.file);
            // The disk may have been removed in the meantime.
            self.enter(entry.station)?;
        }
        // Also if no picture is stored.
        self.store.put_flight_files()?;
        let logs = &mut self.cameras[entry.station];
        logs.solutions.append(&entry.row)?;
        entry.report.kept();
        if let Err(error) = logs.dirfile.append(&entry.row) {
            self.note_refusal(&error);
        }
        Ok(())
    }

    fn enter(&mut self, station: usize) -> Result<(), ArchiveError> {
        self.store.enter(&self.cameras[station].folder)?;
        self.close_after_mount();
        Ok(())
    }

    fn write_housekeeping(
        &mut self,
        time: Timestamp,
        housekeeping: &Housekeeping,
    ) -> Result<(), ArchiveError> {
        self.store.prepare()?;
        self.close_after_mount();
        let mut fields = vec![format!("{time:.3}")];
        fields.extend(housekeeping.csv_row());
        self.housekeeping.append(&fields)
    }

    fn write_command(&mut self, note: &CommandNote) -> Result<(), ArchiveError> {
        self.store.prepare()?;
        self.close_after_mount();
        self.commands.append(&note.fields())
    }

    /// Writes the rows, and leaves in `rows` those that are not written yet.
    fn write_navigation(&mut self, rows: &mut NavigationRows) -> Result<(), ArchiveError> {
        self.store.prepare()?;
        self.close_after_mount();
        let log = &mut self.navigation[rows.log as usize];
        while let Some(row) = rows.rows.front() {
            log.append(row)?;
            rows.rows.pop_front();
        }
        Ok(())
    }

    /// Closes the files after a mount, so that the next rows open them again: the old handles are useless.
    fn close_after_mount(&mut self) {
        let mount = self.store.visits();
        if mount != self.mount {
            self.mount = mount;
            self.close();
        }
    }

    fn close(&mut self) {
        self.housekeeping.close();
        self.commands.close();
        self.navigation.iter_mut().for_each(Log::close);
        for logs in &mut self.cameras {
            logs.solutions.close();
            logs.dirfile.close();
        }
    }

    fn note_refusal(&mut self, error: &ArchiveError) {
        self.close();
        self.wait_until = Instant::now() + STORAGE_TIMEOUT;
        let refused = self.tally.refused.fetch_add(1, Ordering::Relaxed) + 1;
        if worth_a_line(refused) {
            tracing::error!(%error, refused, "a disk refused a row of the log");
        }
    }
}
