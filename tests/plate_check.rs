//! A plate's check before it is made: what it calls safe is read, and what it calls ambiguous is not.

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use solaspect::accuracy::bound::covariance_mil2;
use solaspect::aspect::{Expected, Quality, SolverSettings, solve};
use solaspect::instrument::{Instrument, builtin};
use solaspect::plate::{MarkId, MarkPlace, MarkShape, Pattern, Plate, table_text};
use solaspect::plate_check::{CheckSettings, CheckedPlace, PlaceVerdict, PlateCheck, check, html};
use solaspect::plate_design::{DesignSettings, design, file};
use solaspect::simulate::{Noise, SUN_RADIUS_ARCSEC, Scene, Sun};
use solaspect::units::PlateMil;

fn demo() -> Instrument {
    builtin("demo").unwrap()
}

/// The demo with other marks, mil.
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

fn checked(instrument: &Instrument, places: usize) -> PlateCheck {
    let settings = CheckSettings {
        places,
        ..CheckSettings::default()
    };
    check(instrument, &SolverSettings::default(), &settings)
}

/// Frames with the Sun at a place, by a camera as it is stated: whether each is fine, and how far off, mil.
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
        // The files give the same plate again.
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
fn marks_for_which_the_disc_has_no_room_are_refused() {
    let settings = DesignSettings {
        trials: 1,
        exchanges: 0,
        ..DesignSettings::new(1000.0, 60)
    };
    let error = design(&demo(), &settings, &|| ()).unwrap_err().to_string();
    assert!(error.contains("room for 60 marks"), "{error}");
}
