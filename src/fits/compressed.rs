//! Tile-compressed images (FITS 4.0, section 10): a binary table with one tile per row.
//!
//! Headers are checked: cfitsio (3.49) divides by zero if a tile's size is bad, and reads beyond its buffer if a stream is
//! damaged. RICE_1, GZIP_1 and GZIP_2 are supported, which cameras' programs, cfitsio and astropy write. A tile that does not
//! compress is in a column of its own, gzipped or plain; so may be floating-point pixels that were not quantised.

use super::Problem;
use super::header::Header;
use super::quantised::Quantised;
use super::reals::Coding;
use super::rice::{Rice, StoredPixel, Width};
use super::structure::{Hdu, MAX_SIDE};
use super::tile_table::TileTable;
use flate2::read::MultiGzDecoder;
use std::io::Read;
use std::ops::Range;

/// Most pixels per byte of table that any compression reaches (deflate's limit is 1032).
const MOST_PIXELS_PER_BYTE: usize = 1100;

/// The algorithms.
#[derive(Debug, Clone, Copy)]
enum Algorithm {
    Rice(Rice),
    Gzip,
    /// Gzip of all first bytes, then all second ones ...
    GzipShuffled,
}

/// An image's table of tiles, checked.
pub(super) struct Tiles {
    width: usize,
    height: usize,
    /// Size of a tile that is not cut by the image's edge.
    tile: [usize; 2],
    algorithm: Algorithm,
    /// Range in the file of each tile's stream, row of tiles by row of tiles; empty if the tile is in another column.
    streams: Vec<Range<usize>>,
    /// The same for tiles that are only gzipped, and for those that are not compressed.
    gzipped: Option<Vec<Range<usize>>>,
    plain: Option<Vec<Range<usize>>>,
    /// `None` for integers, and for floating-point pixels that were not quantised.
    quantised: Option<Quantised>,
}

impl Tiles {
    /// Checks the table of `planes` images of `width` x `height` for consistency and against the size of its data. The first one is read.
    pub fn new(
        bytes: &[u8],
        hdu: &Hdu,
        width: usize,
        height: usize,
        planes: usize,
    ) -> Result<Self, Problem> {
        let header = &hdu.header;
        let algorithm = algorithm(header)?;
        let data = &bytes[hdu.data_bytes.clone()];
        if width * height > data.len().saturating_mul(MOST_PIXELS_PER_BYTE) {
            return Err(Problem::field(
                "ZNAXISn",
                "a size that the compressed data can fill",
                format!("{width} x {height} pixels in {} bytes", data.len()),
            ));
        }
        let side = |keyword: &str, default| match header.get(keyword) {
            Some(_) => header.size(keyword, 1..=MAX_SIDE).map(|side| side as usize),
            None => Ok(default),
        };
        // A tile that extends beyond the image ends at its edge.
        let tile = [
            side("ZTILE1", width)?.min(width),
            side("ZTILE2", 1)?.min(height),
        ];
        if side("ZTILE3", 1)? != 1 {
            return Err(Problem::field("ZTILE3", "tiles of one picture", "several"));
        }
        let in_plane = width.div_ceil(tile[0]) * height.div_ceil(tile[1]);
        let count = in_plane.saturating_mul(planes);
        let rows = header.size("NAXIS2", 0..=i64::MAX)?;
        if rows != count as u64 {
            let expected = format!("a row for each of {count} tiles");
            return Err(Problem::field("NAXIS2", expected, format!("{rows} rows")));
        }
        let table = TileTable::new(bytes, hdu, count)?;
        let Some(streams) = table.streams("COMPRESSED_DATA")? else {
            let expected = "a column COMPRESSED_DATA of bytes, of variable length";
            return Err(Problem::field("TTYPEn", expected, "none"));
        };
        let steps = table.steps(header)?;
        Ok(Self {
            width,
            height,
            tile,
            algorithm,
            streams,
            gzipped: table.streams("GZIP_COMPRESSED_DATA")?,
            plain: table.plain_streams("UNCOMPRESSED_DATA")?,
            quantised: steps
                .map(|steps| Quantised::new(header, steps))
                .transpose()?,
        })
    }

    /// Whether each tile has a stream of integers.
    pub fn are_whole_numbers(&self) -> bool {
        self.quantised.is_none() && self.streams.iter().all(|stream| !stream.is_empty())
    }

