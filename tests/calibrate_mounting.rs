//! `solaspect calibrate mounting` determines boresight, clocking and plate distance, and reports what it cannot determine.

use jiff::{SignedDuration, Timestamp};
use nalgebra::{Matrix2, Vector2};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;
use solaspect::calibrate::mounting::{
    Mounting, MountingError, Pointings, SunObservation, Unknown, calibrate,
};
use solaspect::calibrate::quantity::Verdict;
use solaspect::calibrate::revision::{Provenance, Revision};
use solaspect::frame::{Frame, FrameInfo, Pixels};
use solaspect::instrument::{Directions, Instrument, builtin, builtin_text};
use solaspect::pointing::{self, Horizontal, Roll};
use solaspect::simulate::FORT_SUMNER;
use solaspect::sky::{Ephemeris, SunPosition};
use solaspect::units::{Estimate, Place, PlateMil};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The demo instrument with a given convention of directions.
fn demo_by(directions: Directions) -> Instrument {
    let mut instrument = builtin("demo").unwrap();
    instrument.mounting.directions = directions;
    instrument
}

/// The demo instrument with another mounting.
fn true_instrument(directions: Directions) -> Instrument {
    let mut instrument = demo_by(directions);
    instrument.mounting.boresight_mil = PlateMil::new(-85.59, -68.64);
    instrument.mounting.clocking_deg.value = -51.3;
    instrument.optics.plate_distance_mm.value = 3005.0;
    instrument
}

#[derive(Clone, Copy)]
struct Scan {
    /// Convention of directions of the true instrument.
    directions: Directions,
    start: &'static str,
    count: usize,
    every_s: f64,
    /// 1 sigma per axis of the Sun's position on the plate.
    noise_mil: f64,
    place: Place,
    seed: u64,
}

const TEN_MINUTES: Scan = Scan {
    directions: Directions::Telescope,
    start: "2013-09-21T18:00:00Z",
    count: 600,
    every_s: 1.0,
    noise_mil: 0.05,
    place: FORT_SUMNER,
    seed: 1,
};

impl Scan {
    /// The same scan with both conventions.
    fn by_both(self) -> [Self; 2] {
        Directions::ALL.map(|directions| Self { directions, ..self })
    }

    /// The instrument that a scan with unknown pointing starts from. With directions at the telescope the clocking
    /// relies on the stated centre, so the centre is drawn with its sigma of 1 mil.
    fn stated(&self) -> Instrument {
        let mut stated = demo_by(self.directions);
        let mounting = &mut stated.mounting;
        if self.directions == Directions::Telescope {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(1000 + self.seed);
            let [dx, dy]: [f64; 2] = std::array::from_fn(|_| rng.sample(StandardNormal));
            let truth = true_instrument(self.directions).mounting.boresight_mil;
            let off = Vector2::new(dx, dy) * mounting.boresight_sigma_mil;
            mounting.boresight_mil = (truth.vector() + off).into();
        }
        stated
    }

    fn suns(&self) -> Vec<(Timestamp, SunPosition)> {
        let start: Timestamp = self.start.parse().unwrap();
        let mut ephemeris = Ephemeris::default();
        let at =
            |n: usize| start + SignedDuration::try_from_secs_f64(n as f64 * self.every_s).unwrap();
        (0..self.count)
            .map(|n| (at(n), ephemeris.sun(at(n), self.place).unwrap()))
            .collect()
    }

    /// Observations by the true instrument, its telescope pointed by `towards` at each instant.
    fn observations(
        &self,
        towards: impl Fn(usize, &SunPosition) -> Horizontal,
    ) -> Vec<SunObservation> {
        let instrument = true_instrument(self.directions);
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(self.seed);
        let suns = self.suns();
        let observation = |(n, (utc, sun)): (usize, &(Timestamp, SunPosition))| {
            let pointing = towards(n, sun);
            let at = pointing::sun_on_plate(pointing, Roll::Stated, &instrument, sun).unwrap();
            let [dx, dy]: [f64; 2] = std::array::from_fn(|_| rng.sample(StandardNormal));
            let seen = at.vector() + Vector2::new(dx, dy) * self.noise_mil;
            SunObservation {
                file: format!("frame_{n:05}.fits").into(),
                utc: *utc,
                sun_plate: Estimate {
                    position: seen.into(),
                    covariance: Matrix2::identity() * self.noise_mil.powi(2),
                },
                sun: *sun,
                pointing: Some(pointing),
            }
        };
        suns.iter().enumerate().map(observation).collect()
    }

