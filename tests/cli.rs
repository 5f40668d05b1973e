//! The program from the user's view: arguments in, lines and exit codes out.

use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

const FRAMES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/frames");

fn solaspect(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_solaspect"));
    command.args(arguments).env_remove("RUST_LOG");
    command.output().unwrap()
}

fn lines(output: &Output) -> Vec<Value> {
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Writes a FITS file of one HDU with these cards and data.
fn fits(folder: &Path, name: &str, cards: &[(&str, &str)], data: &[u8]) -> PathBuf {
    let mut bytes = Vec::new();
    for (keyword, value) in cards {
        bytes.extend(format!("{:<80}", format!("{keyword:<8}= {value:>20}")).bytes());
    }
    bytes.extend(format!("{:<80}", "END").bytes());
    bytes.resize(bytes.len().next_multiple_of(2880), b' ');
    bytes.extend(data);
    bytes.resize(bytes.len().next_multiple_of(2880), 0);
    let path = folder.join(name);
    fs::write(&path, bytes).unwrap();
    path
}

fn image<'a>(bitpix: &'a str, axes: &[&'a str]) -> Vec<(&'static str, &'a str)> {
    const NAMES: [&str; 3] = ["NAXIS1", "NAXIS2", "NAXIS3"];
    let count = ["0", "1", "2", "3"][axes.len()];
    let mut cards = vec![("SIMPLE", "T"), ("BITPIX", bitpix), ("NAXIS", count)];
    cards.extend(NAMES.into_iter().zip(axes.iter().copied()));
    cards
}

/// All commands that print and end soon.
fn that_print(folder: &Path) -> Vec<Vec<String>> {
    let frame = format!("{FRAMES}/standard/frame_00000.fits");
    let good = folder.join("good.toml");
    fs::write(&good, "[camera]\nsource = \"simulated\"\n").unwrap();
    let archive = folder.join("archive");
    fs::create_dir_all(&archive).unwrap();
    fs::copy(&frame, archive.join("frame.fits")).unwrap();
    let at = |name: &str| folder.join(name).display().to_string();
    let lines = [
        "config example".to_owned(),
        "config parameters".into(),
        format!("config check {}", good.display()),
        format!("config check --json {}", good.display()),
        "preflight --camera simulated".into(),
        "calibrate compare heroes-pyas-f heroes-pyas-r".into(),
        "calibrate compare --json heroes-pyas-f heroes-pyas-r".into(),
        format!("solve {frame}"),
        format!("solve --format table {frame}"),
        format!("solve --format csv {frame}"),
        "sky --at 2013-09-21T18:00:00Z --place 34.49,-104.2218,38405".into(),
        "sky visibility --orbit leo550 --days 1".into(),
        "sky visibility --orbit leo550 --simplified --json".into(),
        format!("simulate --frames 1 --out {}", at("simulated")),
        format!(
            "simulate --navigation rocket --duration-s 2 --out {}",
            at("flown")
        ),
        format!("refine {} --out {}", archive.display(), at("refined")),
        format!("archive check {}", archive.display()),
        "link decode 9ac30104050067b803110800".into(),
        "fly --camera simulated --duration 1s".into(),
        format!("demo --duration 1s --archive {}", at("demo")),
    ];
    let words = |line: &String| line.split(' ').map(str::to_owned).collect();
    lines.iter().map(words).collect()
}

/// Runs a command with `out` as standard output and standard error; asserts that it does not panic.
fn run_into(words: &[String], out: impl Fn() -> Stdio) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_solaspect"));
    let status = command.args(words).stdout(out()).stderr(out()).status();
    let code = status.unwrap().code();
    assert!(matches!(code, Some(0 | 1)), "{words:?}: {code:?}");
}

#[test]
fn no_command_panics_when_nobody_reads_what_it_prints() {
    let folder = tempfile::tempdir().unwrap();
    for words in that_print(folder.path()) {
        run_into(&words, || {
            let (reader, writer) = std::io::pipe().unwrap();
            drop(reader);
            writer.into()
        });
    }
}

#[test]
fn no_command_panics_when_what_it_prints_cannot_be_written() {
    let folder = tempfile::tempdir().unwrap();
    for words in that_print(folder.path()) {
        let full = || fs::File::options().write(true).open("/dev/full").unwrap();
        run_into(&words, || full().into());
    }
}

