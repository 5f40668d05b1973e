//! Refinement of the roll camera's frames: roll and pitch with calibrated uncertainties, the offsets corrected for them,
//! flagged frames with pictures.

use crate::common::refined::{Columns, command, refine, rms, temporary};
use jiff::{SignedDuration, Timestamp};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use solaspect::archive::Store;
use solaspect::fits::Compression;
use solaspect::frame::{Frame, Pixels};
use solaspect::instrument::{DEMO_HORIZON, MountedCamera, builtin};
use solaspect::simulate::earth::SwingingGondola;
use solaspect::simulate::{Conditions, FORT_SUMNER, RandomScenes};
use solaspect::units::Place;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

const RATE_HZ: f64 = 4.0;
const START: &str = "2013-09-21T18:00:00Z";

fn utc(time_s: f64) -> Timestamp {
    let start: Timestamp = START.parse().unwrap();
    start + SignedDuration::from_secs_f64(time_s)
}

/// A flight with its own simulated limb.
struct Swinging {
    gondola: SwingingGondola,
    /// Time of the first frame since the gondola began to swing.
    begins_s: f64,
}

impl Swinging {
    fn new(seed: u64) -> Self {
        let camera = MountedCamera::parse(Path::new("demo-horizon"), DEMO_HORIZON).unwrap();
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        Self {
            gondola: SwingingGondola::new(&camera, &FORT_SUMNER, seed),
            begins_s: random.random_range(0.0..100.0),
        }
    }

    fn since_start(&self, time_s: f64) -> Duration {
        Duration::from_secs_f64(self.begins_s + time_s)
    }

    fn frame(&self, number: u64, time_s: f64) -> Frame {
        let scene = self.gondola.scene(number, self.since_start(time_s), 1.0);
        let mut frame = scene.frame().unwrap();
        frame.info.mid_exposure = Some(utc(time_s));
        frame.info.monotonic = Some(self.since_start(time_s));
        frame
    }

    fn roll_deg(&self, time_s: f64) -> f64 {
        self.gondola.roll_deg(self.since_start(time_s))
    }
}

fn roll_store(folder: &Path) -> Store {
    Store::open(&folder.join("roll"), "roll", Compression::Rice).unwrap()
}

fn camera_file(folder: &Path) -> PathBuf {
    let path = folder.join("cam.toml");
    fs::write(&path, DEMO_HORIZON).unwrap();
    path
}

/// Rms of roll error over sigma, and of the error (deg), over one flight's frames: of single frames, and smoothed.
fn errors_of_flight(seed: u64, frames: u64) -> [[f64; 2]; 2] {
    let folder = temporary();
    let flight = Swinging::new(seed);
    let store = roll_store(folder.path());
    for n in 0..frames {
        let frame = flight.frame(n, n as f64 / RATE_HZ);
        store.write(&frame, &[], &[]).unwrap();
    }
    let out = temporary();
    let camera = camera_file(folder.path());
    refine(
        folder.path(),
        out.path(),
        &["--roll-camera", camera.to_str().unwrap()],
    );
    let rows = Columns::of(&out.path().join("roll.fits"), "ROLL");
    let times = rows.floats("MONO_S");
    let errors = |value: &str, sigma: &str| {
        let all = rows.floats(value).iter().zip(rows.floats(sigma)).zip(times);
        let errors: Vec<[f64; 2]> = all
            .map(|((value, sigma), time_s)| {
                let error = value - flight.roll_deg(time_s - flight.begins_s);
                [error / sigma, error]
            })
            .collect();
        [0, 1].map(|n| rms(&errors.iter().map(|e| e[n]).collect::<Vec<_>>()))
    };
    [
        errors("ROLL_DEG", "ROLL_SIGMA_DEG"),
        errors("SMOOTHED_ROLL_DEG", "SMOOTHED_ROLL_SIGMA_DEG"),
    ]
}

#[test]
fn frames_of_a_mirroring_flight_count_once() {
    let [folder, camera_folder, out] = [(); 3].map(|()| temporary());
    let flight = Swinging::new(3);
    let [one, two] = ["one", "two"].map(|disk| folder.path().join(disk));
    let store = roll_store(&one);
    for n in 0..40 {
        store
            .write(&flight.frame(n, n as f64 / RATE_HZ), &[], &[])
            .unwrap();
    }
    let camera = camera_file(camera_folder.path());
    let summary = || -> serde_json::Value {
        refine(
            folder.path(),
            out.path(),
            &["--roll-camera", camera.to_str().unwrap()],
        );
        serde_json::from_slice(&fs::read(out.path().join("roll.json")).unwrap()).unwrap()
    };
    let alone = summary();
    copy_tree(&one, &two);
    let mirrored = summary();
    assert_eq!(
        (&mirrored["files"], &mirrored["copies"]),
        (&80.into(), &40.into())
    );
    for same in [
        "fine",
        "frame_sigma_deg",
        "smoothed_sigma_deg",
        "changing_part",
    ] {
        assert_eq!(mirrored[same], alone[same], "{same}");
    }
}

fn copy_tree(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let copy = to.join(path.file_name().unwrap());
        match path.is_dir() {
            true => copy_tree(&path, &copy),
            false => drop(fs::copy(path, copy).unwrap()),
        }
    }
}

