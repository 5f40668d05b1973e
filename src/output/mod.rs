//! Outputs of a flight for other programs, beside the controller's line: solutions as JSON lines or NMEA sentences, telemetry as CCSDS space packets.
//!
//! ```text
//! Report (a solved frame) \
//!                          Message -> Encoder (format) -> bytes -> Endpoint (destination)
//! TelemetryPacket         /
//! ```
//!
//! Nothing here starts a thread or waits for longer than a write may take: the flight service owns the loop. `docs/outputs.md` describes the fields.

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

    /// Name in the configuration.
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

/// A message to be sent. Copies share its content.
#[derive(Debug, Clone)]
pub enum Message {
    Solution(Arc<Report>),
    Telemetry(Arc<TelemetryPacket>),
}

/// Result of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Name of the camera's table in the configuration.
    pub camera: String,
    /// The camera's number on the controller's line.
    pub number: u8,
    /// The row without the picture's file: the picture is stored later, if at all.
    pub row: LoggedRow,
}

/// Encodes messages.
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

    /// The bytes of a message; `None` if the format does not carry it, or it does not fit.
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
