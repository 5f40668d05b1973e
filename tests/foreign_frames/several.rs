//! Files with more than one picture, with other axes, and parts of the sensor.

use super::*;

fn preview() -> Vec<u8> {
    image(EXTENSION, 8, &[320, 240], &[], vec![9; 320 * 240])
}

fn whole(first: &str) -> Vec<u8> {
    image(first, 8, &SIZE, &[], PIXELS.clone())
}

fn primary() -> Vec<u8> {
    header(&[PRIMARY, "BITPIX  = 8", "NAXIS   = 0", "EXTEND  = T"].map(String::from))
}

#[test]
fn axes_of_length_one_do_not_count() {
    for axes in [&[1296, 966, 1][..], &[1296, 966, 1, 1], &[1, 1296, 966]] {
        let frame = read(&image(PRIMARY, 8, axes, &[], PIXELS.clone()), "frame.fits");
        assert_eq!(*frame.pixels(), Pixels::U8(PIXELS.clone()), "{axes:?}");
        assert_eq!(frame.info.warnings, [], "{axes:?}");
    }
    let line = image(PRIMARY, 8, &[5, 1], &[], vec![1, 2, 3, 4, 5]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line.fits");
    fs::write(&path, line).unwrap();
    let frame = solaspect::fits::read_frame(&path).unwrap();
    assert_eq!((frame.width(), frame.height()), (5, 1));
}

#[test]
fn of_several_pictures_the_one_of_the_sensors_size_is_read_and_the_others_are_named() {
    let cube = image(
        PRIMARY,
        8,
        &[1296, 966, 2],
        &[],
        [PIXELS.clone(), vec![0; PIXELS.len()]].concat(),
    );
    let small_primary = image(PRIMARY, 8, &[320, 240], &[], vec![9; 320 * 240]);
    for (what, bytes) in [
        (
            "a preview before it",
            [primary(), preview(), whole(EXTENSION)].concat(),
        ),
        (
            "a preview as the primary picture",
            [small_primary, whole(EXTENSION)].concat(),
        ),
        ("a preview behind it", [whole(PRIMARY), preview()].concat()),
        (
            "a second frame",
            [whole(PRIMARY), whole(EXTENSION)].concat(),
        ),
        ("a cube", cube),
    ] {
        let frame = read(&bytes, "frame.fits");
        assert_eq!(*frame.pixels(), Pixels::U8(PIXELS.clone()), "{what}");
        let [warning] = frame.info.warnings.as_slice() else {
            panic!("{what}: {:?}", frame.info.warnings);
        };
        assert_eq!(warning.expected, "one picture", "{what}");
        assert!(
            warning.found.starts_with("2; read the first of 1296 x 966"),
            "{what}: {warning}"
        );
    }
}

/// The window of 640 x 600 px at (500, 200) of the sample's picture.
fn part() -> Vec<u8> {
    let rows = PIXELS.chunks_exact(1296).skip(200).take(600);
    rows.flat_map(|row| &row[500..1140]).copied().collect()
}

fn solved_part(bytes: &[u8]) -> Frame {
    let frame = read(bytes, "frame.fits");
    assert_eq!(frame.info.corner_px, Some((500, 200)));
    let seen = DEMO.seen_by(&frame).unwrap();
    let solution = aspect::solve(&frame, &seen, None, None);
    let sun = solution.aspect.unwrap().sun_px.position;
    let error = (sun.x + 500.0 - SUN_PX[0]).hypot(sun.y + 200.0 - SUN_PX[1]);
    assert!(error < 0.1, "{error} px");
    frame
}

#[test]
fn a_part_of_the_sensor_is_placed_by_whatever_keyword_names_it() {
    for cards in [
        &["CORNER-X= 500", "CORNER-Y= 200"][..],
        &["XORGSUBF= 500", "YORGSUBF= 200"],
        &["DETSEC  = '[501:1140,201:800]'"],
        &["CCDSEC  = '[501:1140, 201:800]'"],
        &["DETSEC  = '[0,0]'", "CCDSEC  = '[501:1140,201:800]'"],
    ] {
        solved_part(&image(PRIMARY, 8, &[640, 600], cards, part()));
    }
    let mut reversed = part();
    reversed.chunks_exact_mut(640).for_each(<[u8]>::reverse);
    let card = ["DETSEC  = '[1140:501,201:800]'"];
    solved_part(&image(PRIMARY, 8, &[640, 600], &card, reversed));
}

#[test]
fn a_part_of_the_sensor_without_a_place_is_refused_by_the_keywords_that_would_name_it() {
    let frame = read(&image(PRIMARY, 8, &[640, 600], &[], part()), "frame.fits");
    let message = DEMO.seen_by(&frame).unwrap_err().to_string();
    for part in ["1296 x 966", "640 x 600", "CORNER-X", "XORGSUBF", "DETSEC"] {
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn a_picture_whose_first_row_is_the_lowest_is_turned_over() {
    let upside_down: Vec<u8> = PIXELS.rchunks_exact(1296).flatten().copied().collect();
    let bytes = image(PRIMARY, 8, &SIZE, &["ROWORDER= 'BOTTOM-UP'"], upside_down);
    let frame = read(&bytes, "frame.fits");
    assert_eq!(*frame.pixels(), Pixels::U8(PIXELS.clone()));
    for (card, warnings) in [("ROWORDER= 'TOP-DOWN'", 0), ("ROWORDER= 'SIDEWAYS'", 1)] {
        let frame = read(
            &image(PRIMARY, 8, &SIZE, &[card], PIXELS.clone()),
            "frame.fits",
        );
        assert_eq!(*frame.pixels(), Pixels::U8(PIXELS.clone()));
        assert_eq!(frame.info.warnings.len(), warnings, "{card}");
    }
}
