//! The dictionary as a description in XTCE 1.2 (XML Telemetric and Command Exchange, OMG).

use super::{Dictionary, Entry, Item};
use crate::commands::text::filled;
use crate::commands::variable::Kind;
use crate::link::Direction;
use crate::link::housekeeping::LAYOUT;
use crate::link::message::key;
use crate::link::number::{Codes, Number};
use crate::link::packet::{id, telemetry_type};

/// A parameter of telemetry or an argument of commands.
#[derive(Clone, Copy)]
enum Role {
    Parameter,
    Argument,
}

/// Framing of packets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Framing {
    /// As on the controller's line.
    Line,
    /// As CCSDS space packets: only the telemetry of the aspect system.
    Ccsds,
}

impl Framing {
    /// The container that every telemetry packet extends.
    fn root(self) -> &'static str {
        match self {
            Self::Line => "TelemetryPacket",
            Self::Ccsds => "CCSDSPacket",
        }
    }

    /// The lines of a text for this framing: those that begin with its name and a bar, and those without a framing.
    fn lines(self, text: &str) -> String {
        let [own, other] = match self {
            Self::Line => ["line|", "ccsds|"],
            Self::Ccsds => ["ccsds|", "line|"],
        };
        let lines = text.lines().filter(|line| !line.starts_with(other));
        let lines = lines.map(|line| line.strip_prefix(own).unwrap_or(line));
        lines.flat_map(|line| [line, "\n"]).collect()
    }
}

/// Additions to the text: each definition once.
#[derive(Default)]
struct Added {
    types: Vec<String>,
    parameters: Vec<String>,
    containers: Vec<String>,
}

impl Dictionary {
    /// The description: XML.
    pub fn xtce(&self, framing: Framing) -> String {
        let mut added = Added::default();
        let is_on_line = framing == Framing::Line;
        // Types of the header, which the text contains.
        for (number, unit) in [(Number::U8, ""), (Number::U16, ""), (Number::U32, "ns")] {
            added.types.push(number_type(Role::Parameter, number, unit));
        }
        // The text contains these containers.
        let by_hand = [
            telemetry_type::HOUSEKEEPING,
            telemetry_type::PICTURE,
            telemetry_type::PICTURE_TAG,
        ];
        let is_ours = |entry: &&Entry| entry.direction == Direction::ToController;
        let generated = |entry: &&Entry| !by_hand.map(u16::from).contains(&entry.number);
        let telemetry = self.telemetry.iter().filter(generated);
        for entry in telemetry.filter(|entry| is_on_line || is_ours(entry)) {
            let mut limits = vec![("packet_type", "==", entry.number)];
            if is_on_line && entry.number == u16::from(telemetry_type::RECEIPT) {
                limits.push(("packet_source", "==", id::ASPECT.into()));
            }
            added.entry(entry, "", framing.root(), &limits);
        }
        (1..=LAYOUT).for_each(|layout| self.layout(layout, &mut added));
        let messages = self.messages.iter().filter(is_ours);
        for entry in messages.filter(|_| is_on_line) {
            added.entry(
                entry,
                "message_",
                "CommandPacket",
                &[("message_key", "==", entry.number)],
            );
        }
        let is_generated = |entry: &&Entry| !is_ours(entry) && entry.number != key::ASPECT_COMMAND;
        let messages = self.messages.iter().filter(is_generated);
        let mut argument_types = vec![
            number_type(Role::Argument, Number::U8, ""),
            number_type(Role::Argument, Number::U16, ""),
        ];
        let items = messages.clone().chain(&self.commands);
        for item in items.flat_map(|entry| &entry.items) {
            let (_, kind) = argument_type(item);
            kind.into_iter()
                .for_each(|kind| push(&mut argument_types, kind));
        }
        let commands = messages
            .map(message)
            .chain(self.commands.iter().map(aspect_command));
        let gaps = [
            ("root", framing.root().to_owned()),
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("parameter_types", added.types.join("\n")),
            ("parameters", added.parameters.join("\n")),
            ("containers", added.containers.join("\n")),
            ("argument_types", argument_types.join("\n")),
            ("commands", commands.collect::<Vec<_>>().join("\n")),
        ];
        filled(&framing.lines(include_str!("xtce.xml")), gaps)
    }

    /// Additions of a layout of the housekeeping to the previous one.
    fn layout(&self, layout: u8, added: &mut Added) {
        let own = self
            .housekeeping
            .iter()
            .filter(|(since, _)| *since == layout);
        let (name, base) = match layout {
            1 => ("Housekeeping1".to_owned(), "Housekeeping".to_owned()),
            layout => (
                format!("Housekeeping{layout}"),
                format!("Housekeeping{}", layout - 1),
            ),
        };
        let limits = [
            ("layout", ">=", layout.into()),
            ("layout", "<=", LAYOUT.into()),
        ];
        let documentation = format!("housekeeping of layout {layout} or later");
        let items = own.map(|(_, item)| item);
        added.container((&name, &documentation), "", items, &base, &limits);
    }
}

