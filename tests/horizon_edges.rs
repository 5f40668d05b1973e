//! Limbs, and edges that are not limbs: the solution distinguishes them, and so does the truth of a drawn scene.

use super::horizon::{camera, picture_of_disc, rocket, solaspect, sphere};
use nalgebra::{Rotation3, UnitVector3, Vector3};
use solaspect::frame::Pixels;
use solaspect::geometry::camera::CameraModel;
use solaspect::horizon::{self, EdgeHeight, HorizonSettings, Quality};
use solaspect::instrument::DirectionCamera;
use solaspect::reasons::horizon as reasons;
use solaspect::simulate::earth::EarthConditions;
use solaspect::units::SensorPx;
use std::f64::consts::TAU;

const SEED: u64 = 2;

#[test]
fn a_panel_with_the_edge_of_an_earth_is_too_sharp_to_be_one() {
    let scene = rocket().scene(SEED, 0);
    let sphere = sphere(&scene);
    let camera = camera(&scene.conditions);
    let down = scene.truth().nadir;
    let frame = picture_of_disc(&camera, &down, sphere.half_angle_rad.value);
    let solution = horizon::solve(&HorizonSettings::default(), &frame, &camera, &sphere, None);
    assert_ne!(solution.quality(), Quality::Fine);
    let reason = solution.reason().unwrap().rejected.reason;
    assert_eq!(reason, reasons::SHARP_EDGE);
}

#[test]
fn a_fitted_height_that_no_air_has_says_that_the_cameras_file_is_wrong() {
    let scene = rocket().scene(SEED, 1);
    let frame = scene.frame().unwrap();
    let sphere = sphere(&scene);
    let settings = HorizonSettings {
        height: EdgeHeight::Fitted,
        ..HorizonSettings::default()
    };
    let solved = |focal_share: f64| {
        let right = camera(&scene.conditions);
        let [width, height] =
            [right.width_px, right.height_px].map(|size| (size as f64 - 1.0) / 2.0);
        let focal_px = focal_share * right.lens.mean_focal_px();
        let file = DirectionCamera {
            lens: CameraModel::rectilinear(focal_px, SensorPx::new(width, height)),
            ..right
        };
        horizon::solve(&settings, &frame, &file, &sphere, None)
    };
    assert_eq!(solved(1.0).quality(), Quality::Fine);
    for focal_share in [0.82, 1.1] {
        let solution = solved(focal_share);
        assert_eq!(solution.quality(), Quality::Coarse, "{focal_share}");
        let reason = solution.reason().unwrap().rejected.reason;
        assert_eq!(reason, reasons::EDGE_HEIGHT, "{focal_share}");
    }
}

#[test]
fn a_circle_is_drawn_like_a_cone_and_alone_has_a_threshold() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let out = folder.path().display().to_string();
    let simulate = [
        "simulate",
        "--horizon",
        "--frames",
        "1",
        "--height-m",
        "230000",
    ];
    let simulated = solaspect(&[&simulate[..], &["--out", &out]].concat());
    assert!(simulated.status.success(), "{simulated:?}");
    let (camera, frame, pictures) = (at("cam.toml"), at("frame_00000.fits"), at("pictures"));
    let horizon = ["horizon", "--instrument", &camera, "--height-m", "230000"];
    let circle = ["--method", "circle", "--threshold-dn", "60"];
    let drawn = solaspect(&[&horizon[..], &circle, &["--overlay", &pictures, &frame]].concat());
    assert!(drawn.status.success(), "{drawn:?}");
    let picture = std::fs::read_dir(pictures)
        .unwrap()
        .next()
        .unwrap()
        .unwrap();
    let picture = image::open(picture.path()).unwrap();
    assert!(picture.width() >= 1920, "{} px", picture.width());
    let refused = solaspect(&[&horizon[..], &["--threshold-dn", "60", &frame]].concat());
    assert_eq!(refused.status.code(), Some(1));
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(
        said.contains("--threshold-dn: expected with --method circle"),
        "{said}"
    );
}

#[test]
fn the_truth_calls_lit_what_the_picture_shows_bright_inside_of_the_limb() {
    const PLACES: u32 = 720;
    const INSIDE_RAD: f64 = 0.03;
    let conditions = EarthConditions {
        terminator: true,
        ..EarthConditions::clear(300_000.0)
    };
    let mut seen = Vec::new();
    for number in 0..12 {
        let scene = conditions.scene(SEED, number);
        let (truth, lens) = (scene.truth(), &scene.conditions.camera);
        let frame = scene.frame().unwrap();
        let Pixels::U8(pixels) = frame.pixels() else {
            panic!("8 bits")
        };
        let half_angle_rad = sphere(&scene).half_angle_rad.value;
        let tilt = Rotation3::rotation_between(&Vector3::z_axis(), &truth.nadir).unwrap();
        let dn = |around_rad: f64, angle_rad: f64| {
            let (sine, cosine) = angle_rad.sin_cos();
            let ray = Vector3::new(sine * around_rad.cos(), sine * around_rad.sin(), cosine);
            let at = lens.pixel(&UnitVector3::new_normalize(tilt * ray))?;
            let is_seen = (0.0..1919.0).contains(&at.x) && (0.0..1079.0).contains(&at.y);
            is_seen.then(|| pixels[at.y.round() as usize * 1920 + at.x.round() as usize])
        };
        let places = (0..PLACES).map(|n| f64::from(n) * TAU / f64::from(PLACES));
        let along: Vec<u8> = places
            .filter(|around| dn(*around, half_angle_rad).is_some())
            .filter_map(|around| dn(around, half_angle_rad - INSIDE_RAD))
            .collect();
        let bright = along.iter().filter(|dn| **dn > 60).count();
        let share = bright as f64 / along.len() as f64;
        assert!(
            (share - truth.lit).abs() < 0.2,
            "{number}: {share}, {}",
            truth.lit
        );
        seen.push(truth.lit);
    }
    // The frames include day, night and both.
    assert!(seen.iter().any(|lit| *lit > 0.9), "{seen:?}");
    assert!(seen.iter().any(|lit| *lit < 0.1), "{seen:?}");
    assert!(seen.iter().any(|lit| (0.1..0.9).contains(lit)), "{seen:?}");
}
