//! The pointing of a refined flight's telescope at any time: photons are mapped to their origin on the Sun with calibrated
//! uncertainties, and cameras that contradict the gyros are detected.

use crate::common::refined::{Columns, command, refine, rms, summary, temporary};
use crate::common::sun_picture::SunPicture;
use crate::events::image::read as read_sun_image;
use crate::events::lists::{Bench, event_table};
use jiff::{SignedDuration, Timestamp};
use nalgebra::{Matrix2x3, UnitVector3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use solaspect::archive::Store;
use solaspect::fits::{self, Compression, Values};
use solaspect::geometry::earth::{ecef_m, geodetic, north_east_up};
use solaspect::instrument::{DEMO_HORIZON, DEMO_NAVIGATION, MountedCamera, builtin};
use solaspect::pointing::{HelioprojectiveArcsec, solar_north, sun_direction};
use solaspect::pointing_history::{Invalid, PointingHistory};
use solaspect::simulate::earth::SwingingGondola;
use solaspect::simulate::navigation::TelescopeFlight;
use solaspect::simulate::{FORT_SUMNER, FlightScenes, Gondola, Trajectory};
use solaspect::sky::{Ephemeris, sun_angular_radius};
use solaspect::units::ARCSEC_PER_RAD;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::{Duration, Instant};
use tempfile::TempDir;

const START: &str = "2013-09-21T18:00:00Z";
const RATE_HZ: f64 = 4.0;

fn start() -> Timestamp {
    START.parse().unwrap()
}

fn utc(since: Duration) -> Timestamp {
    start() + SignedDuration::try_from(since).unwrap()
}

/// A flight: its gondola's motion, duration and seed.
#[derive(Clone, Copy)]
struct Plan {
    gondola: Gondola,
    duration: Duration,
    seed: u64,
}

impl Plan {
    /// The demo's trajectory, in which the Sun is absent from 60 to 75 % of the time; a longer flight has slews, and gaps of 45 s.
    fn course(&self) -> Trajectory {
        const SHORT: Duration = Duration::from_secs(600);
        let instrument = builtin("demo").unwrap();
        let (radius_mil, seed) = (radius_mil(), self.seed);
        match self.duration < SHORT {
            true => Trajectory::demo(&instrument, radius_mil, self.duration, seed).unwrap(),
            false => Trajectory::flight(&instrument, radius_mil, seed).unwrap(),
        }
    }

    fn telescope(&self) -> TelescopeFlight {
        let instrument = builtin("demo").unwrap();
        let flight =
            TelescopeFlight::new(self.course(), &instrument, FORT_SUMNER, start(), self.seed);
        flight.on(self.gondola)
    }

    fn frames(&self) -> u64 {
        (self.duration.as_secs_f64() * RATE_HZ) as u64
    }

    fn write_sun(&self, folder: &Path) {
        let instrument = builtin("demo").unwrap();
        let scenes = FlightScenes::new(&instrument, self.course(), radius_mil(), self.seed);
        let scenes = scenes.unwrap();
        fs::create_dir_all(folder).unwrap();
        (0..self.frames()).into_par_iter().for_each(|n| {
            let mut scene = scenes.scene(n, taken(n)).unwrap();
            scene.info.mid_exposure = Some(utc(taken(n)));
            scene.info.monotonic = Some(Duration::from_secs(5000) + taken(n));
            scene.info.place = Some(FORT_SUMNER);
            let path = folder.join(format!("frame_{n:06}.fits"));
            fits::write_frame(&path, &scene.frame().unwrap(), &[], &[], Compression::Rice).unwrap();
        });
    }

    fn write_horizon(&self, folder: &Path) {
        let camera = MountedCamera::parse(Path::new("demo-horizon"), DEMO_HORIZON).unwrap();
        let gondola = SwingingGondola::new(&camera, &FORT_SUMNER, self.seed);
        let store = Store::open(folder, "roll", Compression::Rice).unwrap();
        (0..self.frames()).into_par_iter().for_each(|n| {
            let mut frame = gondola.scene(n, taken(n), 1.0).frame().unwrap();
            frame.info.mid_exposure = Some(utc(taken(n)));
            frame.info.monotonic = Some(Duration::from_secs(5000) + taken(n));
            frame.info.place = Some(FORT_SUMNER);
            store.write(&frame, &[], &[]).unwrap();
        });
    }

    /// Writes `imu.csv` and `gps.csv`.
    fn write_sensors(&self, folder: &Path) {
        let mut telescope = self.telescope();
        let mut imu = String::from("t_s,fx_m_s2,fy_m_s2,fz_m_s2,wx_rad_s,wy_rad_s,wz_rad_s\n");
        for n in 1..=self.duration.as_secs() * telescope.rate_hz() {
            let sample = telescope.sample(n).unwrap();
            let (t_s, [fx, fy, fz]) = (unix_s(sample.time), sample.force_m_s2);
            let [wx, wy, wz] = sample.rate_rad_s;
            writeln!(imu, "{t_s:.6},{fx},{fy},{fz},{wx},{wy},{wz}").unwrap();
        }
        fs::write(folder.join("imu.csv"), imu).unwrap();
        let mut gps = String::from("t_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s\n");
        let mut random = Xoshiro256PlusPlus::seed_from_u64(self.seed);
        let at = ecef_m(&FORT_SUMNER);
        for second in 0..=self.duration.as_secs() {
            let mut normal = |sigma: f64| -> [f64; 3] {
                [(); 3].map(|()| sigma * random.sample::<f64, _>(StandardNormal))
            };
            let [x, y, z] = (at + Vector3::from(normal(5.0))).into();
            let [vx, vy, vz] = normal(0.05);
            let t_s = start().as_second() as u64 + second;
            writeln!(gps, "{t_s},{x},{y},{z},{vx},{vy},{vz}").unwrap();
        }
        fs::write(folder.join("gps.csv"), gps).unwrap();
    }
}

fn radius_mil() -> f64 {
    let radius_arcsec = sun_angular_radius(start()).unwrap();
    builtin("demo").unwrap().optics.radius_mil(radius_arcsec)
}

fn taken(n: u64) -> Duration {
    Duration::from_secs_f64((n as f64 + 0.5) / RATE_HZ)
}

fn unix_s(utc: Timestamp) -> f64 {
    utc.as_duration().as_secs_f64()
}

const SHORT: Plan = Plan {
    gondola: Gondola::Swinging,
    duration: Duration::from_secs(40),
    seed: 3,
};

/// A short flight with roll camera, IMU and GPS: the folder of its files, and the output of `refine`.
fn flight() -> &'static (TempDir, PathBuf) {
    static FLIGHT: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    FLIGHT.get_or_init(|| {
        let root = temporary();
        write(&SHORT, root.path());
        let out = root.path().join("out");
        refine(&root.path().join("archive"), &out, &options(root.path()));
        (root, out)
    })
}

