//! Reading and writing of frames and their keywords.
//!
//! Reading accepts FITS (plain, gzipped or tile-compressed; the image of the wanted size or the first one, in any HDU),
//! PNG, TIFF and JPEG; the first bytes of a file determine its format. A file is read into memory and its structure is
//! checked against its size before anything is allocated for it: a truncated, hostile or foreign file gives one line of
//! error, see [`FileError`]. Writing makes a primary HDU without data, an image extension with every keyword beside
//! the pixels, and binary tables, each HDU with its checksums.
//!
//! Both are implemented here, in safe code: a reader of foreign or damaged files has to check every size and offset anyway, and
//! storing a flight's frame must cost no more than solving it. The tests compare both with cfitsio, which shares no code with them. The
//! keywords are those of one table, [`keyword`].
//!
//! Tables of other programs, and tables larger than memory, are read and written by cfitsio: [`DiskFile`], [`AmendedTable`].

mod amended_table;
mod by_cfitsio;
mod cards;
mod checksum;
mod choice;
mod compressed;
mod disk_file;
mod error;
mod file;
mod form;
mod header;
mod images;
mod info;
pub mod keyword;
mod layout;
mod listing;
mod pack;
mod picture;
mod place;
mod quantised;
mod read;
mod reals;
mod rice;
mod saturation;
mod section;
mod stream;
mod structure;
mod table;
mod tiffs;
mod tile_table;
mod times;
mod unit;
mod values;
mod write;

pub use amended_table::{AmendedTable, Inward};
pub use by_cfitsio::open_disk_file;
pub use cards::{clock_cards, format_time, modified_julian_date, zero_cards};
pub use checksum::Checksums;
pub use disk_file::{DiskFile, DiskHdu, NumberColumn};
pub use error::{FileError, Problem};
pub use file::FitsFile;
pub use header::{Card, Header, Value};
pub use images::{Image, Samples, encode_images};
pub use listing::{
    FRAME_ENDINGS, Listing, Unlisted, is_frame_name, is_hidden, list_folder, list_tree,
};
pub use pack::{Compression, Packing};
pub use place::place_cards;
pub use reals::frame_of_values;
pub use stream::{CellForm, StoredColumn, StoredRow, TableFile};
pub use write::{Column, FRAME_EXTENSION, Table, Values, encode_frame, write_frame};

use crate::files::{self, Unread};
use crate::frame::{Frame, FrameInfo};
use flate2::read::MultiGzDecoder;
use std::io::Read;
use std::path::Path;

/// The largest file that is read, bytes, before and after gunzip.
const MAX_BYTES: u64 = 512 << 20;

/// Length of the beginning of a file in which its headers are searched first, bytes.
pub const START_BYTES: u64 = 1 << 16;

/// The largest image that is read, pixels.
const MAX_PIXELS: u64 = 1 << 26;

/// Reads a frame from a FITS, PNG, TIFF or JPEG file; of several pictures in a file, the first.
///
/// Pixels are integers of 8 or 16 bits; others are [scaled to 16](FrameInfo::warnings). The keywords of the image's HDU take precedence over
/// those of the primary one. A keyword that cannot be used, and anything else that is not read unchanged, is a warning of the frame.
///
/// # Errors
/// Any reason why the file is no such frame, in one line that names the file, the field and the expected
/// content; also data that do not match their DATASUM.
pub fn read_frame(path: &Path) -> Result<Frame, FileError> {
    read_picture(path, None)
}

/// The same; of several pictures in a file, the first of this width and height, px, if there is one.
///
/// # Errors
/// As [`read_frame`].
pub fn read_frame_of_size(path: &Path, wanted: [usize; 2]) -> Result<Frame, FileError> {
    read_picture(path, Some(wanted))
}

fn read_picture(path: &Path, wanted: Option<[usize; 2]>) -> Result<Frame, FileError> {
    let read = |bytes: Vec<u8>| match picture::format_of(&bytes) {
        Some(format) => picture::read_picture(&bytes, format, wanted),
        None => {
            let bytes = checked_fits(&bytes, "a FITS, PNG, TIFF or JPEG file")?;
            read::read_fits(bytes, &structure::scan(bytes)?, wanted)
        }
    };
    read_bytes(path)
        .and_then(gunzipped)
        .and_then(read)
        .map_err(|problem| problem.in_file(path))
}

