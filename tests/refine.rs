//! Refinement of a simulated flight: the results are compared with its truth, after interruptions and restarts, in parts
//! and merged.

use crate::common::refined::{Columns, command, quantile, refine, rms, summary, temporary};
use rand::RngExt;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use solaspect::archive::check::Tree;
use solaspect::archive::{ArchiveReader, Flown, FlownFiles, Store};
use solaspect::config::Config;
use solaspect::fits::{self, Compression};
use solaspect::frame::{Frame, FrameInfo, Pixels};
use solaspect::geometry::Mapping;
use solaspect::instrument::{self, Instrument};
use solaspect::observe::{CameraFrames, Journal, Pass, Record, Recorded, Span};
use solaspect::pointing::Target;
use solaspect::provenance;
use solaspect::refine::{
    self as refining, FrameRecord, History, PointingFacts, Recipe, Report, Rows, Sky, SolarPath,
};
use solaspect::simulate::{FORT_SUMNER, Noise, SUN_RADIUS_ARCSEC, Scene, Sun};
use solaspect::sky::Ephemeris;
use solaspect::units::PlateMil;
use std::f64::consts::TAU;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

const RATE_HZ: f64 = 4.0;

/// Defects of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Defect {
    Blurred,
    Knocked,
    Clouded,
    Truncated,
    Barred,
}

const DEFECTS: [Defect; 5] = [
    Defect::Blurred,
    Defect::Knocked,
    Defect::Clouded,
    Defect::Truncated,
    Defect::Barred,
];

/// A flight with wind, slews, sunset at the end, a mapping that drifts by 2 px with temperature and jumps by 0.5 px once, and
/// one frame in fifty with a defect.
struct Plan {
    frames: usize,
    seed: u64,
    instrument: Instrument,
    wind: Vec<[f64; 2]>,
    /// Frames with troubles, instead of defects and sunset.
    hard: bool,
    /// Relative change of the disc's radius on the plate per degC of the camera's temperature.
    radius_per_degc: f64,
}

/// A reason why a frame is hard to solve by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Trouble {
    /// Remaining fraction of the light, and brightness of the sky, DN.
    Haze(f64, f64),
    /// Contrast of the marks.
    Faint(f64),
    /// Without the Sun.
    Dark,
}

const TROUBLES: [Trouble; 10] = [
    Trouble::Haze(0.3, 20.0),
    Trouble::Haze(0.15, 20.0),
    Trouble::Haze(0.1, 20.0),
    Trouble::Haze(0.07, 20.0),
    Trouble::Haze(0.05, 20.0),
    Trouble::Haze(0.03, 20.0),
    Trouble::Faint(0.2),
    Trouble::Faint(0.1),
    Trouble::Faint(0.0),
    Trouble::Dark,
];

impl Plan {
    fn new(frames: usize, seed: u64) -> Self {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut now = [0.0_f64; 2];
        let wind = (0..frames).map(|_| {
            now = now.map(|v| 0.9 * v + rng.random_range(-3.0..3.0));
            now
        });
        Self {
            wind: wind.collect(),
            instrument: instrument::builtin("demo").unwrap(),
            frames,
            seed,
            hard: false,
            radius_per_degc: 0.0,
        }
    }

    /// A flight in which every third frame has a trouble, and the Sun leaves the sensor over an edge for a while.
    fn hard(frames: usize, seed: u64) -> Self {
        Self {
            hard: true,
            ..Self::new(frames, seed)
        }
    }

    fn trouble(&self, n: usize) -> Option<Trouble> {
        (self.hard && n % 3 == 1).then(|| TROUBLES[n / 3 % TROUBLES.len()])
    }

    /// Displacement of the Sun over the sensor's lower edge and back within 16 s, mil.
    fn out_mil(&self, n: usize) -> f64 {
        let part = (n as f64 / RATE_HZ - 20.0) / 16.0;
        let out = self.hard && (0.0..1.0).contains(&part);
        if out {
            1700.0 * (1.0 - (TAU * part).cos())
        } else {
            0.0
        }
    }

    fn jump(&self) -> usize {
        self.frames * 6 / 10
    }

    fn defect(&self, n: usize) -> Option<Defect> {
        let last = self.frames * 9 / 10;
        (!self.hard && n % 50 == 27 && n < last).then(|| DEFECTS[n / 50 % DEFECTS.len()])
    }

    fn temperature_c(&self, n: usize) -> f64 {
        20.0 - 15.0 * n as f64 / self.frames as f64
    }

    fn mapping(&self, n: usize) -> Mapping {
        let mut similarity = self.instrument.mounting.similarity();
        let above_20_c = self.temperature_c(n) - 20.0;
        let mut shift = [
            3.0 + 2.0 / 15.0 * 0.8 * above_20_c,
            -2.0 + 2.0 / 15.0 * 0.6 * above_20_c,
        ];
        if n >= self.jump() {
            shift = [shift[0] + 0.4, shift[1] - 0.3];
        }
        if self.defect(n) == Some(Defect::Knocked) {
            shift = [shift[0] + 1.5, shift[1] + 1.0];
        }
        similarity.plate_centre.x += shift[0];
        similarity.plate_centre.y += shift[1];
        similarity.rotation_deg += 0.4 + 0.002 * above_20_c;
        similarity.scale_mil_per_px *= 1.001;
        Mapping::similarity(similarity, self.instrument.camera.distortion).unwrap()
    }

