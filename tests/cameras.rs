//! Cameras are data: a table in the configuration adds one, or a second of a role, without any other change. `fly` and
//! `preflight` report the same errors.

use crate::common::flight::frames_in;
use solaspect::aspect::Quality;
use solaspect::instrument::{MountedCamera, Role, builtin, builtin_text};
use solaspect::link::{BytePort, FrameMarks, Housekeeping, TelemetryPacket};
use solaspect::link::{CameraCounts, Connection, Direction, Packet, Parser, SerialPort};
use solaspect::plan::{Options, Plan, Replay};
use solaspect::service::{Flight, Service, SolvedFrame};
use solaspect::simulate::FORT_SUMNER;
use solaspect::simulate::earth::SwingingGondola;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

/// A small camera along the gondola's first axis, and one to its right.
const FORWARD: &str = "[camera]\nwidth_px = 480\nheight_px = 270\ncentre_px = [239.5, 134.5]\nfocal_px = [222.2, 222.2]\n\
                       body_from_camera = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]\n";
const TO_THE_RIGHT: &str = "[camera]\nwidth_px = 400\nheight_px = 300\ncentre_px = [199.5, 149.5]\nfocal_px = [200, 200]\n\
                            body_from_camera = [[-1, 0, 0], [0, 0, 1], [0, 1, 0]]\n";

/// Configuration of three plate cameras and two roll cameras; files and archive are in `folder`.
fn configuration(folder: &Path) -> String {
    let at = |name: &str| folder.join(name).display().to_string();
    fs::write(at("forward.toml"), FORWARD).unwrap();
    fs::write(at("right.toml"), TO_THE_RIGHT).unwrap();
    fs::create_dir_all(at("archive")).unwrap();
    format!(
        "[site]\nlatitude_deg = {}\nlongitude_deg = {}\nheight_m = {}\n\
         [camera]\nsource = \"simulated\"\nrate_hz = 2\n\
         [second_camera]\nsource = \"simulated\"\nrate_hz = 1\n\
         [roll_camera]\nsource = \"simulated\"\ninstrument = {:?}\nrate_hz = 2\n\
         [starboard_camera]\nrole = \"roll\"\nsource = \"simulated\"\ninstrument = {:?}\nrate_hz = 2\n\
         [third_camera]\nrole = \"pitch_yaw\"\nsource = \"simulated\"\nrate_hz = 1\n\
         [archive]\ndirectory = {:?}\n",
        FORT_SUMNER.latitude_deg,
        FORT_SUMNER.longitude_deg,
        FORT_SUMNER.height_m,
        at("forward.toml"),
        at("right.toml"),
        at("archive"),
    )
}

fn plan(folder: &Path) -> Plan {
    plan_of(folder, &configuration(folder))
}

fn plan_of(folder: &Path, configuration: &str) -> Plan {
    let file = folder.join("flight.toml");
    fs::write(&file, configuration).unwrap();
    let (plan, remarks) = Plan::survey(Some(&file), &Options::default());
    let errors: Vec<String> = remarks.errors().map(ToString::to_string).collect();
    assert!(errors.is_empty(), "{errors:?}");
    plan
}

/// Flies a plan; the answers, and the telemetry received on the ground.
fn flown(plan: &Plan, duration: Duration) -> (Vec<SolvedFrame>, Vec<TelemetryPacket>) {
    let (near, mut far) = SerialPort::pair().unwrap();
    let replay = Replay {
        duration: Some(duration),
        ..Replay::default()
    };
    let mut flight = Flight::of_plan(plan, replay).unwrap();
    flight.line = Connection::over(near);
    let (service, solved) = Service::start_watched(flight).unwrap();
    let mut parser = Parser::new(Direction::ToController);
    let (mut heard, mut buffer, start) = (Vec::new(), [0; 4096], Instant::now());
    while !service.is_finished() {
        assert!(start.elapsed() < Duration::from_secs(120), "it never ends");
        let count = far.read(&mut buffer, Duration::from_millis(20)).unwrap();
        let packets = parser.feed(&buffer[..count], start.elapsed());
        heard.extend(packets.into_iter().filter_map(|packet| match packet {
            Packet::Telemetry(packet) => Some(packet),
            Packet::Command(_) => None,
        }));
    }
    let tally = service.join().unwrap();
    assert_eq!(tally.lost(), 0, "{tally}");
    (solved.iter().collect(), heard)
}

