//! Greyscale PNG and TIFF pictures as frames. They say nothing of time or exposure.

use super::read::refused;
use super::structure::MAX_SIDE;
use super::{MAX_PIXELS, Problem};
use crate::frame::{Frame, FrameInfo, Pixels};
use image::{DynamicImage, ImageFormat, ImageReader, Limits};
use std::io::Cursor;

/// Reads a greyscale picture of 8 or 16 bits.
pub(super) fn read_picture(bytes: &[u8], format: ImageFormat) -> Result<Frame, Problem> {
    let name = format.extensions_str()[0].to_uppercase();
    let expected = format!("a whole {name} picture in greyscale, 8 or 16 bit");
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE as u32);
    limits.max_image_height = Some(MAX_SIDE as u32);
    limits.max_alloc = Some(4 * MAX_PIXELS);
    reader.limits(limits);
    let picture = reader
        .decode()
        .map_err(|error| Problem::content(&expected, one_line(&error.to_string())))?;
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let pixels = match picture {
        DynamicImage::ImageLuma8(grey) => Pixels::U8(grey.into_raw()),
        DynamicImage::ImageLuma16(grey) => Pixels::U16(grey.into_raw()),
        other => return Err(Problem::content(expected, format!("{:?}", other.color()))),
    };
    let saturation = pixels.as_slice().assumed_saturation_dn();
    Frame::new(width, height, pixels, saturation, FrameInfo::default()).map_err(refused)
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
