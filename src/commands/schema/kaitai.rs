//! The link as a description for Kaitai Struct (<https://kaitai.io>).

mod commands;
mod enums;
mod payloads;

use super::CHECKSUM;
use super::yaml::{Yaml, map};
use crate::link::message::MESSAGES;
use crate::link::number::{Field, Number};
use crate::link::packet::{Direction, SYNC, id, telemetry_type};
use crate::link::telemetry::{Payload, TELEMETRY};

const ABOUT: &str = "The controller link of solaspect, made by `solaspect link describe --format ksy`. The top level reads a stream of packets \
of the aspect system, to the controller and the ground; the type to_aspect reads one of packets to the aspect system. Checksums are \
read and not checked, for Kaitai Struct has no CRC. What is cut short is an error of the reader.";

/// The description: YAML for Kaitai Struct 0.11.
pub fn kaitai() -> String {
    let meta = map([
        ("id", "solaspect_link".into()),
        ("title", "Controller link of solaspect".into()),
        ("ks-version", Yaml::Quoted("0.11")),
        ("endian", "le".into()),
        ("bit-endian", "le".into()),
    ]);
    map([
        ("meta", meta),
        ("doc", ABOUT.into()),
        ("seq", stream("packet_from_aspect")),
        ("types", Yaml::Map(types())),
        ("enums", enums::enums()),
    ])
    .document()
}

fn types() -> Vec<(String, Yaml)> {
    let to_aspect = documented("A stream of packets to the aspect system.");
    let to_aspect = to_aspect.with("seq", stream("packet_to_aspect"));
    let nothing = documented("No fields.");
    let rest = documented("A message whose key is not known, or zeros that pad the packet.");
    let rest = rest.with("seq", vec![to_the_end("bytes")]);
    let fixed = [
        ("to_aspect", to_aspect),
        ("packet_from_aspect", packet(Direction::ToController)),
        ("packet_to_aspect", packet(Direction::ToAspect)),
        ("telemetry", telemetry()),
        ("command", commands::packet()),
        ("messages", commands::messages()),
        ("message", commands::message()),
        ("aspect_command", commands::aspect_command()),
        ("words", commands::words()),
        ("nothing", nothing),
        ("rest", rest),
        ("housekeeping", payloads::housekeeping()),
        ("picture_section", payloads::section()),
        ("picture_tag", payloads::tag()),
    ];
    let fixed = fixed.map(|(name, body)| (name.to_owned(), body));
    let told = TELEMETRY.iter().filter_map(|row| match row.payload {
        Payload::Fields(fields) => Some((row.name, row.documentation, fields())),
        _ => None,
    });
    let said = MESSAGES
        .iter()
        .filter(|row| row.name != "aspect_command")
        .map(|row| (row.name, row.documentation, row.fields()));
    let rows = told.chain(said).filter(|(.., fields)| !fields.is_empty());
    let rows = rows.map(|(name, documentation, fields)| {
        let fields = fields.iter();
        let fields = fields.map(|field| of_field(field, field.documentation));
        let body = documented(documentation).with("seq", fields.collect::<Vec<_>>());
        match name {
            "result" => (name.into(), body.with("instances", commands::of_result())),
            _ => (name.into(), body),
        }
    });
    fixed
        .into_iter()
        .chain(rows)
        .chain(commands::variables())
        .collect()
}

/// Packets to the end of a stream.
fn stream(packet: &str) -> Yaml {
    let packets = attribute("packets", packet).with("repeat", "eos");
    vec![packets].into()
}

/// Either form of packet; bytes 2 and 3 tell which.
fn packet(direction: Direction) -> Yaml {
    let rows = TELEMETRY.iter().filter(|row| row.direction == direction);
    let is_telemetry: Vec<String> = rows
        .map(|row| match row.kind {
            telemetry_type::RECEIPT => {
                format!("(first == {} and second == {})", row.kind, id::ASPECT)
            }
            kind => format!("first == {kind}"),
        })
        .collect();
    let sync = SYNC.map(|byte| Yaml::from(u16::from(byte))).to_vec();
    let cases = [
        ("true", "telemetry(first, second)"),
        ("false", "command(first, second)"),
    ];
    let body = switch(
        "is_telemetry",
        cases.map(|(case, body)| (case.into(), body)),
    );
    let seq = vec![
        map([("id", "sync".into()), ("contents", sync.into())]),
        attribute("first", "u1").with("doc", "type of telemetry, or target of a command packet"),
        attribute("second", "u1").with(
            "doc",
            "source of telemetry, or payload length of a command packet",
        ),
        map([("id", "body".into()), ("type", body)]),
    ];
    let instances = map([("is_telemetry", value(is_telemetry.join(" or ")))]);
    map([("seq", seq.into()), ("instances", instances)])
}

fn telemetry() -> Yaml {
    let cases = TELEMETRY.iter().map(|row| {
        let body = match row.payload {
            Payload::Fields(fields) if fields().is_empty() => "nothing",
            _ => row.name,
        };
        (format!("telemetry_type::{}", row.name), body)
    });
    let payload = map([
        ("id", "payload".into()),
        ("size", "len_payload".into()),
        ("type", switch("kind", cases)),
    ]);
    let seq = vec![
        attribute("len_payload", "u2"),
        attribute("checksum", "u2be").with("doc", CHECKSUM),
        attribute("nanoseconds", "u4")
            .with("doc", "of the packet's time")
            .with("-unit", "ns"),
        attribute("seconds", "u4")
            .with("doc", "the packet's time, UTC since 1970")
            .with("-unit", "s"),
        payload,
    ];
    let instances = map([
        ("kind", value("kind_code").with("enum", "telemetry_type")),
        ("source", value("source_code").with("enum", "party")),
    ]);
    map([
        (
            "params",
            vec![attribute("kind_code", "u1"), attribute("source_code", "u1")].into(),
        ),
        ("seq", seq.into()),
        ("instances", instances),
    ])
}

fn documented(documentation: &str) -> Yaml {
    map([("doc", documentation.into())])
}

fn attribute(id: &str, kind: &str) -> Yaml {
    map([("id", id.into()), ("type", kind.into())])
}

/// Bytes to the end of the stream.
fn to_the_end(id: &str) -> Yaml {
    map([("id", id.into()), ("size-eos", Yaml::True)])
}

fn value(expression: impl Into<Yaml>) -> Yaml {
    map([("value", expression.into())])
}

/// A type that depends on an expression.
fn switch<'a>(on: &str, cases: impl IntoIterator<Item = (String, &'a str)>) -> Yaml {
    let cases = cases.into_iter().map(|(case, kind)| (case, kind.into()));
    map([
        ("switch-on", on.into()),
        ("cases", Yaml::Map(cases.collect())),
    ])
}

fn wire(number: Number) -> &'static str {
    match number {
        Number::U8 => "u1",
        Number::U16 => "u2",
        Number::I16 => "s2",
        Number::U32 => "u4",
        Number::F32 => "f4",
        Number::F64 => "f8",
    }
}

/// A field of a type.
fn of_field(field: &Field, documentation: &str) -> Yaml {
    let mut yaml = attribute(field.name, wire(field.number));
    if field.count > 1 {
        yaml = yaml
            .with("repeat", "expr")
            .with("repeat-expr", Yaml::Number(field.count as i64));
    }
    if let Some(codes) = field.codes {
        yaml = yaml.with("enum", codes.name);
    }
    with_unit(yaml.with("doc", documentation), field.unit)
}

fn with_unit(yaml: Yaml, unit: &str) -> Yaml {
    match unit {
        "" => yaml,
        unit => yaml.with("-unit", unit),
    }
}
