use super::*;
use crate::commands::COMMANDS;
use crate::link::housekeeping::FIELDS;
use crate::link::message::MESSAGES;
use crate::link::telemetry::TELEMETRY;
use std::collections::HashSet;
use xml::Element;
use yaml::{Yaml, map};

/// The values of an attribute of XML, in their order.
fn attributes<'a>(text: &'a str, before: &str) -> Vec<&'a str> {
    let parts = text.split(before).skip(1);
    parts.filter_map(|part| part.split('"').next()).collect()
}

#[test]
fn everything_of_the_tables_is_described() {
    let (ksy, xtce) = (kaitai(), xtce());
    for field in FIELDS {
        assert!(
            ksy.contains(&format!("- id: {}\n", field.name)),
            "{}",
            field.name
        );
        let name = match field.count {
            1 => field.name.to_owned(),
            _ => format!("{}_1", field.name),
        };
        assert!(xtce.contains(&format!("parameterRef=\"{name}\"")), "{name}");
    }
    for (key, name) in MESSAGES.iter().map(|row| (row.key, row.name)) {
        assert!(
            ksy.contains(&format!("{key}:\n      id: {name}\n")),
            "{name}"
        );
    }
    for row in TELEMETRY {
        assert!(
            ksy.contains(&format!("\"telemetry_type::{}\"", row.name)),
            "{}",
            row.name
        );
    }
    let commands = attributes(&xtce, "<MetaCommand name=\"");
    for row in COMMANDS {
        assert!(ksy.contains(&format!("{}:\n      id: {}\n", row.key, row.name)));
        assert!(commands.contains(&row.name), "{}", row.name);
    }
}

#[test]
fn names_occur_once() {
    let text = xtce();
    for kind in [
        "Parameter ",
        "ParameterType ",
        "SequenceContainer ",
        "MetaCommand ",
        "ArgumentType ",
    ] {
        let lines = text
            .lines()
            .filter(|line| line.contains(kind) && line.contains(" name=\""));
        let names: Vec<&str> = lines
            .flat_map(|line| attributes(line, " name=\""))
            .collect();
        let different: HashSet<&str> = names.iter().copied().collect();
        assert_eq!(names.len(), different.len(), "{kind}");
    }
}

#[test]
fn texts_are_quoted_where_they_must_be() {
    let node = map([
        ("on", "a: \"b\"\\".into()),
        ("list", vec![map([("-unit", "px".into())])].into()),
    ]);
    let expected = "\"on\": \"a: \\\"b\\\"\\\\\"\nlist:\n  - -unit: px\n";
    assert_eq!(node.document(), expected);
    assert_eq!(Yaml::from("1e3").document(), "\"1e3\"\n");
    let element = Element::new("a").with("b", "<\"&").text("x > y");
    assert!(
        element
            .document()
            .ends_with("<a b=\"&lt;&quot;&amp;\">x &gt; y</a>\n")
    );
}
