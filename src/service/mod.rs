//! The flight service: every long-lived thread, channel, bound and overflow rule on one page.
//!
//! ```text
//!            Sighting (8)            pictures (queue_frames)
//!  camera ----------------> solver ------------------------> archive-1, archive-2    frames
//!    |                        | \____ rows (10,000) ________> log-1, log-2            log, telemetry
//!    |                        |  \___ Answer (unbounded, only when watched) ---> watcher
//!    |  LinkEvent (256)       |
//!    +----------------------> link <----> controller, over a byte port
//!                             |
//!                Controls (shared): what the ground sets, read by the solver; changes ---> values (saved in a file)
//! ```
//!
//! | channel | holds | when it is full |
//! |---|---|---|
//! | Sighting | frames to solve | the frame is lost and counted: a camera does not wait |
//! | pictures | solved frames to store | by the rule `archive.overflow` a picture is given up, and counted; solving goes on |
//! | rows | rows of the log | the row is lost and counted |
//! | LinkEvent | exposures about to start, solutions | the event is dropped and counted: the line is stuck |
//!
//! A thread ends when the channel it reads from is closed: the camera ends first, then solver and archive, each after
//! the last of its work. The link goes on answering commands until the service is joined. A thread that panics is noticed
//! then.

mod archiver;
pub mod control;
pub mod demo;
mod line;
mod protocol;
mod solver;
mod tally;

pub use archiver::DiskHealth;
pub use protocol::protocol_page;
pub use solver::Answer;
pub use tally::{ArchiveTally, CameraTally, FlightTally, LineTally, SolverTally};

use tally::worth_a_line;

use crate::archive::Store;
use crate::camera::{Exposure, FrameSource, Take};
use crate::config::Config;
use crate::instrument::Instrument;
use crate::link::{self, CameraRole, Connection};
use crate::pointing::Target;
use crate::sky::Ephemeris;
use control::{Controls, Keeper};
use crossbeam_channel::{Receiver, Sender, TrySendError, bounded, unbounded};
use jiff::Timestamp;
use line::{Line, LinkEvent};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Instant;

/// Frames that may wait for the solver: a third of a second at 26 frames/s.
const SIGHTINGS: usize = 8;
/// Events that may wait for the line.
const LINK_EVENTS: usize = 256;

/// The one pitch-yaw camera's number.
const CAMERA: u16 = 1;

/// What a flight is made of.
pub struct Flight {
    pub instrument: Instrument,
    pub config: Config,
    /// Where the telescope should point until a command says otherwise.
    pub target: Target,
    pub ephemeris: Ephemeris,
    pub camera: Box<dyn FrameSource>,
    /// The line to the controller.
    pub line: Connection,
    /// The archives on the disks, the preferred one first; none where frames are not kept.
    pub stores: Vec<Store>,
}

/// A frame on its way from the camera, with the moment it arrived.
struct Sighting {
    exposure: Exposure,
    arrived: Instant,
}

/// A camera's place in the flight.
#[derive(Debug, Clone)]
pub struct Station {
    /// Among the flight's cameras, from 0.
    pub index: usize,
    pub role: CameraRole,
    pub instrument: Instrument,
    /// Of its frames and logs under the archive's root; empty for the root itself.
    pub folder: PathBuf,
}

impl Station {
    /// As the link counts cameras, from 1.
    fn camera_number(&self) -> u16 {
        self.index as u16 + 1
    }
}

/// A running service.
pub struct Service {
    camera: JoinHandle<CameraTally>,
    solver: JoinHandle<SolverTally>,
    archive: archiver::Threads,
    gauges: archiver::Gauges,
    line: JoinHandle<LineTally>,
    /// Only where values set by command are saved.
    values: Option<JoinHandle<u64>>,
    controls: Controls,
    stop: Arc<AtomicBool>,
    hang_up: Arc<AtomicBool>,
}

