//! Invalid input: errors that name the place, counts with reasons, and no copy of half a list.

use super::copies::rich_file;
use super::flight::*;
use super::lists::Key::{Number, Text};
use super::lists::*;
use rand::RngExt;
use solaspect::events::EventsError;
use solaspect::observe::Watch;
use std::fs;
use std::slice::from_ref;

#[test]
fn mistakes_are_errors_that_name_file_and_field_and_leave_no_copy() {
    let bench = Bench::plain();
    let photons = [[1.0, 0.0, 0.0, 1.0], [2.0, 0.0, 0.0, 7.0]];
    let plain = event_table(&photons);
    let two = "[[detector]]\nid = 1\nscale_arcsec = 1\ncentre = [0, 0]\nrotation_deg = 0\n\
               [[detector]]\nid = 2\nscale_arcsec = 1\ncentre = [0, 0]\nrotation_deg = 0\n";
    let in_file = |detectors: &str, table: Table, end: &str| {
        let error = bench.refusal(detectors, &[table]);
        assert!(
            error.contains("in.fits: ") && error.ends_with(end),
            "{error}"
        );
    };
    in_file(
        two,
        plain.clone(),
        "EVENTS, row 2: column DET_ID: expected the id of a detector (1, 2), found 7",
    );
    in_file(
        PLAIN,
        plain.clone().without("MJDREF"),
        "EVENTS: MJDREF: expected a day, here or in MJDREFI and MJDREFF, found none",
    );
    in_file(
        PLAIN,
        plain.clone().without("MJDREF").with("MJDREF", Text("soon")),
        "EVENTS: MJDREF: expected a finite number, found 'soon'",
    );
    in_file(
        PLAIN,
        plain.clone().with("TIMEUNIT", Text("weeks")),
        "EVENTS: TIMEUNIT: expected a unit of time (s, d, h, min, ms, us, ns), found 'weeks'",
    );
    for missing in ["TIME", "X", "Y"] {
        let mut table = plain.clone();
        table.column(missing).0 = "OTHER";
        in_file(
            PLAIN,
            table.clone(),
            &format!(
                "EVENTS: column {missing}: expected one of this name, found {} only",
                table
                    .columns
                    .iter()
                    .map(|column| column.0)
                    .collect::<Vec<_>>()
                    .join(", ")
            ),
        );
    }
    let mut vector = plain.clone();
    (vector.column("X").1, vector.column("X").3) = ("2D", vec![0.0; 4]);
    in_file(
        PLAIN,
        vector,
        "EVENTS: column X: expected one number in each row (B, I, J, K, E or D), found '2D'",
    );
    for (keyword, end) in [
        (
            "TNULL3",
            "TNULL3: expected a whole number without a point, found 4.0",
        ),
        ("TZERO3", "TZERO3: expected a finite number, found 'soon'"),
    ] {
        let value = if keyword == "TNULL3" {
            Number(4.0)
        } else {
            Text("soon")
        };
        in_file(PLAIN, plain.clone().with(keyword, value), end);
    }
    let mut twice = plain.clone();
    twice.columns.push(("hpx", "1D", "", vec![0.0; 2]));
    in_file(
        PLAIN,
        twice,
        "EVENTS: column HPX: expected none of this name, which is added, found one",
    );
    let mut unnamed = plain.clone();
    (unnamed.name, unnamed.column("TIME").0) = ("PHOTONS", "WHEN");
    in_file(
        PLAIN,
        unnamed,
        "in.fits: expected a table EVENTS, or one table with a column TIME, found 0 with one",
    );
    let mut interval = good_times("GTI", &[[0.0, 1.0]]);
    interval.column("STOP").0 = "END";
    write(&bench.at("in.fits"), &[], &[plain.clone(), interval]);
    let error = bench.place("in.fits", PLAIN, &()).unwrap_err().to_string();
    assert!(
        error.ends_with(
            "GTI: column STOP: expected one of this name, found START, END, WEIGHT only"
        ),
        "{error}"
    );

    for (detectors, end) in [
        (
            "",
            "det.toml: detector: expected one [[detector]] or more, found none",
        ),
        (
            &PLAIN.replace("scale_arcsec", "scale_arcsecs"),
            "det.toml: detector.0.scale_arcsecs: expected a known key (the nearest is \"detector.scale_arcsec\"), found an unknown key",
        ),
        (
            &PLAIN.replace("1.0", "-1.0"),
            "det.toml: detector.0.scale_arcsec: expected a number above 0, found -1",
        ),
        (
            &two.replace("id = 2", "id = 1"),
            "det.toml: detector.1.id: expected an id of its own for each detector, found 1 again",
        ),
        (
            &two.replace("id = 2\n", ""),
            "det.toml: detector.1.id: expected an id of its own for each detector, found none",
        ),
    ] {
        let error = bench.refusal(detectors, from_ref(&plain));
        assert!(error.ends_with(end), "{error}");
    }
    fs::write(bench.at("in.fits"), "no FITS").unwrap();
    let error = bench.place("in.fits", PLAIN, &()).unwrap_err().to_string();
    assert!(
        error.contains("in.fits: expected a FITS file, found a file that begins with \"no FITS\""),
        "{error}"
    );
    fs::write(
        bench.at("in.fits"),
        format!("{:2880}", "SIMPLE  = 'T       '"),
    )
    .unwrap();
    let error = bench.place("in.fits", PLAIN, &()).unwrap_err().to_string();
    assert!(
        error.ends_with("in.fits: expected a FITS file, found \"illegal SIMPLE keyword value\""),
        "{error}"
    );
    let error = bench
        .place("none.fits", PLAIN, &())
        .unwrap_err()
        .to_string();
    assert!(error.contains("none.fits: expected"), "{error}");
    fs::remove_file(bench.at("pointing.fits")).unwrap();
    write(&bench.at("in.fits"), &[], &[plain]);
    let error = bench.place("in.fits", PLAIN, &()).unwrap_err().to_string();
    assert!(
        error.contains("pointing.fits: expected a refined flight's pointing.fits"),
        "{error}"
    );
}