    /// Whether each tile is a row of pixels.
    pub fn are_rows(&self) -> bool {
        self.tile == [self.width, 1]
    }

    /// Some rows of pixels, if each row is a tile and the pixels have the width of the numbers in its stream; else `None`.
    ///
    /// # Errors
    /// If a tile is damaged.
    pub fn rows<T: StoredPixel>(
        &self,
        file: &[u8],
        rows: Range<usize>,
    ) -> Result<Option<Vec<T>>, Problem> {
        let rice = match self.algorithm {
            Algorithm::Rice(rice) if rice.width == T::WIDTH && self.are_rows() => rice,
            _ => return Ok(None),
        };
        let mut pixels = Vec::with_capacity(rows.len() * self.width);
        for y in rows {
            let start = pixels.len();
            pixels.resize(start + self.width, T::default());
            let stream = &file[self.streams[y].clone()];
            let decoded = rice.decode_pixels(stream, &mut pixels[start..]);
            decoded.ok_or_else(|| damaged(y, self.width, stream))?;
        }
        Ok(Some(pixels))
    }

    /// Unpacks the image from its first row on: `each` is given the numbers of one or more whole rows, as stored, before BZERO. Returns
    /// false if it rejects them.
    ///
    /// # Errors
    /// If a tile is damaged.
    pub fn unpack(&self, file: &[u8], each: impl FnMut(&[i32]) -> bool) -> Result<bool, Problem> {
        self.bands(|n, numbers| self.decode(file, n, numbers), each)
    }

    /// The values of all pixels.
    ///
    /// # Errors
    /// If a tile is damaged.
    pub fn values(&self, file: &[u8], coding: &Coding) -> Result<Vec<f32>, Problem> {
        let mut all = Vec::with_capacity(self.width * self.height);
        let decode = |n: usize, values: &mut [f32]| self.decode_values(file, n, coding, values);
        self.bands(decode, |rows| {
            all.extend_from_slice(rows);
            true
        })?;
        Ok(all)
    }

