//! Positions and orientations of Sun and Moon agree with astropy and sunpy; those of the Earth with the IERS.

use jiff::Timestamp;
use serde_json::Value;
use solaspect::pointing::{Feature, HelioprojectiveArcsec, PointingError};
use solaspect::sky::{
    Disc, Ephemeris, OrientationTable, Rising, SkyError, crossings, horizon_deg, sun_angular_radius,
};
use solaspect::units::Place;
use std::process::{Command, Output};

const FORT_SUMNER: [f64; 3] = [34.49, -104.2218, 38_405.0];

struct Row {
    utc: Timestamp,
    place: Place,
    /// The columns from the Sun's azimuth onwards.
    values: Vec<f64>,
}

fn rows(text: &str) -> impl Iterator<Item = &str> {
    text.lines().filter(|line| !line.starts_with('#')).skip(1)
}

/// Positions by astropy and sunpy, at places and times of flights and at random ones.
fn oracle() -> Vec<Row> {
    let texts = [
        include_str!("data/sky.csv"),
        include_str!("data/sky_random.csv"),
    ];
    let found: Vec<Row> = texts
        .into_iter()
        .flat_map(rows)
        .map(|line| {
            let (utc, rest) = line.split_once(',').unwrap();
            let numbers: Vec<f64> = rest.split(',').map(|n| n.parse().unwrap()).collect();
            Row {
                utc: format!("{utc}Z").parse().unwrap(),
                place: Place::new(numbers[0], numbers[1], numbers[2]).unwrap(),
                values: numbers[3..].to_vec(),
            }
        })
        .collect();
    assert_eq!(found.len(), 24);
    found
}

/// The largest absolute error, to be compared with a tolerance.
#[derive(Default)]
struct Worst(f64);

impl Worst {
    fn take(&mut self, error: f64) {
        assert!(error.is_finite());
        self.0 = self.0.max(error.abs());
    }

    fn within(&self, tolerance: f64, what: &str) {
        println!("{what}: {:e} of {tolerance:e}", self.0);
        assert!(self.0 <= tolerance, "{what}: off by {:e}", self.0);
    }
}

/// Difference of two angles, from -180 to 180 deg.
fn turn(found: f64, expected: f64) -> f64 {
    (found - expected + 180.0).rem_euclid(360.0) - 180.0
}

/// Angle between two nearby directions of (azimuth, elevation), arcsec.
fn apart_arcsec(found: (f64, f64), expected: (f64, f64)) -> f64 {
    let across = turn(found.0, expected.0) * expected.1.to_radians().cos();
    across.hypot(found.1 - expected.1) * 3600.0
}

#[test]
fn the_sun_stands_within_an_arcsec_of_astropys() {
    let mut ephemeris = Ephemeris::default();
    let [mut direction, mut distance, mut radius] = [(); 3].map(|()| Worst::default());
    for row in oracle() {
        let v = &row.values;
        let sun = ephemeris.sun(row.utc, row.place).unwrap();
        direction.take(apart_arcsec(
            (sun.azimuth_deg, sun.elevation_deg),
            (v[0], v[1]),
        ));
        distance.take(sun.distance_au - v[2]);
        radius.take(sun.radius_arcsec - v[3]);
        radius.take(sun_angular_radius(row.utc).unwrap() - v[3]);
    }
    direction.within(1.0, "direction, arcsec");
    distance.within(2e-7, "distance, au");
    radius.within(0.002, "radius, arcsec");
}

#[test]
fn the_sun_is_turned_as_sunpy_says() {
    let mut ephemeris = Ephemeris::default();
    let [mut p, mut b0, mut l0, mut to_north] = [(); 4].map(|()| Worst::default());
    for row in oracle() {
        let v = &row.values;
        let sun = ephemeris.sun(row.utc, row.place).unwrap();
        p.take(turn(sun.p_deg, v[4]));
        b0.take(sun.b0_deg - v[5]);
        l0.take(turn(sun.l0_deg, v[6]));
        to_north.take(turn(sun.zenith_to_north_deg, v[7]));
    }
    p.within(0.01, "P, deg");
    b0.within(0.01, "B0, deg");
    l0.within(0.01, "L0, deg");
    to_north.within(0.01, "zenith to north, deg");
}