/// A thread of the service that ended by a panic.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("the {0} thread of the service has failed")]
pub struct ThreadFailed(&'static str);

impl Service {
    /// Starts the threads of a flight.
    pub fn start(flight: Flight) -> std::io::Result<Self> {
        Self::launch(flight, None)
    }

    /// Starts the threads of a flight; every answer goes to the watcher, too.
    pub fn start_watched(flight: Flight) -> std::io::Result<(Self, Receiver<Answer>)> {
        let (watcher, answers) = unbounded();
        Ok((Self::launch(flight, Some(watcher))?, answers))
    }

    fn launch(flight: Flight, watcher: Option<Sender<Answer>>) -> std::io::Result<Self> {
        let config = flight.config;
        let (to_solver, sightings) = bounded(SIGHTINGS);
        let (to_line, events) = bounded(LINK_EVENTS);
        let stop = Arc::new(AtomicBool::new(false));
        let saved_values = config.link.saved_values.clone();
        let controls = Controls::new(config, flight.target, flight.instrument.mounting);
        if let Some(path) = &saved_values {
            control::restore(&controls, path);
        }
        let line = Line::new(flight.line, controls.clone());
        let station = Arc::new(Station {
            index: 0,
            role: CameraRole::PitchYaw,
            instrument: flight.instrument,
            folder: PathBuf::new(),
        });
        let folders = [station.folder.clone()];
        let (archive, archive_threads) =
            archiver::start(flight.stores, &folders, &controls, &flight.ephemeris)?;
        let gauges = archive.gauges();
        let solver = solver::Solver {
            station,
            ephemeris: flight.ephemeris,
            controls: controls.clone(),
            archive,
            to_line: to_line.clone(),
            watcher,
        };
        let mut camera = flight.camera;
        let stopped = Arc::clone(&stop);
        let hang_up = Arc::new(AtomicBool::new(false));
        let hung_up = Arc::clone(&hang_up);
        let values = match saved_values {
            Some(path) => {
                let (keeper, ends) = (Keeper::new(controls.clone(), path), Arc::clone(&hang_up));
                Some(spawn("values", move || keeper.run(&ends))?)
            }
            None => None,
        };
        Ok(Self {
            line: spawn("link", move || line.run(&events, &hung_up))?,
            archive: archive_threads,
            gauges,
            solver: spawn("solver", move || solver.run(&sightings))?,
            camera: spawn("camera", move || {
                take_frames(camera.as_mut(), &to_solver, &to_line, &stopped)
            })?,
            values,
            controls,
            stop,
            hang_up,
        })
    }

    /// What the ground sets and reads.
    pub fn controls(&self) -> &Controls {
        &self.controls
    }

    /// Asks the camera to end after the frame it is taking; everything else follows.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Whether the last frame has been solved and stored.
    pub fn is_finished(&self) -> bool {
        self.solver.is_finished() && self.archive.are_finished()
    }

    /// How the archive's disks are.
    pub fn disks(&self) -> Vec<DiskHealth> {
        self.gauges.disks()
    }

    /// Pictures that wait for a disk.
    pub fn waiting_pictures(&self) -> usize {
        self.gauges.waiting()
    }

    /// Waits for the last frame, hangs up, and says what happened.
    pub fn join(self) -> Result<FlightTally, ThreadFailed> {
        let camera = self.camera.join().map_err(|_| ThreadFailed("camera"));
        let solver = self.solver.join().map_err(|_| ThreadFailed("solver"));
        let archived = self.archive.join();
        self.hang_up.store(true, Ordering::Relaxed);
        let line = self.line.join().map_err(|_| ThreadFailed("link"));
        if let Some(values) = self.values {
            values.join().map_err(|_| ThreadFailed("values"))?;
        }
        Ok(FlightTally {
            camera: camera?,
            solver: solver?,
            archive: match archived {
                true => self.gauges.tally(),
                false => return Err(ThreadFailed("archive")),
            },
            line: line?,
        })
    }
}

fn spawn<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> std::io::Result<JoinHandle<T>> {
    thread::Builder::new().name(name.into()).spawn(work)
}

/// The camera's thread: announces each exposure on the line, then hands the frame to the solver.
fn take_frames(
    camera: &mut dyn FrameSource,
    to_solver: &Sender<Sighting>,
    to_line: &Sender<LinkEvent>,
    stop: &AtomicBool,
) -> CameraTally {
    let mut tally = CameraTally::default();
    while !stop.load(Ordering::Relaxed) {
        let mut announce = |time: Timestamp| {
            let (camera, start) = (CAMERA, time);
            let event = LinkEvent::ExposureStarts(link::Exposure { camera, start });
            if to_line.try_send(event).is_err() {
                tally.unannounced += 1;
                if worth_a_line(tally.unannounced) {
                    tracing::warn!("the line is stuck: an exposure was not announced");
                }
            }
        };
        match camera.next(&mut announce) {
            Ok(Take::Exposure(exposure)) => {
                tally.taken += 1;
                let sighting = Sighting {
                    exposure: *exposure,
                    arrived: Instant::now(),
                };
                if let Err(TrySendError::Full(_)) = to_solver.try_send(sighting) {
                    tally.lost += 1;
                    tracing::warn!(
                        lost = tally.lost,
                        "the solver cannot follow: a frame was lost"
                    );
                }
            }
            Ok(Take::NotYet) => {}
            Ok(Take::End) => break,
            Err(error) => {
                tally.failed += 1;
                if worth_a_line(tally.failed) {
                    tracing::error!(%error, failed = tally.failed, "no frame from the camera");
                }
            }
        }
    }
    tally
}
