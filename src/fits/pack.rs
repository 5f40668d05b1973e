//! An image's rows as compressed tiles, a row of pixels a tile (FITS 4.0, section 10): what `compressed` unpacks.

use super::layout::{Layout, text_card, value_card};
use super::rice::{BLOCK, Encoder, Folded};
use crate::frame::Pixels;
use flate2::write::GzEncoder;
use std::io::{self, Write};

/// How the pixels of an image extension are compressed. All are lossless.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Compression {
    /// Rice, row by row: about half the size, and fast.
    #[default]
    Rice,
    /// Deflate, row by row.
    Gzip,
    None,
}

impl Compression {
    /// The names of the kinds, as files and commands give them.
    pub const NAMES: [&str; 3] = ["rice", "none", "gzip"];
    /// Every kind.
    pub const KINDS: [Self; 3] = [Self::Rice, Self::None, Self::Gzip];

    /// The name of the kind.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rice => "rice",
            Self::Gzip => "gzip",
            Self::None => "none",
        }
    }
}

/// Bytes of a tile's descriptor: its length, and where it begins in the heap.
const DESCRIPTOR: usize = 8;
/// Of the header of a table of tiles, the cards that tell what is known only when all tiles are there.
const PCOUNT: usize = 5;
const TFORM: usize = 9;

/// Begins an image's HDU with the cards that tell its shape.
pub(super) fn begin(layout: &mut Layout, pixels: &Pixels, width: usize, compression: Compression) {
    let (height, bits) = (pixels.len() / width, pixels.bits() as usize);
    layout.begin();
    let Some(algorithm) = algorithm(compression) else {
        layout.text("XTENSION", "IMAGE", "an image");
        axes(layout, "", bits, [width, height]);
        layout.value("PCOUNT", "0", "no more data");
        layout.value("GCOUNT", "1", "one group");
        return offset(layout, pixels);
    };
    layout.text("XTENSION", "BINTABLE", "a table of compressed tiles");
    axes(layout, "", 8, [DESCRIPTOR, height]);
    layout.value("PCOUNT", "0", "bytes of all tiles");
    layout.value("GCOUNT", "1", "one group");
    layout.value("TFIELDS", "1", "columns of the table");
    layout.text("TTYPE1", "COMPRESSED_DATA", "a tile in each row");
    layout.text("TFORM1", "1PB", "where it stands");
    layout.value("ZIMAGE", "T", "the table is a compressed image");
    axes(layout, "Z", bits, [width, height]);
    layout.value("ZTILE1", &width.to_string(), "a tile is a row of pixels");
    layout.value("ZTILE2", "1", "a tile is a row of pixels");
    layout.text("ZCMPTYPE", algorithm, "the compression");
    if compression == Compression::Rice {
        layout.text("ZNAME1", "BLOCKSIZE", "pixels of a block");
        layout.value("ZVAL1", &BLOCK.to_string(), "pixels of a block");
        layout.text("ZNAME2", "BYTEPIX", "bytes of a pixel");
        layout.value("ZVAL2", &(bits / 8).to_string(), "bytes of a pixel");
    }
    offset(layout, pixels);
}

/// FITS's name of a compression.
fn algorithm(compression: Compression) -> Option<&'static str> {
    match compression {
        Compression::Rice => Some("RICE_1"),
        Compression::Gzip => Some("GZIP_1"),
        Compression::None => None,
    }
}

fn axes(layout: &mut Layout, prefix: &str, bits: usize, sides: [usize; 2]) {
    let mut value = |keyword: &str, value: usize, comment: &str| {
        layout.value(&format!("{prefix}{keyword}"), &value.to_string(), comment);
    };
    value("BITPIX", bits, "bits of a value");
    value("NAXIS", 2, "axes");
    value("NAXIS1", sides[0], "length of axis 1");
    value("NAXIS2", sides[1], "length of axis 2");
}

/// FITS's 16 bits have a sign: what is stored is 32768 less.
fn offset(layout: &mut Layout, pixels: &Pixels) {
    if let Pixels::U16(_) = pixels {
        layout.value("BZERO", "32768", "offset of the values");
        layout.value("BSCALE", "1", "scale of the values");
    }
}

/// Adds the image's pixels as the HDU's data, and what the header must tell of them.
///
/// # Errors
/// None but what the compressor of gzip may give.
pub(super) fn put(
    layout: &mut Layout,
    pixels: &Pixels,
    width: usize,
    compression: Compression,
) -> io::Result<()> {
    match (compression, pixels) {
        (Compression::None, Pixels::U8(pixels)) => layout.bytes().extend_from_slice(pixels),
        (Compression::None, Pixels::U16(pixels)) => {
            layout.bytes().extend(pixels.iter().flat_map(stored));
        }
        (Compression::Rice, Pixels::U8(pixels)) => put_tiles(layout, pixels, width, rice(width))?,
        (Compression::Rice, Pixels::U16(pixels)) => put_tiles(layout, pixels, width, rice(width))?,
        (Compression::Gzip, Pixels::U8(pixels)) => {
            put_tiles(layout, pixels, width, |row: &[u8], heap| gzip(row, heap))?;
        }
        (Compression::Gzip, Pixels::U16(pixels)) => {
            put_tiles(layout, pixels, width, |row: &[u16], heap| {
                gzip(&row.iter().flat_map(stored).collect::<Vec<u8>>(), heap)
            })?;
        }
    }
    Ok(())
}

/// A pixel of 16 bits as it is stored.
fn stored(dn: &u16) -> [u8; 2] {
    (dn ^ 0x8000).to_be_bytes()
}

/// Adds descriptors and heap: a tile for each row.
fn put_tiles<T>(
    layout: &mut Layout,
    pixels: &[T],
    width: usize,
    mut tile: impl FnMut(&[T], &mut Vec<u8>) -> io::Result<()>,
) -> io::Result<()> {
    let rows = pixels.len() / width;
    let bytes = layout.bytes();
    let descriptors = bytes.len();
    bytes.resize(descriptors + DESCRIPTOR * rows, 0);
    let heap = bytes.len();
    let mut longest = 0;
    for (n, row) in pixels.chunks_exact(width).enumerate() {
        let start = bytes.len();
        tile(row, bytes)?;
        let length = bytes.len() - start;
        longest = longest.max(length);
        let at = descriptors + DESCRIPTOR * n;
        bytes[at..at + 4].copy_from_slice(&(length as u32).to_be_bytes());
        bytes[at + 4..at + 8].copy_from_slice(&((start - heap) as u32).to_be_bytes());
    }
    let heap_bytes = (bytes.len() - heap).to_string();
    let form = format!("1PB({longest})");
    layout.set_card(
        PCOUNT,
        &value_card("PCOUNT", &heap_bytes, "bytes of all tiles"),
    );
    layout.set_card(TFORM, &text_card(["TFORM1", "where it stands"], &form));
    Ok(())
}

fn rice<T: Folded>(width: usize) -> impl FnMut(&[T], &mut Vec<u8>) -> io::Result<()> {
    let mut encoder = Encoder::new::<T>(width);
    move |row, heap| {
        heap.extend_from_slice(encoder.encode(row));
        Ok(())
    }
}

fn gzip(row: &[u8], heap: &mut Vec<u8>) -> io::Result<()> {
    let mut packed = GzEncoder::new(heap, flate2::Compression::fast());
    packed.write_all(row)?;
    packed.finish()?;
    Ok(())
}
