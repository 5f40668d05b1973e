//! The pointing from the Sun on the plate, by both rules of directions: at the telescope, and at the Sun as in the HEROES
//! flight program.

use jiff::Timestamp;
use nalgebra::{Matrix2, Rotation3, UnitVector3, Vector2, Vector3};
use proptest::prelude::*;
use solaspect::aspect::{self, Expected, Quality};
use solaspect::fits;
use solaspect::geometry::attitude::Direction;
use solaspect::instrument::{Directions, Instrument, builtin};
use solaspect::pointing::{
    Feature, HelioprojectiveArcsec, Horizontal, PointingError, Roll, Target, body_roll_deg,
    helioprojective, offset, offset_of, pointing, roll_by_nadir, sun_on_plate, sun_on_plate_for,
};
use solaspect::sky::sphere::{direction, separation_rad};
use solaspect::sky::{Ephemeris, SunPosition};
use solaspect::units::{Estimate, Measured, PlateMil};
use std::path::Path;

const ARCSEC: f64 = 1.0 / 3600.0;
const CENTRE: HelioprojectiveArcsec = HelioprojectiveArcsec { x: 0.0, y: 0.0 };

fn sun(azimuth_deg: f64, elevation_deg: f64, zenith_to_north_deg: f64) -> SunPosition {
    SunPosition {
        azimuth_deg,
        elevation_deg,
        radius_arcsec: 955.6,
        distance_au: 1.004,
        zenith_to_north_deg,
        p_deg: 25.07,
        b0_deg: 7.07,
        l0_deg: 84.3,
        ut1_shift_arcsec: [0.0; 2],
    }
}

/// A Sun's position on the plate with a sigma of 0.1 mil per axis.
fn on_plate(x: f64, y: f64) -> Estimate<PlateMil> {
    Estimate {
        position: PlateMil::new(x, y),
        covariance: Matrix2::identity() * 0.01,
    }
}

fn instrument(
    directions: Directions,
    clocking_deg: f64,
    (boresight_x, boresight_y): (f64, f64),
) -> Instrument {
    let mut instrument = builtin("heroes-pyas-f").unwrap();
    instrument.mounting.directions = directions;
    instrument.mounting.clocking_deg.value = clocking_deg;
    instrument.mounting.boresight_mil = PlateMil::new(boresight_x, boresight_y);
    instrument
}

/// A measured roll without error.
fn exact_roll(roll_deg: f64) -> Roll {
    Roll::Measured(Measured::new(roll_deg, 0.0))
}

/// The nadir in the axes of a telescope: along the boresight, to the right, and perpendicular to both.
fn nadir(roll_deg: f64, elevation_deg: f64) -> UnitVector3<f64> {
    let [(sin_roll, cos_roll), (sin, cos)] =
        [roll_deg, elevation_deg].map(|deg| deg.to_radians().sin_cos());
    UnitVector3::new_normalize(Vector3::new(-sin, cos * sin_roll, cos * cos_roll))
}

/// The angle between two pointings, arcsec.
fn apart_arcsec(a: Horizontal, b: Horizontal) -> f64 {
    let [a, b] = [a, b].map(|p| direction(p.azimuth_deg, p.elevation_deg));
    separation_rad(&a, &b).to_degrees() / ARCSEC
}

/// The numeric rows of a CSV table, without comments and header.
fn rows(table: &str) -> Vec<Vec<f64>> {
    let lines = table.lines().filter(|line| !line.starts_with('#'));
    let numbers = |line: &str| line.split(',').map(|n| n.parse().unwrap()).collect();
    lines.skip(1).map(numbers).collect()
}

#[test]
fn offsets_by_directions_at_the_sun_are_those_of_the_heroes_flight_program() {
    let rows = rows(include_str!("data/pointing.csv"));
    assert_eq!(rows.len(), 3);
    for row in rows {
        let instrument = instrument(Directions::Sun2013, row[4], (row[5], row[6]));
        let sun = sun(row[9], row[10], row[11]);
        let target = HelioprojectiveArcsec {
            x: row[2],
            y: row[3],
        };
        let seen = on_plate(row[0], row[1]);
        let found = offset(seen, Roll::Stated, &instrument, &sun, target).unwrap();
        let off = [found.azimuth_deg - row[12], found.elevation_deg - row[13]];
        assert!(
            off.iter().all(|d| d.abs() < 0.3 * ARCSEC),
            "off by {off:?} deg"
        );
    }
}

