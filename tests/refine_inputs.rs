//! Handling of an archive's files by `refine`: a frame counts once, contradictory times do not reduce the uncertainty, and
//! unreadable files are counted.

use crate::common::refined::{Columns, command, refine, summary, temporary};
use jiff::{SignedDuration, Timestamp};
use rayon::prelude::*;
use solaspect::fits::{self, Compression};
use solaspect::frame::{Frame, FrameInfo};
use solaspect::instrument::{self, Instrument};
use solaspect::simulate::{FORT_SUMNER, Noise, SUN_RADIUS_ARCSEC, Scene, Sun};
use solaspect::units::PlateMil;
use std::f64::consts::TAU;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::Duration;

const FRAMES: usize = 48;
const RATE_HZ: f64 = 4.0;
/// Time of the first frame after a whole second.
const BEGINS_S: f64 = 0.07;

fn start() -> Timestamp {
    "2013-09-21T18:00:00Z".parse().unwrap()
}

fn time_s(n: usize) -> f64 {
    BEGINS_S + n as f64 / RATE_HZ
}

/// Position of the Sun on the plate; it moves at up to 160 mil/s.
fn sun(time_s: f64) -> PlateMil {
    let swing = |amplitude: f64, period: f64| amplitude * (TAU * time_s / period).sin();
    PlateMil::new(swing(300.0, 12.0), 150.0 + swing(100.0, 9.0))
}

/// The frames of a flight, simulated once.
fn frames() -> &'static [Frame] {
    static MADE: OnceLock<Vec<Frame>> = OnceLock::new();
    MADE.get_or_init(|| {
        let instrument = instrument::builtin("demo").unwrap();
        (0..FRAMES)
            .into_par_iter()
            .map(|n| frame(&instrument, n))
            .collect()
    })
}

fn frame(instrument: &Instrument, n: usize) -> Frame {
    let radius = instrument.optics.radius_mil(SUN_RADIUS_ARCSEC);
    let scene = Scene {
        noise: Noise::read(5.0),
        seed: n as u64,
        sun: Some(Sun::new(sun(time_s(n)), radius)),
        info: FrameInfo {
            number: Some(n as u64),
            mid_exposure: Some(start() + SignedDuration::from_secs_f64(time_s(n))),
            exposure: Some(Duration::from_millis(15)),
            place: Some(FORT_SUMNER),
            ..FrameInfo::default()
        },
        ..Scene::new(instrument, instrument.nominal_mapping().unwrap())
    };
    scene.frame().unwrap()
}

fn write(path: &Path, frame: &Frame, compression: Compression) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fits::write_frame(path, frame, &[], &[], compression).unwrap();
}

/// Writes the frames with changed metadata, in parallel.
fn write_stamped(folder: &Path, restamp: impl Fn(usize, &mut FrameInfo) + Sync) {
    frames().par_iter().enumerate().for_each(|(n, frame)| {
        let mut frame = frame.clone();
        restamp(n, &mut frame.info);
        let path = folder.join(format!("frame_{n:05}.fits"));
        write(&path, &frame, Compression::Rice);
    });
}

fn whole_seconds(utc: Timestamp) -> Timestamp {
    Timestamp::from_second(utc.as_second()).unwrap()
}

fn n_of(file: &str) -> usize {
    let digits = file.trim_end_matches(".fits");
    digits[digits.len() - 5..].parse().unwrap()
}

/// A flight with one file per frame, and its refinement; made once.
fn plain() -> &'static (PathBuf, PathBuf) {
    static MADE: OnceLock<(PathBuf, PathBuf)> = OnceLock::new();
    MADE.get_or_init(|| {
        let [flight, out] = [(); 2].map(|()| temporary().keep());
        write_stamped(&flight.join("a"), |_, _| {});
        refine(&flight, &out, &[]);
        (flight, out)
    })
}

