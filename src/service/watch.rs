//! The watch: it checks every thread, sends housekeeping each second, and feeds systemd's watchdog.

use super::archiver::{self, Archive};
use super::housekeeping::{HousekeepingSource, Restarts, SecondPackets};
use super::messages::{LinkEvent, NavigationRows};
use super::shared::Shared;
use super::silence;
use super::systemd::Systemd;
use super::tallies::Tallies;
use super::tally::FlightTally;
use super::worker::{self, Worker};
use crate::commands::controls::Controls;
use crate::link::Housekeeping;
use crossbeam_channel::{Receiver, Sender};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// How often the threads are checked.
const CHECK_EVERY: Duration = Duration::from_millis(10);
const REPORT_EVERY: Duration = Duration::from_secs(1);
/// A check delayed by this much shows that the whole program was stopped: suspended, or by SIGSTOP.
const STOPPED: Duration = Duration::from_secs(1);
/// Time for the last frames to be stored before a program that hangs is replaced.
const ENDING: Duration = Duration::from_millis(1500);
/// Silence of the line after which recovery is left to systemd: only a new process gets a new port.
const LINE_TIMEOUT: Duration = Duration::from_secs(10);
/// How long the archive waits for the filter's last rows after the last frame.
const NAVIGATION_ENDING: Duration = Duration::from_millis(500);
/// How long the line may take to close.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(300);

/// Shared state of the watch and the rest of the program.
#[derive(Debug, Default)]
pub(super) struct Signals {
    /// No more frames are to be taken.
    pub stop: Arc<AtomicBool>,
    /// No camera takes frames any more; threads of cameras that hang may still hold their channels.
    pub cameras_ended: Arc<AtomicBool>,
    /// The last frame is solved and stored, or abandoned.
    pub finished: AtomicBool,
    /// A caller waits for the end: the port may be closed when everything is finished.
    pub awaited: AtomicBool,
    /// Nothing more is to be sent.
    pub closing: Arc<AtomicBool>,
    /// Time at which unfinished work is abandoned.
    pub deadline: Shared<Option<Instant>>,
    /// The housekeeping sent last.
    pub housekeeping: Shared<Option<Housekeeping>>,
    /// Threads that were started again, as of the watch's last check.
    pub restarts: AtomicU64,
}

pub(super) struct Watch {
    pub cameras: Vec<Worker>,
    pub solvers: Vec<Worker>,
    /// Threads of the filter, and of sensors with lines of their own. The end does not wait for them.
    pub navigation: Vec<Worker>,
    pub navigation_rows: Receiver<NavigationRows>,
    pub disks: archiver::Threads,
    pub line: Worker,
    /// Threads of the outputs for other programs. Only the end waits for them, for a moment.
    pub outputs: Vec<Worker>,
    /// Held until the last solver has ended.
    pub archive: Option<Archive>,
    pub to_line: Sender<LinkEvent>,
    pub controls: Controls,
    pub housekeeping: HousekeepingSource,
    pub tallies: Tallies,
    pub signals: Arc<Signals>,
    /// Whether the flight was ended because its threads could not be restarted any more.
    pub gave_up: bool,
    /// Latest time at which frames were still taken or solved.
    pub frames_ended: Option<Instant>,
}

impl Watch {
    /// Watches the flight until everything has ended, or the deadline has passed and the port has been closed.
    pub fn run(mut self) -> FlightTally {
        let mut systemd = Systemd::ready();
        let mut checked = Instant::now();
        let mut report_at = checked + REPORT_EVERY;
        loop {
            let now = Instant::now();
            if now - checked > STOPPED {
                self.reset_silence(now - checked);
            }
            checked = now;
            self.note_commands();
            self.note_navigation();
            if self.is_finished(now) {
                break;
            }
            if !self.line.is_silent_for(LINE_TIMEOUT, now) {
                systemd.feed();
            }
            if systemd.is_there && !self.gave_up && self.is_unrecoverable(now) {
                self.give_up();
            }
            if now >= report_at {
                self.report();
                report_at += REPORT_EVERY;
                if report_at <= now {
                    // Seconds in which the program was stopped are not repeated.
                    report_at = now + REPORT_EVERY;
                }
            }
            thread::sleep(CHECK_EVERY);
        }
        systemd.stopping();
        self.signals.closing.store(true, Ordering::Relaxed);
        let begin = Instant::now();
        while self.is_closing(Instant::now()) && begin.elapsed() < CLOSE_TIMEOUT {
            thread::sleep(CHECK_EVERY);
        }
        let mut tally = self.tallies.tally();
        tally.archive = self.tallies.archive.final_tally(&tally.counts);
        tally.counts.unstored += tally.archive.unfinished;
        tally.restarts = self.restarts();
        tally.takeovers = self.takeovers();
        tally.gave_up = self.gave_up;
        tally
    }