    fn sun(&self, n: usize) -> PlateMil {
        let t = n as f64 / RATE_HZ;
        let swing =
            |amplitude: f64, period: f64, phase: f64| amplitude * (TAU * t / period + phase).sin();
        let [x, y] = self.wind[n];
        // A slew of 10 s every 25 s, between two positions.
        let part =
            ((t % 50.0 - 15.0) / 10.0).clamp(0.0, 1.0) - ((t % 50.0 - 40.0) / 10.0).clamp(0.0, 1.0);
        let slewed = (1.0 - (TAU * part / 2.0).cos()) / 2.0;
        PlateMil::new(
            -400.0 + 900.0 * slewed + swing(80.0, 12.3, 0.3) + swing(20.0, 3.7, 1.0) + x,
            250.0 - 500.0 * slewed
                + swing(60.0, 13.1, 2.0)
                + swing(15.0, 4.1, 0.0)
                + y
                + self.out_mil(n),
        )
    }

    /// Remaining fraction of the light: it decreases during a twentieth of the flight and is zero at the end.
    fn light(&self, n: usize) -> f64 {
        if self.hard {
            return 1.0;
        }
        let left = (self.frames - n) as f64 / self.frames as f64;
        ((left - 0.03) / 0.05).clamp(0.0, 1.0)
    }

    fn frame(&self, n: usize) -> Frame {
        let defect = self.defect(n);
        let above_20_c = self.temperature_c(n) - 20.0;
        let radius = self.instrument.optics.radius_mil(SUN_RADIUS_ARCSEC);
        let radius = radius * (1.0 + self.radius_per_degc * above_20_c);
        let mut sun = Sun::new(self.sun(n), radius);
        sun.peak_dn *= self.light(n);
        let mut scene = Scene {
            noise: Noise::read(5.0),
            seed: self.seed * 1_000_003 + n as u64,
            ..Scene::new(&self.instrument, self.mapping(n))
        };
        match defect {
            Some(Defect::Blurred) => scene.blur_px = 5.0,
            Some(Defect::Clouded) => sun.peak_dn *= 0.3,
            _ => {}
        }
        match self.trouble(n) {
            Some(Trouble::Haze(left, sky_dn)) => {
                sun.peak_dn *= left;
                scene.background_dn += sky_dn;
                scene.blur_px *= 1.3;
            }
            Some(Trouble::Faint(contrast)) => scene.mark_contrast = contrast,
            Some(Trouble::Dark) => sun.peak_dn = 0.0,
            None => {}
        }
        scene.sun = Some(sun);
        scene.info = FrameInfo {
            number: Some(n as u64),
            mid_exposure: Some(time(n)),
            exposure: Some(Duration::from_millis(15)),
            camera_temperature_c: Some(self.temperature_c(n)),
            place: Some(FORT_SUMNER),
            ..FrameInfo::default()
        };
        let frame = scene.frame().unwrap();
        match defect {
            Some(Defect::Barred) => barred(frame, scene.mapping.to_sensor(self.sun(n)).y as usize),
            _ => frame,
        }
    }

    fn write(&self, folder: &Path) {
        use rayon::prelude::*;
        (0..self.frames).into_par_iter().for_each(|n| {
            let folder = folder.join(format!("hour{}", n / 100));
            fs::create_dir_all(&folder).unwrap();
            let path = folder.join(format!("frame_{n:05}.fits"));
            fits::write_frame(&path, &self.frame(n), &[], &[], Compression::Rice).unwrap();
            if self.defect(n) == Some(Defect::Truncated) {
                let bytes = fs::read(&path).unwrap();
                fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
            }
        });
    }
}

/// A frame in which 40 rows below the disc's centre were lost.
fn barred(frame: Frame, from: usize) -> Frame {
    let Pixels::U8(mut pixels) = frame.pixels().clone() else {
        panic!("8 bit");
    };
    let width = frame.width();
    pixels[(from + 20) * width..(from + 60) * width].fill(0);
    let (height, info) = (frame.height(), frame.info.clone());
    Frame::new(width, height, Pixels::U8(pixels), 255, info).unwrap()
}

fn time(n: usize) -> jiff::Timestamp {
    let start: jiff::Timestamp = "2013-09-21T18:00:00Z".parse().unwrap();
    start + jiff::SignedDuration::from_millis(250 * n as i64)
}

/// The small flight, simulated once for all tests.
fn flight() -> &'static (Plan, PathBuf) {
    static FLIGHT: OnceLock<(Plan, PathBuf)> = OnceLock::new();
    FLIGHT.get_or_init(|| {
        let plan = Plan::new(240, 5);
        let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("refined-flight");
        let _ = fs::remove_dir_all(&folder);
        plan.write(&folder);
        (plan, folder)
    })
}

/// Errors of the refined history with respect to the truth.
struct Comparison {
    /// Radial error, arcsec, and error over sigma in each axis; fine rows except the frame of the jump.
    errors: Vec<f64>,
    ratios: Vec<f64>,
    /// Radial errors while the Sun has at least half of its light.
    lit_errors: Vec<f64>,
    /// Errors of the smoothed path at frames.
    smooth_errors: Vec<f64>,
    smooth_ratios: Vec<f64>,
    unflagged: Vec<usize>,
}

