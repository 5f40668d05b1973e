//! A refined history is nowhere worse than its frames, whatever the gondola, its clock and its cameras do; and frames of
//! another camera are never mistaken for its own.

use crate::common::refined::{Columns, command, refine, rms, summary, temporary};
use jiff::{SignedDuration, Timestamp};
use nalgebra::{Matrix2, Vector2};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use solaspect::fits::{self, Card, Compression, Values, keyword};
use solaspect::instrument::{self, Instrument};
use solaspect::pointing::{self, HelioprojectiveArcsec, Roll};
use solaspect::simulate::{
    Course, FORT_SUMNER, FlightScenes, Pieces, SUN_RADIUS_ARCSEC, Trajectory,
};
use solaspect::sky::Ephemeris;
use solaspect::units::{Estimate, PlateMil};
use std::fs;
use std::ops::Range;
use std::path::Path;
use std::time::Duration;

const RATE_HZ: f64 = 4.0;

/// A flight at four frames per second with a known path of the Sun.
struct Flight {
    scenes: FlightScenes,
    frames: usize,
    /// Ranges of frames, and the amount by which their UTC is ahead.
    clock_steps: Vec<(Range<usize>, SignedDuration)>,
    cards: Vec<Card>,
}

impl Flight {
    fn new(course: impl Fn(&Instrument, f64) -> Course, frames: usize, seed: u64) -> Self {
        let instrument = instrument::builtin("demo").unwrap();
        let radius_mil = instrument.optics.radius_mil(SUN_RADIUS_ARCSEC);
        let course = course(&instrument, radius_mil);
        let scenes = FlightScenes::new(&instrument, course, radius_mil, seed).unwrap();
        Self {
            scenes,
            frames,
            clock_steps: Vec::new(),
            cards: Vec::new(),
        }
    }

    /// A flight along the pieces of a path file.
    fn of_pieces(pieces: &str, frames: usize, seed: u64) -> Self {
        let pieces = Pieces::parse(Path::new("flight.toml"), pieces).unwrap();
        Self::new(|_, _| pieces.clone().into(), frames, seed)
    }

    fn since_start(n: usize) -> Duration {
        Duration::from_secs_f64(n as f64 / RATE_HZ)
    }

    fn sun(&self, n: usize) -> PlateMil {
        let scene = self.scenes.scene(n as u64, Self::since_start(n)).unwrap();
        scene.sun.unwrap().centre
    }

    fn write(&self, folder: &Path) {
        use rayon::prelude::*;
        fs::create_dir_all(folder).unwrap();
        let start: Timestamp = "2013-09-21T18:00:00Z".parse().unwrap();
        (0..self.frames).into_par_iter().for_each(|n| {
            let since = Self::since_start(n);
            let mut scene = self.scenes.scene(n as u64, since).unwrap();
            let steps = self.clock_steps.iter();
            let stepped = steps.filter(|(frames, _)| frames.contains(&n));
            let ahead: SignedDuration = stepped.map(|(_, ahead)| *ahead).sum();
            let utc = start + SignedDuration::try_from(since).unwrap() + ahead;
            scene.info.mid_exposure = Some(utc);
            scene.info.monotonic = Some(Duration::from_secs(5000) + since);
            scene.info.place = Some(FORT_SUMNER);
            let path = folder.join(format!("frame_{n:05}.fits"));
            let frame = scene.frame().unwrap();
            fits::write_frame(&path, &frame, &self.cards, &[], Compression::Rice).unwrap();
        });
    }

