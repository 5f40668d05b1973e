//! The log and the telemetry beside the archive's frames: every frame is in both, with the numbers of its file.

use crate::common::flight::{self, dark_frame};
use jiff::Timestamp;
use solaspect::archive::{Dirfile, SolutionLog, Store};
use solaspect::aspect::{self, Expected, SolverSettings};
use solaspect::config;
use solaspect::demo::{self, Demo};
use solaspect::fits::{self, Compression, Header, Value};
use solaspect::instrument;
use solaspect::record::{LoggedRow, Record};
use solaspect::service::FlightTally;
use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::common::disk::{Fault, FaultyDisk};
use solaspect::archive::disk::{Disk, LocalDisk};
use std::sync::Arc;

/// A row of the log, keyed by column name.
type LogRow = BTreeMap<String, String>;

fn beginning_with(folder: &Path, start: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap();
    let mut found: Vec<_> = entries
        .map(|entry| entry.unwrap().path())
        .filter(|path| {
            let name = path.file_name().unwrap().to_string_lossy();
            name.starts_with(start)
        })
        .collect();
    found.sort();
    found
}

fn read_log(path: &Path) -> Vec<LogRow> {
    let mut reader = csv::Reader::from_path(path).unwrap();
    reader.deserialize().map(|row| row.unwrap()).collect()
}

/// The only log of an archive.
fn log_of(root: &Path) -> Vec<LogRow> {
    let logs = beginning_with(root, "solutions_");
    assert_eq!(logs.len(), 1, "{logs:?}");
    assert_eq!(logs[0].extension().unwrap(), "csv");
    read_log(&logs[0])
}

/// The fields of a dirfile, read as its `format` declares them, in the order of the declarations.
fn read_dirfile(folder: &Path) -> Vec<(String, Vec<f64>)> {
    let format = fs::read_to_string(folder.join("format")).unwrap();
    let lines: Vec<Vec<&str>> = format
        .lines()
        .map(|line| line.split_whitespace().collect())
        .collect();
    for directive in [
        ["/ENDIAN", "little"],
        ["/ENCODING", "none"],
        ["/REFERENCE", "TIME"],
    ] {
        assert!(lines.iter().any(|line| line[..] == directive), "{format}");
    }
    let raw = lines.iter().filter(|line| line.get(1) == Some(&"RAW"));
    raw.map(|line| {
        assert_eq!(line[3], "1", "samples per frame");
        let bytes = fs::read(folder.join(line[0])).unwrap();
        let values = match line[2] {
            "UINT8" => bytes.iter().map(|&code| f64::from(code)).collect(),
            "FLOAT64" => {
                let samples = bytes.chunks_exact(8);
                assert!(samples.remainder().is_empty(), "{}", line[0]);
                samples
                    .map(|sample| f64::from_le_bytes(sample.try_into().unwrap()))
                    .collect()
            }
            kind => panic!("unexpected type {kind}"),
        };
        (line[0].to_string(), values)
    })
    .collect()
}

/// The only dirfile of an archive.
fn telemetry_of(root: &Path) -> BTreeMap<String, Vec<f64>> {
    let folders = beginning_with(root, "telemetry_");
    assert_eq!(folders.len(), 1, "{folders:?}");
    read_dirfile(&folders[0]).into_iter().collect()
}

/// A keyword as a number; NaN if it is absent.
fn keyword(header: &Header, name: &str) -> f64 {
    match header.get(name) {
        Some(Value::Float(number)) => *number,
        Some(Value::Integer(number)) => *number as f64,
        None => f64::NAN,
        other => panic!("{name}: {other:?}"),
    }
}

fn text(header: &Header, name: &str) -> String {
    match header.get(name) {
        Some(Value::Text(text)) => text.clone(),
        None => String::new(),
        other => panic!("{name}: {other:?}"),
    }
}

fn agree(a: f64, b: f64, tolerance: f64) -> bool {
    (a.is_nan() && b.is_nan()) || (a - b).abs() <= tolerance
}