fn number(file: &str) -> usize {
    let digits = file.trim_end_matches(".fits");
    digits[digits.len() - 5..].parse().unwrap()
}

fn compare(plan: &Plan, out: &Path) -> Comparison {
    let table = Columns::read(out, "ASPECT");
    let arcsec_per_mil = plan.instrument.optics.arcsec_per_mil();
    let mut compared = Comparison {
        errors: Vec::new(),
        ratios: Vec::new(),
        lit_errors: Vec::new(),
        smooth_errors: Vec::new(),
        smooth_ratios: Vec::new(),
        unflagged: Vec::new(),
    };
    let [x, y, sx, sy] =
        ["SUN_X_MIL", "SUN_Y_MIL", "SIGMA_X_MIL", "SIGMA_Y_MIL"].map(|n| table.floats(n));
    for (row, file) in table.texts("FILE").iter().enumerate() {
        let n = number(file);
        let fine = table.texts("QUALITY")[row] == "fine";
        if plan.defect(n).is_some() && table.texts("REASON")[row].is_empty() {
            compared.unflagged.push(n);
        }
        if !fine || n == plan.jump() {
            continue;
        }
        let truth = plan.sun(n);
        let (dx, dy) = (x[row] - truth.x, y[row] - truth.y);
        compared.errors.push(dx.hypot(dy) * arcsec_per_mil);
        if plan.light(n) >= 0.5 {
            compared.lit_errors.push(dx.hypot(dy) * arcsec_per_mil);
        }
        compared.ratios.extend([dx / sx[row], dy / sy[row]]);
    }
    let smoothed = Columns::read(out, "SMOOTHED");
    let first = time(0).as_millisecond() as f64 / 1e3;
    let [t, x, sx] = ["UNIX_S", "SUN_X_MIL", "SIGMA_X_MIL"].map(|n| smoothed.floats(n));
    let y = smoothed.floats("SUN_Y_MIL");
    for row in 0..t.len() {
        let n = ((t[row] - first) * RATE_HZ).round();
        let at_frame = ((t[row] - first) * RATE_HZ - n).abs() < 1e-3;
        if !at_frame || x[row].is_nan() || sx[row] > 1.0 || n as usize == plan.jump() {
            continue;
        }
        let truth = plan.sun(n as usize);
        compared
            .smooth_errors
            .push((x[row] - truth.x).hypot(y[row] - truth.y) * arcsec_per_mil);
        compared.smooth_ratios.push((x[row] - truth.x) / sx[row]);
    }
    compared
}

fn print(name: &str, compared: &Comparison) {
    println!(
        "{name}: {} fine, error median {:.3} 99.7 % {:.3} (by half of the light or more {:.3}) largest {:.3} arcsec, \
         error/sigma {:.3}; smoothed median {:.3} \
         99.7 % {:.3}, error/sigma {:.3}; defective and not flagged {:?}",
        compared.errors.len(),
        quantile(&compared.errors, 0.5),
        quantile(&compared.errors, 0.997),
        quantile(&compared.lit_errors, 0.997),
        quantile(&compared.errors, 1.0),
        rms(&compared.ratios),
        quantile(&compared.smooth_errors, 0.5),
        quantile(&compared.smooth_errors, 0.997),
        rms(&compared.smooth_ratios),
        compared.unflagged,
    );
}

/// Rms of error over sigma of the plate's centre x and y, rotation and scale, over fine rows except the frame of the jump. The whole flight
/// has one mapping model, so neighbouring rows have nearly the same error.
fn mapping_errors_over_sigma(plan: &Plan, table: &Columns) -> [f64; 4] {
    let quantities = [
        ["CENTRE_X_PX", "CENTRE_SIGMA_X_PX"],
        ["CENTRE_Y_PX", "CENTRE_SIGMA_Y_PX"],
        ["ROTATION_DEG", "ROTATION_SIGMA_DEG"],
        ["SCALE_MIL_PER_PX", "SCALE_SIGMA_MIL_PER_PX"],
    ];
    let columns = quantities.map(|names| names.map(|name| table.floats(name)));
    let mut errors = [const { Vec::new() }; 4];
    for (row, file) in table.texts("FILE").iter().enumerate() {
        let n = number(file);
        if table.texts("QUALITY")[row] != "fine" || n == plan.jump() {
            continue;
        }
        let mapping = plan.mapping(n);
        let centre = mapping.to_sensor(PlateMil::new(0.0, 0.0));
        let scale = mapping.scale_mil_per_px(centre);
        let truth = [centre.x, centre.y, mapping.rotation_deg(centre), scale];
        for ((errors, [found, sigma]), truth) in errors.iter_mut().zip(columns).zip(truth) {
            errors.push((found[row] - truth) / sigma[row]);
        }
    }
    errors.map(|errors| rms(&errors))
}