fn write(plan: &Plan, root: &Path) {
    plan.write_sun(&root.join("archive/sun"));
    plan.write_horizon(&root.join("archive/roll"));
    plan.write_sensors(root);
    fs::write(root.join("NAV.toml"), DEMO_NAVIGATION).unwrap();
    fs::write(root.join("CAM.toml"), DEMO_HORIZON).unwrap();
}

/// Options that name the sensor files of a folder.
fn options(root: &Path) -> Vec<&'static str> {
    let of = [
        ("--imu", "imu.csv"),
        ("--gps", "gps.csv"),
        ("--navigation", "NAV.toml"),
        ("--roll-camera", "CAM.toml"),
    ];
    let named = of.into_iter().flat_map(|(option, file)| {
        let path = root.join(file).to_str().unwrap().to_owned();
        [option, path.leak()]
    });
    named.collect()
}

/// A photon traced back to the Sun: error and 1 sigma along the telescope's right and up axes, arcsec.
struct PutBack {
    source: &'static str,
    is_valid: bool,
    /// Distance from the boresight.
    away_arcsec: f64,
    error: [f64; 2],
    sigma: [f64; 2],
}

/// Number of random times, and of photons at each.
#[derive(Clone, Copy)]
struct Drawn {
    times: usize,
    each: usize,
}

const FEW: Drawn = Drawn {
    times: 10_000,
    each: 2,
};