    /// The telescope points at the Sun's position in the middle of the scan.
    fn drift(&self) -> Vec<SunObservation> {
        let suns = self.suns();
        let middle = suns[self.count / 2].1;
        self.observations(|_, _| at_sun(&middle))
    }

    /// The telescope points at a grid about the Sun.
    fn grid(&self) -> Vec<SunObservation> {
        self.grid_of(0.8)
    }

    fn grid_of(&self, half_side_deg: f64) -> Vec<SunObservation> {
        self.observations(|n, sun| {
            let step = |k: usize| ((k % 5) as f64 / 2.0 - 1.0) * half_side_deg;
            Horizontal {
                azimuth_deg: sun.azimuth_deg + step(n) / sun.elevation_deg.to_radians().cos(),
                elevation_deg: sun.elevation_deg + step(n / 5),
            }
        })
    }
}

fn at_sun(sun: &SunPosition) -> Horizontal {
    Horizontal {
        azimuth_deg: sun.azimuth_deg,
        elevation_deg: sun.elevation_deg,
    }
}

fn verdict(mounting: &Mounting, name: &str) -> Verdict {
    let mut quantities = mounting.quantities.iter();
    let quantity = quantities.find(|q| q.name.starts_with(name));
    quantity
        .unwrap_or_else(|| panic!("no quantity {name}"))
        .verdict
}

/// Estimated minus true value, over the stated sigma.
fn normalised_error(mounting: &Mounting, unknown: Unknown) -> f64 {
    let truth = true_instrument(mounting.fit.directions);
    let wanted = match unknown {
        Unknown::CentreX => truth.mounting.boresight_mil.x,
        Unknown::CentreY => truth.mounting.boresight_mil.y,
        Unknown::Clocking => truth.mounting.clocking_deg.value,
        Unknown::Distance => truth.optics.plate_distance_mm.value,
        Unknown::Azimuth | Unknown::Elevation => panic!("no truth"),
    };
    let found = mounting.fit.measured(unknown).unwrap();
    (found.value - wanted) / found.sigma
}

const MOUNTING: [Unknown; 4] = [
    Unknown::CentreX,
    Unknown::CentreY,
    Unknown::Clocking,
    Unknown::Distance,
];

#[test]
fn a_drift_scan_of_ten_minutes_determines_the_clocking_and_not_the_centre() {
    for start in [
        "2013-09-21T15:00:00Z",
        "2013-06-21T18:00:00Z",
        "2013-12-21T20:00:00Z",
    ] {
        let scan = Scan {
            start,
            ..TEN_MINUTES
        };
        for scan in scan.by_both() {
            let mounting = calibrate(&scan.drift(), Pointings::Fixed, &scan.stated()).unwrap();
            let clocking = mounting.fit.measured(Unknown::Clocking).unwrap();
            assert!(
                (clocking.value + 51.3).abs() < 0.02,
                "{start}: {clocking:?}"
            );
            assert!(clocking.sigma < 0.01, "{start}: {clocking:?}");
            let distance = mounting.fit.measured(Unknown::Distance).unwrap();
            assert!((distance.value / 3005.0 - 1.0).abs() < 1e-3, "{distance:?}");
            assert_eq!(verdict(&mounting, "clocking"), Verdict::Determined);
            assert_eq!(verdict(&mounting, "centre"), Verdict::Kept);
        }
    }
}

