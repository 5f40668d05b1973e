//! Contents and names of copies.

use super::flight::SECONDS;
use super::lists::*;
use fitsio::{FileOpenMode, FitsFile, sys};
use solaspect::events::{EventsError, Files, place_photons};
use solaspect::fits::open_disk_file;
use std::fs;
use std::io::Write;
use std::path::Path;

/// The HDUs of a file, each as its cards and data.
pub fn parts(path: &Path) -> Vec<(Vec<String>, Vec<u8>)> {
    let bytes = fs::read(path).unwrap();
    let mut file = open_disk_file(path, FileOpenMode::READONLY).unwrap();
    let (mut count, mut status) = (0, 0);
    unsafe { sys::ffthdu(file.as_raw(), &mut count, &mut status) };
    let mut part = |n| {
        let (mut kind, mut start, mut data, mut end) = (0, 0, 0, 0);
        unsafe {
            sys::ffmahd(file.as_raw(), n, &mut kind, &mut status);
            sys::ffghadll(file.as_raw(), &mut start, &mut data, &mut end, &mut status);
        }
        assert_eq!(status, 0);
        let cards = bytes[start as usize..data as usize].chunks(80);
        let cards = cards.map(|card| String::from_utf8(card.to_vec()).unwrap());
        let cards = cards.take_while(|card| card.trim_end() != "END");
        (cards.collect(), bytes[data as usize..end as usize].to_vec())
    };
    (1..=count).map(&mut part).collect()
}

/// Writes a list whose photons have a heap, between other tables with heaps, and good time intervals.
pub fn rich_file(path: &Path, photons: &[[f64; 4]]) {
    let heap = |name| Table {
        name,
        keys: vec![],
        columns: vec![
            ("N", "1J", "", vec![1.0, 2.0, 3.0]),
            ("V", "1PE", "", vec![]),
        ],
    };
    let mut events = event_table(photons);
    events.columns.insert(2, ("V", "1PI(3)", "", vec![]));
    events.columns.push(("LAST", "3A", "", vec![]));
    write(
        path,
        &[],
        &[
            heap("OTHER"),
            events,
            good_times("STDGTI01", &[[5.0, 25.5], [40.0, 99.0]]),
            heap("MORE"),
        ],
    );
    let mut file = FitsFile::edit(path).unwrap();
    let mut status = 0;
    for (table, column, rows) in [
        ("OTHER", 2, 3),
        ("EVENTS", 3, photons.len() as i64),
        ("MORE", 2, 3),
    ] {
        // fitsio does not support columns of variable-length arrays.
        unsafe {
            sys::ffmnhd(
                file.as_raw(),
                2,
                c(table).as_ptr().cast_mut(),
                0,
                &mut status,
            )
        };
        for row in 1..=rows {
            let mut values = vec![row as f64; (row % 4) as usize];
            let count = values.len() as i64;
            unsafe {
                sys::ffpcld(
                    file.as_raw(),
                    column,
                    row,
                    1,
                    count,
                    values.as_mut_ptr(),
                    &mut status,
                )
            };
        }
        unsafe {
            sys::ffphis(
                file.as_raw(),
                c("of the instrument's own program").as_ptr(),
                &mut status,
            );
            sys::ffpcks(file.as_raw(), &mut status);
        }
    }
    assert_eq!(status, 0);
}