/// Corresponding names: column of the log, field of the telemetry, keyword of the file; and half a unit of the log's last digit.
const SAME: [(&str, &str, &str, f64); 24] = [
    ("sun_x_px", "PIXEL_X", "SUNPX-X", 5e-7),
    ("sun_y_px", "PIXEL_Y", "SUNPX-Y", 5e-7),
    ("sun_radius_px", "RADIUS", "SUNPX-R", 5e-7),
    ("sun_radius_sigma_px", "RADIUS_SIGMA", "SUNPX-SR", 5e-7),
    ("sun_plate_x_mil", "SUN_X", "SUNMIL-X", 5e-7),
    ("sun_plate_y_mil", "SUN_Y", "SUNMIL-Y", 5e-7),
    ("sun_plate_sigma_x_mil", "SIGMA_X", "SUNMILSX", 5e-7),
    ("sun_plate_sigma_y_mil", "SIGMA_Y", "SUNMILSY", 5e-7),
    ("marks", "MARKS", "NMARKS", 0.0),
    ("scale_mil_per_px", "SCALE", "MAPSCALE", 5e-7),
    ("scale_sigma_mil_per_px", "SCALE_SIGMA", "MAPSCASG", 5e-7),
    ("rotation_deg", "ROTATION", "MAPROT", 5e-7),
    ("rotation_sigma_deg", "ROTATION_SIGMA", "MAPROTSG", 5e-7),
    ("residual_px", "RESIDUAL", "MAPRES", 5e-7),
    ("offset_azimuth_deg", "OFFSET_AZ", "OFFSETAZ", 5e-10),
    ("offset_elevation_deg", "OFFSET_EL", "OFFSETEL", 5e-10),
    ("offset_sigma_deg", "OFFSET_SIGMA", "OFFSETSG", 5e-10),
    ("offset_cross_elevation_deg", "OFFSET_XEL", "OFFSETXE", 0.0),
    (
        "offset_calibration_sigma_deg",
        "OFFSET_CALSIGMA",
        "OFFSETCS",
        0.0,
    ),
    ("frame", "FRAME", "FRAMENUM", 0.0),
    ("roll_deg", "ROLL", "BODYROLL", 5e-7),
    ("sun_sigma_x_px", "", "SUNPX-SX", 5e-7),
    ("reason_measured", "", "REASONIS", 0.0),
    ("reason_limit", "", "REASONLM", 0.0),
];

fn demonstration(archive: &Path) -> demo::Summary {
    let settings = Demo::lasting(Duration::from_secs(5), archive, 1);
    demo::run(&settings, &mut None, |_| {}, || false).unwrap()
}

#[test]
fn log_and_telemetry_have_the_numbers_of_the_frames_files() {
    let root = tempfile::tempdir().unwrap();
    demonstration(root.path());
    let log = log_of(root.path());
    let telemetry = telemetry_of(root.path());
    assert_eq!(log.len(), 20);
    let number = |text: &str| text.parse().unwrap_or(f64::NAN);
    let mut known = 0;
    for (n, row) in log.iter().enumerate() {
        let path = root.path().join(&row["file"]);
        let header = fits::read_keywords(&path).unwrap();
        assert_eq!(row["quality"], text(&header, "QUALITY"));
        assert_eq!(row["reason"], text(&header, "REASON"));
        for (column, field, name, rounding) in SAME {
            let expected = keyword(&header, name);
            known += u32::from(expected.is_finite());
            let logged = number(&row[column]);
            assert!(
                agree(logged, expected, 1.01 * rounding),
                "{column} of frame {n}: {logged}, {name} {expected}"
            );
            if !field.is_empty() {
                let sample = telemetry[field][n];
                assert!(
                    agree(sample, expected, 1e-12 * expected.abs()),
                    "{field} of frame {n}: {sample}, {name} {expected}"
                );
            }
        }
        let frame = fits::read_frame(&path).unwrap();
        let time: Timestamp = row["utc"].parse().unwrap();
        let middle = frame.info.mid_exposure.unwrap();
        assert!(time.duration_since(middle).abs().as_secs_f64() < 0.001);
        assert!((telemetry["TIME"][n] - middle.as_microsecond() as f64 * 1e-6).abs() < 2e-6);
        let code = ["none", "coarse", "fine"][telemetry["QUALITY"][n] as usize];
        assert_eq!(code, row["quality"]);
        assert_eq!(telemetry["STORED"][n], 1.0);
        assert_eq!(telemetry["STOPPED"][n] == 0.0, row["reason"].is_empty());
    }
    assert!(known > 200, "{known} numbers were compared");
    let qualities = &telemetry["QUALITY"];
    assert!(qualities.contains(&0.0) && qualities.contains(&2.0));
}

