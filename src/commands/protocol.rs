//! The page on the protocol: the interface document for builders of the other end, made from the tables that the
//! program itself uses.

use super::order::order;
use super::table::COMMANDS;
use super::text::filled;
use super::words::describe;
use crate::config::{Allowed, parameters};
use crate::instrument::Role;
use crate::link::control::RESULTS;
use crate::link::hex::hex;
use crate::link::message::{ERROR_CODES, MESSAGES};
use crate::link::moon::{NOT_FOUND, NOT_VISIBLE};
use crate::link::number::{Codes, Field};
use crate::link::packet::PARTIES;
use crate::link::telemetry::{Payload, TELEMETRY};
use crate::link::{
    AspectCommand, CommandOutcome, Computer, Direction, ExposureStart, Message, MoonAnswer,
    MoonFix, MoonOutcome, NoSolution, Packet, Receipt, Solution, Telemetry, housekeeping, id,
    picture,
};
use jiff::Timestamp;

/// The page, in Markdown.
pub fn protocol_page() -> String {
    let tables = [
        (
            "parties",
            codes(&PARTIES, "id", "who", |id| format!("0x{id:02X}")),
        ),
        ("telemetry", telemetry()),
        ("messages", messages()),
        (
            "results",
            codes(&RESULTS, "result", "meaning", |value| value.to_string()),
        ),
        (
            "errors",
            codes(&ERROR_CODES, "error code", "no solution, because", |code| {
                code.to_string()
            }),
        ),
        ("moon", moon_codes()),
        ("commands", commands()),
        ("parameters", numbered_parameters()),
        ("housekeeping", housekeeping_fields()),
        ("section_pixels", picture::SECTION_PIXELS.to_string()),
        ("roll_camera", Role::Roll.number().to_string()),
        ("moon_camera", Role::Moon.number().to_string()),
        ("roles", roles()),
        ("examples", examples()),
    ];
    filled(include_str!("protocol/page.md"), tables)
}

fn roles() -> String {
    let role = |role: Role| format!("{} {}", role as u8, role.name());
    Role::KINDS.map(role).join(", ")
}

/// A table with the given head and rows of cells.
fn table<const N: usize>(head: [&str; N], rows: impl IntoIterator<Item = [String; N]>) -> String {
    let line = |cells: &[String]| {
        let cells = cells.iter().map(|cell| match cell.is_empty() {
            true => " |".to_owned(),
            false => format!(" {cell} |"),
        });
        format!("|{}\n", cells.collect::<String>())
    };
    let head = line(&head.map(str::to_owned));
    let rows: String = rows.into_iter().map(|row| line(&row)).collect();
    format!("{head}|{}\n{rows}", "---|".repeat(N))
}

fn codes(codes: &Codes, number: &str, meaning: &str, in_words: fn(u16) -> String) -> String {
    let rows = codes.rows.iter();
    let rows = rows.map(|(number, _, meaning)| [in_words(*number), (*meaning).into()]);
    table([number, meaning], rows)
}

fn direction(direction: Direction) -> String {
    match direction {
        Direction::ToAspect => "to the aspect system".into(),
        Direction::ToController => "from the aspect system".into(),
    }
}

fn fields(fields: &[Field]) -> String {
    let fields = fields.iter().map(|field| {
        let (name, kind) = (field.name, field.number.name());
        let count = match field.count {
            1 => String::new(),
            count => format!("{count} x "),
        };
        format!("`{name}` {count}{kind}: {}", field.documentation)
    });
    fields.collect::<Vec<_>>().join("; ")
}

fn telemetry() -> String {
    let rows = TELEMETRY.iter().map(|row| {
        let payload = match row.payload {
            Payload::Fields(of) => fields(&of()),
            _ => "below".into(),
        };
        let (kind, name) = (format!("0x{:02X}", row.kind), format!("`{}`", row.name));
        [
            kind,
            direction(row.direction),
            name,
            row.documentation.into(),
            payload,
        ]
    });
    table(["type", "direction", "name", "meaning", "payload"], rows)
}

fn messages() -> String {
    let rows = MESSAGES.iter().map(|row| {
        let (key, name) = (format!("0x{:04X}", row.key), format!("`{}`", row.name));
        [
            key,
            direction(row.direction),
            name,
            row.documentation.into(),
            fields(&row.fields()),
        ]
    });
    table(
        [
            "key",
            "direction",
            "name",
            "meaning",
            "fields after the key",
        ],
        rows,
    )
}

/// The reasons in answers to a request for the Moon.
fn moon_codes() -> String {
    let lists = [("not visible", &NOT_VISIBLE), ("not found", &NOT_FOUND)];
    let rows = lists.into_iter().flat_map(|(message, codes)| {
        let rows = codes.rows.iter();
        rows.map(move |(code, _, meaning)| [message.into(), code.to_string(), (*meaning).into()])
    });
    table(["message", "code", "meaning"], rows)
}

fn commands() -> String {
    let rows = COMMANDS.iter().map(|row| {
        let variables: Vec<String> = row.variables.iter().map(ToString::to_string).collect();
        let result = row.reads.map_or("0 done".into(), |reads| reads.to_string());
        let (key, name) = (format!("0x{:04X}", row.key), format!("`{}`", row.name));
        [
            key,
            name,
            variables.join("; "),
            result,
            row.documentation.into(),
        ]
    });
    table(["key", "name", "variables", "result", "what it does"], rows)
}

