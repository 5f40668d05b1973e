//! PNG, TIFF and JPEG pictures as frames. They say nothing of time or exposure.
//!
//! A greyscale picture is read as it stands; any other as its luminance, with a warning: such a camera's numbers are seldom proportional
//! to light. A picture that says how it was turned (TIFF's orientation, EXIF) is turned back.

use super::read::{Size, refused};
use super::structure::MAX_SIDE;
use super::{MAX_PIXELS, Problem};
use crate::frame::{Frame, FrameInfo, Pixels, Warning};
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use std::io::Cursor;
use tiff::decoder::Decoder;

/// More pages of a TIFF are not looked at.
const MOST_PAGES: usize = 1000;

/// Where a PNG states the bits of a pixel, in the chunk IHDR, which is its first: decoders do not say.
const PNG_DEPTH: usize = 24;

/// What a file is, if it is a picture.
pub(super) fn format_of(bytes: &[u8]) -> Option<ImageFormat> {
    match bytes {
        [0x89, b'P', b'N', b'G', ..] => Some(ImageFormat::Png),
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => Some(ImageFormat::Tiff),
        [0xFF, 0xD8, 0xFF, ..] => Some(ImageFormat::Jpeg),
        _ => None,
    }
}

/// Reads a picture; of several in a TIFF, the first of the wanted size, if there is one.
pub(super) fn read_picture(
    bytes: &[u8],
    format: ImageFormat,
    wanted: Option<Size>,
) -> Result<Frame, Problem> {
    let name = format.extensions_str()[0].to_uppercase();
    let expected = format!("a whole {name} picture");
    let mut warnings = Vec::new();
    let page = match format {
        ImageFormat::Tiff => tiff_page(bytes, wanted, &mut warnings),
        _ => None,
    };
    let bytes = page.as_deref().unwrap_or(bytes);
    let bad = |error: image::ImageError| Problem::content(&expected, one_line(&error.to_string()));
    let mut decoder = reader(bytes, format).into_decoder().map_err(bad)?;
    let stored = decoder.original_color_type();
    let orientation = decoder.orientation().map_err(bad)?;
    let mut picture = DynamicImage::from_decoder(decoder).map_err(bad)?;
    picture.apply_orientation(orientation);
    let is_grey = matches!(
        picture,
        DynamicImage::ImageLuma8(_) | DynamicImage::ImageLuma16(_)
    );
    let is_shallow =
        format == ImageFormat::Png && bytes.get(PNG_DEPTH).is_some_and(|bits| *bits < 8);
    let is_linear =
        is_grey && !is_shallow && format != ImageFormat::Jpeg && stored == picture.color().into();
    if !is_linear {
        let found =
            format!("{name}, {stored:?}: its luminance, which is seldom proportional to light");
        warnings.push(Warning::new("picture", "greyscale of 8 or 16 bit", found));
    }
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let has_16_bits = picture.color().bytes_per_pixel() / picture.color().channel_count() > 1;
    let pixels = match has_16_bits {
        true => Pixels::U16(picture.into_luma16().into_raw()),
        false => Pixels::U8(picture.into_luma8().into_raw()),
    };
    let saturation = pixels.as_slice().assumed_saturation_dn();
    let info = FrameInfo {
        warnings,
        ..FrameInfo::default()
    };
    Frame::new(width, height, pixels, saturation, info).map_err(refused)
}

fn reader(bytes: &[u8], format: ImageFormat) -> ImageReader<Cursor<&[u8]>> {
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE as u32);
    limits.max_image_height = Some(MAX_SIDE as u32);
    limits.max_alloc = Some(4 * MAX_PIXELS);
    reader.limits(limits);
    reader
}

/// The same TIFF with the wanted page as its first, where that is another; warns of pages that are left out.
fn tiff_page(bytes: &[u8], wanted: Option<Size>, warnings: &mut Vec<Warning>) -> Option<Vec<u8>> {
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
    // Where the first page's directory stands: in the header.
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

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
