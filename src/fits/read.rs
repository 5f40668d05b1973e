//! A FITS file's first picture as a frame.

use super::compressed::Tiles;
use super::header::Header;
use super::info::{read_info, read_saturation};
use super::structure::{Content, Hdu, MAX_SIDE};
use super::{MAX_PIXELS, Problem, checksum};
use crate::frame::{Frame, FrameError, Pixels, RowSource};
use multiversion::multiversion;
use std::ops::RangeInclusive;
use std::sync::{Arc, Mutex, PoisonError};

/// The kinds of pixels that a camera's frame can have.
#[derive(Clone, Copy)]
enum PixelType {
    U8,
    /// 16 bit, stored with an offset of 32768.
    U16,
    /// 16 bit with a sign that no pixel may use.
    I16,
}

/// Reads the first image with two axes, in the primary HDU or an extension.
pub(super) fn read_fits(bytes: &[u8], hdus: &[Hdu]) -> Result<Frame, Problem> {
    Image::find(bytes, hdus)?.frame(bytes)
}

/// As [`read_fits`], but rows are decoded when they are first read, where each is a tile of its own, the sum of all was checked, and
/// the saturation is stated. Then what a row's damage is will stand in the second value.
pub(super) fn read_on_demand(bytes: Vec<u8>, hdus: &[Hdu]) -> Result<(Frame, Damage), Problem> {
    let damage = Damage::default();
    let mut image = Image::find(&bytes, hdus)?;
    let is_checked = image.hdu.header.get("DATASUM").is_some();
    let states_saturation = image.header.get("SATURATE").is_some();
    let rows = |tiles: &mut Tiles| tiles.are_rows() && is_checked && states_saturation;
    let Some(tiles) = image.tiles.take_if(rows) else {
        return Ok((image.frame(&bytes)?, damage));
    };
    let (width, height) = (image.width, image.height);
    let dark = match image.pixel_type {
        PixelType::U8 => Pixels::U8(vec![0; width]),
        PixelType::U16 | PixelType::I16 => Pixels::U16(vec![0; width]),
    };
    let saturation = read_saturation(&image.header, dark.as_slice())?;
    let info = read_info(&image.header)?;
    let rows = TileRows {
        pixel_type: image.pixel_type,
        width,
        tiles,
        bytes,
        damage: Arc::clone(&damage),
    };
    let frame = Frame::on_demand(dark, height, Box::new(rows), saturation, info);
    Ok((frame.map_err(refused)?, damage))
}

/// What is wrong with the first row that turned out to be damaged.
pub(super) type Damage = Arc<Mutex<Option<Problem>>>;

/// An image whose structure is checked, and the sum of its data.
struct Image<'a> {
    hdu: &'a Hdu,
    /// Its keywords over those of the primary HDU.
    header: Header,
    width: usize,
    height: usize,
    pixel_type: PixelType,
    /// None where it is not compressed.
    tiles: Option<Tiles>,
}

impl<'a> Image<'a> {
    /// The first one with two axes.
    fn find(bytes: &[u8], hdus: &'a [Hdu]) -> Result<Self, Problem> {
        let (hdu, header) = find_image(hdus)?;
        let compressed = hdu.content() == Content::CompressedImage;
        let prefix = if compressed { "Z" } else { "" };
        let [width, height] = sides(&hdu.header, prefix)?;
        let pixel_type = pixel_type(&hdu.header, prefix)?;
        let tiles = match compressed {
            true => Some(Tiles::new(bytes, hdu, width, height)?),
            false => None,
        };
        let expected = width * height * pixel_type.bytes();
        let found = hdu.data_bytes.len();
        if !compressed && found != expected {
            let expected = format!("{expected} bytes of {width} x {height} pixels");
            return Err(Problem::field("GCOUNT", expected, found));
        }
        checksum::check_data(bytes, hdu)?;
        Ok(Self {
            hdu,
            header,
            width,
            height,
            pixel_type,
            tiles,
        })
    }