#[test]
fn a_scan_near_the_zenith_where_azimuth_races_is_as_good() {
    for latitude_deg in [34.49, 25.0] {
        let scan = Scan {
            start: "2013-06-21T18:53:00Z",
            place: Place {
                latitude_deg,
                ..FORT_SUMNER
            },
            ..TEN_MINUTES
        };
        for scan in scan.by_both() {
            let observations = scan.drift();
            let highest = observations
                .iter()
                .map(|s| s.sun.elevation_deg)
                .fold(0.0, f64::max);
            assert!(highest > 78.0, "{highest}");
            let mounting = calibrate(&observations, Pointings::Fixed, &scan.stated()).unwrap();
            let clocking = mounting.fit.measured(Unknown::Clocking).unwrap();
            println!("{highest} {:?} {clocking:?}", scan.directions);
            assert!(
                (clocking.value + 51.3).abs() < 0.02,
                "{highest}: {clocking:?}"
            );
            assert!(mounting.rejected.len() < 10);
        }
    }
}

#[test]
fn a_grid_of_known_pointings_determines_everything() {
    let scan = Scan {
        count: 50,
        every_s: 10.0,
        ..TEN_MINUTES
    };
    for scan in scan.by_both() {
        let demo = demo_by(scan.directions);
        let mounting = calibrate(&scan.grid(), Pointings::Known, &demo).unwrap();
        let arcsec = demo.optics.arcsec_per_mil();
        let centre = PlateMil::new(mounting.fit.values[0], mounting.fit.values[1]);
        assert!(
            centre.distance(PlateMil::new(-85.59, -68.64)) * arcsec < 0.1,
            "{centre:?}"
        );
        for unknown in MOUNTING {
            assert!(
                normalised_error(&mounting, unknown).abs() < 4.0,
                "{unknown:?}"
            );
        }
        let determined = [
            "centre",
            "clocking",
            "plate's distance",
            "mirror",
            "directions",
        ];
        for name in determined {
            assert_eq!(verdict(&mounting, name), Verdict::Determined, "{name}");
        }
    }
}

#[test]
fn observations_show_their_rule_of_directions_whichever_the_instrument_states() {
    let grid = Scan {
        count: 50,
        every_s: 10.0,
        ..TEN_MINUTES
    };
    for (drift, grid) in TEN_MINUTES.by_both().into_iter().zip(grid.by_both()) {
        let true_rule = drift.directions;
        for rule in Directions::ALL {
            let mut stated = drift.stated();
            stated.mounting.directions = rule;
            let mounting = calibrate(&drift.drift(), Pointings::Fixed, &stated).unwrap();
            assert_eq!(mounting.fit.directions, true_rule, "drift, {rule:?} stated");
            assert_eq!(mounting.directions, Some(true_rule));
            let clocking = normalised_error(&mounting, Unknown::Clocking);
            assert!(clocking.abs() < 4.0, "{clocking}");
            assert_eq!(verdict(&mounting, "centre"), Verdict::Kept);
            let mounting = calibrate(&grid.grid(), Pointings::Known, &demo_by(rule)).unwrap();
            assert_eq!(mounting.fit.directions, true_rule, "grid, {rule:?} stated");
            assert_eq!(mounting.directions, Some(true_rule));
            for unknown in MOUNTING {
                let error = normalised_error(&mounting, unknown);
                assert!(error.abs() < 4.0, "{unknown:?}: {error}");
            }
            assert_eq!(verdict(&mounting, "directions"), Verdict::Determined);
        }
    }
}