#[test]
fn the_moon_stands_within_ten_arcsec_of_astropys() {
    let mut ephemeris = Ephemeris::default();
    let [mut direction, mut radius] = [(); 2].map(|()| Worst::default());
    for row in oracle() {
        let v = &row.values;
        let moon = ephemeris.moon(row.utc, row.place).unwrap();
        direction.take(apart_arcsec(
            (moon.azimuth_deg, moon.elevation_deg),
            (v[8], v[9]),
        ));
        radius.take(moon.radius_arcsec - v[10]);
    }
    direction.within(10.0, "direction, arcsec");
    radius.within(0.5, "radius, arcsec");
}

#[test]
fn the_moon_is_lit_as_astropy_has_it() {
    let mut ephemeris = Ephemeris::default();
    let [mut phase, mut limb] = [(); 2].map(|()| Worst::default());
    for row in oracle().iter().filter(|row| row.values.len() == 14) {
        let moon = ephemeris.moon(row.utc, row.place).unwrap();
        phase.take(moon.phase_angle_deg - row.values[12]);
        // Near full and new Moon the direction of the bright limb is ill-determined.
        let steadiness = moon.phase_angle_deg.to_radians().sin();
        limb.take(turn(moon.bright_limb_deg, row.values[13]) * steadiness);
        let tilt = moon.zenith_to_bright_limb_deg;
        assert!((-180.0..=180.0).contains(&tilt));
    }
    phase.within(0.01, "phase angle, deg");
    limb.within(0.01, "bright limb, deg");
}

#[test]
fn the_earths_clock_is_known_to_a_millisecond() {
    let table = OrientationTable::built_in();
    let agreed: Timestamp = "1990-01-01T00:00:00Z".parse().unwrap();
    let [mut ut1, mut ut1_before] = [(); 2].map(|()| Worst::default());
    for row in oracle() {
        let error = table.at(row.utc).unwrap().ut1_utc_s - row.values[11];
        if row.utc > agreed {
            ut1.take(error);
        } else {
            ut1_before.take(error);
        }
    }
    ut1.within(1e-3, "UT1 - UTC, s");
    // The IERS's own series (Bulletins A and B) differ by this much in those years.
    ut1_before.within(6e-3, "UT1 - UTC before 1990, s");
}

#[test]
fn answers_do_not_depend_on_what_was_asked_before() {
    let [latitude, longitude, height] = FORT_SUMNER;
    let place = Place::new(latitude, longitude, height).unwrap();
    let mut ephemeris = Ephemeris::default();
    for utc in [
        "2013-09-21T18:00:00.999Z",
        "2013-09-21T18:00:00.25Z",
        "2013-09-21T18:00:01Z",
        "2013-09-21T18:00:00.25Z",
    ] {
        let utc = utc.parse().unwrap();
        let alone = Ephemeris::default().sun(utc, place).unwrap();
        assert_eq!(ephemeris.sun(utc, place).unwrap(), alone);
    }
}

#[test]
fn within_a_second_the_sun_moves_without_a_jump() {
    let [latitude, longitude, height] = FORT_SUMNER;
    let place = Place::new(latitude, longitude, height).unwrap();
    let mut ephemeris = Ephemeris::default();
    let mut at = |utc: &str| ephemeris.sun(utc.parse().unwrap(), place).unwrap();
    let last = at("2013-09-21T18:00:00.999999Z");
    let next = at("2013-09-21T18:00:01Z");
    let apart = apart_arcsec(
        (last.azimuth_deg, last.elevation_deg),
        (next.azimuth_deg, next.elevation_deg),
    );
    // The Sun moves at 15 arcsec/s, and the times differ by 1 us.
    assert!(apart < 3e-5, "{apart} arcsec");
}

