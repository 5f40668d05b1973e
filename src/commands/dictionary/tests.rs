use super::*;
use std::collections::HashSet;

/// The names of the elements of a kind, in their order.
fn names<'a>(xml: &'a str, element: &str) -> Vec<&'a str> {
    let element = format!("<{element} ");
    let starts = xml.split(&element).skip(1);
    let name = |rest: &'a str| rest.split_once("name=\"")?.1.split('"').next();
    starts.filter_map(name).collect()
}

#[test]
fn everything_of_the_tables_is_described() {
    let dictionary = Dictionary::default();
    let (ksy, xtce) = (dictionary.kaitai(), dictionary.xtce(Framing::Line));
    assert!(
        !ksy.contains('@') && !xtce.contains('@'),
        "a text is missing"
    );
    let lines: Vec<&str> = ksy.lines().collect();
    for pair in lines.windows(2) {
        // After a closed list or object no more items follow on the next line.
        let is_closed = pair[0].ends_with(']') || pair[0].ends_with("}");
        let indent = |line: &str| line.len() - line.trim_start().len();
        assert!(!is_closed || indent(pair[1]) <= indent(pair[0]), "{pair:?}");
    }
    let parameters = names(&xtce, "Parameter");
    for field in FIELDS {
        assert!(
            ksy.contains(&format!("- {{id: {}, ", field.name)),
            "{}",
            field.name
        );
        let name = match field.count {
            1 => field.name.to_owned(),
            _ => format!("{}_1", field.name),
        };
        assert!(parameters.contains(&&*name), "{name}");
    }
    let rows = MESSAGES.iter().map(|row| (row.key, row.name));
    let rows = rows.chain(TELEMETRY.iter().map(|row| (row.kind.into(), row.name)));
    for (key, name) in rows.chain(COMMANDS.iter().map(|row| (row.key, row.name))) {
        assert!(
            ksy.contains(&format!("    {key}: {{id: {name}, ")),
            "{name}"
        );
    }
    let commands = names(&xtce, "MetaCommand");
    for row in COMMANDS {
        assert!(commands.contains(&row.name), "{}", row.name);
    }
}

#[test]
fn names_occur_once() {
    let dictionary = Dictionary::default();
    let all = names_of(&dictionary.xtce(Framing::Line));
    let telemetry = names_of(&dictionary.xtce(Framing::Ccsds));
    assert!(all.iter().all(|count| *count > 5));
    let [parameters, containers, commands, _, arguments] = telemetry;
    assert_eq!((commands, arguments), (0, 0));
    assert!(parameters > 100 && containers < all[1]);
}

#[test]
fn a_space_packet_has_the_telemetry_of_the_aspect_system_behind_its_header() {
    let dictionary = Dictionary::default();
    let [line, ccsds] = [Framing::Line, Framing::Ccsds].map(|framing| dictionary.xtce(framing));
    assert!(!ccsds.contains('@') && !ccsds.contains('|') && !line.contains('|'));
    let containers = names(&ccsds, "SequenceContainer");
    assert!(containers.contains(&"CCSDSPacket") && !containers.contains(&"TelemetryPacket"));
    let others = ["TelemetryPacket", "CommandPacket", "ImuSample"];
    for name in names(&line, "SequenceContainer") {
        let is_message = line.contains(&format!(r#"name="{name}""#)) && {
            let (_, rest) = line
                .split_once(&format!(r#"<SequenceContainer name="{name}""#))
                .unwrap();
            rest.split_once("</SequenceContainer>")
                .unwrap()
                .0
                .contains("message_key")
        };
        let is_left_out = is_message || others.contains(&name);
        assert_eq!(containers.contains(&name), !is_left_out, "{name}");
    }
}

/// Numbers of parameters, containers, commands, and types of parameters and arguments, each with a name of its own.
fn names_of(xtce: &str) -> [usize; 5] {
    let types = [
        "Integer",
        "Float",
        "Enumerated",
        "Boolean",
        "Binary",
        "String",
    ];
    let all = |role: &str| -> Vec<&str> {
        let kinds = types.iter();
        kinds
            .flat_map(|kind| names(xtce, &format!("{kind}{role}Type")))
            .collect()
    };
    [
        names(xtce, "Parameter"),
        names(xtce, "SequenceContainer"),
        names(xtce, "MetaCommand"),
        all("Parameter"),
        all("Argument"),
    ]
    .map(|names| {
        let different: HashSet<&str> = names.iter().copied().collect();
        assert_eq!(names.len(), different.len(), "{names:?}");
        names.len()
    })
}

#[test]
fn every_type_of_the_json_is_defined_and_no_opcode_or_name_occurs_twice() {
    let json = Dictionary::default().json();
    let list = |key: &str| json[key].as_array().unwrap().clone();
    let defined: HashSet<Value> = list("typeDefinitions")
        .iter()
        .map(|d| d["qualifiedName"].clone())
        .collect();
    assert_eq!(defined.len(), list("typeDefinitions").len());
    let params = [list("commands"), list("events")].concat();
    let params = params
        .iter()
        .flat_map(|entry| entry["formalParams"].as_array().unwrap().clone());
    let mut types = params
        .chain(list("telemetryChannels"))
        .map(|typed| typed["type"].clone());
    assert!(
        types.all(|kind| kind["kind"] != "qualifiedIdentifier" || defined.contains(&kind["name"]))
    );
    for (key, number) in [
        ("commands", "opcode"),
        ("events", "id"),
        ("telemetryChannels", "id"),
    ] {
        let numbers: HashSet<Value> = list(key)
            .iter()
            .map(|entry| entry[number].clone())
            .collect();
        let names: HashSet<Value> = list(key)
            .iter()
            .map(|entry| entry["name"].clone())
            .collect();
        assert_eq!(
            (numbers.len(), names.len()),
            (list(key).len(), list(key).len()),
            "{key}"
        );
    }
    assert_eq!(list("telemetryChannels").len(), FIELDS.len());
    assert_eq!(list("commands").len(), COMMANDS.len() + 4);
}