/// The same flight with copies: on a second disk (mirroring), with other compression, and under other names. Returns the number of copies.
fn copied(flight: &Path) -> usize {
    write_stamped(&flight.join("a"), |_, _| {});
    let (whole, names) = (flight.join("b"), flight.join("a"));
    for (n, frame) in frames().iter().enumerate() {
        let name = format!("frame_{n:05}.fits");
        let unpacked = if n % 2 == 0 {
            Compression::None
        } else {
            Compression::Rice
        };
        write(&whole.join(&name), frame, unpacked);
        if n % 5 == 0 {
            let other = format!("frame_{n:05} (1).fits");
            fs::copy(names.join(&name), names.join(other)).unwrap();
        }
    }
    FRAMES + FRAMES.div_ceil(5)
}

#[test]
fn a_frame_that_several_files_hold_counts_once() {
    let [folder, out] = [(); 2].map(|()| temporary());
    let copies = copied(folder.path());
    let output = refine(folder.path(), out.path(), &[]);
    let (_, alone) = plain();
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(
        printed.contains(&format!("{copies} files with the same frames")),
        "{printed}"
    );
    let (with, without) = (summary(out.path()), summary(alone));
    assert_eq!(with["copies"], copies);
    assert_eq!(with["unreadable"], 0);
    for same in [
        "fine",
        "coarse",
        "median_sigma_mil",
        "radius_over_expected",
        "mapping",
        "swings_mil",
    ] {
        assert_eq!(with[same], without[same], "{same}");
    }
    let smoothed = |out: &Path| Columns::read(out, "SMOOTHED").0.columns;
    let same = format!("{:?}", smoothed(out.path())) == format!("{:?}", smoothed(alone));
    assert!(same, "copies change the path");
    let rows = Columns::read(out.path(), "ASPECT");
    let [files, reasons] = ["FILE", "REASON"].map(|name| rows.texts(name));
    for (file, reason) in files.iter().zip(reasons) {
        let is_first = file.starts_with("a/") && !file.contains('(');
        let first = file.replacen("b/", "a/", 1).replace(" (1)", "");
        let expected = format!("file: the same frame as {first}");
        assert_eq!(reason, if is_first { "" } else { &expected }, "{file}");
    }
}

#[test]
fn shards_of_an_archive_with_copies_merge_to_the_same_bytes() {
    let [folder, out, one, two, merged] = [(); 5].map(|()| temporary());
    copied(folder.path());
    refine(folder.path(), out.path(), &[]);
    refine(folder.path(), one.path(), &["--shard", "1/2"]);
    refine(folder.path(), two.path(), &["--shard", "2/2"]);
    let [one, two] = [&one, &two].map(|shard| shard.path().to_str().unwrap());
    refine(folder.path(), merged.path(), &["--merge", one, two]);
    for file in ["aspect.fits", "aspect.csv", "summary.json", "report.html"] {
        let [a, b] = [&out, &merged].map(|out| fs::read(out.path().join(file)).unwrap());
        assert!(a == b, "{file}");
    }
}

#[test]
fn other_pixels_under_one_number_and_time_are_another_frame_and_said() {
    let [folder, out] = [(); 2].map(|()| temporary());
    write_stamped(folder.path(), |n, info| {
        if n == 20 {
            info.number = Some(19);
            info.mid_exposure = frames()[19].info.mid_exposure;
        }
    });
    let output = refine(folder.path(), out.path(), &[]);
    let printed = String::from_utf8(output.stderr).unwrap();
    assert!(
        printed.contains("frame_00019.fits") && printed.contains("other pixels"),
        "{printed}"
    );
    let rows = Columns::read(out.path(), "ASPECT");
    let (files, sigma_s) = (rows.texts("FILE"), rows.floats("UTC_SIGMA_S"));
    for (row, file) in files.iter().enumerate() {
        let is_pair = [19, 20].contains(&n_of(file));
        assert_eq!(sigma_s[row].is_finite(), is_pair, "{file}");
        assert_eq!(rows.texts("QUALITY")[row], "fine", "{file}");
        assert!(!rows.texts("REASON")[row].contains("the same frame"));
    }
    assert_eq!(summary(out.path())["copies"], 0);
}