#[test]
fn a_date_before_the_table_is_refused_with_its_beginning() {
    let place = Place::new(0.0, 0.0, 0.0).unwrap();
    let mut ephemeris = Ephemeris::default();
    for utc in ["1972-12-31T23:59:59Z", "1950-01-01T00:00:00Z"] {
        let utc: Timestamp = utc.parse().unwrap();
        let error = ephemeris.sun(utc, place).unwrap_err();
        assert!(matches!(error, SkyError::Orientation { .. }), "{error}");
        assert!(error.to_string().contains("from 1973-01-02 on"), "{error}");
        assert_eq!(ephemeris.moon(utc, place).unwrap_err(), error);
        let rejected = error.rejected();
        assert!(rejected.measured.is_finite() && rejected.limit.is_finite());
        assert!(sun_angular_radius(utc).is_ok());
    }
    for utc in ["1973-01-02T00:00:00Z", "2027-06-30T23:59:59Z"] {
        let sun = ephemeris.sun(utc.parse().unwrap(), place).unwrap();
        assert_eq!(sun.ut1_shift_arcsec, [0.0; 2]);
    }
    for utc in ["1800-01-01T00:00:00Z", "2200-01-01T00:00:00Z"] {
        let utc = utc.parse().unwrap();
        assert_eq!(sun_angular_radius(utc), Err(SkyError::Date(utc)));
    }
}

#[test]
fn behind_the_table_the_suns_place_is_known_less_well_day_by_day() {
    let place = Place::new(34.49, -104.2218, 38_405.0).unwrap();
    let mut ephemeris = Ephemeris::default();
    let mut shift_arcsec = |utc: &str| {
        let sun = ephemeris.sun(utc.parse().unwrap(), place).unwrap();
        let [across, up] = sun.ut1_shift_arcsec;
        across.hypot(up)
    };
    // The table ends on 2027-10-29.
    let days = ["2027-10-28", "2027-10-30", "2028-02-06", "2030-10-29"];
    let shifts = days.map(|day| shift_arcsec(&format!("{day}T18:00:00Z")));
    assert_eq!(shifts[0], 0.0);
    // The hour angle changes by 15 arcsec/s; times the cosine of the declination, which is about -15 deg on these days.
    for (shift, sigma_s) in shifts[1..].iter().zip([0.0214, 0.0563, 0.4047]) {
        let expected = 15.0 * sigma_s * 15_f64.to_radians().cos();
        assert!((shift - expected).abs() < 0.02 * expected, "{shifts:?}");
    }
}

#[test]
fn a_place_that_is_none_is_refused() {
    let nowhere = Place {
        latitude_deg: f64::NAN,
        longitude_deg: 0.0,
        height_m: 0.0,
    };
    let utc = "2013-09-21T18:00:00Z".parse().unwrap();
    let found = Ephemeris::default().sun(utc, nowhere);
    assert!(matches!(found, Err(SkyError::Place(_))));
}

#[test]
fn the_moons_phase_is_that_of_the_almanac() {
    // Full Moon 2013-09-19 11:13 UTC and first quarter 2013-09-12 17:08 UTC (US Naval Observatory).
    let place = Place::new(34.49, -104.2218, 0.0).unwrap();
    let mut ephemeris = Ephemeris::default();
    let mut phase = |utc: &str| ephemeris.moon(utc.parse().unwrap(), place).unwrap();
    assert!(phase("2013-09-19T11:13:00Z").phase_angle_deg < 6.0);
    let quarter = phase("2013-09-12T17:08:00Z");
    assert!((quarter.phase_angle_deg - 90.0).abs() < 2.0);
    // The Moon is waxing, so its western limb is bright.
    assert!((quarter.bright_limb_deg - 280.0).abs() < 15.0);
}

#[test]
fn the_sun_rises_and_sets_as_the_almanac_says() {
    // Greenwich, 2024-06-20: sunrise 04:43, sunset 21:21 British Summer Time (HM Nautical Almanac Office's convention:
    // centre 50 arcmin below the horizontal).
    let place = Place::new(51.4779, 0.0, 0.0).unwrap();
    let mut ephemeris = Ephemeris::default();
    let from = "2024-06-20T00:00:00Z".parse().unwrap();
    let to = "2024-06-21T00:00:00Z".parse().unwrap();
    let found = crossings(from, to, |utc| {
        Ok(ephemeris.sun(utc, place)?.elevation_deg - horizon_deg(place))
    })
    .unwrap();
    let expected = [
        ("2024-06-20T03:43:00Z", Rising::Up),
        ("2024-06-20T20:21:00Z", Rising::Down),
    ];
    assert_eq!(found.len(), 2);
    for (crossing, (utc, rising)) in found.iter().zip(expected) {
        let off = crossing.utc.duration_since(utc.parse().unwrap());
        assert_eq!(crossing.rising, rising);
        assert!(off.as_secs_f64().abs() < 60.0, "{crossing:?}");
    }
}

