//! The archive in flight: pictures and rows, each disk with two threads of its own.
//!
//! ```text
//!  solver --- offer(answer) ---> Queue (queue_frames) ---> archive-1 ---> disk 1   frames
//!     |                            \---------------------> archive-2 ---> disk 2
//!     |                                                         | Fate: the file's name
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

use super::answer::Answer;
use super::flight::Station;
use super::navigation::NavigationRows;
use super::tally::ArchiveTally;
use super::worker::{self, Job, Worker};
use crate::archive::{Sharing, Store, navigation_file};
use crate::commands::CommandNote;
use crate::commands::controls::Controls;
use crate::config;
use crate::link::Housekeeping;
use crate::link::{Counters, Counts};
use crate::log::worth_a_line;
use crate::record::Upkeep;
use crate::sky::Ephemeris;
use crossbeam_channel::{Receiver, Sender, bounded};
use jiff::Timestamp;
use journal::{Entry, FATE_KNOWN, Journal, JournalTally, RowCounts, RowEntry, RowFate};
use picture::{Fate, FrameCounts, Picture, Told};
use queue::{GivenUp, Queue, Rules};
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
    queues: Vec<Arc<Queue<Picture>>>,
    logs: Vec<Sender<Entry>>,
    /// Closed with the last copy: then no row is tried again.
    _flying: Sender<Infallible>,
    gauges: Gauges,
}

/// What the archive counts, for telemetry.
#[derive(Clone, Default)]
pub(super) struct Gauges {
    queues: Vec<Arc<Queue<Picture>>>,
    disks: Vec<SharedHealth>,
    journals: Vec<Arc<JournalTally>>,
    /// What waits for each log.
    entries: Vec<Receiver<Entry>>,
    frames: Arc<FrameCounts>,
    rows: Arc<RowCounts>,
    /// Rows that a log had no room for.
    rows_overflowed: Arc<AtomicU64>,
}

/// The archive's threads.
#[derive(Default)]
pub(super) struct Threads(Vec<Worker>);