#[test]
fn two_cameras_of_a_role_and_a_fifth_need_no_more_than_a_table() {
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path());
    let (solved, heard) = flown(&plan, Duration::from_secs(4));
    let mut frames: BTreeMap<String, u32> = BTreeMap::new();
    for frame in &solved {
        *frames
            .entry(frame.station.camera.label.clone())
            .or_default() += 1;
    }
    let labels: Vec<&str> = frames.keys().map(String::as_str).collect();
    assert_eq!(labels, ["demo", "demo-2", "demo-3", "roll", "roll-2"]);
    for (label, count) in &frames {
        let files = frames_in(&folder.path().join("archive").join(label));
        assert_eq!(files.len() as u32, *count, "{label}");
    }
    // Each roll camera measures the gondola's roll with its own mounting.
    for camera in plan
        .cameras
        .iter()
        .filter(|one| one.camera.role == Role::Roll)
    {
        let mounted: &MountedCamera = camera.camera.sees.horizon().unwrap();
        let gondola = SwingingGondola::new(mounted, &FORT_SUMNER, plan.config.simulation.seed);
        let own = solved
            .iter()
            .filter(|a| a.station.camera.name == camera.camera.name);
        let mut rolls = 0;
        for frame in own {
            let roll = frame.solved.roll.unwrap().deg;
            let since_start = frame.exposure.frame.info.monotonic.unwrap();
            let off_deg = roll.value - gondola.roll_deg(since_start);
            assert!(
                off_deg.abs() < 5.0 * roll.sigma,
                "{off_deg} +- {}",
                roll.sigma
            );
            rolls += 1;
        }
        assert!(rolls >= 4, "{rolls} of {}", camera.camera.name);
    }
    // Counts are sent for exactly those cameras that the housekeeping does not cover.
    let counts = heard
        .iter()
        .filter_map(|packet| CameraCounts::decode(packet).ok());
    let mut last: BTreeMap<u16, CameraCounts> = BTreeMap::new();
    counts.for_each(|counts| _ = last.insert(counts.camera, counts));
    assert_eq!(last.keys().copied().collect::<Vec<_>>(), [2, 3, 8]);
    let of_roll = last[&8];
    assert_eq!(of_roll.role, Role::Roll as u16);
    assert!(of_roll.fine >= 1 && of_roll.lost == 0, "{of_roll:?}");
    let solved = |number: u8| {
        let own = solved
            .iter()
            .filter(move |frame| frame.station.number == number);
        own.filter(|frame| frame.solved.quality == Quality::Fine)
            .count()
    };
    assert!(u64::from(last[&2].fine) <= solved(2) as u64);
}

/// The demo instrument with a table of marks, whose ids the pattern of 2013 does not have.
fn with_listed_plate(folder: &Path) -> String {
    let places = builtin("demo").unwrap().plate;
    let rows: String = places
        .marks()
        .map(|(id, at)| format!("{},{},{},{}\n", 100 + id.i, id.j - 9000, at.x, at.y))
        .collect();
    fs::write(folder.join("marks.csv"), format!("i,j,x_mil,y_mil\n{rows}")).unwrap();
    let text = builtin_text("demo").unwrap();
    let text = text.replace("[plate]\n", "[plate]\nmarks = \"marks.csv\"\n");
    let file = folder.join("listed.toml");
    fs::write(&file, text).unwrap();
    file.display().to_string()
}

#[test]
fn a_plate_of_another_pattern_sends_its_ids_in_a_message_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let configuration = format!(
        "[camera]\nsource = \"simulated\"\ninstrument = {:?}\nrate_hz = 2\n\
         [second_camera]\nsource = \"simulated\"\nrate_hz = 2\n",
        with_listed_plate(folder.path()),
    );
    let plan = plan_of(folder.path(), &configuration);
    let (solved, heard) = flown(&plan, Duration::from_secs(4));
    let marks: Vec<(FrameMarks, (u32, u32))> = heard
        .iter()
        .filter_map(|packet| Some((FrameMarks::decode(packet).ok()?, packet.time())))
        .collect();
    assert!(marks.len() >= 2, "{} packets", marks.len());
    let mut read = 0;
    for (marks, time) in &marks {
        assert_eq!(marks.camera, 1, "the other one has the plate of 2013");
        let frame = solved.iter().find(|frame| {
            let number = frame.exposure.frame.info.number;
            frame.station.number == 1 && number == Some(marks.number.into())
        });
        let solution = &frame.unwrap().sun().unwrap().solution;
        let ids: Vec<[i32; 2]> = solution.marks.iter().map(|m| [m.id.i, m.id.j]).collect();
        assert_eq!(marks.ids().collect::<Vec<_>>(), ids);
        assert!(ids.iter().all(|[i, j]| *i > 90 && *j < -8990), "{ids:?}");
        // Housekeeping with the same time describes the same frame.
        let housekeeping = heard.iter().filter(|packet| packet.time() == *time);
        let housekeeping: Vec<_> = housekeeping.filter_map(Housekeeping::decode).collect();
        assert_eq!(housekeeping.len(), 1);
        assert_eq!(
            (housekeeping[0].number, u16::from(housekeeping[0].marks)),
            (marks.number, marks.marks)
        );
        assert_eq!(housekeeping[0].ids.iter().count(), 0);
        read += ids.len();
    }
    assert!(read > 0, "no mark was read");
}