    /// Whether the line or an output still has something to send.
    fn is_closing(&mut self, now: Instant) -> bool {
        let writing = worker::check(&mut self.outputs, now);
        self.line.check(now) || writing
    }

    fn note_commands(&self) {
        let lost = self.controls.take_lost_notes();
        for note in self.controls.command_notes() {
            if let Some(archive) = &self.archive {
                archive.note_command(&note);
            }
        }
        self.tallies.archive.note_lost_commands(lost);
    }

    /// Passes the navigation's rows to the archive.
    fn note_navigation(&self) {
        for rows in self.navigation_rows.try_iter() {
            if let Some(archive) = &self.archive {
                archive.note_navigation(&rows);
            }
        }
    }

    /// The threads were stopped like the whole program: they did not hang.
    fn reset_silence(&self, stopped: Duration) {
        let stopped_s = stopped.as_secs_f64();
        tracing::warn!(stopped_s, "the whole program was stopped for a while");
        let workers = self.cameras.iter().chain(&self.solvers);
        let workers = workers.chain(&self.navigation).chain([&self.line]);
        let workers = workers.chain(&self.outputs);
        workers.for_each(Worker::reset_silence);
    }

    /// Whether no camera is left that takes frames and has them solved.
    fn is_unrecoverable(&self, now: Instant) -> bool {
        let mut pairs = self.cameras.iter().zip(&self.solvers);
        pairs.all(|(camera, solver)| camera.is_unrecoverable(now) || solver.is_unrecoverable(now))
    }

    /// Ends the flight in order: systemd starts a new one.
    fn give_up(&mut self) {
        tracing::error!("threads hang again and again: the program ends, to be started again");
        self.gave_up = true;
        self.signals.stop.store(true, Ordering::Relaxed);
        let deadline = Instant::now() + ENDING;
        self.signals.deadline.lock().get_or_insert(deadline);
    }

    /// Checks all threads; returns whether the work is done and the port is to be closed.
    fn is_finished(&mut self, now: Instant) -> bool {
        silence::check(self.tallies.cameras.iter().map(|camera| &camera.silence));
        let taking = worker::check(&mut self.cameras, now);
        if !taking {
            self.signals.cameras_ended.store(true, Ordering::Relaxed);
        }
        let flying = worker::check(&mut self.solvers, now) || taking;
        let navigating = worker::check(&mut self.navigation, now);
        if flying || self.frames_ended.is_none() {
            self.frames_ended = Some(now);
        }
        let is_late = |frames_ended| now > frames_ended + NAVIGATION_ENDING;
        let navigating = navigating && !self.frames_ended.is_some_and(is_late);
        if !flying && !navigating {
            // The last rows.
            self.note_navigation();
            self.archive.take().into_iter().for_each(Archive::close);
        }
        let storing = self.disks.check(now);
        self.line.check(now);
        worker::check(&mut self.outputs, now);
        let restarts = self.restarts();
        self.signals.restarts.store(restarts, Ordering::Relaxed);
        let deadline = *self.signals.deadline.lock();
        let late = deadline.is_some_and(|deadline| Instant::now() >= deadline);
        if late && (flying || storing) && !self.signals.finished.load(Ordering::Relaxed) {
            tracing::error!("not everything could be finished in time");
        }
        if late || !(flying || storing || self.archive.is_some()) {
            self.signals.finished.store(true, Ordering::Release);
        }
        self.signals.finished.load(Ordering::Relaxed)
            && self.signals.awaited.load(Ordering::Relaxed)
    }

    fn report(&mut self) {
        let restarts = Restarts {
            all: self.restarts(),
            takeovers: self.takeovers(),
        };
        let events = self.to_line.len();
        let report = self.housekeeping.next(&self.tallies, restarts, events);
        let SecondPackets {
            time,
            housekeeping,
            counts,
            marks,
        } = report;
        if let Some(archive) = &self.archive {
            archive.note(time, &housekeeping);
        }
        *self.signals.housekeeping.lock() = Some((*housekeeping).clone());
        // If the line is stuck, other messages are more urgent.
        let send = |event| _ = self.to_line.try_send(event);
        send(LinkEvent::Housekeeping(time, housekeeping));
        if !counts.is_empty() {
            send(LinkEvent::Cameras(time, counts));
        }
        if !marks.is_empty() {
            send(LinkEvent::Marks(time, marks));
        }
    }

    fn takeovers(&self) -> u64 {
        let workers = self.cameras.iter().chain(&self.solvers);
        let workers = workers.chain(&self.navigation);
        workers.map(Worker::takeovers).sum()
    }

    fn restarts(&self) -> u64 {
        let workers = self.cameras.iter().chain(&self.solvers);
        let workers = workers.chain(&self.navigation).chain(&self.outputs);
        workers.map(Worker::restarts).sum::<u64>() + self.line.restarts() + self.disks.restarts()
    }
}
