//! A disk's thread: it takes pictures from the queue and stores them on its disk.

use super::picture::StoredPicture;
use super::queue::{Queue, Taken, Waiting};
use crate::archive::{
    ArchiveError, Encoded, FreeSpace, Store, instrument_cards, sky_cards, tables,
};
use crate::backoff::Backoff;
use crate::clock::ClockStatus;
use crate::commands::controls::Controls;
use crate::fits::clock_cards;
use crate::log::worth_a_line;
use crate::pointing::Roll;
use crate::sky::Ephemeris;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Longest pause of a disk if no other takes its frames meanwhile: they wait in memory, which holds some seconds of
/// them.
const LONGEST_PAUSE_ALONE: Duration = Duration::from_millis(500);
/// How often a disk's free space is measured.
const CHECK_EVERY: Duration = Duration::from_secs(1);

/// State of a disk, for telemetry and the ground.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DiskHealth {
    pub root: PathBuf,
    /// Frames it has stored.
    pub stored: u64,
    /// Times that it refused a frame.
    pub refused: u64,
    /// Times that it refused a row of a log.
    pub rows_refused: u64,
    /// Half-written files of an earlier run that were removed.
    pub swept: usize,
    /// `None` if the disk does not report it.
    pub free_percent: Option<f64>,
    pub space: FreeSpace,
    /// Whether its last attempt was refused.
    pub failing: bool,
}

/// A disk's health, shared between its thread and its readers.
pub(super) type SharedHealth = Arc<Mutex<DiskHealth>>;

pub(super) fn health_of(shared: &SharedHealth) -> MutexGuard<'_, DiskHealth> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

#[derive(Clone)]
pub(super) struct Writer {
    /// Its number in the queue.
    pub disk: usize,
    pub store: Arc<Store>,
    pub queue: Arc<Queue<StoredPicture>>,
    /// Its number on this computer, from 0.
    pub number: usize,
    pub controls: Controls,
    /// Status of the computer's clock at the last check.
    pub clock: Option<ClockStatus>,
    pub ephemeris: Ephemeris,
    pub health: SharedHealth,
}

impl Writer {
    /// Stores pictures until the queue is closed and empty, or the disk refuses one after that.
    pub fn run(mut self) {
        let mut pauses = Backoff::DISK;
        let mut checked = None;
        let mut outcome = self.store.prepare().map(|()| self.note_swept());
        loop {
            if let Err(error) = outcome {
                self.note_refusal(&error);
                let pause = match self.queue.other_is_working(self.disk) {
                    true => pauses.wait(),
                    false => pauses.wait_at_most(LONGEST_PAUSE_ALONE),
                };
                if self.queue.pause(self.disk, Instant::now() + pause) {
                    break;
                }
            } else {
                pauses.reset();
            }
            if checked.is_none_or(|then: Instant| then.elapsed() >= CHECK_EVERY) {
                checked = Some(Instant::now());
                self.check();
            }
            let deadline = Instant::now() + CHECK_EVERY;
            outcome = match self.queue.take(self.disk, deadline) {
                Taken::Picture(waiting) => self.keep(waiting),
                Taken::Nothing if health_of(&self.health).failing => self.store.prepare(),
                Taken::Nothing => Ok(()),
                Taken::Closed => break,
            };
            if outcome.is_ok() {
                health_of(&self.health).failing = false;
            }
        }
        self.queue.end(self.disk);
    }

    /// Stores a picture; an error is the disk's, and the picture has then been given back.
    fn keep(&mut self, waiting: Waiting<StoredPicture>) -> Result<(), ArchiveError> {
        match self.store(&waiting.picture) {
            Ok(path) => {
                tracing::debug!(file = %path.display(), "stored");
                health_of(&self.health).stored += 1;
                let file = path.strip_prefix(self.store.root()).unwrap_or(&path);
                let file = file.display().to_string();
                waiting.picture.report.stored(&file, self.number);
                self.note_swept();
                Ok(())
            }
            Err(error @ ArchiveError::Io { .. }) => {
                self.queue.give_back(self.disk, waiting);
                Err(error)
            }
            Err(error) => {
                tracing::error!(%error, "a frame could not be stored");
                self.queue.fail();
                Ok(())
            }
        }
    }

    fn store(&mut self, picture: &StoredPicture) -> Result<PathBuf, ArchiveError> {
        match picture.encoded.get() {
            Some(encoded) if !self.store.has(&encoded.name) => self.store.put(encoded),
            Some(_) => {
                let encoded = self.encode(picture)?;
                self.store.put(&encoded)
            }
            None => {
                let encoded = self.encode(picture)?;
                // Two disks that mirror may both come here; the bytes that one of them made serve for both.
                self.store.put(picture.encoded.get_or_init(|| encoded))
            }
        }
    }

    fn encode(&mut self, picture: &StoredPicture) -> Result<Encoded, ArchiveError> {
        let solved = &picture.frame;
        let (frame, camera) = (&solved.exposure.frame, &solved.station.camera);
        let mut cards = solved.row().record.cards();
        cards.extend(solved.station.flown.cards());
        let mut columns = Vec::new();
        if let Some(sun) = solved.sun() {
            let (solution, instrument) = (&sun.solution, &sun.instrument);
            let roll = sun.offset.map_or(Roll::Stated, |offset| offset.roll);
            cards.extend(instrument_cards(instrument, roll));
            cards.extend(self.clock.iter().flat_map(clock_cards));
            cards.extend(sky_cards(
                &frame.info,
                solution,
                roll,
                instrument,
                &solved.target,
                &mut self.ephemeris,
            ));
            columns = tables(solution);
        }
        self.store
            .encode(&camera.folder, &camera.label, frame, &cards, &columns)
    }

    /// Measures the disk's free space, and logs when its state has changed; checks the clock and the settings, too.
    fn check(&mut self) {
        let settings = self.controls.config().archive;
        let limits = settings.space_limits();
        self.queue.set_every(settings.store_every);
        self.clock = ClockStatus::read().ok();
        let free_percent = self.store.space().ok().map(|space| space.free_percent());
        let used = free_percent.map(|free| (100.0 - free).round() as u8);
        self.controls.note_disk_use(self.number, used);
        if let Some(free_percent) = free_percent {
            self.queue
                .set_space(self.disk, limits.free_space(free_percent));
        }
        let mut health = health_of(&self.health);
        health.free_percent = free_percent;
        // A disk that does not report its free space keeps its last state; writing to it will show.
        let Some(free_percent) = free_percent else {
            return;
        };
        let space = limits.free_space(free_percent);
        if space == health.space {
            return;
        }
        let lower = space < health.space;
        health.space = space;
        let (disk, space) = (health.root.display(), space.name());
        match lower {
            true => tracing::warn!(%disk, space, free_percent, "a disk is filling up"),
            false => tracing::info!(%disk, space, free_percent, "a disk has free space again"),
        }
    }

    fn note_swept(&self) {
        let swept = self.store.swept();
        let mut health = health_of(&self.health);
        if swept > health.swept {
            health.swept = swept;
            let disk = health.root.display();
            tracing::warn!(%disk, swept, "partial files of an earlier run were removed");
        }
    }

    fn note_refusal(&self, error: &ArchiveError) {
        let mut health = health_of(&self.health);
        health.refused += 1;
        health.failing = true;
        if worth_a_line(health.refused) {
            tracing::error!(%error, refused = health.refused, "a disk refused");
        }
    }
}
