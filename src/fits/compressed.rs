//! Tile-compressed images (FITS 4.0, section 10): a binary table with a tile in each row.
//!
//! A header is not believed: cfitsio (3.49) divides by zero where a tile's size is bad, and reads beyond its buffer where a stream is
//! damaged. RICE_1, GZIP_1 and GZIP_2 are known, which are what cameras' programs, cfitsio and astropy write for whole numbers.

use super::Problem;
use super::form::Form;
use super::header::Header;
use super::rice::{Rice, Width};
use super::structure::{Hdu, MAX_SIDE};
use flate2::read::MultiGzDecoder;
use std::io::Read;
use std::ops::Range;

/// More pixels than this per byte of table no compression reaches (deflate's limit is 1032).
const MOST_PIXELS_PER_BYTE: usize = 1100;

/// All tiles together may have so many times the bytes of the data: some may share a stream.
const MOST_SHARING: usize = 4;

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
    /// Where in the file each tile's stream stands, row of tiles by row of tiles.
    streams: Vec<Range<usize>>,
}

impl Tiles {
    /// Checks the table of a `width` x `height` image against itself and the size of its data.
    pub fn new(bytes: &[u8], hdu: &Hdu, width: usize, height: usize) -> Result<Self, Problem> {
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
        // A tile that reaches beyond the image ends at its edge.
        let tile = [
            side("ZTILE1", width)?.min(width),
            side("ZTILE2", 1)?.min(height),
        ];
        let count = width.div_ceil(tile[0]) * height.div_ceil(tile[1]);
        let rows = header.size("NAXIS2", 0..=i64::MAX)?;
        if rows != count as u64 {
            let expected = format!("a row for each of {count} tiles");
            return Err(Problem::field("NAXIS2", expected, format!("{rows} rows")));
        }
        Ok(Self {
            width,
            height,
            tile,
            algorithm,
            streams: streams(bytes, hdu, count)?,
        })
    }

    /// Whether each tile is a row of pixels.
    pub fn are_rows(&self) -> bool {
        self.tile == [self.width, 1]
    }

    /// Unpacks the image from its first row on: `each` is given the numbers of one or more whole rows, as stored, before BZERO.
    ///
    /// # Errors
    /// A tile that is damaged, or what `each` gives.
    pub fn unpack(
        &self,
        file: &[u8],
        mut each: impl FnMut(&[i32]) -> Result<(), Problem>,
    ) -> Result<(), Problem> {
        let mut rows = vec![0; self.width * self.tile[1]];
        let mut numbers = vec![0; self.tile[0] * self.tile[1]];
        let across = self.width.div_ceil(self.tile[0]);
        for band in 0..self.height.div_ceil(self.tile[1]) {
            let height = self.tile[1].min(self.height - band * self.tile[1]);
            let rows = &mut rows[..self.width * height];
            for n in 0..across {
                let x = n * self.tile[0];
                let columns = self.tile[0].min(self.width - x);
                if columns == self.width {
                    self.decode(file, band * across + n, rows)?;
                    continue;
                }
                let numbers = &mut numbers[..columns * height];
                self.decode(file, band * across + n, numbers)?;
                for (row, line) in numbers.chunks_exact(columns).enumerate() {
                    rows[row * self.width + x..][..columns].copy_from_slice(line);
                }
            }
            each(rows)?;
        }
        Ok(())
    }

