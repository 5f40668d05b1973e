//! Telemetry: answers to commands, and the table of its types.

use super::fields::{MessageError, Reader, Wire, Writer, fields, unix_time};
use super::imu::Sample;
use super::number::Field;
use super::packet::Direction::{self, ToAspect, ToController};
use super::packet::{TelemetryPacket, id, telemetry_type};
use jiff::Timestamp;

fields! {
    /// The command with this sequence number has arrived.
    Receipt, format!("receipt of seq {sequence}") => {
        sequence: u16, "", "sequence number of the command";
    }

    /// What came of a command.
    CommandOutcome, format!("result of seq {sequence}") => {
        sequence: u16, "", "sequence number of the command";
        key: u16, "", "key of the message, or of the aspect command with its computers";
        value: u16, "", "0 done, 1 not implemented, 2 refused, 65535 unknown, or what a read has read";
    }

    /// What is counted of a camera that is not the first of its role.
    CameraCounts, format!("camera {camera}: {fine} fine, {coarse} coarse, {none} none, {lost} lost") => {
        camera: u16, "", "number of the camera, as in its pictures";
        role: u16, "", "number of its role";
        fine: u32, "", "frames solved finely";
        coarse: u32, "", "frames solved coarsely";
        none: u32, "", "frames that show nothing, or are not solved";
        lost: u32, "", "frames that the camera or the solver lost";
    }
}

impl CameraCounts {
    /// The counts of a second as a packet made at `time`.
    pub fn packet(&self, time: Timestamp) -> Result<TelemetryPacket, MessageError> {
        let kind = telemetry_type::CAMERA;
        let mut out = Writer::after_key(kind.into());
        Self::write(self, &mut out, "camera counts")?;
        let time = unix_time(kind.into(), time)?;
        Ok(TelemetryPacket::new(kind, id::ASPECT, time, out.finish())?)
    }

    /// Reads the packet.
    pub fn decode(packet: &TelemetryPacket) -> Result<Self, MessageError> {
        let kind = packet.kind();
        if kind != telemetry_type::CAMERA {
            return Err(MessageError::UnknownTelemetry { kind });
        }
        let mut input = Reader::after_key(kind.into(), packet.payload());
        Self::read(&mut input, "camera counts")
    }
}

/// A type of telemetry.
#[derive(Debug, Clone, Copy)]
pub struct TelemetryRow {
    pub kind: u8,
    pub name: &'static str,
    pub direction: Direction,
    pub payload: Payload,
    pub documentation: &'static str,
}

/// What a telemetry packet carries.
#[derive(Debug, Clone, Copy)]
pub enum Payload {
    Fields(fn() -> Vec<Field>),
    /// The layout's number, and the fields of [`housekeeping::FIELDS`](super::housekeeping::FIELDS) that it has.
    Housekeeping,
    PictureSection,
    PictureTag,
}

const fn row(
    kind: u8,
    name: &'static str,
    direction: Direction,
    payload: Payload,
    documentation: &'static str,
) -> TelemetryRow {
    TelemetryRow {
        kind,
        name,
        direction,
        payload,
        documentation,
    }
}

/// The types of telemetry.
#[rustfmt::skip] // One row, one line.
pub const TELEMETRY: &[TelemetryRow] = &[
    row(telemetry_type::RECEIPT, "receipt", ToController, Payload::Fields(|| Receipt::fields(&[])), "a command has arrived"),
    row(telemetry_type::IDLE, "idle", ToController, Payload::Fields(Vec::new), "nothing to report"),
    row(telemetry_type::HOUSEKEEPING, "housekeeping", ToController, Payload::Housekeeping, "status, each second"),
    row(telemetry_type::IMU, "imu_sample", ToAspect, Payload::Fields(|| Sample::fields(&[])), "a sample of the IMU; the header's time is the end of its interval"),
    row(telemetry_type::CAMERA, "camera_counts", ToController, Payload::Fields(|| CameraCounts::fields(&[])), "each second for every camera that is not the first of its role"),
    row(telemetry_type::PICTURE, "picture_section", ToController, Payload::PictureSection, "pixels of a picture, row by row"),
    row(telemetry_type::PICTURE_TAG, "picture_tag", ToController, Payload::PictureTag, "a keyword of a picture"),
    row(telemetry_type::RESULT, "result", ToController, Payload::Fields(|| CommandOutcome::fields(&[])), "what came of a command"),
];

/// What a telemetry packet of the link says: every command is answered by a receipt and a result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Telemetry {
    Receipt(Receipt),
    Result(CommandOutcome),
}

impl Telemetry {
    /// The answer as a packet made at `time`.
    pub fn packet(&self, time: Timestamp) -> Result<TelemetryPacket, MessageError> {
        let kind = match self {
            Self::Receipt(_) => telemetry_type::RECEIPT,
            Self::Result(_) => telemetry_type::RESULT,
        };
        let mut out = Writer::after_key(kind.into());
        match self {
            Self::Receipt(receipt) => Receipt::write(receipt, &mut out, "receipt")?,
            Self::Result(outcome) => CommandOutcome::write(outcome, &mut out, "result")?,
        }
        let time = unix_time(kind.into(), time)?;
        Ok(TelemetryPacket::new(kind, id::ASPECT, time, out.finish())?)
    }

    /// Reads a receipt or a result.
    pub fn decode(packet: &TelemetryPacket) -> Result<Self, MessageError> {
        let kind = packet.kind();
        let mut input = Reader::after_key(kind.into(), packet.payload());
        match kind {
            telemetry_type::RECEIPT => Receipt::read(&mut input, "receipt").map(Self::Receipt),
            telemetry_type::RESULT => CommandOutcome::read(&mut input, "result").map(Self::Result),
            kind => Err(MessageError::UnknownTelemetry { kind }),
        }
    }
}
