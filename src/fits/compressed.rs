//! Tile-compressed images (FITS 4.0, section 10): a binary table with a tile in each row.
//!
//! A header is not believed: cfitsio (3.49) divides by zero where a tile's size is bad, and reads beyond its buffer where a stream is
//! damaged. RICE_1, GZIP_1 and GZIP_2 are known, which are what cameras' programs, cfitsio and astropy write. A tile that does not
//! compress stands in a column of its own, gzipped or plain, and so may floating-point pixels that were not rounded.

use super::Problem;
use super::form::Form;
use super::header::Header;
use super::quantised::Quantised;
use super::reals::Coding;
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
    /// Where in the file each tile's stream stands, row of tiles by row of tiles; empty where a tile stands in another column.
    streams: Vec<Range<usize>>,
    /// The same of tiles that are only gzipped, and of those that are not compressed.
    gzipped: Option<Vec<Range<usize>>>,
    plain: Option<Vec<Range<usize>>>,
    /// None of whole numbers, and of floating-point ones that were not rounded.
    quantised: Option<Quantised>,
}

impl Tiles {
    /// Checks the table of `planes` images of `width` x `height` against itself and the size of its data. The first one is read.
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
        // A tile that reaches beyond the image ends at its edge.
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
            plain: table.streams("UNCOMPRESSED_DATA")?,
            quantised: steps
                .map(|steps| Quantised::new(header, steps))
                .transpose()?,
        })
    }

    /// Whether each tile has a stream of whole numbers.
    pub fn are_whole_numbers(&self) -> bool {
        self.quantised.is_none() && self.streams.iter().all(|stream| !stream.is_empty())
    }

    /// Whether each tile is a row of pixels.
    pub fn are_rows(&self) -> bool {
        self.tile == [self.width, 1]
    }

    /// Unpacks the image from its first row on: `each` is given the numbers of one or more whole rows, as stored, before BZERO. Ends with
    /// false where it does not take them.
    ///
    /// # Errors
    /// A tile that is damaged.
    pub fn unpack(&self, file: &[u8], each: impl FnMut(&[i32]) -> bool) -> Result<bool, Problem> {
        self.bands(|n, numbers| self.decode(file, n, numbers), each)
    }

    /// The values of all pixels.
    ///
    /// # Errors
    /// A tile that is damaged.
    pub fn values(&self, file: &[u8], coding: &Coding) -> Result<Vec<f32>, Problem> {
        let mut all = Vec::with_capacity(self.width * self.height);
        let decode = |n: usize, values: &mut [f32]| self.decode_values(file, n, coding, values);
        self.bands(decode, |rows| {
            all.extend_from_slice(rows);
            true
        })?;
        Ok(all)
    }

    /// Puts the tiles beside each other, band by band.
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
    /// A tile that is damaged.
    pub fn decode(&self, file: &[u8], n: usize, numbers: &mut [i32]) -> Result<(), Problem> {
        let stream = &file[self.streams[n].clone()];
        let count = numbers.len();
        let decoded = self.algorithm.decode(stream, numbers);
        decoded.ok_or_else(|| damaged(n, count, stream))
    }

    /// The values of tile `n`, from whichever column it stands in.
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

/// At most so many bytes, and one to show that there are more.
fn gunzip(stream: &[u8], most: usize) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut unzipped = MultiGzDecoder::new(stream).take(most as u64 + 1);
    unzipped.read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

/// Numbers of so many bytes, of which all first bytes stood before all second ones.
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
    /// Fills `numbers` from a stream; `None` where it does not hold as many.
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

/// The table of tiles: a row for each.
struct TileTable<'a> {
    data: &'a [u8],
    /// Where the data begin in the file.
    start: usize,
    row_bytes: usize,
    tiles: usize,
    columns: Vec<Column>,
    heap: Range<usize>,
}

impl<'a> TileTable<'a> {
    fn new(bytes: &'a [u8], hdu: &Hdu, tiles: usize) -> Result<Self, Problem> {
        let (header, data) = (&hdu.header, &bytes[hdu.data_bytes.clone()]);
        let row_bytes = header.size("NAXIS1", 1..=1_000_000)? as usize;
        let columns = columns(header)?;
        let width: usize = columns.iter().map(|column| column.bytes).sum();
        if width != row_bytes {
            let expected = format!("{width} bytes, as the columns need");
            return Err(Problem::field("NAXIS1", expected, row_bytes));
        }
        Ok(Self {
            data,
            start: hdu.data_bytes.start,
            row_bytes,
            tiles,
            heap: heap(header, data.len(), row_bytes, tiles)?,
            columns,
        })
    }

