use super::context::Context;
use super::*;
use crate::pointing::HelioprojectiveArcsec;
use crate::pointing_history::{Basis, Second, State};
use crate::report::Colour;
use image::codecs::png::PngDecoder;
use image::{AnimationDecoder, Rgb};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, UnitVector3, Vector3};
use std::fs::{self, File};
use std::io::BufReader;
use std::path::Path;
use tempfile::TempDir;

/// 2013-09-21T18:00:00Z.
const START_S: i64 = 1_379_786_400;
/// The Sun's radius that day, from the distance by JPL's Horizons, 1.0040 au.
const RADIUS_ARCSEC: f64 = 955.6;
const LENGTH_S: i64 = 20;
const TARGET: HelioprojectiveArcsec = HelioprojectiveArcsec {
    x: 320.0,
    y: -190.0,
};

/// The path of the flight below.
fn place(since_s: f64) -> HelioprojectiveArcsec {
    HelioprojectiveArcsec {
        x: 300.0 + 2.0 * since_s,
        y: -200.0 + since_s,
    }
}

/// A flight of 20 s whose last 4 s are contradicted.
fn pointing() -> PointingHistory {
    let to_sun = UnitVector3::new_normalize(Vector3::new(-0.31, -0.62, 0.72));
    let north = Vector3::z() - to_sun.into_inner() * to_sun.z;
    let north = UnitVector3::new_normalize(north);
    let sun = Matrix3::from_columns(&[*to_sun, to_sun.cross(&north), *north]);
    let state = |n: i64| {
        let since_s = n as f64 / 4.0;
        let forward = sun * place(since_s).direction();
        let right = forward.cross(&north).normalize();
        let axes = Matrix3::from_columns(&[forward, right, forward.cross(&right)]);
        let axes = Rotation3::from_matrix_unchecked(axes);
        State {
            unix_s: START_S as f64 + since_s,
            attitude: UnitQuaternion::from_rotation_matrix(&axes),
            rate_rad_s: Vector3::zeros(),
            covariance_rad2: Matrix3::identity() * 1e-12,
            basis: Basis::Sun,
            is_contradicted: since_s > 16.0,
        }
    };
    let second = |n: i64| Second {
        unix_s: START_S + n,
        position_m: Vector3::new(-1_302_000.0, -5_137_000.0, 3_617_000.0),
        to_sun,
        north,
        systematic_rad2: Matrix3::zeros(),
    };
    let states = (0..=4 * LENGTH_S).map(state).collect();
    PointingHistory::new(states, (0..=LENGTH_S + 1).map(second).collect())
}

/// One frame a second, all but the first unreadable.
struct OneFrame;

impl Frames for OneFrame {
    fn nearest(&self, unix_s: f64, _: f64) -> Option<usize> {
        Some((unix_s - START_S as f64) as usize)
    }

    fn overlay(&self, frame: usize) -> Result<RgbImage, String> {
        match frame {
            0 => Ok(RgbImage::from_pixel(1500, 900, Rgb([9, 99, 199]))),
            _ => Err("frame.fits: expected a readable file, found none".into()),
        }
    }
}

fn film(folder: &TempDir, name: &str, step_s: Option<f64>, has_frames: bool) -> (PathBuf, Made) {
    let path = folder.path().join(name);
    let options = Options {
        destination: path.to_str().unwrap().parse().unwrap(),
        step_s,
        context: None,
        has_frames,
    };
    let mut flight = Flight {
        title: "test".into(),
        label: None,
        pointing: &pointing(),
        target: Target::Fixed(TARGET),
        ephemeris: Ephemeris::default(),
        frame_step_s: 1.0,
        frames: &OneFrame,
    };
    let made = Film::new(&options).unwrap().make(&mut flight, &());
    (path, made.unwrap().unwrap())
}

fn picture(folder: &Path, number: usize) -> RgbImage {
    let path = folder.join(format!("film_{number:05}.png"));
    image::open(path).unwrap().into_rgb8()
}

/// The mean position of a colour on the map, without the inset in its upper left corner.
fn mean_px(picture: &RgbImage, Colour(red, green, blue): Colour) -> Option<[f64; 2]> {
    let on_map = |x: u32, y: u32| y < 720 && x < 720 && (x >= 240 || y >= 240);
    let of_colour = picture
        .enumerate_pixels()
        .filter(|(x, y, pixel)| on_map(*x, *y) && pixel.0 == [red, green, blue]);
    let places: Vec<[f64; 2]> = of_colour.map(|(x, y, _)| [x.into(), y.into()]).collect();
    let mean = |axis: usize| {
        let all: f64 = places.iter().map(|place| place[axis]).sum();
        all / places.len() as f64
    };
    (!places.is_empty()).then(|| [mean(0), mean(1)])
}