#[test]
fn features_turn_with_the_sun_as_sunpy_has_it() {
    let mut ephemeris = Ephemeris::default();
    let mut apart = Worst::default();
    let mut count = 0;
    for line in rows(include_str!("data/rotation.csv")) {
        let fields: Vec<&str> = line.split(',').collect();
        let [epoch, utc] = [0, 1].map(|n| format!("{}Z", fields[n]).parse().unwrap());
        let v: Vec<f64> = fields[2..].iter().map(|n| n.parse().unwrap()).collect();
        let then = HelioprojectiveArcsec { x: v[0], y: v[1] };
        let feature = Feature::seen(then, epoch, &ephemeris.disc(epoch).unwrap()).unwrap();
        let now = feature.at(utc, &ephemeris.disc(utc).unwrap()).unwrap();
        apart.take((now.x - v[2]).hypot(now.y - v[3]));
        count += 1;
    }
    assert_eq!(count, 8);
    apart.within(0.1, "place, arcsec");
}

#[test]
fn a_feature_off_the_disc_or_behind_it_is_refused() {
    let epoch: Timestamp = "2013-09-21T18:00:00Z".parse().unwrap();
    let disc = Disc {
        b0_deg: 0.0,
        l0_deg: 100.0,
        distance_au: 1.0,
    };
    let off = HelioprojectiveArcsec { x: 0.0, y: 1000.0 };
    let found = Feature::seen(off, epoch, &disc);
    assert!(matches!(found, Err(PointingError::OffTheDisc { .. })));
    let at = HelioprojectiveArcsec { x: 900.0, y: 0.0 };
    let feature = Feature::seen(at, epoch, &disc).unwrap();
    let later = Disc {
        l0_deg: 50.0,
        ..disc
    };
    let found = feature.at(epoch, &later);
    assert!(matches!(found, Err(PointingError::BehindTheLimb { .. })));
}

fn solaspect(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_solaspect"))
        .args(arguments)
        .output()
        .unwrap()
}

fn json(arguments: &[&str]) -> Value {
    let output = solaspect(arguments);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}

fn keys(object: &Value) -> Vec<&str> {
    object
        .as_object()
        .unwrap()
        .keys()
        .map(String::as_str)
        .collect()
}

const SKY: [&str; 3] = ["sky", "--place", "34.49,-104.2218,38405"];

#[test]
fn the_command_prints_one_object_with_the_fields_of_the_contract() {
    let report = json(&[&SKY[..], &["--json", "--at", "2013-09-21T18:00:00.250Z"]].concat());
    assert_eq!(keys(&report), ["moon", "sun", "utc"]);
    assert_eq!(report["utc"], "2013-09-21T18:00:00.250Z");
    let mut sun = [
        "azimuth_deg",
        "elevation_deg",
        "radius_arcsec",
        "p_deg",
        "b0_deg",
        "l0_deg",
        "zenith_to_north_deg",
    ];
    let mut moon = [
        "azimuth_deg",
        "elevation_deg",
        "radius_arcsec",
        "phase_angle_deg",
        "bright_limb_deg",
    ];
    sun.sort_unstable();
    moon.sort_unstable();
    assert_eq!(keys(&report["sun"]), sun);
    assert_eq!(keys(&report["moon"]), moon);
}

#[test]
fn refraction_lifts_and_only_when_asked() {
    let at = [&SKY[..], &["--json", "--at", "2013-09-21T14:00:00Z"]].concat();
    let elevation = |more: &[&str]| {
        let report = json(&[&at, more].concat());
        report["sun"]["elevation_deg"].as_f64().unwrap()
    };
    let bare = elevation(&[]);
    let float = (elevation(&["--refraction"]) - bare) * 3600.0;
    assert!((0.5..1.5).contains(&float), "{float} arcsec");
    let ground = (elevation(&["--refraction", "1013.25,15"]) - bare) * 3600.0;
    assert!((190.0..230.0).contains(&ground), "{ground} arcsec");
}

