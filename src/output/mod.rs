//! Outputs of a flight for other programs, beside the controller's line: solutions as JSON lines or NMEA sentences, telemetry as CCSDS space packets.
//!
//! ```text
//! Report (a solved frame) \
//!                          Message -> Encoder (format) -> bytes -> Endpoint (destination)
//! TelemetryPacket         /
//! ```
//!
//! Nothing here starts a thread or waits for longer than a write may take: the flight service owns the loop. `docs/outputs.md` has the fields.

mod ccsds;
mod destination;
mod endpoint;
mod jsonl;
mod nmea;

pub use destination::{Destination, NoDestination};
pub use endpoint::{Endpoint, Went};

use crate::link::TelemetryPacket;
use crate::record::LoggedRow;
use ccsds::Sequences;
use std::sync::Arc;

/// Format of an output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// A JSON object on a line for each solved frame.
    Jsonl,
    /// A sentence of NMEA 0183 for each solved frame.
    Nmea,
    /// A CCSDS space packet for each telemetry packet of the controller's line.
    Ccsds,
}

impl Format {
    pub const KINDS: [Self; 3] = [Self::Jsonl, Self::Nmea, Self::Ccsds];
    pub const NAMES: &'static [&'static str] = &["jsonl", "nmea", "ccsds"];

    /// As the configuration gives it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Jsonl => "jsonl",
            Self::Nmea => "nmea",
            Self::Ccsds => "ccsds",
        }
    }

    /// Whether it carries solved frames.
    pub fn carries_solutions(self) -> bool {
        matches!(self, Self::Jsonl | Self::Nmea)
    }

    /// Whether it carries telemetry packets.
    pub fn carries_telemetry(self) -> bool {
        self == Self::Ccsds
    }
}

/// Message to go out. Copies share it.
#[derive(Debug, Clone)]
pub enum Message {
    Solution(Arc<Report>),
    Telemetry(Arc<TelemetryPacket>),
}

/// Result of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// The camera's table in the configuration.
    pub camera: String,
    /// Its number on the controller's line.
    pub number: u8,
    /// Without the picture's file: it is stored later, if at all.
    pub row: LoggedRow,
}

/// Makes the bytes of messages.
#[derive(Debug)]
pub struct Encoder {
    format: Format,
    sequences: Sequences,
}

impl Encoder {
    pub fn new(format: Format) -> Self {
        let sequences = Sequences::default();
        Self { format, sequences }
    }

    /// The bytes of a message; `None` where the format does not carry it, or cannot hold it.
    pub fn encode(&mut self, message: &Message) -> Option<Vec<u8>> {
        match (self.format, message) {
            (Format::Jsonl, Message::Solution(report)) => jsonl::line(report),
            (Format::Nmea, Message::Solution(report)) => Some(nmea::sentence(report).into_bytes()),
            (Format::Ccsds, Message::Telemetry(packet)) => {
                let sequence = self.sequences.next(packet.kind());
                ccsds::space_packet(packet, sequence)
            }
            _ => None,
        }
    }
}
