//! Plates other than that of 2013: any marks, crosses or dots, from the file to the refined flight.

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::Value;
use solaspect::accuracy::{DESIGNS, Figures, PLATES, Program, Size, text};
use solaspect::aspect::{Expected, Quality, Solution, solve};
use solaspect::instrument::Instrument;
use solaspect::plate::{MarkId, Pattern};
use solaspect::reasons::sun;
use solaspect::simulate::{Conditions, RandomScenes, SUN_RADIUS_ARCSEC};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

const DEMO: &str = include_str!("../calibration/demo.toml");
const ARMS: &str = "arm_length_mil = { value = 90, source = \"Cramer 2014, section 4.3.1\", date = 2014-05-01 }\n\
                    arm_width_mil = { value = 12, source = \"Cramer 2014, section 4.3.1\", date = 2014-05-01 }\n";
const DOT: &str = "shape = \"dot\"\ndot_diameter_mil = { value = 50, source = \"drawing\" }\n";

/// Random positions, mil, more than 200 mil from each other.
fn scattered(count: usize) -> Vec<[f64; 2]> {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(57);
    let mut places: Vec<[f64; 2]> = Vec::new();
    while places.len() < count {
        let [x, y] = [(); 2].map(|()| rng.random_range(-3000.0..3000.0));
        if places.iter().all(|[a, b]| (x - a).hypot(y - b) > 200.0) {
            places.push([x, y]);
        }
    }
    places
}

/// Positions on a regular grid, mil.
fn grid(step_mil: f64) -> Vec<[f64; 2]> {
    let along = || (-10..=10).map(|n| f64::from(n) * step_mil);
    along().flat_map(|x| along().map(move |y| [x, y])).collect()
}

fn table(places: &[[f64; 2]]) -> String {
    let mut text = String::from("# the drawing\ni,j,x_mil,y_mil\n");
    for (n, [x, y]) in places.iter().enumerate() {
        writeln!(text, "{},0,{x},{y}", 300 + n).unwrap();
    }
    text
}

/// An instrument file and its table of marks.
fn instrument(folder: &Path, places: &[[f64; 2]], change: impl Fn(String) -> String) -> PathBuf {
    fs::create_dir_all(folder.join("drawings")).unwrap();
    fs::write(folder.join("drawings/marks.csv"), table(places)).unwrap();
    let toml = DEMO.replacen("name = \"demo\"", "name = \"own\"", 1);
    let toml = toml.replace("[plate]\n", "[plate]\nmarks = \"drawings/marks.csv\"\n");
    let file = folder.join("own.toml");
    fs::write(&file, change(toml)).unwrap();
    file
}

fn with_dots(toml: String) -> String {
    let changed = toml.replace(ARMS, DOT);
    assert_ne!(changed, toml);
    changed
}

/// Solutions of frames taken by one instrument and solved with the file of another, and each Sun's distance from its true position, mil.
fn solved(taken_by: &Instrument, stated: &Instrument, frames: u64) -> Vec<(Solution, f64)> {
    let scenes = RandomScenes::new(taken_by, &Conditions::of(taken_by), 11).unwrap();
    let expected = Some(Expected {
        radius_arcsec: SUN_RADIUS_ARCSEC,
    });
    let solution = |n| {
        let picture = scenes.scene(n).unwrap().picture().unwrap();
        let solution = solve(&picture.frame, stated, expected, None);
        let found = solution.aspect.map(|aspect| aspect.sun_plate.position);
        let truth = picture.truth.sun.unwrap().plate;
        (
            solution,
            found.map_or(f64::INFINITY, |found| found.distance(truth)),
        )
    };
    (0..frames).map(solution).collect()
}

fn fine(solutions: &[(Solution, f64)]) -> impl Iterator<Item = &(Solution, f64)> {
    let is_fine = |(solution, _): &&(Solution, f64)| solution.quality == Quality::Fine;
    solutions.iter().filter(is_fine)
}

fn solaspect(folder: &Path, arguments: &str) -> (bool, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_solaspect"));
    command.current_dir(folder).args(arguments.split(' '));
    let output = command.output().unwrap();
    let said = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    (output.status.success(), said.concat())
}

#[test]
fn other_plates_lenses_and_cameras_are_read_as_well_as_the_demos() {
    assert_demands_are_met(PLATES);
}

#[test]
fn designed_plates_are_read_all_over_and_the_check_of_plates_is_right() {
    assert_demands_are_met(DESIGNS);
}

fn assert_demands_are_met(part: &str) {
    let program = Program::new(Size::Small, &[part.into()], Figures::Left, None).unwrap();
    let report = program.run(&|| {}).unwrap();
    println!("{}", text(&report));
    assert_eq!(report.unmet(), []);
}

