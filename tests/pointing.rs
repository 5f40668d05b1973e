//! The Sun on the plate tells where the telescope points, as the HEROES flight program said and as the sphere
//! says.

use jiff::Timestamp;
use nalgebra::Matrix2;
use proptest::prelude::*;
use solaspect::aspect::{self, Expected, Quality};
use solaspect::fits;
use solaspect::instrument::{Instrument, builtin};
use solaspect::pointing::{
    Feature, HelioprojectiveArcsec, PointingError, Target, offset, offset_of, pointing,
    sun_on_plate, sun_on_plate_for,
};
use solaspect::sky::{Ephemeris, SunPosition};
use solaspect::units::{Estimate, PlateMil};
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

/// A Sun on the plate known to 0.1 mil in each axis.
fn on_plate(x: f64, y: f64) -> Estimate<PlateMil> {
    Estimate {
        position: PlateMil::new(x, y),
        covariance: Matrix2::identity() * 0.01,
    }
}

fn instrument(clocking_deg: f64, boresight_mil: PlateMil) -> Instrument {
    let mut instrument = builtin("heroes-pyas-f").unwrap();
    instrument.mounting.clocking_deg.value = clocking_deg;
    instrument.mounting.boresight_mil = boresight_mil;
    instrument
}

#[test]
fn offsets_are_those_of_the_heroes_flight_program() {
    let rows: Vec<Vec<f64>> = include_str!("data/pointing.csv")
        .lines()
        .filter(|line| !line.starts_with('#'))
        .skip(1)
        .map(|line| line.split(',').map(|n| n.parse().unwrap()).collect())
        .collect();
    assert_eq!(rows.len(), 3);
    for row in rows {
        let instrument = instrument(row[4], PlateMil::new(row[5], row[6]));
        let sun = sun(row[9], row[10], row[11]);
        let target = HelioprojectiveArcsec {
            x: row[2],
            y: row[3],
        };
        let found = offset(on_plate(row[0], row[1]), &instrument, &sun, target).unwrap();
        let off = [found.azimuth_deg - row[12], found.elevation_deg - row[13]];
        assert!(
            off.iter().all(|d| d.abs() < 0.3 * ARCSEC),
            "off by {off:?} deg"
        );
    }
}

#[test]
fn a_target_at_solar_north_lies_where_north_is_turned_to() {
    // North turned to the right of the zenith by 90 deg: the target lies at larger azimuth, so the telescope,
    // pointing at the Sun, is short of it. West is then straight down.
    let instrument = instrument(0.0, PlateMil::new(0.0, 0.0));
    let sun = sun(180.0, 0.0, 90.0);
    let north = HelioprojectiveArcsec { x: 0.0, y: 900.0 };
    let found = offset(on_plate(0.0, 0.0), &instrument, &sun, north).unwrap();
    assert!((found.azimuth_deg + 0.25).abs() < 1e-9, "{found:?}");
    assert!(found.elevation_deg.abs() < 1e-9, "{found:?}");
    let west = HelioprojectiveArcsec { x: 900.0, y: 0.0 };
    let found = offset(on_plate(0.0, 0.0), &instrument, &sun, west).unwrap();
    assert!((found.elevation_deg - 0.25).abs() < 1e-9, "{found:?}");
}

#[test]
fn an_azimuth_difference_across_north_is_small() {
    let instrument = instrument(0.0, PlateMil::new(0.0, 0.0));
    for azimuth_deg in [0.01, 359.99] {
        for x in [-300.0, 300.0] {
            let sun = sun(azimuth_deg, 32.0, 10.0);
            let found = offset(on_plate(x, 0.0), &instrument, &sun, CENTRE).unwrap();
            let expected = 300.0 * 1.7464 * ARCSEC / 32_f64.to_radians().cos();
            assert!((found.azimuth_deg.abs() - expected).abs() < 1e-4);
        }
    }
}