    /// Unpacks tile `n`, from 0, of the file to its numbers.
    ///
    /// # Errors
    /// A tile that is damaged.
    pub fn decode(&self, file: &[u8], n: usize, numbers: &mut [i32]) -> Result<(), Problem> {
        let stream = &file[self.streams[n].clone()];
        self.algorithm.decode(stream, numbers).ok_or_else(|| {
            let expected = format!("a whole stream of {} pixels", numbers.len());
            let found = format!("{} damaged bytes", stream.len());
            Problem::field(format!("tile {}", n + 1), expected, found)
        })
    }
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
    /// Fills `numbers` from a stream; `None` where it does not hold as many.
    fn decode(self, stream: &[u8], numbers: &mut [i32]) -> Option<()> {
        if let Self::Rice(rice) = self {
            return rice.decode(stream, numbers);
        }
        let mut bytes = Vec::new();
        // At most four bytes a number, and one to show that there are more.
        let most = 4 * numbers.len() as u64 + 1;
        let mut unzipped = MultiGzDecoder::new(stream).take(most);
        unzipped.read_to_end(&mut bytes).ok()?;
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

/// Where in the file the stream of each tile stands, as the descriptors of the column COMPRESSED_DATA tell.
fn streams(bytes: &[u8], hdu: &Hdu, tiles: usize) -> Result<Vec<Range<usize>>, Problem> {
    let (header, data) = (&hdu.header, &bytes[hdu.data_bytes.clone()]);
    let row_bytes = header.size("NAXIS1", 1..=1_000_000)? as usize;
    let columns = columns(header)?;
    let width: usize = columns.iter().map(|column| column.bytes).sum();
    if width != row_bytes {
        let expected = format!("{width} bytes, as the columns need");
        return Err(Problem::field("NAXIS1", expected, row_bytes));
    }
    let Some(index) = columns
        .iter()
        .position(|c| c.compressed && c.pointer.is_some())
    else {
        let expected = "a column COMPRESSED_DATA of bytes, of variable length";
        return Err(Problem::field("TTYPEn", expected, "none"));
    };
    let start: usize = columns[..index].iter().map(|column| column.bytes).sum();
    let heap = heap(header, data.len(), row_bytes, tiles)?;
    let rows = data.chunks_exact(row_bytes).take(tiles).enumerate();
    let streams = rows.map(|(n, row)| {
        let (length, offset) = columns[index].descriptor(&row[start..]);
        if offset.saturating_add(length) > heap.len() {
            let field = format!("tile {}", n + 1);
            let expected = format!("data within the heap of {} bytes", heap.len());
            let found = format!("{length} bytes at byte {offset}");
            return Err(Problem::field(field, expected, found));
        }
        let start = hdu.data_bytes.start + heap.start + offset;
        Ok(start..start + length)
    });
    let streams: Vec<Range<usize>> = streams.collect::<Result<_, Problem>>()?;
    // Tiles may share a stream, but a short file may not keep its reader busy for hours.
    let all: usize = streams.iter().map(Range::len).sum();
    if all > MOST_SHARING * data.len() {
        let expected = format!(
            "tiles of at most {} bytes in all",
            MOST_SHARING * data.len()
        );
        return Err(Problem::field(
            "COMPRESSED_DATA",
            expected,
            format!("{all} bytes"),
        ));
    }
    Ok(streams)
}

/// Where in the data the heap lies, behind the table's rows.
fn heap(
    header: &Header,
    data_bytes: usize,
    row_bytes: usize,
    tiles: usize,
) -> Result<Range<usize>, Problem> {
    let table_bytes = row_bytes.saturating_mul(tiles);
    if table_bytes > data_bytes {
        let expected = format!("{tiles} rows of {row_bytes} bytes in the data");
        let found = format!("{} bytes", data_bytes);
        return Err(Problem::field("NAXISn", expected, found));
    }
    let heap_start = match header.get("THEAP") {
        Some(_) => header.size("THEAP", table_bytes as i64..=data_bytes as i64)? as usize,
        None => table_bytes,
    };
    Ok(heap_start..data_bytes)
}

/// A column of the table of tiles.
struct Column {
    /// Whether it holds the compressed tiles; the other columns serve floating-point images.
    compressed: bool,
    /// Bytes in a row.
    bytes: usize,
    /// Half the bytes of a descriptor of a stream of bytes; `None` in any other column.
    pointer: Option<usize>,
}

impl Column {
    /// Length and offset of a stream, big-endian, each in half of the descriptor.
    fn descriptor(&self, row: &[u8]) -> (usize, usize) {
        let number = |bytes: &[u8]| bytes.iter().fold(0, |n: usize, b| n << 8 | usize::from(*b));
        let half = self.pointer.unwrap_or(0);
        (number(&row[..half]), number(&row[half..2 * half]))
    }
}

fn columns(header: &Header) -> Result<Vec<Column>, Problem> {
    let count = header.size("TFIELDS", 1..=999)?;
    (1..=count).map(|n| column(header, n)).collect()
}

fn column(header: &Header, n: u64) -> Result<Column, Problem> {
    let keyword = format!("TFORM{n}");
    let form = header.text(&keyword)?.unwrap_or_default();
    let name = header.text(&format!("TTYPE{n}"))?.unwrap_or_default();
    let compressed = name == "COMPRESSED_DATA";
    column_of(&form, compressed).ok_or_else(|| {
        let expected = "a column of a compressed image";
        Problem::field(keyword, expected, format!("'{form}'"))
    })
}

/// A column of this form; descriptors (P, Q) only as one a row.
fn column_of(form: &str, compressed: bool) -> Option<Column> {
    let form = Form::parse(form)?;
    let half = match form.letter {
        'P' => Some(4),
        'Q' => Some(8),
        _ => None,
    };
    if half.is_some() && form.repeat != 1 {
        return None;
    }
    Some(Column {
        compressed,
        bytes: form.bytes()?,
        pointer: half.filter(|_| form.pointed_to == Some('B')),
    })
}
