//! Packets in words, for people.

use super::order::orderable;
use super::table::{CommandRow, row_of};
use super::variable::Kind;
use crate::link::control::result;
use crate::link::hex::hex;
use crate::link::message::{key, message_of};
use crate::link::number::Field;
use crate::link::packet::telemetry_type;
use crate::link::picture::Section;
use crate::link::{
    AspectCommand, CameraCounts, CommandOutcome, CommandPacket, CommandResult, Execution,
    FrameMarks, Housekeeping, ImuPacket, Message, Messages, Packet, Telemetry, TelemetryPacket,
};
use crate::units::counted;
use jiff::Timestamp;

/// A packet on one line; housekeeping has a line for each field.
pub fn describe(packet: &Packet) -> String {
    match packet {
        Packet::Command(packet) => command(packet),
        Packet::Telemetry(packet) => telemetry(packet),
    }
}

/// A command as a person would write it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct CommandInWords {
    /// The key, including the computers' bits; `None` if nothing of the command was read.
    pub key: Option<u16>,
    /// Empty for an unknown key.
    pub name: String,
    /// Values in natural units, separated by blanks.
    pub values: String,
}

impl CommandInWords {
    /// The command with this key; `message` is its message, if that could be read.
    pub fn of(key: u16, message: Option<&Message>) -> Self {
        let (name, values) = match (message, name_of_message(key)) {
            (Some(Message::Aspect(command)), _) => (name_of_command(key), natural(key, command)),
            (Some(message), Some(name)) => (name, numbers(message)),
            _ => (name_of_command(key), Vec::new()),
        };
        let values: Vec<String> = values.iter().map(f64::to_string).collect();
        Self {
            key: Some(key),
            name: name.into(),
            values: values.join(" "),
        }
    }
}

/// Result of a command, in words.
pub fn execution_in_words(key: u16, execution: &Execution) -> String {
    match execution {
        Execution::Result(CommandResult::Unknown) => "unknown".into(),
        Execution::Result(result) => result_in_words(key, result.code()),
        Execution::Refused(Some(reason)) => format!("refused: {reason}"),
        Execution::Refused(None) => "refused".into(),
        Execution::Waits => "waits for the announced exposure".into(),
    }
}

fn name_of_command(key: u16) -> &'static str {
    row_of(key).map_or("", |row| row.name)
}

/// The name by which a message is ordered, if the key is that of one.
fn name_of_message(key: u16) -> Option<&'static str> {
    let row = orderable().find(|row| row.key == key)?;
    Some(row.name)
}

/// The variables of a command in natural units.
fn natural(key: u16, command: &AspectCommand) -> Vec<f64> {
    let variables = row_of(key).map_or(&[][..], |row| row.variables);
    let codes = variables.iter().zip(command.variables());
    let natural = codes.map(|(variable, code)| variable.kind.value(*code));
    natural.collect()
}

/// The numbers of a message's fields.
fn numbers(message: &Message) -> Vec<f64> {
    let (Ok(payload), Some(row)) = (message.payload(), message_of(message.key())) else {
        return Vec::new();
    };
    let mut rest = payload.get(2..).unwrap_or_default();
    let number = |field: Field| {
        let (number, after) = field.number.read(rest)?;
        rest = after;
        Some(number)
    };
    row.fields().into_iter().map_while(number).collect()
}

/// The result of a command in words; `value` is the number received.
pub fn result_in_words(key: u16, value: u16) -> String {
    let reads = row_of(key).and_then(|row| row.reads);
    match (reads, value) {
        (Some(reads), result::UNKNOWN) if reads.kind != Kind::Signed => "not known".into(),
        (Some(reads), value) => {
            let number = reads.kind.value(value);
            format!("{} {number} {}", reads.name, reads.unit)
                .trim_end()
                .into()
        }
        (None, result::DONE) => "done".into(),
        (None, result::NOT_IMPLEMENTED) => "not implemented".into(),
        (None, result::REFUSED) => "refused: out of range".into(),
        (None, result::UNKNOWN) => "unknown".into(),
        (None, value) => format!("{value}"),
    }
}