/// Reads the keywords of a frame's FITS file, the image's over the primary HDU's, and none of its pixels.
pub fn read_keywords(path: &Path) -> Result<Header, FileError> {
    FitsFile::open(path)?.keywords()
}

/// The exposure data of a frame, and the keywords of its FITS file. If its image's header is near the beginning, no more is read.
///
/// # Errors
/// A file that cannot be read or is no FITS file with an image.
pub fn read_info(path: &Path) -> Result<(FrameInfo, Header), FileError> {
    let start = read_start(path).unwrap_or_default();
    info_of_start(&start).map_or_else(|| FitsFile::open(path)?.info(), Ok)
}

/// The same from the first [`START_BYTES`] of a file; `None` if its image's header does not end within them.
pub fn info_of_start(start: &[u8]) -> Option<(FrameInfo, Header)> {
    read::read_headers(&structure::begun(start), None).ok()
}

/// Checks every checksum of a FITS file; an error if one does not match.
pub fn check_sums(path: &Path) -> Result<Checksums, FileError> {
    FitsFile::open(path)?.checksums()
}

/// Reads the binary table with this name from a FITS file, `None` if it has none; see [`FitsFile::table`].
pub fn read_table(path: &Path, name: &str) -> Result<Option<Table>, FileError> {
    FitsFile::open(path)?.table(name)
}

/// The first [`START_BYTES`] of a file.
///
/// # Errors
/// A file that cannot be read.
pub fn read_start(path: &Path) -> Result<Vec<u8>, Problem> {
    read_at_most(path, START_BYTES)
}

/// The bytes of a file.
///
/// # Errors
/// If the file cannot be read, or is larger than 512 MiB.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>, Problem> {
    let bytes = read_at_most(path, MAX_BYTES + 1)?;
    check_length(bytes.len() as u64)?;
    Ok(bytes)
}

/// Refuses a file that is larger than 512 MiB.
pub(crate) fn check_length(bytes: u64) -> Result<(), Problem> {
    match bytes <= MAX_BYTES {
        true => Ok(()),
        false => Err(Problem::content(
            format!("a file of at most {MAX_BYTES} bytes"),
            "a larger one",
        )),
    }
}

fn read_at_most(path: &Path, most: u64) -> Result<Vec<u8>, Problem> {
    files::read_start(path, most).map_err(Problem::of_unread)
}

impl Problem {
    pub(crate) fn of_unread(unread: Unread) -> Self {
        match unread {
            Unread::Io(cause) => Self::unread(cause),
            other => Self::content(other.expected(), other.found()),
        }
    }
}

/// The bytes of a file, gunzipped if need be.
fn gunzipped(bytes: Vec<u8>) -> Result<Vec<u8>, Problem> {
    let [0x1f, 0x8b, ..] = bytes.as_slice() else {
        return Ok(bytes);
    };
    let mut whole = Vec::new();
    let mut unzipped = MultiGzDecoder::new(bytes.as_slice()).take(MAX_BYTES + 1);
    let read = unzipped.read_to_end(&mut whole);
    read.map_err(|error| Problem::content("a whole gzip file", error.to_string()))?;
    check_length(whole.len() as u64)?;
    Ok(whole)
}

/// The bytes, if they begin as a FITS file does.
fn checked_fits<'a>(bytes: &'a [u8], expected: &str) -> Result<&'a [u8], Problem> {
    if bytes.is_empty() {
        return Err(Problem::content(expected, "an empty file"));
    }
    if bytes.starts_with(b"SIMPLE  =") {
        return Ok(bytes);
    }
    let shown = bytes.len().min(12);
    let found = format!(
        "a file that begins with \"{}\"",
        bytes[..shown].escape_ascii()
    );
    Err(Problem::content(expected, found))
}
