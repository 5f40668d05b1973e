//! Description of the line for other programs: its messages and telemetry, in one dictionary made from the tables that this program uses. It is
//! printed in the format of NASA's F Prime ground system, and is the source of the descriptions for Kaitai Struct and in XTCE.

mod kaitai;
mod xtce;

pub use xtce::Framing;

use super::table::COMMANDS;
use super::variable::{Kind, Variable};
use crate::link::Direction;
use crate::link::control::RESULTS;
use crate::link::housekeeping::{FIELDS, LAYOUT, fields_by_layout};
use crate::link::message::{ERROR_CODES, MESSAGES, key};
use crate::link::moon::{NOT_FOUND, NOT_VISIBLE};
use crate::link::number::{Codes, Field, Number};
use crate::link::packet::PARTIES;
use crate::link::picture::TAG_TYPES;
use crate::link::telemetry::{Payload, TELEMETRY};
use serde_json::{Value, json};

/// Contents of the line.
pub struct Dictionary {
    telemetry: Vec<Entry>,
    messages: Vec<Entry>,
    /// The aspect commands, by their keys without the computers.
    commands: Vec<Entry>,
    /// Fields after the layout's number, each with the first layout that contains it.
    housekeeping: Vec<(u8, Item)>,
    codes: Vec<&'static Codes>,
}

/// A type of telemetry, a message, or a command.
struct Entry {
    name: &'static str,
    /// Its type or key.
    number: u16,
    direction: Direction,
    documentation: &'static str,
    items: Vec<Item>,
}

/// A field, or a variable of a command.
struct Item {
    name: &'static str,
    number: Number,
    count: usize,
    unit: &'static str,
    documentation: String,
    codes: Option<&'static Codes>,
    /// Kind of a variable.
    kind: Option<Kind>,
}

impl Item {
    fn of_field(field: &Field) -> Self {
        Self {
            name: field.name,
            number: field.number,
            count: field.count,
            unit: field.unit,
            documentation: field.documentation.into(),
            codes: field.codes,
            kind: None,
        }
    }

    fn of_variable(variable: &Variable) -> Self {
        Self {
            name: variable.name,
            number: variable.kind.number(),
            count: 1,
            unit: variable.unit,
            documentation: variable.kind.range().into(),
            codes: None,
            kind: Some(variable.kind),
        }
    }
}

impl Default for Dictionary {
    fn default() -> Self {
        let items = |fields: Vec<Field>| fields.iter().map(Item::of_field).collect();
        let telemetry = TELEMETRY.iter().map(|row| Entry {
            name: row.name,
            number: row.kind.into(),
            direction: row.direction,
            documentation: row.documentation,
            items: match row.payload {
                Payload::Fields(fields) => items(fields()),
                _ => Vec::new(),
            },
        });
        let messages = MESSAGES.iter().map(|row| Entry {
            name: row.name,
            number: row.key,
            direction: row.direction,
            documentation: row.documentation,
            items: items(row.fields()),
        });
        let commands = COMMANDS.iter().map(|row| Entry {
            name: row.name,
            number: row.key,
            direction: Direction::ToAspect,
            documentation: row.documentation,
            items: row.variables.iter().map(Item::of_variable).collect(),
        });
        let housekeeping = fields_by_layout().map(|(since, field)| {
            let documentation = field.in_words();
            let plain = Item::of_field(&field.plain());
            let item = Item {
                documentation,
                ..plain
            };
            (since, item)
        });
        let fixed = [
            &PARTIES,
            &RESULTS,
            &ERROR_CODES,
            &NOT_VISIBLE,
            &NOT_FOUND,
            &TAG_TYPES,
        ];
        let choices = FIELDS.iter().filter_map(|field| field.codes);
        Self {
            telemetry: telemetry.collect(),
            messages: messages.collect(),
            commands: commands.collect(),
            housekeeping: housekeeping.collect(),
            codes: fixed.into_iter().chain(choices).collect(),
        }
    }
}

