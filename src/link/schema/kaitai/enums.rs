//! Numbers with names.

use crate::link::command::COMMANDS;
use crate::link::layout::{CHOICES, MESSAGES, TELEMETRY};
use crate::link::message::ERROR_CODES;
use crate::link::moon::{NOT_FOUND, NOT_VISIBLE};
use crate::link::schema::yaml::{Yaml, map};
use crate::link::schema::{Names, PARTIES, RESULTS, TAG_TYPES};

/// The enum of a field of a type.
pub fn of_field(owner: &str, field: &str) -> Option<&'static str> {
    match (owner, field) {
        ("error", "code") => Some("error_code"),
        ("moon_not_visible", "code") => Some("not_visible_code"),
        ("moon_not_found", "code") => Some("not_found_code"),
        ("housekeeping", name) => CHOICES
            .iter()
            .map(|(name, _)| *name)
            .find(|other| *other == name),
        _ => None,
    }
}

pub fn enums() -> Yaml {
    let telemetry = TELEMETRY
        .iter()
        .map(|row| (row.kind.into(), row.name, row.documentation));
    let messages = MESSAGES
        .iter()
        .map(|row| (row.key, row.name, row.documentation));
    let commands = COMMANDS
        .iter()
        .map(|row| (row.key, row.name, row.documentation));
    let padding = (0, "padding", "zeros to the end of the packet");
    let lists: [(&str, Vec<_>); 9] = [
        ("telemetry_type", telemetry.collect()),
        (
            "message_key",
            [padding].into_iter().chain(messages).collect(),
        ),
        ("command_name", commands.collect()),
        ("party", PARTIES.into()),
        ("result_code", RESULTS.into()),
        ("error_code", ERROR_CODES.into()),
        ("not_visible_code", NOT_VISIBLE.into()),
        ("not_found_code", NOT_FOUND.into()),
        ("tag_type", TAG_TYPES.into()),
    ];
    let lists = lists.map(|(name, rows)| (name.to_owned(), numbers(&rows)));
    let choices = CHOICES.iter().map(|(name, rows)| {
        let rows = rows
            .iter()
            .map(|(number, name)| (number.to_string(), (*name).into()));
        ((*name).to_owned(), Yaml::Map(rows.collect()))
    });
    Yaml::Map(lists.into_iter().chain(choices).collect())
}

fn numbers(rows: &Names) -> Yaml {
    let rows = rows.iter().map(|(number, name, documentation)| {
        let row = map([("id", (*name).into()), ("doc", (*documentation).into())]);
        (format!("{number}"), row)
    });
    Yaml::Map(rows.collect())
}
