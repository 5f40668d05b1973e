//! The link's thread: it alone reads and writes the port.

use super::Commanded;
use super::tally::{LineTally, worth_a_line};
use crate::aspect::Stopped;
use crate::link::{
    BytePort, Change, CommandPacket, Direction, Packet, Parser, PortError, Responder, Solution,
};
use crate::pointing::{HelioprojectiveArcsec, Offset, Target};
use crate::units::Place;
use crossbeam_channel::{Receiver, RecvTimeoutError};
use jiff::Timestamp;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How long the thread waits for something to send before it looks whether something came.
const PATIENCE: Duration = Duration::from_millis(1);
const WRITE_TIMEOUT: Duration = Duration::from_millis(200);
/// Error code of a frame whose Sun was found but whose time or place is not known.
const NO_OFFSET: u16 = 100;

/// What the link is told.
pub(super) enum LinkEvent {
    ExposureStarts(Timestamp),
    Outcome(Outcome),
}

/// What came of an exposure.
pub(super) struct Outcome {
    pub announced: Timestamp,
    pub arrived: Instant,
    pub offset: Option<Offset>,
    pub stopped: Option<Stopped>,
}

pub(super) struct Settings {
    /// One solution in so many is sent.
    pub solution_divisor: u64,
    /// An older solution is not sent any more.
    pub max_age: Duration,
}

pub(super) struct Line {
    port: Option<Box<dyn BytePort + Send>>,
    responder: Responder,
    parser: Parser,
    settings: Settings,
    commanded: Arc<Mutex<Commanded>>,
    start: Instant,
    outcomes: u64,
    tally: LineTally,
}

impl Line {
    pub fn new(
        port: Option<Box<dyn BytePort + Send>>,
        responder: Responder,
        settings: Settings,
        commanded: Arc<Mutex<Commanded>>,
    ) -> Self {
        Self {
            port,
            responder,
            parser: Parser::new(Direction::ToAspect),
            settings,
            commanded,
            start: Instant::now(),
            outcomes: 0,
            tally: LineTally::default(),
        }
    }

    /// Talks while camera and solver work, and from then on listens until it is to hang up.
    pub fn run(mut self, events: &Receiver<LinkEvent>, hang_up: &AtomicBool) -> LineTally {
        loop {
            match events.recv_timeout(PATIENCE) {
                Ok(LinkEvent::ExposureStarts(time)) => self.announce(time),
                Ok(LinkEvent::Outcome(outcome)) => self.conclude(&outcome),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) if hang_up.load(Ordering::Relaxed) => {
                    return self.tally;
                }
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(PATIENCE),
            }
            self.listen();
        }
    }

    fn announce(&mut self, time: Timestamp) {
        match self.responder.exposure_starts(time) {
            Ok(Some(packet)) => {
                if self.send(&packet) {
                    self.tally.announced += 1;
                } else {
                    self.responder.forget_exposure(time);
                }
            }
            Ok(None) => {}
            Err(error) => tracing::error!(%error, "an exposure was not announced"),
        }
    }

    fn conclude(&mut self, outcome: &Outcome) {
        self.outcomes += 1;
        let due = (self.outcomes - 1).is_multiple_of(self.settings.solution_divisor);
        if !due {
            return self.responder.forget_exposure(outcome.announced);
        }
        if outcome.arrived.elapsed() > self.settings.max_age {
            self.tally.outdated += 1;
            return self.responder.forget_exposure(outcome.announced);
        }
        let time = outcome.announced;
        let packet = match &outcome.offset {
            Some(offset) => self.responder.solution(&Solution {
                azimuth_deg: offset.azimuth_deg,
                elevation_deg: offset.elevation_deg,
                roll_deg: 0.0,
                error_deg: offset.sigma_deg,
                time,
            }),
            None => self.responder.error(error_code(outcome.stopped), time),
        };
        match packet {
            Ok(Some(packet)) => {
                if self.send(&packet) {
                    if outcome.offset.is_some() {
                        self.tally.solutions += 1;
                        self.tally.note_latency(outcome.arrived.elapsed());
                    } else {
                        self.tally.errors += 1;
                    }
                }
            }
            Ok(None) => {}
            Err(error) => tracing::error!(%error, "a solution was not sent"),
        }
    }

    /// Reads what has come and answers it.
    fn listen(&mut self) {
        let Some(port) = &mut self.port else { return };
        let mut buffer = [0; 512];
        let count = match port.read(&mut buffer, Duration::ZERO) {
            Ok(count) => count,
            Err(error) => return self.lose(&error),
        };
        for packet in self.parser.feed(&buffer[..count], self.start.elapsed()) {
            if let Packet::Command(packet) = packet {
                self.obey(&packet);
            }
        }
    }

    fn obey(&mut self, packet: &CommandPacket) {
        match self.responder.handle(packet, Timestamp::now()) {
            Ok(reply) => {
                self.tally.commands += u64::from(!reply.packets.is_empty());
                for answer in reply.packets {
                    self.send(&answer);
                }
                if let Some(change) = reply.change {
                    self.apply(change);
                }
            }
            Err(error) => tracing::error!(%error, "a command was not answered"),
        }
    }

    fn apply(&self, change: Change) {
        tracing::info!(?change, "by command");
        let mut commanded = self
            .commanded
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        match change {
            Change::Target { x_arcsec, y_arcsec } => {
                commanded.target = Target::Fixed(HelioprojectiveArcsec {
                    x: f64::from(x_arcsec),
                    y: f64::from(y_arcsec),
                });
            }
            Change::Place(fix) => {
                let height_m = commanded.place.map_or(0.0, |place| place.height_m);
                let (latitude, longitude) = (fix.latitude_deg.into(), fix.longitude_deg.into());
                commanded.place = Place::new(latitude, longitude, height_m).ok();
            }
            Change::Tracking { .. } | Change::Sending { .. } => {}
        }
    }

    /// Whether the port took the packet.
    fn send(&mut self, packet: &[u8]) -> bool {
        let Some(port) = &mut self.port else {
            return false;
        };
        match port.write(packet, WRITE_TIMEOUT) {
            Ok(()) => true,
            Err(error) => {
                self.tally.failed += 1;
                if matches!(error, PortError::Lost { .. }) {
                    self.lose(&error);
                } else if worth_a_line(self.tally.failed) {
                    tracing::warn!(%error, failed = self.tally.failed, "a packet was not sent");
                }
                false
            }
        }
    }

    fn lose(&mut self, error: &PortError) {
        tracing::error!(%error, "the line is lost");
        self.port = None;
    }
}

/// The code of a frame without a solution: 1 to 7 for the stage that it did not pass.
fn error_code(stopped: Option<Stopped>) -> u16 {
    stopped.map_or(NO_OFFSET, |stopped| stopped.stage as u16 + 1)
}