/// Traces back photons from random positions on the Sun at random times.
fn put_back(plan: &Plan, history: &PointingHistory, drawn: Drawn) -> Vec<PutBack> {
    let (mut telescope, mut ephemeris) = (plan.telescope(), Ephemeris::default());
    let mut random = Xoshiro256PlusPlus::seed_from_u64(plan.seed + 100);
    let to_earth = north_east_up(&ecef_m(&FORT_SUMNER));
    let mut put_back = Vec::new();
    for _ in 0..drawn.times {
        let since = Duration::from_secs_f64(random.random_range(0.0..plan.duration.as_secs_f64()));
        let pointed = history.at(unix_s(utc(since)));
        let Some(line_of_sight) = pointed.line_of_sight else {
            continue;
        };
        let sun = ephemeris.sun(utc(since), FORT_SUMNER).unwrap();
        let [centre, north] = [sun_direction(&sun), solar_north(&sun)].map(|v| to_earth * v);
        let truth = telescope.attitude(since).unwrap();
        for _ in 0..drawn.each {
            let [x, y] = [(); 2].map(|()| random.random_range(-900.0..900.0));
            let from = HelioprojectiveArcsec { x, y };
            let along = from.direction();
            let towards = centre * along.x + centre.cross(&north) * along.y + north * along.z;
            let seen = truth.inverse_transform_vector(&towards);
            let found = line_of_sight.helioprojective(&UnitVector3::new_normalize(seen));
            let (right, up) = (seen.y / seen.x, -seen.z / seen.x);
            let by_pointing = Matrix2x3::new(1.0, 0.0, up, 0.0, 1.0, -right);
            let covariance = by_pointing * line_of_sight.random_arcsec2 * by_pointing.transpose();
            // Solar west and north in the telescope's axes.
            let (sin, cos) = line_of_sight.north_angle_deg.to_radians().sin_cos();
            let [west, north] = [found.x - from.x, found.y - from.y];
            put_back.push(PutBack {
                source: line_of_sight.basis.name(),
                is_valid: pointed.is_valid(),
                away_arcsec: right.hypot(up).to_degrees() * 3600.0,
                error: [west * cos - north * sin, west * sin + north * cos],
                sigma: [covariance.m11.sqrt(), covariance.m22.sqrt()],
            });
        }
    }
    put_back
}

/// Prints and returns the rms error (arcsec), the rms of error over sigma, both over both axes, and the largest error over sigma.
fn judged<'a>(name: &str, photons: impl Iterator<Item = &'a PutBack>) -> [f64; 3] {
    let (mut errors, mut ratios) = (Vec::new(), Vec::new());
    for photon in photons {
        errors.extend(photon.error);
        ratios.extend([0, 1].map(|axis| photon.error[axis] / photon.sigma[axis]));
    }
    let worst = ratios
        .iter()
        .fold(0.0_f64, |most, ratio| most.max(ratio.abs()));
    let of = [rms(&errors), rms(&ratios), worst];
    println!(
        "{name}: {} photons, {:.3} arcsec rms, {:.2} sigma rms, at most {:.1}",
        errors.len() / 2,
        of[0],
        of[1],
        of[2]
    );
    of
}

#[test]
fn photons_come_back_to_where_on_the_sun_they_came_from() {
    let (_, out) = flight();
    let history = PointingHistory::read(out).unwrap();
    let photons = put_back(&SHORT, &history, FEW);
    let valid = || photons.iter().filter(|photon| photon.is_valid);
    let near = valid().filter(|photon| photon.source == "both" && photon.away_arcsec < 500.0);
    let [error, ratio, _] = judged("near the boresight", near);
    // The filter has just started; an hour gives smaller errors.
    assert!(error < 0.3 && (0.6..1.25).contains(&ratio));
    let with_sun = valid().filter(|photon| photon.source == "both");
    let [_, ratio, _] = judged("with the Sun", with_sun);
    assert!((0.6..1.25).contains(&ratio), "{ratio}");
    let in_gap: Vec<&PutBack> = photons.iter().filter(|p| p.source == "gyros").collect();
    judged("in the gap", in_gap.iter().copied());
    assert!(in_gap.len() > 300, "{}", in_gap.len());
    let [_, _, worst] = judged("all that are valid", valid());
    assert!(worst < 6.0, "{worst}");
    assert!(valid().count() > photons.len() / 2);
}

