//! Refinement of a flight with its IMU: the attitude at the frames and between them, also while no frame shows the Sun.

use crate::common::refined::{Columns, command, refine, rms, temporary};
use jiff::Timestamp;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use solaspect::demo::{self, Demo};
use solaspect::instrument::{Instrument, builtin};
use solaspect::pointing::sun_in_telescope;
use solaspect::simulate::navigation::TelescopeFlight;
use solaspect::simulate::{FORT_SUMNER, Gondola, Trajectory};
use solaspect::sky::sun_angular_radius;
use solaspect::units::ARCSEC_PER_RAD;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

const START: &str = "2013-09-21T18:00:00Z";
const SEED: u64 = 5;

/// The flight of `solaspect demo`.
fn telescope(instrument: &Instrument, duration: Duration) -> TelescopeFlight {
    let start: Timestamp = START.parse().unwrap();
    let radius_arcsec = sun_angular_radius(start).unwrap();
    let radius_mil = instrument.optics.radius_mil(radius_arcsec);
    let course = Trajectory::demo(instrument, radius_mil, duration, SEED).unwrap();
    TelescopeFlight::new(course, instrument, FORT_SUMNER, start, SEED).on(Gondola::Swinging)
}

/// Time since the start of the flight.
fn since(unix_s: f64) -> Duration {
    let start: Timestamp = START.parse().unwrap();
    Duration::from_secs_f64(unix_s - start.as_second() as f64)
}

/// The files in a folder whose names begin with `begins`.
fn files(folder: &Path, begins: &str) -> Vec<PathBuf> {
    let listed = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    let named = listed.filter(|entry| entry.file_name().to_string_lossy().starts_with(begins));
    named.map(|entry| entry.path()).collect()
}

/// The numbers of a table's rows, without the last column, which is text; rows with missing numbers are skipped.
fn numbers(file: &Path) -> Vec<Vec<f64>> {
    let text = fs::read_to_string(file).unwrap();
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let (_, cells) = cells.split_last().unwrap();
        cells.iter().map(|cell| cell.parse().ok()).collect()
    };
    text.lines().skip(1).filter_map(row).collect()
}

/// Errors of the attitude about two axes perpendicular to the Sun, each with its sigma, arcsec.
fn across_sun(row: &[f64], truth: &UnitQuaternion<f64>, sun: &Vector3<f64>) -> [[f64; 2]; 2] {
    let found = UnitQuaternion::from_quaternion(Quaternion::new(row[1], row[2], row[3], row[4]));
    let error = (truth * found.inverse()).scaled_axis();
    #[rustfmt::skip]
    let covariance = Matrix3::new(
        row[5].powi(2), row[8], row[9],
        row[8], row[6].powi(2), row[10],
        row[9], row[10], row[7].powi(2),
    );
    let first = sun.cross(&Vector3::z()).normalize();
    [first, sun.cross(&first)].map(|axis| {
        let sigma = axis.dot(&(covariance * axis)).sqrt();
        [axis.dot(&error), sigma].map(|rad| rad * ARCSEC_PER_RAD)
    })
}

/// Asserts that the mean square of `one` exceeds that of `other` by at most two of its standard errors; values are paired.
fn assert_no_worse(one: &[f64], other: &[f64]) {
    let count = one.len() as f64;
    let pairs = one.iter().zip(other);
    let grown: Vec<f64> = pairs.map(|(a, b)| a * a - b * b).collect();
    let mean = grown.iter().sum::<f64>() / count;
    let scatter = grown.iter().map(|by| (by - mean).powi(2)).sum::<f64>() / count;
    let standard_error = (scatter / count).sqrt();
    assert!(mean <= 2.0 * standard_error, "{mean} +- {standard_error}");
}

