//! The gondola's IMU and GPS receiver, which speak in time.

use super::navigation::{NoFlight, TelescopeFlight};
use crate::link::{AnyPort, BytePort, ImuPacket, PortError};
use std::time::Duration;

/// How long a packet or a sentence waits for room.
const WRITE_TIMEOUT: Duration = Duration::from_millis(10);

/// What becomes of a sample before it is sent; `None` where it is lost.
pub type Spoil = Box<dyn FnMut(ImuPacket) -> Option<ImuPacket> + Send>;

/// The sensors of a simulated flight.
pub struct Sensors {
    flight: TelescopeFlight,
    spoil: Spoil,
    /// Where the receiver speaks; it is silent without.
    gps: Option<AnyPort>,
    /// How far the flight was when the clock of the caller began.
    ahead: Duration,
    /// The next sample and the next second of the receiver.
    sample: u64,
    second: u64,
}

/// Why the sensors are silent.
#[derive(Debug, thiserror::Error)]
pub enum SensorError {
    #[error(transparent)]
    Port(#[from] PortError),
    #[error("the flight cannot be simulated: {0}")]
    Flight(#[from] NoFlight),
}

impl Sensors {
    /// Sensors that begin when the flight is `ahead` of its start.
    pub fn new(flight: TelescopeFlight, gps: Option<AnyPort>, ahead: Duration) -> Self {
        let (rate, ahead_s) = (flight.rate_hz(), ahead.as_secs());
        Self {
            sample: ahead_s * rate + 1,
            second: ahead_s + 1,
            flight,
            spoil: Box::new(Some),
            gps,
            ahead,
        }
    }

    /// The same with an IMU that is not what it should be.
    pub fn spoilt(self, spoil: Spoil) -> Self {
        Self { spoil, ..self }
    }

    /// How long there is nothing to say.
    pub fn wait(&self, now: Duration) -> Duration {
        self.due().saturating_sub(self.ahead + now)
    }

    /// When the next sample's interval ends, since the flight's start.
    fn due(&self) -> Duration {
        Duration::from_nanos(self.sample * 1_000_000_000 / self.flight.rate_hz())
    }

    /// Says what is due: samples over the controller's line, sentences over the receiver's own.
    ///
    /// # Errors
    /// A lost port, and a flight that goes where nothing points.
    pub fn speak(&mut self, port: &mut dyn BytePort, now: Duration) -> Result<(), SensorError> {
        while self.wait(now).is_zero() {
            let sample = self.flight.sample(self.sample)?;
            self.sample += 1;
            // Of its numbers each fits its packet, but for some of a spoilt one: an IMU sends no such packet.
            if let Some(Ok(packet)) = (self.spoil)(sample).map(|sample| sample.packet()) {
                write(port, &packet.encode())?;
            }
            if self.due() > Duration::from_secs(self.second) {
                let sentences = self.flight.sentences(self.second)?;
                self.second += 1;
                if let Some(gps) = &mut self.gps {
                    write(gps.as_mut(), sentences.as_bytes())?;
                }
            }
        }
        Ok(())
    }
}

/// What nobody takes is lost, as on a wire.
fn write(port: &mut dyn BytePort, bytes: &[u8]) -> Result<(), PortError> {
    match port.write(bytes, WRITE_TIMEOUT) {
        Err(PortError::Stalled { .. }) => {
            port.discard_backlog();
            Ok(())
        }
        written => written,
    }
}
