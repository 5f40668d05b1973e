//! Parts of TIFF files that pictures' decoders do not read: pages, palettes, and number types that do not occur in pictures.

use super::Problem;
use super::choice::Size;
use super::reals::{frame_of_values, luminance_warning};
use crate::frame::{Frame, FrameInfo, Warning};
use std::io::Cursor;
use tiff::decoder::{Decoder, DecodingResult};
use tiff::tags::Tag;

/// Largest number of pages that are read.
const MOST_PAGES: usize = 1000;

/// A greyscale picture of numbers that frames do not have: floating-point ones, or integers with a sign or of more than 16 bits.
pub(super) struct Numbers {
    values: Vec<f32>,
    bits: i64,
    size: Size,
    orientation: u16,
}

/// The numbers of such a TIFF; `None` for any other.
pub(super) fn numbers(bytes: &[u8]) -> Option<Numbers> {
    let mut decoder = Decoder::new(Cursor::new(bytes)).ok()?;
    let tiff::ColorType::Gray(bits) = decoder.colortype().ok()? else {
        return None;
    };
    let formats = decoder
        .find_tag_unsigned_vec::<u16>(Tag::SampleFormat)
        .ok()?;
    // 1, or no entry, means unsigned integers: up to 16 bits they are read like pictures.
    let without_sign = formats.is_none_or(|formats| formats.first() == Some(&1));
    if without_sign && bits <= 16 {
        return None;
    }
    Numbers::decode(decoder)
}

/// The luminance of a TIFF with a palette of 8 bits; `None` for any other. Its decoder does not support palettes: the picture is decoded as if
/// the numbers were grey.
pub(super) fn palette(bytes: &[u8], warnings: &mut Vec<Warning>) -> Option<Numbers> {
    const PALETTE: u16 = 3;
    const BLACK_IS_ZERO: u16 = 1;
    let mut decoder = Decoder::new(Cursor::new(bytes)).ok()?;
    let tag = Tag::PhotometricInterpretation;
    if decoder.find_tag_unsigned::<u16>(tag).ok()?? != PALETTE {
        return None;
    }
    let colours = decoder.get_tag_u16_vec(Tag::ColorMap).ok()?;
    let directory = usize::try_from(decoder.ifd_pointer()?.0).ok()?;
    let is_little = bytes[0] == b'I';
    let stored = |number: u16| match is_little {
        true => number.to_le_bytes(),
        false => number.to_be_bytes(),
    };
    // Entries of 12 bytes after their number: tag, type, count and value (TIFF 6.0, section 2).
    let entries = bytes.get(directory + 2..)?.chunks_exact(12);
    let entry = entries
        .take_while(|entry| !entry.is_empty())
        .position(|entry| entry[..2] == stored(tag.to_u16()))?;
    let mut grey = bytes.to_vec();
    grey.get_mut(directory + 2 + 12 * entry + 8..)?
        .get_mut(..2)?
        .copy_from_slice(&stored(BLACK_IS_ZERO));
    let mut numbers = Numbers::decode(Decoder::new(Cursor::new(grey.as_slice())).ok()?)?;
    let (red, rest) = colours.split_at_checked(256)?;
    let (green, blue) = rest.split_at_checked(256)?;
    for value in &mut numbers.values {
        let n = *value as usize;
        let parts = [(red, 0.2126), (green, 0.7152), (blue, 0.0722)];
        let luminance =
            parts.map(|(list, share)| share * f32::from(list.get(n).copied().unwrap_or(0)));
        *value = (luminance.iter().sum::<f32>() / 257.0).round();
    }
    warnings.push(luminance_warning("TIFF, palette"));
    Some(numbers)
}

impl Numbers {
    fn decode(mut decoder: Decoder<Cursor<&[u8]>>) -> Option<Self> {
        let [width, height] = decoder.dimensions().ok().map(<[u32; 2]>::from)?;
        let orientation = decoder.find_tag_unsigned(Tag::Orientation).ok()?;
        let (values, bits) = match decoder.read_image().ok()? {
            DecodingResult::F32(v) => (v, -32),
            DecodingResult::F64(v) => (v.into_iter().map(|value| value as f32).collect(), -64),
            DecodingResult::U8(v) => (v.into_iter().map(f32::from).collect(), 8),
            DecodingResult::I8(v) => (v.into_iter().map(f32::from).collect(), 16),
            DecodingResult::I16(v) => (v.into_iter().map(f32::from).collect(), 16),
            DecodingResult::I32(v) => (v.into_iter().map(|value| value as f32).collect(), 32),
            DecodingResult::U32(v) => (v.into_iter().map(|value| value as f32).collect(), 32),
            _ => return None,
        };
        Some(Self {
            values,
            bits,
            size: [width as usize, height as usize],
            orientation: orientation.unwrap_or(1),
        })
    }

    /// The numbers as a frame.
    pub fn frame(self, warnings: Vec<Warning>) -> Result<Frame, Problem> {
        if self.orientation != 1 {
            let expected = "1 beside numbers that are not of 8 or 16 bit";
            return Err(Problem::field("Orientation", expected, self.orientation));
        }
        let info = FrameInfo {
            warnings,
            ..FrameInfo::default()
        };
        frame_of_values(&self.values, self.bits, self.size, None, info)
    }
}

/// The same TIFF with the wanted page as its first, if that is another one; warns of pages that are not read.
pub(super) fn page(
    bytes: &[u8],
    wanted: Option<Size>,
    warnings: &mut Vec<Warning>,
) -> Option<Vec<u8>> {
    let mut decoder = Decoder::new(Cursor::new(bytes)).ok()?;
    let mut pages = Vec::new();
    loop {
        let [width, height] = decoder.dimensions().ok().map(<[u32; 2]>::from)?;
        pages.push(([width as usize, height as usize], decoder.ifd_pointer()?.0));
        if !decoder.more_images() || pages.len() == MOST_PAGES || decoder.next_image().is_err() {
            break;
        }
    }
    if pages.len() == 1 {
        return None;
    }
    let chosen = pages
        .iter()
        .position(|(size, _)| Some(*size) == wanted)
        .unwrap_or(0);
    let ([width, height], pointer) = pages[chosen];
    let count = pages.len();
    let found = format!(
        "{count}; read the first of {width} x {height} pixels, page {}",
        chosen + 1
    );
    warnings.push(Warning::new("file", "one picture", found));
    // Position of the first page's directory: in the header.
    let is_little = bytes[0] == b'I';
    let is_big_tiff = bytes[2..4].contains(&43);
    let (at, pointer) = match (is_little, is_big_tiff) {
        (true, false) => (4, (pointer as u32).to_le_bytes().to_vec()),
        (false, false) => (4, (pointer as u32).to_be_bytes().to_vec()),
        (true, true) => (8, pointer.to_le_bytes().to_vec()),
        (false, true) => (8, pointer.to_be_bytes().to_vec()),
    };
    let mut page = bytes.to_vec();
    page[at..at + pointer.len()].copy_from_slice(&pointer);
    Some(page)
}
