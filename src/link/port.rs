//! Ports: they carry bytes in and out, and every wait has a timeout.

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use serialport::{DataBits, FlowControl, Parity, StopBits, TTYPort};
use std::io::{self, ErrorKind, Read, Write};
use std::net::SocketAddr;
use std::os::fd::AsRawFd;
use std::time::{Duration, Instant};

/// Baud rate of the controller's line, bit/s; 8 data bits, no parity, 1 stop bit.
pub const BAUD: u32 = 115_200;
/// Most bytes that one system call is asked to write.
const CHUNK: usize = 256;

/// Reason why a port failed.
#[derive(Debug, thiserror::Error)]
pub enum PortError {
    #[error("serial port {name}: cannot be opened: {cause}")]
    Open {
        name: String,
        cause: serialport::Error,
    },
    #[error("serial port {name}: another program has it open")]
    InUse { name: String },
    #[error("{name}: expected a serial port, found something else")]
    NotSerial { name: String },
    #[error("{name}: cannot be opened: {cause}")]
    Udp { name: String, cause: io::Error },
    #[error("serial port {name}: lost: {cause}")]
    Lost { name: String, cause: io::Error },
    #[error(
        "serial port {name}: the other end does not read: {written} of {length} bytes in {timeout:?}"
    )]
    Stalled {
        name: String,
        written: usize,
        length: usize,
        timeout: Duration,
    },
}

/// A carrier of bytes in both directions. Tests use their own instead of a serial line.
pub trait BytePort {
    /// Reads received bytes, waiting at most `timeout` for the first byte; returns 0 if none has come.
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize, PortError>;

    /// Sender of the datagram that was read last; `None` if none came, and for a wire.
    fn sender(&self) -> Option<SocketAddr> {
        None
    }

    /// Writes all bytes, one packet at a time, or fails after `timeout`; the error states how many were written by then.
    fn write(&mut self, bytes: &[u8], timeout: Duration) -> Result<(), PortError>;

    /// Bytes that have been written and are still on this machine, as far as the system reports.
    fn backlog(&mut self) -> usize {
        0
    }

    /// Drops the backlog: bytes not taken in time are too old to be taken later.
    fn discard_backlog(&mut self) {}
}

/// A serial line, or one end of a pseudo-terminal.
#[derive(Debug)]
pub struct SerialPort {
    name: String,
    port: TTYPort,
}

impl SerialPort {
    /// Opens a serial device, 8N1 without flow control, at `baud` (bit/s; the controller's is [`BAUD`]).
    pub fn open(name: &str, baud: u32) -> Result<Self, PortError> {
        let builder = serialport::new(name, baud)
            .data_bits(DataBits::Eight)
            .parity(Parity::None)
            .stop_bits(StopBits::One)
            .flow_control(FlowControl::None);
        let port = builder.open_native().map_err(|cause| {
            let name = name.into();
            // The crate's message if another program holds the lock, and its message for an ordinary file.
            match cause.description.as_str() {
                said if said.contains("exclusive lock") => PortError::InUse { name },
                said if said == Errno::ENOTTY.desc() => PortError::NotSerial { name },
                _ => PortError::Open { name, cause },
            }
        })?;
        Self::non_blocking(name.into(), port)
    }

    /// The two ends of a new pseudo-terminal. The second one has a device name, too.
    pub fn pair() -> Result<(Self, Self), PortError> {
        let name = "pseudo-terminal";
        let (near, far) = TTYPort::pair().map_err(|cause| PortError::Open {
            name: name.into(),
            cause,
        })?;
        let far_name = serialport::SerialPort::name(&far).unwrap_or_else(|| name.into());
        let near = Self::non_blocking(format!("{far_name} (near end)"), near)?;
        Ok((near, Self::non_blocking(far_name, far)?))
    }

    /// The device's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Without this, a write that exceeds the system's buffer would wait for the reader indefinitely, whatever the
    /// port's timeout.
    fn non_blocking(name: String, port: TTYPort) -> Result<Self, PortError> {
        let descriptor = port.as_raw_fd();
        let set = fcntl(descriptor, FcntlArg::F_GETFL).and_then(|flags| {
            let flags = OFlag::from_bits_truncate(flags) | OFlag::O_NONBLOCK;
            fcntl(descriptor, FcntlArg::F_SETFL(flags))
        });
        match set {
            Ok(_) => Ok(Self { name, port }),
            Err(errno) => Err(PortError::Open {
                name,
                cause: io::Error::from(errno).into(),
            }),
        }
    }

    fn wait_at_most(&mut self, timeout: Duration) -> Result<(), PortError> {
        serialport::SerialPort::set_timeout(&mut self.port, timeout)
            .map_err(|error| self.lost(error.into()))
    }