    /// Joins the tiles, band by band.
    fn bands<T: Copy + Default>(
        &self,
        decode: impl Fn(usize, &mut [T]) -> Result<(), Problem>,
        mut each: impl FnMut(&[T]) -> bool,
    ) -> Result<bool, Problem> {
        let mut rows = vec![T::default(); self.width * self.tile[1]];
        let mut numbers = vec![T::default(); self.tile[0] * self.tile[1]];
        let across = self.width.div_ceil(self.tile[0]);
        for band in 0..self.height.div_ceil(self.tile[1]) {
            let height = self.tile[1].min(self.height - band * self.tile[1]);
            let rows = &mut rows[..self.width * height];
            for n in 0..across {
                let x = n * self.tile[0];
                let columns = self.tile[0].min(self.width - x);
                if columns == self.width {
                    decode(band * across + n, rows)?;
                    continue;
                }
                let numbers = &mut numbers[..columns * height];
                decode(band * across + n, numbers)?;
                for (row, line) in numbers.chunks_exact(columns).enumerate() {
                    rows[row * self.width + x..][..columns].copy_from_slice(line);
                }
            }
            if !each(rows) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Unpacks tile `n`, from 0, of the file to its numbers.
    ///
    /// # Errors
    /// If a tile is damaged.
    pub fn decode(&self, file: &[u8], n: usize, numbers: &mut [i32]) -> Result<(), Problem> {
        let stream = &file[self.streams[n].clone()];
        let count = numbers.len();
        let decoded = self.algorithm.decode(stream, numbers);
        decoded.ok_or_else(|| damaged(n, count, stream))
    }

    /// The values of tile `n`, from whichever column contains it.
    fn decode_values(
        &self,
        file: &[u8],
        n: usize,
        coding: &Coding,
        values: &mut [f32],
    ) -> Result<(), Problem> {
        let stream = &file[self.streams[n].clone()];
        if !stream.is_empty() && (coding.bits > 0 || self.quantised.is_some()) {
            let mut numbers = vec![0; values.len()];
            self.decode(file, n, &mut numbers)?;
            if let Some(quantised) = &self.quantised {
                quantised.fill(n, &numbers, values);
            } else {
                for (value, number) in values.iter_mut().zip(numbers) {
                    *value = coding.whole(number.into());
                }
            }
            return Ok(());
        }
        let of = |streams: &Option<Vec<Range<usize>>>| {
            let stream = &file[streams.as_ref()?[n].clone()];
            (!stream.is_empty()).then_some(stream)
        };
        let bytes = values.len() * coding.bytes();
        let unpacked = match (stream, of(&self.gzipped), of(&self.plain)) {
            ([_, ..], ..) => gunzip(stream, bytes).map(|plain| match self.algorithm {
                Algorithm::GzipShuffled => unshuffled(&plain, coding.bytes()),
                _ => plain,
            }),
            (_, Some(gzipped), _) => gunzip(gzipped, bytes),
            (.., plain) => plain.map(<[u8]>::to_vec),
        };
        let unpacked = unpacked.filter(|unpacked| unpacked.len() == bytes);
        let unpacked = unpacked.ok_or_else(|| damaged(n, values.len(), stream))?;
        values.copy_from_slice(&coding.values(&unpacked));
        Ok(())
    }
}

fn damaged(n: usize, pixels: usize, stream: &[u8]) -> Problem {
    let expected = format!("a whole stream of {pixels} pixels");
    let found = format!("{} damaged bytes", stream.len());
    Problem::field(format!("tile {}", n + 1), expected, found)
}

/// The unzipped bytes: at most `most`, and one more to show that there are more.
fn gunzip(stream: &[u8], most: usize) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut unzipped = MultiGzDecoder::new(stream).take(most as u64 + 1);
    unzipped.read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

/// Numbers of `width` bytes, from bytes sorted so that all first bytes come before all second ones.
fn unshuffled(bytes: &[u8], width: usize) -> Vec<u8> {
    let count = bytes.len() / width;
    (0..count * width)
        .map(|at| bytes[at % width * count + at / width])
        .collect()
}

fn algorithm(header: &Header) -> Result<Algorithm, Problem> {
    let name = header.text("ZCMPTYPE")?.unwrap_or_default();
    match name.as_str() {
        "RICE_1" | "RICE_ONE" => rice(header).map(Algorithm::Rice),
        "GZIP_1" => Ok(Algorithm::Gzip),
        "GZIP_2" => Ok(Algorithm::GzipShuffled),
        _ => {
            let expected = "RICE_1, GZIP_1 or GZIP_2";
            Err(Problem::field("ZCMPTYPE", expected, format!("'{name}'")))
        }
    }
}

/// The two parameters of Rice, each named in a ZNAMEn with its value in ZVALn.
fn rice(header: &Header) -> Result<Rice, Problem> {
    let mut rice = Rice {
        block: 32,
        width: Width::Four,
    };
    for n in 1..=9 {
        let value = format!("ZVAL{n}");
        match header.text(&format!("ZNAME{n}"))?.as_deref() {
            Some("BLOCKSIZE") => rice.block = header.size(&value, 1..=MAX_SIDE)? as usize,
            Some("BYTEPIX") => {
                rice.width = match header.size(&value, 1..=4)? {
                    1 => Width::One,
                    2 => Width::Two,
                    4 => Width::Four,
                    bytes => return Err(Problem::field(value, "1, 2 or 4 bytes", bytes)),
                }
            }
            _ => {}
        }
    }
    Ok(rice)
}

impl Algorithm {
    /// Fills `numbers` from a stream; `None` if the stream holds fewer.
    fn decode(self, stream: &[u8], numbers: &mut [i32]) -> Option<()> {
        if let Self::Rice(rice) = self {
            return rice.decode(stream, numbers);
        }
        let bytes = gunzip(stream, 4 * numbers.len())?;
        let count = numbers.len();
        let width = bytes.len() / count;
        if !matches!(width, 1 | 2 | 4) || bytes.len() != width * count {
            return None;
        }
        for (n, number) in numbers.iter_mut().enumerate() {
            let byte = |k: usize| match self {
                Self::GzipShuffled => bytes[k * count + n],
                _ => bytes[n * width + k],
            };
            *number = match width {
                1 => i32::from(byte(0)),
                2 => i32::from(i16::from_be_bytes([byte(0), byte(1)])),
                _ => i32::from_be_bytes([byte(0), byte(1), byte(2), byte(3)]),
            };
        }
        Some(())
    }
}