    /// Errors of a table's positions at frames, in segments of `SEGMENT` frames; `frame_of` returns the frame of a row.
    fn errors(&self, table: &Columns, frame_of: impl Fn(usize) -> Option<usize>) -> Vec<Errors> {
        let segments = self.frames.div_ceil(SEGMENT);
        let mut errors: Vec<Errors> = (0..segments).map(|_| Errors::default()).collect();
        let [x, y] = ["SUN_X_MIL", "SUN_Y_MIL"].map(|name| table.floats(name));
        let [sx, sy] = ["SIGMA_X_MIL", "SIGMA_Y_MIL"].map(|name| table.floats(name));
        for row in (0..x.len()).filter(|row| x[*row].is_finite()) {
            let Some(n) = frame_of(row) else { continue };
            let truth = self.sun(n);
            let (dx, dy) = (x[row] - truth.x, y[row] - truth.y);
            let segment = &mut errors[n / SEGMENT];
            segment.mil.extend([dx, dy]);
            segment.ratios.extend([dx / sx[row], dy / sy[row]]);
        }
        errors
    }
}

/// Number of frames in a segment.
const SEGMENT: usize = 40;

#[derive(Default)]
struct Errors {
    mil: Vec<f64>,
    ratios: Vec<f64>,
}

impl Errors {
    fn largest_ratio(&self) -> f64 {
        self.ratios
            .iter()
            .fold(0.0, |most, ratio| ratio.abs().max(most))
    }
}

/// Errors of the table's fine rows, and of the smoothed path at the same frames.
fn judged(flight: &Flight, out: &Path) -> (Vec<Errors>, Vec<Errors>) {
    let table = Columns::read(out, "ASPECT");
    let number = |row: usize| {
        let file = &table.texts("FILE")[row];
        file[file.len() - 10..file.len() - 5]
            .parse::<usize>()
            .unwrap()
    };
    let fine = |row: usize| (table.texts("QUALITY")[row] == "fine").then(|| number(row));
    let times = table.floats("UNIX_S");
    let smoothed = Columns::read(out, "SMOOTHED");
    let path_times = smoothed.floats("UNIX_S");
    let at_frame = |row: usize| {
        let same = |n: &usize| (times[*n] - path_times[row]).abs() < 1e-4;
        (0..times.len()).find(same).and_then(fine)
    };
    (
        flight.errors(&table, fine),
        flight.errors(&smoothed, at_frame),
    )
}

/// Asserts that no fine frame lacks a smoothed position, and that the smoothed path has calibrated sigmas and no larger rms error than the frames.
fn assert_history(name: &str, flight: &Flight, out: &Path) {
    let (frames, smoothed) = judged(flight, out);
    let all = |errors: &[Errors], of: fn(&Errors) -> &Vec<f64>| -> Vec<f64> {
        errors
            .iter()
            .flat_map(|errors| of(errors).clone())
            .collect()
    };
    let (own_mil, mil) = (all(&frames, |e| &e.mil), all(&smoothed, |e| &e.mil));
    let ratio = rms(&all(&smoothed, |e| &e.ratios));
    println!(
        "{name}: {} fine, rms of frames {:.4} mil, error/sigma {:.3}; smoothed {:.4} mil, error/sigma {ratio:.3}; by segment {:?}",
        own_mil.len() / 2,
        rms(&own_mil),
        rms(&all(&frames, |e| &e.ratios)),
        rms(&mil),
        smoothed
            .iter()
            .map(|e| (rms(&e.ratios) * 100.0).round() / 100.0)
            .collect::<Vec<_>>(),
    );
    assert_eq!(own_mil.len(), mil.len(), "{name}");
    assert!((0.8..1.25).contains(&ratio), "{name}: {ratio}");
    assert!(rms(&mil) <= rms(&own_mil), "{name}");
    for errors in frames.iter().chain(&smoothed) {
        assert!(errors.largest_ratio() < 6.0, "{name}");
    }
}