#[test]
fn offsets_by_directions_at_the_telescope_are_those_of_a_plate_fixed_in_it() {
    let rows = rows(include_str!("data/pointing_telescope.csv"));
    assert_eq!(rows.len(), 40);
    let mut largest_deg = 0.0_f64;
    for row in rows {
        let mut instrument = instrument(Directions::Telescope, row[3], (row[4], row[5]));
        instrument.mounting.roll_deg.value = row[2];
        let sun = sun(row[0], row[1], 0.0);
        let seen = on_plate(row[6], row[7]);
        // The nadir in the telescope's axes, and the same in a gondola's, from which the telescope is tilted up.
        let nadir = nadir(row[2], row[1] + row[9]);
        let lowered = Rotation3::from_axis_angle(&Vector3::y_axis(), 0.7) * nadir;
        let level = self::instrument(Directions::Telescope, row[3], (row[4], row[5]));
        let by_horizon = |nadir| {
            let seen_down = Direction::new(nadir, 0.0);
            roll_by_nadir(&seen_down, seen.position, &level, &sun)
        };
        let rolls = [nadir, lowered].map(by_horizon);
        for roll in [Roll::Stated, exact_roll(row[2]), rolls[0], rolls[1]] {
            let found = offset(seen, roll, &instrument, &sun, CENTRE).unwrap();
            let off = [
                found.azimuth_deg - row[8],
                found.elevation_deg - row[9],
                found.cross_elevation_deg - row[10],
            ];
            assert!(
                off.iter().all(|d| d.abs() < 0.01 * ARCSEC),
                "off by {off:?} deg"
            );
            largest_deg = off.iter().fold(largest_deg, |most, d| most.max(d.abs()));
        }
    }
    println!("off by {:.1e} arcsec at most", largest_deg / ARCSEC);
}

#[test]
fn a_rolls_sigma_is_by_how_much_an_error_of_the_nadir_turns_it() {
    const SIGMA_RAD: f64 = 1e-4;
    for (roll_deg, elevation_deg) in [(0.0, 0.0), (3.0, 54.0), (-20.0, 30.0)] {
        let nadir = nadir(roll_deg, elevation_deg);
        let known = Direction::new(nadir, SIGMA_RAD);
        let body = body_roll_deg(&known);
        assert!((body.value - roll_deg).abs() < 1e-9);
        let Some(Roll::Measured(telescope)) = Roll::by_nadir(&known, elevation_deg) else {
            panic!("no roll")
        };
        assert!((telescope.value - roll_deg).abs() < 1e-9);
        // Perturb the nadir along each axis.
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        let moved = axes.map(|axis| {
            let across = axis - nadir.into_inner() * nadir.dot(&axis);
            let off = UnitVector3::new_normalize(nadir.into_inner() + across * SIGMA_RAD);
            let off = Direction::new(off, 0.0);
            let Some(Roll::Measured(telescope)) = Roll::by_nadir(&off, elevation_deg) else {
                panic!("no roll")
            };
            [body_roll_deg(&off).value, telescope.value]
        });
        for (n, found) in [body, telescope].iter().enumerate() {
            let squares = moved.map(|values| (values[n] - roll_deg).powi(2));
            let sigma_deg = squares.iter().sum::<f64>().sqrt();
            assert!(
                (found.sigma / sigma_deg - 1.0).abs() < 1e-2,
                "{found:?}, {sigma_deg}"
            );
        }
    }
    // The nadir's component to the right, 0.5, exceeds cos(80 deg), so a telescope at this elevation has no roll.
    let level = Direction::new(nadir(30.0, 0.0), SIGMA_RAD);
    assert_eq!(Roll::by_nadir(&level, 80.0), None);
}

