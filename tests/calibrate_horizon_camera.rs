//! The optics of a horizon camera are determined from its own frames, with calibrated uncertainties in the file.

use crate::common::refined::{rms, temporary};
use nalgebra::{UnitVector3, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use solaspect::archive::Store;
use solaspect::calibrate::horizon_camera::{
    self, FromFrames, Limb, Optics, OpticsError, Unknown, fit,
};
use solaspect::calibrate::roll_camera::Horizons;
use solaspect::config::Roll;
use solaspect::fits::Compression;
use solaspect::geometry::camera::{CameraModel, Lens};
use solaspect::horizon::{EdgePoint, EdgeRays, Sphere};
use solaspect::instrument::DirectionCamera;
use solaspect::simulate::earth::EarthConditions;
use solaspect::units::{Measured, Place, SensorPx};
use std::f64::consts::TAU;
use std::fs;
use std::process::Command;

const SIZE_PX: [usize; 2] = [1920, 1080];
/// Focal length in the camera's file.
const FOCAL_PX: f64 = 889.0;
const K2: f64 = -0.1;
const FRAMES: u64 = 300;
/// Number of drawn cameras in the tests, and for the numbers in the documentation.
const SMALL: u64 = 16;
const FULL: u64 = 100;

/// A lens r = f (theta + k2 theta^3), by this formula.
#[derive(Debug, Clone, Copy)]
struct Truth {
    focal_px: f64,
    centre: Vector2<f64>,
    k2: f64,
}

impl Truth {
    fn drawn(random: &mut Xoshiro256PlusPlus) -> Self {
        let mut normal = || random.sample::<f64, _>(StandardNormal);
        Self {
            focal_px: FOCAL_PX * (1.0 + 0.03 * normal()),
            centre: Vector2::new(959.5 + 10.0 * normal(), 539.5 + 10.0 * normal()),
            k2: K2 * (1.0 + 0.2 * normal()),
        }
    }

    fn pixel(&self, ray: &Vector3<f64>) -> Vector2<f64> {
        let theta = ray.xy().norm().atan2(ray.z);
        let r = self.focal_px * (theta + self.k2 * theta.powi(3));
        self.centre + ray.xy().normalize() * r
    }
}

/// The camera as described by its file.
fn file() -> DirectionCamera {
    let lens = Lens::KannalaBrandt([1.0, K2, 0.0, 0.0, 0.0]);
    DirectionCamera {
        width_px: SIZE_PX[0],
        height_px: SIZE_PX[1],
        lens: CameraModel::new(lens, [FOCAL_PX; 2], SensorPx::new(959.5, 539.5)).unwrap(),
        body_from_camera: None,
        mask: Vec::new(),
    }
}

/// Angular radius of the horizon, and range of the camera's roll and pitch, deg.
#[derive(Debug, Clone, Copy)]
struct Flight {
    half_angle_deg: f64,
    half_angle_sigma_deg: f64,
    most_roll_deg: f64,
    pitches_deg: [f64; 2],
}

/// At 38 km: the edge at 20 km with a sigma of 1 km.
const BALLOON: Flight = Flight {
    half_angle_deg: 85.69,
    half_angle_sigma_deg: 0.12,
    most_roll_deg: 30.0,
    pitches_deg: [-30.0, 20.0],
};

/// Limbs of a flight as the camera observes them: points about 12 px apart with independent noise of 0.1 px and correlated noise of 0.3 px.
fn limbs(truth: &Truth, flight: &Flight, random: &mut Xoshiro256PlusPlus) -> Vec<Limb> {
    let sigma_rad = flight.half_angle_sigma_deg.to_radians();
    let stated = Measured::new(flight.half_angle_deg.to_radians(), sigma_rad);
    let angle = stated.value + sigma_rad * random.sample::<f64, _>(StandardNormal);
    let frames = (0..FRAMES).map(|n| {
        let most = flight.most_roll_deg;
        let roll = random.random_range(-most..=most).to_radians();
        let [low, high] = flight.pitches_deg;
        let pitch = random.random_range(low..=high).to_radians();
        let level = Vector3::new(roll.sin(), roll.cos(), 0.0) * pitch.cos();
        let nadir = UnitVector3::new_normalize(level - Vector3::z() * pitch.sin());
        let points = points(truth, &nadir, angle, random);
        Limb {
            file: format!("{n}").into(),
            utc: None,
            sphere: Sphere::disc(stated),
            edge: EdgeRays::of(&points, &file().lens, 0.0),
        }
    });
    frames.collect()
}

fn points(
    truth: &Truth,
    nadir: &UnitVector3<f64>,
    angle: f64,
    random: &mut Xoshiro256PlusPlus,
) -> Vec<EdgePoint> {
    const AROUND: u32 = 470;
    const NOISE_PX: f64 = 0.1;
    const SHARED_PX: f64 = 0.3;
    const KEPT: f64 = 0.9;
    let first = nadir.cross(&Vector3::z()).normalize();
    let second = nadir.cross(&first);
    let mut shared = SHARED_PX * random.sample::<f64, _>(StandardNormal);
    let mut points = Vec::new();
    for n in 0..AROUND {
        let around = TAU * f64::from(n) / f64::from(AROUND);
        let outward = first * around.cos() + second * around.sin();
        let at = |angle: f64| nadir.into_inner() * angle.cos() + outward * angle.sin();
        let ray = at(angle);
        let fresh = (1.0 - KEPT * KEPT).sqrt() * SHARED_PX;
        shared = KEPT * shared + fresh * random.sample::<f64, _>(StandardNormal);
        if ray.z < 0.5 {
            continue;
        }
        let seen = truth.pixel(&ray);
        let inward = (truth.pixel(&at(angle - 1e-4)) - seen).normalize();
        let seen = seen + inward * (shared + NOISE_PX * random.sample::<f64, _>(StandardNormal));
        let is_in_view = (0..2).all(|axis| (0.0..SIZE_PX[axis] as f64 - 1.0).contains(&seen[axis]));
        if is_in_view {
            points.push(EdgePoint {
                at: seen.into(),
                inward,
                sigma_px: NOISE_PX,
                of_brightness_px: 0.0,
            });
        }
    }
    points
}

/// Error over sigma of focal length, centre (two axes) and k2.
fn errors(found: &Optics, truth: &Truth) -> [f64; 4] {
    let centre = found.camera.principal_point();
    let Lens::KannalaBrandt(k) = found.camera.lens() else {
        panic!("expected a polynomial");
    };
    let errors = [
        (found.camera.focal_px()[0] / truth.focal_px).ln(),
        centre.x - truth.centre.x,
        centre.y - truth.centre.y,
        k[1] - truth.k2,
    ];
    std::array::from_fn(|n| errors[n] / found.changed(Unknown::REQUIRED[n]).sigma)
}

#[test]
fn the_optics_of_a_flight_are_known_as_well_as_they_say() {
    check_optics(SMALL);
}

#[test]
#[ignore = "full size"]
fn the_optics_of_a_hundred_flights_are_known_as_well_as_they_say() {
    check_optics(FULL);
}

fn check_optics(cameras: u64) {
    let of_camera = |seed: u64| {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let truth = Truth::drawn(&mut random);
        let found = fit(&limbs(&truth, &BALLOON, &mut random), &file()).unwrap();
        found.check_determined(&file()).unwrap();
        (errors(&found, &truth), found)
    };
    let found: Vec<([f64; 4], Optics)> = (0..cameras).into_par_iter().map(of_camera).collect();
    for (n, unknown) in Unknown::REQUIRED.into_iter().enumerate() {
        let ratios: Vec<f64> = found.iter().map(|(ratios, _)| ratios[n]).collect();
        let sigmas: Vec<f64> = found
            .iter()
            .map(|(_, found)| found.changed(unknown).sigma)
            .collect();
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        println!(
            "{}: sigma {:.5}, error/sigma {:.2}, mean {mean:.2}",
            unknown.name(),
            rms(&sigmas),
            rms(&ratios)
        );
    }
    let residual_px = rms(&found.iter().map(|(_, f)| f.residual_px).collect::<Vec<_>>());
    let all: Vec<f64> = found.iter().flat_map(|(ratios, _)| *ratios).collect();
    println!("residual {residual_px:.3} px, error/sigma {:.2}", rms(&all));
    assert!((0.8..1.25).contains(&rms(&all)), "{}", rms(&all));
    assert!(all.iter().all(|ratio| ratio.abs() < 5.0));
}

#[test]
fn frames_that_do_not_determine_the_optics_say_what_lacks() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
    let truth = Truth::drawn(&mut random);
    let level = Flight {
        most_roll_deg: 0.5,
        pitches_deg: [-4.4, -4.2],
        ..BALLOON
    };
    let found = fit(&limbs(&truth, &level, &mut random), &file()).unwrap();
    let error = found.check_determined(&file()).unwrap_err().to_string();
    assert!(
        error.contains("tilt and roll the camera") && error.contains("the lower left"),
        "{error}"
    );
    assert_eq!(fit(&[], &file()), Err(OpticsError::TooFew(0)));
}

