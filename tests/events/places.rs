//! Positions of photons, and their uncertainty.

use super::flight::*;
use super::lists::Key::{Number, Text, Whole};
use super::lists::*;
use nalgebra::{Matrix3, UnitQuaternion, UnitVector3, Vector3};
use rand_xoshiro::Xoshiro256PlusPlus;
use std::fs;

#[test]
fn photons_land_where_the_rotation_says_for_every_turn_mirror_and_offset() {
    let mut text = String::from("x_column = \"X\"\n");
    let mut mounted = Vec::new();
    for (id, turn_deg) in (1_u64..).zip([0.0, 90.0, 180.0, 270.0, 33.3, -123.4]) {
        for mirrored in [false, true] {
            let id = 2 * id + u64::from(mirrored) - 2;
            let offset = [40.0 * id as f64, -25.0 * id as f64];
            text += &format!(
                "[[detector]]\nid = {id}\nscale_arcsec = 1.7\ncentre = [12.5, -7.0]\nrotation_deg = {turn_deg}\n\
                 mirrored = {mirrored}\noffset_arcsec = {offset:?}\n"
            );
            mounted.push((turn_deg, mirrored, offset));
        }
    }
    let mut photons = some_photons(3000, mounted.len() as u64);
    photons.iter_mut().for_each(|photon| photon[3] -= 1.0);
    let (placed, columns) = Bench::plain().placed(&text, &[], &[event_table(&photons)]);
    assert_eq!((placed.photons, placed.valid), (3000, 3000));
    for ([s, x, y, id], found) in photons.iter().zip(&columns.hp) {
        let (turn_deg, mirrored, offset): (f64, bool, [f64; 2]) = mounted[*id as usize];
        // Polar coordinates about the detector's axis; in a mirrored detector angles have the opposite sense.
        let (dx, dy) = (1.7 * (x - 12.5), 1.7 * (y + 7.0));
        let angle = if mirrored {
            -dy.atan2(dx)
        } else {
            dy.atan2(dx)
        } + turn_deg.to_radians();
        let place = [
            dx.hypot(dy) * angle.cos() + offset[0],
            dx.hypot(dy) * angle.sin() + offset[1],
        ];
        let expected = truth_arcsec(&attitude(START_S + s), place);
        assert_close(*found, expected, 1e-3, &format!("detector {id}"));
    }
}

#[test]
fn sigma_is_the_scatter_over_pointings_drawn_from_the_covariance() {
    let place = [250.0, -170.0];
    let photons = [[10.0, place[0], place[1], 1.0]];
    let detectors = "[[detector]]\nid = 1\nscale_arcsec = 1.0\nscale_sigma_arcsec = 0.02\ncentre = [0, 0]\n\
                     centre_sigma = 2.0\nrotation_deg = 0\nrotation_sigma_deg = 1.0\noffset_sigma_arcsec = 3.0\n";
    let (_, columns) = Bench::plain().placed(detectors, &[], &[event_table(&photons)]);
    let mut random = random(2);
    let at = attitude(START_S + 10.0);
    let mean = truth_arcsec(&at, place);
    let draws = 40_000;
    let mut scatter = |draw: &mut dyn FnMut(&mut Xoshiro256PlusPlus) -> [f64; 2]| {
        let square = |found: [f64; 2]| (found[0] - mean[0]).powi(2) + (found[1] - mean[1]).powi(2);
        let sum: f64 = (0..draws).map(|_| square(draw(&mut random))).sum();
        (sum / f64::from(2 * draws)).sqrt()
    };
    // Rotate by roll about forward, up about right, and right about down.
    let moved = |covariance: &Matrix3<f64>, random: &mut Xoshiro256PlusPlus| {
        let factor = covariance.cholesky().unwrap().l();
        let [right, up, roll] = (factor * Vector3::from_fn(|_, _| normal(random))).into();
        at * UnitQuaternion::from_scaled_axis(Vector3::new(roll, up, right))
    };
    let expected = scatter(&mut |random| truth_arcsec(&moved(&random_rad2(), random), place));
    assert!(
        (columns.sigma[0] / expected - 1.0).abs() < 0.02,
        "{} {expected}",
        columns.sigma[0]
    );
    let expected = scatter(&mut |random| {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * normal(random).to_radians());
        let from_axis = Vector3::new(
            place[0] + 2.0 * normal(random),
            place[1] + 2.0 * normal(random),
            0.0,
        );
        let on_sky = turn * from_axis * (1.0 + 0.02 * normal(random));
        let offset = [
            on_sky.x + 3.0 * normal(random),
            on_sky.y + 3.0 * normal(random),
        ];
        truth_arcsec(&moved(&systematic_rad2(), random), offset)
    });
    assert!(
        (columns.systematic[0] / expected - 1.0).abs() < 0.02,
        "{} {expected}",
        columns.systematic[0]
    );
}