/// Positions of the Sun on the plate at an angle from the boresight, in steps of 1 deg around it.
fn around(boresight_mil: PlateMil, angle_deg: f64) -> impl Iterator<Item = PlateMil> {
    let radius_mil = 3000.0 / 0.0254 * angle_deg.to_radians().tan();
    (0..360).map(move |degree| {
        let (sin, cos) = f64::from(degree).to_radians().sin_cos();
        PlateMil::from(boresight_mil.vector() + Vector2::new(cos, sin) * radius_mil)
    })
}

#[test]
fn the_rules_agree_at_the_boresight_and_differ_by_tens_of_arcsec_a_degree_from_it() {
    let sun = sun(158.5, 54.0, -41.0);
    let by = |directions| instrument(directions, -32.425, (124.68, -74.64));
    let [telescope, at_sun] = Directions::ALL.map(by);
    let largest_arcsec = |angle_deg: f64| {
        let difference = |at: PlateMil| {
            let roll = exact_roll(0.0);
            let [a, b] = [&telescope, &at_sun].map(|i| pointing(at, roll, i, &sun).unwrap());
            apart_arcsec(a, b)
        };
        let places = around(telescope.mounting.boresight_mil, angle_deg);
        places.map(difference).fold(0.0, f64::max)
    };
    assert!(largest_arcsec(0.0) < 1e-9);
    // Expected: a^2 tan(elevation), at a solar radius and at 1 deg.
    for (angle_deg, expected_arcsec) in [(955.6 * ARCSEC, 6.09), (1.0, 86.5)] {
        let found_arcsec = largest_arcsec(angle_deg);
        let ratio = found_arcsec / expected_arcsec;
        assert!((ratio - 1.0).abs() < 0.03, "{angle_deg}: {found_arcsec}");
    }
}

#[test]
fn a_roll_turns_the_pointing_about_the_sun_only_where_directions_count_at_the_telescope() {
    let (sun, at) = (sun(158.5, 20.0, -41.0), PlateMil::new(-1900.0, 700.0));
    let by = |directions| instrument(directions, 0.0, (0.0, 0.0));
    let pointing = |roll_deg, instrument: &Instrument| {
        pointing(at, exact_roll(roll_deg), instrument, &sun).unwrap()
    };
    let at_sun = by(Directions::Sun2013);
    assert_eq!(pointing(2.0, &at_sun), pointing(0.0, &at_sun));
    // A roll equals a clocking of the opposite sign.
    let (level, mut clocked) = (by(Directions::Telescope), by(Directions::Telescope));
    clocked.mounting.clocking_deg.value = -2.0;
    let [rolled, clocked] = [pointing(2.0, &level), pointing(0.0, &clocked)];
    assert!(apart_arcsec(rolled, clocked) < 1e-6);
    // The plate's +Y is up. The Sun is observed below the boresight, so it is higher than the pointing; with the right side low,
    // "up" is tilted to the right, so the Sun is to the right of the vertical and the boresight to the left of the Sun.
    let below = PlateMil::new(0.0, -1000.0);
    let [level, rolled] = [0.0, 2.0]
        .map(|roll_deg| solaspect::pointing::pointing(below, exact_roll(roll_deg), &level, &sun));
    let (level, rolled) = (level.unwrap(), rolled.unwrap());
    assert!((level.azimuth_deg - 158.5).abs() < 1e-9, "{level:?}");
    assert!(level.elevation_deg < 20.0, "{level:?}");
    let aside_deg = (rolled.azimuth_deg - 158.5) * 20_f64.to_radians().cos();
    let shift_deg = (1000.0 * 0.0254_f64).atan2(3000.0).to_degrees();
    let expected_deg = -shift_deg * 2_f64.to_radians().sin();
    assert!((aside_deg / expected_deg - 1.0).abs() < 0.01, "{aside_deg}");
}

