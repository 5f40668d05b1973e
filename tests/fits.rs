//! Properties of the files: written data read back unchanged, frames of other programs are read, and a bad file gives one
//! line with its name, the field and what was expected there.

use crate::allocations::counted;
use crc::{CRC_32_ISO_HDLC, Crc};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use solaspect::fits::{
    Card, Column, Compression, FitsFile, Table, Value, Values, check_sums, keyword, read_frame,
    read_info, read_keywords, read_table, write_frame,
};
use solaspect::frame::{Frame, FrameInfo, Pixels};
use solaspect::simulate::{Conditions, RandomScenes};
use solaspect::units::Place;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tempfile::TempDir;

const FRAMES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/frames/");

/// A temporary folder.
fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn full_info() -> FrameInfo {
    FrameInfo {
        number: Some(123_456_789_012),
        mid_exposure: Some("2013-09-21T18:00:00.007500001Z".parse().unwrap()),
        utc_step: Some(jiff::SignedDuration::from_millis(-1500)),
        monotonic: Some(Duration::new(86_400, 123_456_789)),
        camera_clock: Some(Duration::new(1_379_786_400, 123_456_789)),
        exposure: Some(Duration::from_micros(15_001)),
        analogue_gain: Some(1.1),
        preamp_gain: Some(-3.0),
        camera_temperature_c: Some(-12.345_678_901_234_5),
        corner_px: Some((100, 50)),
        place: Some(Place::new(34.49, -104.2218, 38_405.0).unwrap()),
        camera: Some("PYAS-F, the pilot's".into()),
        ..FrameInfo::default()
    }
}

fn noise(seed: u64, count: usize, top: u16) -> Vec<u16> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    (0..count).map(|_| random.random_range(0..=top)).collect()
}

fn eight_bit(width: usize, height: usize) -> Frame {
    let pixels = noise(1, width * height, 255)
        .iter()
        .map(|dn| *dn as u8)
        .collect();
    Frame::new(width, height, Pixels::U8(pixels), 255, full_info()).unwrap()
}

fn twelve_bit(width: usize, height: usize) -> Frame {
    let pixels = Pixels::U16(noise(2, width * height, 4095));
    Frame::new(width, height, pixels, 4095, full_info()).unwrap()
}

fn written(folder: &TempDir, frame: &Frame, compression: Compression) -> PathBuf {
    let path = folder.path().join("frame.fits");
    write_frame(&path, frame, &[], &[], compression).unwrap();
    path
}

const COMPRESSIONS: [Compression; 3] = [Compression::Rice, Compression::Gzip, Compression::None];

mod round_trips {
    use super::*;

    #[test]
    fn every_pixel_and_every_value_reads_back_as_it_was() {
        let folder = folder();
        let info = full_info();
        let full = Pixels::U16(noise(3, 37 * 21, u16::MAX));
        let sixteen_bit = Frame::new(37, 21, full, 60_000, info).unwrap();
        for frame in [
            eight_bit(64, 48),
            twelve_bit(101, 33),
            sixteen_bit,
            eight_bit(1, 1),
        ] {
            for compression in COMPRESSIONS {
                let path = written(&folder, &frame, compression);
                assert_eq!(read_frame(&path).unwrap(), frame, "{compression:?}");
            }
        }
    }

    #[test]
    fn what_a_frame_does_not_know_stays_unknown() {
        let folder = folder();
        let pixels = Pixels::U16(vec![0, 1, 2, 4095]);
        let frame = Frame::new(2, 2, pixels, 4095, FrameInfo::default()).unwrap();
        let path = written(&folder, &frame, Compression::Rice);
        assert_eq!(read_frame(&path).unwrap(), frame);
    }

    #[test]
    fn each_hdu_carries_checksums_that_hold_and_a_flipped_bit_breaks_them() {
        let folder = folder();
        let frame = twelve_bit(64, 48);
        for compression in COMPRESSIONS {
            let path = folder.path().join("frame.fits");
            write_frame(&path, &frame, &[], &[marks()], compression).unwrap();
            let sums = check_sums(&path).unwrap();
            assert_eq!((sums.hdus, sums.guarded), (3, 3), "{compression:?}");
            let sound = fs::read(&path).unwrap();
            let mut random = Xoshiro256PlusPlus::seed_from_u64(4);
            for _ in 0..50 {
                let mut changed = sound.clone();
                let at = random.random_range(0..changed.len());
                changed[at] ^= 1 << random.random_range(0..8);
                fs::write(&path, changed).unwrap();
                // A flip in a checksum keyword's own name removes that guard, which the count shows.
                let sound = check_sums(&path).is_ok_and(|sums| sums.guarded == 3);
                assert!(!sound, "byte {at}, {compression:?}");
            }
        }
    }

    #[test]
    fn keywords_stand_beside_the_pixels_as_the_standard_names_them() {
        let folder = folder();
        let path = written(&folder, &twelve_bit(8, 8), Compression::Rice);
        let mut file = fitsio::FitsFile::open(&path).unwrap();
        let hdu = file.hdu("FRAME").unwrap();
        let text =
            |name: &str| hdu.read_key::<String>(&mut fitsio::FitsFile::open(&path).unwrap(), name);
        assert_eq!(text("DATE-AVG").unwrap(), "2013-09-21T18:00:00.007500001");
        assert_eq!(text("TIMESYS").unwrap(), "UTC");
        assert_eq!(text("BUNIT").unwrap(), "adu");
        let mut number = |name: &str| hdu.read_key::<f64>(&mut file, name).unwrap();
        assert_eq!(number("EXPTIME"), 0.015_001);
        assert_eq!(number("XPOSURE"), 0.015_001);
        assert_eq!(number("BITDEPTH"), 12.0);
        assert_eq!(number("SATURATE"), 4095.0);
        // Computed with astropy's EarthLocation from the same latitude, longitude and height.
        for (name, metres) in [
            ("OBSGEO-X", -1_300_690.005_2),
            ("OBSGEO-Y", -5_132_065.136_0),
            ("OBSGEO-Z", 3_613_124.978_7),
        ] {
            assert!((number(name) - metres).abs() < 1e-3, "{name}");
        }
    }

    fn marks() -> Table {
        let column = |name: &str, unit: &str, values| Column {
            name: name.into(),
            unit: unit.into(),
            meaning: format!("what {name} is"),
            values,
        };
        Table {
            name: "MARKS".into(),
            columns: vec![
                column("I", "", Values::Integer(vec![-7, 0, i64::MAX])),
                column("X", "pixel", Values::Float(vec![0.1, f64::NAN, -1e300])),
                column(
                    "STATE",
                    "",
                    Values::Text(vec!["used".into(), "".into(), "cut off".into()]),
                ),
            ],
        }
    }