#[test]
fn the_boresight_is_drawn_where_it_points_in_each_picture_of_the_step() {
    let folder = tempfile::tempdir().unwrap();
    let (path, made) = film(&folder, "pictures", None, false);
    assert_eq!((made.pictures, made.step_s), (21, 1.0));
    assert_eq!(fs::read_dir(&path).unwrap().count(), 21);
    // The map is 2.4 radii wide and high.
    let arcsec_per_px = 2.4 * RADIUS_ARCSEC / 720.0;
    for since_s in 0..=20 {
        let picture = picture(&path, since_s + 1);
        assert_eq!(picture.dimensions(), (720, 810));
        let found = mean_px(&picture, panel::BORESIGHT);
        if since_s >= 16 {
            assert_eq!(found, None, "pointing that is not valid is grey");
            continue;
        }
        let [x, y] = found.unwrap();
        let place = place(since_s as f64);
        let expected = [
            359.5 + place.x / arcsec_per_px,
            359.5 - place.y / arcsec_per_px,
        ];
        let off = (x - expected[0]).hypot(y - expected[1]);
        assert!(off < 0.8, "{since_s} s: ({x}, {y}), expected {expected:?}");
    }
    // A film that is made again replaces the previous one.
    film(&folder, "pictures", Some(10.0), false);
    assert_eq!(fs::read_dir(&path).unwrap().count(), 3);
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        1,
        "parts are left"
    );
}

#[test]
fn gif_and_apng_hold_the_same_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let (path, _) = film(&folder, "pictures", Some(5.0), true);
    let last = picture(&path, 5);
    assert_eq!(last.dimensions(), (1460, 810));
    let (path, _) = film(&folder, "film.apng", Some(5.0), true);
    let file = BufReader::new(File::open(path).unwrap());
    let frames = PngDecoder::new(file).unwrap().apng().unwrap().into_frames();
    let frames = frames.collect_frames().unwrap();
    assert_eq!(frames.len(), 5);
    assert_eq!(frames[1].delay().numer_denom_ms(), (100, 1));
    let shown = image::DynamicImage::from(frames[4].buffer().clone());
    assert!(shown.into_rgb8() == last, "the last picture of the APNG");
    let (path, _) = film(&folder, "film.gif", Some(5.0), true);
    let mut decoder = gif::DecodeOptions::new();
    decoder.set_color_output(gif::ColorOutput::RGBA);
    let mut decoder = decoder.read_info(File::open(path).unwrap()).unwrap();
    let mut shown = RgbImage::new(1460, 810);
    let mut count = 0;
    while let Some(frame) = decoder.read_next_frame().unwrap() {
        count += 1;
        assert_eq!(frame.delay, 10);
        let drawn = shown.pixels_mut().zip(frame.buffer.chunks_exact(4));
        drawn
            .filter(|(_, now)| now[3] == 255)
            .for_each(|(pixel, now)| pixel.0.copy_from_slice(&now[..3]));
    }
    assert_eq!(count, 5);
    let off = |(a, b): (&u8, &u8)| a.abs_diff(*b);
    let farthest = shown.as_raw().iter().zip(last.as_raw()).map(off).max();
    assert!(
        farthest < Some(33),
        "half a step of the palette: {farthest:?}"
    );
}

#[test]
fn a_frame_stands_beside_as_high_as_the_map_and_one_that_cannot_be_read_leaves_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let (path, _) = film(&folder, "pictures", Some(10.0), true);
    let beside = |number: usize| {
        let mut picture = picture(&path, number);
        image::imageops::crop(&mut picture, 720, 0, 740, 810).to_image()
    };
    // 1500 x 900 px, scaled to a width of 740.
    let whole = beside(1);
    let frame = |pixel: &&Rgb<u8>| pixel.0 == [9, 99, 199];
    assert_eq!(whole.pixels().filter(frame).count(), 740 * 444);
    let reason = beside(2);
    assert_eq!(reason.pixels().filter(frame).count(), 0);
    let Colour(red, green, blue) = Colour::ORANGE;
    let words = reason
        .pixels()
        .filter(|pixel| pixel.0 == [red, green, blue]);
    assert!(words.count() > 300);
}

const HMI: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/hmi/continuum.fits");

