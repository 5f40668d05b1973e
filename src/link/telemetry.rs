//! Telemetry: answers to commands, and the table of its types.

use super::fields::{MessageError, Reader, Wire, Writer, fields, unix_time};
use super::housekeeping::{ids_in_words, saturated};
use super::imu::Sample;
use super::number::Field;
use super::packet::Direction::{self, ToAspect, ToController};
use super::packet::{TelemetryPacket, id, telemetry_type};
use jiff::Timestamp;

/// Number of ids of marks that fit into a packet.
pub const MOST_MARK_IDS: usize = 32;

fields! {
    /// The command with this sequence number has arrived.
    Receipt, format!("receipt of seq {sequence}") => {
        sequence: u16, "", "sequence number of the command";
    }

    /// Result of a command.
    CommandOutcome, format!("result of seq {sequence}") => {
        sequence: u16, "", "sequence number of the command";
        key: u16, "", "key of the message, or of the aspect command with its computers";
        value: u16, "", "0 done, 1 not implemented, 2 refused, 65535 unknown, or the value read";
    }

    /// Counts of a camera that is not the first of its role.
    CameraCounts, format!("camera {camera}: {fine} fine, {coarse} coarse, {none} none, {lost} lost") => {
        camera: u16, "", "number of the camera, as in its pictures";
        role: u16, "", "number of its role";
        fine: u32, "", "fine frames";
        coarse: u32, "", "coarse frames";
        none: u32, "", "frames that show nothing, or were not solved";
        lost: u32, "", "frames that the camera or the solver lost";
    }

    /// The marks identified in a frame of a plate of another pattern than that of 2013. Housekeeping of the same time has the rest.
    FrameMarks, format!("camera {camera}, frame {number}: {marks} marks, ids {}", ids_in_words(ids_of(*marks, mark_ids))) => {
        camera: u16, "", "number of the camera, as in its pictures";
        number: u32, "", "number of its latest frame";
        marks: u16, "", "marks with ids in that frame";
        mark_ids: [[i16; 2]; MOST_MARK_IDS], "", "i and j of each of the first 32 of them; places after the last mark are 0";
    }
}

/// A payload as a packet of the given type, made at `time`; `name` is its name in errors.
fn packed<T: Wire>(
    kind: u8,
    name: &'static str,
    payload: &T,
    time: Timestamp,
) -> Result<TelemetryPacket, MessageError> {
    let mut out = Writer::after_key(kind.into());
    T::write(payload, &mut out, name)?;
    let time = unix_time(kind.into(), time)?;
    Ok(TelemetryPacket::new(kind, id::ASPECT, time, out.finish())?)
}

/// The payload of a packet, which must be of the given type.
fn unpacked<T: Wire>(
    kind: u8,
    name: &'static str,
    packet: &TelemetryPacket,
) -> Result<T, MessageError> {
    if packet.kind() != kind {
        let kind = packet.kind();
        return Err(MessageError::UnknownTelemetry { kind });
    }
    let mut input = Reader::after_key(kind.into(), packet.payload());
    T::read(&mut input, name)
}

impl CameraCounts {
    /// The counts of a second as a packet made at `time`.
    pub fn packet(&self, time: Timestamp) -> Result<TelemetryPacket, MessageError> {
        packed(telemetry_type::CAMERA, "camera counts", self, time)
    }

    /// Reads the packet.
    pub fn decode(packet: &TelemetryPacket) -> Result<Self, MessageError> {
        unpacked(telemetry_type::CAMERA, "camera counts", packet)
    }
}

impl FrameMarks {
    /// The first [`MOST_MARK_IDS`] of the ids, and their total number. `None` if an id does not fit 16 bits: no other value may replace it.
    pub fn new(camera: u16, number: u32, ids: &[[i32; 2]]) -> Option<Self> {
        let mut mark_ids = [[0; 2]; MOST_MARK_IDS];
        for (place, [i, j]) in mark_ids.iter_mut().zip(ids) {
            *place = [i16::try_from(*i).ok()?, i16::try_from(*j).ok()?];
        }
        Some(Self {
            camera,
            number,
            marks: saturated(ids.len() as u64),
            mark_ids,
        })
    }

    /// The ids in the packet.
    pub fn ids(&self) -> impl Iterator<Item = [i32; 2]> {
        ids_of(self.marks, &self.mark_ids)
    }

