//! Reports of `solaspect preflight` and `solaspect config check` before a flight.

use crate::common::disk::{Fault, FaultyDisk};
use jiff::{Timestamp, civil::Date, tz::Offset};
use serde_json::Value;
use solaspect::archive::disk::LocalDisk;
use solaspect::archive::{SpaceLimits, Store};
use solaspect::clock::ClockStatus;
use solaspect::fits::{self, Compression};
use solaspect::frame::{Frame, FrameInfo, Pixels};
use solaspect::instrument;
use solaspect::link::{BytePort, SerialPort};
use solaspect::pointing::{self, Horizontal, Roll};
use solaspect::preflight::{Demand, Motion, Trend, Verdict, check_folder, judge_clock};
use solaspect::sky::Ephemeris;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tempfile::TempDir;

const FRAMES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/frames");
const DEMO: &str = include_str!("../calibration/demo.toml");

fn solaspect(arguments: &[&str], answers: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_solaspect"));
    command.args(arguments).env_remove("RUST_LOG");
    command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut program = command.spawn().unwrap();
    // A program that refused its arguments reads no answers, so the write may fail.
    let _ = program.stdin.take().unwrap().write_all(answers.as_bytes());
    program.wait_with_output().unwrap()
}

const SIMULATED: &str = "[camera]\nsource = \"simulated\"\n";

/// The configuration; adds the simulator as its camera where it names none.
fn with_camera(config: &str) -> String {
    match config.contains("source =") {
        true => config.into(),
        false if config.contains("[camera]\n") => config.replacen("[camera]\n", SIMULATED, 1),
        false => format!("{config}{SIMULATED}"),
    }
}

/// The page of a preflight as JSON, and whether all checks passed.
struct Page {
    passed: bool,
    page: Value,
}

impl Page {
    /// The page of a configuration, with added settings for the simulated camera, an archive in `folder` and full disks.
    fn of(folder: &TempDir, config: &str, options: &[&str]) -> Self {
        Self::with_answers(folder, config, options, "")
    }

    fn with_answers(folder: &TempDir, config: &str, options: &[&str], answers: &str) -> Self {
        let config = with_camera(config);
        let text = format!(
            "[archive]\nwarn_free_percent = 0\nthin_free_percent = 0\nstop_free_percent = 0\n\
             directory = {:?}\n{config}",
            folder.path().join("archive")
        );
        let sky = match config.contains("[sky]") {
            true => String::new(),
            false => any_day(folder.path()),
        };
        let file = folder.path().join("flight.toml");
        fs::write(&file, text + &sky).unwrap();
        let mut arguments = vec!["preflight", "--json", "--config", file.to_str().unwrap()];
        arguments.extend(options);
        let output = solaspect(&arguments, answers);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(!error.contains("panicked"), "{error}");
        Self {
            passed: output.status.code() == Some(0),
            page: serde_json::from_slice(&output.stdout).unwrap(),
        }
    }

    /// Verdict and text of each finding of a check, as lines "verdict: found".
    fn found(&self, check: &str) -> String {
        let checks = self.page["checks"].as_array().unwrap();
        let of_it = checks.iter().filter(|finding| finding["check"] == check);
        let text = |value: &Value| value.as_str().unwrap().to_owned();
        let lines = of_it.map(|f| format!("{}: {}\n", text(&f["verdict"]), text(&f["found"])));
        lines.collect()
    }

    /// Remedy of the first finding of a check.
    fn remedy(&self, check: &str) -> &str {
        let checks = self.page["checks"].as_array().unwrap();
        let of_it = checks.iter().find(|finding| finding["check"] == check);
        of_it.unwrap()["remedy"].as_str().unwrap()
    }

    fn failures(&self) -> Vec<&str> {
        let checks = self.page["checks"].as_array().unwrap();
        let failed = checks.iter().filter(|finding| finding["verdict"] == "fail");
        failed.map(|f| f["check"].as_str().unwrap()).collect()
    }
}

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