#[test]
fn frames_without_a_time_keep_their_own_place_on_the_plate() {
    let [folder, out] = [(); 2].map(|()| temporary());
    write_stamped(folder.path(), |_, info| info.mid_exposure = None);
    refine(folder.path(), out.path(), &[]);
    let rows = Columns::read(out.path(), "ASPECT");
    let [x, y] = ["SUN_X_MIL", "SUN_Y_MIL"].map(|name| rows.floats(name));
    for (row, file) in rows.texts("FILE").iter().enumerate() {
        let truth = sun(time_s(n_of(file)));
        assert!((x[row] - truth.x).hypot(y[row] - truth.y) < 1.0, "{file}");
    }
    assert_eq!(rows.texts("FILE").len(), FRAMES);
}

/// Normalised errors of the smoothed path at its own times, both axes, and its sigmas in X, mil.
fn held_to_truth(out: &Path) -> (Vec<f64>, Vec<f64>) {
    let path = Columns::read(out, "SMOOTHED");
    let [t, x, sx] = ["UNIX_S", "SUN_X_MIL", "SIGMA_X_MIL"].map(|name| path.floats(name));
    let [y, sy] = ["SUN_Y_MIL", "SIGMA_Y_MIL"].map(|name| path.floats(name));
    let first = start().as_second() as f64;
    let (mut ratios, mut sigmas) = (Vec::new(), Vec::new());
    for row in (0..t.len()).filter(|row| x[*row].is_finite()) {
        let truth = sun(t[row] - first);
        ratios.extend([(x[row] - truth.x) / sx[row], (y[row] - truth.y) / sy[row]]);
        sigmas.push(sx[row]);
    }
    (ratios, sigmas)
}

#[test]
fn frames_stamped_to_whole_seconds_are_spread_and_claim_no_more_than_that() {
    let [folder, out] = [(); 2].map(|()| temporary());
    write_stamped(folder.path(), |_, info| {
        info.mid_exposure = info.mid_exposure.map(whole_seconds);
    });
    let output = refine(folder.path(), out.path(), &[]);
    let text = "time stamped to whole seconds: spread by the frames' numbers, 1 sigma 0.29 s";
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(
        printed.contains(&format!("{FRAMES} flagged: {text}")),
        "{printed}"
    );
    let rows = Columns::read(out.path(), "ASPECT");
    let first = start().as_second() as f64;
    let [t, sigma_s, offset_sigma] =
        ["UNIX_S", "UTC_SIGMA_S", "OFFSET_SIGMA_DEG"].map(|name| rows.floats(name));
    let (_, alone) = plain();
    let alone = Columns::read(alone, "ASPECT");
    for (row, file) in rows.texts("FILE").iter().enumerate() {
        let n = n_of(file);
        assert!((sigma_s[row] - 0.2887).abs() < 1e-3);
        assert!((t[row] - first - time_s(n)).abs() < 0.25, "{file}");
        assert!(rows.texts("REASON")[row].contains(text), "{file}");
        let (before, behind) = (sun(time_s(n) - 0.1), sun(time_s(n) + 0.1));
        let moves_mil = before.distance(behind) / 0.2 * 0.2887;
        let moves_deg = moves_mil * 1.746 / 3600.0;
        let least = alone.floats("OFFSET_SIGMA_DEG")[row].max(0.4 * moves_deg);
        assert!(
            offset_sigma[row] > least,
            "{file} {} {least}",
            offset_sigma[row]
        );
    }
    let (ratios, sigmas) = held_to_truth(out.path());
    assert!(sigmas.len() >= FRAMES);
    assert!(ratios.iter().all(|ratio| ratio.abs() < 3.5), "{ratios:?}");
    assert!(sigmas.iter().sum::<f64>() / sigmas.len() as f64 > 10.0);
}

