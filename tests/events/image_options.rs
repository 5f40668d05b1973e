//! Effect of the image options on the counts; and rejected options.

use super::flight::{ARCSEC, SECONDS, START_S, attitude, troubled, truth_arcsec};
use super::lists::Key::{Number, Whole};
use super::lists::*;
use solaspect::events::{Energies, Field, ImageRequest};

pub const WITH_FIELD: &str = "[[detector]]\nscale_arcsec = 1.0\ncentre = [0, 0]\nrotation_deg = 0\nfield = [[-400, 400], [-400, 400]]\n";

/// A large field, because the test telescope moves by 2200 arcsec in its minute.
fn wide(bench: &Bench) -> ImageRequest {
    ImageRequest {
        field: Field {
            centre_arcsec: [0.0; 2],
            size_arcsec: [6000.0; 2],
        },
        ..bench.request()
    }
}

fn good() -> Table {
    good_times("GTI", &[[0.0, SECONDS as f64]])
}

/// The image pixel of a position (west, north), arcsec.
fn pixel(request: &ImageRequest, [x, y]: [f64; 2]) -> [i64; 2] {
    let Field {
        centre_arcsec,
        size_arcsec,
    } = request.field;
    let along = |at: f64, axis: usize| {
        ((at - centre_arcsec[axis] + size_arcsec[axis] / 2.0) / request.pixel_arcsec).floor() as i64
    };
    // Project to the tangent plane at the Sun's centre.
    let (x, y) = (x * ARCSEC, y * ARCSEC);
    [
        along(x.tan() / ARCSEC, 0),
        along(y.tan() / x.cos() / ARCSEC, 1),
    ]
}

#[test]
fn each_photon_is_in_the_pixel_of_its_place_or_counted_elsewhere() {
    let bench = Bench::new(&troubled());
    let photons = some_photons(20_000, 1);
    let request = ImageRequest {
        pixel_arcsec: 60.0,
        field: Field {
            centre_arcsec: [-600.0, 100.0],
            size_arcsec: [3600.0, 2400.0],
        },
        ..wide(&bench)
    };
    let placed = bench
        .image(WITH_FIELD, &[event_table(&photons), good()], &request)
        .unwrap();
    let imaged = placed.image.clone().unwrap();
    assert_eq!([imaged.width_px, imaged.height_px], [60, 40]);
    let history = troubled();
    let mut expected = [vec![0.0; 60 * 40], vec![0.0; 60 * 40]];
    let (mut outside, mut unplaced) = (0, 0);
    for [s, x, y, _] in &photons {
        let pointed = history.at(START_S + s);
        if pointed.line_of_sight.is_none() {
            unplaced += 1;
            continue;
        }
        let [column, row] = pixel(&request, truth_arcsec(&attitude(START_S + s), [*x, *y]));
        if !(0..60).contains(&column) || !(0..40).contains(&row) {
            outside += 1;
            continue;
        }
        expected[usize::from(!pointed.is_valid())][(row * 60 + column) as usize] += 1.0;
    }
    assert!(outside > 500 && unplaced > 100, "{outside} {unplaced}");
    let differ = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f64>();
    let [counts, invalid] = ["COUNTS", "INVALID"].map(|name| read_image(&request.path, name));
    // A photon on the edge of two pixels may be in either: the cubic interpolation between states has errors of a few 0.001 arcsec.
    assert!(differ(&counts, &expected[0]) <= 8.0);
    // In the slew the stated rates contradict the attitudes, so positions differ and only totals are compared.
    let totals = [&invalid, &expected[1]].map(|image| image.iter().sum::<f64>());
    assert!(
        totals[0] > 500.0 && (totals[0] - totals[1]).abs() <= 8.0,
        "{totals:?}"
    );
    let all = imaged.photons + imaged.invalid + imaged.outside + imaged.unplaced;
    assert!(all == 20_000 && imaged.unplaced == unplaced, "{imaged:?}");
    assert!(
        imaged.outside.abs_diff(outside) <= 16,
        "{outside} {imaged:?}"
    );
}

#[test]
fn only_photons_of_the_energies_count() {
    let bench = Bench::plain();
    let photons = some_photons(9000, 1);
    let energies = Energies {
        column: "pi".into(),
        range: [100.0, 299.0],
    };
    let request = ImageRequest {
        energies: Some(energies),
        ..wide(&bench)
    };
    let placed = bench
        .image(WITH_FIELD, &[event_table(&photons), good()], &request)
        .unwrap();
    // Channels run from 0 to 4095 repeatedly: 200 of each cycle are in the range.
    let imaged = placed.image.unwrap();
    assert_eq!([imaged.photons, imaged.other_energies], [600, 8400]);
    let energies = Energies {
        column: "ENERGY".into(),
        range: [1.0, 2.0],
    };
    let request = ImageRequest {
        energies: Some(energies),
        ..wide(&bench)
    };
    let error = bench
        .image(WITH_FIELD, &[event_table(&photons), good()], &request)
        .unwrap_err();
    assert!(error.to_string().ends_with("in.fits: EVENTS: column ENERGY: expected one of this name, found TIME, PI, X, Y, DET_ID only"), "{error}");
}

