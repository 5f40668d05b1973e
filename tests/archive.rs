//! The archive commands: their counts when files are lost, truncated, changed or renamed.

use crate::common::flight::{self, frames_in};
use jiff::{SignedDuration, Timestamp};
use serde_json::Value;
use solaspect::archive::{self, Store, keywords};
use solaspect::aspect::{self, Expected};
use solaspect::config;
use solaspect::fits::{self, Card, Compression};
use solaspect::frame::{Frame, FrameInfo, Pixels};
use solaspect::record::Record;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::Duration;
use tempfile::TempDir;

const FRAMES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/frames");
const COUNT: usize = 8;

fn run(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_solaspect"));
    command
        .arg("archive")
        .args(arguments)
        .env_remove("RUST_LOG");
    command.output().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn stdout(output: &Output) -> &str {
    std::str::from_utf8(&output.stdout).unwrap()
}

fn stderr(output: &Output) -> &str {
    std::str::from_utf8(&output.stderr).unwrap()
}

/// Frames every 0.25 s from 1 s before the hour, so that they fill two folders.
fn info(number: usize) -> FrameInfo {
    let start: Timestamp = "2013-09-21T17:59:59.000Z".parse().unwrap();
    let since = SignedDuration::from_millis(250 * number as i64);
    FrameInfo {
        number: Some(number as u64),
        mid_exposure: Some(start + since),
        ..FrameInfo::default()
    }
}

/// A small archive of frames with a grey pattern, and its files in order.
fn small(compression: Compression) -> (TempDir, Vec<PathBuf>) {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path(), "demo", compression).unwrap();
    let write = |number| {
        let pixels = (0..96 * 64).map(|n| (n * 7 % 251) as u8).collect();
        let frame = Frame::new(96, 64, Pixels::U8(pixels), 255, info(number)).unwrap();
        let keyword = |name| keywords::find(name).unwrap();
        let cards = [
            Card::new(keyword("QUALITY"), "none"),
            Card::new(keyword("REASON"), "disc: none found"),
        ];
        store.write(&frame, &cards, &[]).unwrap()
    };
    let files = (0..COUNT).map(write).collect();
    (root, files)
}

/// The report of `check` on an archive; asserts that the exit code says whether a file is bad or missing.
fn report(root: &Path) -> Value {
    let output = run(&["check", "--json", text(root)]);
    let report: Value = serde_json::from_str(stdout(&output)).unwrap();
    let code = i32::from(report["bad"] != 0 || report["missing"] != 0);
    assert_eq!(output.status.code(), Some(code), "{report}");
    assert_eq!(
        report["bad_files"].as_array().unwrap().len() as u64,
        report["bad"]
    );
    report
}

#[track_caller]
fn assert_counts(report: &Value, files: usize, bad: usize, gaps: usize) {
    let counts = ["files", "bad", "gaps"].map(|name| report[name].as_u64().unwrap() as usize);
    assert_eq!(counts, [files, bad, gaps], "{report}");
}

/// Asserts which file is first in the list of bad files, and why.
#[track_caller]
fn assert_blamed(report: &Value, file: &Path, why: &str) {
    let bad = &report["bad_files"][0];
    assert_eq!(bad["file"], text(file));
    let error = bad["error"].as_str().unwrap();
    assert!(error.contains(why) && !error.contains('\n'), "{error}");
}

fn change(file: &Path, change: impl FnOnce(&mut Vec<u8>)) {
    let mut bytes = fs::read(file).unwrap();
    change(&mut bytes);
    fs::write(file, bytes).unwrap();
}

fn position(bytes: &[u8], wanted: &[u8]) -> usize {
    bytes
        .windows(wanted.len())
        .position(|window| window == wanted)
        .unwrap()
}

