//! Payloads of telemetry that are more than a table of numbers.

use super::{attribute, documented, of_field, to_the_end, value};
use crate::commands::schema::yaml::{Yaml, map};
use crate::link::housekeeping::{LAYOUT, fields_by_layout};

/// Fields that a layout does not have are absent.
pub fn housekeeping() -> Yaml {
    let layout = format!("{LAYOUT}: the layout of this description; earlier ones end sooner");
    let mut seq = vec![attribute("layout", "u1").with("doc", layout)];
    seq.extend(fields_by_layout().map(|(since, field)| {
        let field = of_field(&field.plain(), &field.in_words());
        field.with("if", format!("known_layout >= {since}"))
    }));
    seq.push(to_the_end("rest").with("doc", "what a later layout has"));
    let known = value(format!("layout <= {LAYOUT} ? layout : 0"));
    let known = known.with(
        "doc",
        "the layout; 0 for one that this description does not know",
    );
    let instances = map([("known_layout", known)]);
    documented("Status of the aspect system, each second. A field that the packet's layout does not have is absent.")
        .with("seq", seq)
        .with("instances", instances)
}

pub fn section() -> Yaml {
    let pixels = to_the_end("pixels").with("doc", "8 bits each");
    let seq = vec![
        attribute("is_last", "b1").with("doc", "this is the last section"),
        attribute("reserved", "b7"),
        attribute("first_pixel", "b24").with("doc", "number of its first pixel, row by row"),
        attribute("zero", "b1"),
        attribute("depth", "b3").with("doc", "3: 8 bits a pixel"),
        attribute("camera", "b4").with("doc", "1, 2: pitch-yaw; 6: roll; 7: Moon"),
        attribute("height", "b12").with("-unit", "px"),
        attribute("width", "b12").with("-unit", "px"),
        pixels,
    ];
    documented("A run of pixels of a picture.").with("seq", seq)
}

pub fn tag() -> Yaml {
    let text = |id: &str, size| {
        attribute(id, "str")
            .with("size", Yaml::Number(size))
            .with("encoding", "UTF-8")
            .with("terminator", Yaml::Number(0))
    };
    let value_bytes = map([("id", "value_bytes".into()), ("size", Yaml::Number(16))]);
    let seq = vec![
        value_bytes,
        attribute("tag_type", "u1").with("enum", "tag_type"),
        attribute("camera", "u1"),
        text("name", 8),
        text("comment", 32),
    ];
    let at_start = |kind: Yaml, of: &str| {
        map([
            ("pos", Yaml::Number(0)),
            ("type", kind),
            ("if", format!("tag_type == tag_type::{of}").into()),
        ])
    };
    let words = map([
        ("pos", Yaml::Number(0)),
        ("size", Yaml::Number(16)),
        ("type", "str".into()),
        ("encoding", "UTF-8".into()),
        ("terminator", Yaml::Number(0)),
        ("if", "tag_type == tag_type::text".into()),
    ]);
    let instances = map([
        ("text", words),
        ("whole", at_start("s4".into(), "whole")),
        ("number", at_start("f8".into(), "number")),
    ]);
    documented("A keyword of a picture; its value is text, whole or number, by its type.")
        .with("seq", seq)
        .with("instances", instances)
}