    #[test]
    fn tables_read_back_with_names_units_and_values() {
        let folder = folder();
        let path = folder.path().join("frame.fits");
        let mut empty = marks();
        empty.name = "NONE".into();
        for column in &mut empty.columns {
            column.values = Values::Text(vec![]);
        }
        let tables = [marks(), empty];
        write_frame(&path, &eight_bit(8, 8), &[], &tables, Compression::Rice).unwrap();
        let mut file = fitsio::FitsFile::open(&path).unwrap();
        let hdu = file.hdu("MARKS").unwrap();
        let indices: Vec<i64> = hdu.read_col(&mut file, "I").unwrap();
        let positions: Vec<f64> = hdu.read_col(&mut file, "X").unwrap();
        assert_eq!(indices, [-7, 0, i64::MAX]);
        assert_eq!((positions[0], positions[2]), (0.1, -1e300));
        assert!(positions[1].is_nan());
        // fitsio 0.21 writes one byte too many when it reads strings, so their rows are read directly:
        // an integer, a float and seven characters each.
        assert_eq!(hdu.read_key::<String>(&mut file, "TFORM3").unwrap(), "7A");
        let bytes = fs::read(&path).unwrap();
        let first = bytes.windows(4).position(|text| text == b"used").unwrap();
        let texts = [0, 1, 2].map(|row| &bytes[first + 23 * row..][..7]);
        assert_eq!(texts, [b"used   ", b"       ", b"cut off"]);
        let mut text = |keyword: &str| hdu.read_key::<String>(&mut file, keyword).unwrap();
        assert_eq!(
            [text("TUNIT2"), text("TCOMM2")],
            ["pixel", "what X is"].map(String::from)
        );
        let none = file.hdu("NONE").unwrap();
        assert_eq!(none.read_key::<i64>(&mut file, "NAXIS2").unwrap(), 0);
    }

    #[test]
    fn cards_from_above_are_written_and_long_texts_survive() {
        let folder = folder();
        let path = folder.path().join("frame.fits");
        let mut frame = eight_bit(8, 8);
        frame.info.camera = Some("a name that is long ".repeat(9) + "'quoted' & so on");
        let cards = [Card::new(&keyword::INSTRUME, "pyas")];
        write_frame(&path, &frame, &cards, &[], Compression::Rice).unwrap();
        assert_eq!(read_frame(&path).unwrap(), frame);
        let keywords = read_keywords(&path).unwrap();
        assert_eq!(keywords.get("INSTRUME"), Some(&Value::from("pyas")));
    }

    #[test]
    fn cards_of_another_kind_not_finite_or_given_twice_are_refused() {
        let folder = folder();
        let path = folder.path().join("frame.fits");
        for (card, field) in [
            (
                Card::new(&keyword::INSTRUME, 1.0),
                "INSTRUME: expected Text, found 1.0",
            ),
            (
                Card::new(&keyword::SATURATE, 9_i64),
                "SATURATE: expected one value",
            ),
        ] {
            let error = write_frame(&path, &eight_bit(8, 8), &[card], &[], Compression::Rice);
            let message = error.unwrap_err().to_string();
            assert!(
                message.contains("frame.fits") && message.contains(field),
                "{message}"
            );
        }
        let mut frame = eight_bit(8, 8);
        frame.info.analogue_gain = Some(f64::NAN);
        let error = write_frame(&path, &frame, &[], &[], Compression::Rice);
        assert!(
            error
                .unwrap_err()
                .to_string()
                .contains("GAIN: expected Float, found NaN")
        );
        assert!(!path.exists());
    }

    /// The data of the second HDU: tile descriptors and tiles of a compressed image.
    fn tiles(path: &Path) -> Vec<u8> {
        let bytes = fs::read(path).unwrap();
        let headers: Vec<usize> = (0..bytes.len() / 80)
            .filter(|n| bytes[80 * n..].starts_with(b"END     "))
            .collect();
        let start = (80 * (headers[1] + 1)).next_multiple_of(2880);
        let header =
            String::from_utf8_lossy(&bytes[80 * (headers[0] + 1)..80 * headers[1]]).into_owned();
        let number = |keyword: &str| -> usize {
            let at = header.find(&format!("{keyword:<8}=")).unwrap();
            header[at + 10..at + 30].trim().parse().unwrap()
        };
        let length = number("NAXIS1") * number("NAXIS2") + number("PCOUNT");
        bytes[start..start + length].to_vec()
    }

    /// The same pixels, compressed by cfitsio.
    fn written_by_cfitsio(folder: &TempDir, frame: &Frame) -> PathBuf {
        use fitsio_sys as sys;
        let path = folder.path().join("cfitsio.fits");
        let _ = fs::remove_file(&path);
        let name = std::ffi::CString::new(path.to_str().unwrap()).unwrap();
        let mut axes = [frame.width() as std::ffi::c_long, frame.height() as _];
        let count = frame.pixels().len() as i64;
        let (mut file, mut status) = (std::ptr::null_mut(), 0);
        // SAFETY: the file is open until `ffclos`, and each pointer lives through its call with the length given to it.
        unsafe {
            sys::ffdkinit(&mut file, name.as_ptr(), &mut status);
            sys::ffcrim(file, 8, 0, std::ptr::null_mut(), &mut status);
            sys::fits_set_compression_type(file, sys::RICE_1 as _, &mut status);
            match frame.pixels() {
                Pixels::U8(pixels) => {
                    sys::ffcrim(file, sys::BYTE_IMG as _, 2, axes.as_mut_ptr(), &mut status);
                    sys::ffpprb(file, 1, 1, count, pixels.as_ptr().cast_mut(), &mut status);
                }
                Pixels::U16(pixels) => {
                    sys::ffcrim(
                        file,
                        sys::USHORT_IMG as _,
                        2,
                        axes.as_mut_ptr(),
                        &mut status,
                    );
                    sys::ffpprui(file, 1, 1, count, pixels.as_ptr().cast_mut(), &mut status);
                }
            }
            sys::ffclos(file, &mut status);
        }
        assert_eq!(status, 0);
        path
    }

