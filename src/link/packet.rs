//! Packets: a header, a checksum and a payload. The content of the payload is described in [`message`](super::message).
//!
//! All numbers are little-endian. The checksum is CRC-16/MODBUS over the whole packet with the checksum's own
//! two bytes zero; it alone is stored high byte first.
//!
//! | packet | 0-1 | 2 | 3 | 4-5 | 6-7 | then |
//! |---|---|---|---|---|---|---|
//! | command | sync | target | payload length | sequence number | checksum | payload |
//! | telemetry | sync | type | source | payload length | checksum | nanoseconds (u32), seconds (u32), payload |
//!
//! Source: HEROES flight program, 2013; samples of an IMU are this project's.

use super::number::Codes;
use crc::{CRC_16_MODBUS, Crc, Table};

/// The two bytes with which every packet begins: 0xC39A, little-endian.
pub const SYNC: [u8; 2] = 0xC39A_u16.to_le_bytes();
/// Length of a command packet's header, bytes.
pub const COMMAND_HEADER: usize = 8;
/// Length of a telemetry packet's header, bytes.
pub const TELEMETRY_HEADER: usize = 16;

const CHECKSUM_AT: usize = 6;
/// Sixteen bytes per step: a parser may have to check many false headers that claim long packets.
static MODBUS: Crc<u16, Table<16>> = Crc::<u16, Table<16>>::new(&CRC_16_MODBUS);

/// Ids of the recipients and senders of packets.
pub mod id {
    pub const CONTROLLER: u8 = 0x01;
    pub const ASPECT: u8 = 0x30;
    pub const EVERYONE: u8 = 0xFF;
}

/// The ids with names.
#[rustfmt::skip] // One row, one line.
pub static PARTIES: Codes = Codes { name: "party", rows: &[
    (id::CONTROLLER as u16, "controller", "the controller"),
    (id::ASPECT as u16, "aspect_system", "the aspect system"),
    (id::EVERYONE as u16, "everyone", "everyone"),
] };

/// The types of telemetry.
pub mod telemetry_type {
    pub const RECEIPT: u8 = 0x01;
    pub const IDLE: u8 = 0x03;
    pub const HOUSEKEEPING: u8 = 0x70;
    pub const IMU: u8 = 0x71;
    pub const CAMERA: u8 = 0x72;
    pub const MARKS: u8 = 0x73;
    pub const PICTURE: u8 = 0x82;
    pub const PICTURE_TAG: u8 = 0x83;
    pub const RESULT: u8 = 0xE1;
}

/// Direction in which the bytes of a line run. Telemetry runs to the controller only, except for samples of the IMU;
/// so the interpretation of a header depends on the direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    ToController,
    ToAspect,
}

/// Reason why bytes are not a packet, or a payload does not fit one.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    #[error("packet: expected the sync word c39a at its start, found {found:02x?}")]
    Sync { found: Vec<u8> },
    #[error("packet: expected {expected} bytes, found {found}")]
    Length { expected: usize, found: usize },
    #[error("packet: expected checksum {expected:04x}, found {found:04x}")]
    Checksum { expected: u16, found: u16 },
    #[error("packet: expected a payload of at most {limit} bytes, found {found}")]
    Payload { limit: usize, found: usize },
}

/// A command packet, in either direction: it carries the messages of both sides.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CommandPacket {
    target: u8,
    sequence: u16,
    payload: Vec<u8>,
}

impl CommandPacket {
    /// A packet for `target`; the payload holds at most 255 bytes.
    pub fn new(target: u8, sequence: u16, payload: Vec<u8>) -> Result<Self, PacketError> {
        fits(&payload, u8::MAX.into())?;
        Ok(Self {
            target,
            sequence,
            payload,
        })
    }

    pub fn target(&self) -> u8 {
        self.target
    }

    pub fn sequence(&self) -> u16 {
        self.sequence
    }

    pub fn payload(&self) -> &[u8] {
        &self.payload
    }

    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(COMMAND_HEADER + self.payload.len());
        bytes.extend(SYNC);
        bytes.extend([self.target, self.payload.len() as u8]);
        bytes.extend(self.sequence.to_le_bytes());
        bytes.extend([0, 0]);
        bytes.extend(&self.payload);
        sealed(bytes)
    }
}

