//! The sky coordinates in a frame's file agree with the picture: sunspots, the limb, the boresight.

use nalgebra::{Matrix2, Vector2, Vector3};
use solaspect::archive::{Helioprojection, Store, instrument_cards, sky_cards, tables};
use solaspect::aspect::{self, Aspect, Expected, Quality, Solution, SolverSettings};
use solaspect::fits::{Compression, Header, Value, read_keywords};
use solaspect::frame::{Frame, FrameInfo, Pixels};
use solaspect::geometry::{Distortion, Handedness, LocalSimilarity, Mapping, SimilarityParameters};
use solaspect::instrument::{Directions, Instrument, builtin};
use solaspect::pointing::{HelioprojectiveArcsec, Roll, Target, offset, offset_of, pointing};
use solaspect::record::Record;
use solaspect::simulate::{Scene, Sun, Sunspot, keystoned};
use solaspect::sky::sphere::{bearing_rad, direction, separation_rad, travel};
use solaspect::sky::{Ephemeris, SunPosition};
use solaspect::units::{ARCSEC_PER_RAD, Estimate, MIL_MM, Measured, Place, PlateMil, SensorPx};
use std::io::Write;
use std::path::Path;
use std::time::Duration;

/// World coordinates as a reader of the file interprets them (FITS 4.0, section 8; Calabretta and Greisen 2002 for TAN).
struct Coordinates {
    reference: Vector2<f64>,
    matrix: Matrix2<f64>,
}

impl Coordinates {
    fn read(header: &Header) -> Self {
        let number = |name: &str| match header.get(name) {
            Some(Value::Float(number)) => *number,
            Some(Value::Integer(number)) => *number as f64,
            other => panic!("{name}: {other:?}"),
        };
        let text = |name: &str| header.get(name).cloned();
        assert_eq!(text("CTYPE1"), Some("HPLN-TAN".into()));
        assert_eq!(text("CTYPE2"), Some("HPLT-TAN".into()));
        assert_eq!(text("CUNIT1"), Some("arcsec".into()));
        assert_eq!([number("CRVAL1"), number("CRVAL2")], [0.0, 0.0]);
        let scale = Matrix2::from_diagonal(&Vector2::new(number("CDELT1"), number("CDELT2")));
        let turn = Matrix2::new(
            number("PC1_1"),
            number("PC1_2"),
            number("PC2_1"),
            number("PC2_2"),
        );
        // FITS counts pixels from 1.
        let reference = Vector2::new(number("CRPIX1") - 1.0, number("CRPIX2") - 1.0);
        Self {
            reference,
            matrix: scale * turn,
        }
    }

    fn of(projection: &Helioprojection) -> Self {
        Self {
            reference: projection.centre_px.vector(),
            matrix: projection.arcsec_per_px,
        }
    }

    fn at(&self, px: SensorPx) -> HelioprojectiveArcsec {
        let plane = self.matrix * (px.vector() - self.reference) / ARCSEC_PER_RAD;
        let longitude = plane.x.atan();
        let latitude = (plane.y * longitude.cos()).atan();
        HelioprojectiveArcsec {
            x: longitude * ARCSEC_PER_RAD,
            y: latitude * ARCSEC_PER_RAD,
        }
    }
}

#[derive(Clone, Copy)]
struct Case {
    name: &'static str,
    directions: Directions,
    instrument: &'static str,
    sun_plate: PlateMil,
    rotation_deg: f64,
    keystone_deg: f64,
    utc: &'static str,
    place: [f64; 3],
    spot: HelioprojectiveArcsec,
}

/// Every case with both conventions of directions.
fn cases() -> impl Iterator<Item = Case> {
    let by = |case| Directions::ALL.map(|directions| Case { directions, ..case });
    CASES.into_iter().flat_map(by)
}

const CASES: [Case; 4] = [
    Case {
        name: "north-west",
        directions: Directions::Telescope,
        instrument: "demo",
        sun_plate: PlateMil::new(250.0, -700.0),
        rotation_deg: 0.3,
        keystone_deg: 0.0,
        utc: "2013-09-21T15:00:00.0075Z",
        place: [34.49, -104.2218, 38_405.0],
        spot: HelioprojectiveArcsec { x: 500.0, y: 250.0 },
    },
    Case {
        name: "north-east",
        directions: Directions::Telescope,
        instrument: "heroes-pyas-f",
        sun_plate: PlateMil::new(-900.0, 600.0),
        rotation_deg: -0.8,
        keystone_deg: 0.0,
        utc: "2013-09-21T22:00:00.0075Z",
        place: [34.49, -104.2218, 38_405.0],
        spot: HelioprojectiveArcsec {
            x: -650.0,
            y: 200.0,
        },
    },
    Case {
        name: "south-west",
        directions: Directions::Telescope,
        instrument: "heroes-pyas-r",
        sun_plate: PlateMil::new(1500.0, 900.0),
        rotation_deg: 3.0,
        keystone_deg: 1.0,
        utc: "2017-01-05T02:30:00.0075Z",
        place: [-77.85, 166.67, 39_000.0],
        spot: HelioprojectiveArcsec {
            x: 300.0,
            y: -640.0,
        },
    },
    Case {
        name: "south-east",
        directions: Directions::Telescope,
        instrument: "demo",
        sun_plate: PlateMil::new(-300.0, -1200.0),
        rotation_deg: 137.0,
        keystone_deg: 0.0,
        utc: "2016-06-20T11:45:00.0075Z",
        place: [67.89, 21.1, 36_000.0],
        spot: HelioprojectiveArcsec {
            x: -210.0,
            y: -480.0,
        },
    },
];