    /// Pixels of different roughness: constant, slightly noisy, noisy, spiky and random rows.
    fn rough(width: usize, height: usize, top: u16) -> Vec<u16> {
        let wild = noise(3, width * height, top);
        let pixel = |n: usize| {
            let (row, dn) = (n / width, wild[n]);
            match row % 6 {
                0 => top / 3,
                1 => top / 3 + dn % 4,
                2 => top / 3 + dn % (top / 6),
                3 if dn % 37 == 0 => dn,
                3 => top / 5,
                4 => ((n % width) as u32 * u32::from(dn % 3) % (u32::from(top) + 1)) as u16,
                _ => dn,
            }
        };
        (0..width * height).map(pixel).collect()
    }

    #[test]
    fn how_a_frame_was_taken_is_read_from_its_headers_alone() {
        let folder = folder();
        for (compression, frame) in [
            (Compression::Rice, twelve_bit(64, 48)),
            (Compression::None, eight_bit(1296, 966)),
        ] {
            let path = written(&folder, &frame, compression);
            let (info, header) = read_info(&path).unwrap();
            assert_eq!(info, frame.info);
            assert_eq!(header.get("BTYPE"), Some(&"Intensity".into()));
            // If the data are cut off, the headers can still be read.
            let bytes = fs::read(&path).unwrap();
            fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
            let are_headers_whole = frame.pixels().len() > 1 << 20;
            assert!(read_info(&path).is_ok() || !are_headers_whole);
            fs::write(&path, b"SIMPLE  = nothing").unwrap();
            assert!(read_info(&path).is_err());
        }
        assert!(read_info(folder.path()).is_err());
    }

    #[test]
    fn rice_tiles_are_those_of_cfitsio_byte_for_byte() {
        let folder = folder();
        for (width, height) in [(1296, 60), (33, 48), (1, 30), (31, 12)] {
            let bytes = rough(width, height, 255).into_iter().map(|dn| dn as u8);
            for (pixels, top) in [
                (Pixels::U8(bytes.collect()), 255),
                (Pixels::U16(rough(width, height, 4095)), 4095),
                (Pixels::U16(rough(width, height, 65_535)), 65_535),
            ] {
                let frame = Frame::new(width, height, pixels, top, full_info()).unwrap();
                let ours = tiles(&written(&folder, &frame, Compression::Rice));
                let theirs = tiles(&written_by_cfitsio(&folder, &frame));
                assert!(ours == theirs, "{width} x {height}, up to {top}");
            }
        }
    }

    #[test]
    fn many_threads_at_once_do_not_disturb_each_other() {
        let folder = folder();
        std::thread::scope(|scope| {
            for n in 0..8 {
                let path = folder.path().join(format!("{n}.fits"));
                scope.spawn(move || {
                    let frame = twelve_bit(50 + n, 40);
                    for compression in COMPRESSIONS.iter().cycle().take(30) {
                        write_frame(&path, &frame, &[], &[], *compression).unwrap();
                        assert_eq!(read_frame(&path).unwrap(), frame);
                    }
                });
            }
        });
    }
}

mod frames_of_others {
    use super::*;

    /// CRC-32 of the pixels as astropy reads them (16 bit: low byte first).
    const PIXELS: [(&str, u32); 10] = [
        ("dim/frame_00000.fits", 0x201dcb4b),
        ("disturbed/frame_00000.fits", 0xc3b90b4b),
        ("heroes-layout/frame_00000.fits.gz", 0xd2b2a9bb),
        ("night/frame_00000.fits", 0xf65315ab),
        ("partial/frame_00001.fits", 0x42b8ed05),
        ("partial/frame_00003.fits", 0xc6a7bc5c),
        ("rotated/frame_00000.fits", 0x32145ea2),
        ("saturated/frame_00000.fits", 0xfabd99db),
        ("standard/frame_00000.fits", 0x1ccafe56),
        ("twelve-bit/frame_00000.fits.gz", 0x66960fc1),
    ];

    fn crc(pixels: &Pixels) -> u32 {
        let crc = Crc::<u32>::new(&CRC_32_ISO_HDLC);
        match pixels {
            Pixels::U8(p) => crc.checksum(p),
            Pixels::U16(p) => {
                let bytes: Vec<u8> = p.iter().flat_map(|dn| dn.to_le_bytes()).collect();
                crc.checksum(&bytes)
            }
        }
    }

    #[test]
    fn every_layout_gives_the_pixels_that_astropy_reads() {
        for (name, expected) in PIXELS {
            let frame = read_frame(&Path::new(FRAMES).join(name)).unwrap();
            assert_eq!((frame.width(), frame.height()), (1296, 966), "{name}");
            assert_eq!(crc(frame.pixels()), expected, "{name}");
        }
    }

    #[test]
    fn keywords_are_found_in_the_primary_header_of_every_layout() {
        for (name, _) in PIXELS {
            let info = read_frame(&Path::new(FRAMES).join(name)).unwrap().info;
            assert_eq!(info.exposure, Some(Duration::from_millis(15)), "{name}");
            let middle = info.mid_exposure.unwrap().to_string();
            assert!(middle.starts_with("2013-09-21T18:00:0"), "{name}: {middle}");
            assert!(middle.ends_with("075Z"), "{name}: {middle}");
            assert!(info.number.is_some(), "{name}");
        }
    }

    #[test]
    fn saturation_is_that_of_the_depth_where_nothing_is_said() {
        let saturation = |name: &str| {
            read_frame(&Path::new(FRAMES).join(name))
                .unwrap()
                .saturation_dn()
        };
        assert_eq!(saturation("standard/frame_00000.fits"), 255);
        assert_eq!(saturation("twelve-bit/frame_00000.fits.gz"), 4095);
    }

    #[test]
    fn the_images_keywords_go_over_the_primary_ones() {
        let primary = primary(&["EXPTIME = 0.5", "FRAMENUM= 1", "CAMTEMP = -5.5"]);
        let image = image_extension(8, [2, 1], &["EXPTIME = 0.25", "FRAMENUM= 2"], &[7, 9]);
        let frame = read_bytes(&[primary, image].concat(), "a.fits").unwrap();
        assert_eq!(frame.pixels(), &Pixels::U8(vec![7, 9]));
        assert_eq!(frame.info.exposure, Some(Duration::from_millis(250)));
        assert_eq!(frame.info.number, Some(2));
        assert_eq!(frame.info.camera_temperature_c, Some(-5.5));
    }