/// A quarter of an hour at four frames per second with rests, swings, slews and steps, or SOLASPECT_FLIGHT_FRAMES frames:
/// `cargo test --test promises -- --ignored a_quarter --nocapture`.
#[test]
#[ignore = "a quarter of an hour of flight takes minutes to simulate"]
fn a_quarter_of_an_hour_is_nowhere_worse_than_its_frames() {
    let frames = std::env::var("SOLASPECT_FLIGHT_FRAMES");
    let frames = frames.map_or(3600, |frames| frames.parse().unwrap());
    let swaying = |instrument: &Instrument, radius_mil| {
        let trajectory = Trajectory::flight(instrument, radius_mil, 21);
        trajectory.unwrap().into()
    };
    for (name, flight) in [
        ("swaying", Flight::new(swaying, frames, 21)),
        (
            "pieces",
            Flight::of_pieces(&random_pieces(frames, 22), frames, 22),
        ),
    ] {
        let (archive, out) = (temporary(), temporary());
        flight.write(archive.path());
        refine(archive.path(), out.path(), &[]);
        assert_history(name, &flight, out.path());
        let (own, smoothed) = judged(&flight, out.path());
        for segment in own
            .chunks(200 / SEGMENT)
            .zip(smoothed.chunks(200 / SEGMENT))
        {
            let all = |errors: &[Errors], of: fn(&Errors) -> &Vec<f64>| -> Vec<f64> {
                errors
                    .iter()
                    .flat_map(|errors| of(errors).clone())
                    .collect()
            };
            let (own_mil, mil) = (all(segment.0, |e| &e.mil), all(segment.1, |e| &e.mil));
            let ratio = rms(&all(segment.1, |e| &e.ratios));
            println!(
                "  {} frames: {:.4}, smoothed {:.4} mil, error/sigma {ratio:.3}",
                mil.len() / 2,
                rms(&own_mil),
                rms(&mil)
            );
            if mil.len() >= 400 {
                assert!(rms(&mil) <= rms(&own_mil), "{name}");
                assert!((0.8..1.25).contains(&ratio), "{name}");
            }
        }
    }
}

/// Pieces of a path: rests, slews and steps of 1 to 10 s each.
fn random_pieces(frames: usize, seed: u64) -> String {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let (mut text, mut start_s, mut at) = (String::new(), 0.0, [0.0_f64; 2]);
    while start_s < frames as f64 / RATE_HZ {
        let length_s: f64 = rng.random_range(1.0..10.0);
        let to: [f64; 2] = std::array::from_fn(|_| rng.random_range(-900.0..900.0));
        let speed = match rng.random_range(0..3) {
            0 => [0.0; 2],
            1 => {
                at = to;
                [0.0; 2]
            }
            _ => {
                let way = [to[0] - at[0], to[1] - at[1]];
                let most = 500.0 / way[0].hypot(way[1]);
                way.map(|way| way * most.min(1.0 / length_s))
            }
        };
        text += &format!(
            "[[piece]]\nstart_s = {start_s}\nsun_mil = {at:?}\nslew_mil_per_s = {speed:?}\n"
        );
        at = [0, 1].map(|axis| at[axis] + speed[axis] * length_s);
        start_s += length_s;
    }
    text
}

const SLEWS: &str = "
    [[piece]]
    start_s = 0
    sun_mil = [300, -150]
    [[piece]]
    start_s = 10
    sun_mil = [300, -150]
    slew_mil_per_s = [-500, 100]
    [[piece]]
    start_s = 12
    sun_mil = [-700, 50]
    [[piece]]
    start_s = 20
    sun_mil = [-700, 50]
    slew_mil_per_s = [250, 0]
    [[piece]]
    start_s = 25
    sun_mil = [900, 100]
";

#[test]
fn a_slew_that_begins_at_once_loses_no_frame_and_leaves_the_path_right() {
    for seed in [11, 31] {
        let flight = Flight::of_pieces(SLEWS, 120, seed);
        let (archive, out) = (temporary(), temporary());
        flight.write(archive.path());
        refine(archive.path(), out.path(), &[]);
        assert_history("slews", &flight, out.path());
        let report = summary(out.path());
        assert_eq!(report["fine"], 120);
        assert!(
            report["flagged"].as_object().unwrap().is_empty(),
            "{report}"
        );
    }
}