    fn lost(&self, cause: io::Error) -> PortError {
        PortError::Lost {
            name: self.name.clone(),
            cause,
        }
    }
}

impl BytePort for SerialPort {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize, PortError> {
        if buffer.is_empty() {
            return Ok(0);
        }
        self.wait_at_most(timeout)?;
        match self.port.read(buffer) {
            Ok(0) => Err(self.lost(ErrorKind::UnexpectedEof.into())),
            Ok(count) => Ok(count),
            Err(error) if means_later(&error) => Ok(0),
            Err(error) => Err(self.lost(error)),
        }
    }

    fn write(&mut self, bytes: &[u8], timeout: Duration) -> Result<(), PortError> {
        let start = Instant::now();
        let mut rest = bytes;
        while !rest.is_empty() {
            let left = timeout.saturating_sub(start.elapsed());
            self.wait_at_most(left)?;
            match self.port.write(&rest[..rest.len().min(CHUNK)]) {
                Ok(count) => rest = &rest[count..],
                Err(error) if means_later(&error) => {}
                Err(error) => return Err(self.lost(error)),
            }
            if !rest.is_empty() && start.elapsed() >= timeout {
                return Err(PortError::Stalled {
                    name: self.name.clone(),
                    written: bytes.len() - rest.len(),
                    length: bytes.len(),
                    timeout,
                });
            }
        }
        Ok(())
    }

    fn backlog(&mut self) -> usize {
        let waiting = serialport::SerialPort::bytes_to_write(&self.port);
        waiting.map_or(0, |bytes| bytes as usize)
    }

    fn discard_backlog(&mut self) {
        // If this fails, the next write will fail, too.
        let _ = serialport::SerialPort::clear(&self.port, serialport::ClearBuffer::Output);
    }
}

pub(super) fn means_later(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHORT: Duration = Duration::from_millis(20);
    const LONG: Duration = Duration::from_secs(10);

    #[test]
    fn every_byte_value_passes_both_ways_unchanged() {
        let (mut near, mut far) = SerialPort::pair().unwrap();
        let sent: Vec<u8> = (0..=255).collect();
        let pass = |from: &mut SerialPort, to: &mut SerialPort| {
            from.write(&sent, LONG).unwrap();
            let (mut read, mut buffer) = (Vec::new(), [0; 100]);
            while read.len() < sent.len() {
                let count = to.read(&mut buffer, LONG).unwrap();
                assert!(count > 0, "{} bytes came", read.len());
                read.extend_from_slice(&buffer[..count]);
            }
            assert_eq!(read, sent);
        };
        pass(&mut near, &mut far);
        pass(&mut far, &mut near);
    }

    #[test]
    fn silence_is_no_error() {
        let (mut near, _far) = SerialPort::pair().unwrap();
        assert_eq!(near.read(&mut [0; 8], SHORT).unwrap(), 0);
    }

    #[test]
    fn a_write_that_nobody_takes_ends() {
        let (mut near, _far) = SerialPort::pair().unwrap();
        let error = near.write(&[0x55; 1_000_000], SHORT).unwrap_err();
        let PortError::Stalled {
            written, length, ..
        } = error
        else {
            panic!("{error}");
        };
        assert!(0 < written && written < length);
    }

    #[test]
    fn a_lost_line_is_said_at_once_on_reading_and_on_writing() {
        let (mut near, far) = SerialPort::pair().unwrap();
        drop(far);
        assert!(matches!(
            near.read(&mut [0; 8], LONG),
            Err(PortError::Lost { .. })
        ));
        assert!(matches!(
            near.write(b"bytes", LONG),
            Err(PortError::Lost { .. })
        ));
    }

    #[test]
    fn a_port_that_another_program_holds_is_said_to_be_in_use() {
        let (_near, far) = SerialPort::pair().unwrap();
        let held = SerialPort::open(far.name(), BAUD).unwrap();
        let error = SerialPort::open(far.name(), BAUD).unwrap_err();
        assert!(matches!(error, PortError::InUse { .. }), "{error}");
        drop(held);
        SerialPort::open(far.name(), BAUD).unwrap();
    }

    #[test]
    fn a_device_that_is_not_there_is_named() {
        let error = SerialPort::open("/nowhere/tty", BAUD)
            .unwrap_err()
            .to_string();
        assert!(
            error.starts_with("serial port /nowhere/tty: cannot be opened"),
            "{error}"
        );
    }

    #[test]
    fn the_far_end_can_be_opened_by_its_name() {
        let (mut near, far) = SerialPort::pair().unwrap();
        let mut opened = SerialPort::open(far.name(), BAUD).unwrap();
        near.write(b"x", LONG).unwrap();
        let mut buffer = [0; 4];
        assert_eq!(opened.read(&mut buffer, LONG).unwrap(), 1);
        assert_eq!(buffer[0], b'x');
    }
}