#[test]
fn the_simulated_camera_with_an_archive_passes_and_leaves_nothing_behind() {
    let folder = folder();
    let page = Page::of(&folder, "", &[]);
    assert!(page.passed, "{}", page.page);
    assert!(page.failures().is_empty());
    let disk = page.found(&format!("disk {}", folder.path().join("archive").display()));
    assert!(
        disk.contains("GB free") && disk.contains("files/s"),
        "{disk}"
    );
    assert!(page.found("camera").contains("simulated answers; "));
    assert!(page.found("camera solves").starts_with("pass: fine"));
    assert!(page.found("camera settings").starts_with("pass"));
    assert!(page.found("Earth orientation").contains("1973"));
    assert!(
        page.found("camera boresight")
            .starts_with("pass: 1 sigma of the boresight 1.7 arcsec")
    );
    let left = fs::read_dir(folder.path().join("archive")).unwrap();
    let names: Vec<_> = left.map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(names, ["archive.lock"]);
}

#[test]
fn a_page_for_people_has_a_line_for_each_check_and_one_for_all() {
    let folder = folder();
    let file = folder.path().join("flight.toml");
    fs::write(&file, with_camera(&any_day(folder.path()))).unwrap();
    let output = solaspect(&["preflight", "--config", file.to_str().unwrap()], "");
    let page = String::from_utf8(output.stdout).unwrap();
    let lines: Vec<&str> = page.lines().collect();
    assert!(
        lines.iter().any(|line| line.starts_with("warn  archive ")),
        "{page}"
    );
    assert!(lines.last().unwrap().ends_with(" 0 failed"), "{page}");
    assert_eq!(output.status.code(), Some(0));
}

#[test]
fn a_disk_that_is_a_file_fails_by_name() {
    let folder = folder();
    fs::write(folder.path().join("archive"), "not a folder").unwrap();
    let page = Page::of(&folder, "", &[]);
    assert!(!page.passed);
    let check = format!("disk {}", folder.path().join("archive").display());
    assert_eq!(page.failures(), [check.as_str()]);
    assert!(
        page.found(&check)
            .contains("archive.lock: expected to create the disk's lock file")
    );
    assert!(page.remedy(&check).contains("not a file"), "{}", page.page);
}

fn demand(limits: [f64; 3]) -> Demand {
    Demand {
        instrument: "demo".into(),
        packing: Compression::Rice.into(),
        limits: SpaceLimits {
            warn_percent: limits[0],
            thin_percent: limits[1],
            stop_percent: limits[2],
        },
        frame_bytes: 100_000,
        rate_hz: 0.001,
        min_hours: 12.0,
    }
}

#[test]
fn a_disk_is_judged_by_its_free_space_and_by_a_frame_written_to_it() {
    let folder = folder();
    let disk = FaultyDisk::new(LocalDisk);
    let verdicts = |fault| {
        disk.set(fault);
        let findings = check_folder(disk.clone(), folder.path(), &demand([10.0, 3.0, 1.0]));
        let verdicts: Vec<Verdict> = findings.iter().map(|finding| finding.verdict).collect();
        verdicts
    };
    use Verdict::{Fail, Pass, Warn};
    assert_eq!(verdicts(Some(Fault::Free(50.0))), [Pass, Pass]);
    assert_eq!(verdicts(Some(Fault::Free(5.0))), [Warn, Pass]);
    assert_eq!(verdicts(Some(Fault::Free(2.0))), [Fail, Pass]);
    assert_eq!(verdicts(Some(Fault::Free(0.5))), [Fail, Pass]);
    assert_eq!(
        verdicts(Some(Fault::Quota { bytes: 0 })).last(),
        Some(&Fail)
    );
    assert_eq!(verdicts(Some(Fault::Step("sync"))).last(), Some(&Fail));
}