/// Sweeps across the sensor's lower edge, of 15 px in an exposure, between rests.
const SWEEPS: &str = "
    [[piece]]
    start_s = 0
    sun_mil = [300, -150]
    [[piece]]
    start_s = 10
    sun_mil = [-2000, 2450]
    slew_mil_per_s = [5600, 0]
    [[piece]]
    start_s = 10.8
    sun_mil = [300, 150]
    [[piece]]
    start_s = 15
    sun_mil = [2000, 2500]
    slew_mil_per_s = [-5700, 100]
    [[piece]]
    start_s = 15.8
    sun_mil = [-200, 150]
    [[piece]]
    start_s = 20
    sun_mil = [-2000, 2550]
    slew_mil_per_s = [5500, 200]
    [[piece]]
    start_s = 20.8
    sun_mil = [200, -250]
";

#[test]
fn a_sun_that_moves_far_during_the_exposure_is_coarse_and_its_sigma_covers_the_error() {
    let mut moved = 0;
    for seed in [5, 6] {
        let flight = Flight::of_pieces(SWEEPS, 100, seed);
        let (archive, out) = (temporary(), temporary());
        flight.write(archive.path());
        refine(archive.path(), out.path(), &[]);
        let table = Columns::read(out.path(), "ASPECT");
        let value = |name, row: usize| table.floats(name)[row];
        for row in 0..flight.frames {
            let truth = flight.sun(row);
            let off = [
                (value("SUN_X_MIL", row) - truth.x) / value("SIGMA_X_MIL", row),
                (value("SUN_Y_MIL", row) - truth.y) / value("SIGMA_Y_MIL", row),
            ];
            let sweeps = truth.y > 2000.0;
            let quality = &table.texts("QUALITY")[row];
            println!("{row}: {quality}, off by {off:.2?} sigma");
            if off[0].is_finite() {
                moved += usize::from(sweeps);
                assert_eq!(quality == "fine", !sweeps, "{row}");
                assert!(off.iter().all(|off| off.abs() < 5.0), "{row}: {off:?}");
            }
        }
    }
    assert!(moved > 10, "{moved}");
}

#[test]
fn the_history_of_a_demo_is_nowhere_worse_than_its_frames() {
    for seed in [1, 2] {
        let demo = |instrument: &Instrument, radius_mil| {
            let whole = Duration::from_secs(20);
            let trajectory = Trajectory::demo(instrument, radius_mil, whole, seed);
            trajectory.unwrap().into()
        };
        let flight = Flight::new(demo, 80, seed);
        let (archive, out) = (temporary(), temporary());
        flight.write(archive.path());
        refine(archive.path(), out.path(), &[]);
        assert_history("demo", &flight, out.path());
        let report = summary(out.path());
        assert!(
            report["fine"].as_u64() >= report["own_fine"].as_u64(),
            "{report}"
        );
    }
}

