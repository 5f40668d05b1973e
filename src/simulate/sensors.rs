//! The gondola's IMU and GPS receiver, which send in real time.

use super::navigation::{NoFlight, TelescopeFlight};
use crate::link::{AnyPort, BytePort, ImuPacket, PortError};
use jiff::{SignedDuration, Timestamp};
use std::time::Duration;

/// How long a packet or a sentence waits for space.
const WRITE_TIMEOUT: Duration = Duration::from_millis(10);

/// Change of a sample before it is sent; `None` if it is lost.
pub type Corrupt = Box<dyn FnMut(ImuPacket) -> Option<ImuPacket> + Send>;

/// The sensors of a simulated flight. They are silent until they [join](Self::join) its cameras.
pub struct Sensors {
    flight: TelescopeFlight,
    corrupt: Corrupt,
    /// The receiver's port; it is silent without one.
    gps: Option<AnyPort>,
    /// Lead of the flight over the caller's clock.
    ahead: Option<SignedDuration>,
    /// The next sample.
    sample: u64,
    second: u64,
}

/// Reason why the sensors are silent.
#[derive(Debug, thiserror::Error)]
pub enum SensorError {
    #[error(transparent)]
    Port(#[from] PortError),
    #[error("the flight cannot be simulated: {0}")]
    Flight(#[from] NoFlight),
}

impl Sensors {
    pub fn new(flight: TelescopeFlight, gps: Option<AnyPort>) -> Self {
        Self {
            sample: 1,
            second: 1,
            flight,
            corrupt: Box::new(Some),
            gps,
            ahead: None,
        }
    }

    /// Starts the sensors at this time of the flight, rounded down to a second, unless they send already. `now` is the caller's clock, as in
    /// [`speak`](Self::speak).
    pub fn join(&mut self, utc: Timestamp, now: Duration) {
        let since_start = utc.duration_since(self.flight.start());
        let (None, Ok(second)) = (self.ahead, u64::try_from(since_start.as_secs())) else {
            return;
        };
        self.ahead = since_start.checked_sub(signed(now));
        self.sample = second * self.flight.rate_hz() + 1;
        self.second = second + 1;
    }

    /// The same with an IMU whose samples are changed.
    pub fn corrupted(self, corrupt: Corrupt) -> Self {
        Self { corrupt, ..self }
    }

    /// Time until the next data are due.
    pub fn wait(&self, now: Duration) -> Duration {
        let Some(ahead) = self.ahead else {
            return Duration::MAX;
        };
        let left = signed(self.due())
            .saturating_sub(signed(now))
            .saturating_sub(ahead);
        Duration::try_from(left).unwrap_or_default()
    }

    /// End of the next sample's interval, since the flight's start.
    fn due(&self) -> Duration {
        Duration::from_nanos(self.sample * 1_000_000_000 / self.flight.rate_hz())
    }

    /// Sends data that are due: samples over the controller's line, sentences over the receiver's own.
    ///
    /// # Errors
    /// If the controller's port is lost, or the flight has no attitude at this time.
    pub fn speak(&mut self, port: &mut dyn BytePort, now: Duration) -> Result<(), SensorError> {
        while self.wait(now).is_zero() {
            let sample = self.flight.sample(self.sample)?;
            self.sample += 1;
            // All its numbers fit the packet, except for some of a corrupted sample: an IMU sends no such packet.
            if let Some(Ok(packet)) = (self.corrupt)(sample).map(|sample| sample.packet()) {
                write(port, &packet.encode())?;
            }
            if self.due() > Duration::from_secs(self.second) {
                let sentences = self.flight.sentences(self.second)?;
                self.second += 1;
                self.say(&sentences);
            }
        }
        Ok(())
    }

    /// Sends sentences of the receiver, until the other end closes its line: at the end of a flight it does so before the controller.
    fn say(&mut self, sentences: &str) {
        let said = self
            .gps
            .as_mut()
            .map(|gps| write(gps.as_mut(), sentences.as_bytes()));
        if let Some(Err(error)) = said {
            tracing::info!(%error, "the simulated GPS receiver has no reader any more");
            self.gps = None;
        }
    }
}

fn signed(duration: Duration) -> SignedDuration {
    SignedDuration::try_from(duration).unwrap_or(SignedDuration::MAX)
}

/// Bytes without a reader are lost, as on a wire.
fn write(port: &mut dyn BytePort, bytes: &[u8]) -> Result<(), PortError> {
    match port.write(bytes, WRITE_TIMEOUT) {
        Err(PortError::Stalled { .. }) => {
            port.discard_backlog();
            Ok(())
        }
        written => written,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instrument::builtin;
    use crate::link::SerialPort;
    use crate::simulate::{FORT_SUMNER, Trajectory};

    const LONG: Duration = Duration::from_secs(10);

    #[test]
    fn sensors_join_a_flight_that_has_begun_in_the_second_of_its_first_announced_exposure() {
        let start: Timestamp = "2013-09-21T18:00:00Z".parse().unwrap();
        let demo = builtin("demo").unwrap();
        let path = Trajectory::flight(&demo, 547.0, 1).unwrap();
        let flight = TelescopeFlight::new(path, &demo, FORT_SUMNER, start, 1);
        let (mut near, mut far) = SerialPort::pair().unwrap();
        let (mut receiver, gps) = SerialPort::pair().unwrap();
        let mut sensors = Sensors::new(flight, Some(Box::new(gps)));
        // The caller's clock has run for 50 s before the flight begins.
        let now = Duration::from_secs(50);
        sensors.speak(&mut near, now).unwrap();
        assert_eq!(sensors.wait(now), Duration::MAX);
        sensors.join(start + Duration::from_millis(7_250), now);
        sensors.join(start, now);
        sensors.speak(&mut near, now).unwrap();
        let mut buffer = [0; 4096];
        let mut parser = crate::link::Parser::new(crate::link::Direction::ToAspect);
        let count = far.read(&mut buffer, LONG).unwrap();
        let packets = parser.feed(&buffer[..count], Duration::ZERO);
        let crate::link::Packet::Telemetry(first) = &packets[0] else {
            panic!("{packets:?}");
        };
        let sample = ImuPacket::decode(first).unwrap();
        assert_eq!(sample.time, start + Duration::from_millis(7_010));
        // The next second of the receiver is due in 0.75 s.
        sensors
            .speak(&mut near, now + Duration::from_millis(800))
            .unwrap();
        let count = receiver.read(&mut buffer, LONG).unwrap();
        let said = String::from_utf8_lossy(&buffer[..count]).into_owned();
        assert!(said.contains("180008"), "{said}");
    }
}