/// A telemetry packet: a report of the aspect system that is not part of the control loop.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TelemetryPacket {
    kind: u8,
    source: u8,
    seconds: u32,
    nanoseconds: u32,
    payload: Vec<u8>,
}

impl TelemetryPacket {
    /// A packet of type `kind` made at `seconds` and `nanoseconds` UTC; the payload holds at most 65535 bytes.
    pub fn new(
        kind: u8,
        source: u8,
        (seconds, nanoseconds): (u32, u32),
        payload: Vec<u8>,
    ) -> Result<Self, PacketError> {
        fits(&payload, u16::MAX.into())?;
        Ok(Self {
            kind,
            source,
            seconds,
            nanoseconds,
            payload,
        })
    }

    /// The type, one of [`telemetry_type`].
    pub fn kind(&self) -> u8 {
        self.kind
    }

    pub fn source(&self) -> u8 {
        self.source
    }

    /// Time at which the packet was made, from its header: seconds and nanoseconds UTC since 1970.
    pub fn time(&self) -> (u32, u32) {
        (self.seconds, self.nanoseconds)
    }

    pub fn payload(&self) -> &[u8] {
        &self.payload
    }

    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(TELEMETRY_HEADER + self.payload.len());
        bytes.extend(SYNC);
        bytes.extend([self.kind, self.source]);
        bytes.extend((self.payload.len() as u16).to_le_bytes());
        bytes.extend([0, 0]);
        bytes.extend(self.nanoseconds.to_le_bytes());
        bytes.extend(self.seconds.to_le_bytes());
        bytes.extend(&self.payload);
        sealed(bytes)
    }
}

/// A packet of either form.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Packet {
    Command(CommandPacket),
    Telemetry(TelemetryPacket),
}

impl Packet {
    /// The length that a packet beginning with `bytes` states; `None` until its header is complete.
    pub fn length(direction: Direction, bytes: &[u8]) -> Option<usize> {
        let (kind, source) = (*bytes.get(2)?, *bytes.get(3)?);
        if is_telemetry(direction, kind, source) {
            let payload = u16::from_le_bytes([*bytes.get(4)?, *bytes.get(5)?]);
            Some(TELEMETRY_HEADER + usize::from(payload))
        } else {
            Some(COMMAND_HEADER + usize::from(source))
        }
    }

    /// Reads exactly one packet.
    pub fn decode(direction: Direction, bytes: &[u8]) -> Result<Self, PacketError> {
        if !bytes.starts_with(&SYNC) {
            let found = bytes.iter().take(2).copied().collect();
            return Err(PacketError::Sync { found });
        }
        let expected = Self::length(direction, bytes).unwrap_or(COMMAND_HEADER);
        if bytes.len() != expected {
            let found = bytes.len();
            return Err(PacketError::Length { expected, found });
        }
        verify(bytes)?;
        let u16_at = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let u32_at = |at: usize| u32::from(u16_at(at)) | u32::from(u16_at(at + 2)) << 16;
        Ok(if is_telemetry(direction, bytes[2], bytes[3]) {
            Self::Telemetry(TelemetryPacket {
                kind: bytes[2],
                source: bytes[3],
                seconds: u32_at(12),
                nanoseconds: u32_at(8),
                payload: bytes[TELEMETRY_HEADER..].to_vec(),
            })
        } else {
            Self::Command(CommandPacket {
                target: bytes[2],
                sequence: u16_at(4),
                payload: bytes[COMMAND_HEADER..].to_vec(),
            })
        })
    }

    pub fn encode(&self) -> Vec<u8> {
        match self {
            Self::Command(packet) => packet.encode(),
            Self::Telemetry(packet) => packet.encode(),
        }
    }
}