#[test]
fn gyros_sun_and_horizon_agree_on_a_gondola_that_swings() {
    let (_, out) = flight();
    let cameras_against_gyros = &summary(out)["cameras_against_gyros"];
    let axes = cameras_against_gyros["axes"].as_array().unwrap();
    assert_eq!(axes.len(), 3);
    for axis in axes {
        let [rms, most] = ["rms_over_sigma", "most_over_sigma"].map(|key| axis[key].as_f64());
        assert!(rms.unwrap() < 1.25 && most.unwrap() < 5.0, "{axis}");
        assert!(axis["frames"].as_u64().unwrap() > 100, "{axis}");
    }
    assert!(
        cameras_against_gyros["findings"]
            .as_array()
            .unwrap()
            .is_empty()
    );
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("Gyros against Sun and horizon"));
}

#[test]
fn the_report_shows_the_pointing_and_the_time_near_the_target_is_that_of_the_table() {
    let (_, out) = flight();
    let table = Columns::read(out, "POINTING");
    let [x, y] = ["HPLN", "HPLT"].map(|name| table.floats(name));
    let valid: Vec<usize> = (0..x.len())
        .filter(|n| table.texts("INVALID")[*n].is_empty())
        .collect();
    // The target is the disc's centre.
    let mut far: Vec<f64> = valid.iter().map(|n| x[*n].hypot(y[*n])).collect();
    far.sort_by(f64::total_cmp);
    let within_s = |limit: f64| far.partition_point(|far| *far <= limit) as f64 / 10.0;
    let found = &summary(out)["on_target"];
    for (key, truth) in [
        ("valid_s", valid.len() as f64 / 10.0),
        ("within_20_arcsec_s", within_s(20.0)),
        ("within_60_arcsec_s", within_s(60.0)),
        ("median_arcsec", far[far.len() / 2]),
    ] {
        let found = found[key].as_f64().unwrap();
        assert!(
            (found - truth).abs() < 0.01 * truth + 1e-9,
            "{key}: {found} {truth}"
        );
    }
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    for text in [
        "Where the telescope pointed on the Sun",
        "The boresight on the Sun",
        "Dwell in squares of",
        "Distance from the target",
        "<td>1 arcmin</td>",
    ] {
        assert!(page.contains(text), "{text}");
    }
}

#[test]
fn a_horizon_that_contradicts_the_gyros_is_a_finding_and_such_a_pointing_is_not_valid() {
    let (root, _) = flight();
    let out = temporary();
    // The roll camera is rotated by 0.5 deg with respect to its file.
    let turned = root.path().join("turned.toml");
    fs::write(&turned, turned_horizon(0.5)).unwrap();
    let mut options = options(root.path());
    let camera = options.iter().position(|option| *option == "--roll-camera");
    options[camera.unwrap() + 1] = turned.to_str().unwrap();
    let output = command(&root.path().join("archive"), out.path(), &options);
    let output = { output }.output().unwrap();
    let [printed, warned] =
        [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text));
    assert!(
        printed.contains("the horizon contradicts the gyros in roll"),
        "{printed}"
    );
    assert!(
        warned.contains("the horizon contradicts the gyros in roll"),
        "{warned}"
    );
    let findings = &summary(out.path())["cameras_against_gyros"]["findings"];
    assert_eq!(findings[0]["axis"], "roll");
    let reasons = Columns::read(out.path(), "POINTING");
    let reasons = reasons.texts("INVALID");
    let contradicted = reasons
        .iter()
        .filter(|reason| *reason == "contradicted")
        .count();
    assert!(
        contradicted > reasons.len() / 2,
        "{contradicted} of {}",
        reasons.len()
    );
}

