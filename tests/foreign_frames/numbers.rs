//! Pixels as stored by other programs.

use super::*;

#[test]
fn numbers_of_every_kind_give_the_same_sun() {
    let physical = |dn: u8| 0.001 * f32::from(dn) - 0.02;
    for (what, bytes) in [
        (
            "float32",
            sample(-32, &[], |_, dn| physical(dn).to_be_bytes()),
        ),
        (
            "float64",
            sample(-64, &[], |_, dn| f64::from(physical(dn)).to_be_bytes()),
        ),
        (
            "whole float32",
            sample(-32, &[], |_, dn| f32::from(dn).to_be_bytes()),
        ),
        (
            "int32",
            sample(32, &[], |_, dn| i32::from(dn).to_be_bytes()),
        ),
        (
            "int64",
            sample(64, &[], |_, dn| (1000 * i64::from(dn)).to_be_bytes()),
        ),
        (
            "dark-subtracted int16",
            sample(16, &[], |_, dn| (i16::from(dn) - 7).to_be_bytes()),
        ),
        (
            "uint32",
            sample(32, &["BZERO   = 2147483648"], |_, dn| {
                (i32::from(dn) + i32::MIN).to_be_bytes()
            }),
        ),
        (
            "scaled",
            sample(16, &["BSCALE  = 0.25", "BZERO   = 10"], |_, dn| {
                i16::from(dn).to_be_bytes()
            }),
        ),
        ("signed bytes", sample(8, &["BZERO   = -128"], |_, dn| [dn])),
    ] {
        let frame = read(&bytes, "frame.fits");
        assert_solved(&frame, what);
    }
}

#[test]
fn whole_numbers_that_fit_are_the_pixels_themselves() {
    for (what, bytes) in [
        (
            "float32",
            sample(-32, &[], |_, dn| f32::from(dn).to_be_bytes()),
        ),
        (
            "int32",
            sample(32, &[], |_, dn| i32::from(dn).to_be_bytes()),
        ),
        (
            "blank",
            sample(16, &["BLANK   = -32768"], |_, dn| {
                i16::from(dn).to_be_bytes()
            }),
        ),
    ] {
        let frame = read(&bytes, "frame.fits");
        let expected = PIXELS.iter().map(|dn| u16::from(*dn)).collect();
        assert_eq!(*frame.pixels(), Pixels::U16(expected), "{what}");
        assert_eq!(frame.info.warnings, [], "{what}");
    }
    let blank = read(&sample(8, &["BLANK   = 255"], |_, dn| [dn]), "frame.fits");
    assert_eq!(*blank.pixels(), Pixels::U8(PIXELS.clone()));
}

/// Whether a pixel has no value: every 401st of the picture, 3,122 in all, also at the limb and the marks.
fn is_hit(n: usize) -> bool {
    n.is_multiple_of(401)
}

#[test]
fn pixels_without_a_value_are_masked_and_counted() {
    let hit = (0..PIXELS.len()).filter(|n| is_hit(*n)).count();
    let nan = |n, dn: u8| if is_hit(n) { f32::NAN } else { f32::from(dn) };
    let minus = |n, dn: u8| if is_hit(n) { -32_768 } else { i16::from(dn) };
    let vast = |n: usize, dn: u8| {
        if n.is_multiple_of(40_009) {
            1e30
        } else {
            f32::from(dn)
        }
    };
    for (what, count, bytes) in [
        (
            "not a number",
            hit,
            sample(-32, &[], |n, dn| nan(n, dn).to_be_bytes()),
        ),
        (
            "BLANK",
            hit,
            sample(16, &["BLANK   = -32768"], |n, dn| {
                minus(n, dn).to_be_bytes()
            }),
        ),
        (
            "impossible",
            32,
            sample(-32, &[], |n, dn| vast(n, dn).to_be_bytes()),
        ),
        (
            "infinite",
            hit,
            sample(-64, &[], |n, dn| {
                (f64::from(dn) / if is_hit(n) { 0.0 } else { 1.0 }).to_be_bytes()
            }),
        ),
    ] {
        let frame = read(&bytes, "frame.fits");
        assert_solved(&frame, what);
        let masked: usize = (0..SIZE[1])
            .filter_map(|y| frame.unusable(y, 0, SIZE[0]))
            .map(|row| row.iter().filter(|unusable| **unusable).count())
            .sum();
        assert_eq!(masked, count, "{what}");
        let warning = &frame.info.warnings[0];
        assert_eq!(warning.field, "pixels", "{what}");
        assert!(warning.found.starts_with(&format!("{count} ")), "{warning}");
    }
}

#[test]
fn blank_columns_and_rows_over_the_sun_leave_it_where_it_is() {
    let [x, y] = SUN_PX.map(|at| at as usize);
    let is_blank = |n: usize| n % SIZE[0] == x + 40 || (y + 20..y + 23).contains(&(n / SIZE[0]));
    let value = |n, dn: u8| if is_blank(n) { f32::NAN } else { f32::from(dn) };
    let frame = read(
        &sample(-32, &[], |n, dn| value(n, dn).to_be_bytes()),
        "frame.fits",
    );
    assert_solved(&frame, "a blank column and three blank rows");
}