/// Both forms share one sync word. A type of telemetry is no id of a target, except for 0x01: there the next byte
/// decides, since no command has a payload as long as the aspect system's id (48 bytes).
fn is_telemetry(direction: Direction, kind: u8, source: u8) -> bool {
    use telemetry_type::*;
    match (direction, kind) {
        (Direction::ToAspect, kind) => kind == IMU,
        (Direction::ToController, RECEIPT) => source == id::ASPECT,
        (Direction::ToController, kind) => {
            matches!(
                kind,
                IDLE | HOUSEKEEPING | CAMERA | MARKS | PICTURE | PICTURE_TAG | RESULT
            )
        }
    }
}

fn fits(payload: &[u8], limit: usize) -> Result<(), PacketError> {
    let found = payload.len();
    if found > limit {
        return Err(PacketError::Payload { limit, found });
    }
    Ok(())
}

/// The checksum of a packet of at least a header's length, with its own field set to zero.
fn checksum(bytes: &[u8]) -> u16 {
    let mut digest = MODBUS.digest();
    digest.update(&bytes[..CHECKSUM_AT]);
    digest.update(&[0, 0]);
    digest.update(&bytes[CHECKSUM_AT + 2..]);
    digest.finalize()
}

fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let stored = checksum(&bytes).to_be_bytes();
    bytes[CHECKSUM_AT..CHECKSUM_AT + 2].copy_from_slice(&stored);
    bytes
}

fn verify(bytes: &[u8]) -> Result<(), PacketError> {
    let expected = checksum(bytes);
    let found = u16::from_be_bytes([bytes[CHECKSUM_AT], bytes[CHECKSUM_AT + 1]]);
    if found != expected {
        return Err(PacketError::Checksum { expected, found });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use Direction::*;

    /// "Stop tracking", sequence number 8, in the form of the HEROES flight program.
    const STOP: [u8; 10] = [0x9a, 0xc3, 0x30, 2, 8, 0, 0x6f, 0x33, 1, 0x10];

    #[test]
    fn a_packet_with_any_one_bit_wrong_is_refused() {
        assert!(Packet::decode(ToAspect, &STOP).is_ok());
        for bit in 0..8 * STOP.len() {
            let mut bytes = STOP;
            bytes[bit / 8] ^= 1 << (bit % 8);
            assert!(Packet::decode(ToAspect, &bytes).is_err(), "bit {bit}");
        }
    }

    #[test]
    fn a_packet_cut_short_or_run_on_is_refused() {
        for length in 0..STOP.len() {
            assert!(Packet::decode(ToAspect, &STOP[..length]).is_err());
        }
        let run_on = [&STOP[..], &[0]].concat();
        let (expected, found) = (10, 11);
        assert_eq!(
            Packet::decode(ToAspect, &run_on),
            Err(PacketError::Length { expected, found })
        );
    }

    #[test]
    fn telemetry_is_known_by_its_type_and_its_way() {
        let header = |kind, source| [SYNC[0], SYNC[1], kind, source, 7, 1];
        for kind in [0x03, 0x70, 0x72, 0x73, 0x82, 0x83, 0xE1] {
            assert_eq!(
                Packet::length(ToController, &header(kind, 0x30)),
                Some(16 + 263)
            );
            assert_eq!(Packet::length(ToAspect, &header(kind, 0x30)), Some(8 + 48));
        }
        assert_eq!(Packet::length(ToAspect, &header(0x71, 1)), Some(16 + 263));
        assert_eq!(Packet::length(ToController, &header(0x71, 1)), Some(8 + 1));
        assert_eq!(
            Packet::length(ToController, &header(0x01, 0x30)),
            Some(16 + 263)
        );
        assert_eq!(
            Packet::length(ToController, &header(0x01, 0x28)),
            Some(8 + 40)
        );
        assert_eq!(Packet::length(ToController, &header(0x82, 0x30)[..5]), None);
    }

    #[test]
    fn a_payload_too_long_for_its_length_field_is_refused() {
        assert!(CommandPacket::new(id::ASPECT, 1, vec![0; 255]).is_ok());
        assert!(CommandPacket::new(id::ASPECT, 1, vec![0; 256]).is_err());
        assert!(TelemetryPacket::new(0x82, id::ASPECT, (0, 0), vec![0; 65536]).is_err());
    }
}
