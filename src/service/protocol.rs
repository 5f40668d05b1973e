//! The page on the protocol: the interface document for whoever builds the other end, made from the tables that the
//! program itself works by.

use crate::config::{Allowed, parameters};
use crate::link::describe::{describe, hex};
use crate::link::ground::order;
use crate::link::message::ERROR_CODES;
use crate::link::moon::{NOT_FOUND, NOT_VISIBLE};
use crate::link::{
    AspectCommand, COMMANDS, Computer, ExposureStart, Message, MoonAnswer, MoonFix, MoonSight,
    Packet, Solution, Telemetry, housekeeping, id, picture,
};
use jiff::Timestamp;
use std::fmt::Write;

/// The page, in Markdown.
pub fn protocol_page() -> String {
    let mut page = String::from(include_str!("protocol/head.md"));
    page += &error_codes();
    page += include_str!("protocol/moon.md");
    page += &moon_codes();
    page += include_str!("protocol/commands.md");
    page += &commands();
    page += include_str!("protocol/parameters.md");
    page += &numbered_parameters();
    page += include_str!("protocol/housekeeping.md");
    page += &housekeeping_fields();
    page += &pictures();
    page += include_str!("protocol/others.md");
    page += include_str!("protocol/examples.md");
    page += &examples();
    page
}

fn error_codes() -> String {
    let mut text = String::from("\n| error code | no solution, because |\n|---|---|\n");
    for (code, _, meaning) in ERROR_CODES {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "| {code} | {meaning} |");
    }
    text
}

/// The reasons with which a request for the Moon is answered.
fn moon_codes() -> String {
    let mut text = String::from("\n| message | code | meaning |\n|---|---|---|\n");
    for (message, codes) in [("not visible", NOT_VISIBLE), ("not found", NOT_FOUND)] {
        for (code, _, meaning) in codes {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "| {message} | {code} | {meaning} |");
        }
    }
    text
}

fn commands() -> String {
    let mut text = String::from(
        "\n| key | name | variables | result | what it does |\n|---|---|---|---|---|\n",
    );
    for row in COMMANDS {
        let variables: Vec<String> = row.variables.iter().map(ToString::to_string).collect();
        let result = row.reads.map_or("0 done".into(), |reads| reads.to_string());
        let _ = writeln!(
            text,
            "| 0x{:04X} | `{}` | {} | {result} | {} |",
            row.key,
            row.name,
            variables.join("; "),
            row.documentation
        );
    }
    text
}

fn numbered_parameters() -> String {
    let mut text = String::from(
        "\n| number | command | parameter | unit | range | default |\n|---|---|---|---|---|---|\n",
    );
    let mut numbered: Vec<_> = parameters()
        .iter()
        .filter_map(|row| row.command.map(|number| (number, row)))
        .collect();
    numbered.sort_by_key(|(number, _)| *number);
    for (number, row) in numbered {
        let command = match row.allowed {
            Allowed::Whole(..) => "integer",
            _ => "float",
        };
        let default = row
            .default()
            .map_or("unset".into(), |value| value.to_string());
        let _ = writeln!(
            text,
            "| {number} | {command} | `{}` | {} | {} | {default} |",
            row.key,
            row.unit,
            row.range()
        );
    }
    text
}

fn housekeeping_fields() -> String {
    let mut text =
        String::from("\n| byte | field | type | unit | meaning |\n|---|---|---|---|---|\n");
    let _ = writeln!(
        text,
        "| 0 | `layout` | u8 | | {}: the layout of this table |",
        housekeeping::LAYOUT
    );
    let mut at = 1;
    for field in housekeeping::FIELDS {
        let _ = writeln!(
            text,
            "| {at} | `{}` | {} | {} | {} |",
            field.name, field.kind, field.unit, field.documentation
        );
        at += field.bytes;
    }
    let _ = writeln!(text, "\nThe payload has {at} bytes.");
    text
}

fn pictures() -> String {
    let text = include_str!("protocol/pictures.md");
    let text = text.replace("SECTION_PIXELS", &picture::SECTION_PIXELS.to_string());
    let text = text.replace("ROLL_CAMERA", &picture::ROLL_CAMERA.to_string());
    text.replace("MOON_CAMERA", &picture::MOON_CAMERA.to_string())
}

/// Packets with their bytes; each is what this program sends or understands.
fn examples() -> String {
    let mut text = String::from("\n| what | bytes |\n|---|---|\n");
    for packet in example_packets().unwrap_or_default() {
        let said = describe(&packet);
        let _ = writeln!(text, "| {said} | `{}` |", hex(&packet.encode()));
    }
    text
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
    let told = |answer: Telemetry| answer.packet(time).ok().map(Packet::Telemetry);
    let result = |sequence, key, value| {
        told(Telemetry::Result {
            sequence,
            key,
            value,
        })
    };
    let stop_other = AspectCommand::new(0x2030, vec![]).ok()?;
    let solution = Solution {
        azimuth_deg: 0.0125,
        elevation_deg: -0.0034,
        roll_deg: 0.0,
        error_deg: 1.5e-5,
        time,
    };
    let moon = |sight| Message::Moon(MoonAnswer { request: 18, sight });
    let found = MoonSight::Found(MoonFix {
        x_px: 351.25,
        y_px: 290.5,
        covariance_px2: [0.0004, 0.0, 0.001],
        direction: [0.0, 0.0, 1.0],
        time,
    });
    [
        to_us(7, say("start_tracking", &[])),
        told(Telemetry::Receipt { sequence: 7 }),
        result(7, 0x1000, 0),
        from_us(1, Message::TrackingOn),
        from_us(2, Message::ExposureStart(ExposureStart { camera: 1, time })),
        from_us(3, Message::Solution(solution)),
        from_us(4, Message::Error { code: 2 }),
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
        from_us(6, moon(MoonSight::NotVisible { code: 1 })),
        from_us(7, moon(MoonSight::NotFound { code: 1 })),
        to_us(16, Some(Message::Aspect(stop_other))),
        to_us(17, say("stop_tracking", &[])),
    ]
    .into_iter()
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::layout::MESSAGES;
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
    fn every_message_of_the_table_is_on_the_page() {
        let page = protocol_page();
        for row in MESSAGES {
            let key = format!("| 0x{:04X} |", row.key);
            assert_eq!(page.matches(&key).count(), 1, "{}", row.name);
        }
    }

    #[test]
    fn every_example_is_there_and_every_stage_has_its_code() {
        assert_eq!(example_packets().unwrap().len(), 23);
        let codes: Vec<u16> = ERROR_CODES.iter().map(|(code, ..)| *code).collect();
        assert_eq!(codes, [1, 2, 3, 4, 5, 6, 7, NO_OFFSET]);
    }
}