    #[test]
    fn mid_exposure_is_date_avg_or_else_the_start_and_half_the_exposure() {
        for (cards, expected) in [
            (
                &["DATE-OBS= '2013-09-21T18:00:00.000'", "EXPTIME = 0.015"][..],
                Some("18:00:00.0075Z"),
            ),
            (
                &["DATE-BEG= '2013-09-21T18:00:00Z'", "XPOSURE = 2"],
                Some("18:00:01Z"),
            ),
            (&["DATE-OBS= '2013-09-21T18:00:00'"], Some("18:00:00Z")),
            (
                &[
                    "DATE-OBS= '2013-09-21T18:00:00'",
                    "EXPTIME = 2",
                    "DATE-AVG= '2013-09-21T19:00:00'",
                ],
                Some("19:00:00Z"),
            ),
            (&["EXPTIME = 2"], None),
        ] {
            let frame = read_bytes(&only_image(8, [1, 1], cards, &[0]), "a.fits").unwrap();
            let middle = frame.info.mid_exposure.map(|time| time.to_string());
            assert_eq!(middle, expected.map(|time| format!("2013-09-21T{time}")));
        }
    }

    #[test]
    fn a_place_is_read_from_geocentric_metres() {
        // The position by astropy's EarthLocation for this latitude, longitude and height.
        let cards = [
            "OBSGEO-X= -1300690.00516486",
            "OBSGEO-Y= -5132065.13600597",
            "OBSGEO-Z= 3613124.97868061",
        ];
        let frame = read_bytes(&only_image(8, [1, 1], &cards, &[0]), "a.fits").unwrap();
        let place = frame.info.place.unwrap();
        assert!((place.latitude_deg - 34.49).abs() < 1e-9);
        assert!((place.longitude_deg + 104.2218).abs() < 1e-9);
        assert!((place.height_m - 38_405.0).abs() < 1e-3);
    }

    #[test]
    fn a_geodetic_place_is_read_on_the_ellipsoid_of_the_standard() {
        // The position above by wcslib: on the IAU's ellipsoid of 1976 the height is 3 m lower.
        let cards = [
            "OBSGEO-B= 34.490000",
            "OBSGEO-L= -104.221800",
            "OBSGEO-H= 38401.992",
        ];
        let frame = read_bytes(&only_image(8, [1, 1], &cards, &[0]), "a.fits").unwrap();
        let place = frame.info.place.unwrap();
        assert!((place.latitude_deg - 34.49).abs() < 1e-6);
        assert!((place.longitude_deg + 104.2218).abs() < 1e-9);
        assert!((place.height_m - 38_405.0).abs() < 0.01, "{place:?}");
    }

    #[test]
    fn sixteen_bits_are_read_with_and_without_an_offset_and_saturate_as_stated() {
        let signed = only_image(16, [2, 1], &[], &[0, 5, 0x0f, 0xff]);
        let frame = read_bytes(&signed, "a.fits").unwrap();
        assert_eq!(frame.pixels(), &Pixels::U16(vec![5, 4095]));
        assert_eq!(frame.saturation_dn(), 4095);
        for (card, saturation) in [
            ("SATURATE= 3800", 3800),
            ("BITDEPTH= 14", 16_383),
            ("BITDEPTH= 16", u16::MAX),
        ] {
            let cards = ["BZERO   = 32768", card];
            let unsigned = only_image(16, [2, 1], &cards, &[0x80, 0, 0x80, 1]);
            let frame = read_bytes(&unsigned, "a.fits").unwrap();
            assert_eq!(frame.pixels(), &Pixels::U16(vec![0, 1]));
            assert_eq!(frame.saturation_dn(), saturation);
        }
    }

    #[test]
    fn a_file_is_what_its_first_bytes_say_and_its_name_is_taken_literally() {
        let bytes = only_image(8, [1, 1], &[], &[42]);
        for name in [
            "a.dat",
            "b[1].fits",
            "c(2)+1.fits",
            "d[*,-*].fits.gz",
            "mem:",
            "-",
            "é ü.fts",
        ] {
            let frame = read_bytes(&bytes, name).unwrap();
            assert_eq!(frame.pixels(), &Pixels::U8(vec![42]), "{name}");
        }
        let folder = folder();
        let path = folder.path().join("x[0:3](+)!.fits");
        write_frame(&path, &eight_bit(4, 4), &[], &[], Compression::Rice).unwrap();
        assert_eq!(read_frame(&path).unwrap(), eight_bit(4, 4));
    }

    #[test]
    fn greyscale_pictures_are_frames() {
        let folder = folder();
        let [shallow, deep] = [noise(5, 20, 255), noise(6, 20, 4095)];
        let shallow: Vec<u8> = shallow.iter().map(|dn| *dn as u8).collect();
        for name in ["a.png", "a.tiff"] {
            let path = folder.path().join(name);
            image::GrayImage::from_raw(5, 4, shallow.clone())
                .unwrap()
                .save(&path)
                .unwrap();
            let frame = read_frame(&path).unwrap();
            assert_eq!(frame.pixels(), &Pixels::U8(shallow.clone()), "{name}");
            assert_eq!((frame.width(), frame.saturation_dn()), (5, 255));
            type Grey16 = image::ImageBuffer<image::Luma<u16>, Vec<u16>>;
            Grey16::from_raw(5, 4, deep.clone())
                .unwrap()
                .save(&path)
                .unwrap();
            let frame = read_frame(&path).unwrap();
            assert_eq!(frame.pixels(), &Pixels::U16(deep.clone()), "{name}");
            assert_eq!(frame.saturation_dn(), 4095);
            assert_eq!(frame.info, FrameInfo::default());
        }
    }
}

mod bad_files {
    use super::*;

    /// Reads bytes that are no valid frame and returns the error, which is one line with the name of the file.
    fn refusal(bytes: &[u8]) -> String {
        let message = read_bytes(bytes, "bad.fits").unwrap_err();
        assert!(message.contains("bad.fits: "), "{message}");
        assert!(!message.contains('\n'), "{message}");
        assert!(message.contains("expected"), "{message}");
        message
    }

    fn assert_refused(bytes: &[u8], parts: &[&str]) {
        let message = refusal(bytes);
        for part in parts {
            assert!(message.contains(part), "\"{part}\" in \"{message}\"");
        }
    }

