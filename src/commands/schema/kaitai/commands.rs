//! Command packets, their messages, and the commands of the table.

use super::{attribute, documented, switch, to_the_end, value, wire, with_unit};
use crate::commands::schema::CHECKSUM;
use crate::commands::schema::yaml::{Yaml, map};
use crate::commands::{COMMANDS, Kind, Variable};
use crate::link::message::MESSAGES;

pub fn packet() -> Yaml {
    let payload = attribute("payload", "messages").with("size", "len_payload");
    let seq = vec![
        attribute("sequence", "u2").with("doc", "the sender's number of the packet"),
        attribute("checksum", "u2be").with("doc", CHECKSUM),
        payload,
    ];
    let params = vec![
        attribute("target_code", "u1"),
        attribute("len_payload", "u1"),
    ];
    let instances = map([("target", value("target_code").with("enum", "party"))]);
    map([
        ("params", params.into()),
        ("seq", seq.into()),
        ("instances", instances),
    ])
}

pub fn messages() -> Yaml {
    let messages = attribute("messages", "message")
        .with("repeat", "until")
        .with("repeat-until", "_io.size - _io.pos < 2")
        .with("if", "_io.size >= 2");
    let rest = to_the_end("rest").with("doc", "a single byte at the end is none of a message");
    documented("Messages, one after the other. A key that is zero or not known ends them: its message holds the rest.")
        .with("seq", vec![messages, rest])
}

pub fn message() -> Yaml {
    let cases = MESSAGES.iter().map(|row| {
        let body = if row.fields().is_empty() {
            "nothing"
        } else {
            row.name
        };
        (format!("message_key::{}", row.name), body)
    });
    let cases = cases.chain([("_".to_owned(), "rest")]);
    let seq = vec![
        attribute("key", "u2").with("enum", "message_key"),
        map([("id", "body".into()), ("type", switch("key", cases))]),
    ];
    map([("seq", seq.into())])
}

pub fn aspect_command() -> Yaml {
    let rows = COMMANDS.iter().filter(|row| !row.variables.is_empty());
    let cases = rows.map(|row| (format!("command_name::{}", row.name), row.name));
    let cases = cases.chain([("_".to_owned(), "words(num_variables)")]);
    let seq = vec![
        attribute("key", "u2").with("doc", "with the bits of the computers"),
        map([
            ("id", "variables".into()),
            ("type", switch("command", cases)),
        ]),
    ];
    let instances = map([
        (
            "command",
            value("key & 0x0fff").with("enum", "command_name"),
        ),
        ("for_computer_1", value("(key & 0x1000) != 0")),
        ("for_computer_2", value("(key & 0x2000) != 0")),
        ("num_variables", value("key & 0x000f")),
    ]);
    documented("A command of the ground.")
        .with("seq", seq)
        .with("instances", instances)
}

pub fn words() -> Yaml {
    let words = attribute("words", "u2")
        .with("repeat", "expr")
        .with("repeat-expr", "num_words");
    documented("Variables of a command that is not in the table.")
        .with("params", vec![attribute("num_words", "u1")])
        .with("seq", vec![words])
}

/// How the value of a result reads, by the command that it is of.
pub fn of_result() -> Yaml {
    map([
        (
            "command",
            value("key & 0x0fff")
                .with("enum", "command_name")
                .with("doc", "of an aspect command"),
        ),
        (
            "code",
            value("value")
                .with("enum", "result_code")
                .with("doc", "of what reads nothing"),
        ),
        (
            "signed",
            value("(value ^ 0x8000) - 0x8000").with("doc", "of a read of an i16"),
        ),
        (
            "angle",
            value("value / 8.0 - 1024").with("doc", "of a read of an angle code"),
        ),
    ])
}

/// A type for the variables of every command that has some.
pub fn variables() -> impl Iterator<Item = (String, Yaml)> {
    let rows = COMMANDS.iter().filter(|row| !row.variables.is_empty());
    rows.map(|row| {
        let seq: Vec<Yaml> = row.variables.iter().map(variable).collect();
        let angles = row
            .variables
            .iter()
            .filter(|variable| variable.kind == Kind::Angle);
        let angles: Vec<_> = angles
            .map(|angle| (angle.name.to_owned(), decoded(angle)))
            .collect();
        let body = documented(row.documentation).with("seq", seq);
        let body = if angles.is_empty() {
            body
        } else {
            body.with("instances", Yaml::Map(angles))
        };
        (row.name.to_owned(), body)
    })
}

fn variable(variable: &Variable) -> Yaml {
    let kind = wire(variable.kind.number());
    match variable.kind {
        Kind::Angle => attribute(&format!("{}_code", variable.name), kind),
        Kind::Switch => attribute(variable.name, kind).with("doc", variable.kind.range()),
        _ => with_unit(attribute(variable.name, kind), variable.unit),
    }
}

fn decoded(angle: &Variable) -> Yaml {
    with_unit(
        value(format!("{}_code / 8.0 - 1024", angle.name)),
        angle.unit,
    )
}
