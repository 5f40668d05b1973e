//! Types of parameters that are more than a number, and comparisons.

use super::{encoding, enumeration, type_name, units};
use crate::commands::schema::xml::Element;
use crate::link::number::{Codes, Number};

pub fn comparison(parameter: &str, operator: &str, value: u16) -> Element {
    Element::new("Comparison")
        .with("parameterRef", parameter)
        .with("comparisonOperator", operator)
        .with("value", value)
        .with("useCalibratedValue", false)
}

pub fn integer(name: &str, encoding: Element) -> Element {
    Element::new("IntegerParameterType")
        .with("signed", false)
        .with("name", name)
        .child(units(""))
        .child(encoding)
}

pub fn enumerated(codes: &Codes) -> Element {
    Element::new("EnumeratedParameterType")
        .with("name", type_name("u8", codes.name))
        .child(units(""))
        .child(encoding(Number::U8, "leastSignificantByteFirst"))
        .child(enumeration(
            codes.rows.iter().map(|(number, name, _)| (*number, *name)),
        ))
}

pub fn binary(name: &str, size: Element) -> Element {
    let size = Element::new("SizeInBits").child(size);
    Element::new("BinaryParameterType")
        .with("name", name)
        .child(units(""))
        .child(Element::new("BinaryDataEncoding").child(size))
}

pub fn text(name: &str, bytes: usize) -> Element {
    let size = Element::new("Fixed").child(Element::new("FixedValue").text(8 * bytes));
    let encoding = Element::new("StringDataEncoding").with("encoding", "UTF-8");
    Element::new("StringParameterType")
        .with("name", name)
        .child(units(""))
        .child(encoding.child(Element::new("SizeInBits").child(size)))
}

pub fn unix_seconds() -> Element {
    let encoding = Element::new("Encoding")
        .with("units", "seconds")
        .child(encoding(Number::U32, "leastSignificantByteFirst"));
    let reference = Element::new("ReferenceTime").child(Element::new("Epoch").text("UNIX"));
    Element::new("AbsoluteTimeParameterType")
        .with("name", "unix_seconds")
        .child(encoding)
        .child(reference)
}

/// The name of a row as that of a container.
pub fn camel(name: &str) -> String {
    let words = name.split('_').map(|word| {
        let (first, rest) = word.split_at(1.min(word.len()));
        first.to_uppercase() + rest
    });
    words.collect()
}