    #[test]
    fn what_is_no_file_is_named_as_such() {
        let folder = folder();
        let missing = read_frame(&folder.path().join("no.fits"))
            .unwrap_err()
            .to_string();
        assert!(missing.contains("no.fits: expected to read the file, found \"No such file"));
        let directory = read_frame(folder.path()).unwrap_err().to_string();
        assert!(
            directory.ends_with("expected a regular file, found a directory"),
            "{directory}"
        );
        #[cfg(unix)]
        {
            let device = read_frame(Path::new("/dev/zero")).unwrap_err().to_string();
            assert!(
                device.ends_with("expected a regular file, found a device or pipe"),
                "{device}"
            );
        }
    }

    #[test]
    fn what_is_no_picture_is_named_as_such() {
        assert_refused(
            b"",
            &["expected a FITS, PNG, TIFF or JPEG file, found an empty file"],
        );
        assert_refused(b"SIM", &["begins with \"SIM\""]);
        let random: Vec<u8> = noise(7, 50_000, 255).iter().map(|b| *b as u8).collect();
        assert_refused(&random, &["expected a FITS, PNG, TIFF or JPEG file"]);
        assert_refused(
            &[0x1f, 0x8b, 8, 0, 1, 2, 3],
            &["expected a whole gzip file"],
        );
        assert_refused(
            b"\x89PNG\r\n\x1a\nnonsense",
            &["expected a whole PNG picture"],
        );
        assert_refused(b"II*\0nonsense", &["expected a whole TIF"]);
    }

    #[test]
    fn a_file_cut_short_anywhere_is_refused() {
        let folder = folder();
        for compression in COMPRESSIONS {
            let whole = fs::read(written(&folder, &eight_bit(100, 100), compression)).unwrap();
            for kept in [
                10,
                100,
                2000,
                2880,
                3000,
                5759,
                5760,
                6000,
                whole.len() / 2,
                whole.len() - 2880,
            ] {
                refusal(&whole[..kept]);
            }
            assert_refused(&whole[..3000], &["expected an END card", "byte 2880"]);
        }
        let plain = only_image(8, [100, 100], &[], &[1; 10_000]);
        assert_refused(
            &plain[..2880 + 9_999],
            &[
                "NAXISn: expected 10000 bytes of data",
                "found 9999 before the end",
            ],
        );
        // The padding of the last block is not part of the data.
        assert!(read_bytes(&plain[..2880 + 10_000], "a.fits").is_ok());
    }

    #[test]
    fn images_that_are_no_frames_are_refused_by_field() {
        let with = |bitpix, cards: &[&str], data: &[u8]| only_image(bitpix, [1, 1], cards, data);
        let nan = f32::NAN.to_be_bytes();
        let no_value = ["pixels: expected some pixel with a value, found none"];
        assert_refused(&with(-32, &[], &nan), &no_value);
        assert_refused(&with(16, &["BLANK   = 7"], &[0, 7]), &no_value);
        assert_refused(&with(12, &[], &[0; 4]), &["BITPIX: expected", "found 12"]);
        let scale = &["BSCALE  = 'two'"];
        assert_refused(&with(8, scale, &[0]), &["BSCALE: expected a finite number"]);
        assert_refused(&primary(&[]), &["expected an image in a FITS file"]);
    }

    #[test]
    fn axes_that_make_no_frame_are_refused() {
        let zero = only_image(8, [0, 5], &[], &[]);
        assert_refused(
            &zero,
            &["NAXIS1: expected a whole number from 1 to 65536, found 0"],
        );
        for side in [1_000_000_000, i64::MAX] {
            let huge = only_image(8, [side, side], &[], &[0]);
            assert_refused(&huge, &["NAXISn: expected", "before the end of the file"]);
        }
        let negative = only_image(8, [-1, 5], &[], &[0]);
        assert_refused(
            &negative,
            &["NAXIS1: expected a whole number from 0", "found -1"],
        );
    }

    #[test]
    fn data_that_do_not_match_their_sum_are_refused() {
        let data = only_image(16, [1, 1], &["DATASUM = '7'"], &[0; 2]);
        assert_refused(&data, &["DATASUM: expected data with the sum 7", "0"]);
    }

    /// A valid compressed file with one card replaced.
    fn compressed_with(keyword: &str, card: &str) -> Vec<u8> {
        let folder = folder();
        let mut bytes = fs::read(written(&folder, &eight_bit(64, 48), Compression::Rice)).unwrap();
        let name = format!("{keyword:<8}=");
        let at = (2880..bytes.len())
            .step_by(80)
            .find(|at| bytes[*at..].starts_with(name.as_bytes()))
            .unwrap_or_else(|| panic!("no {keyword}"));
        bytes[at..at + 80].copy_from_slice(format!("{card:<80}").as_bytes());
        bytes
    }

    #[test]
    fn a_compressed_image_that_contradicts_itself_is_refused_before_it_is_unpacked() {
        for (keyword, card, parts) in [
            (
                "ZNAXIS1",
                "ZNAXIS1 = 1000000000",
                ["ZNAXIS1: expected", "65536, found 1000000000"],
            ),
            (
                "ZNAXIS2",
                "ZNAXIS2 = 60000",
                ["NAXIS2: expected a row for each of 60000", "48 rows"],
            ),
            ("ZNAXIS1", "ZNAXIS1 = 0", ["ZNAXIS1: expected", "found 0"]),
            (
                "ZNAXIS",
                "ZNAXIS  = 3",
                ["NAXIS: expected an image with 2 axes", "found 3"],
            ),
            ("ZTILE1", "ZTILE1  = 0", ["ZTILE1: expected", "found 0"]),
            (
                "ZTILE1",
                "ZTILE1  = 99999",
                ["ZTILE1: expected", "found 99999"],
            ),
            (
                "ZVAL1",
                "ZVAL1   = 0",
                ["ZVAL1: expected a whole number from 1", "found 0"],
            ),
            (
                "ZVAL2",
                "ZVAL2   = 3",
                ["ZVAL2: expected 1, 2 or 4 bytes", "found 3"],
            ),
            (
                "ZBITPIX",
                "ZBITPIX = 12",
                ["ZBITPIX: expected 8, 16, 32, 64, -32 or -64", "found 12"],
            ),
            (
                "ZBITPIX",
                "ZBITPIX = -32",
                ["tile 1: expected a whole stream", "damaged bytes"],
            ),
            (
                "ZCMPTYPE",
                "ZCMPTYPE= 'PLIO_1'",
                ["ZCMPTYPE: expected RICE_1, GZIP_1 or GZIP_2", "PLIO_1"],
            ),
            (
                "NAXIS2",
                "NAXIS2  = 0",
                ["NAXIS2: expected a row for each of 48", "0 rows"],
            ),
            (
                "NAXIS1",
                "NAXIS1  = 800",
                ["NAXISn: expected", "before the end"],
            ),
            (
                "NAXIS1",
                "NAXIS1  = 4",
                ["NAXIS1: expected 8 bytes", "found 4"],
            ),
            (
                "TTYPE1",
                "TTYPE1  = 'OTHER'",
                ["TTYPEn: expected a column COMPRESSED_DATA", "found none"],
            ),
            (
                "TFORM1",
                "TFORM1  = '1PE(9)'",
                [
                    "TTYPEn: expected a column COMPRESSED_DATA of bytes",
                    "found none",
                ],
            ),
            (
                "TFORM1",
                "TFORM1  = '9Y'",
                ["TFORM1: expected a column", "9Y"],
            ),
            (
                "TFORM1",
                "TFORM1  = ''",
                ["TFORM1: expected a column", "''"],
            ),
        ] {
            assert_refused(&compressed_with(keyword, card), &parts);
        }
    }

