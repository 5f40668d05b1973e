//! The flight service: every long-lived thread, channel, bound and overflow rule on one page.
//!
//! ```text
//!             frames (8)               pictures (queue_frames)
//!  camera-1 ---------------> solver-1 ------------------------> archive-1, archive-2    frames
//!     |  ^                     | |  | \_______ rows (10,000) ______> log-1, log-2         log, telemetry, housekeeping
//!     |  \__ LatestBrightness _/ |  |
//!     |                          |  \___ directions __
//!     |     LinkEvent (256)      |                    v
//!     +--------------------------+-> link --- IMU --> navigation <--- gps, imu     sensors with lines of their own
//!                                    ^ ^     inputs (1024)  |
//!        controller, over a byte port| \_____ offsets ______/
//!
//!  solutions of all solvers, telemetry of link --- messages (256) ---> output-1, output-2     for other programs
//!
//!  Controls (shared): settings by the ground; values: saves them
//!  watch: checks all of them, gives the housekeeping to link and logs each second, feeds systemd's watchdog
//! ```
//!
//! Each camera has a thread and a solver of its own, numbered in the order of the cameras; the kind of solver depends on what its camera sees
//! (`solvers`). Only solvers of a plate send to the controller. The solver of the first roll camera passes the latest nadir to these. The solver of
//! the first Moon camera passes its result to the link, which answers requests for the Moon with it. If a navigation filter flies, its thread takes
//! the data of IMU, GPS and solvers, and gives the link an offset at some of the IMU's samples. Every disk of the archive has two threads; while it
//! compresses a picture, the first may start `archive.threads` less one for it. Every output for other programs has a thread of a lower priority than
//! all these; only the end waits for it, for a moment.
//!
//! | channel | holds | when it is full |
//! |---|---|---|
//! | frames | frames to solve | the frame is lost and counted: a camera does not wait; frames of a folder or the simulator wait for 10 s before |
//! | LatestBrightness | brightness of the last frame | the newer value replaces the older |
//! | pictures | solved frames to store | by the rule `archive.overflow` a picture is dropped and counted; solving goes on |
//! | rows | rows of the log | the row is lost and counted |
//! | commands | rows of the command log, from link and values to watch (1024), and on among the rows | the row is lost and counted |
//! | inputs | samples, fixes and directions for the filter | the input is lost and counted: neither solvers nor the line wait for the filter |
//! | navigation's rows | the archive's rows of the navigation, a second at a time, from navigation to watch (64), and on among the rows | the rows are lost and counted |
//! | messages | messages of an output: solved frames, or the telemetry of the line | the message is dropped and counted: neither solvers nor the line wait for a reader |
//! | LinkEvent | exposures about to start, solutions, offsets by the gyros, housekeeping, counts of further cameras, ids of marks, pictures | the event is dropped and counted: the line is stuck |
//!
//! A thread ends when the channel it reads from is closed: the camera ends first, then solver and archive, each after
//! the last of its work. Link and outputs go on until the service is joined.
//!
//! A thread that panics is started again. So is a camera, a solver or the filter that shows no sign of life for a while, with the
//! same channels; the thread that hangs is abandoned. While three of them hang, the next is not replaced; if no camera is solved
//! any more, the program ends in order, and systemd starts it again. A stop of the whole program counts against no thread. A
//! thread blocked on a disk is not restarted: the other disk's goes on. If watch or link hang, systemd's watchdog is not
//! fed, and it starts the program again.
//!
//! The program's log has a queue and a thread of its own ([`crate::log`]): no thread here waits for standard error. So has the list of files taken
//! from a folder that is followed ([`crate::camera::TakenFiles`], 4096 names, then lost and counted): no frame waits for its disk.

mod archiver;
mod camera_thread;
mod flight;
mod frames;
mod housekeeping;
mod launch;
mod line;
pub(crate) mod messages;
mod navigation;
mod outputs;
pub mod priority;
mod shared;
mod silence;
mod solved_frame;
mod solver_thread;
pub(crate) mod solvers;
mod systemd;
mod tallies;
mod tally;
mod watch;
mod worker;

pub use archiver::DiskHealth;
pub use flight::{CameraFactory, ClaimError, Flight, FlightCamera, Navigation, NoOwnCamera};
pub use launch::Service;
pub use messages::{BodyRoll, Found, Solved, SolvedFrame, SolvedMoon, SolvedSun, Station};
pub use tally::{
    ArchiveTally, CameraSolved, CameraTally, FlightTally, LineTally, NavigationTally, OutputTally,
    SolverTally, quantile,
};

use crate::commands::controls::Controls;
use crate::link::Housekeeping;
use crossbeam_channel::{Receiver, unbounded};
use launch::SAVED_VALUES;
use std::sync::atomic::Ordering;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// A thread of the service that ended by a panic.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("the {0} thread of the service has failed")]
pub struct ThreadFailed(&'static str);

impl Service {
    /// Starts the threads of a flight.
    pub fn start(flight: Flight) -> std::io::Result<Self> {
        launch::launch(flight, None)
    }

    /// Starts the threads of a flight; every solved frame also goes to the returned receiver.
    pub fn start_watched(flight: Flight) -> std::io::Result<(Self, Receiver<SolvedFrame>)> {
        let (sink, frames) = unbounded();
        Ok((launch::launch(flight, Some(sink))?, frames))
    }

    /// Settings and values that the ground may set.
    pub fn controls(&self) -> &Controls {
        &self.controls
    }

    /// Asks the cameras to end after the frames they are taking; everything else follows.
    pub fn stop(&self) {
        self.signals.stop.store(true, Ordering::Relaxed);
    }

    /// As [`stop`](Self::stop); work that is not finished after this time is abandoned.
    pub fn stop_within(&self, time: Duration) {
        self.stop();
        self.signals
            .deadline
            .lock()
            .get_or_insert(Instant::now() + time);
    }

    /// Whether the last frame has been solved and stored.
    pub fn is_finished(&self) -> bool {
        self.signals.finished.load(Ordering::Acquire) || self.watch.is_finished()
    }

    /// The housekeeping sent last; `None` in the first second.
    pub fn housekeeping(&self) -> Option<Housekeeping> {
        self.signals.housekeeping.copy()
    }

    /// Counts so far, with the latencies of the last moment.
    pub fn tally(&self) -> FlightTally {
        let mut tally = self.tallies.brief();
        tally.restarts = self.signals.restarts.load(Ordering::Relaxed);
        tally
    }

    /// State of the archive's disks.
    pub fn disks(&self) -> Vec<DiskHealth> {
        self.tallies.archive.disks()
    }

    /// Pictures that wait for a disk.
    pub fn waiting_pictures(&self) -> usize {
        self.tallies.archive.waiting()
    }

    /// Waits for the last frame, closes the line, and returns the counts.
    pub fn join(self) -> Result<FlightTally, ThreadFailed> {
        self.signals.awaited.store(true, Ordering::Relaxed);
        let tally = self.watch.join().map_err(|_| ThreadFailed("watch"));
        // A watch that has failed has reported nothing.
        self.signals.closing.store(true, Ordering::Relaxed);
        let begin = Instant::now();
        let is_saving = |values: &JoinHandle<u64>| !values.is_finished();
        while self.values.as_ref().is_some_and(is_saving) && begin.elapsed() < SAVED_VALUES {
            thread::sleep(Duration::from_millis(1));
        }
        tally
    }
}
