//! Lengths and types of the tables, compared with the packets that the program writes.

use crate::link::housekeeping::{self, fields_by_layout};
use crate::link::message::tests::every_message;
use crate::link::message::{
    MESSAGES, Message, MoonFound, MoonNotFound, MoonNotVisible, message_of,
};
use crate::link::number::Field;
use crate::link::packet::Direction::{ToAspect, ToController};
use crate::link::packet::{Packet, SYNC, TelemetryPacket, id};
use crate::link::telemetry::{Payload, TELEMETRY};
use crate::link::{
    CommandOutcome, FrameMarks, Housekeeping, ImuPacket, NoSolution, Receipt, Telemetry,
};
use jiff::Timestamp;

/// The numbers of a payload read by the table, and their length in bytes.
fn read(fields: &[Field], payload: &[u8]) -> (Vec<f64>, usize) {
    let mut rest = payload;
    let mut numbers = Vec::new();
    for field in fields {
        for _ in 0..field.count {
            let (number, after) = field.number.read(rest).unwrap();
            rest = after;
            numbers.push(number);
        }
    }
    (numbers, payload.len() - rest.len())
}

/// Fields of a message, in the order of its bytes.
fn said(message: &Message) -> Vec<f64> {
    let time = |time: Timestamp| [time.as_second() as f64, time.subsec_millisecond().into()];
    match message {
        Message::Solution(s) => {
            let angles = [s.azimuth_deg, s.elevation_deg, s.roll_deg, s.error_deg];
            [&angles[..], &time(s.time)].concat()
        }
        Message::Propagated(p) => {
            let solution = said(&Message::Solution(p.solution));
            [&solution[..], &[p.age_ms.into()]].concat()
        }
        Message::Error(NoSolution { code }) => vec![(*code).into()],
        Message::ExposureStart(e) => vec![e.camera.into(), e.time.as_second() as f64],
        Message::Gps(fix) => vec![fix.latitude_deg.into(), fix.longitude_deg.into()],
        Message::MoonRequest(r) => vec![r.latitude_deg, r.longitude_deg, r.height_m],
        Message::MoonFound(MoonFound { request, fix }) => {
            let place = [(*request).into(), fix.x_px, fix.y_px];
            let time = time(fix.time);
            [&place[..], &fix.covariance_px2, &fix.direction, &time].concat()
        }
        Message::MoonNotVisible(MoonNotVisible { request, code })
        | Message::MoonNotFound(MoonNotFound { request, code }) => {
            vec![(*request).into(), (*code).into()]
        }
        Message::Aspect(command) => vec![command.key().into()],
        _ => Vec::new(),
    }
}

#[test]
fn what_the_program_writes_is_read_by_the_tables() {
    for message in every_message() {
        let row = message_of(message.key()).unwrap();
        let packet = message.packet(id::ASPECT, 1).unwrap();
        let payload = &packet.payload()[2..];
        let (numbers, length) = read(&row.fields(), payload);
        assert_eq!(numbers, said(&message), "{}", row.name);
        let variables = match &message {
            Message::Aspect(command) => 2 * command.variables().len(),
            _ => 0,
        };
        assert_eq!(payload.len(), length + variables, "{}", row.name);
    }
    for row in MESSAGES {
        let known = every_message()
            .iter()
            .any(|message| message.key() == row.key);
        assert!(known, "{} is not among the messages", row.name);
    }
}

fn telemetry_fields(packet: &TelemetryPacket) -> Vec<f64> {
    let mut rows = TELEMETRY.iter().filter(|row| row.kind == packet.kind());
    let Some(Payload::Fields(fields)) = rows.next().map(|row| row.payload) else {
        panic!("no fields");
    };
    let (numbers, length) = read(&fields(), packet.payload());
    assert_eq!(packet.payload().len(), length);
    numbers
}

#[test]
fn telemetry_is_read_by_the_tables() {
    let time = Timestamp::from_second(1_379_786_400).unwrap();
    let receipt = Telemetry::Receipt(Receipt { sequence: 7 });
    let result = Telemetry::Result(CommandOutcome {
        sequence: 7,
        key: 0x1412,
        value: 3,
    });
    let sample = ImuPacket {
        time,
        counter: 9,
        force_m_s2: [0.5, -0.25, -9.5],
        rate_rad_s: [0.125, 2.0, 4.0],
    };
    let marks = FrameMarks::new(1, 70_000, &[[101, -2], [-9999, 0]]).unwrap();
    let mut values = [0.0; 67];
    values[..7].copy_from_slice(&[1.0, 70_000.0, 2.0, 101.0, -2.0, -9999.0, 0.0]);
    for (packet, expected) in [
        (receipt.packet(time), &[7.0][..]),
        (marks.packet(time), &values),
        (result.packet(time), &[7.0, 0x1412.into(), 3.0]),
        (
            sample.packet(),
            &[9.0, 0.5, -0.25, -9.5, 0.125, 2.0, 4.0][..],
        ),
    ] {
        assert_eq!(telemetry_fields(&packet.unwrap()), expected);
    }
}

#[test]
fn the_types_of_telemetry_are_those_that_distinguish_packets() {
    for direction in [ToController, ToAspect] {
        for kind in 0..=255 {
            // The payload is not as long as the source's id: the length distinguishes the two forms.
            let header = [SYNC[0], SYNC[1], kind, id::ASPECT, 0, 0];
            let is_telemetry = Packet::length(direction, &header) == Some(16);
            let mut rows = TELEMETRY.iter();
            let known = rows.any(|row| row.kind == kind && row.direction == direction);
            assert_eq!(is_telemetry, known, "{direction:?} {kind:02x}");
        }
    }
}

#[test]
fn layouts_of_housekeeping_end_where_they_ended() {
    let length = |layout| -> usize {
        let fields = fields_by_layout().filter(|(since, _)| *since <= layout);
        1 + fields.map(|(_, field)| field.bytes).sum::<usize>()
    };
    let now = Housekeeping::default().packet(Timestamp::UNIX_EPOCH);
    assert_eq!([1, 2, 4, 8].map(length), [207, 245, 282, 374]);
    assert_eq!(
        length(housekeeping::LAYOUT),
        now.unwrap().payload().len(),
        "the layout of now"
    );
    for (_, field) in fields_by_layout() {
        assert_eq!(field.bytes, field.count * field.number.bytes());
    }
}