#[test]
fn a_determined_rule_of_directions_is_written_and_another_is_kept() {
    let grid = Scan {
        count: 50,
        every_s: 10.0,
        ..TEN_MINUTES
    };
    let noisy = Scan {
        noise_mil: 5.0,
        ..grid
    };
    let provenance = Provenance {
        name: "mounting",
        source: "a test".into(),
        date: "2013-09-21".parse().ok(),
        frames: 50,
        frames_sha256: "0af3".into(),
        camera: None,
    };
    for (clear, noisy) in grid.by_both().into_iter().zip(noisy.by_both()) {
        for rule in Directions::ALL {
            let stated = demo_by(rule);
            let text = builtin_text("demo").unwrap();
            let text = text.replace("\"telescope\"", &format!("{:?}", rule.name()));
            let written = |observations: &[SunObservation]| {
                let mounting = calibrate(observations, Pointings::Known, &stated).unwrap();
                let mut revision = Revision::of(Path::new("a.toml"), &text).unwrap();
                mounting.revise(&mut revision, &provenance);
                (mounting, revision.finish().unwrap().1)
            };
            let (_, instrument) = written(&clear.grid());
            assert_eq!(instrument.mounting.directions, clear.directions);
            // Within 0.2 deg the conventions differ by less than the noise.
            let (mounting, instrument) = written(&noisy.grid_of(0.2));
            assert_eq!(instrument.mounting.directions, rule);
            assert_eq!(mounting.directions, None);
            assert_eq!(verdict(&mounting, "directions"), Verdict::Kept);
            let mut quantities = mounting.quantities.iter();
            assert!(quantities.any(|q| q.remark.contains("fit the observations equally well")));
        }
    }
}

#[test]
fn sigmas_are_honest_over_many_scans() {
    const RUNS: u64 = 50;
    type Way = fn(&Scan) -> Vec<SunObservation>;
    let ways: [(Pointings, Way); 2] = [
        (Pointings::Fixed, Scan::drift),
        (Pointings::Known, Scan::grid),
    ];
    let rules = Directions::ALL.into_iter();
    for (directions, (pointings, observations)) in
        rules.flat_map(|rule| ways.map(|way| (rule, way)))
    {
        let mut squares = [0.0; 4];
        for seed in 0..RUNS {
            let scan = Scan {
                directions,
                count: 60,
                every_s: 10.0,
                seed,
                ..TEN_MINUTES
            };
            let mounting = calibrate(&observations(&scan), pointings, &scan.stated()).unwrap();
            for (sum, unknown) in squares.iter_mut().zip(MOUNTING) {
                *sum += normalised_error(&mounting, unknown).powi(2);
            }
        }
        for (unknown, sum) in MOUNTING.iter().zip(squares) {
            let rms = (sum / RUNS as f64).sqrt();
            println!("{directions:?} {pointings:?} {unknown:?}: {rms:.2}");
            assert!(
                (0.75..1.3).contains(&rms),
                "{directions:?} {pointings:?} {unknown:?}: {rms:.2}"
            );
        }
    }
}

#[test]
fn a_third_of_the_observations_bad_changes_nothing_and_they_are_rejected() {
    let scan = Scan {
        count: 150,
        every_s: 4.0,
        ..TEN_MINUTES
    };
    for (pointings, clean) in [
        (Pointings::Fixed, scan.drift()),
        (Pointings::Known, scan.grid()),
    ] {
        let whole = calibrate(&clean, pointings, &scan.stated()).unwrap();
        let mut bad = clean.clone();
        for (n, observation) in bad.iter_mut().enumerate().filter(|(n, _)| n % 3 == 1) {
            let at = observation.sun_plate.position;
            observation.sun_plate.position = match n % 4 {
                0 => PlateMil::new(at.x + 342.0, at.y + 90.0), // ids one step off
                1 => PlateMil::new(1500.0, -700.0),            // another Sun
                2 => PlateMil::new(at.x + 0.8, at.y - 1.1),    // blurred
                _ => PlateMil::new(-at.x, at.y),
            };
        }
        let mounting = calibrate(&bad, pointings, &scan.stated()).unwrap();
        for unknown in MOUNTING {
            let [a, b] = [&whole, &mounting].map(|m| m.fit.measured(unknown).unwrap());
            assert!(
                (a.value - b.value).abs() < 2.0 * b.sigma,
                "{pointings:?} {unknown:?}: {a:?} {b:?}"
            );
        }
        let listed = |n: usize| mounting.rejected.iter().any(|r| r.file == bad[n].file);
        assert!((0..150).filter(|n| n % 3 == 1).all(listed), "{pointings:?}");
        assert!(mounting.rejected.len() < 53, "{}", mounting.rejected.len());
    }
}