impl Case {
    fn instrument(&self) -> Instrument {
        let mut instrument = builtin(self.instrument).unwrap();
        instrument.mounting.directions = self.directions;
        instrument
    }

    fn name(&self) -> String {
        format!("{}-{}", self.name, self.directions.name())
    }

    /// Position of the spot on the plate, relative to the Sun's centre.
    fn spot_mil(&self) -> Vector2<f64> {
        match self.directions {
            Directions::Sun2013 => self.spot_mil_sun_2013(),
            Directions::Telescope => self.spot_mil_telescope(),
        }
    }

    /// By the convention of the HEROES flight program alone: the boresight is at the bearing -(direction + clocking) from the Sun, and
    /// a point on that side of the Sun is observed on that side of it.
    fn spot_mil_sun_2013(&self) -> Vector2<f64> {
        let mounting = self.instrument().mounting;
        let to_boresight = std::f64::consts::PI
            - self.spot_bearing_rad()
            - mounting.clocking_deg.value.to_radians();
        let (sin, cos) = to_boresight.sin_cos();
        Vector2::new(sin, cos) * self.distance_mil() * self.spot_angle_rad().tan()
    }

    /// By the plate's plane in the telescope: an object at the position angle D is observed in the direction -(D + 180 deg) - clocking.
    fn spot_mil_telescope(&self) -> Vector2<f64> {
        let (instrument, sun) = (self.instrument(), self.sun());
        let towards = pointing(self.sun_plate, Roll::Stated, &instrument, &sun).unwrap();
        let towards = direction(towards.azimuth_deg, towards.elevation_deg);
        let clocking = instrument.mounting.clocking_deg.value.to_radians();
        let seen = |thing: &Vector3<f64>| {
            let seen = -bearing_rad(&towards, thing) - std::f64::consts::PI - clocking;
            let length_mil = self.distance_mil() * separation_rad(&towards, thing).tan();
            Vector2::new(seen.sin(), seen.cos()) * length_mil
        };
        let centre = direction(sun.azimuth_deg, sun.elevation_deg);
        let spot = travel(&centre, self.spot_bearing_rad(), self.spot_angle_rad());
        seen(&spot) - seen(&centre)
    }

    /// Bearing of the spot from the Sun's centre, clockwise from the zenith.
    fn spot_bearing_rad(&self) -> f64 {
        self.sun().zenith_to_north_deg.to_radians() + self.spot.x.atan2(self.spot.y)
    }

    fn spot_angle_rad(&self) -> f64 {
        self.spot.x.hypot(self.spot.y) / ARCSEC_PER_RAD
    }

    fn distance_mil(&self) -> f64 {
        self.instrument().optics.plate_distance_mm.value / MIL_MM
    }

    fn info(&self) -> FrameInfo {
        let [latitude, longitude, height] = self.place;
        FrameInfo {
            number: Some(1),
            mid_exposure: Some(self.utc.parse().unwrap()),
            exposure: Some(Duration::from_millis(15)),
            place: Some(Place::new(latitude, longitude, height).unwrap()),
            ..FrameInfo::default()
        }
    }

    fn sun(&self) -> SunPosition {
        let info = self.info();
        let mut ephemeris = Ephemeris::default();
        ephemeris
            .sun(info.mid_exposure.unwrap(), info.place.unwrap())
            .unwrap()
    }

    /// A scene of the Sun with its spot on the plate with its marks.
    fn scene(&self) -> Scene {
        let instrument = self.instrument();
        let mut parameters = instrument.mounting.similarity();
        parameters.rotation_deg += self.rotation_deg;
        let mapping = keystoned(
            parameters,
            self.keystone_deg,
            instrument.camera.width_px,
            Distortion::NONE,
        );
        let radius_mil = instrument.optics.radius_mil(self.radius_arcsec());
        Scene {
            sun: Some(Sun {
                spots: vec![Sunspot {
                    offset_mil: self.spot_mil(),
                    radius_mil: 16.0,
                    contrast: 0.7,
                }],
                ..Sun::new(self.sun_plate, radius_mil)
            }),
            info: self.info(),
            ..Scene::new(&instrument, mapping.unwrap())
        }
    }

