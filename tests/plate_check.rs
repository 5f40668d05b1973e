//! The check of a plate before it is made: safe places are identified, and ambiguous ones are not.

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use solaspect::accuracy::bound::covariance_mil2;
use solaspect::aspect::{Expected, Quality, SolverSettings, solve};
use solaspect::instrument::{Instrument, MEAN_SUN_ARCSEC, SMALLEST_SUN_ARCSEC, builtin};
use solaspect::plate::{MarkId, MarkPlace, MarkShape, Pattern, Plate, table_text};
use solaspect::plate_check::{
    CheckSettings, CheckedPlace, PlaceVerdict, PlateCheck, check, html, json,
};
use solaspect::plate_design::{DesignSettings, design, file};
use solaspect::simulate::{Noise, SUN_RADIUS_ARCSEC, Scene, Sun};
use solaspect::units::PlateMil;
use std::process::Command;

fn demo() -> Instrument {
    builtin("demo").unwrap()
}

/// The demo instrument with other marks, mil.
fn with_marks(places: impl IntoIterator<Item = [f64; 2]>, field_mil: f64) -> Instrument {
    let demo = demo();
    let mark = |(n, [x, y]): (i32, [f64; 2])| {
        (
            MarkId { i: n, j: 0 },
            MarkPlace::new(PlateMil::new(x, y), 1.0),
        )
    };
    let marks = (1..).zip(places).map(mark);
    let mut plate = Plate::new(Pattern::Listed, demo.plate.shape, 1.0, marks);
    plate.field_radius_mil = field_mil;
    Instrument { plate, ..demo }
}

fn grid(step_mil: f64) -> Instrument {
    let along = move || (-9..=9).map(move |n| f64::from(n) * step_mil);
    with_marks(along().flat_map(|x| along().map(move |y| [x, y])), 1500.0)
}

fn checked(instrument: &Instrument, places: u64) -> PlateCheck {
    let settings = CheckSettings {
        places,
        ..CheckSettings::default()
    };
    check(instrument, &SolverSettings::default(), &settings)
}

/// Frames with the Sun at a checked place: whether each solution is fine, and its error, mil.
fn frames(instrument: &Instrument, place: &CheckedPlace, count: u64) -> Vec<(bool, f64)> {
    let at = PlateMil::new(place.x_mil, place.y_mil);
    let frame = |seed| {
        let mut scene = scene(instrument, at);
        scene.seed = seed;
        let expected = Expected {
            radius_arcsec: SUN_RADIUS_ARCSEC,
        };
        let solution = solve(&scene.frame().unwrap(), instrument, Some(expected), None);
        let found = solution.aspect.map(|aspect| aspect.sun_plate.position);
        let off = found.map_or(f64::INFINITY, |found| found.distance(at));
        (solution.quality == Quality::Fine, off)
    };
    (0..count).map(frame).collect()
}

fn scene(instrument: &Instrument, at: PlateMil) -> Scene {
    let radius_mil = instrument.optics.radius_mil(SUN_RADIUS_ARCSEC);
    Scene {
        sun: Some(Sun::new(at, radius_mil)),
        noise: Noise::read(5.0),
        ..Scene::new(instrument, instrument.nominal_mapping().unwrap())
    }
}

#[test]
fn the_plate_of_2013_passes_over_its_field() {
    let found = checked(&demo(), 600);
    assert!(found.passes(), "{found}");
    assert_eq!(found.field_radius_mil, 2000.0);
    let page = html(&found).unwrap();
    assert!(page.contains("The plate passes") && page.contains("<svg"));
}

#[test]
fn a_regular_grid_fails_since_its_marks_fit_several_places() {
    let found = checked(&grid(300.0), 200);
    assert!(!found.passes());
    assert!(found.count(PlaceVerdict::SeveralPlaces) > 120, "{found}");
    let text = found.to_string();
    assert!(
        text.contains("the marks fit several places of the plate"),
        "{text}"
    );
}

