//! The dictionary as a description for Kaitai Struct (<https://kaitai.io>).

use super::{Dictionary, Entry, Item};
use crate::commands::text::filled;
use crate::commands::variable::Kind;
use crate::link::housekeeping::LAYOUT;
use crate::link::message::key;
use crate::link::number::Number;
use crate::link::packet::{Direction, id, telemetry_type};
use serde_json::json;

/// Interpretation of the value of a result, by its command.
const OF_RESULT: &str = r#"
    instances:
      command: {value: "key & 0x0fff", enum: command_name, doc: "of an aspect command"}
      code: {value: value, enum: result_code, doc: "of what reads nothing"}
      signed: {value: "(value ^ 0x8000) - 0x8000", doc: "of a read of an i16"}
      angle: {value: "value / 8.0 - 1024", doc: "of a read of an angle code"}"#;

impl Dictionary {
    /// The description: YAML for Kaitai Struct 0.11.
    pub fn kaitai(&self) -> String {
        // These entries are in the text.
        let is_own = |entry: &&Entry| {
            let in_the_text = entry.number == key::ASPECT_COMMAND;
            !entry.items.is_empty() && !in_the_text
        };
        let entries = self.telemetry.iter().chain(&self.messages);
        let entries = entries.chain(&self.commands).filter(is_own);
        let housekeeping = self.housekeeping.iter();
        let housekeeping = housekeeping.map(|(since, item)| attribute(item, Some(*since)));
        let names = |name: &str, entries: &[Entry]| {
            let rows = entries.iter();
            let rows = rows.map(|entry| (entry.number, entry.name, entry.documentation));
            numbers(name, &rows.collect::<Vec<_>>())
        };
        let padding = "    0: {id: padding, doc: \"zeros to the end of the packet\"}";
        let enums = [
            names("telemetry_type", &self.telemetry),
            names("message_key", &self.messages) + "\n" + padding,
            names("command_name", &self.commands),
        ];
        let codes = self.codes.iter();
        let codes = codes.map(|codes| numbers(codes.name, codes.rows));
        let enums = enums.into_iter().chain(codes);
        let gaps = [
            ("layout", LAYOUT.to_string()),
            ("from_aspect", self.is_telemetry(Direction::ToController)),
            ("to_aspect", self.is_telemetry(Direction::ToAspect)),
            (
                "telemetry_cases",
                cases("telemetry_type", self.telemetry.iter()),
            ),
            ("message_cases", cases("message_key", self.messages.iter())),
            (
                "command_cases",
                cases("command_name", self.commands.iter().filter(is_own)),
            ),
            ("housekeeping", lines(housekeeping)),
            ("types", lines(entries.map(structure))),
            ("enums", lines(enums)),
        ];
        filled(include_str!("kaitai.ksy"), gaps)
    }

    /// Condition that identifies telemetry packets of a direction, by their bytes 2 and 3.
    fn is_telemetry(&self, direction: Direction) -> String {
        let rows = self.telemetry.iter();
        let rows = rows.filter(|row| row.direction == direction);
        let rows: Vec<String> = rows
            .map(|row| match row.number {
                kind if kind == u16::from(telemetry_type::RECEIPT) => {
                    format!("(first == {kind} and second == {})", id::ASPECT)
                }
                kind => format!("first == {kind}"),
            })
            .collect();
        rows.join(" or ")
    }
}

fn lines(texts: impl Iterator<Item = String>) -> String {
    texts.collect::<Vec<_>>().join("\n")
}

/// A text for YAML, quoted as in JSON, which YAML contains.
fn quoted(text: &str) -> String {
    json!(text).to_string()
}

/// The type of each entry's body.
fn cases<'a>(of: &str, entries: impl Iterator<Item = &'a Entry>) -> String {
    let by_hand = ["housekeeping", "picture_section", "picture_tag"];
    lines(entries.map(|entry| {
        let name = entry.name;
        let body = match entry.items.is_empty() && !by_hand.contains(&name) {
            true => "nothing",
            false => name,
        };
        format!("            \"{of}::{name}\": {body}")
    }))
}

fn structure(entry: &Entry) -> String {
    let (name, doc) = (entry.name, quoted(entry.documentation));
    let seq = lines(entry.items.iter().map(|item| attribute(item, None)));
    let angles = entry.items.iter();
    let angles: Vec<String> = angles
        .filter(|item| item.kind == Some(Kind::Angle))
        .map(|item| {
            let (name, unit) = (item.name, with_unit(item.unit));
            format!("\n      {name}: {{value: \"{name}_code / 8.0 - 1024\"{unit}}}")
        })
        .collect();
    let instances = match angles.is_empty() {
        true if name == "result" => OF_RESULT.to_owned(),
        true => String::new(),
        false => format!("\n    instances:{}", angles.concat()),
    };
    format!("  {name}:\n    doc: {doc}\n    seq:\n{seq}{instances}")
}

/// A field of a type, on a line.
fn attribute(item: &Item, condition: Option<u8>) -> String {
    let wire = match item.number {
        Number::U8 => "u1",
        Number::U16 => "u2",
        Number::I16 => "s2",
        Number::U32 => "u4",
        Number::F32 => "f4",
        Number::F64 => "f8",
    };
    let (code, unit) = match item.kind {
        // The unit is that of the angle.
        Some(Kind::Angle) => ("_code", ""),
        _ => ("", item.unit),
    };
    let repeated = match item.count {
        1 => String::new(),
        count => format!(", repeat: expr, repeat-expr: {count}"),
    };
    let codes = item.codes.map(|codes| format!(", enum: {}", codes.name));
    let condition = condition.map(|since| format!(", if: \"known_layout >= {since}\""));
    format!(
        "      - {{id: {}{code}, type: {wire}{repeated}{}, doc: {}{}{}}}",
        item.name,
        codes.unwrap_or_default(),
        quoted(&item.documentation),
        with_unit(unit),
        condition.unwrap_or_default(),
    )
}

fn with_unit(unit: &str) -> String {
    match unit {
        "" => String::new(),
        unit => format!(", -unit: {}", quoted(unit)),
    }
}

fn numbers(name: &str, rows: &[(u16, &str, &str)]) -> String {
    let rows = rows.iter();
    let rows = rows.map(|(number, name, meaning)| {
        format!("    {number}: {{id: {name}, doc: {}}}", quoted(meaning))
    });
    format!("  {name}:\n{}", lines(rows))
}