    fn radius_arcsec(&self) -> f64 {
        (695_700.0 / (self.sun().distance_au * 149_597_870.7)).asin() * ARCSEC_PER_RAD
    }

    /// Solves and archives the frame; returns the keywords of the file.
    fn archived(&self, root: &Path) -> Header {
        let instrument = self.instrument();
        let frame = self.scene().frame().unwrap();
        let mut solution = solve(&frame, &instrument);
        assert_eq!(solution.quality, Quality::Fine, "{}", self.name());
        let (target, mut ephemeris) = (Target::default(), Ephemeris::default());
        let (utc, place) = (frame.info.mid_exposure, frame.info.place);
        let offset = offset_of(
            &mut solution,
            utc,
            place,
            &target,
            None,
            &instrument,
            &mut ephemeris,
        );
        let mut cards = Record::new("", utc, &solution, offset, None).cards();
        cards.extend(instrument_cards(&instrument, Roll::Stated));
        cards.extend(sky_cards(
            &frame.info,
            &solution,
            Roll::Stated,
            &instrument,
            &target,
            &mut ephemeris,
        ));
        let store = Store::open(root, &self.name(), Compression::Rice).unwrap();
        let path = store.write(&frame, &cards, &tables(&solution)).unwrap();
        read_keywords(&path).unwrap()
    }
}

fn solve(frame: &Frame, instrument: &Instrument) -> Solution {
    let expected = frame.info.mid_exposure.and_then(Expected::at);
    aspect::solve_with(
        &SolverSettings::default(),
        frame,
        instrument,
        expected,
        None,
    )
}

/// Position of the spot, px: the centroid of the brightness it removes from a uniform Sun without marks.
fn spot_px(case: &Case) -> SensorPx {
    let mut scene = case.scene();
    scene.mark_contrast = 0.0;
    if let Some(sun) = &mut scene.sun {
        sun.limb_darkening = 0.0;
    }
    let spotted = scene.frame().unwrap();
    if let Some(sun) = &mut scene.sun {
        sun.spots.clear();
    }
    let clean = scene.frame().unwrap();
    let (Pixels::U8(spotted), Pixels::U8(clean)) = (spotted.pixels(), clean.pixels()) else {
        panic!("expected 8-bit frames");
    };
    let mut sum = 0.0;
    let mut moment = Vector2::zeros();
    for (n, (with, without)) in spotted.iter().zip(clean).enumerate() {
        let taken = f64::from(*without) - f64::from(*with);
        let (x, y) = (n % scene.width_px, n / scene.width_px);
        sum += taken;
        moment += Vector2::new(x as f64, y as f64) * taken;
    }
    (moment / sum).into()
}

/// If SOLASPECT_SUNSPOTS names a folder, the files are kept there, with a list of the spots' positions.
#[test]
fn a_sunspot_has_its_helioprojective_place_by_the_files_coordinates() {
    let temporary = tempfile::tempdir().unwrap();
    let kept = std::env::var_os("SOLASPECT_SUNSPOTS");
    let root = kept.as_ref().map_or(temporary.path(), Path::new);
    let mut list = String::from("name,x_arcsec,y_arcsec,x_px,y_px\n");
    for case in cases() {
        let (header, name) = (case.archived(root), case.name());
        let px = spot_px(&case);
        let found = Coordinates::read(&header).at(px);
        let off_arcsec = (found.x - case.spot.x).hypot(found.y - case.spot.y);
        println!("{name}: off by {off_arcsec:.3} arcsec");
        assert!(off_arcsec < 0.5, "{name}: {found:?}");
        let spot = case.spot;
        list += &format!("{name},{},{},{},{}\n", spot.x, spot.y, px.x, px.y);
    }
    let mut file = std::fs::File::create(root.join("sunspots.csv")).unwrap();
    file.write_all(list.as_bytes()).unwrap();
}

#[test]
fn the_limb_is_where_the_coordinates_say_to_a_tenth_of_a_pixel() {
    let root = tempfile::tempdir().unwrap();
    for case in cases() {
        let coordinates = Coordinates::read(&case.archived(root.path()));
        let scene = case.scene();
        let sun = scene.sun.as_ref().unwrap();
        let scale = coordinates.matrix.determinant().abs().sqrt();
        for degree in 0..360 {
            let (sin, cos) = f64::from(degree).to_radians().sin_cos();
            let edge = sun.centre.vector() + Vector2::new(cos, sin) * sun.radius_mil;
            let found = coordinates.at(scene.mapping.to_sensor(edge.into()));
            let off_px = (found.x.hypot(found.y) - case.radius_arcsec()) / scale;
            assert!(off_px.abs() < 0.1, "{}: {off_px} px", case.name());
        }
    }
}