#[test]
fn a_sound_archive_has_nothing_bad_whatever_its_compression() {
    for compression in [Compression::Rice, Compression::None, Compression::Gzip] {
        let (root, _) = small(compression);
        let report = report(root.path());
        assert_counts(&report, COUNT, 0, 0);
        assert_eq!(report["first_utc"], "2013-09-21T17:59:59.000Z");
        assert_eq!(report["last_utc"], "2013-09-21T18:00:00.750Z");
    }
}

#[test]
fn a_truncated_file_is_bad_wherever_it_ends() {
    let (root, files) = small(Compression::Rice);
    let whole = fs::read(&files[3]).unwrap();
    for length in [0, 1, 79, 2880, 2881, whole.len() / 2, whole.len() - 2880] {
        fs::write(&files[3], &whole[..length]).unwrap();
        let report = report(root.path());
        assert_counts(&report, COUNT, 1, 0);
        assert_blamed(&report, &files[3], "expected");
    }
}

#[test]
fn any_changed_byte_is_bad_in_header_and_data_alike() {
    let (root, files) = small(Compression::Rice);
    let whole = fs::read(&files[2]).unwrap();
    // The step of 311 bytes matches no structure of the file: it reaches keywords, values, comments, fill, tiles and their descriptors.
    for at in (0..whole.len()).step_by(311) {
        change(&files[2], |bytes| bytes[at] ^= 0x04);
        let report = report(root.path());
        assert_counts(&report, COUNT, 1, 0);
        assert_blamed(&report, &files[2], "expected");
        fs::write(&files[2], &whole).unwrap();
    }
    assert_counts(&report(root.path()), COUNT, 0, 0);
}

#[test]
fn a_file_without_checksums_cannot_be_vouched_for() {
    let (root, files) = small(Compression::Rice);
    change(&files[0], |bytes| {
        let at = position(bytes, b"CHECKSUM");
        bytes[at..at + 8].copy_from_slice(b"COMMENT ");
    });
    let report = report(root.path());
    assert_counts(&report, COUNT, 1, 0);
    assert_blamed(
        &report,
        &files[0],
        "CHECKSUM, DATASUM: expected both in each of 2 HDUs",
    );
}

#[test]
fn a_missing_file_is_a_gap_and_no_fault_of_the_others() {
    let (root, files) = small(Compression::Rice);
    fs::remove_file(&files[4]).unwrap();
    let one = report(root.path());
    assert_counts(&one, COUNT - 1, 0, 1);
    let gap = &one["gap_list"][0];
    assert_eq!(
        [&gap["after"], &gap["before"]],
        [text(&files[3]), text(&files[5])]
    );
    assert_eq!([&gap["step_s"], &gap["median_step_s"]], [0.5, 0.25]);
    assert_eq!(gap["missing_frames"], 1);
    fs::remove_file(&files[1]).unwrap();
    fs::remove_file(&files[2]).unwrap();
    let two = report(root.path());
    assert_counts(&two, COUNT - 3, 0, 2);
    assert_eq!(two["missing_frames"], 3);
}

#[test]
fn a_renamed_file_is_bad_and_leaves_a_gap_where_it_was() {
    let (root, files) = small(Compression::Rice);
    let to = files[7].with_file_name("demo_20130921T190000.000_00000099.fits");
    fs::rename(&files[3], &to).unwrap();
    let report = report(root.path());
    assert_counts(&report, COUNT, 1, 1);
    assert_blamed(&report, &to, "FILENAME: expected 'demo_20130921T190000");
}

#[test]
fn a_time_that_goes_back_in_the_order_of_names_is_bad() {
    let root = tempfile::tempdir().unwrap();
    for (name, number) in [("a_1", 0), ("a_2", 1), ("a_3", 3), ("a_4", 2), ("a_5", 4)] {
        let frame = Frame::new(8, 8, Pixels::U8(vec![9; 64]), 255, info(number)).unwrap();
        let path = root.path().join(name).with_extension("fits");
        fits::write_frame(&path, &frame, &[], &[], Compression::None).unwrap();
    }
    let report = report(root.path());
    assert_counts(&report, 5, 1, 1);
    assert_blamed(
        &report,
        &root.path().join("a_4.fits"),
        "DATE-AVG: expected a time not before",
    );
}