#[test]
fn gyros_that_slip_are_contradicted_by_the_sun_and_then_no_pointing_is_valid() {
    let (root, _) = flight();
    let out = temporary();
    // During the 11th second the gyros add 100 arcsec about the telescope's down axis, to the right. The Sun is visible until the 24th.
    let slipping = root.path().join("slipping.csv");
    let text = fs::read_to_string(root.path().join("imu.csv")).unwrap();
    let slipped = |(n, line): (usize, &str)| {
        let (rest, last) = line.rsplit_once(',').unwrap();
        match (1001..=1100).contains(&n) {
            true => format!(
                "{rest},{}\n",
                last.parse::<f64>().unwrap() + 100.0 / ARCSEC_PER_RAD
            ),
            false => format!("{line}\n"),
        }
    };
    let text: String = text.lines().enumerate().map(slipped).collect();
    fs::write(&slipping, text).unwrap();
    let mut options = options(root.path());
    options[1] = slipping.to_str().unwrap();
    refine(&root.path().join("archive"), out.path(), &options);
    let summary = summary(out.path());
    let findings = summary["cameras_against_gyros"]["findings"]
        .as_array()
        .unwrap();
    assert!(
        findings.iter().any(|one| one["axis"] == "right"),
        "{findings:?}"
    );
    let most = summary["cameras_against_gyros"]["axes"][0]["most_over_sigma"]
        .as_f64()
        .unwrap();
    assert!(most > 20.0, "{most}");
    let table = Columns::read(out.path(), "POINTING");
    let (times_s, reasons) = (table.floats("UNIX_S"), table.texts("INVALID"));
    let during = times_s.iter().zip(reasons);
    let since = |time_s: f64| time_s - unix_s(start());
    let mut during = during.filter(|(time_s, _)| (12.0..22.0).contains(&since(**time_s)));
    assert!(during.all(|(_, reason)| reason == "contradicted"));
}

/// The demo's horizon camera, rotated about the body's forward axis.
fn turned_horizon(deg: f64) -> String {
    let camera = MountedCamera::parse(Path::new("demo-horizon"), DEMO_HORIZON).unwrap();
    let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::x_axis(), deg.to_radians());
    let turned = turn * camera.body_from_camera;
    let row = |n: usize| format!("{:?}", turned.matrix().row(n).iter().collect::<Vec<_>>());
    let rows = format!("[{}, {}, {}]", row(0), row(1), row(2));
    let mut text: toml::Table = DEMO_HORIZON.parse().unwrap();
    let camera = text["camera"].as_table_mut().unwrap();
    let rows: toml::Table = format!("turn = {rows}").parse().unwrap();
    camera.insert("body_from_camera".into(), rows["turn"].clone());
    text.to_string()
}

#[test]
fn tables_of_any_rate_hold_what_the_states_say() {
    let (root, out) = flight();
    let other = temporary();
    let mut options = options(root.path());
    options.extend(["--pointing-rate", "3", "--rate", "7"]);
    refine(&root.path().join("archive"), other.path(), &options);
    let states = |folder: &Path| fs::read(folder.join("pointing.fits")).unwrap();
    assert!(states(out) == states(other.path()));
    let history = PointingHistory::read(out).unwrap();
    for folder in [out, other.path()] {
        let table = Columns::read(folder, "POINTING");
        let columns: BTreeMap<&str, &[f64]> =
            ["UNIX_S", "TIME", "HPLN", "NORTH_ANGLE", "ROLL", "VAR_UP"]
                .map(|name| (name, table.floats(name)))
                .into();
        let times_s = columns["UNIX_S"];
        assert!(times_s.len() > 100);
        for (n, time_s) in times_s.iter().enumerate() {
            let Some(line_of_sight) = history.at(*time_s).line_of_sight else {
                assert!(columns["HPLN"][n].is_nan());
                continue;
            };
            for (name, value) in [
                ("HPLN", line_of_sight.helioprojective_arcsec.x),
                ("NORTH_ANGLE", line_of_sight.north_angle_deg),
                ("ROLL", line_of_sight.roll_deg),
                ("VAR_UP", line_of_sight.random_arcsec2.m22),
            ] {
                assert!((columns[name][n] - value).abs() < 1e-7, "{name}");
            }
        }
        let midnight = start().as_second() / 86_400 * 86_400;
        assert!((times_s[0] - columns["TIME"][0] - midnight as f64).abs() < 1e-6);
    }
    follow_from_them(other.path(), &history);
}

