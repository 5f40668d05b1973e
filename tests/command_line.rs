//! Conventions shared by all commands: folders of frames, built-in instruments, dates, values of options, and error
//! messages.

use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

const FRAMES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/frames");
const CALIBRATION: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/calibration");
const PLACE: [&str; 2] = ["--place", "34.49,-104.2218,38405"];

fn solaspect(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_solaspect"));
    command.args(arguments).env_remove("RUST_LOG");
    command.output().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn printed(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// Results of `solve` without the solve time.
fn answers(arguments: &[&str]) -> Vec<Value> {
    let output = solaspect(&[&["solve"], arguments].concat());
    let text = printed(&output);
    let mut answers: Vec<Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    for answer in &mut answers {
        answer.as_object_mut().unwrap().remove("solve_us");
    }
    answers
}

#[test]
fn a_folder_stands_for_its_frames_in_the_order_of_their_names() {
    let frame = |name: &str| format!("{FRAMES}/{name}.fits");
    let [standard, first, third] = [
        "standard/frame_00000",
        "partial/frame_00001",
        "partial/frame_00003",
    ]
    .map(frame);
    let partial = format!("{FRAMES}/partial");
    let named = answers(&[&standard, &first, &third]);
    assert_eq!(named.len(), 3);
    assert_eq!(answers(&[&standard, &partial]), named);
    assert_eq!(answers(&["--track", &standard, &partial]).len(), 3);
}

#[test]
fn a_folder_without_frames_is_a_line_and_the_rest_go_on() {
    let folder = tempfile::tempdir().unwrap();
    let frame = format!("{FRAMES}/standard/frame_00000.fits");
    let output = solaspect(&["solve", folder.path().to_str().unwrap(), &frame]);
    assert_eq!(output.status.code(), Some(1));
    let lines = printed(&output);
    let lines: Vec<&str> = lines.lines().collect();
    assert!(
        lines[0].contains("\"error\"") && lines[1].contains("\"fine\""),
        "{lines:?}"
    );
}

#[test]
fn every_instrument_option_takes_the_name_of_a_built_in_one() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let frame = format!("{FRAMES}/standard/frame_00000.fits");
    let file = format!("{CALIBRATION}/heroes-pyas-r.toml");
    let by = |instrument: &str| {
        answers(&[&PLACE, &["--instrument", instrument, frame.as_str()][..]].concat())
    };
    assert_eq!(by("heroes-pyas-r"), by(&file));
    assert_ne!(by("heroes-pyas-r"), by("heroes-pyas-f"));

    let lines = [
        format!(
            "simulate --frames 1 --instrument NAME --out {}",
            at("simulated")
        ),
        "fly --camera simulated --duration 1s --instrument NAME".into(),
        "preflight --camera simulated --instrument NAME".into(),
        format!(
            "refine {FRAMES}/standard --instrument NAME --out {}",
            at("refined")
        ),
        format!(
            "calibrate plate {frame} --instrument NAME --out {}",
            at("plate.toml")
        ),
        "calibrate compare NAME heroes-pyas-f".into(),
        format!("horizon --height-m 38000 {frame} --instrument NAME"),
        format!("moon {frame} --instrument NAME"),
    ];
    for line in &lines {
        let run = |name: &str| {
            let line = line.replace("NAME", name);
            let output = solaspect(&line.split(' ').collect::<Vec<_>>());
            assert_ne!(output.status.code(), Some(2), "{line}: {}", said(&output));
            printed(&output) + &said(&output)
        };
        let of_the_sky = line.starts_with("horizon") || line.starts_with("moon");
        let known = run(if of_the_sky { "demo-horizon" } else { "demo" });
        assert!(
            !known.contains("expected a file, or a built-in instrument"),
            "{line}: {known}"
        );
        let unknown = run("demonstration");
        assert!(
            unknown.contains("demonstration: expected a file, or a built-in instrument (demo, "),
            "{line}: {unknown}"
        );
    }
}

#[test]
fn a_file_is_preferred_to_the_built_in_instrument_of_its_name() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("demo"), "colour = 1\n").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_solaspect"));
    command
        .current_dir(folder.path())
        .args(["solve", "--instrument", "demo", "frame.fits"]);
    let said = said(&command.output().unwrap());
    assert!(said.contains("colour"), "{said}");
}

