//! A byte log: the bytes that came over a line, with their times. Each line of text holds the UTC time of the bytes as seconds since 1970 with nine
//! decimals, a space, and the bytes in hexadecimal. Lines that begin with `#` are remarks.

mod reader;

pub use reader::{BadLine, Kind, LogError, Reader, Skipped};

use super::hex::hex;
use super::packet::{Direction, Packet, PacketError};
use super::parser::{Parser, Rejected};
use jiff::Timestamp;
use std::time::Duration;

/// The first line of a log.
pub const HEADER: &str = "# solaspect byte log: UTC seconds since 1970, bytes in hexadecimal";

/// Bytes that came at one time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Burst {
    pub time: Timestamp,
    pub bytes: Vec<u8>,
}

impl std::fmt::Display for Burst {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let nanosecond = self.time.as_nanosecond();
        let (seconds, rest) = (
            nanosecond.div_euclid(1_000_000_000),
            nanosecond.rem_euclid(1_000_000_000),
        );
        write!(out, "{seconds}.{rest:09} {}", hex(&self.bytes))
    }
}

/// Reads a whole log.
pub fn read(bytes: &[u8]) -> (Vec<Burst>, Reader) {
    let mut reader = Reader::default();
    let mut bursts = reader.feed(bytes);
    bursts.extend(reader.finish());
    (bursts, reader)
}

/// Contents of a log.
#[derive(Debug, Clone, PartialEq)]
pub struct Contents {
    /// Packets, with the times at which they were complete.
    pub packets: Vec<(Timestamp, Packet)>,
    /// Bytes and lines that belonged to no packet.
    pub rejected: Rejected,
    /// Reasons for the first 16 rejections.
    pub reasons: Vec<PacketError>,
}

/// The packets of a log.
pub fn packets(bursts: &[Burst], direction: Direction) -> Contents {
    let mut parser = Parser::new(direction);
    let mut found = Vec::new();
    let since_1970 = |time: Timestamp| Duration::try_from(time.as_duration()).unwrap_or_default();
    let mut last = Duration::ZERO;
    for Burst { time, bytes } in bursts {
        last = since_1970(*time);
        let packets = parser.feed(bytes, last);
        found.extend(packets.into_iter().map(|packet| (*time, packet)));
    }
    parser.feed(&[], last + Duration::from_secs(1));
    Contents {
        packets: found,
        rejected: parser.rejected(),
        reasons: parser.reasons().to_vec(),
    }
}

/// The direction for which more of the bytes form packets.
pub fn likely_direction(bursts: &[Burst]) -> Direction {
    let rejected = |direction| packets(bursts, direction).rejected.bytes;
    match rejected(Direction::ToAspect) < rejected(Direction::ToController) {
        true => Direction::ToAspect,
        false => Direction::ToController,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::hex::from_hex;

    #[test]
    fn a_log_is_read_as_it_was_written() {
        let bursts = ["9ac30102", "01007e310011"].map(|bytes| Burst {
            time: Timestamp::new(1_379_786_400, 5_000_001).unwrap(),
            bytes: from_hex(bytes).unwrap(),
        });
        let text = format!("{HEADER}\n{}\n{}\n", bursts[0], bursts[1]);
        assert!(text.contains("\n1379786400.005000001 9ac30102\n"), "{text}");
        let read = read(text.as_bytes()).0;
        assert_eq!(read, bursts);
        assert_eq!(likely_direction(&read), Direction::ToController);
        let found = packets(&read, Direction::ToController);
        assert_eq!(found.packets.len(), 1);
        assert_eq!(
            (found.rejected, found.reasons),
            (Rejected::default(), vec![])
        );
    }

    #[test]
    fn a_pause_within_a_packet_breaks_it_as_it_did_on_the_line() {
        let text = "1.0 9ac30102\n1.2 01007e310011\n";
        let found = packets(&read(text.as_bytes()).0, Direction::ToController);
        assert!(found.packets.is_empty());
        assert_eq!((found.rejected.bytes, found.rejected.packets), (10, 1));
        let (expected, found_bytes) = (10, 4);
        let cut = PacketError::Length {
            expected,
            found: found_bytes,
        };
        assert_eq!(found.reasons, [cut]);
    }

    #[test]
    fn a_wrong_checksum_is_the_reason_of_a_rejected_packet() {
        let text = "1.0 9ac3300208006f340110\n";
        let found = packets(&read(text.as_bytes()).0, Direction::ToAspect);
        let (expected, found_sum) = (0x6f33, 0x6f34);
        let wrong = PacketError::Checksum {
            expected,
            found: found_sum,
        };
        assert_eq!(found.reasons, [wrong]);
    }
}
