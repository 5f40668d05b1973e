//! The archive in flight: pictures and rows, each disk with two threads of its own.
//!
//! ```text
//!  solver --- receive(frame) --> Queue (queue_frames) ---> archive-1 ---> disk 1   frames
//!     |                            \---------------------> archive-2 ---> disk 2
//!     |                                                         | StorageReport: the file's name
//!     \------- Entry (10,000) ----> log-1 <---------------------/         disk 1   log, telemetry
//!      \------ Entry (10,000) ----> log-2                                 disk 2
//! ```
//!
//! Rows wait while their disk refuses them: the channel is their queue.
//!
//! Two disks that alternate take from one queue; two that mirror have a queue each. Every disk has a log of its own of
//! all frames. Nothing here makes the solver wait.

mod journal;
mod picture;
mod queue;
mod writer;

pub use writer::DiskHealth;

use super::messages::{NavigationRows, ReceivesFrames, SolvedFrame, Station};
use super::tally::ArchiveTally;
use super::worker::{self, Job, Worker};
use crate::archive::{Sharing, Store, navigation_file};
use crate::commands::CommandNote;
use crate::commands::controls::Controls;
use crate::config;
use crate::link::Housekeeping;
use crate::link::{Counters, Counts};
use crate::log::worth_a_line;
use crate::record::ArchiveState;
use crate::sky::Ephemeris;
use crossbeam_channel::{Receiver, Sender, bounded};
use jiff::Timestamp;
use journal::{Entry, Journal, JournalTally, RowCounts, RowEntry, RowReport, STORAGE_TIMEOUT};
use picture::{FrameCounts, StorageReport, StoredAt, StoredPicture};
use queue::{Dropped, Queue, Rules};
use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;
use writer::{SharedHealth, Writer, health_of};

/// Rows that may wait for the log: six minutes' worth.
const ROWS: usize = 10_000;

/// The solver's end of the archive.
#[derive(Clone)]
pub(super) struct Archive {
    queues: Vec<Arc<Queue<StoredPicture>>>,
    logs: Vec<Sender<Entry>>,
    /// Closed with the last copy: from then on no row is retried.
    _flying: Sender<Infallible>,
    gauges: Gauges,
}

/// Counts of the archive, for telemetry.
#[derive(Clone, Default)]
pub(super) struct Gauges {
    queues: Vec<Arc<Queue<StoredPicture>>>,
    disks: Vec<SharedHealth>,
    journals: Vec<Arc<JournalTally>>,
    /// Rows that wait for each log.
    entries: Vec<Receiver<Entry>>,
    frames: Arc<FrameCounts>,
    rows: Arc<RowCounts>,
    /// Rows that did not fit into a log's queue.
    rows_overflowed: Arc<AtomicU64>,
}

/// The archive's threads.
#[derive(Default)]
pub(super) struct Threads(Vec<Worker>);

/// Inputs of the archive's threads.
pub(super) struct ArchiveContext<'f> {
    pub stations: &'f [Arc<Station>],
    pub controls: &'f Controls,
    pub ephemeris: &'f Ephemeris,
    pub navigation_toml: Option<&'f str>,
    pub counters: &'f Arc<Counters>,
}

/// Starts the threads of every disk.
pub(super) fn start(
    stores: Vec<Store>,
    context: &ArchiveContext,
) -> std::io::Result<(Archive, Threads)> {
    let settings = context.controls.config().archive;
    let queues = queues(&settings, stores.len());
    let mut gauges = Gauges {
        queues: queues.clone(),
        frames: Arc::new(FrameCounts {
            offered: AtomicU64::default(),
            counters: Arc::clone(context.counters),
        }),
        ..Gauges::default()
    };
    let (mut logs, mut threads) = (Vec::new(), Threads::default());
    let (flying, ended) = bounded(0);
    let start = Timestamp::now();
    for (number, store) in stores.into_iter().enumerate() {
        for station in context.stations {
            let files = station.flown.files(&station.camera.folder, start);
            store.add_flight_files(files);
        }
        let navigation = context.navigation_toml;
        store.add_flight_files(navigation.map(|text| navigation_file(text, start)));
        let (queue, disk) = match settings.sharing {
            Sharing::Alternate => (&queues[0], number),
            Sharing::Mirror => (&queues[number], 0),
        };
        let health = DiskHealth {
            root: store.root().into(),
            ..DiskHealth::default()
        };
        let writer = Writer {
            disk,
            store: Arc::new(store),
            queue: Arc::clone(queue),
            number,
            controls: context.controls.clone(),
            clock: None,
            ephemeris: context.ephemeris.clone(),
            health: Arc::new(Mutex::new(health)),
        };
        let (to_log, entries) = bounded(ROWS);
        let tally = Arc::new(JournalTally::default());
        logs.push(to_log);
        gauges.entries.push(entries.clone());
        gauges.disks.push(Arc::clone(&writer.health));
        gauges.journals.push(Arc::clone(&tally));
        let folders = context.stations.iter().map(|s| s.camera.folder.clone());
        threads.log(&writer, (folders.collect(), start), entries, &ended, &tally)?;
        threads.start(format!("archive-{}", number + 1), move || {
            let writer = writer.clone();
            Box::new(move |_| writer.run())
        })?;
    }
    let archive = Archive {
        queues,
        logs,
        _flying: flying,
        gauges,
    };
    Ok((archive, threads))
}