#[test]
fn a_target_at_solar_north_lies_where_north_is_turned_to() {
    // North is rotated by 90 deg to the right of the zenith: the target has a larger azimuth, so the telescope,
    // which points at the Sun, is short of it. West is then straight down.
    let sun = sun(180.0, 0.0, 90.0);
    let north = HelioprojectiveArcsec { x: 0.0, y: 900.0 };
    let west = HelioprojectiveArcsec { x: 900.0, y: 0.0 };
    for directions in Directions::ALL {
        let instrument = instrument(directions, 0.0, (0.0, 0.0));
        let offset =
            |target| offset(on_plate(0.0, 0.0), Roll::Stated, &instrument, &sun, target).unwrap();
        let found = offset(north);
        assert!((found.azimuth_deg + 0.25).abs() < 1e-9, "{found:?}");
        assert!(found.elevation_deg.abs() < 1e-9, "{found:?}");
        let found = offset(west);
        assert!((found.elevation_deg - 0.25).abs() < 1e-9, "{found:?}");
    }
}

#[test]
fn an_azimuth_difference_across_north_is_small() {
    let expected = 300.0 * 1.7464 * ARCSEC / 32_f64.to_radians().cos();
    for directions in Directions::ALL {
        let instrument = instrument(directions, 0.0, (0.0, 0.0));
        for (azimuth_deg, x) in [
            (0.01, -300.0),
            (0.01, 300.0),
            (359.99, -300.0),
            (359.99, 300.0),
        ] {
            let sun = sun(azimuth_deg, 32.0, 10.0);
            let found = offset(on_plate(x, 0.0), Roll::Stated, &instrument, &sun, CENTRE).unwrap();
            assert!((found.azimuth_deg.abs() - expected).abs() < 1e-4);
        }
    }
}

#[test]
fn near_the_zenith_there_is_no_offset_but_a_reason() {
    let instrument = builtin("demo").unwrap();
    let found = offset(
        on_plate(0.0, 0.0),
        Roll::Stated,
        &instrument,
        &sun(180.0, 86.0, 0.0),
        CENTRE,
    );
    assert!(
        matches!(found, Err(PointingError::NearZenith { elevation_deg }) if elevation_deg > 85.0)
    );
    assert!(found.unwrap_err().to_string().contains("86"));
}

#[test]
fn nearer_to_the_zenith_than_to_the_boresight_the_sun_may_have_no_pointing() {
    let instrument = instrument(Directions::Telescope, 0.0, (0.0, 0.0));
    let no_boresight = |at: PlateMil, sun: &SunPosition| {
        let found = pointing(at, exact_roll(0.0), &instrument, sun);
        matches!(found, Err(PointingError::NoBoresight { sun_from_vertical_deg, sun_from_boresight_deg })
            if (sun_from_vertical_deg - 0.55).abs() < 1e-9 && (sun_from_boresight_deg - 1.0).abs() < 1e-9)
    };
    let none = |sun: SunPosition| {
        let seen = around(PlateMil::new(0.0, 0.0), 1.0);
        seen.filter(|at| no_boresight(*at, &sun)).count()
    };
    // The Sun can be observed only within asin(0.55) = 33.4 deg to either side of straight above the boresight.
    assert_eq!(none(sun(70.0, 89.45, 0.0)), 360 - 67);
    assert_eq!(none(sun(70.0, -89.45, 0.0)), 360 - 67);
    let found = pointing(
        PlateMil::new(2000.0, 0.0),
        exact_roll(0.0),
        &instrument,
        &sun(70.0, 89.9, 0.0),
    );
    let reason = found.unwrap_err().rejected();
    assert_eq!(reason.reason.code, "no_boresight");
    assert!(reason.measured < reason.limit, "{reason:?}");
    // With the Sun farther from the zenith than from the boresight, a pointing always exists.
    for at in around(PlateMil::new(0.0, 0.0), 1.0) {
        let found = pointing(at, exact_roll(0.0), &instrument, &sun(70.0, 88.99, 0.0)).unwrap();
        assert!(found.elevation_deg <= 90.0, "{found:?}");
    }
}