    #[test]
    fn a_tile_outside_the_heap_is_refused() {
        let mut bytes = compressed_with("DATASUM", "COMMENT");
        let table = table_start(&bytes);
        bytes[table + 16..table + 20].copy_from_slice(&[0x7f, 0xff, 0xff, 0xff]);
        assert_refused(
            &bytes,
            &[
                "tile 3: expected data within the heap",
                "2147483647 bytes at byte",
            ],
        );
    }

    #[test]
    fn a_table_with_fewer_rows_than_its_keyword_says_is_refused() {
        let cards = [
            "PCOUNT  = 7",
            "THEAP   = 8",
            "TFIELDS = 1",
            "TTYPE1  = 'COMPRESSED_DATA'",
            "TFORM1  = '1PB'",
            "ZIMAGE  = T",
            "ZBITPIX = 8",
            "ZNAXIS  = 2",
            "ZNAXIS1 = 40",
            "ZNAXIS2 = 30",
            "ZCMPTYPE= 'RICE_1'",
            "ZNAME1  = 'BYTEPIX'",
            "ZVAL1   = 1",
        ];
        // Only one axis counts, so there is one row of 8 bytes.
        let mut header = vec![
            "XTENSION= 'BINTABLE'",
            "BITPIX  = 8",
            "NAXIS   = 1",
            "NAXIS1  = 8",
            "NAXIS2  = 30",
            "GCOUNT  = 1",
        ];
        header.extend(cards);
        let data = [0, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        let file = [primary(&[]), self::header(&header), blocks(&data)].concat();
        assert_refused(&file, &["NAXISn: expected 30 rows of 8 bytes", "15 bytes"]);
    }

    #[test]
    fn tiles_that_all_share_a_long_stream_are_refused() {
        let mut bytes = compressed_with("DATASUM", "COMMENT");
        let table = table_start(&bytes);
        // Each of the 48 tiles claims the longest stream that fits into the heap.
        let heap = bytes.len() - 2880 - table - 48 * 8;
        for row in 0..48 {
            let descriptor = &mut bytes[table + 8 * row..][..8];
            descriptor[..4].copy_from_slice(&(heap as u32).to_be_bytes());
            descriptor[4..].copy_from_slice(&[0; 4]);
        }
        assert_refused(&bytes, &["COMPRESSED_DATA: expected tiles of at most"]);
    }

    #[test]
    fn a_plain_image_whose_data_are_not_its_pixels_is_refused_before_it_is_allocated() {
        let large = only_image(16, [8192, 8192], &["BZERO   = 32768", "GCOUNT  = 0"], &[]);
        let (read, [_, memory]) = counted(|| read_bytes(&large, "promises.fits"));
        let message = read.unwrap_err();
        assert!(
            message.contains("GCOUNT: expected 134217728 bytes of 8192 x 8192 pixels, found 0"),
            "{message}"
        );
        assert!(memory < 1 << 20, "{memory} bytes");
    }

    #[test]
    fn damaged_data_are_refused_by_their_sum_and_a_stream_cut_short_by_its_tile() {
        let folder = folder();
        let path = written(&folder, &eight_bit(64, 48), Compression::Rice);
        let mut bytes = fs::read(&path).unwrap();
        let last = bytes.len() - 2880;
        bytes[last] ^= 1;
        assert_refused(&bytes, &["DATASUM: expected data with the sum"]);
        // The first tile's descriptor gets a length of 9 bytes.
        let mut bytes = compressed_with("DATASUM", "COMMENT");
        let table = table_start(&bytes);
        bytes[table..table + 4].copy_from_slice(&[0, 0, 0, 9]);
        assert_refused(
            &bytes,
            &["tile 1: expected a whole stream of 64 pixels", "9 damaged"],
        );
    }

    /// Offset of the first extension's data in the file.
    fn table_start(bytes: &[u8]) -> usize {
        let mut cards = (2880..bytes.len()).step_by(80);
        let end = cards.find(|at| bytes[*at..].starts_with(b"END     "));
        (end.unwrap() + 80).next_multiple_of(2880)
    }

    /// The file without DATASUM cards, so that changed data reach the decoder.
    fn without_sums(file: &[u8]) -> Vec<u8> {
        let mut bytes = file.to_vec();
        for card in bytes.chunks_exact_mut(80) {
            if card.starts_with(b"DATASUM ") {
                card[..8].copy_from_slice(b"COMMENT ");
            }
        }
        bytes
    }

    /// Limit on the bytes allocated while reading: a row of tiles, one tile and the pixels, for the largest possible compression ratio.
    fn most_memory(file: &[u8]) -> usize {
        (1 << 20) + file.len() * 1100 * (4 + 4 + 2)
    }

    #[test]
    fn a_file_with_any_bytes_changed_is_a_frame_or_one_line_and_takes_no_memory_that_its_size_does_not_warrant()
     {
        let folder = folder();
        let mut random = Xoshiro256PlusPlus::seed_from_u64(8);
        for compression in COMPRESSIONS {
            for frame in [eight_bit(40, 30), twelve_bit(40, 30)] {
                let sound = fs::read(written(&folder, &frame, compression)).unwrap();
                let unguarded = without_sums(&sound);
                for n in 0..1000 {
                    let mut bytes = if n % 2 == 0 { &sound } else { &unguarded }.clone();
                    for _ in 0..random.random_range(1..20) {
                        let at = random.random_range(0..bytes.len());
                        bytes[at] = random.random();
                    }
                    let (read, [_, memory]) = counted(|| read_bytes(&bytes, "changed.fits"));
                    assert!(memory <= most_memory(&bytes), "{memory} bytes");
                    let on_demand = read_on_demand(&bytes, "changed.fits");
                    match (read, on_demand) {
                        (Ok(frame), on_demand) => assert_eq!(on_demand, Ok(frame)),
                        (Err(message), on_demand) => {
                            assert!(message.contains("changed.fits: "), "{message}");
                            assert!(!message.contains('\n'), "{message}");
                            assert!(on_demand.is_err(), "{message}");
                        }
                    }
                }
            }
        }
    }
}

mod rows_on_demand {
    use super::*;
    use solaspect::aspect::{Expected, solve};
    use solaspect::instrument::builtin;

