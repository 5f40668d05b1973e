//! Commands to the aspect system.

use super::{
    Role, checksum_type, enumeration, number_type, type_name, units, unsigned_bits, valid_range,
};
use crate::commands::schema::xml::Element;
use crate::commands::{COMMANDS, CommandRow, Kind, Variable};
use crate::link::message::{MESSAGES, MessageRow, key};
use crate::link::number::Number;
use crate::link::packet::{Direction, SYNC, id};

pub fn meta_data() -> Element {
    let messages = MESSAGES
        .iter()
        .filter(|row| row.direction == Direction::ToAspect);
    let messages: Vec<&MessageRow> = messages
        .filter(|row| row.key != key::ASPECT_COMMAND)
        .collect();
    let mut types = vec![
        number_type(Role::Argument, Number::U8, ""),
        number_type(Role::Argument, Number::U16, ""),
        checksum_type(Role::Argument),
        computers(),
    ];
    let fields = messages.iter().flat_map(|row| row.fields());
    let fields = fields.map(|field| number_type(Role::Argument, field.number, field.unit));
    let variables = COMMANDS
        .iter()
        .flat_map(|row| row.variables)
        .map(variable_type);
    for kind in fields.chain(variables) {
        if !types.contains(&kind) {
            types.push(kind);
        }
    }
    let set = Element::new("MetaCommandSet")
        .child(packet())
        .children(messages.into_iter().map(message))
        .child(aspect_command())
        .children(COMMANDS.iter().map(command));
    Element::new("CommandMetaData")
        .child(Element::new("ArgumentTypeSet").children(types))
        .child(set)
}

/// The header of every command packet.
fn packet() -> Element {
    let arguments = vec![
        argument("payload_length", "u8", "bytes after the header"),
        argument("sequence", "u16", "the sender's number of the packet"),
        argument("checksum", "checksum", "of the whole packet"),
    ];
    let entries = vec![
        fixed(&SYNC, 16),
        fixed(&[id::ASPECT], 8),
        reference("payload_length"),
        reference("sequence"),
        reference("checksum"),
    ];
    MetaCommand::new("packet", "A command packet to the aspect system")
        .finish_abstract(arguments, entries)
}

fn message(row: &MessageRow) -> Element {
    let fields = row.fields();
    let arguments = fields.iter().map(|field| {
        let kind = number_type(Role::Argument, field.number, field.unit);
        argument(
            field.name,
            kind.attribute("name").unwrap_or_default(),
            field.documentation,
        )
    });
    let entries = [fixed(&row.key.to_le_bytes(), 16)].into_iter();
    let entries = entries.chain(fields.iter().map(|field| reference(field.name)));
    MetaCommand::new(row.name, row.documentation)
        .extending("packet", Some(2 + row.bytes))
        .finish(arguments.collect(), entries.collect())
}

fn aspect_command() -> Element {
    let arguments = vec![argument(
        "computers",
        "computers",
        "the computers it is for",
    )];
    MetaCommand::new("aspect_command", "A command of the ground")
        .extending("packet", None)
        .finish_abstract(
            arguments,
            vec![fixed(&key::ASPECT_COMMAND.to_le_bytes(), 16)],
        )
}

/// The computers are the top 4 bits of the key, which is little-endian.
fn command(row: &CommandRow) -> Element {
    let [low, high] = row.key.to_le_bytes();
    let arguments = row.variables.iter().map(|variable| {
        let kind = variable_type(variable);
        argument(
            variable.name,
            kind.attribute("name").unwrap_or_default(),
            "",
        )
    });
    let key = [fixed(&[low], 8), reference("computers"), fixed(&[high], 4)];
    let variables = row
        .variables
        .iter()
        .map(|variable| reference(variable.name));
    MetaCommand::new(row.name, row.documentation)
        .extending("aspect_command", Some(4 + 2 * row.variables.len()))
        .finish(
            arguments.collect(),
            key.into_iter().chain(variables).collect(),
        )
}