    /// The marks of a second as a packet made at `time`.
    pub fn packet(&self, time: Timestamp) -> Result<TelemetryPacket, MessageError> {
        packed(telemetry_type::MARKS, "frame marks", self, time)
    }

    /// Reads the packet.
    pub fn decode(packet: &TelemetryPacket) -> Result<Self, MessageError> {
        unpacked(telemetry_type::MARKS, "frame marks", packet)
    }
}

/// The elements of a packet that hold the ids of `marks` marks.
fn ids_of(marks: u16, mark_ids: &[[i16; 2]]) -> impl Iterator<Item = [i32; 2]> {
    let ids = mark_ids.iter().take(marks.into());
    ids.map(|id| id.map(i32::from))
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

/// Content of a telemetry packet.
#[derive(Debug, Clone, Copy)]
pub enum Payload {
    Fields(fn() -> Vec<Field>),
    /// The layout's number, and the fields of [`housekeeping::FIELDS`](super::housekeeping::FIELDS) that the layout contains.
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
    row(telemetry_type::MARKS, "frame_marks", ToController, Payload::Fields(|| FrameMarks::fields(&[])), "each second for every camera with new frames of a plate that is not the one of 2013"),
    row(telemetry_type::PICTURE, "picture_section", ToController, Payload::PictureSection, "pixels of a picture, row by row"),
    row(telemetry_type::PICTURE_TAG, "picture_tag", ToController, Payload::PictureTag, "a keyword of a picture"),
    row(telemetry_type::RESULT, "result", ToController, Payload::Fields(|| CommandOutcome::fields(&[])), "what came of a command"),
];

/// Answers to a command in telemetry: every command is answered by a receipt and a result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Telemetry {
    Receipt(Receipt),
    Result(CommandOutcome),
}

impl Telemetry {
    /// The answer as a packet made at `time`.
    pub fn packet(&self, time: Timestamp) -> Result<TelemetryPacket, MessageError> {
        match self {
            Self::Receipt(receipt) => packed(telemetry_type::RECEIPT, "receipt", receipt, time),
            Self::Result(outcome) => packed(telemetry_type::RESULT, "result", outcome, time),
        }
    }

    /// Reads a receipt or a result.
    pub fn decode(packet: &TelemetryPacket) -> Result<Self, MessageError> {
        match packet.kind() {
            kind @ telemetry_type::RECEIPT => unpacked(kind, "receipt", packet).map(Self::Receipt),
            _ => unpacked(telemetry_type::RESULT, "result", packet).map(Self::Result),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn time() -> Timestamp {
        Timestamp::from_second(1_379_786_400).unwrap()
    }

    #[test]
    fn ids_of_any_plate_come_back_from_their_packet() {
        let many: Vec<[i32; 2]> = (0..40).map(|n| [101 + n, -n]).collect();
        for ids in [&[][..], &[[0, 0]], &[[-9999, 9999], [9999, 0]], &many] {
            let sent = FrameMarks::new(2, 70_000, ids).unwrap();
            let packet = sent.packet(time()).unwrap();
            assert_eq!(packet.payload().len(), 136);
            let read = FrameMarks::decode(&packet).unwrap();
            assert_eq!(read, sent);
            assert_eq!(usize::from(read.marks), ids.len());
            let found: Vec<[i32; 2]> = read.ids().collect();
            assert_eq!(found, ids[..ids.len().min(MOST_MARK_IDS)]);
        }
    }

    #[test]
    fn an_id_that_does_not_fit_is_not_sent_as_another() {
        for index in [32_768, -32_769, i32::MIN] {
            assert_eq!(FrameMarks::new(1, 1, &[[0, 0], [0, index]]), None);
        }
    }

    proptest! {
        #[test]
        fn any_payload_is_read_or_refused(payload in prop::collection::vec(any::<u8>(), 0..200)) {
            let is_whole = payload.len() >= FrameMarks::BYTES;
            let packet = TelemetryPacket::new(telemetry_type::MARKS, id::ASPECT, (0, 0), payload.clone()).unwrap();
            let read = FrameMarks::decode(&packet);
            prop_assert_eq!(read.is_ok(), is_whole);
            if let Ok(read) = read {
                prop_assert!(read.ids().count() <= MOST_MARK_IDS);
                let again = read.packet(time()).unwrap();
                prop_assert_eq!(again.payload(), &payload[..FrameMarks::BYTES]);
            }
        }
    }
}