    #[test]
    fn a_frame_whose_rows_are_decoded_on_demand_has_the_same_solution() {
        let instrument = builtin("demo").unwrap();
        let conditions = Conditions::of(&instrument);
        let scenes = RandomScenes::new(&instrument, &conditions, 4).unwrap();
        let folder = folder();
        for n in 0..4 {
            let frame = scenes.scene(n).unwrap().frame().unwrap();
            let solution = |frame: &Frame| {
                let expected = frame.info.mid_exposure.and_then(Expected::at);
                format!("{:?}", solve(frame, &instrument, expected, None))
            };
            for compression in COMPRESSIONS {
                let path = written(&folder, &frame, compression);
                let on_demand = FitsFile::open(&path).unwrap().with_frame(solution).unwrap();
                assert_eq!(on_demand, solution(&read_frame(&path).unwrap()));
            }
        }
    }

    #[test]
    fn a_damaged_row_that_no_sum_shows_is_an_error_where_it_is_read() {
        let folder = folder();
        let path = written(&folder, &eight_bit(64, 48), Compression::Rice);
        let mut bytes = fs::read(&path).unwrap();
        let table = (2880..bytes.len()).step_by(80);
        let mut ends = table.filter(|at| bytes[*at..].starts_with(b"END     "));
        let descriptors = (ends.next().unwrap() + 80).next_multiple_of(2880);
        // Row 10 loses what row 20 gains, so the sum of all words is unchanged.
        for (row, change) in [(10, -40), (20, 40)] {
            let length = &mut bytes[descriptors + 8 * row..][..4];
            let changed = i32::from_be_bytes(length.try_into().unwrap()) + change;
            length.copy_from_slice(&changed.to_be_bytes());
        }
        fs::write(&path, &bytes).unwrap();
        let read = |row: usize| {
            let file = FitsFile::open(&path).unwrap();
            file.with_frame(|frame| frame.row_dn(row, 0..64).len())
        };
        assert_eq!(read(9).unwrap(), 64);
        let message = read(10).unwrap_err().to_string();
        assert!(
            message.contains("tile 11: expected a whole stream of 64 pixels"),
            "{message}"
        );
        assert_eq!(read_frame(&path).unwrap_err().to_string(), message);
    }
}

mod tables {
    use super::*;

    /// A file with a binary table named MARKS: rows and row length as the header states them, forms of the columns, further
    /// cards, data.
    fn file(rows: i64, row_bytes: i64, forms: &[&str], cards: &[&str], data: &[u8]) -> Vec<u8> {
        let mut own: Vec<String> = [
            "XTENSION= 'BINTABLE'",
            "BITPIX  = 8",
            "NAXIS   = 2",
            &format!("NAXIS1  = {row_bytes}"),
            &format!("NAXIS2  = {rows}"),
            "PCOUNT  = 0",
            "GCOUNT  = 1",
            &format!("TFIELDS = {}", forms.len()),
            "EXTNAME = 'MARKS   '",
        ]
        .map(String::from)
        .into();
        for (n, form) in (1..).zip(forms) {
            own.push(format!("TTYPE{n}  = 'C{n}'"));
            own.push(format!("TFORM{n}  = '{form}'"));
        }
        let own: Vec<&str> = own.iter().map(String::as_str).collect();
        let table = header(&[&own, cards].concat());
        [primary(&[]), table, blocks(data)].concat()
    }

    fn read(bytes: &[u8]) -> Result<Option<Table>, String> {
        let folder = folder();
        let path = folder.path().join("table.fits");
        fs::write(&path, bytes).unwrap();
        read_table(&path, "MARKS").map_err(|error| error.to_string())
    }

    fn columns(bytes: &[u8]) -> Vec<Column> {
        read(bytes).unwrap().unwrap().columns
    }

    #[track_caller]
    fn assert_refused(bytes: &[u8], message: &str) {
        let error = read(bytes).unwrap_err();
        assert!(
            error.ends_with(&format!("table.fits: {message}")),
            "{error}"
        );
    }

    #[test]
    fn a_table_that_was_written_is_read_with_units_not_a_number_and_texts() {
        let folder = folder();
        let path = folder.path().join("frame.fits");
        let column = |name: &str, unit: &str, values| Column {
            name: name.into(),
            unit: unit.into(),
            meaning: format!("what {name} is"),
            values,
        };
        let texts = ["used", "", "cut off"].map(String::from);
        let written = Table {
            name: "MARKS".into(),
            columns: vec![
                column("I", "", Values::Integer(vec![-7, 0, i64::MIN])),
                column("X", "pixel", Values::Float(vec![0.1, 1e-300, -1e300])),
                column("STATE", "", Values::Text(texts.into())),
            ],
        };
        let mut unknown = written.clone();
        unknown.name = "UNKNOWN".into();
        unknown.columns = vec![column("X", "pixel", Values::Float(vec![f64::NAN]))];
        for compression in COMPRESSIONS {
            let tables = [unknown.clone(), written.clone()];
            write_frame(&path, &eight_bit(8, 8), &[], &tables, compression).unwrap();
            let file = FitsFile::open(&path).unwrap();
            assert_eq!(file.table("MARKS").unwrap().as_ref(), Some(&written));
            assert_eq!(file.table("LIMB").unwrap(), None);
            let unknown = file.table("UNKNOWN").unwrap().unwrap();
            assert_eq!(unknown.columns[0].unit, "pixel");
            let Values::Float(values) = &unknown.columns[0].values else {
                panic!("{unknown:?}");
            };
            assert!(values.len() == 1 && values[0].is_nan());
        }
    }

    #[test]
    fn a_compressed_picture_is_no_table() {
        let folder = folder();
        let path = written(&folder, &eight_bit(8, 8), Compression::Rice);
        assert_eq!(read_table(&path, "FRAME").unwrap(), None);
    }