/// A command that is being written.
struct MetaCommand {
    name: &'static str,
    element: Element,
    base: Option<&'static str>,
}

impl MetaCommand {
    fn new(name: &'static str, documentation: &str) -> Self {
        let element = Element::new("MetaCommand")
            .with("name", name)
            .with("shortDescription", documentation);
        Self {
            name,
            element,
            base: None,
        }
    }

    /// As an addition to another command, with the payload's length where that is known.
    fn extending(self, base: &'static str, payload: Option<usize>) -> Self {
        let assignment = payload.map(|length| {
            let length = Element::new("ArgumentAssignment")
                .with("argumentName", "payload_length")
                .with("argumentValue", length);
            Element::new("ArgumentAssignmentList").child(length)
        });
        let extended = Element::new("BaseMetaCommand")
            .with("metaCommandRef", base)
            .children(assignment);
        Self {
            element: self.element.child(extended),
            base: Some(base),
            ..self
        }
    }

    fn finish_abstract(mut self, arguments: Vec<Element>, entries: Vec<Element>) -> Element {
        self.element = self.element.with("abstract", true);
        self.finish(arguments, entries)
    }

    fn finish(self, arguments: Vec<Element>, entries: Vec<Element>) -> Element {
        let list = Element::new("ArgumentList").children(arguments.iter().cloned());
        let base = self
            .base
            .map(|base| Element::new("BaseContainer").with("containerRef", base));
        let container = Element::new("CommandContainer")
            .with("name", self.name)
            .child(Element::new("EntryList").children(entries))
            .children(base);
        self.element
            .children((!arguments.is_empty()).then_some(list))
            .child(container)
    }
}

fn argument(name: &str, kind: &str, documentation: &str) -> Element {
    Element::new("Argument")
        .with("argumentTypeRef", kind)
        .with("name", name)
        .with_some("shortDescription", documentation)
}

fn reference(argument: &str) -> Element {
    Element::new("ArgumentRefEntry").with("argumentRef", argument)
}

fn fixed(bytes: &[u8], bits: usize) -> Element {
    let digits: String = bytes.iter().map(|byte| format!("{byte:02X}")).collect();
    Element::new("FixedValueEntry")
        .with("binaryValue", digits)
        .with("sizeInBits", bits)
}

fn computers() -> Element {
    let names = [(1, "computer_1"), (2, "computer_2"), (3, "both")];
    Role::Argument
        .element("Enumerated")
        .with("name", "computers")
        .child(units(""))
        .child(unsigned_bits(4))
        .child(enumeration(names))
}

/// The type of a variable, with the range of its kind.
fn variable_type(variable: &Variable) -> Element {
    let plain = number_type(Role::Argument, variable.kind.number(), variable.unit);
    let encoding = super::encoding(variable.kind.number(), "leastSignificantByteFirst");
    match variable.kind {
        Kind::Switch => Role::Argument
            .element("Boolean")
            .with("name", "switch")
            .with("oneStringValue", "on")
            .with("zeroStringValue", "off")
            .child(units(""))
            .child(encoding),
        Kind::Angle => {
            let (low, high) = (variable.kind.value(0), variable.kind.value(u16::MAX));
            Role::Argument
                .element("Float")
                .with("sizeInBits", 32)
                .with("name", type_name("angle_code", variable.unit))
                .child(units(variable.unit))
                .child(encoding.child(angle_calibrator()))
                .child(valid_range(low, high))
        }
        Kind::Signed | Kind::Unsigned => plain,
    }
}

/// code / 8 - 1024.
fn angle_calibrator() -> Element {
    let terms = [
        (0, Kind::Angle.value(0)),
        (1, Kind::Angle.value(1) - Kind::Angle.value(0)),
    ];
    let terms = terms.map(|(exponent, coefficient)| {
        Element::new("Term")
            .with("coefficient", coefficient)
            .with("exponent", exponent)
    });
    Element::new("DefaultCalibrator").child(Element::new("PolynomialCalibrator").children(terms))
}