fn push(list: &mut Vec<String>, text: String) {
    if !list.contains(&text) {
        list.push(text);
    }
}

impl Added {
    /// A container of an entry's fields, whose names begin with the entry's name.
    fn entry(&mut self, entry: &Entry, prefix: &str, base: &str, limits: &[(&str, &str, u16)]) {
        let prefix = format!("{prefix}{}_", entry.name);
        let words = entry.name.split('_');
        let words = words.map(|word| word[..1].to_uppercase() + &word[1..]);
        let name: String = words.collect();
        self.container(
            (&name, entry.documentation),
            &prefix,
            entry.items.iter(),
            base,
            limits,
        );
    }

    /// A container, with name and description, that extends another one if some parameters are within limits; and the parameters of its items.
    fn container<'a>(
        &mut self,
        (name, documentation): (&str, &str),
        prefix: &str,
        items: impl Iterator<Item = &'a Item>,
        base: &str,
        limits: &[(&str, &str, u16)],
    ) {
        let mut entries = String::new();
        for (item, n) in items.flat_map(|item| (1..=item.count).map(move |n| (item, n))) {
            let name = match item.count {
                1 => format!("{prefix}{}", item.name),
                _ => format!("{prefix}{}_{n}", item.name),
            };
            // Codes of other telemetry remain numbers.
            let kind = match item.codes.filter(|_| prefix.is_empty()) {
                Some(codes) => enumerated(codes),
                None => number_type(Role::Parameter, item.number, item.unit),
            };
            let (reference, about) = (name_of(&kind), about(&item.documentation));
            push(
                &mut self.parameters,
                format!(r#"<Parameter parameterTypeRef="{reference}" name="{name}"{about}/>"#),
            );
            push(&mut self.types, kind);
            entries += &format!(r#"<ParameterRefEntry parameterRef="{name}"/>"#);
        }
        let limits = limits.iter().map(|(parameter, operator, value)| {
            let operator = escaped(operator);
            format!(r#"<Comparison parameterRef="{parameter}" comparisonOperator="{operator}" value="{value}" useCalibratedValue="false"/>"#)
        });
        let (about, limits) = (about(documentation), limits.collect::<String>());
        self.containers.push(format!(
            r#"<SequenceContainer name="{name}"{about}><EntryList>{entries}</EntryList><BaseContainer containerRef="{base}"><RestrictionCriteria><ComparisonList>{limits}</ComparisonList></RestrictionCriteria></BaseContainer></SequenceContainer>"#
        ));
    }
}

fn enumerated(codes: &Codes) -> String {
    let rows = codes.rows.iter();
    let rows =
        rows.map(|(value, label, _)| format!(r#"<Enumeration value="{value}" label="{label}"/>"#));
    let (name, encoding, rows) = (
        type_name("u8", codes.name),
        encoding(Number::U8),
        rows.collect::<String>(),
    );
    format!(
        r#"<EnumeratedParameterType name="{name}"><UnitSet/>{encoding}<EnumerationList>{rows}</EnumerationList></EnumeratedParameterType>"#
    )
}

/// A message to the aspect system.
fn message(entry: &Entry) -> String {
    let [low, high] = entry.number.to_le_bytes();
    let bytes: usize = entry.items.iter().map(|item| item.number.bytes()).sum();
    let key = format!(r#"<FixedValueEntry binaryValue="{low:02X}{high:02X}" sizeInBits="16"/>"#);
    meta_command(entry, "packet", 2 + bytes, &key)
}

/// The computers are the top 4 bits of the key, which is little-endian.
fn aspect_command(entry: &Entry) -> String {
    let [low, high] = entry.number.to_le_bytes();
    let key = format!(
        r#"<FixedValueEntry binaryValue="{low:02X}" sizeInBits="8"/><ArgumentRefEntry argumentRef="computers"/><FixedValueEntry binaryValue="{high:02X}" sizeInBits="4"/>"#
    );
    meta_command(entry, "aspect_command", 4 + 2 * entry.items.len(), &key)
}

fn meta_command(entry: &Entry, base: &str, payload: usize, key: &str) -> String {
    let (name, about_it) = (entry.name, about(entry.documentation));
    let arguments = entry.items.iter().map(|item| {
        let (kind, _) = argument_type(item);
        let documentation = match item.kind {
            None => about(&item.documentation),
            // Its type states the range.
            Some(_) => String::new(),
        };
        format!(
            r#"<Argument argumentTypeRef="{kind}" name="{}"{documentation}/>"#,
            item.name
        )
    });
    let arguments = match entry.items.is_empty() {
        true => String::new(),
        false => format!(
            "<ArgumentList>{}</ArgumentList>",
            arguments.collect::<String>()
        ),
    };
    let references = entry.items.iter();
    let references: String = references
        .map(|item| format!(r#"<ArgumentRefEntry argumentRef="{}"/>"#, item.name))
        .collect();
    format!(
        r#"<MetaCommand name="{name}"{about_it}><BaseMetaCommand metaCommandRef="{base}"><ArgumentAssignmentList><ArgumentAssignment argumentName="payload_length" argumentValue="{payload}"/></ArgumentAssignmentList></BaseMetaCommand>{arguments}<CommandContainer name="{name}"><EntryList>{key}{references}</EntryList><BaseContainer containerRef="{base}"/></CommandContainer></MetaCommand>"#
    )
}

/// The name of an argument's type, and the type's definition unless the text contains it.
fn argument_type(item: &Item) -> (String, Option<String>) {
    match item.kind {
        Some(Kind::Switch) => ("switch".into(), None),
        Some(Kind::Angle) => {
            let (low, high, _) = Kind::Angle.limits();
            let (name, units, range) = (
                type_name("angle_code", item.unit),
                units(item.unit),
                valid((low, high)),
            );
            let kind = format!(
                r#"<FloatArgumentType sizeInBits="32" name="{name}">{units}<IntegerDataEncoding sizeInBits="16" encoding="unsigned" byteOrder="leastSignificantByteFirst"><DefaultCalibrator><PolynomialCalibrator><Term coefficient="-1024" exponent="0"/><Term coefficient="0.125" exponent="1"/></PolynomialCalibrator></DefaultCalibrator></IntegerDataEncoding>{range}</FloatArgumentType>"#
            );
            (name, Some(kind))
        }
        _ => {
            let kind = number_type(Role::Argument, item.number, item.unit);
            (name_of(&kind).to_owned(), Some(kind))
        }
    }
}

/// The type of a number in its unit, named after both. An integer argument has its range.
fn number_type(role: Role, number: Number, unit: &str) -> String {
    let role_name = match role {
        Role::Parameter => "ParameterType",
        Role::Argument => "ArgumentType",
    };
    let (name, units, encoding) = (
        type_name(number.name(), unit),
        units(unit),
        encoding(number),
    );
    let bits = 8 * number.bytes();
    match (number.range(), role) {
        (None, _) => format!(
            r#"<Float{role_name} sizeInBits="{bits}" name="{name}">{units}{encoding}</Float{role_name}>"#
        ),
        (Some(limits), role) => {
            let signed = number == Number::I16;
            let range = match role {
                Role::Parameter => String::new(),
                Role::Argument => valid(limits),
            };
            format!(
                r#"<Integer{role_name} signed="{signed}" sizeInBits="{bits}" name="{name}">{units}{encoding}{range}</Integer{role_name}>"#
            )
        }
    }
}

fn valid((low, high): (f64, f64)) -> String {
    format!(
        r#"<ValidRangeSet><ValidRange minInclusive="{low}" maxInclusive="{high}"/></ValidRangeSet>"#
    )
}

fn encoding(number: Number) -> String {
    let (name, encoding) = match number {
        Number::F32 | Number::F64 => ("FloatDataEncoding", "IEEE754_1985"),
        Number::I16 => ("IntegerDataEncoding", "twosComplement"),
        _ => ("IntegerDataEncoding", "unsigned"),
    };
    let bits = 8 * number.bytes();
    format!(
        r#"<{name} sizeInBits="{bits}" encoding="{encoding}" byteOrder="leastSignificantByteFirst"/>"#
    )
}

fn units(unit: &str) -> String {
    match unit {
        "" => "<UnitSet/>".into(),
        unit => format!("<UnitSet><Unit>{}</Unit></UnitSet>", escaped(unit)),
    }
}

/// A name without characters that XTCE and programs do not allow.
fn type_name(wire: &str, unit: &str) -> String {
    let unit = unit
        .replace('%', "percent")
        .replace('/', "_per_")
        .replace(' ', "_");
    let unit = unit.replace(|c: char| !c.is_ascii_alphanumeric() && c != '_', "");
    match unit.is_empty() {
        true => wire.into(),
        false => format!("{wire}_{unit}"),
    }
}

/// The name in a type's definition.
fn name_of(kind: &str) -> &str {
    let (_, rest) = kind.split_once(" name=\"").unwrap_or_default();
    rest.split('"').next().unwrap_or_default()
}

fn about(documentation: &str) -> String {
    match documentation {
        "" => String::new(),
        text => format!(" shortDescription=\"{}\"", escaped(text)),
    }
}

fn escaped(text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    text.replace('>', "&gt;").replace('"', "&quot;")
}