#[test]
fn half_written_files_are_counted_and_not_bad() {
    let (root, files) = small(Compression::Rice);
    fs::write(files[0].with_file_name(".x1.part"), "half").unwrap();
    let others = [".values-1a2b3c", ".y2.fits", ".directory"].map(|name| root.path().join(name));
    for other in others {
        fs::write(other, "no frame").unwrap();
    }
    let report = report(root.path());
    assert_counts(&report, COUNT, 0, 0);
    assert_eq!(report["unfinished"], 1);
}

/// Archives a flight of dark frames on one disk or on two that alternate.
fn flown(roots: &[&Path]) {
    let open = |root: &&Path| Store::open(root, "demo", Compression::Rice).unwrap();
    let settings = config::Archive {
        warn_free_percent: 0.0,
        thin_free_percent: 0.0,
        stop_free_percent: 0.0,
        ..config::Archive::default()
    };
    let stores = roots.iter().map(open).collect();
    let tally = flight::dark(stores, settings, FLOWN as u64, Duration::ZERO, |_| {});
    assert_eq!(tally.counts.stored, FLOWN as u64);
}

const FLOWN: usize = 12;

#[test]
fn a_file_that_the_log_names_and_that_is_not_there_is_missing_wherever_it_was() {
    let root = tempfile::tempdir().unwrap();
    flown(&[root.path()]);
    let sound = report(root.path());
    assert_counts(&sound, FLOWN, 0, 0);
    assert_eq!(sound["missing"], 0);
    let files = frames_in(root.path());
    for file in [&files[FLOWN - 1], &files[FLOWN - 2]] {
        fs::remove_file(file).unwrap();
    }
    let end = report(root.path());
    assert_counts(&end, FLOWN - 2, 0, 0);
    assert_eq!(end["missing"], 2);
    let named = |n: usize| end["missing_files"][n]["file"].as_str().unwrap().to_owned();
    assert_eq!(
        [named(0), named(1)],
        [10, 11].map(|n| text(&files[n]).to_owned())
    );
    fs::remove_file(&files[4]).unwrap();
    let middle = report(root.path());
    assert_counts(&middle, FLOWN - 3, 0, 1);
    assert_eq!(middle["missing"], 3);
    let said = run(&["check", text(root.path())]);
    let said = stdout(&said);
    assert!(
        said.contains("9 files: 0 bad, 3 missing, 1 gap (1 frame missing by number)"),
        "{said}"
    );
}

#[test]
fn one_of_two_disks_that_alternate_is_sound_alone_and_both_are_together() {
    let disks = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let roots = [disks[0].path(), disks[1].path()];
    flown(&roots);
    let files = roots.map(frames_in);
    assert!(files.iter().all(|files| files.len() > 1));
    for (n, root) in roots.iter().enumerate() {
        let alone = report(root);
        assert_counts(&alone, files[n].len(), 0, 0);
        assert_eq!(alone["missing"], 0);
        assert_eq!(alone["on_other_disk"], files[1 - n].len());
    }
    let check_both = || {
        let output = run(&["check", "--json", text(roots[0]), text(roots[1])]);
        let report: Value = serde_json::from_str(stdout(&output)).unwrap();
        (output.status.code(), report)
    };
    let (code, both) = check_both();
    assert_eq!(code, Some(0));
    assert_counts(&both, FLOWN, 0, 0);
    assert_eq!([&both["missing"], &both["on_other_disk"]], [0, 0]);
    fs::remove_file(&files[1][0]).unwrap();
    assert_eq!(report(roots[1])["missing"], 1);
    let (code, both) = check_both();
    assert_eq!((code, &both["missing"]), (Some(1), &Value::from(1)));
}