/// An aspect without error.
fn exact_aspect(sun_plate: PlateMil, mapping: &Mapping) -> Aspect {
    let covariance = Matrix2::zeros();
    let sun_px = mapping.to_sensor(sun_plate);
    Aspect {
        sun_px: Estimate {
            position: sun_px,
            covariance,
        },
        sun_radius_px: Measured::new(95.0, 0.0),
        mapping: LocalSimilarity {
            scale_mil_per_px: Measured::new(mapping.scale_mil_per_px(sun_px), 0.0),
            rotation_deg: Measured::new(mapping.rotation_deg(sun_px), 0.0),
        },
        sun_plate: Estimate {
            position: sun_plate,
            covariance,
        },
        limb_fraction: 1.0,
    }
}

#[test]
fn the_boresights_pixel_has_the_coordinates_that_leave_no_offset() {
    for (azimuth_deg, elevation_deg, turn_deg) in [
        (158.5, 54.0, -42.7),
        (10.0, 5.0, 170.0),
        (254.6, 71.0, 12.0),
    ] {
        for (directions, roll_deg, rotation_deg, handedness) in [
            (Directions::Telescope, 0.0, 0.0, Handedness::Mirrored),
            (Directions::Telescope, 1.7, 180.7, Handedness::Mirrored),
            (Directions::Telescope, -0.6, 33.0, Handedness::Direct),
            (Directions::Sun2013, 0.0, 0.0, Handedness::Mirrored),
            (Directions::Sun2013, 1.7, 180.7, Handedness::Mirrored),
            (Directions::Sun2013, 0.0, 33.0, Handedness::Direct),
        ] {
            let roll = Roll::Measured(Measured::new(roll_deg, 0.0));
            for sun_plate in [PlateMil::new(-600.0, 1300.0), PlateMil::new(2100.0, -40.0)] {
                let mut instrument = builtin("heroes-pyas-f").unwrap();
                instrument.mounting.directions = directions;
                let sun = SunPosition {
                    azimuth_deg,
                    elevation_deg,
                    zenith_to_north_deg: turn_deg,
                    ..CASES[0].sun()
                };
                let parameters = SimilarityParameters {
                    rotation_deg,
                    handedness,
                    ..instrument.mounting.similarity()
                };
                let mapping = Mapping::similarity(parameters, Distortion::NONE).unwrap();
                let aspect = exact_aspect(sun_plate, &mapping);
                let projection = Helioprojection::new(&aspect, &mapping, roll, &instrument, &sun);
                let coordinates = Coordinates::of(&projection.unwrap().unwrap());
                let boresight = mapping.to_sensor(instrument.mounting.boresight_mil);
                let pointing = coordinates.at(boresight);
                let left = offset(aspect.sun_plate, roll, &instrument, &sun, pointing).unwrap();
                let across = left.azimuth_deg * elevation_deg.to_radians().cos();
                let left_arcsec = across.hypot(left.elevation_deg) * 3600.0;
                assert!(left_arcsec < 0.1, "{left_arcsec} arcsec, {pointing:?}");
            }
        }
    }
}

#[test]
fn a_frame_without_a_sun_a_time_or_a_place_has_no_world_coordinates() {
    let case = &CASES[0];
    let instrument = case.instrument();
    let frame = case.scene().frame().unwrap();
    let solution = solve(&frame, &instrument);
    let names = |info: &FrameInfo, solution: &Solution| -> Vec<&str> {
        let target = Target::default();
        let cards = sky_cards(
            info,
            solution,
            Roll::Stated,
            &instrument,
            &target,
            &mut Ephemeris::default(),
        );
        cards.iter().map(|card| card.keyword.name).collect()
    };
    let info = &frame.info;
    assert!(names(info, &solution).contains(&"CTYPE1"));
    let timeless = FrameInfo {
        mid_exposure: None,
        ..info.clone()
    };
    let placeless = FrameInfo {
        place: None,
        ..info.clone()
    };
    assert!(names(&timeless, &solution).is_empty());
    assert!(names(&placeless, &solution).is_empty());
    let dark = Scene {
        sun: None,
        ..case.scene()
    }
    .frame()
    .unwrap();
    let sunless = names(info, &solve(&dark, &instrument));
    assert!(sunless.contains(&"DSUN_OBS"));
    for keyword in ["WCSAXES", "CTYPE1", "CRPIX1", "CDELT1", "PC1_1", "CUNIT1"] {
        assert!(!sunless.contains(&keyword), "{keyword}");
    }
}
