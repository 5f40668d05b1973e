//! Good time intervals are restricted to the times of valid pointing.

use super::copies::parts;
use super::flight::*;
use super::lists::Key::{Number, Text};
use super::lists::*;
use rand::RngExt;
use solaspect::events::Exposure;
use std::slice::from_ref;

#[test]
fn intervals_are_those_in_which_the_pointing_is_valid() {
    let history = troubled();
    let intervals = history.valid_intervals();
    assert!(
        intervals.windows(2).all(|pair| pair[0][1] < pair[1][0]),
        "{intervals:?}"
    );
    assert!(intervals.len() >= 5, "{intervals:?}");
    let step_s = 1.0 / 512.0;
    let mut differ_s = 0.0;
    for n in -512..(SECONDS as i64 + 2) * 512 {
        let unix_s = START_S + n as f64 * step_s;
        let is_inside = intervals
            .iter()
            .any(|[from, to]| (*from..=*to).contains(&unix_s));
        let is_valid = history.at(unix_s).is_valid();
        assert!(is_valid || !is_inside, "{}", unix_s - START_S);
        if is_valid && !is_inside {
            differ_s += step_s;
        }
    }
    assert!(differ_s < 0.01 * intervals.len() as f64, "{differ_s}");
}

#[test]
fn good_time_intervals_lie_inside_both_and_exposure_is_their_length() {
    let history = troubled();
    let bench = Bench::new(&history);
    let mut random = random(3);
    let photons: Vec<[f64; 4]> = (0..20_000)
        .map(|_| [random.random_range(-5.0..70.0), 0.0, 0.0, 1.0])
        .collect();
    let own = [[-3.0, 9.3], [12.5, 33.3], [34.0, 34.0], [37.25, 80.0]];
    let integers = |mut table: Table| {
        (table.column("START").1, table.column("STOP").1) = ("1J", "1J");
        table
            .with("TSCAL1", Number(0.25))
            .with("TSCAL2", Number(0.25))
    };
    for table in [
        good_times("GTI", &own),
        integers(good_times("STDGTI", &own)),
        good_times("STDGTI2", &own).without("MJDREF"),
    ] {
        let name = table.name;
        let (placed, columns) = bench.placed(PLAIN, &[], &[event_table(&photons), table]);
        let ends = |name_of: &str| since_start(&bench.at("out.fits"), name, name_of);
        let found: Vec<[f64; 2]> = ends("START")
            .into_iter()
            .zip(ends("STOP"))
            .map(|(a, b)| [a, b])
            .collect();
        let after_s: f64 = found.iter().map(|[from, to]| to - from).sum();
        let [
            Exposure {
                extension,
                before_s,
                after_s: stated_s,
            },
        ] = &placed.exposures[..]
        else {
            panic!("{placed:?}");
        };
        assert_eq!(extension, name);
        assert!(
            (before_s - 75.85).abs() < 0.3 && (stated_s - after_s).abs() < 1e-5,
            "{placed:?}"
        );
        let inside =
            |s: f64, all: &[[f64; 2]]| all.iter().any(|[from, to]| (*from..=*to).contains(&s));
        let mut lost = 0;
        for ([s, ..], valid) in photons.iter().zip(&columns.valid) {
            let is_inside = inside(*s, &found);
            assert!(
                !is_inside || (*valid && inside(*s, &own.map(|[a, b]| [a - 0.13, b + 0.13]))),
                "{name}: {s}"
            );
            lost += u32::from(*valid && inside(*s, &own) && !is_inside);
        }
        // Only interval ends rounded to quarters of a second lose time.
        assert!(
            lost < if name == "STDGTI" { 900 } else { 20 },
            "{name}: {lost}"
        );
    }
}

#[test]
fn intervals_without_a_scale_are_in_that_of_the_photons() {
    let bench = Bench::plain();
    let photons: Vec<[f64; 4]> = (0..60).map(|n| [n as f64 + 0.5, 0.0, 0.0, 1.0]).collect();
    let list = event_table(&photons)
        .without("TIMESYS")
        .with("TIMESYS", Text("TT"));
    // TT is 67.184 s ahead of UTC: the flight begins at 67.184 s and ends at 127.184 s.
    let intervals = good_times("GTI", &[[0.0, 100.0]]);
    bench.placed(PLAIN, &[], &[list, intervals]);
    let ends = ["START", "STOP"].map(|end| since_start(&bench.at("out.fits"), "GTI", end));
    assert!(
        (ends[0][0] - 67.184).abs() < 1e-3 && ends[1] == [100.0],
        "{ends:?}"
    );
}

#[test]
fn a_file_without_good_time_intervals_gets_them() {
    let history = troubled();
    let bench = Bench::new(&history);
    let photons: Vec<[f64; 4]> = (0..700)
        .map(|n| [n as f64 * 0.1 - 5.0, 0.0, 0.0, 1.0])
        .collect();
    let table = event_table(&photons).with("TIMEZERO", Number(0.0));
    let (placed, columns) = bench.placed(PLAIN, &[], from_ref(&table));
    let starts = column(&bench.at("out.fits"), "GTI", "START");
    let stops = column(&bench.at("out.fits"), "GTI", "STOP");
    for ([s, ..], valid) in photons.iter().zip(&columns.valid) {
        let time = s + START_S - MIDNIGHT_S;
        let is_inside = starts
            .iter()
            .zip(&stops)
            .any(|(from, to)| (*from..=*to).contains(&time));
        assert_eq!(is_inside, *valid, "{s}");
    }
    assert!((placed.exposures[0].before_s - 69.9).abs() < 1e-3);
    let cards = &parts(&bench.at("out.fits"))[2].0;
    for keyword in ["MJDREF  =", "TIMESYS =", "TIMEZERO="] {
        assert!(
            cards.iter().any(|card| card.starts_with(keyword)),
            "{keyword} {cards:#?}"
        );
    }
    let stated = table
        .with("TSTART", Number(64_801.0))
        .with("TSTOP", Number(64_802.5));
    let (placed, _) = bench.placed(PLAIN, &[], &[stated]);
    assert_eq!(placed.exposures[0].before_s, 1.5);
}
