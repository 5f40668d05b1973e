//! What must hold of a tile-compressed image before its bytes are given to cfitsio (FITS 4.0, section 10).
//!
//! cfitsio 3.49 believes tile sizes, block sizes and descriptors; a hostile one makes it allocate without bound,
//! loop for ever or read beyond its buffers. HCOMPRESS_1 and PLIO_1 are left out: their decoders trust sizes inside
//! the stream, and no frame of an integer camera needs them.

use super::Problem;
use super::header::Header;
use super::structure::{Hdu, MAX_SIDE};

/// More pixels than this per byte of table no compression reaches (deflate's limit is 1032).
const MOST_PIXELS_PER_BYTE: u64 = 1100;

/// Checks the table that holds the tiles of a `width` x `height` image.
pub(super) fn check(bytes: &[u8], hdu: &Hdu, width: u64, height: u64) -> Result<(), Problem> {
    check_algorithm(&hdu.header)?;
    let tiles = check_tiles(&hdu.header, width, height)?;
    let stored = hdu.data_bytes.len() as u64;
    if width * height > stored.saturating_mul(MOST_PIXELS_PER_BYTE) {
        return Err(Problem::field(
            "ZNAXISn",
            "a size that the compressed data can fill",
            format!("{width} x {height} pixels in {stored} bytes"),
        ));
    }
    check_descriptors(&bytes[hdu.data_bytes.clone()], &hdu.header, tiles)
}

fn check_algorithm(header: &Header) -> Result<(), Problem> {
    let algorithm = header.text("ZCMPTYPE")?.unwrap_or_else(|| "nothing".into());
    if !["RICE_1", "RICE_ONE", "GZIP_1", "GZIP_2"].contains(&algorithm.as_str()) {
        let expected = "RICE_1, GZIP_1 or GZIP_2";
        return Err(Problem::field("ZCMPTYPE", expected, algorithm));
    }
    for n in 1..=9 {
        let value = format!("ZVAL{n}");
        let allowed: &[i64] = match header.text(&format!("ZNAME{n}"))?.as_deref() {
            Some("BLOCKSIZE") => &[16, 32],
            Some("BYTEPIX") => &[1, 2, 4],
            _ => continue,
        };
        let found = header.integer(&value)?;
        if !found.is_some_and(|found| allowed.contains(&found)) {
            let found = found.map_or("nothing".into(), |n| n.to_string());
            return Err(Problem::field(value, format!("one of {allowed:?}"), found));
        }
    }
    Ok(())
}

/// The number of tiles, which must be the number of rows of the table.
fn check_tiles(header: &Header, width: u64, height: u64) -> Result<u64, Problem> {
    let side = |keyword: &str, default| match header.get(keyword) {
        Some(_) => header.size(keyword, 1..=MAX_SIDE),
        None => Ok(default),
    };
    let (across, down) = (side("ZTILE1", width)?, side("ZTILE2", 1)?);
    let tiles = width.div_ceil(across) * height.div_ceil(down);
    // A tile may reach beyond the image by less than itself.
    if across > 2 * width || down > 2 * height {
        let found = format!("tiles of {across} x {down}");
        return Err(Problem::field(
            "ZTILEn",
            "tiles no larger than the image",
            found,
        ));
    }
    let rows = header.size("NAXIS2", 0..=i64::MAX)?;
    if rows != tiles {
        let expected = format!("a row for each of {tiles} tiles");
        return Err(Problem::field("NAXIS2", expected, format!("{rows} rows")));
    }
    Ok(tiles)
}

/// Every descriptor of a variable-length column must point into the heap.
fn check_descriptors(data: &[u8], header: &Header, rows: u64) -> Result<(), Problem> {
    let row_bytes = header.size("NAXIS1", 1..=1_000_000)?;
    let table_bytes = row_bytes * rows;
    let heap_start = match header.get("THEAP") {
        Some(_) => header.size("THEAP", 0..=data.len() as i64)?,
        None => table_bytes,
    };
    if table_bytes > data.len() as u64 {
        return Err(Problem::field(
            "NAXISn",
            "a table within its data",
            table_bytes,
        ));
    }
    let heap = (data.len() as u64).saturating_sub(heap_start);
    let columns = columns(header)?;
    let width: u64 = columns.iter().map(|column| column.bytes).sum();
    if width != row_bytes {
        let expected = format!("{width} bytes, as the columns need");
        return Err(Problem::field("NAXIS1", expected, row_bytes));
    }
    for (n, row) in data
        .chunks_exact(row_bytes as usize)
        .take(rows as usize)
        .enumerate()
    {
        let mut rest = row;
        for column in &columns {
            let (field, after) = rest.split_at(column.bytes as usize);
            rest = after;
            if let Some((length, offset)) = column.descriptor(field)
                && offset.saturating_add(length.saturating_mul(column.element_bytes)) > heap
            {
                return Err(Problem::field(
                    format!("tile {}", n + 1),
                    format!("data within the heap of {heap} bytes"),
                    format!("{length} elements at byte {offset}"),
                ));
            }
        }
    }
    Ok(())
}

/// A column of the table of tiles.
struct Column {
    /// Bytes in a row.
    bytes: u64,
    /// Half the bytes of a descriptor; `None` in a column of fixed length.
    pointer: Option<usize>,
    /// Bytes of what a descriptor points to.
    element_bytes: u64,
}

impl Column {
    /// Length in elements and offset in bytes, big-endian.
    fn descriptor(&self, field: &[u8]) -> Option<(u64, u64)> {
        let number = |bytes: &[u8]| bytes.iter().fold(0, |n, byte| n << 8 | u64::from(*byte));
        let (length, offset) = field.split_at(self.pointer?);
        Some((number(length), number(offset)))
    }
}

fn columns(header: &Header) -> Result<Vec<Column>, Problem> {
    let count = header.size("TFIELDS", 1..=999)?;
    (1..=count)
        .map(|n| column(header, &format!("TFORM{n}")))
        .collect()
}

/// A column by its TFORM: repeat count and letter, for descriptors (P, Q) the letter of what they point to.
fn column(header: &Header, keyword: &str) -> Result<Column, Problem> {
    let form = header.text(keyword)?.unwrap_or_default();
    let refused = || {
        Problem::field(
            keyword,
            "a column of a compressed image",
            format!("'{form}'"),
        )
    };
    let letter = form
        .find(|c: char| !c.is_ascii_digit())
        .ok_or_else(refused)?;
    let repeat: u64 = match &form[..letter] {
        "" => 1,
        digits => digits
            .parse()
            .ok()
            .filter(|n| *n <= 1000)
            .ok_or_else(refused)?,
    };
    let mut letters = form[letter..].chars();
    let bytes_of = |letter| match letter {
        Some('B' | 'A' | 'L') => Some(1),
        Some('I') => Some(2),
        Some('J' | 'E') => Some(4),
        Some('K' | 'D') => Some(8),
        _ => None,
    };
    let fixed = |bytes| Column {
        bytes,
        pointer: None,
        element_bytes: 0,
    };
    match letters.next() {
        Some(kind @ ('P' | 'Q')) if repeat <= 1 => {
            let half = if kind == 'P' { 4 } else { 8 };
            Ok(Column {
                bytes: 2 * repeat * half as u64,
                pointer: (repeat == 1).then_some(half),
                element_bytes: bytes_of(letters.next()).ok_or_else(refused)?,
            })
        }
        other => Ok(fixed(repeat * bytes_of(other).ok_or_else(refused)?)),
    }
}