#[test]
fn times_of_every_unit_zero_and_scale_give_the_same_places() {
    let photons = some_photons(200, 1);
    let truth = plain_truth(&photons);
    let bench = Bench::plain();
    let plain = event_table(&photons);
    let counted = |unit_s: f64, zero_s: f64, form: &'static str| {
        let mut table = plain.clone().without("MJDREF");
        let column = table.column("TIME");
        (column.1, column.2) = (form, "");
        column.3 = photons
            .iter()
            .map(|photon| (photon[0] + START_S - zero_s) / unit_s)
            .collect();
        table
    };
    let days = 86_400.0;
    // TT is 32.184 s ahead of TAI, and TAI was 35 s ahead of UTC then (IERS Bulletin C 43).
    let tt_s = 35.0 + 32.184;
    let primary = |keys: &[(&str, Key)]| {
        keys.iter()
            .map(|(key, value)| ((*key).into(), *value))
            .collect()
    };
    let cases: Vec<(&str, Keys, Table)> = vec![
        ("seconds", vec![], plain.clone()),
        (
            "days",
            vec![],
            counted(days, MIDNIGHT_S, "1D")
                .with("MJDREF", Number(MJD_OF_MIDNIGHT))
                .with("TIMEUNIT", Text("d")),
        ),
        (
            "milliseconds in integers",
            vec![],
            counted(1e-3, MIDNIGHT_S, "1J")
                .with("MJDREF", Number(MJD_OF_MIDNIGHT))
                .with("TIMEUNIT", Text("ms")),
        ),
        (
            "microseconds in long integers",
            vec![],
            counted(1e-6, MIDNIGHT_S, "1K")
                .with("MJDREF", Number(MJD_OF_MIDNIGHT))
                .with("TIMEUNIT", Text("us")),
        ),
        (
            "seconds in scaled integers",
            vec![],
            counted(1.0, MIDNIGHT_S, "1J")
                .with("MJDREF", Number(MJD_OF_MIDNIGHT))
                .with("TSCAL1", Number(1e-4))
                .with("TZERO1", Number(64_800.0)),
        ),
        (
            "a whole and a fraction in the primary header, and a zero",
            primary(&[
                ("MJDREFI", Number(56_555.0)),
                ("MJDREFF", Number(0.25)),
                ("TIMEUNIT", Text("s")),
            ]),
            counted(1.0, MIDNIGHT_S - 0.75 * days + 1234.5, "1D").with("TIMEZERO", Number(1234.5)),
        ),
        (
            "a zero in days",
            primary(&[
                ("MJDREF", Number(56_000.0)),
                ("TIMEUNIT", Text("d")),
                ("TIMEZERO", Number(556.0)),
            ]),
            counted(days, MIDNIGHT_S, "1D"),
        ),
        (
            "terrestrial time",
            vec![],
            counted(1.0, MIDNIGHT_S - tt_s, "1D")
                .without("TIMESYS")
                .with("MJDREF", Number(MJD_OF_MIDNIGHT))
                .with("TIMESYS", Text("TT")),
        ),
        (
            "atomic time",
            vec![],
            counted(1.0, MIDNIGHT_S - 35.0, "1D")
                .without("TIMESYS")
                .with("MJDREF", Number(MJD_OF_MIDNIGHT))
                .with("TIMESYS", Text("TAI")),
        ),
    ];
    for (what, primary, table) in cases {
        let (placed, columns) = bench.placed(PLAIN, &primary, &[table]);
        assert_eq!(placed.valid, 200, "{what}: {placed:?}");
        for (found, expected) in columns.hp.iter().zip(&truth) {
            // The telescope moves at 36 arcsec/s: 0.5 ms are 0.02 arcsec, or with the roll 0.2 arcsec at the edge of the field.
            assert_close(*found, *expected, 0.4, what);
        }
    }
    let unknown = plain.without("TIMESYS").with("TIMESYS", Text("LOCAL"));
    fs::remove_file(bench.at("out.fits")).unwrap();
    let error = bench.refusal(PLAIN, &[unknown]);
    assert!(
        error.ends_with(
            "in.fits: EVENTS: TIMESYS: expected UTC, TT, TAI, TDB or GPS, found 'LOCAL'"
        ),
        "{error}"
    );
}