#[test]
fn a_flight_is_refined_to_its_truth() {
    let (plan, archive) = flight();
    let out = temporary();
    refine(archive, out.path(), &[]);
    let compared = compare(plan, out.path());
    print("refined", &compared);
    assert!(compared.errors.len() > plan.frames * 8 / 10);
    // The last frames of the setting Sun have a quarter of the light or less, so their errors are limited by noise.
    assert!(quantile(&compared.lit_errors, 0.997) < 0.35);
    assert!(quantile(&compared.errors, 0.997) < 0.6);
    assert!((0.8..1.25).contains(&rms(&compared.ratios)));
    assert!(compared.unflagged.is_empty());
    assert!((0.7..1.3).contains(&rms(&compared.smooth_ratios)));
    let table = Columns::read(out.path(), "ASPECT");
    let mapping = mapping_errors_over_sigma(plan, &table);
    println!("error/sigma of the plate's centre, rotation and scale: {mapping:.2?}");
    assert!(mapping.iter().all(|ratio| (0.3..2.5).contains(ratio)));
    assert_eq!(table.texts("FILE").len(), plan.frames);
    let jumps = table.floats("JUMP_PX");
    let found: Vec<usize> = (0..plan.frames)
        .filter(|row| jumps[*row].is_finite())
        .collect();
    assert_eq!(found, [plan.jump()]);
    assert!((jumps[plan.jump()] - 0.5).abs() < 0.1);
}

/// A plate whose distance grows by 6e-5 per degC, and a fixed one; in both the mapping depends on the temperature.
#[test]
fn what_the_temperature_does_to_the_radius_is_determined_only_where_it_does_something() {
    const PER_DEGC: f64 = 6e-5;
    let (still, archive) = flight();
    assert_eq!(still.radius_per_degc, 0.0);
    let out = temporary();
    refine(archive, out.path(), &[]);
    let found = |folder: &Path| summary(folder)["radius_by_temperature"].clone();
    let stays = found(out.path());
    println!("{stays}");
    assert_eq!(stays["determined"], false, "{stays}");
    let text = stays["text"].as_str().unwrap();
    assert!(text.starts_with("not determined"), "{stays}");
    let breathing = Plan {
        radius_per_degc: PER_DEGC,
        ..Plan::new(240, 6)
    };
    let flown = temporary();
    breathing.write(flown.path());
    let out = temporary();
    refine(flown.path(), out.path(), &[]);
    let breathes = found(out.path());
    println!("{breathes}");
    assert_eq!(breathes["determined"], true, "{breathes}");
    let [value, sigma] = [0, 1].map(|n| breathes["per_degc"][n].as_f64().unwrap());
    assert!((value - PER_DEGC).abs() < 3.0 * sigma, "{breathes}");
    assert!(sigma < 0.2 * PER_DEGC, "{breathes}");
    let page = fs::read_to_string(out.path().join("report.html")).unwrap();
    assert!(page.contains("parts in a million per degC"));
}

#[test]
fn frames_that_fail_by_themselves_are_solved_in_a_second_pass() {
    let plan = Plan::hard(210, 12);
    let (archive, out) = (temporary(), temporary());
    plan.write(archive.path());
    refine(archive.path(), out.path(), &[]);
    let table = Columns::read(out.path(), "ASPECT");
    let mut hard = Hard::default();
    for row in 0..plan.frames {
        hard.take(&plan, &table, row);
    }
    hard.print();
    // Faint marks do no harm, and no Sun is found where there is none.
    assert_eq!(hard.of_faint.fine, hard.of_faint.all);
    assert!(hard.of_faint.own_fine < hard.of_faint.all / 2);
    assert_eq!(hard.of_dark.placed, 0);
    // Haze that leaves a twentieth of the light, two sigma of a pixel's noise, is enough.
    assert_eq!(hard.of_haze.own_placed, 0);
    assert!(hard.of_haze.placed + 1 >= hard.of_haze.all);
    assert_eq!(hard.of_haze.fine, 0);
    // All frames at the sensor's edge have a position.
    assert_eq!(hard.of_edge.placed, hard.of_edge.all);
    for counts in [
        &hard.of_faint,
        &hard.of_haze,
        &hard.of_edge,
        &hard.of_others,
    ] {
        assert!((0.6..1.4).contains(&rms(&counts.ratios)), "{counts:?}");
        assert!(
            counts.ratios.iter().all(|ratio| ratio.abs() < 5.0),
            "{counts:?}"
        );
    }
}

/// Results of the frames with troubles, by kind of trouble.
#[derive(Debug, Default)]
struct Hard {
    of_faint: Counts,
    of_haze: Counts,
    of_dark: Counts,
    of_edge: Counts,
    of_others: Counts,
}

#[derive(Debug, Default)]
struct Counts {
    all: usize,
    own_placed: usize,
    own_fine: usize,
    placed: usize,
    fine: usize,
    /// Error over sigma in both axes.
    ratios: Vec<f64>,
}

impl Hard {
    fn print(&self) {
        let all = [
            &self.of_faint,
            &self.of_haze,
            &self.of_dark,
            &self.of_edge,
            &self.of_others,
        ];
        for (name, counts) in ["faint", "haze", "dark", "edge", "others"].iter().zip(all) {
            println!(
                "{name}: {} frames, by themselves {} placed, {} fine; refined {} placed, {} fine, error/sigma {:.2}",
                counts.all,
                counts.own_placed,
                counts.own_fine,
                counts.placed,
                counts.fine,
                rms(&counts.ratios),
            );
        }
    }