#[test]
fn between_frames_the_gyros_show_where_the_telescope_points() {
    let (archive, out) = (temporary(), temporary());
    let duration = Duration::from_secs(14);
    let settings = Demo::lasting(duration, archive.path(), SEED);
    demo::run(&settings, &mut None, |_| {}, || false).unwrap();
    let [imu, gps] = ["imu_", "gps_"].map(|begins| files(archive.path(), begins).remove(0));
    let calibrated = out.path().join("calibrated.toml");
    let [imu, gps, calibrated] = [&imu, &gps, &calibrated].map(|path| path.to_str().unwrap());
    let more = [
        "--imu",
        imu,
        "--gps",
        gps,
        "--aem",
        "--calibrated",
        calibrated,
    ];
    let output = refine(archive.path(), out.path(), &more);
    println!("{}", String::from_utf8_lossy(&output.stdout));

    let instrument = builtin("demo").unwrap();
    let mut flown = telescope(&instrument, duration);
    let attitude = numbers(&out.path().join("attitude.csv"));
    let frames = Columns::read(out.path(), "ASPECT");
    let columns = ["UNIX_S", "SUN_X_MIL", "SUN_Y_MIL"];
    let [times, x, y] = columns.map(|name| frames.floats(name));
    let qualities = frames.texts("QUALITY");
    let (mut alone, mut smoothed) = (Vec::new(), Vec::new());
    for (n, t_s) in times
        .iter()
        .enumerate()
        .filter(|(n, _)| qualities[*n] == "fine")
    {
        let nearest =
            |a: &&Vec<f64>, b: &&Vec<f64>| (a[0] - t_s).abs().total_cmp(&(b[0] - t_s).abs());
        let Some(row) = attitude.iter().min_by(nearest) else {
            continue;
        };
        if (row[0] - t_s).abs() > 0.01 {
            // The filter had not started.
            continue;
        }
        let true_place = flown.sun_on_plate(since(*t_s));
        let scale = instrument.optics.arcsec_per_mil();
        alone.extend([(x[n] - true_place.x) * scale, (y[n] - true_place.y) * scale]);
        let truth = flown.attitude(since(row[0])).unwrap();
        let seen = sun_in_telescope(flown.sun_on_plate(since(row[0])), &instrument);
        let errors = across_sun(row, &truth, &(truth * seen.into_inner()));
        smoothed.extend(errors.map(|[error, _]| error));
    }
    println!(
        "{} axes at frames: alone {:.3} arcsec rms, with the gyros {:.3}",
        alone.len(),
        rms(&alone),
        rms(&smoothed)
    );
    assert!(alone.len() > 60, "{}", alone.len());
    assert_no_worse(&smoothed, &alone);

    let offsets = numbers(&out.path().join("offsets.csv"));
    assert_eq!(offsets.len(), attitude.len());
    let (mut most, mut away, mut ratios) = (0.0f64, 0, Vec::new());
    for row in &offsets {
        let truth = flown.truth(since(row[0])).unwrap();
        let errors = [
            row[3] - truth.offset.cross_elevation_deg,
            row[2] - truth.offset.elevation_deg,
        ];
        for error in errors {
            most = most.max((error / row[4]).abs());
            ratios.push(error / row[4]);
        }
        let part = since(row[0]).as_secs_f64() / duration.as_secs_f64();
        away += usize::from((0.62..0.73).contains(&part));
    }
    println!(
        "{} offsets, {away} without the Sun: up to {most:.2} sigma off, rms {:.2} sigma",
        offsets.len(),
        rms(&ratios)
    );
    // 14 s at 100 Hz; the Sun is absent for 2.1 s.
    assert!(offsets.len() > 1100 && away > 140, "{away}");
    assert!(most < 5.0, "{most}");

    for name in ["attitude.fits", "attitude.aem"] {
        assert!(out.path().join(name).exists(), "{name}");
    }
    let page = fs::read_to_string(out.path().join("report.html")).unwrap();
    assert!(page.contains("Rows of the attitude"));
    let learnt = fs::read_to_string(calibrated).unwrap();
    assert!(
        learnt.contains("gyro_bias = [") && learnt.contains("[calibration]"),
        "{learnt}"
    );
    assert!(learnt.contains("date = 2013-09-21"), "{learnt}");

    let thinned = temporary();
    let more = [
        "--imu",
        imu,
        "--gps",
        gps,
        "--navigation",
        calibrated,
        "--rate",
        "10",
    ];
    refine(archive.path(), thinned.path(), &more);
    let rows = numbers(&thinned.path().join("offsets.csv"));
    assert!((rows.len() as f64 / offsets.len() as f64 - 0.1).abs() < 0.01);

    refuse_what_does_not_belong_together(archive.path(), [imu, gps]);
    read_what_a_power_cut_and_a_clock_have_left(archive.path(), [imu, gps], &attitude);
}