#[test]
fn a_disk_is_judged_by_the_time_that_its_space_is_for() {
    let folder = folder();
    let disk = FaultyDisk::new(LocalDisk);
    disk.set(Some(Fault::Free(50.0)));
    // 50 % of the simulated disk is 50 MB.
    let finding_at = |bytes_per_s: f64| {
        let demand = Demand {
            rate_hz: bytes_per_s / 100_000.0,
            ..demand([10.0, 3.0, 1.0])
        };
        check_folder(disk.clone(), folder.path(), &demand).remove(0)
    };
    // Plenty of space, but only 40 more files, at 10 per second.
    disk.set(Some(Fault::Files(40)));
    let finding = finding_at(1_000_000.0);
    assert_eq!(finding.verdict, Verdict::Fail, "{finding}");
    assert!(finding.found.contains("40 files"), "{finding}");
    disk.set(Some(Fault::Free(50.0)));
    let finding = finding_at(1_000.0);
    assert_eq!(finding.verdict, Verdict::Pass, "{finding}");
    assert!(finding.found.contains("for 13.9 h of frames"), "{finding}");
    let finding = finding_at(50_000.0);
    assert_eq!(finding.verdict, Verdict::Warn, "{finding}");
    assert!(
        finding.found.contains("for 16.7 min of frames"),
        "{finding}"
    );
    let finding = finding_at(1_000_000.0);
    assert_eq!(finding.verdict, Verdict::Fail, "{finding}");
    assert!(finding.found.contains("for 0.8 min of frames"), "{finding}");
}

#[test]
fn a_folder_of_a_disk_that_is_not_mounted_fails_and_is_not_made() {
    let folder = folder();
    let archive = folder.path().join("mount/archive");
    let page = Page::of(&folder, "", &["--archive", archive.to_str().unwrap()]);
    let check = format!("disk {}", archive.display());
    assert_eq!(page.failures(), [check.as_str()]);
    assert!(page.remedy(&check).contains("is the disk mounted?"));
    assert!(!folder.path().join("mount").exists());
}

#[test]
fn an_archive_that_another_program_writes_to_says_that_it_is_to_be_stopped() {
    let folder = folder();
    let archive = folder.path().join("archive");
    let _service = Store::open(&archive, "demo", Compression::Rice).unwrap();
    let page = Page::of(&folder, "", &[]);
    let check = format!("disk {}", archive.display());
    assert_eq!(page.failures(), [check.as_str()]);
    assert!(page.remedy(&check).contains("stop the service first"));
}

#[test]
fn two_folders_on_one_disk_are_a_warning() {
    let folder = folder();
    let second = folder.path().join("second");
    let config = format!("second_directory = {second:?}\n");
    let page = Page::of(&folder, &config, &[]);
    assert!(page.passed);
    assert!(
        page.found("two disks")
            .starts_with("warn: both folders are on one device")
    );
}

#[test]
fn a_camera_of_another_size_fails_with_both_sizes() {
    let folder = folder();
    let pixels = Pixels::U8(vec![7; 640 * 480]);
    let frame = Frame::new(640, 480, pixels, 255, FrameInfo::default()).unwrap();
    let frames = folder.path().join("frames");
    fs::create_dir(&frames).unwrap();
    fits::write_frame(&frames.join("a.fits"), &frame, &[], &[], Compression::Rice).unwrap();
    let source = format!("folder:{}", frames.display());
    let page = Page::of(&folder, "", &["--camera", &source]);
    assert!(!page.passed);
    assert_eq!(page.failures(), ["camera"]);
    let found = page.found("camera");
    assert!(
        found.contains("1296 x 966") && found.contains("640 x 480"),
        "{found}"
    );
}

#[test]
fn what_a_camera_sees_is_judged_by_its_light() {
    for (kind, light, solves) in [
        ("standard", "pass: light at", "pass: fine"),
        ("saturated", "warn: light at", ""),
        ("night", "warn: dark", "warn: no Sun"),
    ] {
        let folder = folder();
        let source = format!("folder:{FRAMES}/{kind}");
        let page = Page::of(&folder, "", &["--camera", &source]);
        assert!(page.passed, "{kind}: {}", page.page);
        let (seen, solved) = (page.found("camera light"), page.found("camera solves"));
        assert!(seen.starts_with(light), "{kind}: {seen}");
        assert!(solved.starts_with(solves), "{kind}: {solved}");
    }
}

#[test]
fn a_region_of_the_sensor_will_do_and_one_that_reaches_over_it_fails() {
    let folder = folder();
    let page = Page::of(&folder, "[camera]\nregion_px = \"100,50,640,480\"\n", &[]);
    assert!(page.failures().is_empty(), "{}", page.page);
    let outside = Page::of(&folder, "[camera]\nregion_px = \"1200,50,640,480\"\n", &[]);
    assert_eq!(outside.failures(), ["camera"]);
    assert!(
        outside.found("camera").contains("camera.region_px"),
        "{}",
        outside.page
    );
}