#[test]
fn errors_that_neighbours_share_inflate_the_sigma() {
    let stated = TEN_MINUTES.stated();
    let mut observations = TEN_MINUTES.drift();
    for (n, observation) in observations.iter_mut().enumerate() {
        observation.sun_plate.position.x += 0.2 * (n as f64 / 8.0).sin();
    }
    let alone = calibrate(&TEN_MINUTES.drift(), Pointings::Fixed, &stated).unwrap();
    let shared = calibrate(&observations, Pointings::Fixed, &stated).unwrap();
    assert!(alone.fit.correlation < 1.3, "{}", alone.fit.correlation);
    assert!(shared.fit.correlation > 5.0, "{}", shared.fit.correlation);
}

#[test]
fn a_mirrored_plate_is_refused() {
    let demo = builtin("demo").unwrap();
    let mut observations = Scan {
        count: 50,
        ..TEN_MINUTES
    }
    .grid();
    for observation in &mut observations {
        observation.sun_plate.position.x *= -1.0;
    }
    let error = calibrate(&observations, Pointings::Known, &demo).unwrap_err();
    assert!(matches!(error, MountingError::Mirrored { .. }), "{error}");
}

#[test]
fn too_few_observations_or_all_in_one_place_are_refused_with_what_to_take() {
    let demo = builtin("demo").unwrap();
    let few = Scan {
        count: 4,
        ..TEN_MINUTES
    }
    .grid();
    let error = calibrate(&few, Pointings::Known, &demo)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("at least 5") && error.contains("take more"),
        "{error}"
    );
    let still = Scan {
        count: 50,
        every_s: 0.1,
        ..TEN_MINUTES
    }
    .drift();
    let error = calibrate(&still, Pointings::Fixed, &demo)
        .unwrap_err()
        .to_string();
    assert!(error.contains("all frames in one place"), "{error}");
    assert!(error.contains("10 minutes"), "{error}");
    let swaying = TEN_MINUTES.observations(|n, sun| Horizontal {
        azimuth_deg: 165.0 + 0.3 * (n as f64).sin(),
        elevation_deg: sun.elevation_deg,
    });
    let error = calibrate(&swaying, Pointings::Fixed, &demo)
        .unwrap_err()
        .to_string();
    assert!(error.contains("must stand still"), "{error}");
}