#[test]
fn every_bad_file_has_a_clear_line_and_the_rest_of_the_batch_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let good = format!("{FRAMES}/standard/frame_00000.fits");
    let whole = fs::read(&good).unwrap();
    fs::write(at("empty.fits"), []).unwrap();
    fs::write(at("truncated.fits"), &whole[..whole.len() / 2]).unwrap();
    fs::write(at("text.fits"), "this is no frame at all\n".repeat(200)).unwrap();
    fs::create_dir(at("folder.fits")).unwrap();
    let nan = f32::NAN.to_be_bytes().repeat(64 * 64);
    fits(
        folder.path(),
        "cube.fits",
        &image("8", &["64", "64", "3"]),
        &[0; 64 * 64 * 3],
    );
    fits(
        folder.path(),
        "float.fits",
        &image("-32", &["64", "64"]),
        &nan,
    );
    fits(
        folder.path(),
        "small.fits",
        &image("8", &["64", "64"]),
        &[0; 64 * 64],
    );
    let bad = [
        ("missing.fits", "expected to read the file"),
        ("empty.fits", "expected"),
        ("truncated.fits", "expected"),
        ("text.fits", "expected a FITS, PNG, TIFF or JPEG file"),
        ("folder.fits", "found a directory"),
        ("cube.fits", "size: expected 1296 x 966 px"),
        ("float.fits", "pixels: expected some pixel with a value"),
        (
            "small.fits",
            "expected 1296 x 966 px as of instrument \"demo\", found 64 x 64",
        ),
    ];
    let paths: Vec<PathBuf> = bad.iter().map(|(name, _)| at(name)).collect();
    let mut arguments = vec!["solve"];
    arguments.extend(paths.iter().map(|path| text(path)));
    arguments.push(&good);
    let output = solaspect(&arguments);
    assert_eq!(output.status.code(), Some(1));
    let answers = lines(&output);
    assert_eq!(answers.len(), bad.len() + 1);
    for ((name, expectation), answer) in bad.iter().zip(&answers) {
        let error = answer["error"].as_str().unwrap();
        assert_eq!(answer["file"], text(&at(name)));
        assert!(error.contains(expectation), "{name}: {error}");
        assert!(!error.contains('\n'), "{name}: {error}");
    }
    assert_eq!(answers[bad.len()]["quality"], "fine");
}

#[test]
fn black_and_white_frames_have_no_sun_and_say_why() {
    let folder = tempfile::tempdir().unwrap();
    let size = 1296 * 966;
    let black = fits(
        folder.path(),
        "black.fits",
        &image("8", &["1296", "966"]),
        &vec![0; size],
    );
    let white = fits(
        folder.path(),
        "white.fits",
        &image("8", &["1296", "966"]),
        &vec![255; size],
    );
    let output = solaspect(&["solve", text(&black), text(&white)]);
    assert_eq!(output.status.code(), Some(0));
    for answer in lines(&output) {
        assert_eq!(answer["quality"], "none");
        assert_eq!(answer["reason"]["stage"], "levels");
        assert_eq!(answer["sun_px"], Value::Null);
    }
}

#[test]
fn an_answer_has_every_field_of_the_contract() {
    let frame = format!("{FRAMES}/standard/frame_00000.fits");
    let output = solaspect(&["solve", "--place", "34.49,-104.2218,38405", &frame]);
    assert_eq!(output.status.code(), Some(0));
    let answer = &lines(&output)[0];
    let keys: Vec<&str> = answer
        .as_object()
        .unwrap()
        .keys()
        .map(String::as_str)
        .collect();
    let expected = [
        "file",
        "mapping",
        "marks",
        "offset_deg",
        "quality",
        "reason",
        "solve_us",
        "sun_plate_mil",
        "sun_plate_sigma_mil",
        "sun_px",
        "sun_px_sigma",
        "sun_radius_px",
        "sun_radius_px_sigma",
        "utc",
    ];
    assert_eq!(keys, expected);
    assert_eq!(answer["utc"], "2013-09-21T18:00:00.007Z");
    for key in ["azimuth", "elevation", "sigma"] {
        assert!(answer["offset_deg"][key].is_f64(), "{answer}");
    }
    for key in [
        "kind",
        "scale_mil_per_px",
        "scale_sigma_mil_per_px",
        "rotation_deg",
        "rotation_sigma_deg",
        "residual_px",
    ] {
        assert!(!answer["mapping"][key].is_null(), "{answer}");
    }
    let mark = &answer["marks"][0];
    assert!(mark["id"][1].is_i64() && mark["px"][1].is_f64() && mark["sigma_px"].is_f64());
}

#[test]
fn jobs_and_formats_change_neither_answers_nor_their_order() {
    let frames: Vec<String> = [
        "partial/frame_00001",
        "night/frame_00000",
        "standard/frame_00000",
    ]
    .iter()
    .map(|name| format!("{FRAMES}/{name}.fits"))
    .collect();
    let run = |options: &[&str]| {
        let mut arguments = vec!["solve"];
        arguments.extend(options);
        arguments.extend(frames.iter().map(String::as_str));
        solaspect(&arguments)
    };
    let without_time = |output: &Output| {
        let mut answers = lines(output);
        for answer in &mut answers {
            answer.as_object_mut().unwrap().remove("solve_us");
        }
        answers
    };
    let one = without_time(&run(&[]));
    assert_eq!(without_time(&run(&["--jobs", "3"])), one);
    let csv = String::from_utf8(run(&["--format", "csv"]).stdout).unwrap();
    let mut rows = csv::Reader::from_reader(csv.as_bytes());
    let quality = rows
        .headers()
        .unwrap()
        .iter()
        .position(|c| c == "quality")
        .unwrap();
    for (row, answer) in rows.records().zip(&one) {
        assert_eq!(&row.unwrap()[quality], answer["quality"].as_str().unwrap());
    }
}