/// With bad rows in the flight's own logs, the other rows give a consistent attitude.
fn read_what_a_power_cut_and_a_clock_have_left(
    archive: &Path,
    [imu, gps]: [&str; 2],
    whole: &[Vec<f64>],
) {
    let (folder, out) = (temporary(), temporary());
    let damage = |path: &str, name: &str| {
        let text = fs::read_to_string(path).unwrap();
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        let (count, zeros) = (lines.len(), "\0".repeat(4096));
        lines[count / 4] += &zeros;
        let (_, cells) = lines[count / 3].split_once(',').unwrap();
        // One row has a time of another day.
        lines[count / 3] = format!("86400.5,{cells}");
        let number = lines[count / 2]
            .rfind(|c: char| c.is_ascii_digit())
            .unwrap();
        lines[count / 2].replace_range(number..=number, "x");
        let doubled = lines[count - 3].clone();
        lines.insert(count - 3, doubled);
        let cut = lines[count].len() / 2;
        lines[count].truncate(cut);
        let damaged = folder.path().join(name).to_str().unwrap().to_owned();
        fs::write(&damaged, lines.join("\n")).unwrap();
        damaged
    };
    let (imu, gps) = (damage(imu, "imu.csv"), damage(gps, "gps.csv"));
    let output = command(archive, out.path(), &["--imu", &imu, "--gps", &gps]);
    let output = { output }.output().unwrap();
    let report = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{report}");
    for file in ["imu.csv", "gps.csv"] {
        for kind in [
            "cut",
            "zero bytes",
            "unreadable",
            "repeated",
            "of another time",
        ] {
            let of_kind = |line: &&str| line.contains(file) && line.ends_with(kind);
            let lines: Vec<&str> = report.lines().filter(of_kind).collect();
            assert_eq!(lines.len(), 1, "{file} {kind}: {report}");
            assert!(lines[0].contains("1 row rejected"), "{lines:?}");
        }
    }
    let damaged = numbers(&out.path().join("attitude.csv"));
    let lost = whole.len() - damaged.len();
    assert!(lost < 30, "{lost} rows of {}", whole.len());
    for row in &damaged {
        let same = whole.iter().find(|other| other[0] == row[0]).unwrap();
        let apart: f64 = (1..5).map(|n| (row[n] - same[n]).powi(2)).sum();
        // An estimate from fewer data differs from that from all data by the difference of their variances; five fixes of fourteen are lost.
        let variance = |row: &[f64]| (5..8).map(|n| row[n].powi(2)).sum::<f64>();
        let (own, of_all) = (variance(row), variance(same));
        let sigma = (own - of_all).max(0.0).sqrt().max(0.1 * own.sqrt());
        assert!(2.0 * apart.sqrt() < 4.5 * sigma, "{row:?} and {same:?}");
    }
}

/// Files of another time are refused; files of one flight are accepted in any order.
fn refuse_what_does_not_belong_together(archive: &Path, [imu, gps]: [&str; 2]) {
    let folder = temporary();
    let file = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let text = fs::read_to_string(imu).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let write = |name: &str, lines: &[&str]| {
        fs::write(file(name), lines.join("\n") + "\n").unwrap();
    };
    let head = [lines[0]];
    write("first.csv", &lines[..600]);
    write("second.csv", &[&head, &lines[600..]].concat());
    let nav = file("NAV.toml");
    let flown = files(archive, "navigation_").remove(0);
    let flown = fs::read_to_string(flown).unwrap();
    fs::write(
        &nav,
        format!("epoch_utc = \"2013-09-20T18:00:00Z\"\n{flown}"),
    )
    .unwrap();
    let (first, second) = (file("first.csv"), file("second.csv"));
    for (more, wanted) in [
        (
            &["--imu", imu, "--gps", gps, "--navigation", &nav][..],
            vec!["expected frames", "2013-09-20T18:00:00Z"],
        ),
        (&["--imu", imu][..], vec!["--gps"]),
    ] {
        let output = command(archive, &folder.path().join("out"), more)
            .output()
            .unwrap();
        let report = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success(), "{more:?}");
        for word in wanted {
            assert!(report.contains(word), "{report} lacks {word}");
        }
    }
    let [whole, parts] = [temporary(), temporary()];
    refine(archive, whole.path(), &["--imu", imu, "--gps", gps]);
    refine(
        archive,
        parts.path(),
        &["--imu", &second, &first, "--gps", gps],
    );
    let [whole, parts] =
        [whole, parts].map(|out| fs::read(out.path().join("offsets.csv")).unwrap());
    assert!(whole == parts);
}
