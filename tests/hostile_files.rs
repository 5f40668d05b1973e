//! Invalid files: paths that are not regular files, and numbers that are impossible for an instrument. Each is an error
//! that names file and reason, and nothing blocks.

use crate::common::flight::frames_in;
use solaspect::config::Config;
use solaspect::instrument::{DirectionCamera, Instrument, MountedCamera};
use solaspect::link::{BytePort, SerialPort};
use solaspect::navigation::NavigationSettings;
use solaspect::simulate::Pieces;
use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const LONG: Duration = Duration::from_secs(60);

/// Runs the program for at most 60 s; after that it is killed, and the exit code is 124.
fn solaspect(arguments: &[&str]) -> Output {
    let mut command = Command::new("timeout");
    command.args(["60", env!("CARGO_BIN_EXE_solaspect")]);
    command.args(arguments).env_remove("RUST_LOG");
    command.stdin(Stdio::null()).output().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn said(output: &Output) -> String {
    let both = [output.stdout.as_slice(), &output.stderr].concat();
    String::from_utf8_lossy(&both).into_owned()
}

/// A pipe, a link to an endless device, and a folder, each with its description in error messages.
fn impostors(folder: &Path) -> [(PathBuf, &'static str); 3] {
    let [pipe, zero, inner] = ["pipe", "zero", "inner"].map(|name| folder.join(name));
    nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
    symlink("/dev/zero", &zero).unwrap();
    fs::create_dir(&inner).unwrap();
    let device = "a device or pipe";
    [(pipe, device), (zero, device), (inner, "a directory")]
}

#[test]
fn every_file_that_a_configuration_names_is_a_regular_one_or_an_error_that_names_it() {
    let folder = TempDir::new().unwrap();
    let simulated = "[camera]\nsource = \"simulated\"\n";
    for (path, kind) in impostors(folder.path()) {
        let path = text(&path);
        for named in [
            format!("{simulated}instrument = {path:?}\n"),
            format!("[camera]\nsource = \"simulated:{path}\"\n"),
            format!("{simulated}[roll_camera]\nsource = \"simulated\"\ninstrument = {path:?}\n"),
            format!("{simulated}[moon_camera]\nsource = \"simulated\"\ninstrument = {path:?}\n"),
            format!("{simulated}[link]\nport = \"udp:127.0.0.1:9\"\nkey_file = {path:?}\n"),
            format!("{simulated}[link]\nsaved_values = {path:?}\n"),
            format!("{simulated}[sky]\nearth_orientation = {path:?}\n"),
            format!("{simulated}[navigation]\nenabled = \"on\"\nsettings = {path:?}\n"),
        ] {
            let config = folder.path().join("flight.toml");
            fs::write(&config, &named).unwrap();
            for command in [&["config", "check"][..], &["preflight", "--config"]] {
                let output = solaspect(&[command, &[text(&config)]].concat());
                let said = said(&output);
                assert_eq!(output.status.code(), Some(1), "{named}{said}");
                assert!(said.contains(path) && said.contains(kind), "{named}{said}");
            }
        }
        let output = solaspect(&["config", "check", path]);
        assert_eq!(output.status.code(), Some(1));
        assert!(said(&output).contains(&format!("{path}: expected a regular file")));
    }
}

#[test]
fn pipes_and_devices_among_frames_are_errors_of_their_own_lines() {
    let folder = TempDir::new().unwrap();
    let frames = folder.path().join("frames");
    fs::create_dir(&frames).unwrap();
    for (path, _) in &impostors(folder.path())[..2] {
        let name = path.file_name().unwrap().to_str().unwrap();
        fs::rename(path, frames.join(format!("{name}.fits"))).unwrap();
    }
    let output = solaspect(&["solve", "--format", "jsonl", text(&frames)]);
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8(output.stdout).unwrap();
    let wanted = "\"error\":\"expected a regular file, found a device or pipe\"";
    assert_eq!(said.matches(wanted).count(), 2, "{said}");
    for arguments in [
        &["refine", text(&frames), "--out", text(folder.path())][..],
        &["archive", "check", text(&frames)],
        &[
            "calibrate",
            "plate",
            "--out",
            text(&folder.path().join("b.toml")),
            text(&frames),
        ],
    ] {
        let output = solaspect(arguments);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
    }
}

/// The locations of all numbers in a document, as steps from its root; in an array of tables only those of the first.
fn numbers(value: &toml::Value) -> Vec<Vec<Step>> {
    let below = |step: Step, value: &toml::Value| {
        let rest = numbers(value).into_iter();
        rest.map(move |rest| [vec![step.clone()], rest].concat())
    };
    match value {
        toml::Value::Integer(_) | toml::Value::Float(_) => vec![Vec::new()],
        toml::Value::Array(values) => {
            let distinct = if values.iter().all(toml::Value::is_table) {
                1
            } else {
                values.len()
            };
            let values = values.iter().take(distinct).enumerate();
            values
                .flat_map(|(n, value)| below(Step::Item(n), value))
                .collect()
        }
        toml::Value::Table(values) => {
            let values = values.iter();
            values
                .flat_map(|(key, value)| below(Step::Key(key.clone()), value))
                .collect()
        }
        _ => Vec::new(),
    }
}

#[derive(Clone)]
enum Step {
    Key(String),
    Item(usize),
}

/// The document with one number replaced.
fn with_number(document: &toml::Value, place: &[Step], number: f64) -> toml::Value {
    let mut document = document.clone();
    let mut at = &mut document;
    for step in place {
        at = match step {
            Step::Key(key) => &mut at[key.as_str()],
            Step::Item(n) => &mut at[*n],
        };
    }
    *at = number.into();
    document
}

/// The key of an entry as users know it, without `value` or `sigma`.
fn key_of(place: &[Step]) -> String {
    let keys = place.iter().filter_map(|step| match step {
        Step::Key(key) if key != "value" && key != "sigma" => Some(key.as_str()),
        _ => None,
    });
    keys.collect::<Vec<_>>().join(".")
}

type Read = fn(&Path) -> Result<(), String>;

fn read<T, E: ToString>(result: Result<T, E>) -> Result<(), String> {
    result.map(drop).map_err(|error| error.to_string())
}

const PIECES: &str = "repeat_s = 9.0\n[[piece]]\nstart_s = 0.0\nsun_mil = [1, 2]\nslew_mil_per_s = [0.5, 1]\nroll_deg = 2.0\ncloud = 0.5\n";

#[test]
fn no_number_of_a_file_is_infinite_or_none_and_a_huge_one_ends_too() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("file.toml");
    let instrument: Read = |path| read(Instrument::read(path));
    let mounted: Read = |path| read(MountedCamera::read(path));
    let files: [(String, Read); 7] = [
        (include_str!("../calibration/demo.toml").into(), instrument),
        (
            include_str!("../calibration/heroes-pyas-f.toml").into(),
            instrument,
        ),
        (
            include_str!("../calibration/demo-horizon.toml").into(),
            mounted,
        ),
        (
            include_str!("../calibration/demo-moon.toml").into(),
            |path| read(DirectionCamera::read(path)),
        ),
        (
            include_str!("../calibration/demo-nav.toml").into(),
            |path| read(NavigationSettings::read(path)),
        ),
        (PIECES.into(), |path| read(Pieces::read(path))),
        (Config::default().to_toml(), |path| read(Config::read(path))),
    ];
    let mut huge = BTreeSet::new();
    for (text, read) in &files {
        let document = toml::Value::Table(text.parse().unwrap());
        let places = numbers(&document);
        assert!(!places.is_empty());
        for place in places {
            for number in [f64::INFINITY, f64::NEG_INFINITY, f64::NAN, 1e308, -1e308] {
                let document = with_number(&document, &place, number);
                fs::write(&path, toml::to_string(&document).unwrap()).unwrap();
                let key = key_of(&place);
                match read(&path) {
                    Ok(()) if number.is_finite() => _ = huge.insert(key),
                    Ok(()) => panic!("{key} = {number} is taken"),
                    Err(error) => {
                        let last = key.rsplit('.').next().unwrap();
                        let named = error.starts_with(&format!("{}: ", path.display()));
                        assert!(named && error.contains(last), "{key} = {number}: {error}");
                    }
                }
            }
        }
    }
    // `repeat_s` is when the path repeats; `calibration` is information for people.
    let harmless = ["repeat_s", "calibration"];
    huge.retain(|key| !harmless.contains(&key.split('.').next().unwrap()));
    assert_eq!(huge, BTreeSet::new(), "taken as they are");
}

/// A flight that is killed at the end of the test.
struct Fly(Child);

impl Drop for Fly {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_second_flight_with_the_same_archive_or_saved_values_ends_before_it_says_anything() {
    let folder = TempDir::new().unwrap();
    let config = |name: &str, archive: &str| {
        let path = folder.path().join(name);
        let values = folder.path().join("values.toml");
        let archive = folder.path().join(archive);
        fs::create_dir(&archive).unwrap();
        let text = format!(
            "[camera]\nsource = \"simulated\"\n[archive]\ndirectory = {archive:?}\n[link]\nsaved_values = {values:?}\n"
        );
        fs::write(&path, text).unwrap();
        path
    };
    let [first, same_values] = [
        config("first.toml", "one"),
        config("values.toml.toml", "two"),
    ];
    let fly = Command::new(env!("CARGO_BIN_EXE_solaspect"))
        .args(["fly", "--config", text(&first)])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    let fly = Fly(fly.unwrap());
    let start = Instant::now();
    while frames_in(&folder.path().join("one")).is_empty() {
        assert!(start.elapsed() < LONG, "no frame came");
        std::thread::sleep(Duration::from_millis(20));
    }
    let one = folder.path().join("one");
    let same_archive = ["fly", "--camera", "simulated", "--archive", text(&one)];
    let same_values = ["fly", "--config", text(&same_values)];
    let refused = [
        (
            &same_archive[..],
            "archive.lock: expected to be the only program that writes to this archive",
        ),
        (
            &same_values,
            "values.toml: saved values: expected to be the only program that flies with them",
        ),
    ];
    for (arguments, reason) in refused {
        let (mut ours, theirs) = SerialPort::pair().unwrap();
        let output =
            solaspect(&[arguments, &["--serial", theirs.name(), "--duration", "2s"]].concat());
        let said = said(&output);
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains(reason), "{said}");
        let heard = ours.read(&mut [0; 64], Duration::ZERO);
        assert_eq!(heard.unwrap_or(0), 0, "{arguments:?}");
    }
    drop(fly);
    let (_ours, theirs) = SerialPort::pair().unwrap();
    let output = solaspect(
        &[
            &same_values[..],
            &["--serial", theirs.name(), "--duration", "1s"],
        ]
        .concat(),
    );
    assert!(
        !said(&output).contains("the only program"),
        "a flight that was killed holds nothing"
    );
}

#[test]
fn a_configuration_named_as_saved_values_is_refused_and_stays_as_it_is() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("flight.toml");
    let config = format!("[camera]\nsource = \"simulated\"\n[link]\nsaved_values = {path:?}\n");
    fs::write(&path, &config).unwrap();
    for command in [
        &["config", "check"][..],
        &["fly", "--duration", "1s", "--config"],
    ] {
        let output = solaspect(&[command, &[text(&path)]].concat());
        let said = said(&output);
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(
            said.contains(text(&path)) && said.contains("another file"),
            "{said}"
        );
    }
    assert_eq!(fs::read_to_string(&path).unwrap(), config);
}