fn hold_many_flights(flights: u64, frames: u64) {
    let all: Vec<[[f64; 2]; 2]> = (0..flights)
        .into_par_iter()
        .map(|seed| errors_of_flight(seed, frames))
        .collect();
    for (n, name) in ["by itself", "smoothed"].iter().enumerate() {
        let [ratio, rms_deg] =
            [0, 1].map(|m| rms(&all.iter().map(|flight| flight[n][m]).collect::<Vec<_>>()));
        println!(
            "{flights} flights of {frames} frames, {name}: {rms_deg:.4} deg rms, error/sigma {ratio:.2}"
        );
        assert!(rms_deg < 0.04, "{name} {rms_deg}");
        assert!((0.8..1.25).contains(&ratio), "{name} {ratio}");
    }
}

#[test]
fn roll_of_simulated_flights_is_as_good_as_it_says() {
    hold_many_flights(24, 24);
}

/// `cargo test --test promises -- --ignored roll_of_two_hundred --nocapture`
#[test]
#[ignore = "minutes of rendering"]
fn roll_of_two_hundred_flights_is_as_good_as_it_says() {
    hold_many_flights(200, 40);
}

#[test]
fn offsets_are_turned_by_the_smoothed_roll_and_flagged_frames_are_shown() {
    let folder = temporary();
    let flight = Swinging::new(3);
    let store = roll_store(folder.path());
    for n in 0..20 {
        let time_s = n as f64 / RATE_HZ;
        let mut frame = flight.frame(n, time_s);
        if n == 7 {
            let white = Pixels::U8(vec![255; frame.width() * frame.height()]);
            let info = frame.info.clone();
            frame = Frame::new(frame.width(), frame.height(), white, 255, info).unwrap();
        }
        store.write(&frame, &[], &[]).unwrap();
    }
    let demo = builtin("demo").unwrap();
    let suns = Store::open(&folder.path().join("suns"), "demo", Compression::Rice).unwrap();
    let scenes = RandomScenes::new(&demo, &Conditions::of(&demo), 5).unwrap();
    // The last time is far from any frame of the horizon.
    let times = [0.6, 1.1, 1.9, 3.3, 20.0];
    for (n, time_s) in times.iter().enumerate() {
        let mut frame = scenes.scene(n as u64).unwrap().frame().unwrap();
        frame.info.mid_exposure = Some(utc(*time_s));
        frame.info.place = Some(Place { ..FORT_SUMNER });
        suns.write(&frame, &[], &[]).unwrap();
    }
    let out = temporary();
    let camera = camera_file(folder.path());
    let output = refine(
        folder.path(),
        out.path(),
        &["--roll-camera", camera.to_str().unwrap()],
    );
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        said.contains("roll camera: 20 files: 19 fine, 0 coarse, 1 none"),
        "{said}"
    );
    assert!(
        said.contains("1 not fine: light: the frame is bright all over"),
        "{said}"
    );
    let rows = Columns::read(out.path(), "ASPECT");
    let columns = [
        "BODY_ROLL_DEG",
        "BODY_ROLL_SIGMA_DEG",
        "TELESCOPE_ROLL_DEG",
        "POINTING_EL_DEG",
    ];
    let [body, sigma, telescope, elevation] = columns.map(|name| rows.floats(name));
    for (n, time_s) in times.iter().take(4).enumerate() {
        let error = body[n] - flight.roll_deg(*time_s);
        assert!(error.abs() < 3.0 * sigma[n], "{n}: {error} {}", sigma[n]);
        // The dip of the body's second axis gives the roll of a telescope tilted up; the pitch of 0.3 deg is neglected.
        let dips = body[n].to_radians().sin() / elevation[n].to_radians().cos();
        let expected = dips.asin().to_degrees();
        assert!(
            (telescope[n] - expected).abs() < 1e-3,
            "{n}: {} {expected}",
            telescope[n]
        );
    }
    assert!(body[4].is_nan() && telescope[4] == demo.mounting.roll_deg.value);
    let page = fs::read_to_string(out.path().join("report.html")).unwrap();
    assert!(
        page.contains("Roll and pitch of the body")
            && page.contains("light: the frame is bright all over")
    );
    let pictures = page.matches("<img").count();
    let without = temporary();
    let output = command(folder.path(), without.path(), &[])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        said.contains("20 frames of the roll camera: its file is not in the archive"),
        "{said}"
    );
    let page = fs::read_to_string(without.path().join("report.html")).unwrap();
    assert_eq!(pictures, page.matches("<img").count() + 1);
}

#[test]
fn parts_merge_to_the_same_bytes_though_some_hold_no_frame_of_the_horizon() {
    let folder = temporary();
    let flight = Swinging::new(9);
    let store = roll_store(folder.path());
    for n in 0..3 {
        let frame = flight.frame(n, n as f64 / RATE_HZ);
        store.write(&frame, &[], &[]).unwrap();
    }
    let camera = camera_file(folder.path());
    let camera = ["--roll-camera", camera.to_str().unwrap()];
    let [whole, merged] = [temporary(), temporary()];
    refine(folder.path(), whole.path(), &camera);
    let parts: Vec<_> = (1..=4).map(|_| temporary()).collect();
    let mut merge = vec!["--merge"];
    for (part, out) in (1..).zip(&parts) {
        let shard = format!("{part}/4");
        let more = [&camera[..], &["--shard", &shard]].concat();
        // The last shard has no frame at all.
        refine(folder.path(), out.path(), &more);
        merge.push(out.path().to_str().unwrap());
    }
    refine(
        folder.path(),
        merged.path(),
        &[&camera[..], &merge].concat(),
    );
    for name in ["roll.fits", "roll.csv", "roll.json"] {
        let [a, b] = [&whole, &merged].map(|out| fs::read(out.path().join(name)).unwrap());
        assert!(a == b, "{name}");
    }
}