#[test]
fn dates_are_read_alike_in_all_commands() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let config = at("flight.toml");
    let start = "[camera]\nsource = \"simulated\"\n[simulation]\nstart_utc = \"TIME\"\n";
    for time in ["2013-09-21", "2013-09-21T00:00", "2013-09-21T00:00:00Z"] {
        fs::write(&config, start.replace("TIME", time)).unwrap();
        let lines = [
            format!("sky --place 0,0,0 --at {time}"),
            format!("sky --place 0,0,0 --from {time} --to 2013-09-22 --step 12h"),
            format!("sky visibility --orbit leo550 --days 1 --from {time}"),
            format!("simulate --frames 1 --utc {time} --out {}", at("simulated")),
            format!(
                "refine {FRAMES}/standard --since {time} --until 2013-09-22 --out {}",
                at(time)
            ),
            format!("moon --place 0,0,0 --at {time} {FRAMES}/night/frame_00000.fits"),
            format!("config check {config}"),
        ];
        for line in &lines {
            let output = solaspect(&line.split(' ').collect::<Vec<_>>());
            assert!(
                output.status.success(),
                "{line}: {}{}",
                printed(&output),
                said(&output)
            );
        }
        let refined = fs::read_to_string(Path::new(&at(time)).join("aspect.csv")).unwrap();
        assert!(refined.contains("frame_00000.fits"), "{refined}");
    }
    for line in [
        "sky --place 0,0,0 --at soon",
        "refine . --out . --since soon",
    ] {
        let output = solaspect(&line.split(' ').collect::<Vec<_>>());
        let said = said(&output);
        assert_eq!(output.status.code(), Some(2));
        assert!(
            said.contains("expected a time such as 2013-09-21T18:00:00Z, found \"soon\""),
            "{said}"
        );
    }
}

#[test]
fn solve_says_once_how_to_get_offsets_where_only_the_place_is_missing() {
    let frame = format!("{FRAMES}/standard/frame_00000.fits");
    let hint = "no offset for 2 frames without a place";
    let printed = said(&solaspect(&["solve", &frame, &frame]));
    assert_eq!(printed.lines().count(), 1, "{printed}");
    assert!(
        printed.contains(hint) && printed.contains("--place LAT,LON,HEIGHT_M"),
        "{printed}"
    );
    let night = format!("{FRAMES}/night/frame_00000.fits");
    assert_eq!(said(&solaspect(&["solve", &night])), "");
    assert_eq!(said(&solaspect(&["solve", &frame, PLACE[0], PLACE[1]])), "");
}

#[test]
fn an_option_takes_its_value_after_a_space_as_after_an_equals_sign() {
    let preflight = |options: &[&str]| {
        let output = solaspect(&[&["preflight", "--camera", "simulated"], options].concat());
        assert_ne!(
            output.status.code(),
            Some(2),
            "{options:?}: {}",
            said(&output)
        );
    };
    preflight(&["--wait-controller", "20ms"]);
    preflight(&["--wait-controller=20ms"]);
    preflight(&["--wait-controller", "--json"]);
}