    /// A column by its name, and where it begins in a row.
    fn column(&self, name: &str) -> Option<(&Column, usize)> {
        let index = self.columns.iter().position(|column| column.name == name)?;
        let start = self.columns[..index]
            .iter()
            .map(|column| column.bytes)
            .sum();
        Some((&self.columns[index], start))
    }

    fn rows(&self) -> impl Iterator<Item = &[u8]> {
        self.data.chunks_exact(self.row_bytes).take(self.tiles)
    }

    /// Where in the file the stream of each tile stands, as the descriptors of a column give it.
    fn streams(&self, name: &str) -> Result<Option<Vec<Range<usize>>>, Problem> {
        let Some((column, start)) = self
            .column(name)
            .filter(|(column, _)| column.pointer.is_some())
        else {
            return Ok(None);
        };
        let streams = self.rows().enumerate().map(|(n, row)| {
            let (length, offset) = column.descriptor(&row[start..]);
            if offset.saturating_add(length) > self.heap.len() {
                let field = format!("tile {}", n + 1);
                let expected = format!("data within the heap of {} bytes", self.heap.len());
                let found = format!("{length} bytes at byte {offset}");
                return Err(Problem::field(field, expected, found));
            }
            let start = self.start + self.heap.start + offset;
            Ok(start..start + length)
        });
        let streams: Vec<Range<usize>> = streams.collect::<Result<_, Problem>>()?;
        // Tiles may share a stream, but a short file may not keep its reader busy for hours.
        let all: usize = streams.iter().map(Range::len).sum();
        let most = MOST_SHARING * self.data.len();
        if all > most {
            let expected = format!("tiles of at most {most} bytes in all");
            return Err(Problem::field(name, expected, format!("{all} bytes")));
        }
        Ok(Some(streams))
    }

    /// Step and value of number 0 of each tile, from columns or keywords; none where numbers were not rounded.
    fn steps(&self, header: &Header) -> Result<Option<Vec<[f64; 2]>>, Problem> {
        let column = |name: &str| {
            let (_, start) = self.column(name).filter(|(column, _)| column.is_double)?;
            let number = move |row: &[u8]| {
                let bytes = row[start..].first_chunk().copied().unwrap_or_default();
                f64::from_be_bytes(bytes)
            };
            Some(self.rows().map(number).collect::<Vec<f64>>())
        };
        let numbers = |name: &str| match (column(name), header.number(name)?) {
            (Some(numbers), _) => Ok(Some(numbers)),
            (None, Some(number)) => Ok(Some(vec![number; self.tiles])),
            (None, None) => Ok::<_, Problem>(None),
        };
        let pairs = numbers("ZSCALE")?.zip(numbers("ZZERO")?);
        Ok(pairs.map(|(steps, zeros)| steps.into_iter().zip(zeros).map(|(s, z)| [s, z]).collect()))
    }
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
    name: String,
    /// Bytes in a row.
    bytes: usize,
    /// Of a descriptor of a stream: half its bytes, and the bytes of an element of the stream; `None` in any other column.
    pointer: Option<(usize, usize)>,
    /// Whether it holds one floating-point number of 64 bits.
    is_double: bool,
}

impl Column {
    /// Length and offset of a stream in bytes, big-endian, each in half of the descriptor.
    fn descriptor(&self, row: &[u8]) -> (usize, usize) {
        let number = |bytes: &[u8]| bytes.iter().fold(0, |n: usize, b| n << 8 | usize::from(*b));
        let (half, element) = self.pointer.unwrap_or((0, 1));
        let length = number(&row[..half]).saturating_mul(element);
        (length, number(&row[half..2 * half]))
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
    column_of(&form, name).ok_or_else(|| {
        let expected = "a column of a compressed image";
        Problem::field(keyword, expected, format!("'{form}'"))
    })
}

/// A column of this form; descriptors (P, Q) only as one a row.
fn column_of(form: &str, name: String) -> Option<Column> {
    let form = Form::parse(form)?;
    let half = match form.letter {
        'P' => Some(4),
        'Q' => Some(8),
        _ => None,
    };
    if half.is_some() && form.repeat != 1 {
        return None;
    }
    let element = match form.pointed_to {
        Some('B') => Some(1),
        Some('I') => Some(2),
        Some('J' | 'E') => Some(4),
        Some('K' | 'D') => Some(8),
        _ => None,
    };
    Some(Column {
        name,
        bytes: form.bytes()?,
        pointer: half.zip(element),
        is_double: form.letter == 'D' && form.repeat == 1,
    })
}