fn solaspect(arguments: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_solaspect");
    Command::new(program).args(arguments).output().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Frames of a drift scan, simulated with the true instrument.
fn simulated(folder: &Path, frames: &str, rate: &str) -> PathBuf {
    let truth = folder.join("true.toml");
    let demo = builtin_text("demo").unwrap();
    let edited = demo
        .replace("[-105.59, -48.64]", "[-85.59, -68.64]")
        .replace("value = -52.175", "value = -51.3")
        .replace(
            "plate_distance_mm = { value = 3000",
            "plate_distance_mm = { value = 3005",
        );
    std::fs::write(&truth, edited).unwrap();
    let out = folder.join("frames");
    let made = solaspect(&[
        "simulate",
        "--drift",
        "--frames",
        frames,
        "--rate",
        rate,
        "--seed",
        "5",
        "--instrument",
        text(&truth),
        "--out",
        text(&out),
    ]);
    assert!(made.status.success(), "{made:?}");
    out
}

#[test]
fn frames_of_a_drift_scan_become_a_new_instrument_file_and_a_page() {
    let folder = tempfile::tempdir().unwrap();
    let frames = simulated(folder.path(), "40", "0.0666667");
    std::fs::write(frames.join("broken.fits"), "SIMPLE  = nothing").unwrap();
    let (new, page) = (folder.path().join("new.toml"), folder.path().join("page"));
    let done = solaspect(&[
        "calibrate",
        "mounting",
        "--drift",
        "--out",
        text(&new),
        "--report",
        text(&page),
        text(&frames),
    ]);
    let said = String::from_utf8_lossy(&done.stdout);
    assert!(done.status.success(), "{done:?}");
    assert!(
        said.contains("broken.fits") && said.contains("not determined"),
        "{said}"
    );
    let found = Instrument::read(&new).unwrap();
    let clocking = found.mounting.clocking_deg;
    assert!(
        (clocking.value + 51.3).abs() < 0.05 && clocking.sigma < 0.03,
        "{clocking:?}"
    );
    let demo = builtin("demo").unwrap();
    assert_eq!(found.mounting.boresight_mil, demo.mounting.boresight_mil);
    let html = std::fs::read_to_string(page.join("mounting.html")).unwrap();
    assert!(
        html.contains("<svg") && !html.contains("http://") || html.contains("w3.org"),
        "svg"
    );

    let known = folder.path().join("known.toml");
    let log = frames.join("pointing.csv");
    let direct = folder.path().join("direct.toml");
    let text_of_demo = builtin_text("demo").unwrap();
    let wrong = text_of_demo
        .replace("\"mirrored\"", "\"direct\"")
        .replace("\"telescope\"", "\"sun-2013\"");
    std::fs::write(&direct, wrong).unwrap();
    let done = solaspect(&[
        "calibrate",
        "mounting",
        "--pointing",
        text(&log),
        "--instrument",
        text(&direct),
        "--out",
        text(&known),
        text(&frames),
    ]);
    assert!(done.status.success(), "{done:?}");
    let found = Instrument::read(&known).unwrap();
    assert_eq!(found.mounting.handedness, demo.mounting.handedness);
    assert_eq!(found.mounting.directions, Directions::Telescope);
    let off = found
        .mounting
        .boresight_mil
        .distance(PlateMil::new(-85.59, -68.64));
    assert!(off * found.optics.arcsec_per_mil() < 0.2, "{off}");
    assert!((found.mounting.clocking_deg.value + 51.3).abs() < 0.002);
}

#[test]
fn frames_without_time_place_or_of_two_cameras_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, width: usize, info: FrameInfo| {
        let pixels = Pixels::U8(vec![0; width * 966]);
        let frame = Frame::new(width, 966, pixels, 255, info).unwrap();
        let file = folder.path().join(name);
        let compression = solaspect::fits::Compression::Rice;
        solaspect::fits::write_frame(&file, &frame, &[], &[], compression).unwrap();
        text(&file).to_owned()
    };
    let timed = |camera: &str| FrameInfo {
        mid_exposure: Some("2013-09-21T18:00:00Z".parse().unwrap()),
        camera: Some(camera.into()),
        place: Some(FORT_SUMNER),
        ..FrameInfo::default()
    };
    let untimed = write("untimed.fits", 1296, FrameInfo::default());
    let unplaced = write(
        "unplaced.fits",
        1296,
        FrameInfo {
            place: None,
            ..timed("front")
        },
    );
    let front = write("front.fits", 1296, timed("front"));
    let rear = write("rear.fits", 1296, timed("rear"));
    let small = write("small.fits", 640, timed("front"));
    let out = folder.path().join("new.toml");
    for (frames, wanted) in [
        (vec![&untimed], "frames without time"),
        (vec![&unplaced], "--place"),
        (vec![&front, &rear], "mixed instruments"),
        (vec![&front, &small], "mixed instruments"),
        (vec![&front], "no frame shows the Sun"),
    ] {
        let mut arguments = vec!["calibrate", "mounting", "--drift", "--out", text(&out)];
        arguments.extend(frames.iter().map(|f| f.as_str()));
        let done = solaspect(&arguments);
        let said = String::from_utf8_lossy(&done.stderr);
        assert_eq!(done.status.code(), Some(1), "{said}");
        assert!(said.contains(wanted), "{wanted}: {said}");
        assert!(!out.exists());
    }
    let done = solaspect(&["calibrate", "mounting", "--out", text(&out), &front]);
    assert_eq!(done.status.code(), Some(2));
}