#[test]
fn a_clock_that_stood_still_gives_places_and_no_path() {
    let [folder, out] = [(); 2].map(|()| temporary());
    write_stamped(folder.path(), |_, info| info.mid_exposure = Some(start()));
    let output = refine(folder.path(), out.path(), &[]);
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(printed.contains("the clock stood still"), "{printed}");
    let rows = Columns::read(out.path(), "ASPECT");
    assert!(rows.texts("UTC").iter().all(String::is_empty));
    assert!(rows.floats("OFFSET_SIGMA_DEG").iter().all(|s| s.is_nan()));
    assert!(rows.floats("SUN_X_MIL").iter().all(|x| x.is_finite()));
    assert!(held_to_truth(out.path()).0.is_empty());
}

#[test]
fn times_that_leave_the_order_of_the_numbers_do_not_bend_the_path() {
    let wrong = |n: usize| match n {
        12 => 3600.0,
        20..24 => -6.0 * 3600.0,
        33 => 1.0,
        40 => -86_400.0,
        _ => 0.0,
    };
    let [folder, out] = [(); 2].map(|()| temporary());
    write_stamped(folder.path(), |n, info| {
        let by = SignedDuration::from_secs_f64(wrong(n));
        info.mid_exposure = info.mid_exposure.map(|utc| utc + by);
    });
    refine(folder.path(), out.path(), &[]);
    let rows = Columns::read(out.path(), "ASPECT");
    let first = start().as_second() as f64;
    for (row, file) in rows.texts("FILE").iter().enumerate() {
        let n = n_of(file);
        let is_wrong = wrong(n) != 0.0;
        assert_eq!(
            rows.floats("UTC_SIGMA_S")[row].is_finite(),
            is_wrong,
            "{file}"
        );
        assert!(
            (rows.floats("UNIX_S")[row] - first - time_s(n)).abs() < 0.02,
            "{file}"
        );
        let is_said = rows.texts("REASON")[row].contains("contradicts the frames' numbers");
        assert_eq!(is_said, is_wrong, "{file}");
    }
    let (ratios, _) = held_to_truth(out.path());
    assert!(ratios.iter().all(|ratio| ratio.abs() < 5.0), "{ratios:?}");
}

#[test]
fn what_could_not_be_read_is_counted_and_nothing_read_is_a_failure() {
    let [folder, out] = [(); 2].map(|()| temporary());
    write_stamped(folder.path(), |_, _| {});
    let damage = |n: usize| {
        let path = folder.path().join(format!("frame_{n:05}.fits"));
        let bytes = fs::read(&path).unwrap();
        let kept = if n == 0 { 0 } else { bytes.len() / 2 };
        fs::write(&path, &bytes[..kept]).unwrap();
    };
    (0..10).for_each(damage);
    let output = refine(folder.path(), out.path(), &[]);
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(
        printed.contains("10 files could not be read, most for "),
        "{printed}"
    );
    let some = summary(out.path());
    assert_eq!(some["unreadable"], 10);
    let reasons = some["unreadable_reasons"].as_object().unwrap();
    assert_eq!(
        reasons.values().map(|n| n.as_u64().unwrap()).sum::<u64>(),
        10
    );
    let report = fs::read_to_string(out.path().join("report.html")).unwrap();
    assert!(report.contains("10 files could not be read"));
    (10..FRAMES).for_each(damage);
    let none = command(folder.path(), temporary().path(), &[])
        .output()
        .unwrap();
    assert_eq!(none.status.code(), Some(1));
    let printed = String::from_utf8(none.stderr).unwrap();
    assert!(printed.contains("48 files could not be read"), "{printed}");
}