    fn take(&mut self, plan: &Plan, table: &Columns, row: usize) {
        let at_edge = table.floats("LIMB_PART")[row] < 0.4;
        let counts = match plan.trouble(row) {
            Some(Trouble::Haze(left, _)) if left < 0.04 => return,
            Some(Trouble::Haze(left, _)) if left < 0.12 => &mut self.of_haze,
            Some(Trouble::Dark) => &mut self.of_dark,
            _ if at_edge => &mut self.of_edge,
            Some(Trouble::Faint(contrast)) if contrast < 0.15 => &mut self.of_faint,
            _ => &mut self.of_others,
        };
        let value = |name| table.floats(name)[row];
        counts.all += 1;
        counts.own_placed += usize::from(value("OWN_X_MIL").is_finite());
        counts.own_fine += usize::from(table.texts("OWN_QUALITY")[row] == "fine");
        counts.fine += usize::from(table.texts("QUALITY")[row] == "fine");
        if value("SUN_X_MIL").is_finite() {
            let truth = plan.sun(row);
            counts.placed += 1;
            counts.ratios.extend([
                (value("SUN_X_MIL") - truth.x) / value("SIGMA_X_MIL"),
                (value("SUN_Y_MIL") - truth.y) / value("SIGMA_Y_MIL"),
            ]);
        }
    }
}

fn bytes(out: &Path) -> Vec<Vec<u8>> {
    ["aspect.fits", "aspect.csv", "summary.json", "report.html"]
        .map(|name| fs::read(out.join(name)).unwrap())
        .into()
}

/// The journal of the frames in a run's output.
fn journal(out: &Path) -> Option<PathBuf> {
    let entries = fs::read_dir(out).ok()?;
    let mut names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let name = names.find(|name| name.ends_with(".journal") && !name.starts_with("cameras-"))?;
    Some(out.join(name))
}