#[test]
fn a_table_fits_100_columns_and_has_angles_in_arcsec() {
    let frames = [
        "standard/frame_00000",
        "partial/frame_00001",
        "partial/frame_00003",
        "night/frame_00000",
    ];
    let frames = frames.map(|name| format!("{FRAMES}/{name}.fits"));
    let solve = |options: &[&str]| {
        let frames: Vec<&str> = frames.iter().map(String::as_str).collect();
        let line = [&["solve"], options, &PLACE, &frames].concat();
        printed(&solaspect(&line))
    };
    let table = solve(&["--format", "table"]);
    for line in table.lines() {
        assert!(line.chars().count() <= 100, "{line}");
    }
    assert!(
        table.starts_with("file ")
            && table.contains("sigma, arcsec")
            && table.contains("offset, arcsec")
    );
    let json = solve(&[]);
    let first: Value = serde_json::from_str(json.lines().next().unwrap()).unwrap();
    let degrees = |axis: &str| first["offset_deg"][axis].as_f64().unwrap();
    let offset = format!(
        "{:.1}, {:.1}",
        degrees("azimuth") * 3600.0,
        degrees("elevation") * 3600.0
    );
    assert!(table.lines().nth(1).unwrap().ends_with(&offset), "{table}");
    let last: Value = serde_json::from_str(json.lines().last().unwrap()).unwrap();
    let reason = last["reason"]["reason"].as_str().unwrap();
    assert!(table.lines().last().unwrap().contains(reason), "{table}");
}

#[test]
fn mistakes_in_a_file_are_reported_in_plain_words() {
    let folder = tempfile::tempdir().unwrap();
    let demo = fs::read_to_string(format!("{CALIBRATION}/demo.toml")).unwrap();
    let line = |begins: &str| {
        demo.lines()
            .position(|line| line.starts_with(begins))
            .unwrap()
            + 1
    };
    let (width, scale) = (line("width_px"), line("scale_mil_per_px"));
    let without_width: Vec<&str> = demo
        .lines()
        .filter(|line| !line.starts_with("width_px"))
        .collect();
    let cases = [
        (
            demo.replace(
                "width_px = { value = 1296,",
                "width_px = { value = \"wide\",",
            ),
            format!(
                "camera.width_px.value: expected a whole number, found \"wide\" on line {width}"
            ),
        ),
        (
            demo.replace("width_px = { value = 1296,", "width_px = { value = [1, 2],"),
            format!("camera.width_px.value: expected a whole number, found a list on line {width}"),
        ),
        (
            demo.replace("{ value = 5.75,", "{ value = true,"),
            format!(
                "mounting.scale_mil_per_px.value: expected a number, found true on line {scale}"
            ),
        ),
        (
            without_width.join("\n"),
            "camera.width_px: expected a value, found none".into(),
        ),
    ];
    for (text, expected) in cases {
        assert_ne!(text, demo);
        let path = folder.path().join("instrument.toml");
        fs::write(&path, text).unwrap();
        let path = path.to_str().unwrap();
        let said = said(&solaspect(&["solve", "--instrument", path, "frame.fits"]));
        assert!(said.trim_end().ends_with(&expected), "{said}");
    }
}

#[test]
fn a_configuration_that_is_no_toml_is_one_error_and_no_guess() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.toml");
    let check = |text: &str| {
        fs::write(&path, text).unwrap();
        let output = solaspect(&["config", "check", path.to_str().unwrap()]);
        assert_eq!(output.status.code(), Some(1));
        printed(&output) + &said(&output)
    };
    let broken = check("[archive]\ndirectory = \"x\n");
    assert!(broken.contains("line 2: expected valid TOML"), "{broken}");
    assert!(!broken.contains("found none"), "{broken}");
    let far = check("bogus = 1\n");
    assert!(
        far.contains("bogus: expected a known key, found an unknown key"),
        "{far}"
    );
}

#[test]
fn what_is_no_serial_port_is_called_so() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let path = file.path().to_str().unwrap();
    let said = said(&solaspect(&["link", "send", "--port", path, "no_op"]));
    assert!(
        said.contains("expected a serial port, found something else"),
        "{said}"
    );
}

#[test]
fn a_frame_of_the_accuracy_report_has_no_number_beyond_all_marks() {
    let shown = printed(&solaspect(&[
        "accuracy", "--only", "standard", "--seed", "1",
    ]));
    assert!(shown.contains("lit_marks: 0..=2000"), "{shown}");
}