#[test]
fn a_port_that_is_not_there_fails_and_is_named() {
    let folder = folder();
    let page = Page::of(&folder, "", &["--serial", "/nowhere/tty"]);
    assert_eq!(page.failures(), ["link"]);
    assert!(page.found("link").contains("/nowhere/tty"));
}

/// The page of a preflight on a serial line where another thread sends these bytes repeatedly.
fn page_of_a_line(bytes: &[u8], wait: &str) -> Page {
    let (mut near, far) = SerialPort::pair().unwrap();
    let over = AtomicBool::new(false);
    let folder = folder();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !over.load(Ordering::Relaxed) {
                let _ = near.write(bytes, Duration::from_millis(50));
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        let options = ["--serial", far.name(), wait];
        let page = std::panic::catch_unwind(|| Page::of(&folder, "", &options));
        over.store(true, Ordering::Relaxed);
        page.unwrap()
    })
}

#[test]
fn a_controller_that_speaks_is_heard_and_silence_is_a_warning() {
    let tracking_on = [0x9a, 0xc3, 0x30, 0x02, 0x07, 0x00, 0x00, 0x32, 0x00, 0x10];
    for (bytes, wait, expected) in [
        (&tracking_on[..], "", "the controller speaks"),
        (&[][..], "=1s", "nothing heard in 1 s"),
        (&[0x55; 64][..], "=1s", "and no packet in them"),
    ] {
        let page = page_of_a_line(bytes, &format!("--wait-controller{wait}"));
        let found = page.found("link");
        assert!(found.contains(expected), "{found}");
        assert!(page.passed);
    }
}

#[test]
fn a_clock_is_judged_by_what_the_kernel_says_and_by_whether_frames_depend_on_it() {
    let now: Timestamp = "2026-06-01T12:00:00Z".parse().unwrap();
    let held = ClockStatus {
        synchronised: true,
        offset_us: 3.0,
        max_error_us: 2000.0,
        source: Some("chrony"),
    };
    let free = ClockStatus {
        synchronised: false,
        ..held
    };
    let verdict = |status, limit_ms, times_frames| {
        judge_clock(Ok(status), now, limit_ms, times_frames)[0].verdict
    };
    assert_eq!(verdict(held, 100.0, true), Verdict::Pass);
    assert_eq!(
        verdict(held, 1.0, true),
        Verdict::Fail,
        "2 ms of error are too much"
    );
    assert_eq!(verdict(held, 1.0, false), Verdict::Warn);
    assert_eq!(verdict(free, 100.0, true), Verdict::Fail);
    assert_eq!(verdict(free, 100.0, false), Verdict::Warn);
    let silent = judge_clock(Err("not permitted".into()), now, 100.0, true);
    assert_eq!(silent[0].verdict, Verdict::Warn);
    let reset: Timestamp = "1970-01-01T00:02:00Z".parse().unwrap();
    let unset = judge_clock(Ok(held), reset, 100.0, false);
    assert_eq!(unset[1].verdict, Verdict::Fail);
    assert!(unset[1].found.contains("1970-01-01"), "{:?}", unset[1]);
}

/// The demo instrument with today as the date of its measurements.
fn instrument_of_today(folder: &Path) -> String {
    let today = Offset::UTC.to_datetime(Timestamp::now()).date();
    let file = folder.join("instrument.toml");
    fs::write(
        &file,
        DEMO.replace("date = 2013-09-21", &format!("date = {today}")),
    )
    .unwrap();
    file.to_str().unwrap().to_owned()
}

#[test]
fn a_calibration_out_of_date_is_a_warning_with_its_date() {
    let folder = folder();
    let old = Page::of(&folder, "", &[]);
    let found = old.found("camera calibration");
    assert!(
        found.starts_with("warn") && found.contains("2013-09-21"),
        "{found}"
    );
    let new = Page::of(
        &folder,
        "",
        &["--instrument", &instrument_of_today(folder.path())],
    );
    let found = new.found("camera calibration");
    assert!(found.starts_with("pass"), "{found}");
}