impl Dictionary {
    /// JSON for the ground system of F Prime: the housekeeping fields are its channels, messages and answers of the aspect system are its events,
    /// and messages to it its commands. Opcodes are keys of messages; those of aspect commands have their own key in the low 16 bits. Numbers
    /// are those that are sent: angles are given by their codes.
    pub fn json(&self) -> Value {
        let from_aspect = |entry: &&Entry| entry.direction == Direction::ToController;
        // Housekeeping and pictures have no fields here.
        let answers = self.telemetry.iter();
        let answers = answers.filter(|entry| !entry.items.is_empty());
        let events = self.messages.iter().chain(answers);
        let to_aspect = |entry: &&Entry| {
            entry.direction == Direction::ToAspect && entry.number != key::ASPECT_COMMAND
        };
        let messages = self.messages.iter().filter(to_aspect);
        let messages = messages.map(|entry| entry.command(entry.number.into()));
        let aspect = u32::from(key::ASPECT_COMMAND) << 16;
        let commands = self.commands.iter();
        let commands = commands.map(|entry| entry.command(aspect | u32::from(entry.number)));
        let channels: Vec<Value> = self.housekeeping.iter().enumerate().map(channel).collect();
        let members: Vec<&Value> = channels.iter().map(|channel| &channel["name"]).collect();
        let housekeeping = json!({
            "name": "housekeeping",
            "members": [{"name": "housekeeping", "id": LAYOUT, "group": 0, "members": members}],
            "omitted": [],
        });
        json!({
            "metadata": {
                "deploymentName": "solaspect",
                "projectVersion": env!("CARGO_PKG_VERSION"),
                "frameworkVersion": "4.0.0",
                "libraryVersions": [],
                "dictionarySpecVersion": "1.0.0",
            },
            "typeDefinitions": self.definitions(),
            "constants": [],
            "commands": messages.chain(commands).collect::<Vec<_>>(),
            "parameters": [],
            "events": events.filter(from_aspect).map(Entry::event).collect::<Vec<_>>(),
            "telemetryChannels": channels,
            "records": [],
            "containers": [],
            "telemetryPacketSets": [housekeeping],
        })
    }

    /// Enums, and arrays of the fields that have several numbers.
    fn definitions(&self) -> Vec<Value> {
        let housekeeping = self.housekeeping.iter().map(|(_, item)| item);
        let entries = self.messages.iter().chain(&self.telemetry);
        let items = entries.flat_map(|entry| &entry.items).chain(housekeeping);
        let arrays = items.clone().filter(|item| item.count > 1);
        let arrays = arrays.map(|item| {
            json!({
                "kind": "array",
                "qualifiedName": qualified(item.name),
                "size": item.count,
                "elementType": number_type(item.number),
                "default": vec![0; item.count],
            })
        });
        let mut enums: Vec<Value> = Vec::new();
        for (codes, number) in items.filter_map(|item| Some((item.codes?, item.number))) {
            let constant = |(value, name, meaning): &(u16, &str, &str)| json!({"name": name, "value": value, "annotation": meaning});
            let definition = json!({
                "kind": "enum",
                "qualifiedName": qualified(codes.name),
                "representationType": number_type(number),
                "enumeratedConstants": codes.rows.iter().map(constant).collect::<Vec<_>>(),
                "default": codes.rows.first().map(|(_, name, _)| format!("solaspect.{}.{name}", codes.name)),
            });
            if !enums.contains(&definition) {
                enums.push(definition);
            }
        }
        enums.into_iter().chain(arrays).collect()
    }
}

impl Entry {
    fn command(&self, opcode: u32) -> Value {
        json!({
            "name": qualified(self.name),
            "commandKind": "async",
            "opcode": opcode,
            "annotation": self.documentation,
            "formalParams": self.params(),
        })
    }

    fn event(&self) -> Value {
        let items = self.items.iter();
        let format = items.map(|item| {
            format!("{} {{}} {}", item.name, item.unit)
                .trim_end()
                .to_owned()
        });
        json!({
            "name": qualified(self.name),
            "severity": "ACTIVITY_HI",
            "id": self.number,
            "annotation": self.documentation,
            "formalParams": self.params(),
            "format": format.collect::<Vec<_>>().join(", "),
        })
    }

    fn params(&self) -> Vec<Value> {
        let param = |item: &Item| {
            json!({
                "name": item.name,
                "type": item.json_type(),
                "ref": false,
                "annotation": item.documentation,
                "unit": item.unit,
            })
        };
        self.items.iter().map(param).collect()
    }
}

impl Item {
    fn json_type(&self) -> Value {
        match (self.codes, self.count) {
            (Some(codes), _) => {
                json!({"name": qualified(codes.name), "kind": "qualifiedIdentifier"})
            }
            (None, 1) => number_type(self.number),
            _ => json!({"name": qualified(self.name), "kind": "qualifiedIdentifier"}),
        }
    }
}

fn channel((n, (since, item)): (usize, &(u8, Item))) -> Value {
    json!({
        "name": qualified(item.name),
        "type": item.json_type(),
        "id": n,
        "telemetryUpdate": "always",
        "annotation": item.documentation,
        "unit": item.unit,
        "sinceLayout": since,
    })
}

fn qualified(name: &str) -> String {
    format!("solaspect.{name}")
}

fn number_type(number: Number) -> Value {
    let (name, size) = (number.name().to_uppercase(), 8 * number.bytes());
    match number {
        Number::F32 | Number::F64 => json!({"name": name, "kind": "float", "size": size}),
        _ => {
            let signed = number == Number::I16;
            json!({"name": name, "kind": "integer", "size": size, "signed": signed})
        }
    }
}

#[cfg(test)]
mod tests;