#[test]
fn near_the_zenith_there_is_no_offset_but_a_reason() {
    let instrument = builtin("demo").unwrap();
    let found = offset(
        on_plate(0.0, 0.0),
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
    // The Sun stands in the zenith of the equator at its noon.
    assert_eq!(
        conclude(Some(utc), "0.7,-91.7,0", fixed),
        reason("too near the zenith for azimuths")
    );
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
    let behind = pointing(PlateMil::new(0.0, 0.0), &instrument, &sun(0.0, 20.0, 0.0));
    let found = sun_on_plate(behind, &instrument, &sun(180.0, 20.0, 0.0));
    assert!(matches!(found, Err(PointingError::BehindTheLens { .. })));
}

#[test]
fn the_uncertainty_is_the_scatter_that_the_sphere_shows() {
    // Move the Sun by one sigma along each principal axis of its covariance and measure on the sky.
    let instrument = instrument(-32.425, PlateMil::new(124.68, -74.64));
    let sun = sun(158.5, 54.0, -41.0);
    let covariance = Matrix2::new(4.0, 1.0, 1.0, 9.0);
    let root = covariance.cholesky().unwrap().l();
    let centre = PlateMil::new(2500.0, -1800.0);
    let start = pointing(centre, &instrument, &sun);
    let mut variance = 0.0;
    for column in root.column_iter() {
        let step = 1e-2;
        let moved = PlateMil::from(centre.vector() + column * step);
        let end = pointing(moved, &instrument, &sun);
        let up = (end.elevation_deg - start.elevation_deg) / step;
        let across =
            (end.azimuth_deg - start.azimuth_deg) / step * start.elevation_deg.to_radians().cos();
        variance += (up.powi(2) + across.powi(2)) / 2.0;
    }
    let estimate = Estimate {
        position: centre,
        covariance,
    };
    let found = offset(estimate, &instrument, &sun, CENTRE).unwrap();
    let ratio = found.sigma_deg / variance.sqrt();
    assert!((ratio - 1.0).abs() < 1e-3, "ratio {ratio}");
    let trace = found.covariance_deg2.trace() / 2.0;
    assert!((trace.sqrt() / found.sigma_deg - 1.0).abs() < 1e-12);
}

#[test]
fn the_calibrations_share_is_the_scatter_of_its_values_and_stands_apart() {
    // Move each calibrated value by its sigma and measure on the sky.
    let mut known = instrument(-32.425, PlateMil::new(124.68, -74.64));
    known.mounting.boresight_sigma_mil = 2.0;
    known.mounting.clocking_deg.sigma = 0.1;
    known.optics.plate_distance_mm.sigma = 3.0;
    let sun = sun(158.5, 54.0, -41.0);
    let centre = on_plate(2500.0, -1800.0);
    let start = pointing(centre.position, &known, &sun);
    let mut expected = Matrix2::zeros();
    let step = 1e-3;
    for value in 0..4 {
        let mut moved = known.clone();
        match value {
            0 => moved.mounting.boresight_mil.x += 2.0 * step,
            1 => moved.mounting.boresight_mil.y += 2.0 * step,
            2 => moved.mounting.clocking_deg.value += 0.1 * step,
            _ => moved.optics.plate_distance_mm.value += 3.0 * step,
        }
        let end = pointing(centre.position, &moved, &sun);
        let cos = start.elevation_deg.to_radians().cos();
        let across = (end.azimuth_deg - start.azimuth_deg) * cos / step;
        let up = (end.elevation_deg - start.elevation_deg) / step;
        let moved = nalgebra::Vector2::new(across, up);
        expected += moved * moved.transpose();
    }
    let found = offset(centre, &known, &sun, CENTRE).unwrap();
    let off = (found.calibration_deg2 - expected).norm() / expected.norm();
    assert!(off < 1e-3, "{} for {expected}", found.calibration_deg2);
    // Behind the table of Earth orientation the Sun itself is uncertain.
    let uncertain_sun = SunPosition {
        ut1_shift_arcsec: [3.0, -4.0],
        ..sun
    };
    let uncertain = offset(centre, &known, &uncertain_sun, CENTRE).unwrap();
    let added_deg2 = uncertain.calibration_deg2 - found.calibration_deg2;
    let added_arcsec = added_deg2.trace().sqrt() / ARCSEC;
    assert!((added_arcsec - 5.0).abs() < 0.05, "{added_arcsec}");
    assert_eq!(uncertain.covariance_deg2, found.covariance_deg2);
    // A perfect calibration changes nothing of what the frame says of itself.
    known.mounting.boresight_sigma_mil = 0.0;
    known.mounting.clocking_deg.sigma = 0.0;
    known.optics.plate_distance_mm.sigma = 0.0;
    let perfect = offset(centre, &known, &sun, CENTRE).unwrap();
    assert_eq!(perfect.calibration_sigma_deg(), 0.0);
    assert_eq!(perfect.covariance_deg2, found.covariance_deg2);
}

#[test]
fn cross_elevation_is_a_true_angle() {
    let instrument = instrument(0.0, PlateMil::new(0.0, 0.0));
    let found = offset(
        on_plate(300.0, 0.0),
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
    ) {
        let instrument = builtin("heroes-pyas-r").unwrap();
        let sun = sun(azimuth_deg, elevation_deg, turn_deg);
        let target = HelioprojectiveArcsec { x: target_x, y: target_y };
        let found = offset(on_plate(x, y), &instrument, &sun, target).unwrap();
        let back = sun_on_plate_for(&found, &instrument, &sun, target).unwrap();
        prop_assert!(back.distance(PlateMil::new(x, y)) < 1e-6, "{back:?}");
    }
}