#[test]
fn between_frames_the_offset_is_known_at_the_rate_that_is_asked_for() {
    const ROWS_HZ: f64 = 50.0;
    const FRAMES: usize = 140;
    // A gap of 12 s is too long to predict the gondola's motion.
    const GAP: Range<usize> = 60..108;
    let swaying = |instrument: &Instrument, radius_mil| {
        let trajectory = Trajectory::flight(instrument, radius_mil, 41);
        trajectory.unwrap().into()
    };
    let flight = Flight::new(swaying, FRAMES, 41);
    let (archive, out) = (temporary(), temporary());
    flight.write(archive.path());
    for n in GAP {
        fs::remove_file(archive.path().join(format!("frame_{n:05}.fits"))).unwrap();
    }
    let report = refine(archive.path(), out.path(), &["--rate", "50"]);
    let table = Columns::of(&out.path().join("stabilisation.fits"), "STABILISATION");
    let times = table.floats("UNIX_S");
    let rows = ((FRAMES - 1) as f64 / RATE_HZ * ROWS_HZ) as usize + 1;
    assert_eq!(times.len(), rows);
    let Values::Logical(valid) = table.values("VALID") else {
        panic!("VALID is of truth values");
    };
    let [across, up] = ["OFFSET_XEL_DEG", "OFFSET_EL_DEG"].map(|name| table.floats(name));
    let [xx, yy, xy] =
        ["VAR_XEL_DEG2", "VAR_EL_DEG2", "COV_XEL_EL_DEG2"].map(|name| table.floats(name));
    let instrument = instrument::builtin("demo").unwrap();
    let mut ephemeris = Ephemeris::default();
    let start: Timestamp = "2013-09-21T18:00:00Z".parse().unwrap();
    let mut chi2 = Vec::new();
    for row in 0..rows {
        let since_s = row as f64 / ROWS_HZ;
        assert!((times[row] - start.as_second() as f64 - since_s).abs() < 1e-6);
        let last_before = (GAP.start - 1) as f64 / RATE_HZ;
        let in_gap = last_before < since_s && since_s < GAP.end as f64 / RATE_HZ;
        assert_eq!(valid[row], !in_gap, "{since_s}");
        assert_eq!(across[row].is_nan(), in_gap, "{since_s}");
        if in_gap {
            continue;
        }
        let since = Duration::from_secs_f64(since_s);
        let scene = flight.scenes.scene(0, since).unwrap();
        let utc = start + SignedDuration::try_from(since).unwrap();
        let sun = ephemeris.sun(utc, FORT_SUMNER).unwrap();
        let truth = Estimate {
            position: scene.sun.unwrap().centre,
            covariance: Matrix2::zeros(),
        };
        let target = HelioprojectiveArcsec::default();
        let truth = pointing::offset(truth, Roll::Stated, &instrument, &sun, target).unwrap();
        let error = Vector2::new(
            across[row] - truth.cross_elevation_deg,
            up[row] - truth.elevation_deg,
        );
        let covariance = Matrix2::new(xx[row], xy[row], xy[row], yy[row]);
        chi2.push(error.dot(&(covariance.try_inverse().unwrap() * error)));
    }
    let honesty = (chi2.iter().sum::<f64>() / chi2.len() as f64 / 2.0).sqrt();
    let worst = chi2.iter().fold(0.0_f64, |most, chi2| most.max(*chi2));
    println!("error/sigma {honesty:.3}, largest chi^2 {worst:.1}");
    assert!((0.8..1.25).contains(&honesty), "{honesty}");
    assert!(worst < 36.0, "{worst}");
    let valid = chi2.len();
    let report = String::from_utf8_lossy(&report.stdout).into_owned();
    let line = format!("stabilisation: {rows} rows at 50 Hz, {valid} of them valid");
    assert!(report.contains(&line), "{report}");
    let csv = fs::read_to_string(out.path().join("stabilisation.csv")).unwrap();
    assert_eq!(csv.lines().count(), rows + 1);
}

#[test]
fn a_clock_that_steps_is_reported_and_its_times_are_corrected() {
    let mut flight = Flight::of_pieces(SLEWS, 120, 12);
    flight.clock_steps = vec![(60..74, SignedDuration::from_millis(-1300))];
    let (archive, out) = (temporary(), temporary());
    flight.write(archive.path());
    let report = refine(archive.path(), out.path(), &[]);
    let report = String::from_utf8_lossy(&report.stdout).into_owned();
    assert_eq!(report.matches("step of UTC").count(), 2, "{report}");
    assert_history("clock", &flight, out.path());
    let table = Columns::read(out.path(), "ASPECT");
    let (correction, times) = (table.floats("UTC_CORRECTION_S"), table.floats("UNIX_S"));
    for n in 0..120 {
        assert!(
            (times[n] - times[0] - n as f64 / RATE_HZ).abs() < 1e-4,
            "{n}"
        );
        assert_eq!((60..74).contains(&n), !correction[n].is_nan(), "{n}");
        let flagged = table.texts("REASON")[n].contains("the clock had stepped");
        assert_eq!(flagged, (60..74).contains(&n), "{n}");
    }
    let steps = &summary(out.path())["clock"]["steps"];
    assert!(
        (steps[0]["step_s"][0].as_f64().unwrap() + 1.3).abs() < 1e-3,
        "{steps}"
    );
    assert!(
        steps[1]["file"]
            .as_str()
            .unwrap()
            .ends_with("frame_00074.fits")
    );
}