#[test]
fn more_cameras_than_the_line_has_numbers_for_are_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("many.toml");
    let table = |n: usize| format!("[a{n}_camera]\nrole = \"roll\"\nsource = \"simulated\"\n");
    for (cameras, refused) in [(9, None), (10, Some("a9_camera.source"))] {
        let further: String = (0..cameras).map(table).collect();
        fs::write(
            &file,
            format!("[camera]\nsource = \"simulated\"\n{further}"),
        )
        .unwrap();
        let (_, remarks) = Plan::survey(Some(&file), &Options::default());
        let key = remarks
            .errors()
            .next()
            .map(|error| error.what.field.clone());
        assert_eq!(key.as_deref(), refused, "{cameras}");
    }
}

fn solaspect(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_solaspect"));
    let command = command.args(arguments).env_remove("RUST_LOG");
    command.output().unwrap()
}

#[test]
fn refine_does_not_take_one_roll_cameras_frames_for_anothers() {
    let folder = tempfile::tempdir().unwrap();
    flown(&plan(folder.path()), Duration::from_secs(4));
    let at = |name: &str| folder.path().join(name).display().to_string();
    let refined = solaspect(&["refine", &at("archive"), "--out", &at("refined")]);
    let said = [refined.stdout, refined.stderr].concat();
    let said = String::from_utf8(said).unwrap();
    assert!(refined.status.success(), "{said}");
    assert!(
        said.contains("8 frames of another roll camera, \"roll-2\""),
        "{said}"
    );
}

#[test]
fn what_preflight_calls_an_error_flies_only_by_force_and_the_log_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    fs::create_dir(at("archive")).unwrap();
    // A camera whose instrument file is missing, and a maximum age of roll that is too small.
    let config = format!(
        "[camera]\nsource = \"simulated\"\n[roll_camera]\nsource = \"simulated\"\ninstrument = \"/nowhere/roll.toml\"\n\
         [roll]\nmax_age_s = 0.01\n[archive]\ndirectory = {:?}\n",
        at("archive")
    );
    fs::write(at("flight.toml"), config).unwrap();
    let error = "/nowhere/roll.toml: expected a file, or a built-in instrument";
    let fly = ["fly", "--config", &at("flight.toml"), "--duration", "1s"];
    for command in [
        &["config", "check", &at("flight.toml")][..],
        &["preflight", "--config", &at("flight.toml")],
        &fly,
    ] {
        let output = solaspect(command);
        let said = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
        assert_eq!(output.status.code(), Some(1), "{command:?}: {said}");
        assert!(said.contains(error), "{command:?}: {said}");
    }
    let output = solaspect(&[&fly[..], &["--force"]].concat());
    let log = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{log}");
    for words in [error, "flies by --force", "roll.max_age_s: expected"] {
        assert!(log.contains(words), "{words} in {log}");
    }
    // Without the camera that commands refer to, nothing flies.
    let config = "[camera]\nsource = \"simulated\"\ninstrument = \"/nowhere/i.toml\"\n[second_camera]\nsource = \"simulated\"\n";
    fs::write(at("second.toml"), config).unwrap();
    let second = [
        "fly",
        "--config",
        &at("second.toml"),
        "--duration",
        "1s",
        "--force",
    ];
    assert_eq!(solaspect(&second).status.code(), Some(1));
    assert!(
        frames_in(&folder.path().join("archive")).len() >= 3,
        "{log}"
    );
}