    #[test]
    fn numbers_of_every_width_are_read_with_their_signs() {
        let row = [
            &[200u8][..],
            &(-2i16).to_be_bytes(),
            &(-3i32).to_be_bytes(),
            &i64::MIN.to_be_bytes(),
            &1.5f32.to_be_bytes(),
            &(-0.1f64).to_be_bytes(),
        ]
        .concat();
        let file = file(1, 27, &["B", "1I", "J", "1K", "E", "1D"], &[], &row);
        let values: Vec<Values> = columns(&file).into_iter().map(|c| c.values).collect();
        let integers = [200, -2, -3, i64::MIN].map(|n| Values::Integer(vec![n]));
        let floats = [1.5, -0.1].map(|n| Values::Float(vec![n]));
        assert_eq!(values, [&integers[..], &floats].concat());
    }

    #[test]
    fn a_text_ends_at_a_nul_and_what_no_header_may_hold_is_a_question_mark() {
        let file = file(3, 4, &["4A"], &[], b"a\0bc  d  x\x1by");
        let expected = ["a", "  d", " x?y"].map(String::from);
        assert_eq!(columns(&file)[0].values, Values::Text(expected.into()));
    }

    #[test]
    fn columns_that_are_no_numbers_or_texts_are_refused_by_field() {
        for form in [
            "",
            "2D",
            "0A",
            "2L",
            "1PB(9)",
            "X",
            "99999999999999999999A",
            "?",
        ] {
            let message = format!(
                "MARKS: TFORM2: expected one number (B, I, J, K, E or D), a truth (L) or a text (A), found '{form}'"
            );
            assert_refused(&file(1, 9, &["1K", form], &[], &[0; 9]), &message);
        }
        assert_refused(
            &file(1, 8, &["1K"], &["TZERO1  = 32768"], &[0; 8]),
            "MARKS: TZERO1: expected 0, found 32768",
        );
        assert_refused(
            &file(1, 7, &["1K"], &[], &[0; 8]),
            "MARKS: NAXIS1: expected 8 bytes, as the columns need, found 7",
        );
    }

    #[test]
    fn what_a_hostile_header_promises_is_not_allocated() {
        let forms = ["1K"];
        for (rows, row_bytes) in [(i64::MAX, 8), (1 << 40, 8), (i64::MAX, 0), (1 << 40, 0)] {
            assert!(read(&file(rows, row_bytes, &forms, &[], &[0; 8])).is_err());
        }
        let none = file(i64::MAX, 0, &[], &[], &[]);
        assert_eq!(columns(&none), []);
        // With a single axis the size of the file does not bound the number of rows.
        let mut one_axis = file(1_000_000, 8, &forms, &[], &[0; 8]);
        let at = one_axis
            .windows(10)
            .rposition(|w| w == b"NAXIS   = ")
            .unwrap();
        one_axis[at + 10] = b'1';
        assert_refused(
            &one_axis,
            "MARKS: NAXIS2: expected at most 1 rows of 8 bytes, found 1000000",
        );
        let many = vec![b'x'; (1 << 22) + 1];
        assert_refused(
            &file(many.len() as i64, 1, &["A"], &[], &many),
            "MARKS: NAXIS2: expected at most 4194304 rows of 1 bytes, found 4194305",
        );
    }

    #[test]
    fn a_table_with_any_bytes_changed_is_a_table_or_one_line() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(9);
        let sound = file(9, 21, &["1K", "5A", "1D"], &[], &[7; 189]);
        for _ in 0..1000 {
            let mut bytes = sound.clone();
            for _ in 0..random.random_range(1..8) {
                let at = random.random_range(2880..3840);
                bytes[at] = random.random_range(b' '..=b'~');
            }
            if let Err(message) = read(&bytes) {
                assert!(
                    message.contains("table.fits: ") && !message.contains('\n'),
                    "{message}"
                );
            }
        }
    }
}

/// As [`read_bytes`], but each row is read on demand.
fn read_on_demand(bytes: &[u8], name: &str) -> Result<Frame, String> {
    let folder = folder();
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    let read = FitsFile::open(&path).and_then(|file| {
        file.with_frame(|frame| {
            frame.pixels();
            frame.clone()
        })
    });
    read.map_err(|error| error.to_string())
}

/// Reads a file with these bytes under this name; an error is returned as its text.
fn read_bytes(bytes: &[u8], name: &str) -> Result<Frame, String> {
    let folder = folder();
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    read_frame(&path).map_err(|error| error.to_string())
}

/// A header with these cards and END, padded to whole blocks. Built by hand, so that invalid ones can be made.
fn header(cards: &[&str]) -> Vec<u8> {
    let mut bytes: Vec<u8> = cards
        .iter()
        .chain(&["END"])
        .flat_map(|card| format!("{card:<80}").into_bytes())
        .collect();
    bytes.resize(bytes.len().next_multiple_of(2880), b' ');
    bytes
}

fn blocks(data: &[u8]) -> Vec<u8> {
    let mut bytes = data.to_vec();
    bytes.resize(bytes.len().next_multiple_of(2880), 0);
    bytes
}

/// A primary HDU without data.
fn primary(cards: &[&str]) -> Vec<u8> {
    header(
        &[
            &["SIMPLE  = T", "BITPIX  = 8", "NAXIS   = 0", "EXTEND  = T"],
            cards,
        ]
        .concat(),
    )
}

/// An HDU with an image; its header begins with the card `first`.
fn image_hdu(first: &str, bitpix: i32, sides: [i64; 2], cards: &[&str], data: &[u8]) -> Vec<u8> {
    let [bitpix, width, height] = [
        format!("BITPIX  = {bitpix}"),
        format!("NAXIS1  = {}", sides[0]),
        format!("NAXIS2  = {}", sides[1]),
    ];
    let own = [first, &bitpix, "NAXIS   = 2", &width, &height];
    [header(&[&own, cards].concat()), blocks(data)].concat()
}

fn image_extension(bitpix: i32, sides: [i64; 2], cards: &[&str], data: &[u8]) -> Vec<u8> {
    image_hdu("XTENSION= 'IMAGE   '", bitpix, sides, cards, data)
}

/// A file whose primary HDU has the image.
fn only_image(bitpix: i32, sides: [i64; 2], cards: &[&str], data: &[u8]) -> Vec<u8> {
    image_hdu("SIMPLE  = T", bitpix, sides, cards, data)
}