#[test]
fn a_table_of_the_earths_orientation_that_has_ended_is_warned_of() {
    let folder = folder();
    let table = folder.path().join("orientation.csv");
    let rows = "mjd_utc,tai_utc_s,x_arcsec,y_arcsec,ut1_utc_s\n55000,34,0,0,0\n56000,34,0,0,0\n";
    fs::write(&table, rows).unwrap();
    let page = Page::of(
        &folder,
        &format!("[sky]\nearth_orientation = {table:?}\n"),
        &[],
    );
    assert_eq!(page.failures(), [] as [&str; 0]);
    let found = page.found("Earth orientation");
    assert!(
        found.starts_with("warn") && found.contains("ends on 2012-03-14"),
        "{found}"
    );
}

#[test]
fn beside_a_wrong_configuration_clock_disks_and_line_are_checked() {
    let folder = folder();
    let config = "[camera]\nrate_hertz = 4\n[lnk]\n[link]\nport = \"/nowhere/tty\"\n";
    let page = Page::of(&folder, config, &[]);
    assert!(!page.passed);
    assert_eq!(page.failures(), ["configuration", "configuration", "link"]);
    assert!(!page.found("clock").is_empty());
    let disk = page.found(&format!("disk {}", folder.path().join("archive").display()));
    assert!(disk.contains("GB free"), "{disk}");
    assert!(page.found("camera").is_empty());
}

#[test]
fn a_port_of_an_unknown_scheme_is_refused_by_check_preflight_and_flight() {
    let folder = folder();
    let file = folder.path().join("c.toml");
    for (key, port) in [
        ("link]\nport", "tcp:10.0.0.1:2000"),
        ("link]\nport", "mavlink:/dev/ttyUSB0"),
        ("navigation]\nimu_port", "tcp://10.0.0.1:3000"),
        ("navigation]\ngps_port", "gpsd:2947"),
        ("roll_camera]\nsource", "gige://192.168.1.20"),
        ("second_camera]\nsource", "rtsp:10.0.0.1"),
    ] {
        let text = format!("[camera]\nsource = \"simulated\"\n[{key} = \"{port}\"\n");
        fs::write(&file, text).unwrap();
        let file = file.to_str().unwrap();
        for command in [
            &["config", "check", file][..],
            &["preflight", "--config", file],
            &["fly", "--config", file, "--duration", "1s"],
        ] {
            let output = solaspect(command, "");
            let said = [output.stdout, output.stderr].concat();
            let said = String::from_utf8(said).unwrap();
            assert_eq!(output.status.code(), Some(1), "{command:?} {said}");
            let key = key.replace("]\n", ".");
            assert!(
                said.contains(&format!("{key}: expected ")) && said.contains(port),
                "{command:?} {said}"
            );
        }
    }
}

#[cfg(not(feature = "gige"))]
#[test]
fn a_camera_that_the_program_was_not_built_for_says_which_program_to_take() {
    let folder = folder();
    for source in ["gige:10.0.0.7", "genicam:Maker-7"] {
        let text =
            format!("[camera]\nsource = \"{source}\"\ninstrument = \"calibration/demo.toml\"\n");
        let page = Page::of(&folder, &text, &[]);
        // The clock may fail, too: the times of a real camera's frames would come from it.
        assert_eq!(page.failures()[0], "configuration");
        assert!(page.remedy("configuration").contains("--features gige"));
    }
}

/// A flight whose telescope moves steadily up and to the right (`way` 1), or down and to the left (-1).
fn flight(folder: &Path, way: f64) -> String {
    let (utc, place) = ("2013-09-21T18:00:00Z", "34.49,-104.2218,38405");
    let sun = Ephemeris::default()
        .sun(utc.parse().unwrap(), place.parse().unwrap())
        .unwrap();
    let demo = instrument::builtin("demo").unwrap();
    let on_plate = |angle_deg: f64| {
        let pointing = Horizontal {
            azimuth_deg: sun.azimuth_deg + angle_deg / sun.elevation_deg.to_radians().cos(),
            elevation_deg: sun.elevation_deg + angle_deg,
        };
        pointing::sun_on_plate(pointing, Roll::Stated, &demo, &sun).unwrap()
    };
    // From one end to the other in 10 s.
    let (start, end) = (on_plate(-0.4 * way), on_plate(0.4 * way));
    let file = folder.join("path.toml");
    let text = format!(
        "[[piece]]\nstart_s = 0\nsun_mil = [{}, {}]\nslew_mil_per_s = [{}, {}]\n",
        start.x,
        start.y,
        (end.x - start.x) / 10.0,
        (end.y - start.y) / 10.0
    );
    fs::write(&file, text).unwrap();
    format!("simulated:{}", file.display())
}