/// Checks that the offsets of the stabilisation table follow from the pointing history.
fn follow_from_them(folder: &Path, history: &PointingHistory) {
    let table = Columns::of(&folder.join("stabilisation.fits"), "STABILISATION");
    let [times_s, across, up] =
        ["UNIX_S", "OFFSET_XEL_DEG", "OFFSET_EL_DEG"].map(|name| table.floats(name));
    let Values::Logical(valid) = table.values("VALID") else {
        panic!("VALID");
    };
    let (mut known, mut ephemeris) = (0, Ephemeris::default());
    for (n, time_s) in times_s.iter().enumerate() {
        let pointed = history.at(*time_s);
        let Some(line_of_sight) = pointed.line_of_sight else {
            assert!(across[n].is_nan() && !valid[n]);
            continue;
        };
        // The target is the Sun's centre.
        let at = start() + SignedDuration::from_secs_f64(time_s - unix_s(start()));
        let place = geodetic(&history.position_m(*time_s).unwrap()).unwrap();
        let sun = ephemeris.sun(at, place).unwrap();
        let away_deg = line_of_sight.horizontal.azimuth_deg - sun.azimuth_deg;
        let sine =
            away_deg.to_radians().sin() * line_of_sight.horizontal.elevation_deg.to_radians().cos();
        // The place is that of the second, known by GPS to a few metres.
        assert!((across[n] - sine.asin().to_degrees()).abs() * 3600.0 < 0.05);
        let above_deg = line_of_sight.horizontal.elevation_deg - sun.elevation_deg;
        assert!((up[n] - above_deg).abs() * 3600.0 < 0.05);
        assert_eq!(valid[n], pointed.invalid != Some(Invalid::Contradicted));
        known += 1;
    }
    assert!(known > times_s.len() / 2);
}

#[test]
fn without_gyros_and_horizon_the_suns_own_path_puts_them_back() {
    let plan = Plan {
        gondola: Gondola::Still,
        ..SHORT
    };
    let (root, _) = flight();
    let alone = temporary();
    refine(&root.path().join("archive/sun"), alone.path(), &[]);
    let history = PointingHistory::read(alone.path()).unwrap();
    let photons = put_back(&plan, &history, FEW);
    assert!(photons.iter().all(|photon| photon.source == "sun"));
    let [error, ratio, worst] = judged("by the Sun alone", photons.iter().filter(|p| p.is_valid));
    assert!(error < 0.3 && worst < 6.0);
    assert!((0.4..1.25).contains(&ratio), "{ratio}");
}

/// Whether a frame of the Sun is removed from the hour's flight: one minute in each quarter of an hour, which includes the 45 s without the Sun.
fn is_taken_away(since: Duration) -> bool {
    (540.0..600.0).contains(&(since.as_secs_f64() % 900.0))
}

const HOUR: Plan = Plan {
    duration: Duration::from_secs(3600),
    ..SHORT
};

/// The flight of an hour, simulated once and kept for the next run.
fn hour() -> PathBuf {
    let root = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("an-hour-of-photons");
    if !root.join("whole").exists() {
        write(&HOUR, &root);
        fs::write(root.join("whole"), "").unwrap();
    }
    for n in (0..HOUR.frames()).filter(|n| is_taken_away(taken(*n))) {
        let _ = fs::remove_file(root.join(format!("archive/sun/frame_{n:06}.fits")));
    }
    root
}

/// Photons drawn from a picture of the Sun: time since the start (s), offset right and up of the true boresight (arcsec), detector id.
fn photons_of(plan: &Plan, picture: &SunPicture, drawn: Drawn) -> Vec<[f64; 4]> {
    let (mut telescope, mut ephemeris) = (plan.telescope(), Ephemeris::default());
    let mut random = Xoshiro256PlusPlus::seed_from_u64(plan.seed + 200);
    let to_earth = north_east_up(&ecef_m(&FORT_SUMNER));
    let mut photons = Vec::with_capacity(drawn.times * drawn.each);
    for _ in 0..drawn.times {
        let since = Duration::from_secs_f64(random.random_range(0.0..plan.duration.as_secs_f64()));
        let sun = ephemeris.sun(utc(since), FORT_SUMNER).unwrap();
        let [centre, north] = [sun_direction(&sun), solar_north(&sun)].map(|v| to_earth * v);
        let truth = telescope.attitude(since).unwrap();
        for _ in 0..drawn.each {
            let [x, y] = picture.draw(&mut random);
            let along = HelioprojectiveArcsec { x, y }.direction();
            let towards = centre * along.x + centre.cross(&north) * along.y + north * along.z;
            let seen = truth.inverse_transform_vector(&towards);
            let [right, up] = [seen.y / seen.x, -seen.z / seen.x].map(|tan| tan * ARCSEC_PER_RAD);
            photons.push([since.as_secs_f64(), right, up, 1.0]);
        }
    }
    photons
}

