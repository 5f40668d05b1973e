//! The Moon's centre in a picture, at any phase and orientation, with calibrated uncertainties.

use nalgebra::Vector2;
use rayon::prelude::*;
use serde_json::Value;
use solaspect::accuracy::Knowledge;
use solaspect::frame::{Frame, Pixels};
use solaspect::moon::{
    Disc, Expected, MoonSettings, Optics, Radius, Stopped, by_extremities, solve,
};
use solaspect::reasons::moon as reasons;
use solaspect::simulate::moon::{MoonConditions, MoonScene, Shown};
use solaspect::units::Measured;
use std::ops::Range;
use std::process::{Command, Output};

fn solve_scene(scene: &MoonScene, known: Knowledge) -> Result<Disc, Stopped> {
    let settings = MoonSettings {
        shading: scene.conditions.shading,
        optics: Optics::Aspect(scene.conditions.pixel_aspect),
    };
    solve(&settings, &scene.frame().unwrap(), &known.expected(scene))
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let squares: Vec<f64> = values.map(|v| v * v).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

/// Error of a disc's centre: its component along the direction of the bright limb, px, and error over sigma per axis.
struct Error {
    across_px: f64,
    over_sigma: f64,
}

/// Errors in some scenes; asserts that the Moon is found in each.
fn errors(conditions: &MoonConditions, scenes: u64, known: Knowledge) -> Vec<Error> {
    let error = |number: u64| {
        let scene = conditions.scene(1, number);
        let disc = solve_scene(&scene, known)
            .unwrap_or_else(|stopped| panic!("{known:?} {number}: {stopped}"));
        let off = disc.centre.position.vector() - scene.centre.vector();
        if off.norm() > 2.0 {
            println!("scene {number}: off by {:.1} px", off.norm());
        }
        let (sin, cos) = scene.bright_limb_in_picture_deg().to_radians().sin_cos();
        let inverse = disc.centre.covariance.try_inverse().unwrap();
        Error {
            across_px: off.dot(&Vector2::new(cos, sin)),
            over_sigma: (off.dot(&(inverse * off)) / 2.0).sqrt(),
        }
    };
    (0..scenes).into_par_iter().map(error).collect()
}

/// Rms of the error components along the bright limb, px, and rms of error over sigma.
fn across_and_over_sigma(conditions: &MoonConditions, scenes: u64, known: Knowledge) -> (f64, f64) {
    let errors = errors(conditions, scenes, known);
    let across = rms(errors.iter().map(|e| e.across_px));
    let over = rms(errors.iter().map(|e| e.over_sigma));
    println!(
        "radius {} px, lit {:?}, {known:?}: {across:.3} px, {over:.2} sigma",
        conditions.radius_px, conditions.lit
    );
    (across, over)
}

fn lit(radius_px: f64, lit: Range<f64>) -> MoonConditions {
    MoonConditions {
        lit,
        ..MoonConditions::clear(radius_px)
    }
}

/// Checks rows of lit fraction with the largest rms along the bright limb, px, for a known radius and for a free one.
fn hold(
    conditions: impl Fn(Range<f64>) -> MoonConditions,
    scenes: u64,
    rows: &[(Range<f64>, f64, f64)],
    sigmas: Range<f64>,
) {
    for (lit, known, free) in rows {
        let conditions = conditions(lit.clone());
        for (radius, most) in [(Knowledge::Radius, known), (Knowledge::Nothing, free)] {
            let (across, over) = across_and_over_sigma(&conditions, scenes, radius);
            assert!(across < *most, "lit {lit:?}, {radius:?}: {across} px");
            assert!(
                sigmas.contains(&over),
                "lit {lit:?}, {radius:?}: {over} sigma"
            );
        }
    }
}

const SMOOTH: [(Range<f64>, f64, f64); 3] = [
    (0.10..0.25, 0.06, 0.20),
    (0.25..0.60, 0.03, 0.10),
    (0.60..1.00, 0.03, 0.05),
];

#[test]
fn a_smooth_moons_centre_is_found_to_a_part_of_a_pixel_at_any_phase() {
    // The limits are widened by 2 sigma of an rms of 80 values.
    hold(
        |range| lit(15.0, range),
        40,
        &SMOOTH,
        0.8 - 0.16..1.25 + 0.16,
    );
}

#[test]
fn a_moon_with_craters_is_found_to_a_quarter_of_a_pixel() {
    let craters = |range| MoonConditions {
        craters: true,
        ..lit(15.0, range)
    };
    hold(craters, 24, &[(0.10..1.00, 0.25, 0.45)], 0.6..2.2);
}

#[test]
fn a_large_moons_centre_is_found_to_hundredths_of_a_pixel() {
    let (across, _) = across_and_over_sigma(&lit(227.0, 0.1..1.0), 10, Knowledge::RadiusAndPhase);
    assert!(across < 0.025, "{across}");
}

#[test]
fn a_full_moon_is_where_it_is_whatever_its_turn() {
    let full = lit(15.0, 0.999..1.0);
    let errors = errors(&full, 60, Knowledge::Nothing);
    let mean = errors.iter().map(|e| e.across_px).sum::<f64>() / 60.0;
    println!("mean {mean:.4} px");
    assert!(mean.abs() < 0.02, "{mean}");
}

#[test]
fn pixels_that_are_not_square_an_earthshine_and_stars_change_little() {
    let hard = MoonConditions {
        pixel_aspect: 0.808,
        earthshine: 0.03,
        stars: 40,
        ..lit(15.0, 0.25..1.0)
    };
    let (across, _) = across_and_over_sigma(&hard, 30, Knowledge::RadiusAndPhase);
    assert!(across < 0.05, "{across}");
}

#[test]
fn planets_glow_the_suns_glare_and_a_short_exposure_change_little() {
    let half_lit = || lit(15.0, 0.25..1.0);
    let planets = MoonConditions {
        planets: 6,
        ..half_lit()
    };
    let glow = MoonConditions {
        glow: 0.03,
        peak_dn: 500.0,
        ..lit(30.0, 0.25..1.0)
    };
    let glare = MoonConditions {
        sun_glare: true,
        ..half_lit()
    };
    // A third of the usual brightness.
    let faint = MoonConditions {
        peak_dn: 70.0,
        ..lit(15.0, 0.5..1.0)
    };
    let all = [
        ("planets", planets),
        ("glow", glow),
        ("glare", glare),
        ("faint", faint),
    ];
    for (name, conditions) in all {
        let scenes = (0..60).map(|number| conditions.scene(6, number));
        let found = |scene: MoonScene| {
            let disc = solve_scene(&scene, Knowledge::RadiusAndPhase).ok()?;
            Some(disc.centre.position.distance(scene.centre))
        };
        let errors: Vec<f64> = scenes.filter_map(found).collect();
        let error = rms(errors.iter().copied());
        println!("{name}: {} of 60, rms {error:.3} px", errors.len());
        assert!(errors.len() >= 57, "{name}: {} of 60", errors.len());
        assert!(error < 0.1, "{name}: {error}");
    }
}

#[test]
fn a_disc_that_the_picture_cuts_and_one_that_is_over_exposed_are_found() {
    let cut = MoonConditions {
        cut: true,
        ..lit(30.0, 0.4..1.0)
    };
    let over_exposed = MoonConditions {
        peak_dn: 500.0,
        ..lit(30.0, 0.2..1.0)
    };
    for (name, conditions, most_px) in [("cut", cut, 0.3), ("over-exposed", over_exposed, 0.5)] {
        let scenes: Vec<MoonScene> = (0..60)
            .map(|number| conditions.scene(4, number))
            .filter(|scene| bright_limb_in_view(scene) > 0.4)
            .collect();
        let found = |scene: &MoonScene| {
            let disc = solve_scene(scene, Knowledge::RadiusAndPhase).ok()?;
            Some(disc.centre.position.distance(scene.centre))
        };
        let errors: Vec<f64> = scenes.par_iter().filter_map(found).collect();
        let worst = errors.iter().copied().fold(0.0, f64::max);
        let error = rms(errors.iter().copied());
        println!(
            "{name}: {} of {}, rms {error:.3}, worst {worst:.3} px",
            errors.len(),
            scenes.len()
        );
        assert!(errors.len() as f64 > 0.9 * scenes.len() as f64, "{name}");
        assert!(error < most_px, "{name}: {error}");
    }
}

/// Fraction of the bright limb, 90 deg to either side of its middle, inside the picture.
fn bright_limb_in_view(scene: &MoonScene) -> f64 {
    let conditions = &scene.conditions;
    let in_view = |n: &i32| {
        let angle = scene.bright_limb_deg + f64::from(*n);
        let (sin, cos) = angle.to_radians().sin_cos();
        let x = scene.centre.x + cos * conditions.radius_px * conditions.pixel_aspect;
        let y = scene.centre.y + sin * conditions.radius_px;
        (0.0..conditions.width_px as f64 - 1.0).contains(&x)
            && (0.0..conditions.height_px as f64 - 1.0).contains(&y)
    };
    (-90..=90).filter(in_view).count() as f64 / 181.0
}

#[test]
fn the_circle_by_eight_extremities_is_within_seven_hundredths_of_the_radius() {
    for radius_px in [15.0, 60.0] {
        let conditions = lit(radius_px, 0.15..1.0);
        let errors = (0..40).map(|number| {
            let scene = conditions.scene(2, number);
            let frame = scene.frame().unwrap();
            let (centre, _) = by_extremities(&MoonSettings::default(), &frame).unwrap();
            centre.distance(scene.centre) / radius_px
        });
        let found = rms(errors);
        println!("radius {radius_px} px: {found:.3}");
        assert!(found < 0.07, "{found}");
    }
}

#[test]
fn what_is_no_moon_of_the_expected_size_and_phase_is_refused() {
    let stars = MoonConditions {
        stars: 60,
        shown: Shown::Nothing,
        ..MoonConditions::clear(15.0)
    };
    for number in 0..40 {
        let found = solve_scene(&stars.scene(3, number), Knowledge::RadiusAndPhase);
        assert!(found.is_err(), "{number}: {found:?}");
    }
    let reason = |scene: &MoonScene, expected: &Expected| {
        let frame = scene.frame().unwrap();
        let stopped = solve(&MoonSettings::default(), &frame, expected).unwrap_err();
        stopped.rejected.reason.code
    };
    // A lamp appears as a full disc; the ephemeris expects a crescent, or another size.
    let lamp = lit(15.0, 0.999..1.0).scene(3, 0);
    let with = |radius_px: f64, phase_deg: f64| Expected {
        radius: Some(Radius::Pixels(Measured::new(radius_px, 0.05))),
        phase_angle_deg: Some(Measured::new(phase_deg, 0.1)),
        bright_limb_deg: None,
    };
    assert!(
        solve(
            &MoonSettings::default(),
            &lamp.frame().unwrap(),
            &with(15.0, 5.0)
        )
        .is_ok()
    );
    assert_eq!(reason(&lamp, &with(15.0, 110.0)), "lit");
    assert_eq!(reason(&lamp, &with(19.0, 5.0)), "no_fit");
    let oval = MoonConditions {
        pixel_aspect: 1.2,
        ..lit(15.0, 0.999..1.0)
    };
    let why = reason(&oval.scene(3, 1), &with(15.5, 5.0));
    assert!(["oval", "no_disc"].contains(&why), "{why}");
    let is_lit = |n: &usize| (n % 2048).is_multiple_of(5) && (n / 2048).is_multiple_of(5);
    let dotted = (0..2048 * 2048).map(|n| if is_lit(&n) { 200 } else { 10 });
    let dotted = Pixels::U8(dotted.collect());
    let dotted = Frame::new(2048, 2048, dotted, 255, Default::default()).unwrap();
    let stopped = solve(&MoonSettings::default(), &dotted, &Expected::default()).unwrap_err();
    assert_eq!(stopped.rejected.reason, reasons::MANY_LIGHTS);
    let white = Pixels::U8(vec![255; 720 * 578]);
    let white = Frame::new(720, 578, white, 255, Default::default()).unwrap();
    let stopped = solve(&MoonSettings::default(), &white, &Expected::default()).unwrap_err();
    assert_eq!(stopped.rejected.reason, reasons::TOO_BRIGHT);
}

/// Number of frames of stars, lamps and the unfiltered Sun that are mistaken for the Moon of known size and phase.
fn false_moons(frames: u64) -> usize {
    let shown = [Shown::Nothing, Shown::Lamp, Shown::Sun];
    let is_found = |number: &u64| {
        let conditions = MoonConditions {
            shown: shown[*number as usize % shown.len()],
            stars: 60,
            planets: 3,
            ..MoonConditions::clear(15.0)
        };
        let scene = conditions.scene(5, *number);
        solve_scene(&scene, Knowledge::RadiusAndPhase).is_ok()
    };
    let found: Vec<u64> = (0..frames).into_par_iter().filter(is_found).collect();
    println!("{} of {frames} pass for the Moon: {found:?}", found.len());
    found.len()
}

#[test]
fn stars_lamps_and_the_unfiltered_sun_do_not_pass_for_the_moon() {
    assert_eq!(false_moons(300), 0);
}

fn solaspect(args: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_solaspect");
    Command::new(program).args(args).output().unwrap()
}

#[test]
fn the_command_finds_what_the_simulator_drew_and_where_it_is_in_the_sky() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    // A place and time at which the Moon is up and half lit.
    let at = "2026-01-10T10:00:00Z";
    let made = solaspect(&[
        "simulate",
        "--moon",
        "--out",
        &path(""),
        "--frames",
        "2",
        "--lit",
        "0.5,0.54",
        "--utc",
        at,
    ]);
    assert!(made.status.success(), "{made:?}");
    let camera = path("cam.toml");
    let said = solaspect(&[
        "moon",
        "--instrument",
        &camera,
        "--place",
        "34.49,-104.2218,38405",
        "--overlay",
        &path("overlays"),
        &path("frame_00000.fits"),
        &path("frame_00001.fits"),
        "/dev/null",
    ]);
    assert_eq!(said.status.code(), Some(1), "{said:?}");
    let lines: Vec<Value> = std::str::from_utf8(&said.stdout)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let truth = std::fs::read_to_string(path("truth.csv")).unwrap();
    for (line, truth) in lines.iter().zip(truth.lines().skip(1)) {
        let truth: Vec<f64> = truth
            .split(',')
            .map(|v| v.parse().unwrap_or(f64::NAN))
            .collect();
        let number = |field: &str, n: usize| line[field][n].as_f64().unwrap();
        // Size and phase by the ephemeris differ slightly from those of the picture.
        assert!((number("centre_px", 0) - truth[3]).abs() < 1.0, "{line}");
        assert!((number("centre_px", 1) - truth[4]).abs() < 1.0, "{line}");
        let off_deg = (line["bright_limb_deg"].as_f64().unwrap() - truth[9] + 540.0)
            .rem_euclid(360.0)
            - 180.0;
        assert!(off_deg.abs() < 20.0, "{line}");
        // The phase comes from the ephemeris, with its small sigma.
        assert_eq!(line["phase_angle_sigma_deg"], 0.1, "{line}");
        assert!(line["lit_sigma"].as_f64().unwrap() < 1e-3, "{line}");
        let length = |field: &str| (0..3).map(|n| number(field, n).powi(2)).sum::<f64>();
        assert!((length("direction") - 1.0).abs() < 1e-9);
        assert!(line["direction_local"].is_null());
        assert!(line["covariance_px2"][0][0].as_f64().unwrap() > 0.0);
    }
    assert!(
        lines[2]["error"]
            .as_str()
            .unwrap()
            .contains("expected a regular file"),
        "{}",
        lines[2]
    );
    assert_eq!(std::fs::read_dir(path("overlays")).unwrap().count(), 2);
    let frame = path("frame_00000.fits");
    let local = solaspect(&[
        "moon",
        "--instrument",
        &camera,
        "--attitude",
        "100,30,0",
        &frame,
    ]);
    let line: Value = serde_json::from_slice(&local.stdout).unwrap();
    // The camera points east at an elevation of 30 deg, and its field is 12 deg wide.
    let [east, up] = [0, 2].map(|n| line["direction_local"][n].as_f64().unwrap());
    assert!((up.asin().to_degrees() - 30.0).abs() < 8.0, "{line}");
    assert!(east > 0.8, "{line}");
    // Thirteen hours later the Moon has set.
    let set = solaspect(&[
        "moon",
        "--instrument",
        &camera,
        "--place",
        "34.49,-104.2218,38405",
        "--at",
        "2026-01-10T23:00:00Z",
        &path("frame_00000.fits"),
    ]);
    let line: Value = serde_json::from_slice(&set.stdout).unwrap();
    assert_eq!(line["reason"]["code"], "below_horizon", "{line}");
}