#[test]
fn pixels_win_against_a_header_that_contradicts_them() {
    let left_aligned = |_, dn: u8| (u16::from(dn) << 8).wrapping_add(0x8000).to_be_bytes();
    for card in ["BITDEPTH= 12", "SATURATE= 255", "SATURATE= 4095"] {
        let bytes = sample(16, &["BZERO   = 32768", card], left_aligned);
        let frame = read(&bytes, "frame.fits");
        assert_solved(&frame, card);
        let warning = &frame.info.warnings[0];
        assert_eq!(warning.field, &card[..8]);
        assert!(warning.found.contains("beside a pixel of"), "{warning}");
        assert_eq!(
            frame.saturation_dn(),
            0xFF00,
            "left-aligned numbers end there"
        );
    }
}

/// Pixels of a file's second HDU, read by cfitsio.
fn read_by_cfitsio(path: &Path) -> Vec<f32> {
    let mut file = fitsio::FitsFile::open(path).unwrap();
    let hdu = file.hdu(1).unwrap();
    hdu.read_image(&mut file).unwrap()
}

/// Writes values compressed by cfitsio.
fn write_by_cfitsio(
    path: &Path,
    values: &[f32],
    sides: [usize; 2],
    compression: i32,
    dither: i32,
    quantise: f32,
) {
    use fitsio_sys as sys;
    let _ = fs::remove_file(path);
    let name = std::ffi::CString::new(path.to_str().unwrap()).unwrap();
    let mut axes = sides.map(|side| side as std::ffi::c_long);
    let (mut file, mut status) = (std::ptr::null_mut(), 0);
    let mut values = values.to_vec();
    let nul = -9999.0;
    // SAFETY: the file is open until `ffclos`, and each pointer lives through its call with the length given to it.
    unsafe {
        sys::ffdkinit(&mut file, name.as_ptr(), &mut status);
        sys::ffcrim(file, 8, 0, std::ptr::null_mut(), &mut status);
        sys::fits_set_compression_type(file, compression, &mut status);
        sys::fits_set_quantize_level(file, quantise, &mut status);
        if dither != 0 {
            sys::fits_set_quantize_method(file, dither, &mut status);
            sys::fits_set_dither_seed(file, 77, &mut status);
        }
        sys::ffcrim(file, sys::FLOAT_IMG, 2, axes.as_mut_ptr(), &mut status);
        sys::ffppne(
            file,
            1,
            1,
            values.len() as i64,
            values.as_mut_ptr(),
            nul,
            &mut status,
        );
        sys::ffclos(file, &mut status);
    }
    assert_eq!(status, 0);
}

#[test]
fn compressed_floats_have_the_values_that_cfitsio_reads() {
    use fitsio_sys as sys;
    const SIDES: [usize; 2] = [160, 120];
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("float.fits");
    let mut random = <rand_xoshiro::Xoshiro256PlusPlus as rand::SeedableRng>::seed_from_u64(46);
    let mut values: Vec<f32> = (0..SIDES[0] * SIDES[1])
        .map(|n| (n % 160) as f32 + rand::RngExt::random_range(&mut random, -5.0..5.0))
        .collect();
    values[1000..1010].fill(-9999.0);
    values[2000..2050].fill(0.0);
    // A row without noise, which cannot be quantised.
    values[4000..4160].fill(3.25);
    let (rice, gzip, gzip2) = (sys::RICE_1 as i32, sys::GZIP_1 as i32, sys::GZIP_2 as i32);
    let dithers = [
        sys::NO_DITHER,
        sys::SUBTRACTIVE_DITHER_1 as i32,
        sys::SUBTRACTIVE_DITHER_2 as i32,
    ];
    let mut cases = vec![(gzip, 0, 0.0), (gzip2, 0, 0.0)];
    for compression in [rice, gzip, gzip2] {
        cases.extend(dithers.map(|dither| (compression, dither, 4.0)));
    }
    for (compression, dither, quantise) in cases {
        let what = format!("compression {compression}, dither {dither}, quantised by {quantise}");
        write_by_cfitsio(&path, &values, SIDES, compression, dither, quantise);
        let expected = read_by_cfitsio(&path);
        let frame = solaspect::fits::read_frame(&path).unwrap();
        // Pixels that were written without a value have none, whatever cfitsio returns for them.
        let has_value = |n: usize| !(1000..1010).contains(&n);
        let finite = || {
            let values = expected.iter().copied().enumerate();
            values
                .filter(|(n, _)| has_value(*n))
                .map(|(_, value)| value)
        };
        let (least, most) = (
            finite().fold(f32::INFINITY, f32::min),
            finite().fold(f32::NEG_INFINITY, f32::max),
        );
        let step = (most - least) / 65_535.0;
        let mut masked = 0;
        for (n, value) in expected.iter().enumerate() {
            let (x, y) = (n % SIDES[0], n / SIDES[0]);
            if !has_value(n) {
                masked += 1;
                assert!(frame.unusable(y, x, x + 1).unwrap()[0], "{what}: pixel {n}");
                continue;
            }
            let read = least + step * frame.dn(x, y);
            assert!(
                (read - value).abs() <= step,
                "{what}: {read} for {value} at pixel {n}, {least} to {most}, {:?}",
                frame.info.warnings
            );
        }
        assert_eq!(masked, 10, "{what}");
    }
}