#[test]
fn a_second_start_leaves_the_first_ones_log_and_telemetry_as_they_were() {
    let root = tempfile::tempdir().unwrap();
    let start = "2026-01-02T03:04:05.6Z".parse().unwrap();
    for n in 0..3 {
        let row = dark_row(n);
        SolutionLog::new(local(), root.path(), start)
            .append(&row)
            .unwrap();
        Dirfile::new(local(), root.path(), start)
            .append(&row)
            .unwrap();
    }
    let name = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
    let logs = beginning_with(root.path(), "solutions_");
    let names: Vec<String> = logs.iter().map(name).collect();
    let ending = ["", "_2", "_3"];
    assert_eq!(
        names,
        ending.map(|n| format!("solutions_20260102T030405{n}.csv"))
    );
    let folders = beginning_with(root.path(), "telemetry_");
    let names: Vec<String> = folders.iter().map(name).collect();
    assert_eq!(
        names,
        ending.map(|n| format!("telemetry_20260102T030405{n}"))
    );
    for (n, (log, folder)) in logs.iter().zip(&folders).enumerate() {
        let rows = read_log(log);
        assert_eq!(rows.len(), 1);
        assert_eq!(rows[0]["frame"], n.to_string());
        let fields: BTreeMap<_, _> = read_dirfile(folder).into_iter().collect();
        assert_eq!(fields["FRAME"], [n as f64]);
    }
    let newest = fs::read_link(root.path().join("telemetry")).unwrap();
    assert_eq!(root.path().join(newest), folders[2]);
}

#[test]
fn what_a_failed_write_left_is_gone_with_the_next_row() {
    let root = tempfile::tempdir().unwrap();
    let start = "2026-01-02T03:04:05Z".parse().unwrap();
    let mut log = SolutionLog::new(local(), root.path(), start);
    let mut dirfile = Dirfile::new(local(), root.path(), start);
    log.append(&dark_row(0)).unwrap();
    dirfile.append(&dark_row(0)).unwrap();
    let telemetry = root.path().join("telemetry_20260102T030405");
    for torn in [
        root.path().join("solutions_20260102T030405.csv"),
        telemetry.join("FRAME"),
        telemetry.join("QUALITY"),
    ] {
        let mut file = OpenOptions::new().append(true).open(torn).unwrap();
        file.write_all(b"half of a row").unwrap();
    }
    log.append(&dark_row(1)).unwrap();
    dirfile.append(&dark_row(1)).unwrap();
    let frames: Vec<String> = log_of(root.path())
        .iter()
        .map(|row| row["frame"].clone())
        .collect();
    assert_eq!(frames, ["0", "1"]);
    let fields = telemetry_of(root.path());
    assert_eq!(fields["FRAME"], [0.0, 1.0]);
    assert!(fields.values().all(|values| values.len() == 2));
    assert!(fields["SUN_X"].iter().all(|value| value.is_nan()));
}

#[test]
fn a_reader_that_follows_finds_every_field_of_each_time() {
    const FRAMES: u64 = 3000;
    let root = tempfile::tempdir().unwrap();
    let mut dirfile = Dirfile::new(local(), root.path(), Timestamp::now());
    let row = dark_row(0);
    dirfile.append(&row).unwrap();
    let folder = &beginning_with(root.path(), "telemetry_")[0];
    let length = |field: &str| fs::metadata(folder.join(field)).unwrap().len();
    let names: Vec<String> = read_dirfile(folder)
        .into_iter()
        .map(|field| field.0)
        .collect();
    std::thread::scope(|scope| {
        let writer = scope.spawn(|| (1..FRAMES).for_each(|_| dirfile.append(&row).unwrap()));
        let mut reads = 0;
        while !writer.is_finished() || reads == 0 {
            let frames = length("TIME") / 8;
            for name in &names {
                let size = if ["QUALITY", "STOPPED", "STORED"].contains(&name.as_str()) {
                    1
                } else {
                    8
                };
                assert!(length(name) / size >= frames, "{name} of frame {frames}");
            }
            reads += 1;
        }
    });
    assert_eq!(length("TIME"), 8 * FRAMES);
}