#[test]
fn a_frame_without_an_offset_says_why_and_keeps_its_quality() {
    let frame = Path::new("tests/data/frames/standard/frame_00000.fits");
    let frame = fits::read_frame(frame).unwrap();
    let instrument = builtin("demo").unwrap();
    let expected = frame.info.mid_exposure.and_then(Expected::at);
    let solved = aspect::solve(&frame, &instrument, expected, None);
    assert_eq!(solved.quality, Quality::Fine);
    let utc: Timestamp = "2013-09-21T18:00:00Z".parse().unwrap();
    let mut ephemeris = Ephemeris::default();
    let mut conclude = |utc, place: &str, target| {
        let mut solution = solved.clone();
        let place = place.parse().ok();
        let offset = offset_of(
            &mut solution,
            utc,
            place,
            &target,
            None,
            &instrument,
            &mut ephemeris,
        );
        assert_eq!(solution.quality, Quality::Fine);
        (offset.is_some(), solution.stopped.map(|s| s.to_string()))
    };
    let fixed = Target::default();
    let fort_sumner = "34.49,-104.2218,38405";
    assert_eq!(conclude(Some(utc), fort_sumner, fixed), (true, None));
    assert_eq!(conclude(None, fort_sumner, fixed), (false, None));
    assert_eq!(conclude(Some(utc), "nowhere", fixed), (false, None));
    let reason = |text: &str| (false, Some(format!("pointing: {text}")));
    // At the equator's noon the Sun is in the zenith.
    for (place, why) in [
        ("0.7,-91.7,0", "too near the zenith for any pointing"),
        ("3.0,-91.7,0", "too near the zenith for azimuths"),
    ] {
        assert_eq!(conclude(Some(utc), place, fixed), reason(why));
    }
    assert_eq!(
        conclude("1971-01-01T00:00:00Z".parse().ok(), fort_sumner, fixed),
        reason("date outside the table of Earth orientation")
    );
    let behind = Target::Feature(Feature {
        latitude_deg: 0.0,
        longitude_deg: 84.3 + 180.0,
        epoch: utc,
    });
    assert_eq!(
        conclude(Some(utc), fort_sumner, behind),
        reason("target behind the limb")
    );
}

#[test]
fn the_sun_behind_the_lens_is_on_no_plate() {
    let instrument = builtin("demo").unwrap();
    let behind = Horizontal {
        azimuth_deg: 0.0,
        elevation_deg: 20.0,
    };
    let found = sun_on_plate(behind, Roll::Stated, &instrument, &sun(180.0, 20.0, 0.0));
    assert!(matches!(found, Err(PointingError::BehindTheLens { .. })));
}

/// Displacement of the pointing in cross-elevation and in elevation, deg.
fn moved_deg(from: Horizontal, to: Horizontal) -> Vector2<f64> {
    let across = (to.azimuth_deg - from.azimuth_deg) * from.elevation_deg.to_radians().cos();
    Vector2::new(across, to.elevation_deg - from.elevation_deg)
}

/// Covariance of independent errors, each given by the pointings at minus and plus `part` sigma of it.
fn covariance_deg2(moved_by: impl Iterator<Item = [Horizontal; 2]>, part: f64) -> Matrix2<f64> {
    moved_by
        .map(|[less, more]| moved_deg(less, more) / (2.0 * part))
        .map(|error| error * error.transpose())
        .sum()
}

/// An instrument with an uncertain calibration, a Sun, and its measured position on the plate.
fn uncertain(directions: Directions) -> (Instrument, SunPosition, Estimate<PlateMil>) {
    let mut instrument = instrument(directions, -32.425, (124.68, -74.64));
    instrument.mounting.boresight_sigma_mil = 2.0;
    instrument.mounting.clocking_deg.sigma = 0.1;
    instrument.mounting.roll_deg = Measured::new(0.4, 0.3);
    instrument.optics.plate_distance_mm.sigma = 3.0;
    let seen = Estimate {
        position: PlateMil::new(2500.0, -1800.0),
        covariance: Matrix2::new(4.0, 1.0, 1.0, 9.0),
    };
    (instrument, sun(158.5, 54.0, -41.0), seen)
}