/// `cargo test --release --test promises -- --ignored an_hour_of_photons --nocapture`.
#[test]
#[ignore = "an hour of flight takes many minutes to simulate"]
fn an_hour_of_photons_makes_the_picture_that_they_came_from() {
    const DETECTOR: &str = "[[detector]]\nscale_arcsec = 1.0\ncentre = [0, 0]\nrotation_deg = 0\n\
                            field = [[-1300, 1300], [-1300, 1300]]\n";
    let root = hour();
    let out = root.join("all");
    if !out.join("pointing.fits").exists() {
        refine(&root.join("archive"), &out, &options(&root));
    }
    let picture = SunPicture::of_radius(sun_angular_radius(start()).unwrap());
    let many = Drawn {
        times: 100_000,
        each: 100,
    };
    let photons = photons_of(&HOUR, &picture, many);
    let bench = Bench::new(&PointingHistory::read(&out).unwrap());
    let list = [event_table(&photons)];
    drop(photons);
    let began = Instant::now();
    let placed = bench.image(DETECTOR, &list, &bench.request()).unwrap();
    println!(
        "{:?} in {:.1} s",
        placed.image,
        began.elapsed().as_secs_f64()
    );
    let found = read_sun_image(&bench.at("image.fits")).registered(&picture);
    println!("{found:?}");
    found.assert_close();
}

/// `cargo test --release --test promises -- --ignored an_hour_of_photons --nocapture`.
#[test]
#[ignore = "an hour of flight takes many minutes to simulate"]
fn an_hour_of_photons_comes_back_with_honest_sigmas() {
    let (plan, root) = (HOUR, hour());
    let options = options(&root);
    let many = Drawn {
        times: 100_000,
        each: 100,
    };
    let photons = |name: &str, archive: &str, options: &[&str], gondola: Gondola| {
        let out = root.join(name);
        refine(&root.join(archive), &out, options);
        println!("{name}: {}", summary(&out)["cameras_against_gyros"]);
        let history = PointingHistory::read(&out).unwrap();
        put_back(&Plan { gondola, ..plan }, &history, many)
    };
    let near = |photon: &&PutBack| photon.away_arcsec < 100.0;

    let all = photons("all", "archive", &options, Gondola::Swinging);
    let valid = || all.iter().filter(|photon| photon.is_valid);
    let by = |source: &'static str| valid().filter(move |photon| photon.source == source);
    let [error, ratio, _] = judged("the Sun seen, within 100 arcsec", by("both").filter(near));
    let [_, far, _] = judged("the Sun seen", by("both"));
    let [_, in_gaps, _] = judged("in gaps", by("gyros"));
    let [_, _, worst] = judged("all that are valid", valid());
    println!("{} of {} are valid", valid().count(), all.len());
    assert!(error < 0.15, "{error}");
    for ratio in [ratio, far, in_gaps] {
        assert!((0.8..1.25).contains(&ratio), "{ratio}");
    }
    assert!(worst < 6.0, "{worst}");

    let (gyros, camera) = options.split_at(6);
    for (name, archive, options, gondola) in [
        (
            "without roll camera",
            "archive/sun",
            gyros,
            Gondola::Swinging,
        ),
        ("without gyros", "archive", camera, Gondola::Swinging),
        ("by the Sun alone", "archive/sun", &[], Gondola::Still),
    ] {
        let photons = photons(name, archive, options, gondola);
        let valid = || photons.iter().filter(|photon| photon.is_valid);
        judged(&format!("{name}, within 100 arcsec"), valid().filter(near));
        // Between frames during slews, the path alone may have slightly larger errors.
        let [_, ratio, worst] = judged(name, valid());
        println!("{} of {} are valid", valid().count(), photons.len());
        assert!((0.4..1.25).contains(&ratio), "{ratio}");
        assert!(worst < 8.0, "{worst}");
    }
}
