//! A FITS file's first picture as a frame.

use super::compressed::Tiles;
use super::header::Header;
use super::info::{read_info, read_saturation};
use super::structure::{Content, Hdu, MAX_SIDE};
use super::{MAX_PIXELS, Problem, checksum};
use crate::frame::{Frame, FrameError, Pixels};
use multiversion::multiversion;
use std::ops::RangeInclusive;

/// The kinds of pixels that a camera's frame can have.
#[derive(Clone, Copy)]
enum Stored {
    U8,
    /// 16 bit, stored with an offset of 32768.
    U16,
    /// 16 bit with a sign that no pixel may use.
    I16,
}

/// Reads the first image with two axes, in the primary HDU or an extension.
pub(super) fn read_fits(bytes: &[u8], hdus: &[Hdu]) -> Result<Frame, Problem> {
    let (hdu, header) = find_image(hdus)?;
    let compressed = hdu.content() == Content::CompressedImage;
    let prefix = if compressed { "Z" } else { "" };
    let [width, height] = sides(&hdu.header, prefix)?;
    let stored = stored(&hdu.header, prefix)?;
    let tiles = match compressed {
        true => Some(Tiles::new(bytes, hdu, width, height)?),
        false => None,
    };
    checksum::check_data(bytes, hdu)?;
    let mut pixels = Unpacked::new(stored, width, width * height);
    match tiles {
        Some(tiles) => tiles.unpack(|numbers| pixels.add(numbers))?,
        None => pixels.add_plain(&bytes[hdu.data_bytes.clone()])?,
    }
    let pixels = pixels.pixels;
    let saturation = read_saturation(&header, pixels.bits(), brightest_dn(&pixels))?;
    let info = read_info(&header)?;
    Frame::new(width, height, pixels, saturation, info).map_err(refused)
}

/// The keywords of the image over those of the primary HDU, without reading the pixels.
pub(super) fn read_keywords(hdus: &[Hdu]) -> Result<Header, Problem> {
    find_image(hdus).map(|(_, header)| header)
}

fn find_image(hdus: &[Hdu]) -> Result<(&Hdu, Header), Problem> {
    let first = hdus.first().map(|hdu| &hdu.header);
    if first.and_then(|header| header.get("SIMPLE")) != Some(&true.into()) {
        return Err(Problem::field("SIMPLE", "T", "something else"));
    }
    let axes = |hdu: &Hdu| match hdu.content() {
        Content::Image => hdu.header.integer("NAXIS").ok().flatten(),
        Content::CompressedImage => hdu.header.integer("ZNAXIS").ok().flatten(),
        Content::Other => None,
    };
    let Some(hdu) = hdus.iter().find(|hdu| axes(hdu) == Some(2)) else {
        return Err(match hdus.iter().find_map(axes) {
            Some(axes) => Problem::field("NAXIS", "an image with 2 axes", axes),
            None => Problem::content("an image in a FITS file", "none in any of its HDUs"),
        });
    };
    Ok((hdu, hdu.header.over(&hdus[0].header)))
}

fn sides(header: &Header, prefix: &str) -> Result<[usize; 2], Problem> {
    let side = |n: u32| header.size(&format!("{prefix}NAXIS{n}"), 1..=MAX_SIDE);
    let (width, height) = (side(1)?, side(2)?);
    if width * height > MAX_PIXELS {
        let field = format!("{prefix}NAXISn");
        let expected = format!("at most {MAX_PIXELS} pixels");
        let found = format!("{width} x {height}");
        return Err(Problem::field(field, expected, found));
    }
    Ok([width as usize, height as usize])
}

