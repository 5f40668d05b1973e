//! A sensor with a line of its own: the IMU where it does not speak on the controller's, and the GPS receiver. A line that is lost is opened
//! again.

use super::NavigationTally;
use super::inputs::{Input, Inputs};
use crate::link::{Connection, Direction, Packet, Parser, PortError};
use crate::navigation::nmea::Nmea;
use crate::service::shared::Shared;
use crate::service::tally::worth_a_line;
use crate::service::worker::Life;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long a thread waits for bytes before it shows that it is at work.
const PATIENCE: Duration = Duration::from_millis(100);
/// More than the longest datagram.
const READ_BYTES: usize = 2048;

/// What a sensor speaks.
pub(super) enum Speech {
    /// Telemetry packets of type 0x71.
    Imu(Parser),
    Gps(Nmea),
}

impl Speech {
    pub fn imu() -> Self {
        Self::Imu(Parser::new(Direction::ToAspect))
    }

    pub fn gps() -> Self {
        Self::Gps(Nmea::default())
    }
}

/// Listens to a sensor.
pub(super) struct Sensor<'a> {
    pub connection: &'a mut Connection,
    pub speech: Speech,
    pub inputs: Inputs,
    pub tally: Shared<NavigationTally>,
    pub ended: Arc<AtomicBool>,
}

impl Sensor<'_> {
    /// Listens until the flight ends, or another thread has taken over.
    pub fn run(mut self, life: &Life) {
        let start = Instant::now();
        let mut buffer = [0; READ_BYTES];
        while !life.is_over() && !self.ended.load(Ordering::Relaxed) {
            life.beat();
            self.connection.revive(start.elapsed());
            match self.read(&mut buffer) {
                Ok(count) => self.hear(&buffer[..count], start.elapsed()),
                Err(error) => {
                    tracing::error!(%error, "a sensor's line is lost");
                    self.connection.lose(start.elapsed());
                }
            }
        }
    }

    /// Reads what has come; of datagrams those of the sensor alone.
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, PortError> {
        let Some(port) = self.connection.port() else {
            std::thread::sleep(PATIENCE);
            return Ok(0);
        };
        let count = port.read(buffer, PATIENCE)?;
        let Some(sender) = port.sender() else {
            return Ok(count);
        };
        let guard = self.connection.guard();
        match guard.open(&buffer[..count], sender) {
            Ok(_) => Ok(count),
            Err(refusal) => {
                let mut tally = self.tally.lock();
                tally.unreadable += 1;
                if worth_a_line(tally.unreadable) {
                    tracing::warn!(%sender, %refusal, "a sensor's datagram was refused");
                }
                Ok(0)
            }
        }
    }

    fn hear(&mut self, bytes: &[u8], now: Duration) {
        match &mut self.speech {
            Speech::Imu(parser) => {
                let read = Instant::now();
                for packet in parser.feed(bytes, now) {
                    if let Packet::Telemetry(packet) = packet {
                        self.inputs.tell_imu(&packet, read);
                    }
                }
            }
            Speech::Gps(receiver) => {
                for fix in receiver.feed(bytes) {
                    self.inputs.tell(Input::Fix(fix));
                }
                self.tally.lock().sentences = receiver.counts();
            }
        }
    }
}