/// Waits until a run's journal is longer than `bytes`, or the run has ended.
fn wait_for_journal(out: &Path, bytes: u64, child: &mut Child) {
    for _ in 0..60_000 {
        let journal = journal(out);
        let long = journal.is_some_and(|j| j.metadata().is_ok_and(|m| m.len() > bytes));
        if long || child.try_wait().unwrap().is_some() {
            return;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    panic!("the journal does not grow");
}

#[test]
fn a_run_that_is_killed_and_run_again_gives_the_same_bytes_and_does_nothing_twice() {
    let (_, archive) = flight();
    let (whole, killed) = (temporary(), temporary());
    refine(archive, whole.path(), &["--jobs", "1"]);
    for kill in 1..=3 {
        let mut child = command(archive, killed.path(), &[]).spawn().unwrap();
        wait_for_journal(killed.path(), kill * 60_000, &mut child);
        child.kill().unwrap();
        child.wait().unwrap();
    }
    refine(archive, killed.path(), &[]);
    assert!(bytes(whole.path()) == bytes(killed.path()));
    let mut records = Vec::new();
    let journal = journal(killed.path()).unwrap();
    Journal::<FrameRecord>::read(&journal, |r, _| records.push(r.input.file)).unwrap();
    let count = records.len();
    records.sort();
    records.dedup();
    assert_eq!((records.len(), count), (240, 240));
}

#[test]
fn a_run_that_is_interrupted_ends_at_the_next_frame_and_goes_on_from_its_journal() {
    let (_, archive) = flight();
    let (whole, interrupted) = (temporary(), temporary());
    refine(archive, whole.path(), &[]);
    let mut command = command(archive, interrupted.path(), &[]);
    let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
    wait_for_journal(interrupted.path(), 60_000, &mut child);
    let pid = child.id().to_string();
    let interrupt = Command::new("kill").args(["-INT", &pid]).status();
    assert!(interrupt.unwrap().success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(
        stderr.contains("cancelled: what is done is in the journal"),
        "{stderr}"
    );
    let mut records = 0;
    let journal = journal(interrupted.path()).unwrap();
    Journal::<FrameRecord>::read(&journal, |_, _| records += 1).unwrap();
    assert!((1..240).contains(&records), "{records}");
    assert!(!interrupted.path().join("aspect.fits").exists());
    refine(archive, interrupted.path(), &[]);
    assert!(bytes(whole.path()) == bytes(interrupted.path()));
}

#[test]
fn parts_on_several_machines_merge_to_the_same_bytes() {
    let (_, archive) = flight();
    let outs: Vec<_> = (0..4).map(|_| temporary()).collect();
    let path = |n: usize| outs[n].path().to_str().unwrap();
    refine(archive, outs[0].path(), &[]);
    refine(archive, outs[1].path(), &["--shard", "1/2"]);
    refine(archive, outs[2].path(), &["--shard", "2/2"]);
    assert!(!outs[1].path().join("aspect.fits").exists());
    refine(archive, outs[3].path(), &["--merge", path(1), path(2)]);
    assert!(bytes(outs[0].path()) == bytes(outs[3].path()));
    let error = command(
        archive,
        outs[3].path(),
        &["--merge", archive.to_str().unwrap()],
    )
    .output()
    .unwrap();
    assert_eq!(error.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&error.stderr).contains("journal"));
}

#[test]
fn since_and_until_choose_by_mid_exposure() {
    let (plan, archive) = flight();
    let out = temporary();
    let span = [
        "--since",
        "2013-09-21T18:00:05Z",
        "--until",
        "2013-09-21T18:00:09.75Z",
    ];
    refine(archive, out.path(), &span);
    let table = Columns::read(out.path(), "ASPECT");
    let numbers: Vec<usize> = table
        .texts("FILE")
        .iter()
        .map(|file| number(file))
        .collect();
    // A file that cannot be read has no known time, so it stays in the table.
    let lost = (0..240).filter(|n| plan.defect(*n) == Some(Defect::Truncated));
    let expected: Vec<usize> = (20..40).chain(lost).collect();
    assert_eq!(numbers, expected);
}

/// Writes a frame as the HEROES flight program did.
fn heroes(path: &Path, frame: &Frame, cards: &[(&str, &str)]) {
    let header = |cards: &[(&str, &str)]| {
        let lines = cards
            .iter()
            .map(|(name, value)| format!("{:<80}", format!("{name:<8}= {value:>20}")));
        let mut text: String = lines.collect();
        text += &format!("{:<80}", "END");
        let mut bytes = text.into_bytes();
        bytes.resize(bytes.len().next_multiple_of(2880), b' ');
        bytes
    };
    let Pixels::U8(pixels) = frame.pixels() else {
        panic!("8 bit");
    };
    let (width, height) = (frame.width().to_string(), frame.height().to_string());
    let primary = [
        ("SIMPLE", "T"),
        ("BITPIX", "8"),
        ("NAXIS", "0"),
        ("EXTEND", "T"),
    ];
    let mut bytes = header(&[&primary[..], cards].concat());
    bytes.extend(header(&[
        ("XTENSION", "'IMAGE   '"),
        ("BITPIX", "8"),
        ("NAXIS", "2"),
        ("NAXIS1", &width),
        ("NAXIS2", &height),
        ("PCOUNT", "0"),
        ("GCOUNT", "1"),
        ("EXTNAME", "'Raw Frame'"),
    ]));
    bytes.extend(pixels);
    bytes.resize(bytes.len().next_multiple_of(2880), 0);
    fs::write(path, bytes).unwrap();
}

#[test]
fn the_files_of_the_heroes_flight_are_read() {
    let plan = Plan::new(40, 3);
    let (archive, out) = (temporary(), temporary());
    for n in 0..6 {
        let path = archive.path().join(format!("frame_{n:05}.fits"));
        let nanoseconds = format!("{}", 250_000_000 * (n % 4) as u32);
        let seconds = format!("{}", 1_379_786_400 + n / 4);
        heroes(
            &path,
            &plan.frame(n),
            &[
                ("EXPTIME", "0.5"),
                ("DATE_OBS", "'Sat Sep 21 18:00:00 2013 '"),
                ("RT_SEC", &seconds),
                ("RT_NSEC", &nanoseconds),
                ("TEMPCCD", "21"),
                ("MON_SEC", "77"),
                ("MON_NSEC", &nanoseconds),
                ("CTL_AZIM", if n == 0 { "0.0" } else { "0.25" }),
                ("CTL_ELEV", if n == 0 { "0.0" } else { "-0.125" }),
                ("FRAMENUM", &format!("{n}.0")),
            ],
        );
    }
    let path = archive.path().join("frame_00006.fits");
    let asctime = [
        ("EXPTIME", "0.5"),
        ("DATE_OBS", "'Sat Sep 21 18:00:03 2013 '"),
    ];
    heroes(&path, &plan.frame(6), &asctime);
    refine(
        archive.path(),
        out.path(),
        &["--place", "34.49,-104.2218,38405"],
    );
    let table = Columns::read(out.path(), "ASPECT");
    let times = table.texts("UTC");
    assert_eq!(times[1], "2013-09-21T18:00:00.500000Z");
    assert_eq!(times[6], "2013-09-21T18:00:03.250000Z");
    assert!(
        table
            .texts("QUALITY")
            .iter()
            .all(|quality| quality == "fine")
    );
    assert_eq!(table.floats("TEMPERATURE_C")[0], 21.0);
    assert_eq!(table.floats("MONO_S")[1], 77.5);
    assert_eq!(table.floats("FLIGHT_OFFSET_AZ_DEG")[1], 0.25);
    assert!(table.floats("FLIGHT_OFFSET_EL_DEG")[0].is_nan());
    assert!(
        table
            .floats("POINTING_AZ_DEG")
            .iter()
            .all(|az| az.is_finite())
    );
    let arcsec = |name| {
        table
            .floats(name)
            .iter()
            .map(|v| v.abs())
            .fold(0.0, f64::max)
    };
    assert!(arcsec("BORESIGHT_HPLN_ARCSEC").max(arcsec("BORESIGHT_HPLT_ARCSEC")) > 100.0);
}

/// Memory of this process, kB: `VmHWM` is the peak, `VmRSS` the current value.
fn memory_kb(what: &str) -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with(what)).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

/// The records of the small flight that have a disc, in order of time; at most as many as there are frames before the jump.
fn lit_records(plan: &Plan, out: &Path) -> Vec<Record<FrameRecord>> {
    let mut records: Vec<Record<FrameRecord>> = Vec::new();
    Journal::read(&journal(out).unwrap(), |record, _| records.push(record)).unwrap();
    records.retain(|r| r.outcome.as_ref().is_ok_and(|frame| frame.disc.is_some()));
    records.sort_by_key(|record| record.input.file.clone());
    records.truncate(plan.jump());
    records
}

/// Seven hours of flight, or SOLASPECT_FLIGHT_FRAMES frames, made by repeating the records of the first half minute forwards and
/// backwards. Needs its own process: `cargo test --test promises -- --ignored a_hundred_thousand --nocapture`.
#[test]
#[ignore = "a minute long, and it measures the process's memory"]
fn a_hundred_thousand_frames_take_less_than_300_mb() {
    let frames = std::env::var("SOLASPECT_FLIGHT_FRAMES");
    let frames: usize = frames.map_or(100_000, |frames| frames.parse().unwrap());
    let (plan, archive) = flight();
    let out = temporary();
    refine(archive, out.path(), &[]);
    let lit = lit_records(plan, out.path());
    let long = out.path().join("long.journal");
    let journal = Journal::open(&long, |_, _| {}).unwrap();
    let mut camera = CameraFrames::default();
    for n in 0..frames {
        let turn = n % (2 * lit.len());
        let mut record = lit[turn.min(2 * lit.len() - 1 - turn)].clone();
        record.input.file = format!(
            "night_of_the_flight/hour_{:02}/frame_{n:06}.fits",
            n / 14_400
        );
        if let Ok(frame) = &mut record.outcome {
            frame.facts.utc_ns = Some(time(0).as_nanosecond() as i64 + n as i64 * 250_000_000);
        }
        journal.append(&record).unwrap();
        camera.inputs.push(record.input);
    }
    drop((journal, lit));
    let archive = ArchiveReader::open(archive, out.path()).unwrap();
    let done = Recorded::open(&long, &[]).unwrap();
    let demo = (plan.instrument.clone(), String::new());
    let recipe = Recipe::new(demo, &Config::default(), FlownFiles::default());
    let sky = Sky {
        target: Target::default(),
        place: None,
        ephemeris: Ephemeris::default(),
    };
    let pass = Pass {
        archive: &archive,
        out: out.path(),
        merge: &[],
        shard: None,
        span: Span::default(),
        watch: &(),
    };
    let reports = |stage: &str| {
        let [now, most] = ["VmRSS", "VmHWM"].map(|what| memory_kb(what) / 1000);
        println!("{stage}: {now} MB, at most {most} MB");
    };
    reports("before");
    let start = std::time::Instant::now();
    let history = History::new(done, camera, recipe, sky, &pass).unwrap();
    println!("history {:.1} s", start.elapsed().as_secs_f64());
    reports("history");
    let mut rows = Rows::default();
    let written = refining::write_rows(out.path(), &history, |row| rows.take(row)).unwrap();
    let pointing = history.pointing(None).unwrap();
    reports("pointing");
    let path = SolarPath::of(&pointing, history.sky());
    let facts = PointingFacts {
        cameras_against_gyros: None,
        on_target: path.on_target(),
    };
    let summary = refining::write(out.path(), &history, written, facts, &pointing, 10.0).unwrap();
    reports("tables");
    let mut report = Report::default();
    report.add(None, &archive, &history, &summary, &rows, &path);
    report.write(out.path()).unwrap();
    reports("report");
    println!("{:.1} s in all", start.elapsed().as_secs_f64());
    let counts = &summary.counts;
    println!("{} fine of {}", counts.fine, counts.files);
    assert!(counts.fine > frames * 9 / 10);
    assert!(memory_kb("VmHWM") < 3 * frames as u64);
}

/// An hour at 4 Hz, or SOLASPECT_FLIGHT_FRAMES frames, simulated once and kept with its journal:
/// `cargo test --test promises -- --ignored an_hour --nocapture`.
#[test]
#[ignore = "an hour of flight takes many minutes to simulate"]
fn an_hour_of_flight_is_refined_to_its_truth() {
    let frames = std::env::var("SOLASPECT_FLIGHT_FRAMES");
    let frames = frames.map_or(14_400, |frames| frames.parse().unwrap());
    let plan = Plan::new(frames, 8);
    let archive = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("flight-of-{frames}"));
    if !archive.join("whole").exists() {
        plan.write(&archive);
        fs::write(archive.join("whole"), "").unwrap();
    }
    let out = archive.with_extension("refined");
    refine(&archive, &out, &[]);
    let compared = compare(&plan, &out);
    print("an hour", &compared);
    // More than 0.3 % of the fourteen thousand frames are in the last minutes, with a tenth of the light.
    assert!(quantile(&compared.lit_errors, 0.997) < 0.35);
    assert!((0.8..1.25).contains(&rms(&compared.ratios)));
    assert!(compared.unflagged.is_empty());
}

