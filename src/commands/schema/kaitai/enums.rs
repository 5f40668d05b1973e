//! Numbers with names.

use crate::commands::COMMANDS;
use crate::commands::schema::yaml::{Yaml, map};
use crate::link::control::RESULTS;
use crate::link::housekeeping::FIELDS;
use crate::link::message::{ERROR_CODES, MESSAGES};
use crate::link::moon::{NOT_FOUND, NOT_VISIBLE};
use crate::link::packet::PARTIES;
use crate::link::picture::TAG_TYPES;
use crate::link::telemetry::TELEMETRY;

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
        ("party", PARTIES.rows.into()),
        ("result_code", RESULTS.rows.into()),
        ("error_code", ERROR_CODES.rows.into()),
        ("not_visible_code", NOT_VISIBLE.rows.into()),
        ("not_found_code", NOT_FOUND.rows.into()),
        ("tag_type", TAG_TYPES.rows.into()),
    ];
    let lists = lists.map(|(name, rows)| (name.to_owned(), numbers(&rows)));
    let choices = FIELDS.iter().filter_map(|field| field.codes).map(|codes| {
        let rows = codes.rows.iter();
        let rows = rows.map(|(number, name, _)| (number.to_string(), (*name).into()));
        (codes.name.to_owned(), Yaml::Map(rows.collect()))
    });
    Yaml::Map(lists.into_iter().chain(choices).collect())
}

fn numbers(rows: &[(u16, &str, &str)]) -> Yaml {
    let rows = rows.iter().map(|(number, name, documentation)| {
        let row = map([("id", (*name).into()), ("doc", (*documentation).into())]);
        (format!("{number}"), row)
    });
    Yaml::Map(rows.collect())
}