/// One queue that all disks take from, or one for each.
fn queues(settings: &config::Archive, disks: usize) -> Vec<Arc<Queue<StoredPicture>>> {
    let rules = Rules {
        bound: settings.queue_frames,
        overflow: settings.overflow,
        every: settings.store_every,
    };
    match settings.sharing {
        _ if disks == 0 => Vec::new(),
        Sharing::Alternate => vec![Arc::new(Queue::new(rules, disks))],
        Sharing::Mirror => (0..disks).map(|_| Arc::new(Queue::new(rules, 1))).collect(),
    }
}

impl ReceivesFrames for Archive {
    /// Stores a solved frame and its row, if there is space.
    fn receive(&self, frame: &SolvedFrame) {
        let stored_at = self.queue_picture(frame);
        let deadline = Instant::now() + STORAGE_TIMEOUT;
        let archive_state = self.gauges.archive_state();
        if self.logs.is_empty() {
            return;
        }
        let report = Arc::new(RowReport::new(&self.gauges.rows));
        for (log, stored_at) in self.logs.iter().zip(stored_at) {
            let mut row = frame.row();
            row.archive_state = archive_state;
            let entry = Entry::Row(RowEntry {
                station: frame.station.index,
                row: Box::new(row),
                stored_at,
                deadline,
                report: Arc::clone(&report),
            });
            self.log(log, entry);
        }
    }
}

impl Archive {
    pub fn gauges(&self) -> Gauges {
        self.gauges.clone()
    }

    /// Stores the second's housekeeping.
    pub fn note(&self, time: Timestamp, housekeeping: &Housekeeping) {
        for log in &self.logs {
            self.log(
                log,
                Entry::Housekeeping(time, Box::new(housekeeping.clone())),
            );
        }
    }

    /// Stores a command.
    pub fn note_command(&self, note: &CommandNote) {
        for log in &self.logs {
            self.log(log, Entry::Command(Box::new(note.clone())));
        }
    }

    /// Stores rows of the navigation.
    pub fn note_navigation(&self, rows: &NavigationRows) {
        for log in &self.logs {
            self.log(log, Entry::Navigation(rows.clone()));
        }
    }

    fn log(&self, log: &Sender<Entry>, entry: Entry) {
        if log.try_send(entry).is_err() {
            let rows = self.gauges.rows_overflowed.fetch_add(1, Ordering::Relaxed) + 1;
            if worth_a_line(rows) {
                tracing::error!(rows, "a log is too slow: it lacks rows");
            }
        }
    }

    /// Queues the picture, if this camera's are stored; returns for each log the receiver of the file's name.
    fn queue_picture(&self, frame: &SolvedFrame) -> Vec<Option<Receiver<StoredAt>>> {
        if !frame.to_be_stored || self.queues.is_empty() {
            return vec![None; self.logs.len()];
        }
        let (report, receivers) = StorageReport::new(self.logs.len(), &self.gauges.frames);
        let picture = StoredPicture::new(frame.clone(), report);
        for queue in &self.queues {
            match queue.offer(picture.clone()) {
                Dropped::DiskSlow(frames) if worth_a_line(frames) => {
                    tracing::warn!(frames, "the disks are too slow: pictures are dropped");
                }
                Dropped::DiskFull(frames) if worth_a_line(frames) => {
                    tracing::warn!(frames, "the disks are nearly full: pictures are dropped");
                }
                _ => {}
            }
        }
        receivers.into_iter().map(Some).collect()
    }

