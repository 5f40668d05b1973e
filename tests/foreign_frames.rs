//! Properties of reading frames from other programs: values that the Sun's position does not need never cost a frame, the
//! values that are read are right, and every value that is not used as stored is reported.
//!
//! The frame is one of `tests/data/frames`, whose truth is that of an independent generator.

mod headers;
mod numbers;
mod pictures;
mod several;

use solaspect::aspect::{self, Expected, Quality};
use solaspect::fits::read_frame_of_size;
use solaspect::frame::{Frame, Pixels, Warning};
use solaspect::instrument::{Instrument, builtin};
use std::fs;
use std::path::Path;
use std::sync::LazyLock;

const SAMPLE: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/tests/data/frames/standard/frame_00000.fits"
);
/// Centre of the Sun in the sample, by `truth.csv`.
const SUN_PX: [f64; 2] = [818.513_247, 527.023_529];
const SIZE: [usize; 2] = [1296, 966];

static DEMO: LazyLock<Instrument> = LazyLock::new(|| builtin("demo").unwrap());
static PIXELS: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let frame = solaspect::fits::read_frame(Path::new(SAMPLE)).unwrap();
    match frame.pixels() {
        Pixels::U8(pixels) => pixels.clone(),
        Pixels::U16(_) => panic!("the sample has 8 bits"),
    }
});

/// A header of these cards and END, padded to whole blocks.
fn header(cards: &[String]) -> Vec<u8> {
    let end = "END".to_owned();
    let cards = cards.iter().chain([&end]);
    let mut bytes: Vec<u8> = cards
        .flat_map(|card| format!("{card:<80}").into_bytes())
        .collect();
    bytes.resize(bytes.len().next_multiple_of(2880), b' ');
    bytes
}

fn blocks(mut data: Vec<u8>) -> Vec<u8> {
    data.resize(data.len().next_multiple_of(2880), 0);
    data
}

/// An image HDU with these axes; the first card makes it primary or an extension.
fn image(first: &str, bits: i32, axes: &[usize], cards: &[&str], data: Vec<u8>) -> Vec<u8> {
    let mut all = vec![
        first.to_owned(),
        format!("BITPIX  = {bits}"),
        format!("NAXIS   = {}", axes.len()),
    ];
    all.extend(
        axes.iter()
            .enumerate()
            .map(|(n, side)| format!("NAXIS{:<3}= {side}", n + 1)),
    );
    all.extend(cards.iter().map(|card| (*card).to_owned()));
    [header(&all), blocks(data)].concat()
}

const PRIMARY: &str = "SIMPLE  = T";
const EXTENSION: &str = "XTENSION= 'IMAGE   '";

/// A file with the sample's picture; `number` converts each DN to the bytes of a pixel.
fn sample<const N: usize>(
    bits: i32,
    cards: &[&str],
    number: impl Fn(usize, u8) -> [u8; N],
) -> Vec<u8> {
    let numbers = PIXELS.iter().enumerate().flat_map(|(n, dn)| number(n, *dn));
    image(PRIMARY, bits, &SIZE, cards, numbers.collect())
}

/// Reads a file of these bytes, for a camera of the sample's size.
fn read(bytes: &[u8], name: &str) -> Frame {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    read_frame_of_size(&path, SIZE).unwrap()
}

/// Error of the Sun's centre, px; `None` if the frame is not fine.
fn error_px(frame: &Frame) -> Option<f64> {
    let seen = DEMO.seen_by(frame).unwrap();
    let expected = frame.info.mid_exposure.and_then(Expected::at);
    let solution = aspect::solve(frame, &seen, expected, None);
    let sun = solution
        .aspect
        .filter(|_| solution.quality == Quality::Fine)?;
    let sun = sun.sun_px.position;
    Some((sun.x - SUN_PX[0]).hypot(sun.y - SUN_PX[1]))
}

fn assert_solved(frame: &Frame, what: &str) {
    let error = error_px(frame);
    assert!(
        error.is_some_and(|error| error < 0.1),
        "{what}: {error:?} px"
    );
}

fn fields(warnings: &[Warning]) -> Vec<&str> {
    warnings
        .iter()
        .map(|warning| warning.field.as_str())
        .collect()
}