#[test]
fn a_plan_has_rows_events_and_the_hours_in_a_band() {
    let plan = [
        &SKY[..],
        &[
            "--from",
            "2013-09-21T12:00",
            "--to",
            "2013-09-22T04:00",
            "--step",
            "4h",
        ],
        &["--band", "20,85", "--json"],
    ]
    .concat();
    let plan = json(&plan);
    assert_eq!(plan["rows"].as_array().unwrap().len(), 5);
    let events = plan["events"].as_array().unwrap();
    let names: Vec<&str> = events
        .iter()
        .map(|e| e["event"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["rise", "transit", "set"]);
    let noon = &events[1];
    assert!((noon["azimuth_deg"].as_f64().unwrap() - 180.0).abs() < 1e-3);
    let spells = plan["band"]["spells"].as_array().unwrap();
    assert_eq!(spells.len(), 1);
    for utc in spells[0].as_array().unwrap() {
        let at = json(&[&SKY[..], &["--json", "--at", utc.as_str().unwrap()]].concat());
        let elevation = at["sun"]["elevation_deg"].as_f64().unwrap();
        assert!((elevation - 20.0).abs() < 0.01, "{elevation}");
    }
}

#[test]
fn the_configuration_may_bring_a_newer_table() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let table = file(
        "newer.csv",
        "mjd_utc,tai_utc_s,x_arcsec,y_arcsec,ut1_utc_s\n65000,37,0.1,0.3,-0.5\n65010,37,0.1,0.3,0.5\n",
    );
    let config = file("c.toml", &format!("[sky]\nearth_orientation = {table:?}\n"));
    let at = ["--json", "--config", &config, "--at"];
    // At MJD 65005, UT1 - UTC is 0 in this table.
    let inside = [&SKY[..], &at, &["2036-11-08T12:00:00Z"]].concat();
    assert!(json(&inside)["sun"]["azimuth_deg"].is_f64());
    let outside = solaspect(&[&SKY[..], &at, &["2013-09-21T18:00:00Z"]].concat());
    assert_eq!(outside.status.code(), Some(1));
    let text = String::from_utf8(outside.stderr).unwrap();
    assert!(text.contains("from 2036-11-03 on"), "{text}");
    // MJD 65110 is 100 days after the end of the table.
    let behind = [&SKY[..], &at, &["2037-02-21T12:00:00Z"]].concat();
    assert!(json(&behind)["sun"]["azimuth_deg"].is_f64());
    let said = String::from_utf8(solaspect(&behind).stderr).unwrap();
    assert!(
        said.contains("ends on 2036-11-13") && said.contains("1 sigma 0.056 s"),
        "{said}"
    );
    let missing = file("d.toml", "[sky]\nearth_orientation = \"/nowhere.csv\"\n");
    let at = ["--config", &missing, "--at", "2013-09-21T18:00:00Z"];
    assert_eq!(solaspect(&[&SKY[..], &at].concat()).status.code(), Some(1));
}

#[test]
fn a_target_that_turns_with_the_sun_moves_the_offset() {
    let folder = tempfile::tempdir().unwrap();
    let frame = "tests/data/frames/standard/frame_00000.fits";
    let offset = |target: &str| {
        let path = folder.path().join("c.toml");
        std::fs::write(&path, format!("[target]\n{target}")).unwrap();
        let config = ["--config", path.to_str().unwrap()];
        let frame = ["--place", SKY[2], "--format", "jsonl", frame];
        json(&[&["solve"][..], &config, &frame].concat())["offset_deg"].clone()
    };
    let cross = |offset: &Value| offset["cross_elevation"].as_f64().unwrap();
    let up = |offset: &Value| offset["elevation"].as_f64().unwrap();
    let fixed = offset("x_arcsec = 0\ny_arcsec = 0\n");
    let now = offset("epoch_utc = \"2013-09-21T18:00:00Z\"\n");
    assert!((cross(&fixed) - cross(&now)).abs() < 1e-6);
    let yesterday = offset("epoch_utc = \"2013-09-20T18:00:00Z\"\n");
    let moved = (cross(&yesterday) - cross(&fixed)).hypot(up(&yesterday) - up(&fixed)) * 3600.0;
    // Expected: 13.2 deg of synodic rotation from the disc's centre.
    let expected = 955.6 * 13.2_f64.to_radians().sin();
    assert!((moved / expected - 1.0).abs() < 0.03, "{moved} arcsec");
    let config = folder.path().join("off.toml");
    let text = "[target]\nx_arcsec = 2000\nepoch_utc = \"2013-09-20T18:00:00Z\"\n";
    std::fs::write(&config, text).unwrap();
    let refused = solaspect(&["solve", "--config", config.to_str().unwrap(), frame]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("on the disc"));
}

