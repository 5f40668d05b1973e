//! Compression of an image's rows as tiles, one row of pixels per tile (FITS 4.0, section 10); `compressed` unpacks them.

use super::layout::{Layout, text_card, value_card};
use super::rice::{BLOCK, Encoder, StoredPixel};
use crate::frame::Pixels;
use flate2::write::GzEncoder;
use std::io::{self, Write};
use std::num::NonZeroUsize;
use std::slice::ChunksExact;
use std::thread::{self, Builder};

/// Compression of the pixels of an image extension. All kinds are lossless.
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
    /// The names of the kinds in files and commands.
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

/// Compression of the pixels of an image extension, and number of threads. The bytes do not depend on that number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Packing {
    pub compression: Compression,
    pub threads: usize,
}

impl From<Compression> for Packing {
    /// With one thread.
    fn from(compression: Compression) -> Self {
        let threads = 1;
        Self {
            compression,
            threads,
        }
    }
}

/// Stack of a thread that compresses: it needs little, and locked memory is taken in full.
const STACK_BYTES: usize = 1 << 18;
/// Bytes of a tile's descriptor: its length, and its start in the heap.
const DESCRIPTOR: usize = 8;
/// Numbers of those cards in the header of a table of tiles whose values are known only when all tiles are there.
const PCOUNT: usize = 5;
const TFORM: usize = 9;

/// Begins an image's HDU with the cards of its shape.
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

/// The 16-bit numbers of FITS have a sign: the stored value is less by 32768.
fn offset(layout: &mut Layout, pixels: &Pixels) {
    if let Pixels::U16(_) = pixels {
        layout.value("BZERO", "32768", "offset of the values");
        layout.value("BSCALE", "1", "scale of the values");
    }
}

/// Adds the image's pixels as the HDU's data, and the header cards that depend on them.
///
/// # Errors
/// Only errors of the gzip compressor.
pub(super) fn put(
    layout: &mut Layout,
    pixels: &Pixels,
    width: usize,
    packing: Packing,
) -> io::Result<()> {
    match pixels {
        Pixels::U8(pixels) => put_as(layout, pixels, width, packing),
        Pixels::U16(pixels) => put_as(layout, pixels, width, packing),
    }
}

fn put_as<T: StoredPixel + Sync>(
    layout: &mut Layout,
    pixels: &[T],
    width: usize,
    packing: Packing,
) -> io::Result<()> {
    let rows = pixels.chunks_exact(width);
    match packing.compression {
        Compression::None => {
            rows.for_each(|row| layout.bytes().extend_from_slice(&T::bytes(row)));
            Ok(())
        }
        Compression::Rice => put_tiles(layout, pixels, width, packing.threads, rice),
        Compression::Gzip => put_tiles(layout, pixels, width, packing.threads, gzip),
    }
}

/// Adds the tiles of some rows to a heap, and returns the length of each, bytes.
type Pack<T> = fn(rows: ChunksExact<'_, T>, heap: &mut Vec<u8>) -> io::Result<Vec<usize>>;

/// Adds descriptors and heap: a tile for each row. Threads beyond this one, at most as many as there are cores, take a part of the rows each.
fn put_tiles<T: Sync>(
    layout: &mut Layout,
    pixels: &[T],
    width: usize,
    threads: usize,
    pack: Pack<T>,
) -> io::Result<()> {
    let rows = pixels.len() / width;
    let bytes = layout.bytes();
    let descriptors = bytes.len();
    bytes.resize(descriptors + DESCRIPTOR * rows, 0);
    let cores = thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let rows_each = rows.div_ceil(threads.clamp(1, cores));
    let mut parts = pixels.chunks(rows_each * width);
    let first = parts.next().unwrap_or_default();
    let lengths = thread::scope(|scope| -> io::Result<_> {
        let mut others = Vec::new();
        for part in parts {
            let work = move || {
                let mut heap = Vec::new();
                Ok::<_, io::Error>((pack(part.chunks_exact(width), &mut heap)?, heap))
            };
            let thread = Builder::new().name("pack".into()).stack_size(STACK_BYTES);
            others.push((part, thread.spawn_scoped(scope, work).ok()));
        }
        let mut lengths = pack(first.chunks_exact(width), bytes)?;
        for (part, other) in others {
            // A thread that could not be started costs time, but no frame.
            let Some(other) = other else {
                lengths.extend(pack(part.chunks_exact(width), bytes)?);
                continue;
            };
            let panicked = |_| Err(io::Error::other("a thread has panicked"));
            let (more, heap) = other.join().unwrap_or_else(panicked)?;
            lengths.extend(more);
            bytes.extend(heap);
        }
        Ok(lengths)
    })?;
    let (mut longest, mut start) = (0, 0);
    let cells = bytes[descriptors..].chunks_exact_mut(DESCRIPTOR);
    for (cell, length) in cells.zip(lengths) {
        cell[..4].copy_from_slice(&(length as u32).to_be_bytes());
        cell[4..].copy_from_slice(&(start as u32).to_be_bytes());
        longest = longest.max(length);
        start += length;
    }
    let form = format!("1PB({longest})");
    let pcount = value_card("PCOUNT", &start.to_string(), "bytes of all tiles");
    layout.set_card(PCOUNT, &pcount);
    layout.set_card(TFORM, &text_card(["TFORM1", "where it stands"], &form));
    Ok(())
}

fn rice<T: StoredPixel>(rows: ChunksExact<'_, T>, heap: &mut Vec<u8>) -> io::Result<Vec<usize>> {
    let mut encoder = Encoder::<T>::new(rows.clone().next().map_or(0, <[T]>::len));
    let tile = |row: &[T]| {
        let stream = encoder.encode(row);
        heap.extend_from_slice(stream);
        Ok(stream.len())
    };
    rows.map(tile).collect()
}

fn gzip<T: StoredPixel>(rows: ChunksExact<'_, T>, heap: &mut Vec<u8>) -> io::Result<Vec<usize>> {
    let tile = |row: &[T]| {
        let start = heap.len();
        let mut packed = GzEncoder::new(&mut *heap, flate2::Compression::fast());
        packed.write_all(&T::bytes(row))?;
        packed.finish()?;
        Ok(heap.len() - start)
    };
    rows.map(tile).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bytes_are_the_same_whatever_the_number_of_threads() {
        let (width, height) = (70, 11);
        let dn = |n: usize| (n * n % 251) as u8;
        let bytes = |compression, threads| {
            let pixels = Pixels::U8((0..width * height).map(dn).collect());
            let mut layout = Layout::new(0);
            let packing = Packing {
                compression,
                threads,
            };
            begin(&mut layout, &pixels, width, compression);
            layout.end_header();
            put(&mut layout, &pixels, width, packing).unwrap();
            layout.end();
            layout.into_bytes()
        };
        for compression in Compression::KINDS {
            let one = bytes(compression, 1);
            for threads in [2, 5, 11, 64] {
                assert_eq!(bytes(compression, threads), one, "{compression:?}");
            }
        }
    }
}
