//! The roll camera's orientation on the body is determined from a known attitude, and in flight from the Sun, with
//! calibrated uncertainties in the file.

use crate::common::refined::{rms, temporary};
use jiff::{SignedDuration, Timestamp};
use nalgebra::{Matrix3, Rotation3, UnitVector3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use solaspect::archive::Store;
use solaspect::calibrate::roll_camera::{Horizon, HorizonObservation, Known, fit};
use solaspect::fits::Compression;
use solaspect::geometry::attitude::Direction;
use solaspect::geometry::camera::CameraModel;
use solaspect::instrument::{Instrument, MountedCamera, builtin};
use solaspect::pointing::{Horizontal, Roll, sun_on_plate};
use solaspect::simulate::earth::{EarthConditions, EarthScene};
use solaspect::simulate::{FORT_SUMNER, Noise, Scene, Sun};
use solaspect::sky::Ephemeris;
use solaspect::units::{Measured, SensorPx};
use std::f64::consts::TAU;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Attitude of the body: heading from north over east, pitch and roll, deg.
#[derive(Clone, Copy)]
struct Attitude {
    heading_deg: f64,
    pitch_deg: f64,
    roll_deg: f64,
}

impl Attitude {
    /// Rotation from (north, east, down) to (forward, right, down).
    fn body_from_local(&self) -> Rotation3<f64> {
        let about = |axis, deg: f64| Rotation3::from_axis_angle(&axis, deg.to_radians());
        let local_from_body = about(Vector3::z_axis(), self.heading_deg)
            * about(Vector3::y_axis(), self.pitch_deg)
            * about(Vector3::x_axis(), self.roll_deg);
        local_from_body.inverse()
    }
}

fn local(azimuth_deg: f64, elevation_deg: f64) -> Vector3<f64> {
    let (sin_a, cos_a) = azimuth_deg.to_radians().sin_cos();
    let (sin_e, cos_e) = elevation_deg.to_radians().sin_cos();
    Vector3::new(cos_e * cos_a, cos_e * sin_a, -sin_e)
}

/// Attitude of a telescope that sweeps over the Sun while the gondola swings.
fn sweep(time_s: f64, sun: Horizontal, across_deg: f64) -> Attitude {
    let swing = |deg: f64, period_s: f64| deg * (TAU * time_s / period_s).sin();
    Attitude {
        heading_deg: sun.azimuth_deg + swing(across_deg, 20.0),
        pitch_deg: sun.elevation_deg + swing(0.2, 13.0),
        roll_deg: 1.0 + swing(1.2, 12.3) + swing(0.3, 3.7),
    }
}

/// A camera that points forward and `down_deg` below the telescope's axis; `off_deg` rotates it about the body's axes.
fn body_from_camera(down_deg: f64, off_deg: [f64; 3]) -> Rotation3<f64> {
    let forward = Matrix3::new(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0);
    let down = Rotation3::from_axis_angle(&Vector3::y_axis(), -down_deg.to_radians());
    let off = Rotation3::new(Vector3::from(off_deg.map(f64::to_radians)));
    off * down * Rotation3::from_matrix_unchecked(forward)
}

/// Error over sigma about each of the body's axes.
fn errors(found: &Rotation3<f64>, truth: &Rotation3<f64>, sigmas_deg: [f64; 3]) -> [f64; 3] {
    let error = (found * truth.inverse()).scaled_axis();
    std::array::from_fn(|n| error[n].to_degrees() / sigmas_deg[n])
}

/// Observations over ten minutes; each nadir has an independent error and one common to all, both perpendicular to the nadir.
fn observations(seed: u64, truth: &Rotation3<f64>, by_sun: bool) -> Vec<HorizonObservation> {
    const STEP_S: f64 = 0.25;
    // Values for frames of 1920 x 1080 px and a limb that varies by 2 % in brightness and 100 m in height.
    const OWN_DEG: f64 = 0.0043;
    const SHARED_DEG: f64 = 0.01;
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut normal = |deg: f64| {
        let parts: [f64; 3] = std::array::from_fn(|_| StandardNormal.sample(&mut random));
        Vector3::from(parts) * deg.to_radians()
    };
    let shared = normal(SHARED_DEG);
    let start: Timestamp = "2013-09-21T18:00:00Z".parse().unwrap();
    let observation = |n: u32| {
        let time_s = f64::from(n) * STEP_S;
        let sun = Horizontal {
            azimuth_deg: 180.0 + time_s / 240.0,
            elevation_deg: 40.0 + time_s / 600.0,
        };
        let attitude = sweep(time_s, sun, 0.7).body_from_local();
        let down = attitude * Vector3::z();
        let seen = truth.inverse() * down + shared + normal(OWN_DEG);
        let sigma_rad = OWN_DEG.hypot(SHARED_DEG).to_radians();
        let unit = |v: Vector3<f64>| UnitVector3::new_normalize(v);
        HorizonObservation {
            horizon: Horizon {
                file: format!("{n}").into(),
                utc: start + SignedDuration::from_secs_f64(time_s),
                nadir: Direction::new(unit(seen), sigma_rad),
            },
            known: match by_sun {
                true => Known::Sun {
                    unit: unit(attitude * local(sun.azimuth_deg, sun.elevation_deg)),
                    elevation_deg: sun.elevation_deg,
                },
                false => Known::Nadir(unit(down)),
            },
        }
    };
    (0..2400).map(observation).collect()
}

#[test]
fn the_turn_of_ten_minutes_is_known_to_two_hundredths_of_a_degree_and_as_well_as_it_says() {
    const FLIGHTS: u64 = 60;
    let nominal = body_from_camera(40.0, [0.0; 3]);
    for by_sun in [false, true] {
        let of_flight = |seed: u64| {
            let truth = body_from_camera(40.0, [2.0, -1.5, 1.0]);
            let turn = fit(&observations(seed, &truth, by_sun), &nominal).unwrap();
            let sigmas_deg = turn.sigmas_deg();
            let ratios = errors(&turn.body_from_camera, &truth, sigmas_deg);
            (ratios, std::array::from_fn(|n| ratios[n] * sigmas_deg[n]))
        };
        let flights: Vec<([f64; 3], [f64; 3])> =
            (0..FLIGHTS).into_par_iter().map(of_flight).collect();
        for axis in 0..3 {
            let ratio = rms(&flights.iter().map(|f| f.0[axis]).collect::<Vec<_>>());
            let rms_deg = rms(&flights.iter().map(|f| f.1[axis]).collect::<Vec<_>>());
            println!("by Sun {by_sun}, axis {axis}: {rms_deg:.4} deg, error/sigma {ratio:.2}");
            assert!((0.8..1.25).contains(&ratio), "{by_sun} {axis} {ratio}");
            assert!(rms_deg < 0.02, "{by_sun} {axis} {rms_deg}");
        }
    }
}

#[test]
fn a_sun_that_stays_in_one_place_does_not_determine_the_turn_about_it_and_the_error_says_what_would()
 {
    let truth = body_from_camera(40.0, [0.5, 0.0, 0.0]);
    let mut still = observations(1, &truth, true);
    for observation in &mut still {
        if let Known::Sun {
            unit,
            elevation_deg,
        } = &mut observation.known
        {
            (*unit, *elevation_deg) = (Vector3::x_axis(), 40.0);
        }
        let level = Attitude {
            heading_deg: 180.0,
            pitch_deg: 40.0,
            roll_deg: 0.0,
        };
        let down = truth.inverse() * level.body_from_local() * Vector3::z();
        observation.horizon.nadir = Direction::new(UnitVector3::new_normalize(down), 1e-4);
    }
    let error = fit(&still, &body_from_camera(40.0, [0.0; 3])).unwrap_err();
    let error = error.to_string();
    assert!(error.contains("not determined"), "{error}");
    assert!(error.contains("sweep over the Sun"), "{error}");
}

/// A simulated flight: its folder, and the true mounting of its camera.
struct Flown {
    folder: tempfile::TempDir,
    truth: Rotation3<f64>,
}

/// Simulates `count` frames of the horizon over `seconds`, with a log of the attitude; if `with_sun`, also frames of the Sun.
fn fly(seed: u64, count: u64, seconds: f64, width_px: usize, with_sun: bool) -> Flown {
    let folder = temporary();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let off_deg = std::array::from_fn(|_| random.random_range(-1.0..1.0));
    let start: Timestamp = "2013-09-21T18:00:00Z".parse().unwrap();
    let demo = telescope();
    let sun_at = |utc| Ephemeris::default().sun(utc, FORT_SUMNER).unwrap();
    let down_deg = match with_sun {
        true => sun_at(start).elevation_deg,
        false => 0.0,
    };
    let truth = body_from_camera(down_deg, off_deg);
    write_camera(
        folder.path(),
        &conditions(width_px),
        &body_from_camera(down_deg, [0.0; 3]),
    );
    let store = |name: &str, folder: &Path| Store::open(folder, name, Compression::Rice).unwrap();
    let at = |name: &str| folder.path().join(name);
    let roll = store("roll", &at("horizon"));
    let suns = with_sun.then(|| store("demo", &at("suns")));
    let mut log = String::from("utc,roll_deg,pitch_deg\n");
    let rows: Vec<String> = (0..count)
        .into_par_iter()
        .map(|n| {
            let time_s = n as f64 * seconds / count as f64;
            let utc = start + SignedDuration::from_secs_f64(time_s);
            let sun = sun_at(utc);
            let towards = Horizontal {
                azimuth_deg: sun.azimuth_deg,
                elevation_deg: if with_sun { sun.elevation_deg } else { 0.0 },
            };
            let mut attitude = sweep(time_s, towards, 1.0);
            if !with_sun {
                // Large tilts, as by hand.
                attitude.roll_deg *= 3.0;
                attitude.pitch_deg *= 15.0;
            }
            let mut frame = horizon_scene(seed, n, width_px, &attitude, &truth)
                .frame()
                .unwrap();
            frame.info.mid_exposure = Some(utc);
            roll.write(&frame, &[], &[]).unwrap();
            if let Some(suns) = &suns {
                let pointing = Horizontal {
                    azimuth_deg: attitude.heading_deg,
                    elevation_deg: attitude.pitch_deg,
                };
                let roll = Roll::Measured(Measured::new(attitude.roll_deg, 0.0));
                let at = sun_on_plate(pointing, roll, &demo, &sun).unwrap();
                let mut scene = Scene::new(&demo, demo.nominal_mapping().unwrap());
                scene.noise = Noise::read(3.0);
                scene.sun = Some(Sun::new(at, demo.optics.radius_mil(sun.radius_arcsec)));
                scene.seed = seed << 32 | n;
                let mut frame = scene.frame().unwrap();
                frame.info.number = Some(n);
                frame.info.place = Some(FORT_SUMNER);
                frame.info.mid_exposure = Some(utc);
                suns.write(&frame, &[], &[]).unwrap();
            }
            format!("{utc},{},{}\n", attitude.roll_deg, attitude.pitch_deg)
        })
        .collect();
    log.extend(rows);
    fs::write(folder.path().join("attitude.csv"), log).unwrap();
    Flown { folder, truth }
}

/// The demo instrument, whose directions are at the telescope.
fn telescope() -> Instrument {
    builtin("demo").unwrap()
}

/// Focal length of a camera with a field of 94.4 deg.
fn focal_px(width_px: usize) -> f64 {
    width_px as f64 / 2.0 / 47.2_f64.to_radians().tan()
}

fn middle(width_px: usize, height_px: usize) -> SensorPx {
    SensorPx::new(
        (width_px as f64 - 1.0) / 2.0,
        (height_px as f64 - 1.0) / 2.0,
    )
}

fn conditions(width_px: usize) -> EarthConditions {
    let height_px = width_px * 9 / 16;
    EarthConditions {
        camera: CameraModel::rectilinear(focal_px(width_px), middle(width_px, height_px)),
        width_px,
        height_px,
        ..EarthConditions::clear(38_405.0).varying(0.02, 100.0)
    }
}

fn horizon_scene(
    seed: u64,
    number: u64,
    width_px: usize,
    attitude: &Attitude,
    truth: &Rotation3<f64>,
) -> EarthScene {
    let forward = EarthScene {
        latitude_deg: FORT_SUMNER.latitude_deg,
        heading_deg: attitude.heading_deg,
        roll_deg: attitude.roll_deg,
        pitch_deg: attitude.pitch_deg,
        weather: 0,
        ..conditions(width_px).scene(seed, number)
    };
    forward.seen_by(&(body_from_camera(0.0, [0.0; 3]).inverse() * truth))
}

fn write_camera(folder: &Path, conditions: &EarthConditions, turn: &Rotation3<f64>) {
    let focal_px = focal_px(conditions.width_px);
    let centre = middle(conditions.width_px, conditions.height_px);
    let m = turn.matrix();
    let rows: Vec<String> = (0..3)
        .map(|n| format!("[{}, {}, {}]", m[(n, 0)], m[(n, 1)], m[(n, 2)]))
        .collect();
    let text = format!(
        "# the roll camera\n[camera]\nwidth_px = {}\nheight_px = {}\ncentre_px = [{}, {}]\nfocal_px = [{focal_px}, {focal_px}]\nbody_from_camera = [{}]\n",
        conditions.width_px,
        conditions.height_px,
        centre.x,
        centre.y,
        rows.join(", ")
    );
    fs::write(folder.join("cam.toml"), text).unwrap();
}

/// Runs the calibration; the new mounting and its sigmas, deg.
fn calibrate(flown: &Flown, more: &[&str]) -> (Rotation3<f64>, [f64; 3]) {
    let at = |name: &str| flown.folder.path().join(name);
    let output = Command::new(env!("CARGO_BIN_EXE_solaspect"))
        .args(["calibrate", "mounting", "--roll-camera"])
        .arg(at("cam.toml"))
        .arg("--out")
        .arg(at("new.toml"))
        .args(more)
        .arg(at("horizon"))
        .args(at("suns").is_dir().then(|| at("suns")))
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{text}{output:?}");
    println!("{text}");
    let file = fs::read_to_string(at("new.toml")).unwrap();
    assert!(file.starts_with("# the roll camera\n"));
    let table: toml::Table = file.parse().unwrap();
    let sigmas = &table["calibration"]["body_from_camera"]["sigmas_deg"];
    let sigmas = sigmas.as_array().unwrap().iter();
    let sigmas: Vec<f64> = sigmas.map(|sigma| sigma.as_float().unwrap()).collect();
    let turn = MountedCamera::read(&at("new.toml"))
        .unwrap()
        .body_from_camera;
    (turn, sigmas.try_into().unwrap())
}

#[test]
fn frames_at_known_attitude_determine_how_the_camera_sits() {
    let flown = fly(3, 60, 30.0, 640, false);
    let log = flown.folder.path().join("attitude.csv");
    let (turn, sigmas) = calibrate(&flown, &["--attitude", log.to_str().unwrap()]);
    let errors = errors(&turn, &flown.truth, sigmas);
    println!("{errors:?} sigmas of {sigmas:?} deg");
    assert!(errors.iter().all(|error| error.abs() < 3.0), "{errors:?}");
    assert!(sigmas[0] < 0.04 && sigmas[2] < 0.04, "{sigmas:?}");
}

#[test]
fn a_flight_that_saw_sun_and_horizon_determines_how_the_camera_sits() {
    let flown = fly(4, 320, 80.0, 640, true);
    let (turn, sigmas) = calibrate(&flown, &[]);
    let errors = errors(&turn, &flown.truth, sigmas);
    println!("{errors:?} sigmas of {sigmas:?} deg");
    assert!(errors.iter().all(|error| error.abs() < 3.0), "{errors:?}");
}

/// `cargo test --test promises -- --ignored a_flight_of_ten_minutes --nocapture`
#[test]
#[ignore = "many minutes of rendering"]
fn a_flight_of_ten_minutes_determines_how_the_camera_sits_to_two_hundredths_of_a_degree() {
    let flown = fly(5, 2400, 600.0, 1920, true);
    let (turn, sigmas) = calibrate(&flown, &[]);
    let errors = errors(&turn, &flown.truth, sigmas);
    let off_deg: [f64; 3] = std::array::from_fn(|n| errors[n] * sigmas[n]);
    println!("off by {off_deg:?}, {errors:?} sigmas of {sigmas:?} deg");
    // The accuracy of the pitch depends on the height of the limb's edge.
    assert!(errors[1].abs() < 3.0, "{errors:?}");
    assert!(
        off_deg[0].abs() < 0.02 && off_deg[2].abs() < 0.02,
        "{off_deg:?}"
    );
}
