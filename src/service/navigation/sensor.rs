//! A sensor with a line of its own: the IMU if it does not send on the controller's, and the GPS receiver. A lost line is opened
//! again.

use super::inputs::Inputs;
use crate::clock::FlightClock;
use crate::link::{Connection, Direction, Packet, Parser, PortError};
use crate::log::worth_a_line;
use crate::navigation::nmea::{Heard, Nmea};
use crate::service::messages::{Input, TakesSamples};
use crate::service::shared::Shared;
use crate::service::tally::NavigationTally;
use crate::service::worker::Life;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How long a thread waits for bytes before it shows that it is at work.
const PATIENCE: Duration = Duration::from_millis(100);
/// More than the longest datagram.
const READ_BYTES: usize = 2048;

/// The format of a sensor's data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Speaks {
    /// Telemetry packets of type 0x71.
    Imu,
    /// NMEA 0183.
    Gps,
}

impl Speaks {
    /// The name of its thread.
    pub fn name(self) -> &'static str {
        match self {
            Self::Imu => "imu",
            Self::Gps => "gps",
        }
    }
}

/// A sensor's thread. Its successive lives share the line: the port outlives a thread that panicked.
#[derive(Clone)]
pub(super) struct Sensor {
    pub connection: Arc<Mutex<Connection>>,
    pub speaks: Speaks,
    pub inputs: Inputs,
    pub tally: Shared<NavigationTally>,
    pub ended: Arc<AtomicBool>,
    pub clock: FlightClock,
}

impl Sensor {
    /// Listens until the flight ends, or another thread has taken over.
    pub fn run(&self, life: &Life) {
        let mut connection = self
            .connection
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let mut packets = Parser::new(Direction::ToAspect);
        let mut sentences = Nmea::default();
        // Noise bytes of the lives before.
        let noise_before = self.tally.lock().gps.noise_bytes;
        let start = Instant::now();
        let mut buffer = [0; READ_BYTES];
        while !life.is_over() && !self.ended.load(Ordering::Relaxed) {
            life.beat();
            connection.revive(start.elapsed());
            let count = match self.read(&mut connection, &mut buffer) {
                Ok(count) => count,
                Err(error) => {
                    tracing::error!(sensor = self.speaks.name(), %error, "a sensor's line is lost");
                    connection.lose(start.elapsed());
                    continue;
                }
            };
            let bytes = &buffer[..count];
            match self.speaks {
                Speaks::Imu => {
                    let read = Instant::now();
                    for packet in packets.feed(bytes, start.elapsed()) {
                        if let Packet::Telemetry(packet) = packet {
                            self.inputs.take_sample(&packet, read);
                        }
                    }
                }
                Speaks::Gps => {
                    let heard = sentences.feed(bytes, self.clock.now());
                    let mut tally = self.tally.lock();
                    heard.iter().for_each(|heard| tally.note_gps(heard));
                    tally.note_gps_noise(noise_before + sentences.noise_bytes());
                    drop(tally);
                    for heard in heard {
                        if let Heard::Fix(fix) = heard {
                            self.inputs.take(Input::Fix(fix));
                        }
                    }
                }
            }
        }
    }

    /// Reads received bytes; of datagrams, only those of the sensor.
    fn read(&self, connection: &mut Connection, buffer: &mut [u8]) -> Result<usize, PortError> {
        let Some(port) = connection.port() else {
            std::thread::sleep(PATIENCE);
            return Ok(0);
        };
        let count = port.read(buffer, PATIENCE)?;
        let Some(sender) = port.sender() else {
            return Ok(count);
        };
        match connection.guard().open(&buffer[..count], sender) {
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
}