/// Frames of a flight at 38 km, simulated with a lens that differs from the camera's file.
struct Drawn {
    folder: tempfile::TempDir,
    truth: Truth,
}

fn drawn(seed: u64, width_px: usize, frames: u64) -> Drawn {
    let scale = width_px as f64 / SIZE_PX[0] as f64;
    let height_px = width_px * 9 / 16;
    let mut truth = Truth::drawn(&mut Xoshiro256PlusPlus::seed_from_u64(seed));
    truth.focal_px *= scale;
    truth.centre *= scale;
    let lens = Lens::KannalaBrandt([1.0, truth.k2, 0.0, 0.0, 0.0]);
    let conditions = EarthConditions {
        camera: CameraModel::new(lens, [truth.focal_px; 2], truth.centre.into()).unwrap(),
        width_px,
        height_px,
        ..EarthConditions::clear(38_000.0).varying(0.02, 100.0)
    };
    let folder = temporary();
    let store = Store::open(&folder.path().join("flight"), "roll", Compression::Rice).unwrap();
    (0..frames).into_par_iter().for_each(|n| {
        let scene = conditions.scene(seed, n);
        let mut frame = scene.frame().unwrap();
        frame.info.place = Place::new(scene.latitude_deg, 0.0, 38_000.0).ok();
        store.write(&frame, &[], &[]).unwrap();
    });
    let text = format!(
        "# the horizon's camera\n[camera]\nwidth_px = {width_px}\nheight_px = {height_px}\n\
         centre_px = [{}, {}]\nfocal_px = [{focal}, {focal}]\nkannala_brandt = [1, {K2}, 0, 0, 0]\n",
        (width_px - 1) as f64 / 2.0,
        (height_px - 1) as f64 / 2.0,
        focal = FOCAL_PX * scale,
    );
    fs::write(folder.path().join("cam.toml"), text).unwrap();
    Drawn { folder, truth }
}