const PART: f64 = 1e-3;

#[test]
fn the_uncertainty_is_the_scatter_that_the_sphere_shows() {
    // Displace the Sun along each column of the covariance's Cholesky factor and measure the displacement on the sky.
    for directions in Directions::ALL {
        let (instrument, sun, seen) = uncertain(directions);
        let root = seen.covariance.cholesky().unwrap().l();
        let moved_by = root.column_iter().map(|column| {
            [-PART, PART].map(|part| {
                let at = PlateMil::from(seen.position.vector() + column * part);
                pointing(at, Roll::Stated, &instrument, &sun).unwrap()
            })
        });
        let expected = covariance_deg2(moved_by, PART);
        let found = offset(seen, Roll::Stated, &instrument, &sun, CENTRE).unwrap();
        let off = (found.covariance_deg2 - expected).norm() / expected.norm();
        assert!(
            off < 1e-6,
            "{off}: {} for {expected}",
            found.covariance_deg2
        );
        let per_axis = (found.covariance_deg2.trace() / 2.0).sqrt();
        assert!((per_axis / found.sigma_deg - 1.0).abs() < 1e-12);
    }
}

#[test]
fn the_calibrations_share_is_the_scatter_of_its_values_and_stands_apart() {
    // Displace each calibrated value by a part of its sigma and measure the displacement on the sky.
    for directions in Directions::ALL {
        let (known, sun, seen) = uncertain(directions);
        let moved_by = (0..5).map(|value| {
            [-PART, PART].map(|part| {
                let mut moved = known.clone();
                match value {
                    0 => moved.mounting.boresight_mil.x += 2.0 * part,
                    1 => moved.mounting.boresight_mil.y += 2.0 * part,
                    2 => moved.mounting.clocking_deg.value += 0.1 * part,
                    3 => moved.mounting.roll_deg.value += 0.3 * part,
                    _ => moved.optics.plate_distance_mm.value += 3.0 * part,
                }
                pointing(seen.position, Roll::Stated, &moved, &sun).unwrap()
            })
        });
        let expected = covariance_deg2(moved_by, PART);
        let found = offset(seen, Roll::Stated, &known, &sun, CENTRE).unwrap();
        let off = (found.calibration_deg2 - expected).norm() / expected.norm();
        assert!(
            off < 1e-6,
            "{off}: {} for {expected}",
            found.calibration_deg2
        );
        // A perfect calibration leaves the frame's own covariance unchanged.
        let mut perfect = known.clone();
        perfect.mounting.boresight_sigma_mil = 0.0;
        perfect.mounting.clocking_deg.sigma = 0.0;
        perfect.mounting.roll_deg.sigma = 0.0;
        perfect.optics.plate_distance_mm.sigma = 0.0;
        let perfect = offset(seen, Roll::Stated, &perfect, &sun, CENTRE).unwrap();
        assert_eq!(perfect.calibration_sigma_deg(), 0.0);
        assert_eq!(perfect.covariance_deg2, found.covariance_deg2);
    }
}

#[test]
fn behind_the_table_of_earth_orientation_the_sun_itself_is_uncertain() {
    for directions in Directions::ALL {
        let (known, sun, seen) = uncertain(directions);
        let certain = offset(seen, Roll::Stated, &known, &sun, CENTRE).unwrap();
        let uncertain_sun = SunPosition {
            ut1_shift_arcsec: [3.0, -4.0],
            ..sun
        };
        let found = offset(seen, Roll::Stated, &known, &uncertain_sun, CENTRE).unwrap();
        assert_eq!(found.covariance_deg2, certain.covariance_deg2);
        let moved_by = [-PART, PART].map(|part| {
            let cos = sun.elevation_deg.to_radians().cos();
            let moved = SunPosition {
                azimuth_deg: sun.azimuth_deg + 3.0 * ARCSEC * part / cos,
                elevation_deg: sun.elevation_deg - 4.0 * ARCSEC * part,
                ..sun
            };
            pointing(seen.position, Roll::Stated, &known, &moved).unwrap()
        });
        let expected = covariance_deg2([moved_by].into_iter(), PART);
        let added = found.calibration_deg2 - certain.calibration_deg2;
        assert!(
            (added - expected).norm() < 1e-3 * expected.norm(),
            "{added}"
        );
    }
}

