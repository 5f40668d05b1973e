use super::super::ClockStep;
use super::super::comparison::{ComparedAxis, Contradiction};
use super::super::mapping::TemperatureDependence;
use super::super::roll_output::RollSummary;
use super::*;
use crate::navigation::Axis;
use crate::units::Measured;
use serde_json::Value;
use std::collections::BTreeSet;

const ONE: Measured = Measured {
    value: 1.0,
    sigma: 0.1,
};

/// Names that the documentation gives for a key, or that the program writes below it.
type Keys = BTreeMap<String, BTreeSet<String>>;

/// A summary that contains all keys.
fn summary(temperature: TemperatureDependence) -> Summary {
    let swing = FoundSwing {
        period_s: 3.47,
        damping_s: Some(43.0),
        damping_least_s: 21.4,
        rms: 10.0,
    };
    Summary {
        program: PROGRAM,
        commit: None,
        times: "",
        instrument: String::new(),
        recipe_hash: String::new(),
        instrument_hash: String::new(),
        settings_hash: String::new(),
        configuration_sha256: None,
        instrument_sha256: None,
        table_sha256: String::new(),
        counts: Counts::default(),
        own_fine: 0,
        second_pass: 0,
        inputs: InputSummary::default(),
        median_sigma_mil: None,
        median_sigma_arcsec: None,
        radius_over_expected: None,
        radius_by_temperature: RadiusDependence::Linear { per_degc: ONE },
        mapping: Some(mapping(temperature)),
        clock: ClockFacts {
            drift_ppm: Some(ONE),
            steps: vec![ClockStep {
                frame: String::new(),
                step_s: ONE,
            }],
            corrected: 0,
        },
        path_process_noise_mil_per_s2_5: None,
        pointing: PointingFacts {
            cameras_against_gyros: Some(compared()),
            on_target: Some(OnTarget {
                valid_s: 0.0,
                within_20_arcsec_s: 0.0,
                within_60_arcsec_s: 0.0,
                median_arcsec: 0.0,
            }),
        },
        swings_mil: [vec![swing], vec![]],
    }
}

fn compared() -> Compared {
    let axis = |axis| ComparedAxis {
        axis,
        frames: 0,
        rms_over_sigma: 1.0,
        most_over_sigma: 3.0,
    };
    Compared {
        axes: Axis::ALL.map(axis).into(),
        findings: vec![Contradiction {
            axis: Axis::Roll,
            first_utc: String::new(),
            last_utc: String::new(),
            most_over_sigma: 6.0,
            during_s: [0.0; 2],
        }],
        differences: Default::default(),
    }
}

fn mapping(temperature: TemperatureDependence) -> MappingSummary {
    let jump = Jump {
        after: 1,
        before: 0,
        shift_px: [1.0, 0.0],
        turn_deg: 0.0,
    };
    MappingSummary {
        facts: MappingFacts {
            jumps: vec![jump],
            process_noise_px: [0.0; 2],
            inflation: 1.0,
            temperature,
        },
        jumps: vec![NamedJump {
            file: String::new(),
            utc: None,
            jump,
        }],
    }
}

fn roll_summary() -> RollSummary {
    RollSummary {
        program: PROGRAM,
        commit: None,
        times: "",
        configuration_sha256: None,
        camera_sha256: None,
        table_sha256: String::new(),
        counts: Counts::default(),
        inputs: InputSummary::default(),
        remarks: BTreeMap::new(),
        frame_sigma_deg: None,
        smoothed_sigma_deg: None,
        changing_part: [0.0; 2],
    }
}

/// The keys of a summary, and below each its names: keys and words. Value and sigma are written as words on the page.
fn written(keys: &mut Keys, summary: &impl Serialize) {
    let Value::Object(summary) = serde_json::to_value(summary).unwrap() else {
        panic!("a summary is an object");
    };
    for (key, value) in summary {
        names(&value, keys.entry(key).or_default());
    }
}

fn names(value: &Value, found: &mut BTreeSet<String>) {
    match value {
        Value::Object(all) => {
            let measured = all.keys().eq(["sigma", "value"]);
            for (key, value) in all.iter().filter(|_| !measured) {
                found.insert(key.clone());
                names(value, found);
            }
        }
        Value::Array(all) => all.iter().for_each(|value| names(value, found)),
        Value::String(word) if is_name(word) => _ = found.insert(word.clone()),
        _ => {}
    }
}

fn is_name(word: &str) -> bool {
    let legal = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_';
    word.starts_with(|c: char| c.is_ascii_lowercase()) && word.bytes().all(legal)
}

/// The texts between backticks.
fn quoted(text: &str) -> impl Iterator<Item = String> {
    let names = text.split('`').skip(1).step_by(2);
    names.filter(|name| is_name(name)).map(String::from)
}

/// The keys of a section's table, each with the names in its description.
fn documented(section: &str) -> Keys {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/refine-reference.md");
    let page = std::fs::read_to_string(path).unwrap();
    let (_, rest) = page.split_once(&format!("## {section}\n")).unwrap();
    let section = rest.split("\n## ").next().unwrap();
    let mut keys = Keys::new();
    for row in section.lines().filter(|line| line.starts_with("| `")) {
        let (key, meaning) = row[2..].split_once(" | ").unwrap();
        keys.extend(quoted(key).map(|key| (key, quoted(meaning).collect())));
    }
    keys
}

#[test]
fn the_page_has_every_key_of_the_summaries() {
    let mut keys = Keys::new();
    let temperatures = [
        TemperatureDependence::NotObservable,
        TemperatureDependence::Insignificant { gain: 0.0 },
        TemperatureDependence::Linear {
            gain: 9.0,
            px_per_degc: [ONE; 4],
        },
    ];
    for temperature in temperatures {
        written(&mut keys, &summary(temperature));
    }
    assert_eq!(keys, documented("summary.json"));

    let mut keys = Keys::new();
    written(&mut keys, &roll_summary());
    let documented = documented("roll.json");
    assert!(keys.keys().eq(documented.keys()), "{documented:?}");
}

#[test]
fn a_damping_time_that_is_not_determined_has_no_number_but_its_least() {
    let swing = |damping_s| FoundSwing {
        period_s: 3.47,
        damping_s,
        damping_least_s: 21.4,
        rms: 10.0,
    };
    let text = swings_text(&[swing(None), swing(Some(43.0))]);
    let expected = "3.47 s, amplitude 14.14 mil, damping not determined: longer than 21 s; \
                    3.47 s, amplitude 14.14 mil, damping time 43 s (longer than 21 s)";
    assert_eq!(text, expected);
    assert_eq!(swings_text(&[]), "none found");
    let json = serde_json::to_value(swing(None)).unwrap();
    assert!(json["damping_s"].is_null());
}