/// Result of the calibration by simulated frames.
fn calibrated(drawn: &Drawn) -> FromFrames {
    let at = |name: &str| drawn.folder.path().join(name);
    let camera = DirectionCamera::read(&at("cam.toml")).unwrap();
    let horizons = Horizons {
        camera: &camera,
        settings: Roll::default(),
        place: None,
    };
    let found = horizon_camera::from_frames(&[at("flight")], &horizons, &()).unwrap();
    for line in found.lines() {
        println!("{line}");
    }
    println!(
        "{} rejected, {:?}",
        found.rejected.len(),
        errors(&found.optics, &drawn.truth)
    );
    found
}

#[test]
fn a_wide_angle_camera_becomes_usable_by_its_own_frames() {
    let drawn = drawn(3, 640, 60);
    let found = calibrated(&drawn);
    assert!(
        found.optics.residual_px < 0.3,
        "{}",
        found.optics.residual_px
    );
    assert!(
        errors(&found.optics, &drawn.truth)
            .iter()
            .all(|ratio| ratio.abs() < 4.0)
    );
    let at = |name: &str| drawn.folder.path().join(name);
    let output = Command::new(env!("CARGO_BIN_EXE_solaspect"))
        .args(["calibrate", "horizon-camera", "--instrument"])
        .arg(at("cam.toml"))
        .arg("--out")
        .arg(at("new.toml"))
        .arg(at("flight"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
    assert!(
        fs::read_to_string(at("new.toml"))
            .unwrap()
            .starts_with("# the horizon's camera\n")
    );
    let new = DirectionCamera::read(&at("new.toml")).unwrap();
    let corner = SensorPx::new(110.0, 70.0);
    let ray = found.optics.camera.ray(corner).unwrap();
    assert!(new.lens.pixel(&ray).unwrap().distance(corner) < 0.02);
}

#[test]
#[ignore = "full size"]
fn wide_angle_cameras_of_full_size_become_usable_and_are_known_as_well_as_they_say() {
    let mut all = Vec::new();
    for seed in 0..4 {
        let drawn = drawn(seed, SIZE_PX[0], FRAMES);
        let found = calibrated(&drawn);
        assert!(
            found.optics.residual_px < 0.3,
            "{}",
            found.optics.residual_px
        );
        all.extend(errors(&found.optics, &drawn.truth));
    }
    println!("error/sigma {:.2}", rms(&all));
    assert!((0.7..1.4).contains(&rms(&all)), "{}", rms(&all));
}