fn numbered_parameters() -> String {
    let parameters = parameters().iter();
    let mut numbered: Vec<_> = parameters
        .filter_map(|row| Some((row.command?, row)))
        .collect();
    numbered.sort_by_key(|(number, _)| *number);
    let rows = numbered.into_iter().map(|(number, row)| {
        let command = match row.allowed {
            Allowed::Whole(..) => "integer",
            _ => "float",
        };
        let default = row
            .default()
            .map_or("unset".into(), |value| value.to_string());
        let (key, unit) = (format!("`{}`", row.key), row.unit.to_owned());
        [
            number.to_string(),
            command.into(),
            key,
            unit,
            row.range(),
            default,
        ]
    });
    table(
        ["number", "command", "parameter", "unit", "range", "default"],
        rows,
    )
}

fn housekeeping_fields() -> String {
    let layout = format!("{}: the layout of this table", housekeeping::LAYOUT);
    let mut rows = vec![[
        "0".into(),
        "`layout`".into(),
        "u8".into(),
        String::new(),
        layout,
    ]];
    let mut at = 1;
    for field in housekeeping::FIELDS {
        let (name, kind) = (format!("`{}`", field.name), field.kind());
        rows.push([
            at.to_string(),
            name,
            kind,
            field.unit.into(),
            field.documentation(),
        ]);
        at += field.bytes;
    }
    let table = table(["byte", "field", "type", "unit", "meaning"], rows);
    format!("{table}\nThe payload has {at} bytes.\n")
}

/// Packets with their bytes; this program sends or accepts each of them.
fn examples() -> String {
    let packets = example_packets().unwrap_or_default().into_iter();
    let rows = packets.map(|packet| [describe(&packet), format!("`{}`", hex(&packet.encode()))]);
    table(["what", "bytes"], rows)
}

fn example_packets() -> Option<Vec<Packet>> {
    let time = Timestamp::new(1_379_786_400, 250_000_000).ok()?;
    let texts = |values: &[&str]| values.iter().map(|v| (*v).into()).collect::<Vec<String>>();
    let say = |name, values: &[&str]| order(name, &texts(values), Computer::One).ok();
    let to_us = |sequence, message: Option<Message>| {
        message?
            .packet(id::ASPECT, sequence)
            .ok()
            .map(Packet::Command)
    };
    let from_us = |sequence, message: Message| {
        message
            .packet(id::CONTROLLER, sequence)
            .ok()
            .map(Packet::Command)
    };
    let packet_of = |answer: Telemetry| answer.packet(time).ok().map(Packet::Telemetry);
    let result = |sequence, key, value| {
        packet_of(Telemetry::Result(CommandOutcome {
            sequence,
            key,
            value,
        }))
    };
    let stop_other = AspectCommand::new(0x2030, vec![]).ok()?;
    let solution = Solution {
        azimuth_deg: 0.0125,
        elevation_deg: -0.0034,
        roll_deg: 0.0,
        error_deg: 1.5e-5,
        time,
    };
    let moon = |outcome| {
        Message::from(MoonAnswer {
            request: 18,
            outcome,
        })
    };
    let found = MoonOutcome::Found(MoonFix {
        x_px: 351.25,
        y_px: 290.5,
        covariance_px2: [0.0004, 0.0, 0.001],
        direction: [0.0, 0.0, 1.0],
        time,
    });
    [
        to_us(7, say("start_tracking", &[])),
        packet_of(Telemetry::Receipt(Receipt { sequence: 7 })),
        result(7, 0x1000, 0),
        from_us(1, Message::TrackingOn),
        from_us(2, Message::ExposureStart(ExposureStart { camera: 1, time })),
        from_us(3, Message::Solution(solution)),
        from_us(4, Message::Error(NoSolution { code: 2 })),
        to_us(9, say("set_target", &["-300", "450"])),
        result(9, 0x1412, 0),
        to_us(10, say("set_pitch_yaw_exposure", &["0"])),
        result(10, 0x1451, 2),
        to_us(11, say("get_pitch_yaw_exposure", &[])),
        result(11, 0x1850, 15_000),
        to_us(12, say("set_clocking", &["-32.375"])),
        to_us(13, say("set_float", &["1", "12.5"])),
        to_us(14, say("gps", &["34.49", "-104.2218"])),
        to_us(15, say("stop_sending", &[])),
        to_us(18, say("moon", &["34.49", "-104.2218", "38405"])),
        from_us(5, moon(found)),
        from_us(6, moon(MoonOutcome::NotVisible { code: 1 })),
        from_us(7, moon(MoonOutcome::NotFound { code: 1 })),
        to_us(16, Some(Message::Aspect(stop_other))),
        to_us(17, say("stop_tracking", &[])),
    ]
    .into_iter()
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::message::NO_OFFSET;

    /// With SOLASPECT_WRITE_DOCS set, the page is written instead.
    #[test]
    fn the_page_on_the_protocol_is_the_tables() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/protocol.md");
        if std::env::var_os("SOLASPECT_WRITE_DOCS").is_some() {
            std::fs::write(path, protocol_page()).unwrap();
        }
        let committed = std::fs::read_to_string(path).unwrap();
        assert!(
            committed == protocol_page(),
            "docs/protocol.md is not the tables: run this test with SOLASPECT_WRITE_DOCS=1"
        );
    }

    #[test]
    fn every_example_is_there_and_every_stage_has_its_code() {
        assert_eq!(example_packets().unwrap().len(), 23);
        let codes: Vec<u16> = ERROR_CODES.rows.iter().map(|(code, ..)| *code).collect();
        assert_eq!(codes, [1, 2, 3, 4, 5, 6, 7, NO_OFFSET]);
    }
}