#[test]
fn on_a_regular_grid_the_stated_centre_decides_nothing_whether_it_is_true_or_not() {
    let folder = tempfile::tempdir().unwrap();
    for change in [|toml: String| toml, with_dots] {
        let file = instrument(folder.path(), &grid(300.0), change);
        let stated = Instrument::read(&file).unwrap();
        // A camera in its stated place, and one shifted by one period of the grid.
        for period in [0.0, 1.0] {
            let mut moved = stated.clone();
            moved.mounting.plate_centre_px.x += period * 300.0 / 5.75;
            let solutions = solved(&moved, &stated, 30);
            assert_eq!(fine(&solutions).count(), 0);
            let alone = solutions.iter().filter_map(|(s, _)| s.stopped);
            let alone = alone.filter(|stopped| stopped.rejected.reason == sun::CENTRE_ALONE);
            assert!(alone.count() > 20);
        }
    }
}

#[test]
fn dots_turned_beyond_what_is_stated_are_never_fine_and_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let file = instrument(folder.path(), &scattered(200), with_dots);
    let stated = Instrument::read(&file).unwrap();
    for turned_deg in [0.0, 2.0, 5.0, 7.0, 12.0, 30.0, 90.0, 180.0] {
        let mut turned = stated.clone();
        turned.mounting.rotation_deg.value += turned_deg;
        let solutions = solved(&turned, &stated, 12);
        for (_, off_mil) in fine(&solutions) {
            assert!(*off_mil < 1.0, "{off_mil} mil off at {turned_deg} deg");
        }
        // Within two sigmas of the stated rotation, all frames with enough marks are solved.
        assert!(
            turned_deg > 2.0 || fine(&solutions).count() > 8,
            "{turned_deg} deg"
        );
        assert!(
            turned_deg < 12.0 || fine(&solutions).count() == 0,
            "{turned_deg} deg"
        );
    }
}

#[test]
fn marks_of_the_other_shape_are_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let [crosses, dots] = [|toml: String| toml, with_dots].map(|change| {
        let file = instrument(folder.path(), &scattered(200), change);
        Instrument::read(&file).unwrap()
    });
    for (taken_by, stated) in [(&crosses, &dots), (&dots, &crosses)] {
        for (solution, _) in solved(taken_by, stated, 12) {
            assert_ne!(solution.quality, Quality::Fine);
            assert_eq!(solution.marks.len(), 0);
        }
    }
}

#[test]
fn a_plate_of_ones_own_goes_through_flight_calibration_and_refine() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    instrument(root, &scattered(230), |toml| toml);
    let run = |arguments: &str| {
        let (succeeded, said) = solaspect(root, arguments);
        assert!(succeeded, "{arguments}: {said}");
        assert!(
            !said.contains("2013") || arguments.contains("simulate"),
            "{arguments}: {said}"
        );
        said
    };
    // The laboratory: frames of two poses, the calibration, then the calibration again from its own result.
    let turned = fs::read_to_string(root.join("own.toml")).unwrap();
    let turned = turned.replace("rotation_deg = { value = 0", "rotation_deg = { value = 25");
    fs::write(root.join("turned.toml"), turned).unwrap();
    run("simulate --frames 60 --seed 1 --instrument own.toml --out a");
    run("simulate --frames 60 --seed 2 --instrument turned.toml --out b");
    let said =
        run("calibrate plate a b --instrument own.toml --out calibrated.toml --report report");
    assert!(said.contains("mil rms off the drawing"), "{said}");
    let calibrated = Instrument::read(&root.join("calibrated.toml")).unwrap();
    assert_eq!(
        (calibrated.plate.pattern(), calibrated.plate.count()),
        (Pattern::Table, 230)
    );
    let [first, _] = scattered(230)[0];
    let id = MarkId::new(300, 0).unwrap();
    assert_eq!(calibrated.plate.drawn_position(id).unwrap().x, first);
    let off = |(id, drawn): (MarkId, _)| Some(calibrated.plate.measured(id)?.at.distance(drawn));
    let measured: Vec<f64> = calibrated.plate.drawn_marks().filter_map(off).collect();
    assert!(
        measured.len() > 60 && measured.iter().all(|mil| *mil < 2.0),
        "{measured:?}"
    );
    let said = run("calibrate plate a b --instrument calibrated.toml --out again.toml");
    assert!(said.contains("its marks begin with the drawing"), "{said}");
    // The file contains the table, so the drawing is no longer needed.
    fs::remove_dir_all(root.join("drawings")).unwrap();
    // The flight, its archive, and the refinement on the ground.
    let configuration = "[camera]\nsource = \"simulated\"\nrate_hz = 10\ninstrument = \"calibrated.toml\"\n\
                         [archive]\ndirectory = \"archive\"\n";
    fs::write(root.join("flight.toml"), configuration).unwrap();
    run("config check flight.toml");
    run("fly --config flight.toml --duration 2s");
    let said = run("refine archive --out refined");
    let fine: usize = said
        .split(" files: ")
        .nth(1)
        .unwrap()
        .split(' ')
        .next()
        .unwrap()
        .parse()
        .unwrap();
    assert!(fine >= 15, "{said}");
    assert!(root.join("report/index.html").is_file());
}