#[test]
fn a_plate_with_few_marks_fails_where_they_are_few() {
    let found = checked(&grid(700.0), 200);
    assert!(
        !found.passes() && found.count(PlaceVerdict::FewMarks) > 100,
        "{found}"
    );
    let mut short = demo();
    short.optics.plate_distance_mm.value = 1000.0;
    let found = checked(&short, 20);
    assert!(!found.passes() && found.misfit.is_some());
}

#[test]
fn frames_at_places_that_are_called_safe_are_fine_and_right() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(58);
    let mut places: Vec<[f64; 2]> = Vec::new();
    while places.len() < 200 {
        let [x, y] = [(); 2].map(|()| rng.random_range(-2600.0..2600.0));
        if places.iter().all(|[a, b]| (x - a).hypot(y - b) > 200.0) {
            places.push([x, y]);
        }
    }
    let instrument = with_marks(places, 2000.0);
    let found = checked(&instrument, 60);
    let safe = found
        .places
        .iter()
        .filter(|p| p.verdict == PlaceVerdict::Safe);
    let mut solved = 0;
    for place in safe.take(30) {
        for (is_fine, off_mil) in frames(&instrument, place, 2) {
            assert!(is_fine && off_mil < 1.0, "{place:?}: {off_mil} mil off");
            solved += 1;
        }
    }
    assert!(solved > 30);
}

#[test]
fn the_expected_sigma_is_within_a_fifth_of_the_cramer_rao_bound() {
    let demo = demo();
    let found = checked(&demo, 12);
    for place in &found.places {
        let at = PlateMil::new(place.x_mil, place.y_mil);
        let bound = covariance_mil2(&scene(&demo, at)).unwrap();
        let ratio = place.sigma_mil.unwrap() / (bound.trace() / 2.0).sqrt();
        assert!(
            (0.8..1.25).contains(&ratio),
            "{place:?}: {ratio} of the bound"
        );
    }
}

#[test]
fn a_camera_that_may_be_anywhere_has_no_safe_place() {
    let mut lost = demo();
    lost.mounting.plate_centre_sigma_px = 1e6;
    let found = checked(&lost, 20);
    assert_eq!(found.count(PlaceVerdict::FewMarks), 20, "{found}");
}

#[test]
fn a_measured_plate_has_the_sigma_of_its_measured_marks() {
    let mut measured = demo();
    for (id, at) in demo().plate.marks() {
        measured.plate.set(id, at, [0.1; 2]);
    }
    let [drawn, measured] =
        [demo(), measured].map(|i| checked(&i, 12).summary().most_misprint_mil.unwrap());
    assert!(
        (drawn / measured - 10.0).abs() < 0.01,
        "{drawn} and {measured} mil"
    );
}

#[test]
fn the_json_has_the_numbers_that_the_text_has() {
    let found = checked(&grid(700.0), 50);
    let text = json(&found).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(json["summary"]["passes"], false);
    let few = found.count(PlaceVerdict::FewMarks);
    assert_eq!(json["summary"]["places"]["few-marks"], few);
    assert_eq!(json["places"].as_array().unwrap().len(), 50);
    assert!(
        found
            .to_string()
            .contains(&format!("{few:>6} places, {:5.1} %", 2.0 * few as f64))
    );
}

#[test]
fn the_same_seed_gives_the_same_check() {
    assert_eq!(checked(&demo(), 20), checked(&demo(), 20));
}

#[test]
fn a_designed_plate_passes_its_check_and_its_frames_are_read() {
    for (shape, seed) in [
        (demo().plate.shape, 1),
        (MarkShape::Dot { diameter_mil: 52.0 }, 2),
    ] {
        let settings = DesignSettings {
            shape,
            trials: 1,
            exchanges: 4,
            seed,
            ..DesignSettings::new(1500.0, 4)
        };
        let designed = design(&demo(), &settings, &|| ()).unwrap();
        let found = checked(&designed, 2000);
        assert!(found.passes(), "{found}");
        assert!(found.places.iter().all(|place| place.lit >= 4), "{found}");
        // The written files describe the same plate.
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("instrument.toml");
        let text = include_str!("../calibration/demo.toml");
        let text = file((&path, text), &demo(), &designed, "a test").unwrap();
        std::fs::write(&path, text).unwrap();
        std::fs::write(folder.path().join("marks.csv"), table_text(&designed.plate)).unwrap();
        let read = Instrument::read(&path).unwrap();
        assert_eq!(read.plate, designed.plate);
        for place in found.places.iter().step_by(400) {
            for (is_fine, off_mil) in frames(&read, place, 1) {
                assert!(is_fine && off_mil < 1.0, "{place:?}: {off_mil} mil off");
            }
        }
    }
}