#[test]
fn a_disk_that_refuses_says_so_and_is_tried_again_with_the_next_row() {
    let parent = tempfile::tempdir().unwrap();
    let root = parent.path().join("unmounted");
    let mut log = SolutionLog::new(local(), &root, Timestamp::now());
    let mut dirfile = Dirfile::new(local(), &root, Timestamp::now());
    let error = log.append(&dark_row(0)).unwrap_err().to_string();
    assert!(error.contains("solutions_"), "{error}");
    let error = dirfile.append(&dark_row(0)).unwrap_err().to_string();
    assert!(error.contains("telemetry_"), "{error}");
    assert!(!root.exists());
    fs::create_dir(&root).unwrap();
    log.append(&dark_row(1)).unwrap();
    dirfile.append(&dark_row(1)).unwrap();
    assert_eq!(log_of(&root)[0]["frame"], "1");
    assert_eq!(telemetry_of(&root)["FRAME"], [1.0]);
}

#[test]
fn frames_whose_picture_no_disk_took_are_in_the_log() {
    let root = tempfile::tempdir().unwrap();
    // Files occupy the names of the hours' folders.
    let rolls = root.path().join("roll");
    fs::create_dir(&rolls).unwrap();
    for folder in [root.path(), &rolls] {
        fs::write(folder.join("20130921T18"), "occupied").unwrap();
    }
    let summary = demonstration(root.path());
    assert_eq!(summary.tally.counts.unstored, 40, "{summary}");
    let log = log_of(root.path());
    assert_eq!(log.len(), 20);
    assert!(log.iter().all(|row| row["file"].is_empty()));
    assert!(log.iter().any(|row| row["quality"] == "fine"));
    let telemetry = telemetry_of(root.path());
    assert_eq!(telemetry["STORED"], [0.0; 20]);
    assert!(telemetry["WAITING"].iter().any(|&waiting| waiting > 1.0));
    assert!((0.0..=100.0).contains(&telemetry["DISK1_FREE"][19]));
    assert!(telemetry["DISK2_FREE"].iter().all(|free| free.is_nan()));
}

#[test]
fn frames_that_find_the_archives_queue_full_are_in_the_log() {
    let root = tempfile::tempdir().unwrap();
    let stores = vec![open(root.path())];
    let tally = dark_flight(stores, 0);
    assert_eq!((tally.archive.overflowed, tally.counts.stored), (5, 0));
    let frames: Vec<String> = log_of(root.path())
        .iter()
        .map(|row| row["frame"].clone())
        .collect();
    assert_eq!(frames, ["0", "1", "2", "3", "4"]);
}

#[test]
fn every_row_is_on_every_disk_and_names_the_file_wherever_it_is() {
    let (first, second) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let roots = [first.path(), second.path()];
    dark_flight(roots.map(open).into(), 64);
    let [mut log, mut other] = roots.map(log_of);
    assert_eq!(log.len(), 5);
    for (n, log) in [&mut log, &mut other].into_iter().enumerate() {
        for row in log {
            let on = roots.map(|root| root.join(&row["file"]).is_file());
            assert!(on[0] != on[1], "{}: {on:?}", row["file"]);
            let disk = row.remove("disk").unwrap();
            assert_eq!(disk, if on[n] { "this" } else { "other" });
        }
    }
    assert_eq!(log, other);
    assert_eq!(telemetry_of(second.path())["STORED"], [1.0; 5]);
}

#[test]
fn a_disk_that_has_gone_leaves_all_to_the_other() {
    let (first, second) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let stores = vec![open(first.path()), open(second.path())];
    fs::remove_dir_all(first.path()).unwrap();
    let tally = dark_flight(stores, 64);
    assert_eq!((tally.counts.stored, tally.counts.unstored), (5, 0));
    assert!(tally.archive.refused > 0);
    assert_eq!(log_of(second.path()).len(), 5);
    assert!(!first.path().exists());
}

#[test]
fn a_flight_goes_on_where_no_disk_takes_a_row() {
    let root = tempfile::tempdir().unwrap();
    let stores = vec![open(root.path())];
    fs::remove_dir_all(root.path()).unwrap();
    let tally = dark_flight(stores, 64);
    assert_eq!((tally.solved(), tally.counts.unstored), (5, 5));
    assert!(!root.path().exists());
}

fn local() -> Arc<dyn Disk> {
    Arc::new(LocalDisk)
}

