//! The controller's end of the demonstration's line.

use super::faults::Faults;
use crate::link::{AnyPort, BytePort, PortError, SerialPort};
use std::time::Duration;

/// Longest wait for the ground to accept data that the controller relays.
const GROUND_TIMEOUT: Duration = Duration::from_millis(5);

/// The controller's end of the line, with the ground behind it: everything that the controller receives goes to the ground as well, and packets
/// from the ground go to the aspect system. While the line is cut nothing passes, in either direction.
pub(super) struct Relayed {
    pub line: SerialPort,
    pub ground: Option<AnyPort>,
    pub faults: Faults,
}

impl BytePort for Relayed {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize, PortError> {
        if let Some(ground) = &mut self.ground {
            let mut commands = [0; 1024];
            let count = ground.read(&mut commands, Duration::ZERO).unwrap_or(0);
            let count = self.faults.passed(count);
            self.line.write(&commands[..count], timeout)?;
        }
        let count = self.line.read(buffer, timeout)?;
        let count = self.faults.passed(count);
        if let Some(ground) = &mut self.ground {
            // A ground that does not listen loses it.
            let _ = ground.write(&buffer[..count], GROUND_TIMEOUT);
        }
        Ok(count)
    }

    fn write(&mut self, bytes: &[u8], timeout: Duration) -> Result<(), PortError> {
        let count = self.faults.passed(bytes.len());
        self.line.write(&bytes[..count], timeout)
    }
}