#[test]
fn an_archive_check_reports_copies_and_calls_none_of_them_bad() {
    let folder = temporary();
    let copies = copied(folder.path());
    let check = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_solaspect"));
        command
            .args(["archive", "check"])
            .arg(folder.path())
            .args(more);
        let output = command.output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success(), "{text}");
        text
    };
    let report: serde_json::Value = serde_json::from_str(&check(&["--json"])).unwrap();
    assert_eq!(
        (&report["copies"], &report["bad"]),
        (&copies.into(), &0.into())
    );
    let list = report["copy_list"].as_array().unwrap();
    for copy in list {
        let [file, first] = ["file", "same_as"].map(|key| copy[key].as_str().unwrap());
        let name = file.replace("/b/", "/a/").replace(" (1)", "");
        assert_eq!(first, name);
    }
    let text = check(&[]);
    assert_eq!(text.matches("the same frame as").count(), copies, "{text}");
    assert!(text.contains(&format!("{copies} copies")), "{text}");
}

#[test]
fn a_flight_of_mirrored_pictures_is_refused() {
    let [folder, out] = [(); 2].map(|()| temporary());
    let direct = folder.path().join("direct.toml");
    let demo = instrument::builtin_text("demo").unwrap();
    fs::write(&direct, demo.replace("\"mirrored\"", "\"direct\"")).unwrap();
    let flight = folder.path().join("flight");
    let mut simulate = Command::new(env!("CARGO_BIN_EXE_solaspect"));
    simulate
        .args(["simulate", "--frames", "12", "--out"])
        .arg(&flight);
    simulate.arg("--instrument").arg(&direct);
    assert!(simulate.output().unwrap().status.success());
    let refused = command(&flight, out.path(), &["--instrument", "demo"])
        .output()
        .unwrap();
    let printed = String::from_utf8(refused.stderr).unwrap();
    assert_eq!(refused.status.code(), Some(1), "{printed}");
    assert!(printed.contains("cannot be identified"), "{printed}");
}

/// Replaces gain and times in a file's headers by values that cannot be parsed.
fn respell(path: &Path) {
    let mut bytes = fs::read(path).unwrap();
    for card in bytes.chunks_exact_mut(80) {
        if card.starts_with(b"MJD-") {
            card.fill(b' ');
        }
        let value: &[u8] = match &card[..9] {
            b"GAIN    =" => b" 'High    '",
            name if name.starts_with(b"DATE-") => b" 'UNKNOWN '",
            _ => continue,
        };
        card[9..].fill(b' ');
        card[9..9 + value.len()].copy_from_slice(value);
    }
    fs::write(path, bytes).unwrap();
}

#[test]
fn values_of_headers_that_are_not_used_are_counted_and_an_unread_time_is_a_reason() {
    let [folder, out] = [(); 2].map(|()| temporary());
    for (n, frame) in frames()[..8].iter().enumerate() {
        let mut frame = frame.clone();
        frame.info.analogue_gain = Some(1.5);
        let path = folder.path().join(format!("frame_{n:05}.fits"));
        write(&path, &frame, Compression::Rice);
        respell(&path);
    }
    let output = refine(folder.path(), out.path(), &[]);
    let [printed, logged] =
        [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
    assert!(printed.contains("8 files: GAIN: expected"), "{printed}");
    assert!(printed.contains("8 files: DATE-"), "{printed}");
    assert_eq!(logged.matches("GAIN").count(), 1, "{logged}");
    let warnings = summary(out.path())["warnings"].clone();
    let warnings = warnings.as_object().unwrap();
    assert!(
        warnings.iter().all(|(_, files)| *files == 8),
        "{warnings:?}"
    );
    let rows = Columns::read(out.path(), "ASPECT");
    for (reason, x) in rows.texts("REASON").iter().zip(rows.floats("SUN_X_MIL")) {
        assert!(
            reason.starts_with("time: DATE-") && x.is_finite(),
            "{reason}"
        );
    }
}