/// Frame numbers in the logs of a folder, in the order of the logs' names, and in its dirfiles.
fn frames_of(root: &Path) -> (Vec<String>, Vec<f64>) {
    let logs = beginning_with(root, "solutions_");
    let rows = logs.iter().flat_map(|log| read_log(log));
    let folders = beginning_with(root, "telemetry_");
    let fields = folders.iter().flat_map(|folder| read_dirfile(folder));
    let samples = fields.filter(|(name, _)| name == "FRAME");
    (
        rows.map(|row| row["frame"].clone()).collect(),
        samples.flat_map(|(_, numbers)| numbers).collect(),
    )
}

#[test]
fn a_log_goes_on_in_its_file_when_the_disk_is_back() {
    let root = tempfile::tempdir().unwrap();
    let disk = FaultyDisk::new(LocalDisk);
    let mut log = SolutionLog::new(disk.clone(), root.path(), Timestamp::now());
    let mut dirfile = Dirfile::new(disk.clone(), root.path(), Timestamp::now());
    for (number, fault) in [
        (0, None),
        (1, Some(Fault::Gone)),
        (2, None),
        (3, Some(Fault::Step("write"))),
        (4, Some(Fault::Step("cut"))),
        (5, None),
    ] {
        disk.set(fault);
        let row = dark_row(number);
        assert_eq!(log.append(&row).is_ok(), fault.is_none(), "{number}");
        assert_eq!(dirfile.append(&row).is_ok(), fault.is_none(), "{number}");
    }
    let (rows, samples) = frames_of(root.path());
    assert_eq!(rows, ["0", "2", "5"]);
    assert_eq!(samples, [0.0, 2.0, 5.0]);
    assert_eq!(beginning_with(root.path(), "solutions_").len(), 1);
    assert_eq!(beginning_with(root.path(), "telemetry_").len(), 1);
}

#[test]
fn a_log_whose_file_lost_rows_or_is_gone_is_begun_anew() {
    let root = tempfile::tempdir().unwrap();
    let disk = FaultyDisk::new(LocalDisk);
    let mut log = SolutionLog::new(disk.clone(), root.path(), Timestamp::now());
    let mut dirfile = Dirfile::new(disk.clone(), root.path(), Timestamp::now());
    let away_and_back = || [Some(Fault::Gone), None].map(|fault| disk.set(fault));
    let mut append = |number| {
        let row = dark_row(number);
        // A file that was open before the disk disappeared is refused once.
        let _ = (log.append(&row), dirfile.append(&row));
        log.append(&dark_row(number + 1)).unwrap();
        dirfile.append(&dark_row(number + 1)).unwrap();
    };
    append(0);
    away_and_back();
    let first = beginning_with(root.path(), "solutions_").remove(0);
    let length = fs::metadata(&first).unwrap().len();
    let file = OpenOptions::new().write(true).open(&first).unwrap();
    file.set_len(length - 10).unwrap();
    let folder = beginning_with(root.path(), "telemetry_").remove(0);
    fs::remove_file(folder.join("SUN_X")).unwrap();
    append(2);
    let logs = beginning_with(root.path(), "solutions_");
    assert_eq!(logs.len(), 2);
    assert_eq!(read_log(&logs[1])[0]["frame"], "3");
    let folders = beginning_with(root.path(), "telemetry_");
    let fields: BTreeMap<_, _> = read_dirfile(&folders[1]).into_iter().collect();
    assert_eq!(fields["FRAME"], [3.0]);
    let newest = fs::read_link(root.path().join("telemetry")).unwrap();
    assert_eq!(root.path().join(newest), folders[1]);
}

fn open(root: &Path) -> Store {
    Store::open(root, "demo", Compression::Rice).unwrap()
}

/// The row of a dark frame.
fn dark_row(number: u64) -> LoggedRow {
    let instrument = instrument::builtin("demo").unwrap();
    let frame = dark_frame(&instrument, number);
    let utc = frame.info.mid_exposure;
    let size = utc.and_then(Expected::at);
    let solution = aspect::solve_with(&SolverSettings::default(), &frame, &instrument, size, None);
    let record = Record::new("", utc, &solution, None, None);
    LoggedRow::new(Some(number), &solution, record)
}

/// A flight of five dark frames.
fn dark_flight(stores: Vec<Store>, queue_frames: usize) -> FlightTally {
    let archive = config::Archive {
        queue_frames,
        ..config::Archive::default()
    };
    flight::dark(stores, archive, 5, Duration::ZERO, |_| {})
}