#[test]
fn a_folder_that_is_missing_or_empty_or_a_file_is_an_error_that_names_it() {
    let root = tempfile::tempdir().unwrap();
    let (missing, file) = (root.path().join("nowhere"), root.path().join("file"));
    fs::write(&file, "").unwrap();
    for (command, path) in [
        ("check", missing.as_path()),
        ("check", root.path()),
        ("check", &file),
        ("list", &missing),
        ("list", root.path()),
        ("list", &file),
    ] {
        let output = run(&[command, text(path)]);
        assert_eq!(output.status.code(), Some(1));
        let error = stderr(&output);
        assert!(
            error.contains(text(path)) && error.contains("expected"),
            "{error}"
        );
        assert_eq!(error.lines().count(), 1, "{error}");
    }
}

#[test]
fn people_read_a_summary_with_each_bad_file_and_gap() {
    let (root, files) = small(Compression::Rice);
    fs::write(&files[1], "no frame").unwrap();
    fs::remove_file(&files[5]).unwrap();
    let output = run(&["check", text(root.path())]);
    assert_eq!(output.status.code(), Some(1));
    let said = stdout(&output);
    assert!(
        said.contains("7 files: 1 bad, 0 missing, 1 gap (1 frame missing by number)"),
        "{said}"
    );
    assert!(
        said.contains(&format!("bad  {}", files[1].display())),
        "{said}"
    );
    assert!(
        said.contains("gap  demo_20130921T180000.000_00000004.fits .. "),
        "{said}"
    );
}

#[test]
fn a_list_has_a_line_for_every_file_the_bad_ones_too() {
    let (root, files) = small(Compression::Rice);
    fs::write(&files[6], "no frame").unwrap();
    let output = run(&["list", "--json", text(root.path())]);
    assert_eq!(output.status.code(), Some(1));
    let lines: Vec<Value> = stdout(&output)
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(lines.len(), COUNT);
    assert_eq!(lines[1]["utc"], "2013-09-21T17:59:59.250Z");
    assert_eq!(lines[1]["number"], 1);
    assert_eq!(lines[1]["quality"], "none");
    assert_eq!(lines[1]["reason"], "disc: none found");
    assert_eq!(lines[1]["sun_plate_mil"], Value::Null);
    assert_eq!(lines[6]["file"], text(&files[6]));
    assert!(
        lines[6]["error"]
            .as_str()
            .unwrap()
            .contains("expected a FITS file")
    );
    let plain = run(&["list", text(root.path())]);
    assert_eq!(stdout(&plain).lines().count(), COUNT);
    assert!(stdout(&plain).starts_with("20130921T17/demo_20130921T175959.000_00000000.fits  "));
}

/// A solved frame in an archive, and the solution's record.
fn solved() -> (TempDir, PathBuf, Record) {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path(), "demo", Compression::Rice).unwrap();
    let instrument = solaspect::instrument::builtin("demo").unwrap();
    let mut frame = fits::read_frame(&Path::new(FRAMES).join("standard/frame_00000.fits")).unwrap();
    frame.info.number.get_or_insert(0);
    let utc = frame.info.mid_exposure;
    let expected = utc.and_then(Expected::at);
    let settings = aspect::SolverSettings::default();
    let solution = aspect::solve_with(&settings, &frame, &instrument, expected, None);
    let record = Record::new("", utc, &solution, None, None);
    let tables = archive::tables(&solution);
    let path = store.write(&frame, &record.cards(), &tables).unwrap();
    (root, path, record)
}