fn stored(header: &Header, prefix: &str) -> Result<Stored, Problem> {
    let scale = header.number("BSCALE")?.unwrap_or(1.0);
    if scale != 1.0 {
        return Err(Problem::field("BSCALE", "1", scale));
    }
    let zero = header.number("BZERO")?.unwrap_or(0.0);
    let field = format!("{prefix}BITPIX");
    match header.integer(&field)? {
        Some(8) if zero == 0.0 => Ok(Stored::U8),
        Some(16) if zero == 32_768.0 => Ok(Stored::U16),
        Some(16) if zero == 0.0 => Ok(Stored::I16),
        Some(8) => Err(Problem::field("BZERO", "0 beside 8-bit pixels", zero)),
        Some(16) => Err(Problem::field(
            "BZERO",
            "0 or 32768 beside 16-bit pixels",
            zero,
        )),
        bits => {
            let found = match bits {
                Some(bits @ ..0) => format!("{bits} (floating-point pixels)"),
                Some(bits) => bits.to_string(),
                None => "nothing".into(),
            };
            Err(Problem::field(
                field,
                "8 or 16 (whole-number pixels)",
                found,
            ))
        }
    }
}

/// Pixels that come row by row.
struct Unpacked {
    stored: Stored,
    width: usize,
    pixels: Pixels,
}

impl Unpacked {
    fn new(stored: Stored, width: usize, pixels: usize) -> Self {
        let pixels = match stored {
            Stored::U8 => Pixels::U8(Vec::with_capacity(pixels)),
            Stored::U16 | Stored::I16 => Pixels::U16(Vec::with_capacity(pixels)),
        };
        Self {
            stored,
            width,
            pixels,
        }
    }

    /// Adds the pixels of an image that is not compressed: big-endian numbers.
    fn add_plain(&mut self, data: &[u8]) -> Result<(), Problem> {
        if let Pixels::U8(pixels) = &mut self.pixels {
            pixels.extend_from_slice(data);
            return Ok(());
        }
        let words = data.as_chunks::<2>().0;
        let number = |word: &[u8; 2]| i16::from_be_bytes(*word).into();
        words.chunks(self.width).try_for_each(|row| {
            let numbers: Vec<i32> = row.iter().map(number).collect();
            self.add(&numbers)
        })
    }

    /// Adds pixels of numbers as stored; an error that names the first that is none.
    fn add(&mut self, numbers: &[i32]) -> Result<(), Problem> {
        let (zero, top) = match self.stored {
            Stored::U8 => (0, 255),
            Stored::U16 => (32_768, 65_535),
            Stored::I16 => (0, 32_767),
        };
        let legal = -zero..=top - zero;
        if !all_within(numbers, &legal)
            && let Some(at) = numbers.iter().position(|number| !legal.contains(number))
        {
            let number = i64::from(numbers[at]) + i64::from(zero);
            let at = self.pixels.len() + at;
            let (x, y) = (at % self.width, at / self.width);
            let found = format!("{number} at pixel ({x}, {y})");
            let expected = format!("values from 0 to {top}");
            return Err(Problem::field("pixels", expected, found));
        }
        match &mut self.pixels {
            Pixels::U8(pixels) => extend(pixels, numbers, |number| number as u8),
            Pixels::U16(pixels) => extend(pixels, numbers, |number| (number + zero) as u16),
        }
        Ok(())
    }
}

/// Whether all numbers lie in a range. Without an end in the middle, and with one number of each, this is many at a time.
#[multiversion(targets("x86_64+avx2"))]
fn all_within(numbers: &[i32], range: &RangeInclusive<i32>) -> bool {
    let above = |number: i32| number.wrapping_sub(*range.start()) as u32;
    let most = numbers
        .iter()
        .fold(0, |most, number| above(*number).max(most));
    most <= above(*range.end())
}

#[multiversion(targets("x86_64+avx2"))]
fn extend<T>(pixels: &mut Vec<T>, numbers: &[i32], pixel: impl Fn(i32) -> T) {
    pixels.extend(numbers.iter().map(|number| pixel(*number)));
}

pub(super) fn brightest_dn(pixels: &Pixels) -> u16 {
    match pixels {
        Pixels::U8(p) => p.iter().fold(0, |most, dn| most.max(*dn)).into(),
        Pixels::U16(p) => p.iter().fold(0, |most, dn| most.max(*dn)),
    }
}

pub(super) fn refused(error: FrameError) -> Problem {
    Problem::content("a frame", error.to_string())
}
