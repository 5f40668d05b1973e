use super::*;
use crate::link::housekeeping::{self, fields_by_layout};
use crate::link::message::tests::every_message;
use crate::link::message::{Message, Telemetry};
use crate::link::moon::{MoonAnswer, MoonSight};
use crate::link::packet::{Packet, SYNC, TelemetryPacket, id};
use crate::link::{Housekeeping, ImuPacket};
use jiff::Timestamp;

/// The numbers of a payload by the table, and how many bytes they take.
fn read(fields: &[Field], payload: &[u8]) -> (Vec<f64>, usize) {
    let mut rest = payload;
    let mut numbers = Vec::new();
    for field in fields {
        for _ in 0..field.count {
            let (bytes, after) = rest.split_at(field.number.bytes());
            rest = after;
            numbers.push(match field.number {
                Number::U8 => bytes[0].into(),
                Number::U16 => u16::from_le_bytes(bytes.try_into().unwrap()).into(),
                Number::I16 => i16::from_le_bytes(bytes.try_into().unwrap()).into(),
                Number::U32 => u32::from_le_bytes(bytes.try_into().unwrap()).into(),
                Number::F32 => f32::from_le_bytes(bytes.try_into().unwrap()).into(),
                Number::F64 => f64::from_le_bytes(bytes.try_into().unwrap()),
            });
        }
    }
    (numbers, payload.len() - rest.len())
}

/// What a message says, in the order of its bytes.
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
        Message::Error { code } => vec![(*code).into()],
        Message::ExposureStart(e) => vec![e.camera.into(), e.time.as_second() as f64],
        Message::Gps(fix) => vec![fix.latitude_deg.into(), fix.longitude_deg.into()],
        Message::MoonRequest(r) => vec![r.latitude_deg, r.longitude_deg, r.height_m],
        Message::Moon(MoonAnswer { request, sight }) => match sight {
            MoonSight::NotVisible { code } | MoonSight::NotFound { code } => {
                vec![(*request).into(), (*code).into()]
            }
            MoonSight::Found(f) => {
                let place = [(*request).into(), f.x_px, f.y_px];
                let time = time(f.time);
                [&place[..], &f.covariance_px2, &f.direction, &time].concat()
            }
        },
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
        let (numbers, length) = read(row.fields, payload);
        assert_eq!(numbers, said(&message), "{}", row.name);
        let variables = match &message {
            Message::Aspect(command) => 2 * command.variables().len(),
            _ => 0,
        };
        assert_eq!(payload.len(), length + variables, "{}", row.name);
    }
    for row in MESSAGES {
        let told = every_message()
            .iter()
            .any(|message| message.key() == row.key);
        assert!(told, "{} is not among the messages", row.name);
    }
}

fn telemetry_fields(packet: &TelemetryPacket) -> Vec<f64> {
    let mut rows = TELEMETRY.iter().filter(|row| row.kind == packet.kind());
    let Some(Payload::Fields(fields)) = rows.next().map(|row| row.payload) else {
        panic!("no fields");
    };
    let (numbers, length) = read(fields, packet.payload());
    assert_eq!(packet.payload().len(), length);
    numbers
}

#[test]
fn telemetry_is_read_by_the_tables() {
    let time = Timestamp::from_second(1_379_786_400).unwrap();
    let receipt = Telemetry::Receipt { sequence: 7 };
    let result = Telemetry::Result {
        sequence: 7,
        key: 0x1412,
        value: 3,
    };
    let sample = ImuPacket {
        time,
        counter: 9,
        force_m_s2: [0.5, -0.25, -9.5],
        rate_rad_s: [0.125, 2.0, 4.0],
    };
    for (packet, expected) in [
        (receipt.packet(time), &[7.0][..]),
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
fn the_types_of_telemetry_are_those_that_packets_are_told_by() {
    for direction in [ToController, ToAspect] {
        for kind in 0..=255 {
            // Not a payload as long as the source's id: the length tells the two forms apart.
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

#[test]
fn the_names_of_choices_are_those_of_the_documentation() {
    for (name, choices) in CHOICES {
        let mut fields = housekeeping::FIELDS.iter();
        let field = fields.find(|field| field.name == *name).unwrap();
        for (number, choice) in *choices {
            let said = field.documentation.split([',', ':']).any(|part| {
                let (told, rest) = part.trim().split_once(' ').unwrap_or((part, ""));
                told == number.to_string() && rest.contains(choice)
            });
            assert!(said, "{name}: {number} {choice}");
        }
    }
}