    /// No frame will be offered any more.
    pub fn close(self) {
        for queue in &self.queues {
            queue.close();
        }
    }
}

impl Gauges {
    /// Counts commands that did not fit into the queue.
    pub fn note_lost_commands(&self, lost: u64) {
        self.rows_overflowed.fetch_add(lost, Ordering::Relaxed);
    }

    pub fn tally(&self) -> ArchiveTally {
        let mut tally = ArchiveTally {
            rows_refused: self.rows_overflowed.load(Ordering::Relaxed),
            rows_lost: self.rows.lost.load(Ordering::Relaxed),
            ..ArchiveTally::default()
        };
        for queue in &self.queues {
            let queue = queue.tally();
            tally.overflowed += queue.overflowed;
            tally.disk_full += queue.disk_full;
            tally.failed += queue.failed;
        }
        for disk in self.disks() {
            tally.refused += disk.refused;
            tally.rows_refused += disk.rows_refused;
            tally.swept += disk.swept as u64;
        }
        tally
    }

    /// The final counts: pictures on a disk that hangs, and those that still wait, are lost.
    pub fn final_tally(&self, counts: &Counts) -> ArchiveTally {
        let mut tally = self.tally();
        let missing =
            |offered: &AtomicU64, kept: u64| offered.load(Ordering::Relaxed).saturating_sub(kept);
        let unstored = missing(&self.frames.offered, counts.stored);
        tally.unfinished = unstored.saturating_sub(counts.unstored);
        let kept = self.rows.kept.load(Ordering::Relaxed);
        tally.rows_lost = missing(&self.rows.offered, kept);
        tally
    }

    /// Telemetry of the archive itself.
    fn archive_state(&self) -> ArchiveState {
        let free = |disk: usize| health_of(self.disks.get(disk)?).free_percent;
        ArchiveState {
            free_percent: [free(0), free(1)],
            waiting: self.waiting() as u64,
            unstored: self.frames.counters.unstored.get(),
        }
    }

    pub fn disks(&self) -> Vec<DiskHealth> {
        let health = |(shared, journal): (&SharedHealth, &Arc<JournalTally>)| DiskHealth {
            rows_refused: journal.refused.load(Ordering::Relaxed),
            ..health_of(shared).clone()
        };
        self.disks.iter().zip(&self.journals).map(health).collect()
    }

    /// Rows that wait for the log that is furthest behind.
    pub fn waiting_rows(&self) -> usize {
        self.entries.iter().map(Receiver::len).max().unwrap_or(0)
    }

    /// Pictures that wait for a disk.
    pub fn waiting(&self) -> usize {
        self.queues.iter().map(|queue| queue.length()).sum()
    }
}

impl Threads {
    /// Starts a disk's thread. It may block for long: no other thread can take over its work.
    fn start(
        &mut self,
        name: String,
        make: impl FnMut() -> Job + Send + 'static,
    ) -> std::io::Result<()> {
        self.0.push(Worker::start(name, None, make)?);
        Ok(())
    }

    /// Starts the thread of a disk's logs: those in the cameras' folders, begun at the given time.
    fn log(
        &mut self,
        disk: &Writer,
        (folders, start): (Vec<PathBuf>, Timestamp),
        entries: Receiver<Entry>,
        ended: &Receiver<Infallible>,
        tally: &Arc<JournalTally>,
    ) -> std::io::Result<()> {
        let (store, number) = (Arc::clone(&disk.store), disk.number);
        let (ended, tally) = (ended.clone(), Arc::clone(tally));
        self.start(format!("log-{}", number + 1), move || {
            let (ended, tally) = (ended.clone(), Arc::clone(&tally));
            let journal = Journal::new(Arc::clone(&store), number, &folders, start, ended, tally);
            let entries = entries.clone();
            Box::new(move |_| journal.run(&entries))
        })
    }

    /// Checks the threads; returns whether the work of any goes on.
    pub fn check(&mut self, now: Instant) -> bool {
        worker::check(&mut self.0, now)
    }

    pub fn restarts(&self) -> u64 {
        self.0.iter().map(Worker::restarts).sum()
    }
}