/// The card with which a frame names its instrument.
fn named(name: &str) -> Vec<Card> {
    vec![Card::new(&keyword::OBSRVTRY, name)]
}

#[test]
fn two_cameras_of_one_archive_have_a_history_each_and_one_report() {
    let mut first = Flight::of_pieces(SLEWS, 48, 13);
    let mut second = Flight::of_pieces("[[piece]]\nstart_s = 0\nsun_mil = [-200, 300]\n", 48, 14);
    first.cards = named("demo");
    second.cards = named("demo-2");
    let (archive, out) = (temporary(), temporary());
    first.write(&archive.path().join("demo"));
    second.write(&archive.path().join("demo-2"));
    refine(archive.path(), out.path(), &[]);
    for (name, flight) in [("demo", &first), ("demo-2", &second)] {
        let folder = out.path().join(name);
        let (frames, _) = judged(flight, &folder);
        assert!(frames.iter().all(|errors| errors.largest_ratio() < 6.0));
        let report = summary(&folder);
        assert_eq!(
            (&report["files"], &report["fine"]),
            (&48.into(), &48.into())
        );
    }
    let report = fs::read_to_string(out.path().join("report.html")).unwrap();
    assert!(report.contains("<h2>demo: The Sun on the plate</h2>"));
    assert!(report.contains("<h2>demo-2: The Sun on the plate</h2>"));
    for figure in ["Spectrum of", "Cumulative jitter of", "Allan deviation of"] {
        assert_eq!(
            report.matches(&format!("aria-label=\"{figure}")).count(),
            2,
            "{figure}"
        );
    }
}

#[test]
fn frames_are_refined_with_the_instrument_they_name_and_refused_with_another() {
    let mut flight = Flight::of_pieces(SLEWS, 6, 15);
    flight.cards = named("heroes-pyas-r");
    let (archive, out) = (temporary(), temporary());
    flight.write(archive.path());
    refine(archive.path(), out.path(), &[]);
    assert_eq!(summary(out.path())["instrument"], "heroes-pyas-r");
    let refused = |report: &str| {
        let report = ["--instrument", report];
        let output = command(archive.path(), out.path(), &report)
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(1));
        String::from_utf8(output.stderr).unwrap()
    };
    let demo = out.path().join("demo.toml");
    fs::write(&demo, instrument::builtin_text("demo").unwrap()).unwrap();
    let error = refused(demo.to_str().unwrap());
    assert!(
        error.contains("OBSRVTRY") && error.contains("heroes-pyas-r"),
        "{error}"
    );

    // An instrument that is not available.
    flight.cards = named("another");
    flight.write(archive.path());
    let output = command(archive.path(), out.path(), &[]).output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1));
    assert!(
        error.contains("\"another\"") && error.contains("--instrument"),
        "{error}"
    );
}

#[test]
fn frames_that_measure_another_camera_are_refused() {
    let flight = Flight::of_pieces(SLEWS, 6, 16);
    let (archive, out) = (temporary(), temporary());
    flight.write(archive.path());
    let demo = instrument::builtin_text("demo").unwrap();
    for (what, stated, wrong) in [
        (
            "mounting.rotation_deg",
            "rotation_deg = { value = 0, sigma = 1,",
            "rotation_deg = { value = 4, sigma = 0.1,",
        ),
        (
            "camera",
            "[camera]",
            "[camera]\nname = { value = \"another\", source = \"a plate\", date = 2026-01-01 }",
        ),
    ] {
        let file = out.path().join("wrong.toml");
        let text = demo.replacen(stated, wrong, 1);
        assert_ne!(text, demo);
        fs::write(&file, text).unwrap();
        let report = ["--instrument", file.to_str().unwrap()];
        let output = command(archive.path(), out.path(), &report)
            .output()
            .unwrap();
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{what}: {error}");
        assert!(error.to_lowercase().contains(what), "{error}");
    }
}
