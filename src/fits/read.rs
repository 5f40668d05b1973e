//! A FITS file's first picture as a frame.

use super::choice::{Chosen, Size, checked_size, choose};
use super::compressed::Tiles;
use super::header::Header;
use super::info::read_info;
use super::reals::{Coding, Digitised, digitise};
use super::section::Section;
use super::structure::{Content, Hdu};
use super::values::Values;
use super::{Problem, checksum, saturation};
use crate::frame::{Frame, FrameError, FrameInfo, Pixels, RowSource, Warning};
use multiversion::multiversion;
use std::ops::{Range, RangeInclusive};
use std::sync::{Arc, Mutex, PoisonError};

/// Types of the pixels of a camera's frame.
#[derive(Clone, Copy)]
enum PixelType {
    U8,
    /// 16 bit, stored with an offset of 32768.
    U16,
    /// 16 bit with a sign; no pixel may be negative.
    I16,
}

/// Reads the image of the wanted size, else the first one, from the primary HDU or an extension.
pub(super) fn read_fits(
    bytes: &[u8],
    hdus: &[Hdu],
    wanted: Option<Size>,
) -> Result<Frame, Problem> {
    Image::find(bytes, hdus, wanted)?.frame(bytes)
}

/// The size of that image, and the physical values of its pixels.
pub(super) fn read_values(
    bytes: &[u8],
    hdus: &[Hdu],
    wanted: Option<Size>,
) -> Result<(Size, Vec<f32>), Problem> {
    let image = Image::find(bytes, hdus, wanted)?;
    Ok(([image.width, image.height], image.values(bytes)?))
}

/// As [`read_fits`], but a row is decoded when it is first read, if each row is a tile of its own, the sum of all was checked, and
/// this program stated the saturation. The second value then receives the fault of a damaged row.
pub(super) fn read_on_demand(
    bytes: Vec<u8>,
    hdus: &[Hdu],
    wanted: Option<Size>,
) -> Result<(Frame, Damage), Problem> {
    let damage = Damage::default();
    let mut image = Image::find(&bytes, hdus, wanted)?;
    let (mut info, section) = image.info();
    let is_checked = image.hdu.header.contains("DATASUM") && saturation::is_own(&image.header);
    let dark = match image.plain {
        Some(PixelType::U8) => Some(Pixels::U8(vec![0; image.width])),
        Some(PixelType::U16) => Some(Pixels::U16(vec![0; image.width])),
        Some(PixelType::I16) | None => None,
    };
    let dark = dark.filter(|_| is_checked && section.reversed == [false; 2]);
    let mut values = Values::of(&image.header);
    let with_saturation = |dark: Pixels| {
        let saturation = saturation::stated(&mut values, dark.as_slice())?;
        Some((dark, saturation))
    };
    let rows = |tiles: &mut Tiles| tiles.are_rows() && tiles.are_whole_numbers();
    let Some((dark, saturation)) = dark.and_then(with_saturation) else {
        return Ok((image.frame(&bytes)?, damage));
    };
    let Some(tiles) = image.tiles.take_if(rows) else {
        return Ok((image.frame(&bytes)?, damage));
    };
    info.warnings.extend(values.warnings);
    let height = image.height;
    let rows = TileRows {
        pixel_type: image.plain.unwrap_or(PixelType::U16),
        width: image.width,
        tiles,
        bytes,
        damage: Arc::clone(&damage),
    };
    let frame = Frame::on_demand(dark, height, Box::new(rows), saturation, info);
    Ok((frame.map_err(refused)?, damage))
}

/// Fault of the first row that turned out to be damaged.
pub(super) type Damage = Arc<Mutex<Option<Problem>>>;

/// An image whose structure is checked, and the sum of its data.
struct Image<'a> {
    hdu: &'a Hdu,
    /// Keywords of its HDU and, where these lack one, of the primary HDU.
    header: Header,
    width: usize,
    height: usize,
    coding: Coding,
    /// `None` if pixels must be computed from the numbers as stored.
    plain: Option<PixelType>,
    /// `None` if it is not compressed.
    tiles: Option<Tiles>,
    /// Pictures of the file that are not read.
    left_out: Option<Warning>,
}