#[test]
fn numbers_of_any_form_and_scaling_are_read_as_cfitsio_reads_them() {
    let photons: Vec<[f64; 4]> = (0..40)
        .map(|n| [n as f64, (n % 90) as f64, (n % 7) as f64 * 2.0, 1.0])
        .collect();
    let bench = Bench::plain();
    for form in ["1B", "1I", "1J", "1K", "1E", "1D"] {
        let mut table = event_table(&photons)
            .with("TSCAL3", Number(0.5))
            .with("TZERO3", Number(-3.0))
            .with("TSCAL4", Number(2.0));
        table.column("X").1 = form;
        table.column("Y").1 = form;
        let (_, columns) = bench.placed(PLAIN, &[], &[table]);
        let out = bench.at("out.fits");
        let read = column(&out, "EVENTS", "X")
            .into_iter()
            .zip(column(&out, "EVENTS", "Y"));
        for ((found, (x, y)), [s, ..]) in columns.hp.iter().zip(read).zip(&photons) {
            let expected = truth_arcsec(&attitude(START_S + s), [x, y]);
            assert_close(*found, expected, 1e-3, form);
        }
    }
    // cfitsio writes unsigned integers as signed ones with a zero offset; a null gives no position.
    let mut table = event_table(&photons)
        .with("TZERO3", Number(32_768.0))
        .with("TNULL4", Whole(4));
    table.column("X").1 = "1I";
    table.column("Y").1 = "1I";
    let (placed, columns) = bench.placed(PLAIN, &[], &[table]);
    let nulls = photons.iter().filter(|photon| photon[2] == 4.0).count() as u64;
    assert_eq!(placed.invalid.get("no position"), Some(&nulls));
    for ((found, expected), photon) in columns.hp.iter().zip(plain_truth(&photons)).zip(&photons) {
        match photon[2] == 4.0 {
            true => assert!(found[0].is_nan()),
            false => assert_close(*found, expected, 1e-3, "unsigned"),
        }
    }
}

#[test]
fn a_direction_is_taken_in_the_plane_that_touches_the_sky() {
    // Far from the boresight: the tangent of the angle equals the coordinate in the tangent plane.
    let photons = [[0.0, 20_000.0, 0.0, 1.0]];
    let (_, columns) = Bench::plain().placed(PLAIN, &[], &[event_table(&photons)]);
    let axis = UnitVector3::new_normalize(attitude(START_S) * Vector3::x());
    let [x, y] = columns.hp[0].map(|arcsec| arcsec * ARCSEC);
    let towards = Vector3::new(x.cos() * y.cos(), -x.sin() * y.cos(), y.sin());
    assert!((axis.dot(&towards).acos().tan() - 20_000.0 * ARCSEC).abs() < 1e-9);
}