const FROM_THE_BALLOON: [&str; 4] = [
    "sky",
    "visibility",
    "--orbit",
    "balloon:34.49,-104.2218,38405",
];

#[test]
fn when_the_moon_can_be_seen_is_one_object_or_a_table() {
    let report = json(&[&FROM_THE_BALLOON[..], &["--step", "10m", "--json"]].concat());
    let number = |key: &str| report[key].as_f64().unwrap();
    // astropy 6.1, as fractions of time: 0.5500 above the limb, 0.5029 also clear of the Sun, 0.4540 for the Sun.
    for (key, expected) in [
        ("above_limb", 0.5500),
        ("seen", 0.5029),
        ("sun_above_limb", 0.4540),
    ] {
        assert!((number(key) - expected).abs() < 1e-3, "{key}: {report}");
    }
    let rows = report["by_lit"].as_array().unwrap();
    let time: f64 = rows.iter().map(|row| row["time"].as_f64().unwrap()).sum();
    assert!((time - 1.0).abs() < 1e-9);
    // On a day with a nearly full Moon, other illuminated fractions have no time and no share.
    let day = [&FROM_THE_BALLOON[..], &["--days", "1"]].concat();
    let nearly_full = json(&[&day[..], &["--json"]].concat());
    assert_eq!(nearly_full["by_lit"][0]["time"], 0.0);
    assert!(nearly_full["by_lit"][0]["seen"].is_null());
    let table = String::from_utf8(solaspect(&day).stdout).unwrap();
    let empty = table.lines().find(|line| line.starts_with("0 to 25 %"));
    assert!(empty.unwrap().ends_with(" -"), "{table}");
}

#[test]
fn the_studys_table_of_visibility_is_printed_on_request() {
    let simplified = ["sky", "visibility", "--orbit", "leo550", "--simplified"];
    let report = json(&[&simplified[..], &["--json"]].concat());
    // "The Development of a Moon Sensor" (2005), table 3.1 and the text below it.
    let edges = [0.0, 15.0, 98.0, 142.0, 180.0, 278.0, 322.0, 345.0, 360.0];
    let lit_percent = [0.0, 1.7, 57.0, 89.4, 100.0, 43.0, 10.6, 1.7, 0.0];
    let rows = report["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 8);
    for (n, row) in rows.iter().enumerate() {
        for end in 0..2 {
            let from_new = row["from_new_deg"][end].as_f64().unwrap();
            let lit = 100.0 * row["lit"][end].as_f64().unwrap();
            assert!((from_new - edges[n + end]).abs() < 0.2, "{row}");
            assert!((lit - lit_percent[n + end]).abs() < 0.2, "{row}");
        }
    }
    assert!((report["seen_of_path"].as_f64().unwrap() - 0.916).abs() < 1e-3);
    let table = String::from_utf8(solaspect(&simplified).stdout).unwrap();
    assert_eq!(table.lines().count(), 13, "{table}");
}

#[test]
fn visibility_names_the_option_that_it_cannot_take() {
    let leo = ["sky", "visibility", "--orbit", "leo550"];
    for (command, options, said) in [
        (&leo, &["--from", "1950-01-01T00:00:00Z"][..], "--from"),
        (&leo, &["--days", "0"], "--days: expected"),
        (&leo, &["--days", "400", "--step", "1s"], "--step: expected"),
        (&leo, &["--step", "0s"], "--step: expected"),
        (&leo, &["--node-h", "25"], "--node-h: expected"),
        (
            &leo,
            &["--clear-of-sun-deg", "181"],
            "--clear-of-sun-deg: expected",
        ),
        (&FROM_THE_BALLOON, &["--node-h", "3"], "--node-h: expected"),
        (
            &FROM_THE_BALLOON,
            &["--simplified"],
            "--simplified: expected",
        ),
    ] {
        let refused = solaspect(&[&command[..], options].concat());
        assert_eq!(refused.status.code(), Some(1), "{options:?}");
        let text = String::from_utf8(refused.stderr).unwrap();
        assert!(text.contains(said), "{options:?}: {text}");
    }
}