#[test]
fn a_frame_is_shown_with_its_keywords_and_the_marks_that_were_read() {
    let (_root, path, record) = solved();
    let output = run(&["show", text(&path)]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let said = stdout(&output);
    for wanted in [
        "\nSolution\n  QUALITY   'fine'",
        "disc's centre on the plate (mil)",
        "\nTime\n",
    ] {
        assert!(said.contains(wanted), "{wanted}: {said}");
    }
    let marks = record.marks.unwrap();
    assert!(marks.len() > 2);
    let (_, table) = said.split_once("\nMarks\n").unwrap();
    let shown: Vec<Vec<f64>> = table
        .lines()
        .skip(1)
        .map(|line| {
            line.split_whitespace()
                .map(|word| word.parse().unwrap())
                .collect()
        })
        .collect();
    assert_eq!(shown.len(), marks.len());
    for (shown, mark) in shown.iter().zip(&marks) {
        assert_eq!([shown[0], shown[1]], mark.id.map(f64::from));
        assert!((shown[2] - mark.px[0]).abs() < 6e-4 && (shown[3] - mark.px[1]).abs() < 6e-4);
    }
}

#[test]
fn a_shown_file_that_is_none_is_one_line_of_error() {
    let root = tempfile::tempdir().unwrap();
    let path = root.path().join("x.fits");
    fs::write(&path, "no frame").unwrap();
    for path in [path.as_path(), root.path(), &root.path().join("none")] {
        let output = run(&["show", text(path)]);
        assert_eq!(output.status.code(), Some(1));
        let error = stderr(&output);
        assert!(
            error.contains(text(path)) && error.lines().count() == 1,
            "{error}"
        );
    }
}

#[test]
fn the_table_has_units_and_a_row_for_every_file() {
    let (root, path, record) = solved();
    fs::write(path.with_file_name("z.fits"), "no frame").unwrap();
    let out = root.path().join("table.csv");
    let output = run(&["export", "--csv", text(root.path()), "--out", text(&out)]);
    assert_eq!(output.status.code(), Some(1));
    let mut table = csv::Reader::from_path(out).unwrap();
    let names = table.headers().unwrap().clone();
    let rows: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 2);
    let cell = |row: usize, name: &str| {
        let column = names.iter().position(|n| n == name).unwrap();
        rows[row][column].to_owned()
    };
    assert_eq!(cell(0, "file"), text(&path));
    assert_eq!(cell(0, "QUALITY"), "fine");
    let sun = record.sun_plate_mil.unwrap();
    assert_eq!(cell(0, "SUNMIL-X [mil]").parse(), Ok(sun[0]));
    assert_eq!(cell(0, "error"), "");
    assert!(cell(1, "error").contains("expected a FITS file"));
    let to_standard_output = run(&["export", "--csv", text(&path)]);
    assert_eq!(to_standard_output.status.code(), Some(0));
    assert_eq!(stdout(&to_standard_output).lines().count(), 2);
}

#[test]
fn a_picture_is_stretched_to_black_and_white_and_has_the_frames_size() {
    let (root, path, record) = solved();
    let out = root.path().join("pictures");
    let output = run(&["export", "--png", text(root.path()), "--out", text(&out)]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let name = path.file_stem().unwrap().to_str().unwrap();
    let picture = image::open(out.join(format!("{name}.png")))
        .unwrap()
        .into_luma8();
    assert_eq!(picture.dimensions(), (1296, 966));
    let [x, y] = record.sun_px.unwrap().map(|px| px as u32);
    let mean = |x0: u32, y0: u32| {
        let pixels = (0..400).map(|n| u32::from(picture.get_pixel(x0 + n % 20, y0 + n / 20).0[0]));
        pixels.sum::<u32>() / 400
    };
    assert!(mean(x - 10, y - 10) > 100 && mean(0, 0) < 50);
    let missing = root.path().join("none.fits");
    let output = run(&[
        "export",
        "--png",
        text(&missing),
        text(&path),
        "--out",
        text(&out),
    ]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains(text(&missing)));
}

#[test]
fn export_without_a_kind_or_place_is_wrong_usage() {
    for arguments in [
        ["export", "x.fits"].as_slice(),
        &["export", "--png", "x.fits"],
    ] {
        assert_eq!(run(arguments).status.code(), Some(2));
    }
}