#[test]
fn a_field_is_stated_or_that_of_the_columns() {
    let bench = Bench::plain();
    let photons = some_photons(3000, 1);
    let table = event_table(&photons);
    let error = bench
        .image(PLAIN, &[table.clone(), good()], &wide(&bench))
        .unwrap_err();
    assert!(
        error
            .to_string()
            .contains("det.toml: detector.0.field: expected [[low, high] of x"),
        "{error}"
    );
    let mut stated = table;
    for (key, value) in [
        ("TLMIN3", -200),
        ("TLMAX3", 199),
        ("TLMIN4", -100),
        ("TLMAX4", 99),
    ] {
        stated = stated.with(key, Whole(value));
    }
    let mut whole = stated.clone();
    (whole.column("X").1, whole.column("Y").1) = ("1I", "1I");
    let exposed = |table: Table| {
        bench.image(PLAIN, &[table, good()], &wide(&bench)).unwrap();
        let exposure = read_image(&bench.at("image.fits"), "EXPOSURE");
        exposure.iter().sum::<f64>() * 25.0 / SECONDS as f64
    };
    let placed = bench
        .image(PLAIN, &[stated.clone(), good()], &wide(&bench))
        .unwrap();
    let inside = photons
        .iter()
        .filter(|[_, x, y, _]| (-200.0..=199.0).contains(x) && (-100.0..=99.0).contains(y));
    let imaged = placed.image.unwrap();
    assert_eq!(
        [imaged.photons, imaged.photons + imaged.invalid],
        [inside.count() as u64, 3000]
    );
    // Integer coordinates are pixels: the field is one pixel wider in each direction.
    for (table, area) in [(stated, 399.0 * 199.0), (whole, 400.0 * 200.0)] {
        let found = exposed(table);
        assert!(
            (found / area - 1.0).abs() < 0.002,
            "{found}, expected {area}"
        );
    }
}

#[test]
fn good_times_belong_to_their_detector() {
    let bench = Bench::plain();
    let photons = some_photons(2000, 2);
    let two = |first: &str, second: &str| {
        let detector = "scale_arcsec = 1.0\ncentre = [0, 0]\nrotation_deg = 0\nfield = [[-400, 400], [-400, 400]]";
        format!(
            "[[detector]]\nid = 1\n{detector}\n{first}\n[[detector]]\nid = 2\n{detector}\n{second}\n"
        )
    };
    let tables = [
        event_table(&photons),
        good_times("STDGTI01", &[[0.0, 40.0]]),
        good_times("STDGTI02", &[[50.0, 60.0]])
            .with("LIVETIME", Number(5.0))
            .with("ONTIME", Number(10.0)),
    ];
    let named = two("good_times = \"STDGTI01\"", "good_times = \"stdgti02\"");
    let imaged = bench
        .image(&named, &tables, &wide(&bench))
        .unwrap()
        .image
        .unwrap();
    let inside = photons
        .iter()
        .filter(|[s, .., id]| if *id == 1.0 { *s <= 40.0 } else { *s >= 50.0 });
    assert_eq!(imaged.photons, inside.count() as u64);
    assert!((imaged.live_s - 22.5).abs() < 1e-3, "{imaged:?}");
    for (detectors, found) in [
        (two("", ""), "none"),
        (two("good_times = \"GTI\"", ""), "\"GTI\""),
    ] {
        let error = bench
            .image(&detectors, &tables, &wide(&bench))
            .unwrap_err()
            .to_string();
        let expected = format!(
            "det.toml: detector.good_times: expected the detector's table of good time intervals (STDGTI01, STDGTI02), found {found}"
        );
        assert!(error.ends_with(&expected), "{error}");
    }
}

#[test]
fn what_makes_no_image_is_refused_and_leaves_no_file() {
    let bench = Bench::plain();
    let table = event_table(&some_photons(10, 1));
    let refused = |detectors: &str, tables: &[Table], request: &ImageRequest, why: &str| {
        let error = bench
            .image(detectors, tables, request)
            .unwrap_err()
            .to_string();
        assert!(error.contains(why), "{error}");
        assert!(!bench.at("image.fits").exists());
    };
    let large = ImageRequest {
        pixel_arcsec: 0.1,
        ..wide(&bench)
    };
    refused(
        WITH_FIELD,
        &[table.clone(), good()],
        &large,
        "image.fits: size of the image: expected 1 to 4096 px a side",
    );
    let never = good_times("GTI", &[[-100.0, -50.0]]);
    refused(
        WITH_FIELD,
        &[table.clone(), never],
        &wide(&bench),
        "image.fits: good time intervals: expected a time",
    );
    let dead = good().with("DEADC", Number(1.3));
    // A copy without an image does not need DEADC.
    bench.placed(PLAIN, &[], &[table.clone(), dead.clone()]);
    refused(
        WITH_FIELD,
        &[table.clone(), dead],
        &wide(&bench),
        "in.fits: GTI: DEADC: expected live time over good time",
    );
    let upside_down = WITH_FIELD.replace("[-400, 400], [", "[400, -400], [");
    refused(
        &upside_down,
        &[table.clone(), good()],
        &wide(&bench),
        "detector.0.field: expected [low, high] of x and of y",
    );
    let over_itself = ImageRequest {
        path: bench.at("in.fits"),
        ..wide(&bench)
    };
    let error = bench
        .image(WITH_FIELD, &[table, good()], &over_itself)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("in.fits: expected a file other than"),
        "{error}"
    );
}
