//! A FITS file's first picture as a frame.

use super::header::Header;
use super::info::{read_info, read_saturation};
use super::raw::OpenFile;
use super::structure::{BLOCK, Content, Hdu, MAX_SIDE, scan};
use super::{MAX_PIXELS, Problem, checksum, compressed};
use crate::frame::{Frame, FrameError, Pixels};

/// How the pixels of an image are stored.
struct Layout {
    width: usize,
    height: usize,
    stored: Stored,
    compressed: bool,
}

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
pub(super) fn read_fits(bytes: &[u8]) -> Result<Frame, Problem> {
    let (hdu, header) = find_image(bytes)?;
    let layout = layout(bytes, &hdu)?;
    checksum::check_data(bytes, &hdu)?;
    let pixels = match layout.compressed {
        true => compressed_pixels(bytes, &hdu, &layout)?,
        false => plain_pixels(&bytes[hdu.data_bytes], layout.stored),
    };
    if let (Stored::I16, Pixels::U16(values)) = (layout.stored, &pixels) {
        refuse_negative(values, layout.width)?;
    }
    finish(layout.width, layout.height, pixels, &header)
}

/// The keywords of the image over those of the primary HDU, without reading the pixels.
pub(super) fn read_keywords(bytes: &[u8]) -> Result<Header, Problem> {
    find_image(bytes).map(|(_, header)| header)
}

fn find_image(bytes: &[u8]) -> Result<(Hdu, Header), Problem> {
    let mut hdus = scan(bytes)?;
    if hdus[0].header.get("SIMPLE") != Some(&true.into()) {
        return Err(Problem::field("SIMPLE", "T", "something else"));
    }
    let axes = |hdu: &Hdu| match hdu.content() {
        Content::Image => hdu.header.integer("NAXIS").ok().flatten(),
        Content::CompressedImage => hdu.header.integer("ZNAXIS").ok().flatten(),
        Content::Other => None,
    };
    let Some(index) = hdus.iter().position(|hdu| axes(hdu) == Some(2)) else {
        return Err(match hdus.iter().find_map(axes) {
            Some(axes) => Problem::field("NAXIS", "an image with 2 axes", axes),
            None => Problem::content("an image in a FITS file", "none in any of its HDUs"),
        });
    };
    let header = hdus[index].header.over(&hdus[0].header);
    Ok((hdus.swap_remove(index), header))
}

fn layout(bytes: &[u8], hdu: &Hdu) -> Result<Layout, Problem> {
    let compressed = hdu.content() == Content::CompressedImage;
    let prefix = if compressed { "Z" } else { "" };
    let side = |n: u32| hdu.header.size(&format!("{prefix}NAXIS{n}"), 1..=MAX_SIDE);
    let (width, height) = (side(1)?, side(2)?);
    if width * height > MAX_PIXELS {
        let field = format!("{prefix}NAXISn");
        let expected = format!("at most {MAX_PIXELS} pixels");
        return Err(Problem::field(
            field,
            expected,
            format!("{width} x {height}"),
        ));
    }
    let stored = stored(&hdu.header, prefix)?;
    if compressed {
        compressed::check(bytes, hdu, width, height)?;
    }
    Ok(Layout {
        width: width as usize,
        height: height as usize,
        stored,
        compressed,
    })
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

fn plain_pixels(data: &[u8], stored: Stored) -> Pixels {
    let words = data.as_chunks::<2>().0.iter();
    match stored {
        Stored::U8 => Pixels::U8(data.to_vec()),
        Stored::U16 => Pixels::U16(words.map(|w| offset(i16::from_be_bytes(*w))).collect()),
        Stored::I16 => Pixels::U16(words.map(|w| u16::from_be_bytes(*w)).collect()),
    }
}

/// Decompresses by cfitsio, which gets nothing but the checked HDU after an empty primary one.
fn compressed_pixels(bytes: &[u8], hdu: &Hdu, layout: &Layout) -> Result<Pixels, Problem> {
    let mut file = empty_primary();
    file.extend_from_slice(&bytes[hdu.bytes(bytes.len())]);
    file.resize(file.len().next_multiple_of(BLOCK), 0);
    let count = layout.width * layout.height;
    OpenFile::read(&mut file, |file| {
        file.go_to(2)?;
        Ok(match layout.stored {
            Stored::U8 => Pixels::U8(file.pixels_u8(count)?),
            Stored::U16 => {
                let stored = file.pixels_i16(count)?;
                Pixels::U16(stored.into_iter().map(offset).collect())
            }
            Stored::I16 => {
                let stored = file.pixels_i16(count)?;
                Pixels::U16(stored.into_iter().map(i16::cast_unsigned).collect())
            }
        })
    })
}

/// The header of a primary HDU without data.
fn empty_primary() -> Vec<u8> {
    let cards = [
        "SIMPLE  = T",
        "BITPIX  = 8",
        "NAXIS   = 0",
        "EXTEND  = T",
        "END",
    ];
    let header: String = cards.iter().map(|card| format!("{card:<80}")).collect();
    let mut bytes = header.into_bytes();
    bytes.resize(BLOCK, b' ');
    bytes
}

/// A stored value with BZERO = 32768.
fn offset(stored: i16) -> u16 {
    stored.cast_unsigned() ^ 0x8000
}

fn refuse_negative(values: &[u16], width: usize) -> Result<(), Problem> {
    match values.iter().position(|value| value.cast_signed() < 0) {
        None => Ok(()),
        Some(at) => {
            let found = format!(
                "{} at pixel ({}, {})",
                values[at].cast_signed(),
                at % width,
                at / width
            );
            Err(Problem::field("pixels", "values from 0 to 32767", found))
        }
    }
}

fn finish(width: usize, height: usize, pixels: Pixels, header: &Header) -> Result<Frame, Problem> {
    let saturation = read_saturation(header, pixels.bits(), brightest_dn(&pixels))?;
    let info = read_info(header)?;
    Frame::new(width, height, pixels, saturation, info).map_err(refused)
}

pub(super) fn brightest_dn(pixels: &Pixels) -> u16 {
    match pixels {
        Pixels::U8(p) => p.iter().max().map_or(0, |dn| u16::from(*dn)),
        Pixels::U16(p) => p.iter().max().copied().unwrap_or(0),
    }
}

pub(super) fn refused(error: FrameError) -> Problem {
    Problem::content("a frame", error.to_string())
}