#[test]
fn photons_of_garbage_are_counted_by_reason_and_never_panic() {
    let history = troubled();
    let bench = Bench::new(&history);
    let mut random = random(4);
    let mut garbage = |scale: f64| match random.random_range(0..12) {
        0 => f64::NAN,
        1 => f64::INFINITY,
        2 => f64::NEG_INFINITY,
        3 => 1e300,
        4 => -1e300,
        5 => f64::MIN_POSITIVE,
        6 => f64::from_bits(random.random()),
        _ => random.random_range(-0.2..1.2) * scale,
    };
    let photons: Vec<[f64; 4]> = (0..100_000)
        .map(|_| [garbage(SECONDS as f64), garbage(300.0), garbage(300.0), 1.0])
        .collect();
    for (scale, ahead_s) in [("UTC", 0.0), ("TT", 67.184)] {
        let table = event_table(&photons)
            .without("TIMESYS")
            .with("TIMESYS", Text(scale))
            .with("TIMEZERO", Number(ahead_s));
        let (placed, columns) = bench.placed(
            PLAIN,
            &[],
            &[
                table,
                good_times(
                    "GTI",
                    &[[f64::NAN, 3.0], [f64::NEG_INFINITY, f64::INFINITY]],
                ),
            ],
        );
        let invalid: u64 = placed.invalid.values().sum();
        assert_eq!((placed.photons, placed.valid + invalid), (100_000, 100_000));
        for why in [
            "no time",
            "no position",
            "extrapolated",
            "gap",
            "contradicted",
            "slew",
            "uncertain",
        ] {
            assert!(placed.invalid.get(why) > Some(&100), "{why}: {placed:?}");
        }
        for ((hp, valid), sigma) in columns.hp.iter().zip(&columns.valid).zip(&columns.sigma) {
            let is_known = hp[0].is_finite() && hp[1].is_finite() && sigma.is_finite();
            assert!(is_known || !valid, "{hp:?} {sigma}");
        }
        let counted = columns.valid.iter().filter(|valid| **valid).count() as u64;
        assert_eq!(counted, placed.valid);
    }
}

#[test]
fn damaged_lists_are_errors_or_lists_and_the_copy_is_whole_or_absent() {
    let bench = Bench::plain();
    rich_file(&bench.at("in.fits"), &some_photons(40, 1));
    let whole = fs::read(bench.at("in.fits")).unwrap();
    let mut random = random(9);
    let mut outcomes = [0, 0];
    for _ in 0..500 {
        let mut damaged = whole.clone();
        for _ in 0..random.random_range(1..6) {
            let at = random.random_range(0..damaged.len());
            // In most cases the new byte is a character that occurs in cards.
            damaged[at] = match random.random_range(0..4) {
                0 => random.random(),
                1 => b' ',
                2 => b'9',
                _ => b"-.()PQEDJKIBALX0123456789"[random.random_range(0..25)],
            };
        }
        if random.random_range(0..8) == 0 {
            damaged.truncate(random.random_range(0..damaged.len()));
        }
        fs::write(bench.at("in.fits"), &damaged).unwrap();
        let _ = fs::remove_file(bench.at("out.fits"));
        let outcome = bench.place("in.fits", PLAIN, &());
        assert_eq!(outcome.is_ok(), bench.at("out.fits").exists());
        outcomes[usize::from(outcome.is_ok())] += 1;
        if let Err(error) = outcome {
            assert!(error.to_string().contains("in.fits: "), "{error}");
        }
    }
    assert!(outcomes.iter().all(|count| *count > 50), "{outcomes:?}");
}

struct Impatient;

impl Watch for Impatient {
    fn is_cancelled(&self) -> bool {
        true
    }
}

#[test]
fn a_run_that_is_cancelled_leaves_nothing() {
    let bench = Bench::plain();
    write(
        &bench.at("in.fits"),
        &[],
        &[event_table(&some_photons(2000, 1))],
    );
    let error = bench.place("in.fits", PLAIN, &Impatient).unwrap_err();
    assert!(matches!(error, EventsError::Cancelled { .. }), "{error}");
    assert_eq!(
        fs::read_dir(bench.folder.path()).unwrap().count(),
        3,
        "pointing, list and detectors"
    );
}