fn command(packet: &CommandPacket) -> String {
    let (target, sequence) = (packet.target(), packet.sequence());
    let mut messages = Messages::of(packet.payload());
    let mut said: Vec<String> = messages
        .by_ref()
        .map(|(bytes, message)| match message {
            Ok(message) => message_in_words(&message),
            Err(error) => format!("? {} ({error})", hex(bytes)),
        })
        .collect();
    let rest = counted(messages.rest().len() as u64, "byte");
    match (messages.rest().len(), messages.not_understood()) {
        (0, _) => {}
        (_, 0) => said.push(format!("{rest} of padding")),
        _ => said.push(format!("{rest} not understood: {}", hex(messages.rest()))),
    }
    format!("to {target:02x} seq {sequence}: {}", said.join("; "))
}

/// A message in words.
pub fn message_in_words(message: &Message) -> String {
    match message {
        Message::Aspect(command) => aspect(command),
        message => message.words(),
    }
}

fn aspect(command: &AspectCommand) -> String {
    let key = command.key();
    let name = row_of(key).map_or("unknown command", |row| row.name);
    let mut text = format!("{name} ({key:#06x})");
    for (at, code) in command.variables().iter().enumerate() {
        let said = match row_of(key).and_then(|row: &CommandRow| row.variables.get(at)) {
            Some(v) => format!(" {} {} {}", v.name, v.kind.value(*code), v.unit),
            None => format!(" {code}"),
        };
        text += said.trim_end();
    }
    text
}

fn telemetry(packet: &TelemetryPacket) -> String {
    let (seconds, nanoseconds) = packet.time();
    let time = Timestamp::new(seconds.into(), nanoseconds as i32);
    let time = time.map_or(format!("{seconds} s {nanoseconds} ns"), |time| {
        time.to_string()
    });
    let said = match packet.kind() {
        telemetry_type::RECEIPT | telemetry_type::RESULT => answer(packet),
        telemetry_type::HOUSEKEEPING => match Housekeeping::decode(packet) {
            Some(housekeeping) => format!("housekeeping\n  {}", housekeeping.lines().join("\n  ")),
            None => format!(
                "housekeeping of another layout, {} bytes",
                packet.payload().len()
            ),
        },
        telemetry_type::PICTURE => match Section::decode(packet) {
            Some(s) => format!(
                "picture of camera {}, {} x {} px: {} pixels from {}{}",
                s.camera,
                s.width,
                s.height,
                s.pixels.len(),
                s.first,
                if s.last { ", the last" } else { "" }
            ),
            None => "picture, cut short".into(),
        },
        telemetry_type::PICTURE_TAG => {
            let name = packet.payload().get(18..26).unwrap_or_default();
            let name = String::from_utf8_lossy(name);
            format!("picture tag {}", name.trim_end_matches('\0'))
        }
        telemetry_type::IDLE => "idle".into(),
        telemetry_type::IMU => match ImuPacket::decode(packet) {
            Ok(packet) => packet.sample().words(),
            Err(error) => format!("IMU: {error}"),
        },
        telemetry_type::CAMERA => match CameraCounts::decode(packet) {
            Ok(counts) => counts.words(),
            Err(error) => format!("camera counts: {error}"),
        },
        telemetry_type::MARKS => match FrameMarks::decode(packet) {
            Ok(marks) => marks.words(),
            Err(error) => format!("marks: {error}"),
        },
        kind => format!("type {kind:02x}"),
    };
    format!("telemetry of {:02x} at {time}: {said}", packet.source())
}

