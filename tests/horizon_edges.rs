//! An edge that is no limb's gives no fine nadir, and the answer says why.

use super::horizon::{camera, picture_of_disc, rocket, solaspect, sphere};
use solaspect::geometry::camera::Camera;
use solaspect::horizon::{self, EdgeHeight, Quality, Settings};
use solaspect::instrument::DirectionCamera;
use solaspect::reasons::horizon as reasons;
use solaspect::units::SensorPx;

const SEED: u64 = 2;

#[test]
fn a_panel_with_the_edge_of_an_earth_is_too_sharp_to_be_one() {
    let scene = rocket().scene(SEED, 0);
    let sphere = sphere(&scene);
    let camera = camera(&scene.conditions);
    let down = scene.truth().nadir;
    let frame = picture_of_disc(&camera, &down, sphere.half_angle_rad.value);
    let solution = horizon::solve(&Settings::default(), &frame, &camera, &sphere, None);
    assert_ne!(solution.quality(), Quality::Fine);
    let reason = solution.reason().unwrap().rejected.reason;
    assert_eq!(reason, reasons::SHARP_EDGE);
}

#[test]
fn a_fitted_height_that_no_air_has_says_that_the_cameras_file_is_wrong() {
    let scene = rocket().scene(SEED, 1);
    let frame = scene.frame().unwrap();
    let sphere = sphere(&scene);
    let settings = Settings {
        height: EdgeHeight::Fitted,
        ..Settings::default()
    };
    let solved = |focal_share: f64| {
        let right = camera(&scene.conditions);
        let [width, height] =
            [right.width_px, right.height_px].map(|size| (size as f64 - 1.0) / 2.0);
        let focal_px = focal_share * right.lens.mean_focal_px();
        let file = DirectionCamera {
            lens: Camera::rectilinear(focal_px, SensorPx::new(width, height)),
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