    /// All of it, decoded.
    fn frame(&self, bytes: &[u8]) -> Result<Frame, Problem> {
        let (width, height) = (self.width, self.height);
        let mut pixels = PixelBuffer::new(self.pixel_type, width, width * height);
        match &self.tiles {
            Some(tiles) => tiles.unpack(bytes, |numbers| pixels.add(numbers))?,
            None => pixels.add_plain(&bytes[self.hdu.data_bytes.clone()])?,
        }
        let pixels = pixels.pixels;
        let saturation = read_saturation(&self.header, pixels.as_slice())?;
        let info = read_info(&self.header)?;
        Frame::new(width, height, pixels, saturation, info).map_err(refused)
    }
}

/// The rows of an image of which each is a tile.
struct TileRows {
    pixel_type: PixelType,
    width: usize,
    tiles: Tiles,
    /// The whole file.
    bytes: Vec<u8>,
    damage: Damage,
}

impl TileRows {
    fn decode(&self, y: usize) -> Result<Pixels, Problem> {
        let mut numbers = vec![0; self.width];
        self.tiles.decode(&self.bytes, y, &mut numbers)?;
        let mut row = PixelBuffer::new(self.pixel_type, self.width, self.width);
        row.add(&numbers)?;
        Ok(row.pixels)
    }
}

impl RowSource for TileRows {
    fn row(&self, y: usize) -> Option<Pixels> {
        let note = |problem| {
            let damage = self.damage.lock();
            let mut damage = damage.unwrap_or_else(PoisonError::into_inner);
            damage.get_or_insert(problem);
        };
        self.decode(y).map_err(note).ok()
    }
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

fn pixel_type(header: &Header, prefix: &str) -> Result<PixelType, Problem> {
    let scale = header.number("BSCALE")?.unwrap_or(1.0);
    if scale != 1.0 {
        return Err(Problem::field("BSCALE", "1", scale));
    }
    let zero = header.number("BZERO")?.unwrap_or(0.0);
    let field = format!("{prefix}BITPIX");
    match header.integer(&field)? {
        Some(8) if zero == 0.0 => Ok(PixelType::U8),
        Some(16) if zero == 32_768.0 => Ok(PixelType::U16),
        Some(16) if zero == 0.0 => Ok(PixelType::I16),
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

impl PixelType {
    /// What is added to a number as stored.
    fn zero(self) -> i32 {
        match self {
            Self::U8 | Self::I16 => 0,
            Self::U16 => 32_768,
        }
    }

    fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 | Self::I16 => 2,
        }
    }

    /// The least and the largest number as stored.
    fn range(self) -> (i32, i32) {
        match self {
            Self::U8 => (0, 255),
            Self::U16 => (-32_768, 32_767),
            Self::I16 => (0, 32_767),
        }
    }
}

/// Pixels that come row by row.
struct PixelBuffer {
    pixel_type: PixelType,
    width: usize,
    pixels: Pixels,
}

impl PixelBuffer {
    fn new(pixel_type: PixelType, width: usize, pixels: usize) -> Self {
        let pixels = match pixel_type {
            PixelType::U8 => Pixels::U8(Vec::with_capacity(pixels)),
            PixelType::U16 | PixelType::I16 => Pixels::U16(Vec::with_capacity(pixels)),
        };
        Self {
            pixel_type,
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
        let mut numbers = vec![0; self.width];
        words.chunks(self.width).try_for_each(|row| {
            for (number, word) in numbers.iter_mut().zip(row) {
                *number = i16::from_be_bytes(*word).into();
            }
            self.add(&numbers[..row.len()])
        })
    }

    /// Adds pixels of numbers as stored; an error that names the first that is none.
    fn add(&mut self, numbers: &[i32]) -> Result<(), Problem> {
        let (least, most) = self.pixel_type.range();
        let legal = least..=most;
        let (zero, top) = (self.pixel_type.zero(), most + self.pixel_type.zero());
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

/// Whether all numbers lie in a range. With a single maximum and no early end, many are looked at side by side.
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

pub(super) fn refused(error: FrameError) -> Problem {
    Problem::content("a frame", error.to_string())
}