#[test]
fn what_is_not_added_stays_byte_for_byte_and_checksums_are_right() {
    let bench = Bench::plain();
    let photons = some_photons(777, 1);
    rich_file(&bench.at("in.fits"), &photons);
    bench.place("in.fits", PLAIN, &()).unwrap();
    assert_sums(&bench.at("out.fits"));
    let (before, after) = (parts(&bench.at("in.fits")), parts(&bench.at("out.fits")));
    assert_eq!(before.len(), after.len());
    for n in [0, 1, 4] {
        assert!(before[n] == after[n], "HDU {n}");
    }
    let structural = |card: &&String| {
        let keyword = card[..8].trim_end();
        ["NAXIS1", "NAXIS2", "TFIELDS", "CHECKSUM", "DATASUM"].contains(&keyword)
    };
    for n in [2, 3] {
        let kept: Vec<&String> = before[n]
            .0
            .iter()
            .filter(|card| !structural(card))
            .collect();
        let mut left = after[n].0.iter();
        for card in kept {
            assert!(left.any(|found| found == card), "HDU {n}: {card}");
        }
    }
    let added: Vec<&String> = after[2]
        .0
        .iter()
        .filter(|card| !before[2].0.contains(card))
        .collect();
    let has = |text: &str| {
        assert!(
            added.iter().any(|card| card.contains(text)),
            "{text}: {added:#?}"
        )
    };
    for text in [
        "'HPX     '",
        "'HP_VALID'",
        "'arcsec  '",
        "HISTORY solaspect ",
        "helioprojective longitude",
    ] {
        has(text);
    }
    has(&solaspect::provenance::sha256_of_file(&bench.at("pointing.fits")).unwrap());

    // Rows are the old bytes and 33 new ones; the heap follows.
    let row = 8 + 2 + 8 + 8 + 8 + 1 + 3;
    let rows = |data: &[u8], bytes: usize| {
        data.chunks(bytes)
            .take(777)
            .map(|r| r[..row].to_vec())
            .collect::<Vec<_>>()
    };
    assert!(rows(&before[2].1, row) == rows(&after[2].1, row + 33));
    let heap = |(cards, data): &(Vec<String>, Vec<u8>), row_bytes: usize| {
        let card = cards.iter().find(|card| card.starts_with("PCOUNT"));
        let bytes = card.unwrap()[10..30].trim().parse().unwrap();
        data[777 * row_bytes..][..bytes].to_vec()
    };
    let kept = heap(&before[2], row);
    assert!(kept.len() > 1000 && kept == heap(&after[2], row + 33));

    // The second interval is cut at the end of the flight; its other column is kept.
    assert_eq!(
        column(&bench.at("out.fits"), "STDGTI01", "WEIGHT"),
        [100.0, 101.0]
    );
    let ends = since_start(&bench.at("out.fits"), "STDGTI01", "STOP");
    assert!(
        (ends[0] - 25.5).abs() < 1e-6 && (ends[1] - SECONDS as f64).abs() < 1e-3,
        "{ends:?}"
    );
}

#[test]
fn names_with_brackets_and_gzipped_lists_are_files_like_others() {
    let bench = Bench::plain();
    let photons = some_photons(50, 1);
    write(&bench.at("in.fits"), &[], &[event_table(&photons)]);
    bench.place("in.fits", PLAIN, &()).unwrap();
    let expected = fs::read(bench.at("out.fits")).unwrap();
    let plain = fs::read(bench.at("in.fits")).unwrap();
    for name in [
        "a[1].fits",
        "a[col X=1].fits",
        "!in.fits",
        "in.fits(new.fits)",
    ] {
        fs::write(bench.at(name), &plain).unwrap();
        bench.place(name, PLAIN, &()).unwrap();
        assert!(
            fs::read(bench.at("out.fits")).unwrap() == expected,
            "{name}"
        );
    }
    let mut packed = flate2::write::GzEncoder::new(
        fs::File::create(bench.at("in.fits.gz")).unwrap(),
        flate2::Compression::fast(),
    );
    packed.write_all(&plain).unwrap();
    packed.finish().unwrap();
    bench.place("in.fits.gz", PLAIN, &()).unwrap();
    assert!(fs::read(bench.at("out.fits")).unwrap() == expected);
    let whole = fs::read(bench.at("in.fits.gz")).unwrap();
    fs::write(bench.at("cut.fits.gz"), &whole[..whole.len() - 20]).unwrap();
    let error = bench
        .place("cut.fits.gz", PLAIN, &())
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("cut.fits.gz: expected a whole gzip file"),
        "{error}"
    );
    // A failed run leaves the existing output unchanged.
    assert!(fs::read(bench.at("out.fits")).unwrap() == expected);
}

#[test]
fn no_file_that_is_read_is_overwritten() {
    let bench = Bench::plain();
    write(
        &bench.at("in.fits"),
        &[],
        &[event_table(&some_photons(5, 1))],
    );
    fs::write(bench.at("det.toml"), PLAIN).unwrap();
    fs::hard_link(bench.at("in.fits"), bench.at("link.fits")).unwrap();
    for out in ["in.fits", "link.fits", "det.toml", "pointing.fits"] {
        let before = fs::read(bench.at(out)).unwrap();
        let files = Files {
            refined: bench.folder.path(),
            events: &bench.at("in.fits"),
            detectors: &bench.at("det.toml"),
            out: Some(&bench.at(out)),
            image: None,
        };
        let error = place_photons(files, &()).unwrap_err();
        assert!(matches!(error, EventsError::Overwrites { .. }), "{error}");
        assert!(fs::read(bench.at(out)).unwrap() == before, "{out}");
    }
}