/// A table of the Earth's orientation valid on any day, so that offsets are always available.
fn any_day(folder: &Path) -> String {
    let mjd = |date: Date| (date - Date::constant(1858, 11, 17)).get_days();
    let [first, last] = [Date::constant(1973, 1, 2), Date::constant(2099, 1, 1)].map(mjd);
    let table = folder.join("orientation.csv");
    let rows = format!(
        "mjd_utc,tai_utc_s,x_arcsec,y_arcsec,ut1_utc_s\n{first},37,0,0,0\n{last},37,0,0,0\n"
    );
    fs::write(&table, rows).unwrap();
    format!("[sky]\nearth_orientation = {table:?}\n")
}

#[test]
fn offsets_that_grow_as_the_telescope_is_slewed_pass_and_others_fail() {
    let axes = ["polarity of elevation", "polarity of azimuth"];
    for (way, verdict) in [(1.0, "pass: "), (-1.0, "fail: ")] {
        let folder = folder();
        let source = flight(folder.path(), way);
        let options = ["--camera", &source, "--polarity", "--answers"];
        let page = Page::with_answers(&folder, "", &options, "\n\n");
        for axis in axes {
            let found = page.found(axis);
            assert!(found.starts_with(verdict), "{way}: {axis}: {found}");
        }
        assert_eq!(page.passed, way > 0.0);
    }
}

#[test]
fn a_slew_that_nobody_makes_is_not_tested_and_never_waited_for() {
    let folder = folder();
    let options = ["--polarity", "--answers"];
    let page = Page::with_answers(&folder, "", &options, "skip\n");
    assert!(
        page.found("polarity of elevation")
            .starts_with("warn: not tested")
    );
    let end_of_answers = page.found("polarity of azimuth");
    assert!(
        end_of_answers.starts_with("warn: not tested"),
        "{end_of_answers}"
    );
}

#[test]
fn the_polarity_test_asks_nobody_where_there_is_no_terminal() {
    let output = solaspect(&["preflight", "--polarity"], "");
    assert_eq!(output.status.code(), Some(1));
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(error.contains("--answers"), "{error}");
}

#[test]
fn a_motion_is_one_beyond_the_noise_in_three_frames_running() {
    let watch = |offsets: &[f64], sigma| {
        let mut trend = Trend::default();
        offsets.iter().find_map(|offset| trend.push(*offset, sigma))
    };
    assert_eq!(watch(&[0.0, 0.06, 0.07, 0.08], 0.001), Some(Motion::Grew));
    assert_eq!(watch(&[1.0, 0.9, 0.9, 0.9], 0.001), Some(Motion::Fell));
    assert_eq!(
        watch(&[0.0, 0.06, 0.0, 0.06, 0.06], 0.001),
        None,
        "single frames"
    );
    assert_eq!(
        watch(&[0.0, 0.06, -0.06, 0.06, 0.06], 0.001),
        None,
        "oscillation"
    );
    assert_eq!(
        watch(&[0.0, 0.06, 0.07, 0.08], 0.02),
        None,
        "within the noise"
    );
    assert_eq!(watch(&[0.0, 0.04, 0.04, 0.04], 0.001), None, "too little");
}