impl<'a> Image<'a> {
    fn find(bytes: &[u8], hdus: &'a [Hdu], wanted: Option<Size>) -> Result<Self, Problem> {
        let Chosen {
            hdu,
            header,
            shape,
            left_out,
        } = choose(hdus, wanted)?;
        let compressed = hdu.content() == Content::CompressedImage;
        let prefix = if compressed { "Z" } else { "" };
        let [width, height] = checked_size(&shape, prefix)?;
        let coding = Coding::read(&hdu.header, prefix)?;
        let tiles = match compressed {
            true => Some(Tiles::new(bytes, hdu, width, height, shape.planes)?),
            false => None,
        };
        let expected = (width * height * coding.bytes()).saturating_mul(shape.planes);
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
            coding,
            plain: PixelType::of(&coding),
            tiles,
            left_out,
        })
    }

    /// Its exposure data, and its orientation on the sensor.
    fn info(&self) -> (FrameInfo, Section) {
        let mut values = Values::of(&self.header);
        let (mut info, section) = info(&mut values, [self.width, self.height]);
        info.warnings = values.warnings;
        info.warnings.extend(self.left_out.clone());
        (info, section)
    }

    /// The whole frame, decoded.
    fn frame(&self, bytes: &[u8]) -> Result<Frame, Problem> {
        let (mut info, section) = self.info();
        let mut values = Values::of(&self.header);
        let (pixels, unusable, saturation) = match self.plain_pixels(bytes)? {
            Some(pixels) => {
                let saturation = saturation::saturation_dn(&mut values, pixels.as_slice());
                (pixels, Vec::new(), saturation)
            }
            None => {
                let mut digitised = self.digitised(bytes)?;
                let saturation = digitised.saturation_dn(&mut values);
                info.warnings.append(&mut digitised.warnings);
                (digitised.pixels, digitised.unusable, saturation)
            }
        };
        info.warnings.extend(values.warnings);
        let (width, height) = (self.width, self.height);
        let (pixels, unusable) = section.upright(pixels, unusable, width);
        let frame = Frame::new(width, height, pixels, saturation, info).map_err(refused)?;
        Ok(frame.with_unusable(unusable))
    }

    /// Pixels that are stored in the form of a frame; `None` if some are not.
    fn plain_pixels(&self, bytes: &[u8]) -> Result<Option<Pixels>, Problem> {
        let Some(pixel_type) = self.plain else {
            return Ok(None);
        };
        if let Some(tiles) = &self.tiles
            && tiles.are_whole_numbers()
            && let Some(pixels) = pixel_type.rows(tiles, bytes, 0..self.height)?
        {
            return Ok(Some(pixels));
        }
        let count = self.width * self.height;
        let mut pixels = PixelBuffer::new(pixel_type, self.width, count);
        let are_pixels = match &self.tiles {
            Some(tiles) if tiles.are_whole_numbers() => {
                tiles.unpack(bytes, |numbers| pixels.add(numbers))?
            }
            Some(_) => false,
            None => {
                pixels.add_plain(&bytes[self.hdu.data_bytes.clone()][..count * pixel_type.bytes()])
            }
        };
        Ok(are_pixels.then_some(pixels.pixels))
    }

    fn digitised(&self, bytes: &[u8]) -> Result<Digitised, Problem> {
        digitise(&self.values(bytes)?, self.coding.bits)
    }

    /// Physical value of each pixel, row by row as stored; NaN if it has no value.
    fn values(&self, bytes: &[u8]) -> Result<Vec<f32>, Problem> {
        match &self.tiles {
            Some(tiles) => tiles.values(bytes, &self.coding),
            None => {
                let plane = self.width * self.height * self.coding.bytes();
                let data = &bytes[self.hdu.data_bytes.clone()][..plane];
                Ok(self.coding.values(data))
            }
        }
    }
}