#[test]
fn a_bad_instrument_or_configuration_is_one_line_with_file_and_field() {
    let folder = tempfile::tempdir().unwrap();
    let frame = format!("{FRAMES}/standard/frame_00000.fits");
    let instrument = include_str!("../calibration/demo.toml");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path
    };
    let negative = instrument.replace(
        "arm_length_mil = { value = 90",
        "arm_length_mil = { value = -90",
    );
    assert_ne!(negative, instrument);
    let cases = [
        (
            "--instrument",
            write("negative.toml", &negative),
            "plate.arm_length_mil",
        ),
        (
            "--instrument",
            write("key.toml", &format!("colour = 1\n{instrument}")),
            "colour",
        ),
        (
            "--instrument",
            folder.path().join("none.toml"),
            "expected a file, or a built-in instrument",
        ),
        (
            "--config",
            write("config.toml", "[camera]\nrate_hs = 4\n"),
            "\"camera.rate_hz\"",
        ),
    ];
    for (option, path, expectation) in &cases {
        let output = solaspect(&["solve", option, text(path), &frame]);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(
            message.contains(text(path)) && message.contains(expectation),
            "{message}"
        );
        assert_eq!(message.lines().count(), 1, "{message}");
    }
}

#[test]
fn an_overlay_is_a_picture_for_every_frame() {
    let folder = tempfile::tempdir().unwrap();
    let frames = ["standard", "night"].map(|name| format!("{FRAMES}/{name}/frame_00000.fits"));
    let out = text(folder.path());
    let output = solaspect(&["solve", "--overlay", out, &frames[0], &frames[1]]);
    assert_eq!(output.status.code(), Some(0));
    for name in [
        "standard_frame_00000.fits.png",
        "night_frame_00000.fits.png",
    ] {
        let picture = image::open(folder.path().join(name)).unwrap();
        assert!(picture.width() > 400, "{name}");
    }
}

#[test]
fn a_wrong_cameras_file_is_reported_once_on_standard_error() {
    let folder = tempfile::tempdir().unwrap();
    let demo = solaspect::instrument::builtin_text("demo").unwrap();
    let key = "rotation_deg = { value = 0,";
    assert_eq!(demo.matches(key).count(), 1);
    let file = folder.path().join("turned.toml");
    fs::write(&file, demo.replace(key, "rotation_deg = { value = 180,")).unwrap();
    let frame = format!("{FRAMES}/standard/frame_00000.fits");
    let solve = |options: &[&str]| {
        let arguments = [&["solve"], options, &[&frame, &frame]].concat();
        let output = solaspect(&arguments);
        assert_eq!(output.status.code(), Some(0));
        assert!(lines(&output).iter().any(|line| line["quality"] == "fine"));
        String::from_utf8(output.stderr).unwrap()
    };
    for options in [
        &["--instrument", text(&file)][..],
        &["--track", "--instrument", text(&file)],
    ] {
        let said = solve(options);
        assert_eq!(
            said.matches("mounting.rotation_deg: stated 180 +- 1")
                .count(),
            1,
            "{said}"
        );
        assert!(
            said.contains("frame_0000") && said.contains("instrument"),
            "{said}"
        );
    }
    let said = solve(&[]);
    assert!(!said.contains("contradicts"), "{said}");
}

#[test]
fn simulated_frames_are_solved_to_their_truth() {
    let folder = tempfile::tempdir().unwrap();
    let out = text(folder.path());
    let made = solaspect(&[
        "simulate",
        "--out",
        out,
        "--frames",
        "6",
        "--rotation",
        "-20",
        "--seed",
        "7",
    ]);
    assert_eq!(
        made.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&made.stderr)
    );
    let frames: Vec<String> = (0..6).map(|n| format!("{out}/frame_{n:05}.fits")).collect();
    let mut arguments = vec!["solve"];
    arguments.extend(frames.iter().map(String::as_str));
    let answers = lines(&solaspect(&arguments));
    let mut fine = 0;
    let mut truth = csv::Reader::from_path(folder.path().join("truth.csv")).unwrap();
    for (row, answer) in truth.records().zip(&answers) {
        let number = |n: usize| row.as_ref().unwrap()[n].parse::<f64>().unwrap();
        if answer["quality"] != "fine" {
            continue;
        }
        fine += 1;
        for (axis, column) in [(0, 3), (1, 4)] {
            let found = answer["sun_plate_mil"][axis].as_f64().unwrap();
            assert!((found - number(column)).abs() < 0.6, "{answer}");
        }
    }
    // A Sun at a random place on the plate may illuminate too few marks.
    assert!(fine >= 4, "{answers:?}");
}

#[test]
fn wrong_usage_is_distinguished_from_failure() {
    assert_eq!(solaspect(&["solve"]).status.code(), Some(2));
    assert_eq!(
        solaspect(&["demo", "--rate", "fast"]).status.code(),
        Some(2)
    );
    assert_eq!(solaspect(&["--version"]).status.code(), Some(0));
}