/// Starts the threads of every disk.
pub(super) fn start(
    stores: Vec<Store>,
    stations: &[Arc<Station>],
    controls: &Controls,
    ephemeris: &Ephemeris,
    navigation_toml: Option<&str>,
    counters: &Arc<Counters>,
) -> std::io::Result<(Archive, Threads)> {
    let settings = controls.config().archive;
    let queues = queues(&settings, stores.len());
    let mut gauges = Gauges {
        queues: queues.clone(),
        frames: Arc::new(FrameCounts {
            offered: AtomicU64::default(),
            counters: Arc::clone(counters),
        }),
        ..Gauges::default()
    };
    let (mut logs, mut threads) = (Vec::new(), Threads::default());
    let start = Timestamp::now();
    let folders: Vec<PathBuf> = stations.iter().map(|s| s.folder.clone()).collect();
    let (flying, ended) = bounded(0);
    for (n, store) in stores.into_iter().enumerate() {
        let (queue, disk) = match settings.sharing {
            Sharing::Alternate => (&queues[0], n),
            Sharing::Mirror => (&queues[n], 0),
        };
        for station in stations {
            store.add_flight_files(station.flown.files(&station.folder, start));
        }
        store.add_flight_files(navigation_toml.map(|text| navigation_file(text, start)));
        let store = Arc::new(store);
        let health = Arc::new(Mutex::new(DiskHealth {
            root: store.root().into(),
            ..DiskHealth::default()
        }));
        let tally = Arc::new(JournalTally::default());
        let writer = Writer {
            disk,
            store: Arc::clone(&store),
            queue: Arc::clone(queue),
            number: n,
            controls: controls.clone(),
            clock: None,
            ephemeris: ephemeris.clone(),
            health: Arc::clone(&health),
        };
        let (to_log, entries) = bounded(ROWS);
        gauges.entries.push(entries.clone());
        threads.start(format!("archive-{}", n + 1), move || {
            let writer = writer.clone();
            Box::new(move |_| writer.run())
        })?;
        let (folders, counts) = (folders.clone(), Arc::clone(&tally));
        let ended = ended.clone();
        threads.start(format!("log-{}", n + 1), move || {
            let store = Arc::clone(&store);
            let (ended, counts) = (ended.clone(), Arc::clone(&counts));
            let journal = Journal::new(store, n, &folders, start, ended, counts);
            let entries: Receiver<Entry> = entries.clone();
            Box::new(move |_| journal.run(&entries))
        })?;
        logs.push(to_log);
        gauges.disks.push(health);
        gauges.journals.push(tally);
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
fn queues(settings: &config::Archive, disks: usize) -> Vec<Arc<Queue<Picture>>> {
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

impl Archive {
    pub fn gauges(&self) -> Gauges {
        self.gauges.clone()
    }

    /// Stores a solved frame and its row, when and where there is room.
    pub fn offer(&self, answer: &Answer) {
        let heard = self.hand_to_disks(answer);
        let deadline = Instant::now() + FATE_KNOWN;
        let upkeep = self.gauges.upkeep();
        if self.logs.is_empty() {
            return;
        }
        let fate = Arc::new(RowFate::new(&self.gauges.rows));
        for (log, told) in self.logs.iter().zip(heard) {
            let mut row = answer.row();
            row.upkeep = upkeep;
            let entry = Entry::Row(RowEntry {
                station: answer.station.index,
                row: Box::new(row),
                told,
                deadline,
                fate: Arc::clone(&fate),
            });
            self.log(log, entry);
        }
    }

    /// Keeps the second's housekeeping.
    pub fn note(&self, time: Timestamp, told: &Housekeeping) {
        for log in &self.logs {
            self.log(log, Entry::Housekeeping(time, Box::new(told.clone())));
        }
    }

    /// Keeps a command.
    pub fn note_command(&self, note: &CommandNote) {
        for log in &self.logs {
            self.log(log, Entry::Command(Box::new(note.clone())));
        }
    }

    /// Keeps rows of the navigation.
    pub fn note_navigation(&self, rows: &NavigationRows) {
        for log in &self.logs {
            self.log(log, Entry::Navigation(rows.clone()));
        }
    }

    fn log(&self, log: &Sender<Entry>, entry: Entry) {
        if log.try_send(entry).is_err() {
            let rows = self.gauges.rows_overflowed.fetch_add(1, Ordering::Relaxed) + 1;
            if worth_a_line(rows) {
                tracing::error!(rows, "a log cannot follow: it lacks rows");
            }
        }
    }

    /// Queues the picture, if this camera's are stored, and returns where each log hears of it.
    fn hand_to_disks(&self, answer: &Answer) -> Vec<Option<Receiver<Told>>> {
        if !answer.to_be_stored || self.queues.is_empty() {
            return vec![None; self.logs.len()];
        }
        let (fate, heard) = Fate::new(self.logs.len(), &self.gauges.frames);
        let picture = Picture::new(answer.clone(), fate);
        for queue in &self.queues {
            match queue.offer(picture.clone()) {
                GivenUp::ForSpeed(frames) if worth_a_line(frames) => {
                    tracing::warn!(frames, "the disks cannot follow: pictures are given up");
                }
                GivenUp::ForSpace(frames) if worth_a_line(frames) => {
                    tracing::warn!(frames, "the disks are nearly full: pictures are given up");
                }
                _ => {}
            }
        }
        heard.into_iter().map(Some).collect()
    }

    /// No frame will be offered any more.
    pub fn close(self) {
        for queue in &self.queues {
            queue.close();
        }
    }
}

impl Gauges {
    /// Counts commands that found no room on their way here.
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
            tally.no_room += queue.no_room;
            tally.failed += queue.failed;
        }
        for disk in self.disks() {
            tally.refused += disk.refused;
            tally.rows_refused += disk.rows_refused;
            tally.swept += disk.swept as u64;
        }
        tally
    }

    /// The counts when nobody waits any longer: what a disk that hangs has in its hands, and what still waits, is lost.
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

    /// What the telemetry tells of the archive itself.
    fn upkeep(&self) -> Upkeep {
        let free = |disk: usize| health_of(self.disks.get(disk)?).free_percent;
        Upkeep {
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
    /// A disk may take its time: nobody else can do what its thread waits for.
    fn start(
        &mut self,
        name: String,
        make: impl FnMut() -> Job + Send + 'static,
    ) -> std::io::Result<()> {
        self.0.push(Worker::start(name, None, make)?);
        Ok(())
    }

    /// Looks after the threads: whether the work of any goes on.
    pub fn look(&mut self, now: Instant) -> bool {
        worker::look(&mut self.0, now)
    }

    pub fn restarts(&self) -> u64 {
        self.0.iter().map(Worker::restarts).sum()
    }
}