/// Exposure data of a frame of this size, and its orientation on the sensor.
fn info(values: &mut Values, size: Size) -> (FrameInfo, Section) {
    let info = read_info(values);
    let section = Section::read(values, size);
    let corner_px = section.corner_px;
    (FrameInfo { corner_px, ..info }, section)
}

/// The rows of an image in which each row is a tile.
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
        if let Some(row) = self.pixel_type.rows(&self.tiles, &self.bytes, y..y + 1)? {
            return Ok(row);
        }
        let mut numbers = vec![0; self.width];
        self.tiles.decode(&self.bytes, y, &mut numbers)?;
        let mut row = PixelBuffer::new(self.pixel_type, self.width, self.width);
        let is_row = row.add(&numbers);
        let none = || Problem::field(format!("row {y}"), "numbers of pixels", "others");
        is_row.then_some(row.pixels).ok_or_else(none)
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

/// The keywords of the image and the primary HDU, without reading the pixels; the image's take precedence.
pub(super) fn read_keywords(hdus: &[Hdu], wanted: Option<Size>) -> Result<Header, Problem> {
    choose(hdus, wanted).map(|chosen| chosen.header)
}

/// The exposure data of the frame, and its keywords, without reading the pixels.
pub(super) fn read_headers(
    hdus: &[Hdu],
    wanted: Option<Size>,
) -> Result<(FrameInfo, Header), Problem> {
    let chosen = choose(hdus, wanted)?;
    let mut values = Values::of(&chosen.header);
    let (mut info, _) = info(&mut values, chosen.shape.size);
    info.warnings = values.warnings;
    info.warnings.extend(chosen.left_out);
    Ok((info, chosen.header))
}

impl PixelType {
    /// Type of plain numbers, if they can be used as pixels unchanged.
    fn of(coding: &Coding) -> Option<Self> {
        let is_plain = coding.scale == 1.0 && coding.blank.is_none();
        match (coding.bits, coding.zero) {
            (8, 0.0) if is_plain => Some(Self::U8),
            (16, 32_768.0) if is_plain => Some(Self::U16),
            (16, 0.0) if is_plain => Some(Self::I16),
            _ => None,
        }
    }

    /// Some rows of tiles, if all their numbers are such pixels; else `None`.
    fn rows(self, tiles: &Tiles, file: &[u8], y: Range<usize>) -> Result<Option<Pixels>, Problem> {
        Ok(match self {
            Self::U8 => tiles.rows(file, y)?.map(Pixels::U8),
            Self::U16 => tiles.rows(file, y)?.map(Pixels::U16),
            Self::I16 => None,
        })
    }

    /// Offset of a number as stored.
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

    /// The smallest and the largest number as stored.
    fn range(self) -> (i32, i32) {
        match self {
            Self::U8 => (0, 255),
            Self::U16 => (-32_768, 32_767),
            Self::I16 => (0, 32_767),
        }
    }
}

/// Pixels that are added row by row.
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

    /// Adds the pixels of an image that is not compressed: big-endian numbers. False if some are no valid pixels.
    fn add_plain(&mut self, data: &[u8]) -> bool {
        if let Pixels::U8(pixels) = &mut self.pixels {
            pixels.extend_from_slice(data);
            return true;
        }
        let words = data.as_chunks::<2>().0;
        let mut numbers = vec![0; self.width];
        words.chunks(self.width).all(|row| {
            for (number, word) in numbers.iter_mut().zip(row) {
                *number = i16::from_be_bytes(*word).into();
            }
            self.add(&numbers[..row.len()])
        })
    }

    /// Adds pixels from numbers as stored; false if some are no valid pixels.
    fn add(&mut self, numbers: &[i32]) -> bool {
        let (least, most) = self.pixel_type.range();
        if !all_within(numbers, &(least..=most)) {
            return false;
        }
        let zero = self.pixel_type.zero();
        match &mut self.pixels {
            Pixels::U8(pixels) => extend(pixels, numbers, |number| number as u8),
            Pixels::U16(pixels) => extend(pixels, numbers, |number| (number + zero) as u16),
        }
        true
    }
}

/// Whether all numbers lie in a range. With a single maximum and no early end, many are compared in parallel (SIMD).
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