#[test]
fn the_error_of_a_roll_is_the_calibrations_when_stated_and_the_frames_when_measured() {
    let (instrument, sun, seen) = uncertain(Directions::Telescope);
    let offset = |roll| offset(seen, roll, &instrument, &sun, CENTRE).unwrap();
    let (stated, exact) = (offset(Roll::Stated), offset(exact_roll(0.4)));
    let by_stated = stated.calibration_deg2 - exact.calibration_deg2;
    assert_eq!(stated.covariance_deg2, exact.covariance_deg2);
    let measured = offset(Roll::Measured(Measured::new(0.4, 0.3)));
    assert_eq!(measured.calibration_deg2, exact.calibration_deg2);
    let by_measured = measured.covariance_deg2 - exact.covariance_deg2;
    assert!((by_measured - by_stated).norm() < 1e-9 * by_stated.norm());
    // Expected: 0.3 deg times the Sun's angle from the boresight.
    let from_boresight = seen.position.vector() - instrument.mounting.boresight_mil.vector();
    let expected_arcsec = 0.3_f64.to_radians() * from_boresight.norm() * 1.7464;
    let found_arcsec = by_stated.trace().sqrt() / ARCSEC;
    assert!(
        (found_arcsec / expected_arcsec - 1.0).abs() < 0.05,
        "{found_arcsec}"
    );
}

#[test]
fn cross_elevation_is_a_true_angle() {
    let instrument = instrument(Directions::Sun2013, 0.0, (0.0, 0.0));
    let found = offset(
        on_plate(300.0, 0.0),
        Roll::Stated,
        &instrument,
        &sun(158.5, 80.0, 0.0),
        CENTRE,
    )
    .unwrap();
    let shift_deg = (300.0 * 0.0254_f64).atan2(3000.0).to_degrees();
    assert!(
        (found.cross_elevation_deg + shift_deg).abs() < 1e-9,
        "{found:?}"
    );
    assert!(found.azimuth_deg.abs() > 5.0 * shift_deg);
}

proptest! {
    #[test]
    fn an_offset_leads_back_to_the_same_place_on_the_plate(
        x in -2500.0..2500.0,
        y in -2500.0..2500.0,
        azimuth_deg in 0.0..360.0,
        elevation_deg in -5.0..80.0,
        turn_deg in -180.0..180.0,
        target_x in -2000.0..2000.0,
        target_y in -2000.0..2000.0,
        roll_deg in -10.0..10.0,
        clocking_deg in -180.0..180.0,
    ) {
        let (at, roll) = (PlateMil::new(x, y), exact_roll(roll_deg));
        for directions in Directions::ALL {
            let instrument = instrument(directions, clocking_deg, (-105.59, -48.64));
            let sun = sun(azimuth_deg, elevation_deg, turn_deg);
            let target = HelioprojectiveArcsec { x: target_x, y: target_y };
            let found = offset(on_plate(x, y), roll, &instrument, &sun, target).unwrap();
            let back = sun_on_plate_for(&found, roll, &instrument, &sun, target).unwrap();
            prop_assert!(back.distance(at) < 1e-6, "{directions:?}: {back:?}");
            let towards = pointing(at, roll, &instrument, &sun).unwrap();
            let back = sun_on_plate(towards, roll, &instrument, &sun).unwrap();
            prop_assert!(back.distance(at) < 1e-6, "{directions:?}: {back:?}");
            // The offset to a target at which the telescope points is zero.
            let target = helioprojective(at, roll, &instrument, &sun).unwrap();
            let none = offset(on_plate(x, y), roll, &instrument, &sun, target).unwrap();
            prop_assert!(none.azimuth_deg.hypot(none.elevation_deg) < 1e-9, "{none:?}");
        }
    }
}