/// An archive of a few demo frames, flown with this instrument and configuration.
fn flown_archive(instrument_toml: &str, configuration: &str) -> tempfile::TempDir {
    let root = tempfile::tempdir().unwrap();
    add_flight(root.path(), instrument_toml, configuration, 0);
    root
}

fn add_flight(root: &Path, instrument_toml: &str, configuration: &str, first: usize) {
    let store = Store::open(root, "demo", Compression::Rice).unwrap();
    let flown = Flown::new(configuration.into(), Some(instrument_toml.into()));
    store.add_flight_files(flown.files(Path::new(""), time(first)));
    let plan = &flight().0;
    let cards: Vec<_> = flown.cards().collect();
    for n in first..first + 4 {
        store.write(&plan.frame(n), &cards, &[]).unwrap();
    }
}

#[test]
fn an_archive_is_refined_with_the_instrument_and_the_configuration_it_was_flown_with() {
    let demo = instrument::builtin_text("demo").unwrap();
    let renamed = demo.replacen("name = \"demo\"", "name = \"as-flown\"", 1);
    let root = flown_archive(
        &renamed,
        "[target]\nx_arcsec = 250.0\n[link]\nbaud = 9600\n",
    );
    let out = tempfile::tempdir().unwrap();
    refine(root.path(), out.path(), &["--rate", "10"]);
    let report = summary(out.path());
    assert_eq!(report["instrument"], "as-flown");
    let hash = provenance::sha256(&renamed);
    assert_eq!(report["instrument_sha256"], hash);
    for table in ["aspect.fits", "stabilisation.fits"] {
        let mut file = fitsio::FitsFile::open(out.path().join(table)).unwrap();
        let card = file
            .primary_hdu()
            .unwrap()
            .read_key::<String>(&mut file, "INSTSHA");
        assert_eq!(card.unwrap(), hash, "{table}");
    }
    assert_eq!(report["fine"], 4);
    let out = tempfile::tempdir().unwrap();
    let file = out.path().join("demo.toml");
    fs::write(&file, demo).unwrap();
    refine(
        root.path(),
        out.path(),
        &["--instrument", file.to_str().unwrap()],
    );
    assert_eq!(summary(out.path())["instrument"], "demo");

    // An instrument file of another sensor size is refused.
    fs::write(&file, demo.replacen("value = 1296", "value = 1295", 1)).unwrap();
    let report = ["--instrument", file.to_str().unwrap()];
    let refused = command(root.path(), out.path(), &report).output().unwrap();
    let error = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(
        !refused.status.success() && error.contains("sensor"),
        "{error}"
    );
}