#[test]
fn a_designed_plate_of_as_many_marks_is_at_least_as_good_as_that_of_2013() {
    let heroes = demo();
    // Marks beyond this reach are never illuminated with the Sun in the field.
    let sun_mil = heroes.optics.radius_mil(SMALLEST_SUN_ARCSEC);
    let reach_mil = heroes.plate.field_radius_mil + sun_mil - heroes.plate.shape.size_mil();
    let in_reach = |(_, at): &(MarkId, PlateMil)| at.vector().norm() < reach_mil;
    let settings = DesignSettings {
        least_marks: heroes.plate.marks().filter(in_reach).count(),
        trials: 1,
        ..DesignSettings::new(heroes.plate.field_radius_mil, 4)
    };
    let designed = design(&heroes, &settings, &|| ()).unwrap();
    assert!(designed.plate.count() <= settings.least_marks);
    let [of_2013, found] = [&heroes, &designed].map(|plate| checked(plate, 2000));
    let [of_2013, designed] = [of_2013, found].map(|check| check.summary());
    let better = designed.least_margin >= of_2013.least_margin
        && designed.median_sigma_mil <= of_2013.median_sigma_mil;
    assert!(better, "{designed:?}\n{of_2013:?}");
}

#[test]
fn another_lens_has_a_camera_that_sees_the_whole_field() {
    let folder = tempfile::tempdir().unwrap();
    let design = |options: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_solaspect"));
        let command = command.current_dir(folder.path());
        let options = format!("plate design --out designed --trials 1 {options}");
        let output = command.args(options.split(' ')).output().unwrap();
        String::from_utf8([output.stdout, output.stderr].concat()).unwrap()
    };
    let said = design("--field-mil 1200 --radius-mil 183 --shape dot");
    assert!(said.contains("100.0 %: marks are read"), "{said}");
    assert!(said.contains("to see the whole Sun all over the field"));
    let designed = Instrument::read(&folder.path().join("designed/instrument.toml")).unwrap();
    assert!((designed.optics.radius_mil(MEAN_SUN_ARCSEC) - 183.0).abs() < 1e-6);
    // The Sun is at the edge of the field, in the direction of the sensor's nearest edge.
    let (mapping, sun_px) = (
        designed.nominal_mapping().unwrap(),
        designed.radius_px(977.0),
    );
    let lowest = mapping.to_sensor(PlateMil::new(0.0, -1200.0)).y;
    assert!(
        lowest - sun_px > 10.0 && lowest - sun_px < 20.0,
        "{lowest} {sun_px}"
    );

    for (options, error) in [
        (
            "--field-mil 0",
            "--field-mil: expected a length above 0 mil",
        ),
        (
            "--field-mil 900 --dot-diameter-mil 40",
            "expected --shape dot",
        ),
        (
            "--field-mil 900 --shape dot --arm-length-mil 40",
            "expected --shape cross",
        ),
    ] {
        let said = design(options);
        assert!(said.contains(error), "{said}");
    }
}

#[test]
fn marks_that_do_not_fit_on_the_disc_are_refused() {
    let settings = DesignSettings {
        trials: 1,
        exchanges: 0,
        ..DesignSettings::new(1000.0, 60)
    };
    let error = design(&demo(), &settings, &|| ()).unwrap_err().to_string();
    assert!(error.contains("space for 60 marks"), "{error}");
}
