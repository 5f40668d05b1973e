//! A sensor with a line of its own: the IMU if it does not send on the controller's, and the GPS receiver. A lost line is opened
//! again.

use super::inputs::Inputs;
use crate::clock::FlightClock;
use crate::link::{Connection, Direction, Packet, Parser, PortError};
use crate::log::worth_a_line;
use crate::navigation::nmea::{Nmea, Received};
use crate::service::messages::{Input, ReceivesSamples};
use crate::service::shared::Shared;
use crate::service::tally::NavigationTally;
use crate::service::worker::Heartbeat;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How long a thread waits for bytes before it shows that it is at work.
const TIMEOUT: Duration = Duration::from_millis(100);
/// More than the longest datagram.
const READ_BYTES: usize = 2048;

/// The format of a sensor's data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SensorKind {
    /// Telemetry packets of type 0x71.
    Imu,
    /// NMEA 0183.
    Gps,
}

impl SensorKind {
    /// The name of its thread.
    pub fn name(self) -> &'static str {
        match self {
            Self::Imu => "imu",
            Self::Gps => "gps",
        }
    }
}

/// A sensor's thread. Restarts of it share the line: the port outlives a thread that panicked.
#[derive(Clone)]
pub(super) struct Sensor {
    pub connection: Arc<Mutex<Connection>>,
    pub kind: SensorKind,
    pub inputs: Inputs,
    pub tally: Shared<NavigationTally>,
    pub ended: Arc<AtomicBool>,
    pub clock: FlightClock,
}

impl Sensor {
    /// Listens until the flight ends, or another thread has taken over.
    pub fn run(&self, heartbeat: &Heartbeat) {
        let mut connection = self
            .connection
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let mut packets = Parser::new(Direction::ToAspect);
        let mut sentences = Nmea::default();
        // Noise bytes before the last restart.
        let noise_before = self.tally.lock().gps.noise_bytes;
        let start = Instant::now();
        let mut buffer = [0; READ_BYTES];
        while !heartbeat.is_replaced() && !self.ended.load(Ordering::Relaxed) {
            heartbeat.beat();
            connection.revive(start.elapsed());
            let count = match self.read(&mut connection, &mut buffer) {
                Ok(count) => count,
                Err(error) => {
                    tracing::error!(sensor = self.kind.name(), %error, "a sensor's line is lost");
                    connection.lose(start.elapsed());
                    continue;
                }
            };
            let bytes = &buffer[..count];
            match self.kind {
                SensorKind::Imu => {
                    let read = Instant::now();
                    for packet in packets.feed(bytes, start.elapsed()) {
                        if let Packet::Telemetry(packet) = packet {
                            self.inputs.receive_sample(&packet, read);
                        }
                    }
                }
                SensorKind::Gps => {
                    let read = sentences.feed(bytes, self.clock.now());
                    let mut tally = self.tally.lock();
                    read.iter().for_each(|one| tally.note_gps(one));
                    tally.note_gps_noise(noise_before + sentences.noise_bytes());
                    drop(tally);
                    for one in read {
                        if let Received::Fix(fix) = one {
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
            std::thread::sleep(TIMEOUT);
            return Ok(0);
        };
        let count = port.read(buffer, TIMEOUT)?;
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