/// The picture of HMI with replaced cards.
fn hmi(folder: &TempDir, cards: &[(&str, &str)]) -> PathBuf {
    let mut bytes = fs::read(HMI).unwrap();
    for (keyword, card) in cards {
        let start = format!("{keyword:<8}= ");
        let is_card = |card: &[u8]| card.starts_with(start.as_bytes());
        let n = bytes.chunks(80).position(is_card).unwrap();
        bytes[80 * n..][..80].copy_from_slice(format!("{card:<80}").as_bytes());
    }
    let path = folder.path().join("map.fits");
    fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn the_limb_of_a_context_falls_on_that_of_the_flight() {
    let context = Context::read(Path::new(HMI)).unwrap();
    let radius = RADIUS_ARCSEC;
    let light = |angle_deg: f64, radii: f64| {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        let (x, y) = (radii * radius * cos, radii * radius * sin);
        let place = HelioprojectiveArcsec { x, y };
        f64::from(context.brightness(place, radius).unwrap())
    };
    let mut centre = [0.0; 2];
    for n in 0..72 {
        let angle_deg = f64::from(n) * 5.0;
        let half = light(angle_deg, 0.985) / 2.0;
        let steps = (0..300).map(|step| 0.985 + f64::from(step) * 1e-4);
        let limb = steps
            .into_iter()
            .find(|radii| light(angle_deg, *radii) < half);
        // A pixel of the picture is 0.005 radii: unscaled its limb would be at 1.019.
        let limb = limb.unwrap();
        assert!((limb - 1.0).abs() < 0.005, "{angle_deg} deg: {limb}");
        centre[0] += limb * angle_deg.to_radians().cos() / 36.0;
        centre[1] += limb * angle_deg.to_radians().sin() / 36.0;
    }
    assert!(centre.iter().all(|off| off.abs() < 0.002), "{centre:?}");
}

/// The largest spot, at the position of its darkest pixel by astropy: an image that is rotated or mirrored has it elsewhere.
#[test]
fn a_spot_of_a_context_is_drawn_where_it_was() {
    let context = Context::read(Path::new(HMI)).unwrap();
    let utc = "2013-09-21T18:00:00Z".parse().unwrap();
    let disc = Ephemeris::default().disc(utc).unwrap();
    let view = panel::View::about(HelioprojectiveArcsec::default(), 1.2 * RADIUS_ARCSEC, 720);
    let picture = panel::Panel::new(view, &disc, Some(&context)).canvas;
    let picture = picture.into_image();
    let scale = RADIUS_ARCSEC / 973.96844 * 720.0 / (2.4 * RADIUS_ARCSEC);
    let expected = [359.5 + 348.0 * scale, 359.5 - 472.8 * scale];
    let is_near =
        |x: u32, y: u32| (f64::from(x) - expected[0]).hypot(f64::from(y) - expected[1]) < 12.0;
    let pixels = picture.enumerate_pixels();
    let greys = pixels.filter(|(x, y, pixel)| is_near(*x, *y) && pixel[0] == pixel[2]);
    let (x, y, _) = greys.min_by_key(|(_, _, pixel)| pixel[0]).unwrap();
    let off = (f64::from(x) - expected[0]).hypot(f64::from(y) - expected[1]);
    assert!(off < 2.0, "({x}, {y}), expected {expected:?}");
    assert!(picture.get_pixel(x, y)[0] < picture.get_pixel(719 - x, y)[0] - 30);
}

#[test]
fn a_context_says_when_it_was_taken_and_warns_when_that_is_long_ago() {
    let context = Context::read(Path::new(HMI)).unwrap();
    let words = |utc: &str| context.words(utc.parse().unwrap());
    let same_day = words("2023-01-31T06:03:00Z");
    assert_eq!(
        same_day.text,
        "context 2023-01-31 03:39 UTC, 2.4 h before the flight"
    );
    assert!(!same_day.is_warning);
    let years = words("2013-09-21T18:00:00Z");
    assert_eq!(
        years.text,
        "context 2023-01-31 03:39 UTC, 3418 days after the flight"
    );
    assert!(years.is_warning);
    let folder = tempfile::tempdir().unwrap();
    let path = hmi(&folder, &[("WAVELNTH", "HGLN_OBS=                 12.0")]);
    let aside = Context::read(&path).unwrap();
    let words = aside.words("2023-01-31T06:03:00Z".parse().unwrap());
    assert!(words.is_warning, "{words:?}");
    assert!(words.text.ends_with("seen 12 deg aside"), "{words:?}");
}

#[test]
fn a_context_that_would_mislead_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (keyword, card, expected) in [
        (
            "CTYPE1",
            "COMMENT",
            "CTYPE1: expected 'HPLN-TAN' or 'SOLARX' of a solar image, found nothing",
        ),
        (
            "WAVELNTH",
            "HGLN_OBS=                 95.0",
            "HGLN_OBS: expected an observer within 20 deg of the Earth, found one at 94 deg",
        ),
        (
            "RSUN_OBS",
            "RSUN_OBS=                202.9",
            "RSUN_OBS: expected about 974 arcsec, the Sun's radius from the Earth, found 202.9",
        ),
        (
            "CRVAL1",
            "CRVAL1  =               9000.0",
            "pixels: expected values on the Sun's disc, found none",
        ),
    ] {
        let path = hmi(&folder, &[(keyword, card)]);
        let error = Context::read(&path).unwrap_err().to_string();
        assert_eq!(error, format!("{}: {expected}", path.display()));
    }
}