#[test]
fn a_lens_that_does_not_fit_its_plate_is_named_before_the_flight() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let short = DEMO.replace("_mm = { value = 3000,", "_mm = { value = 1000,");
    assert_ne!(short, DEMO);
    fs::write(root.join("short.toml"), short).unwrap();
    let configuration = "[camera]\nsource = \"simulated\"\ninstrument = \"short.toml\"\n";
    fs::write(root.join("flight.toml"), configuration).unwrap();
    let (succeeded, said) = solaspect(root, "config check --json flight.toml");
    let _: Value = serde_json::from_str(said.lines().next().unwrap()).unwrap();
    assert!(!succeeded && said.contains("camera.instrument"), "{said}");
    assert!(said.contains("no frame can be read"), "{said}");
}

#[test]
fn what_is_wrong_with_a_drawing_names_the_file_and_the_field() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |places: &[[f64; 2]], change: &dyn Fn(String) -> String| {
        let file = instrument(folder.path(), places, change);
        let error = Instrument::read(&file).unwrap_err().to_string();
        error.replace(&folder.path().display().to_string(), "")
    };
    let some = scattered(20);
    let as_is = |toml: String| toml;
    assert_eq!(
        refused(&[], &as_is),
        "/own.toml: plate.marks: expected 3 to 2000 marks, found 0"
    );
    assert_eq!(
        refused(&[[0.0, 0.0], [500.0, 0.0], [600.0, 0.0]], &as_is),
        "/own.toml: plate.marks: expected marks at least 180 mil apart, twice a mark's size, found (301, 0) and (302, 0) 100.0 mil apart"
    );
    assert_eq!(
        refused(&[[30_000.0, 0.0], [500.0, 0.0], [0.0, 0.0]], &as_is),
        "/drawings/marks.csv: mark (300, 0): x: expected a number from -20000 to 20000 mil, found 30000"
    );
    let missing = |toml: String| toml.replace("drawings/marks.csv", "drawings/none.csv");
    let error = refused(&some, &missing);
    assert!(
        error.starts_with("/drawings/none.csv: expected a readable file"),
        "{error}"
    );
    let both = |toml: String| toml.replace("[plate]\n", "[plate]\npattern = \"heroes\"\n");
    assert_eq!(
        refused(&some, &both),
        "/own.toml: plate.pattern: expected one drawing, by marks or by pattern, found pattern = \"heroes\" beside marks"
    );
    let small = |toml: String| {
        toml.replace(
            "arm_length_mil = { value = 90",
            "arm_length_mil = { value = 10",
        )
    };
    let error = refused(&some, &small);
    assert!(
        error.starts_with(
            "/own.toml: plate.arm_length_mil: expected a number from 17.25 to 345 mil"
        ),
        "{error}"
    );
    let dot = |toml: String| toml.replace("[plate]\n", "[plate]\nshape = \"dot\"\n");
    let error = refused(&some, &dot);
    assert!(
        error.starts_with("/own.toml: plate.arm_length_mil: expected none"),
        "{error}"
    );
    let unknown = |toml: String| toml + "\n[[plate.mark]]\nid = [1, 0]\nposition_mil = [270, 90]\n";
    assert_eq!(
        refused(&some, &unknown),
        "/own.toml: plate.mark[0].id: expected a mark of the drawing, found (1, 0)"
    );
}

#[test]
fn marks_listed_in_the_file_are_the_drawing_unless_they_are_those_of_2013() {
    let listed = |places: &[[f64; 2]]| {
        let mut toml = String::from(DEMO);
        for (n, place) in places.iter().enumerate() {
            write!(
                toml,
                "\n[[plate.mark]]\nid = [{n}, 0]\nposition_mil = {place:?}\n"
            )
            .unwrap();
        }
        Instrument::parse(Path::new("listed.toml"), &toml)
            .unwrap()
            .plate
    };
    let own = listed(&scattered(20));
    assert_eq!((own.pattern(), own.count()), (Pattern::Listed, 20));
    // Measured marks (0, 0) and (1, 0) of the plate of 2013.
    let measured = listed(&[[0.2, 0.1], [270.3, 90.1]]);
    assert_eq!(
        (measured.pattern(), measured.count()),
        (Pattern::Heroes, 225)
    );
    assert!(measured.measured(MarkId::new(1, 0).unwrap()).is_some());
}