#[test]
fn a_configuration_is_checked_with_all_its_errors_at_once() {
    let folder = folder();
    let file = folder.path().join("bad.toml");
    let text = "[camera]\nsource = \"simulated\"\nexposure_us = 400000\ninstrument = \"/nowhere/i.toml\"\nauto_exposure = \"on\"\n\
                auto_exposure_min_us = 500\nauto_exposure_max_us = 300\n\
                [second_camera]\nsource = \"folder:/nowhere\"\n\
                [roll_camera]\nsource = \"simulated:/nowhere/p.toml\"\nrate_hertz = 3\n\
                [archive]\nwarn_free_percent = 1\n[link]\nport = \"udp:x\"\nsaved_values = \"/nowhere/v.toml\"\n\
                [sky]\nearth_orientation = \"/nowhere/o.csv\"\n";
    fs::write(&file, text).unwrap();
    let output = solaspect(&["config", "check", file.to_str().unwrap()], "");
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8(output.stdout).unwrap();
    let own = format!("error: {}: ", file.display());
    for expected in [
        format!("{own}roll_camera.rate_hertz: expected a known key"),
        format!("{own}camera.exposure_us: expected less than the 250000 us"),
        format!(
            "{own}camera.auto_exposure_min_us: expected less than auto_exposure_max_us, 300, found 500"
        ),
        format!("{own}archive.thin_free_percent: expected at most warn_free_percent, 1, found 3"),
        format!("{own}link.port: expected a serial device"),
        format!("{own}link.saved_values: expected a file in a folder that is there"),
        format!("{own}second_camera.source: expected a folder of frames"),
        format!("{own}sky.earth_orientation: expected a table"),
        "error: /nowhere/i.toml: expected a file, or a built-in instrument".into(),
        "error: /nowhere/p.toml: expected a readable file".into(),
        format!("warning: {}: site: ", file.display()),
    ] {
        let lines = said.lines().filter(|line| line.starts_with(&expected));
        assert_eq!(lines.count(), 1, "{expected} in\n{said}");
    }
}

#[test]
fn two_cameras_with_one_source_are_an_error_if_the_source_is_a_device() {
    let folder = folder();
    let file = folder.path().join("twice.toml");
    for (source, severity) in [
        ("gige:10.0.0.7", "error"),
        ("genicam:Maker-7", "error"),
        ("simulated", "warning"),
    ] {
        let table = |name: &str| format!("[{name}]\nsource = \"{source}\"\n");
        fs::write(&file, table("camera") + &table("second_camera")).unwrap();
        let output = solaspect(&["config", "check", "--json", file.to_str().unwrap()], "");
        let said: Value = serde_json::from_slice(&output.stdout).unwrap();
        let remarks = said["remarks"].as_array().unwrap();
        let expected = "another source than that of camera";
        let remark = remarks
            .iter()
            .find(|remark| remark["expected"] == expected)
            .unwrap();
        assert_eq!(remark["severity"], severity);
        assert_eq!(remark["key"], "second_camera.source");
    }
}

#[test]
fn a_configuration_without_errors_is_ok_and_says_what_would_fly() {
    let folder = folder();
    let file = folder.path().join("good.toml");
    fs::write(&file, SIMULATED).unwrap();
    let output = solaspect(&["config", "check", file.to_str().unwrap()], "");
    let said = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(
        said.contains("\nok: this would fly\n  camera: simulated at 4 Hz"),
        "{said}"
    );
    assert!(said.contains("instrument \"demo\""), "{said}");
}

#[test]
fn a_configuration_that_names_no_camera_flies_nothing() {
    let example = ["--config", "docs/solaspect.example.toml"];
    let check = solaspect(&["config", "check", example[1]], "");
    assert_eq!(check.status.code(), Some(1));
    let said = String::from_utf8(check.stdout).unwrap();
    assert!(
        said.contains("error: docs/solaspect.example.toml: camera.source: expected a camera"),
        "{said}"
    );
    for command in [vec!["fly", "--duration", "1s"], vec!["preflight"]] {
        let output = solaspect(&[&command[..], &example].concat(), "");
        assert_eq!(output.status.code(), Some(1));
        let said = [output.stdout, output.stderr].concat();
        let said = String::from_utf8(said).unwrap();
        assert!(said.contains("camera.source: expected a camera"), "{said}");
    }
    let real = ["fly", "--camera", "gige:10.0.0.7", "--duration", "1s"];
    let output = solaspect(&real, "");
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(
        said.contains("camera.instrument: expected the instrument's file"),
        "{said}"
    );
}

#[test]
fn a_configuration_that_cannot_be_read_is_an_error() {
    let output = solaspect(&["config", "check", "/nowhere/flight.toml"], "");
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(
        said.starts_with("error: /nowhere/flight.toml: expected a readable"),
        "{said}"
    );
}
