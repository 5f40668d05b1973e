//! PNG, TIFF and JPEG pictures as frames. They carry no time or exposure.
//!
//! A greyscale picture is read unchanged; any other as its luminance, with a warning: the numbers of such a camera are seldom proportional
//! to light. A picture that states its orientation (TIFF, EXIF) is rotated back.

use super::choice::Size;
use super::read::refused;
use super::reals::luminance_warning;
use super::structure::MAX_SIDE;
use super::{MAX_PIXELS, Problem, tiffs};
use crate::frame::{Frame, FrameInfo, Pixels};
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use std::io::Cursor;

/// Position of the bit depth in a PNG, in its first chunk IHDR: decoders do not report it.
const PNG_DEPTH: usize = 24;

/// Format of a file, if it is a picture.
pub(super) fn format_of(bytes: &[u8]) -> Option<ImageFormat> {
    match bytes {
        [0x89, b'P', b'N', b'G', ..] => Some(ImageFormat::Png),
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => Some(ImageFormat::Tiff),
        [0xFF, 0xD8, 0xFF, ..] => Some(ImageFormat::Jpeg),
        _ => None,
    }
}

/// Reads a picture; if a TIFF has several, the first of the wanted size, if there is one.
pub(super) fn read_picture(
    bytes: &[u8],
    format: ImageFormat,
    wanted: Option<Size>,
) -> Result<Frame, Problem> {
    let name = format.extensions_str()[0].to_uppercase();
    let expected = format!("a whole {name} picture");
    let mut warnings = Vec::new();
    let page = match format {
        ImageFormat::Tiff => tiffs::page(bytes, wanted, &mut warnings),
        _ => None,
    };
    let bytes = page.as_deref().unwrap_or(bytes);
    if format == ImageFormat::Tiff {
        let numbers = tiffs::numbers(bytes).or_else(|| tiffs::palette(bytes, &mut warnings));
        if let Some(numbers) = numbers {
            return numbers.frame(warnings);
        }
    }
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
        warnings.push(luminance_warning(&format!("{name}, {stored:?}")));
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

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
