//! The link as a description in XTCE 1.2 (XML Telemetric and Command Exchange, OMG).

mod commands;
mod telemetry;
mod types;

use super::CHECKSUM;
use super::xml::Element;
use crate::link::number::Number;

const ABOUT: &str = "The controller link of solaspect, made by `solaspect link describe --format xtce`. Containers of packets: TelemetryPacket, with telemetry \
either way, and CommandPacket, with messages of the aspect system to the controller, which are sent one in a packet. Numbers are \
little-endian but for the checksum.";

const NAMESPACE: &str = "http://www.omg.org/spec/XTCE/20180204";

/// The description: XML.
pub fn xtce() -> String {
    let header = Element::new("Header")
        .with("version", env!("CARGO_PKG_VERSION"))
        .with("validationStatus", "Working");
    Element::new("SpaceSystem")
        .with("xmlns", NAMESPACE)
        .with("xmlns:xsi", "http://www.w3.org/2001/XMLSchema-instance")
        .with(
            "xsi:schemaLocation",
            format!("{NAMESPACE} https://www.omg.org/spec/XTCE/20180204/SpaceSystem.xsd"),
        )
        .with("name", "solaspect_link")
        .with("shortDescription", "Controller link of solaspect")
        .child(Element::new("LongDescription").text(ABOUT))
        .child(header)
        .child(telemetry::meta_data())
        .child(commands::meta_data())
        .document()
}

/// Whether a type is one of a parameter (telemetry) or of an argument (commands).
#[derive(Clone, Copy)]
enum Role {
    Parameter,
    Argument,
}

impl Role {
    fn element(self, kind: &str) -> Element {
        Element::new(match self {
            Self::Parameter => format!("{kind}ParameterType"),
            Self::Argument => format!("{kind}ArgumentType"),
        })
    }
}

/// The type of a number in its unit, named after both. An integer argument has its range.
fn number_type(role: Role, number: Number, unit: &str) -> Element {
    let element = match range(number) {
        None => role.element("Float"),
        Some(_) => role
            .element("Integer")
            .with("signed", number == Number::I16),
    };
    let element = element
        .with("sizeInBits", 8 * number.bytes())
        .with(
            "name",
            type_name(&format!("{number:?}").to_lowercase(), unit),
        )
        .child(units(unit))
        .child(encoding(number, "leastSignificantByteFirst"));
    match (role, range(number)) {
        (Role::Argument, Some((low, high))) => element.child(valid_range(low, high)),
        _ => element,
    }
}

/// The range of an integer.
fn range(number: Number) -> Option<(i64, i64)> {
    match number {
        Number::U8 => Some((0, u8::MAX.into())),
        Number::U16 => Some((0, u16::MAX.into())),
        Number::I16 => Some((i16::MIN.into(), i16::MAX.into())),
        Number::U32 => Some((0, u32::MAX.into())),
        Number::F32 | Number::F64 => None,
    }
}

fn valid_range(low: impl ToString, high: impl ToString) -> Element {
    let range = Element::new("ValidRange")
        .with("minInclusive", low)
        .with("maxInclusive", high);
    Element::new("ValidRangeSet").child(range)
}

fn encoding(number: Number, byte_order: &str) -> Element {
    let (name, encoding) = match number {
        Number::F32 | Number::F64 => ("FloatDataEncoding", "IEEE754_1985"),
        Number::I16 => ("IntegerDataEncoding", "twosComplement"),
        _ => ("IntegerDataEncoding", "unsigned"),
    };
    Element::new(name)
        .with("sizeInBits", 8 * number.bytes())
        .with("encoding", encoding)
        .with("byteOrder", byte_order)
}

fn unsigned_bits(bits: usize) -> Element {
    Element::new("IntegerDataEncoding")
        .with("sizeInBits", bits)
        .with("encoding", "unsigned")
}

fn units(unit: &str) -> Element {
    let set = Element::new("UnitSet");
    match unit {
        "" => set,
        unit => set.child(Element::new("Unit").text(unit)),
    }
}

/// A name without what XTCE and programs do not allow in one.
fn type_name(wire: &str, unit: &str) -> String {
    let unit = unit.replace('%', "percent").replace('/', "_per_");
    let unit: String = unit
        .chars()
        .filter_map(|c| match c {
            ' ' => Some('_'),
            c => (c.is_ascii_alphanumeric() || c == '_').then_some(c),
        })
        .collect();
    match unit.is_empty() {
        true => wire.into(),
        false => format!("{wire}_{unit}"),
    }
}

fn enumeration<'a>(rows: impl IntoIterator<Item = (u16, &'a str)>) -> Element {
    let rows = rows.into_iter().map(|(number, label)| {
        Element::new("Enumeration")
            .with("value", number)
            .with("label", label)
    });
    Element::new("EnumerationList").children(rows)
}

/// The CRC of a checksum field.
fn checksum_encoding() -> Element {
    let crc = Element::new("CRC")
        .with("width", 16)
        .with("reflectData", true)
        .with("reflectRemainder", true)
        .with("bitsFromReference", 0)
        .with("reference", "start")
        .child(Element::new("Polynomial").text("8005"))
        .child(Element::new("InitRemainder").text("FFFF"))
        .child(Element::new("FinalXOR").text("0000"));
    encoding(Number::U16, "mostSignificantByteFirst")
        .child(Element::new("ErrorDetectCorrect").child(crc))
}

/// The type of the checksum.
fn checksum_type(role: Role) -> Element {
    role.element("Integer")
        .with("signed", false)
        .with("sizeInBits", 16)
        .with("name", "checksum")
        .with("shortDescription", CHECKSUM)
        .child(units(""))
        .child(checksum_encoding())
}
