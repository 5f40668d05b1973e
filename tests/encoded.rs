//! Formats that other programs and stored flights depend on stay the same byte for byte: packets in both directions,
//! housekeeping of every layout, and a frame's values as rows, telemetry, JSON and keywords.
//!
//! `tests/data/encoded.txt` holds the encoding of fixed inputs. With `SOLASPECT_WRITE_DATA` set it is rewritten: only for
//! an intended change of the format on a line or a disk.

use jiff::Timestamp;
use solaspect::archive::disk::LocalDisk;
use solaspect::archive::{Dirfile, SolutionLog};
use solaspect::aspect::{Quality, Solution, Stage};
use solaspect::clock::Utc;
use solaspect::commands::COMMANDS;
use solaspect::frame::Levels;
use solaspect::link::housekeeping::{FIELDS, LAYOUT, MarkIds, fields_by_layout};
use solaspect::link::{
    AspectCommand, CommandOutcome, ExposureStart, GpsFix, Housekeeping, Message, MoonAnswer,
    MoonFix, MoonOutcome, MoonRequest, NoSolution, Propagated, Receipt, Telemetry,
};
use solaspect::record::{
    ArchiveState, LoggedRow, MappingRecord, MarkRecord, MoonRecord, OffsetRecord, Reason, Record,
    RollRecord,
};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/encoded.txt");

fn time() -> Timestamp {
    "2013-09-21T18:00:00.125Z".parse().unwrap()
}

fn hex(bytes: &[u8]) -> String {
    let mut text = String::new();
    for byte in bytes {
        write!(text, "{byte:02x}").unwrap();
    }
    text
}

fn messages() -> Vec<Message> {
    let time = time();
    let solution = solaspect::link::Solution {
        azimuth_deg: -0.123_456_789,
        elevation_deg: 0.25,
        roll_deg: 1.5,
        error_deg: 2.5e-5,
        time,
    };
    let moon = |outcome| {
        Message::from(MoonAnswer {
            request: 9,
            outcome,
        })
    };
    let mut all = vec![
        Message::TrackingOn,
        Message::TrackingOff,
        Message::Solution(solution),
        Message::Error(NoSolution { code: 7 }),
        Message::ExposureStart(ExposureStart { camera: 1, time }),
        Message::Propagated(Propagated {
            solution,
            age_ms: 1250,
        }),
        moon(MoonOutcome::Found(MoonFix {
            x_px: 359.5,
            y_px: 288.25,
            covariance_px2: [1e-3, -2e-4, 4e-3],
            direction: [0.0, 0.6, 0.8],
            time,
        })),
        moon(MoonOutcome::NotVisible { code: 2 }),
        moon(MoonOutcome::NotFound { code: 1 }),
        Message::StartTracking,
        Message::StopTracking,
        Message::Gps(GpsFix {
            latitude_deg: 34.5,
            longitude_deg: -104.25,
        }),
        Message::MoonRequest(MoonRequest {
            latitude_deg: 34.5,
            longitude_deg: -104.25,
            height_m: 38_000.0,
        }),
    ];
    for command in COMMANDS {
        let key = 0x1000 | command.key;
        let variables = (1..=key & 15).collect();
        let command = AspectCommand::new(key, variables).unwrap();
        all.push(Message::Aspect(command));
    }
    all
}

fn packets(text: &mut String) {
    for (n, message) in messages().iter().enumerate() {
        let packet = message.packet(7, n as u16).unwrap();
        writeln!(text, "message {}", hex(&packet.encode())).unwrap();
        assert_eq!(&Message::decode(packet.payload()).unwrap(), message);
    }
    for housekeeping in [
        Telemetry::Receipt(Receipt { sequence: 7 }),
        Telemetry::Result(CommandOutcome {
            sequence: 7,
            key: 0x0105,
            value: 2,
        }),
    ] {
        let packet = housekeeping.packet(time()).unwrap();
        writeln!(text, "telemetry {}", hex(&packet.encode())).unwrap();
    }
}

/// Housekeeping with a different value in each field: the first of several candidates that the field accepts.
fn full() -> Housekeeping {
    let mut values = Vec::new();
    for (n, field) in FIELDS.iter().enumerate() {
        let default = Housekeeping::default().csv_row()[n].clone();
        let candidates = [
            (n % 90 + 1).to_string(),
            format!("{n}.25"),
            "1".into(),
            "0123abcd".into(),
            "-7,7 0,0".into(),
            default,
        ];
        let takes = |value: &String| {
            let one = |name: &str| (name == field.name).then_some(value.as_str());
            Housekeeping::from_csv(one).is_some()
        };
        values.push(candidates.into_iter().find(takes).unwrap());
    }
    let value = |name: &str| {
        let at = FIELDS.iter().position(|field| field.name == name)?;
        Some(values[at].as_str())
    };
    let housekeeping = Housekeeping::from_csv(value).unwrap();
    Housekeeping {
        ids: MarkIds::new([[-7, 7], [0, 0]]),
        ..housekeeping
    }
}

fn housekeeping(text: &mut String) {
    for housekeeping in [Housekeeping::default(), full()] {
        writeln!(text, "housekeeping {}", hex(&housekeeping.payload())).unwrap();
        writeln!(text, "row {}", housekeeping.csv_row().join(";")).unwrap();
        writeln!(text, "lines {}", housekeeping.lines().join("|")).unwrap();
    }
    let payload = full().payload();
    for layout in 1..=LAYOUT {
        let known = fields_by_layout().filter(|(since, _)| *since <= layout);
        let length = 1 + known.map(|(_, field)| field.bytes).sum::<usize>();
        let mut earlier = payload[..length].to_vec();
        earlier[0] = layout;
        let heard = Housekeeping::from_payload(&earlier).unwrap();
        writeln!(
            text,
            "layout {layout} {length} {}",
            heard.csv_row().join(";")
        )
        .unwrap();
    }
}