#[test]
fn a_film_is_made_of_a_refined_flight_and_what_it_lacks_is_said_before_the_flight_is_refined() {
    let demo = instrument::builtin_text("demo").unwrap();
    let root = flown_archive(demo, "");
    let out = tempfile::tempdir().unwrap();
    let frame = Tree::of(root.path()).unwrap().files.remove(0);
    let film = out.path().join("film");
    let refused = |more: &[&str]| {
        let output = command(root.path(), out.path(), more).output().unwrap();
        assert!(!output.status.success() && journal(out.path()).is_none());
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let (film_, frame_) = (film.to_str().unwrap(), frame.to_str().unwrap());
    let error = refused(&["--film", film_, "--film-context", frame_]);
    let expected = format!("{frame_}: CTYPE1: expected 'HPLN-TAN'");
    assert!(error.contains(&expected), "{error}");
    let error = refused(&["--film", "film.mp4"]);
    assert!(
        error.contains("expected a file that ends in .gif"),
        "{error}"
    );
    let error = refused(&["--film-frames"]);
    assert!(error.contains("--film <DIR|FILE>"), "{error}");
    let in_archive = root.path().join("film");
    let error = refused(&["--film", in_archive.to_str().unwrap()]);
    assert!(error.contains("outside of the archive"), "{error}");

    let output = refine(root.path(), out.path(), &["--film", film_, "--film-frames"]);
    let report = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        report.contains("film: 4 pictures, one each 0.250 s: "),
        "{report}"
    );
    assert_eq!(fs::read_dir(&film).unwrap().count(), 4);
}

#[test]
fn a_frame_that_contradicts_its_archive_is_refused_and_flights_that_differ_want_an_instrument() {
    let demo = instrument::builtin_text("demo").unwrap();
    let root = flown_archive(demo, "[target]\nx_arcsec = 250.0\n");
    let stranger = flown_archive(demo, "[target]\nx_arcsec = -250.0\n");
    let tree = |root: &Path| Tree::of(root).unwrap().files;
    let name = "stranger.fits";
    fs::copy(&tree(stranger.path())[0], root.path().join(name)).unwrap();
    let out = tempfile::tempdir().unwrap();
    refine(root.path(), out.path(), &[]);
    let report = summary(out.path());
    assert_eq!((&report["files"], &report["fine"]), (&5.into(), &4.into()));
    let csv = fs::read_to_string(out.path().join("aspect.csv")).unwrap();
    let row = csv.lines().find(|row| row.contains(name)).unwrap();
    assert!(row.contains("CONFSHA"), "{row}");

    add_flight(root.path(), demo, "[target]\nx_arcsec = -250.0\n", 4);
    let refused = command(root.path(), out.path(), &[]).output().unwrap();
    let error = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(
        !refused.status.success() && error.contains("--config"),
        "{error}"
    );
    let config = out.path().join("c.toml");
    fs::write(&config, "").unwrap();
    refine(
        root.path(),
        out.path(),
        &["--config", config.to_str().unwrap()],
    );
    assert_eq!(summary(out.path())["fine"], 9);
}