fn answer(packet: &TelemetryPacket) -> String {
    match Telemetry::decode(packet) {
        Ok(Telemetry::Receipt(receipt)) => receipt.words(),
        Ok(Telemetry::Result(result)) => {
            let CommandOutcome { key, value, .. } = result;
            let name = match key {
                // The no-op of computer 1 has the same key as the start of tracking.
                key::START_TRACKING => "start_tracking or no_op",
                key => name_of_message(key).unwrap_or_else(|| name_of_command(key)),
            };
            let said = result_in_words(key, value);
            format!("{}, {name} ({key:#06x}): {said}", result.words())
        }
        Err(error) => error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::hex::from_hex;
    use crate::link::packet::Direction;

    fn said(direction: Direction, text: &str) -> String {
        describe(&Packet::decode(direction, &from_hex(text).unwrap()).unwrap())
    }

    #[test]
    fn real_packets_are_described_in_words() {
        use Direction::{ToAspect, ToController};
        assert_eq!(
            said(ToAspect, "9ac3300809001a41ff101214d4fec201"),
            "to 30 seq 9: set_target (0x1412) x -300 arcsec y 450 arcsec"
        );
        assert_eq!(
            said(ToController, "9ac3e1300600a3ab80b2e60ea0de3d52090012140000"),
            "telemetry of 30 at 2013-09-21T18:00:00.25Z: result of seq 9, set_target (0x1412): done"
        );
        assert_eq!(
            said(ToController, "9ac30104050067b803110800"),
            "to 01 seq 5: no solution, error 8"
        );
    }

    #[test]
    fn marks_are_sent_with_their_camera_and_frame() {
        let marks = FrameMarks::new(2, 70_000, &[[101, -7], [0, 9999]]).unwrap();
        let packet = marks.packet(Timestamp::from_second(1_379_786_400).unwrap());
        assert_eq!(
            describe(&Packet::Telemetry(packet.unwrap())),
            "telemetry of 30 at 2013-09-21T18:00:00Z: camera 2, frame 70000: 2 marks, ids 101,-7 0,9999"
        );
    }

    /// A packet to the aspect system with this payload.
    fn payload_said(payload: &str) -> String {
        let packet = CommandPacket::new(0x30, 1, from_hex(payload).unwrap()).unwrap();
        describe(&Packet::Command(packet))
    }

    #[test]
    fn all_messages_of_a_packet_are_described_and_what_was_not_understood() {
        assert_eq!(
            said(
                Direction::ToAspect,
                "9ac3300e7100d498ff1012140b001600ff1081140500"
            ),
            "to 30 seq 113: set_target (0x1412) x 11 arcsec y 22 arcsec; \
             set_pitch_yaw_analogue_gain (0x1481) gain 5"
        );
        assert_eq!(
            payload_said("001104110100000010a8778fd441"),
            "to 30 seq 1: tracking is on; exposure of camera 1 at 2013-09-21T18:00:00.25Z"
        );
        assert_eq!(
            payload_said("0010000000"),
            "to 30 seq 1: start tracking; 3 bytes of padding"
        );
        assert_eq!(
            payload_said("001005"),
            "to 30 seq 1: start tracking; 1 byte not understood: 05"
        );
        assert_eq!(
            payload_said("0010341205"),
            "to 30 seq 1: start tracking; ? 341205 (message: expected a known key, found 0x1234); \
             3 bytes not understood: 341205"
        );
    }

    #[test]
    fn results_are_described_by_what_was_asked() {
        assert_eq!(result_in_words(0x1850, 15_000), "exposure 15000 us");
        assert_eq!(result_in_words(0x1850, 0xFFFF), "not known");
        assert_eq!(result_in_words(0x1A10, 0xFFFF), "x -1 arcsec");
        assert_eq!(result_in_words(0x1C20, 0x1EFD), "angle -32.375 deg");
        assert_eq!(result_in_words(0x1451, 2), "refused: out of range");
        assert_eq!(result_in_words(0x1FF0, 0xFFFF), "unknown");
    }
}