fn nothing() -> Record {
    let utc = Some(time());
    Record {
        utc: utc.map(Utc::from),
        ..Record::new("", None, &Solution::none(), None, None)
    }
}

/// The log rows of a frame of the Sun, of a dark frame without a solution, and of a frame of the Moon.
fn rows() -> [LoggedRow; 3] {
    let sun = Record {
        file: "sun/frame.fits".into(),
        quality: "fine",
        sun_px: Some([647.5, 482.123_456_789]),
        sun_px_sigma: Some([0.01, 0.02]),
        sun_radius_px: Some(412.25),
        sun_radius_px_sigma: Some(0.03),
        sun_plate_mil: Some([-105.59, 48.64]),
        sun_plate_sigma_mil: Some([0.04, 0.05]),
        marks: Some(vec![MarkRecord {
            id: [-7, 3],
            px: [1.5, 2.25],
            sigma_px: 0.125,
        }]),
        mapping: Some(MappingRecord {
            kind: "homography",
            scale_mil_per_px: 5.75,
            scale_sigma_mil_per_px: 2e-4,
            rotation_deg: 0.4785,
            rotation_sigma_deg: 0.002,
            residual_px: Some(0.05),
        }),
        offset_deg: Some(OffsetRecord {
            azimuth: -0.123_456_789_123,
            elevation: 0.25,
            cross_elevation: 1.0 / 3.0,
            sigma: 2.5e-5,
            calibration_sigma: 1e-3,
        }),
        roll_deg: Some(RollRecord {
            value: -1.25,
            sigma: 0.007,
        }),
        solve_us: Some(1234),
        ..nothing()
    };
    let dark = Record {
        reason: Some(Reason {
            stage: "levels",
            code: Some("low_contrast"),
            reason: "nothing outshines the background by enough".into(),
            measured: Some(3.5),
            limit: Some(f64::INFINITY),
        }),
        ..nothing()
    };
    let moon = Record {
        moon: Some(MoonRecord {
            centre_px: [359.5, 288.25],
            centre_sigma_px: [0.03, 0.04],
            radius_px: 81.5,
            radius_sigma_px: 0.05,
            phase_angle_deg: 12.5,
            bright_limb_deg: -45.0,
            direction: Some([0.0, 0.6, 0.8]),
            direction_sigma_deg: Some(0.002),
        }),
        ..nothing()
    };
    let row = |number, record| LoggedRow::new(number, &Solution::none(), record);
    [
        LoggedRow {
            quality: Quality::Fine,
            levels: Some(Levels {
                background_dn: 12.5,
                noise_dn: 1.25,
                disc_dn: 205.5,
            }),
            on_own_disk: Some(true),
            archive_state: ArchiveState {
                free_percent: [Some(87.5), None],
                waiting: 3,
                unstored: 70_000,
            },
            ..row(Some(7), sun)
        },
        LoggedRow {
            stopped: Some(Stage::Levels),
            on_own_disk: Some(false),
            ..row(None, dark)
        },
        LoggedRow {
            quality: Quality::Coarse,
            ..row(Some(u64::from(u32::MAX) + 2), moon)
        },
    ]
}

/// The entries of a folder, sorted by name.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    all.sort();
    all
}

fn logs(text: &mut String) {
    let root = tempfile::tempdir().unwrap();
    let disk = || Arc::new(LocalDisk);
    let mut log = SolutionLog::new(disk(), root.path(), time());
    let mut telemetry = Dirfile::new(disk(), root.path(), time());
    for row in rows() {
        log.append(&row).unwrap();
        telemetry.append(&row).unwrap();
        let line = serde_json::to_string(&row.record).unwrap();
        writeln!(text, "json {line}").unwrap();
        for card in row.record.cards() {
            writeln!(text, "card {} = {}", card.keyword.name, card.value).unwrap();
        }
        let csv = row.record.csv_row();
        writeln!(text, "csv {}", csv.join(";")).unwrap();
    }
    for path in files(root.path()) {
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        if path.is_file() {
            writeln!(text, "{name}\n{}", fs::read_to_string(&path).unwrap()).unwrap();
        } else if !path.is_symlink() {
            for field in files(&path) {
                let bytes = fs::read(&field).unwrap();
                let housekeeping = match field.ends_with("format") {
                    true => String::from_utf8(bytes).unwrap(),
                    false => hex(&bytes),
                };
                writeln!(
                    text,
                    "{name}/{} {housekeeping}",
                    field.file_name().unwrap().to_str().unwrap()
                )
                .unwrap();
            }
        }
    }
}

#[test]
fn what_is_encoded_stays_byte_for_byte() {
    let mut text = String::new();
    packets(&mut text);
    housekeeping(&mut text);
    logs(&mut text);
    if std::env::var_os("SOLASPECT_WRITE_DATA").is_some() {
        fs::write(DATA, &text).unwrap();
    }
    let stored = fs::read_to_string(DATA).unwrap();
    for (now, before) in text.lines().zip(stored.lines()) {
        assert_eq!(now, before);
    }
    assert_eq!(text, stored);
}
