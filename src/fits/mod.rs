//! A frame and its keywords, from a file and to a file.
//!
//! Reading takes FITS (plain, gzipped or tile-compressed; the first image with two axes, wherever it stands) and
//! greyscale PNG and TIFF; what a file is, its first bytes decide. A file is read into memory and its skeleton
//! checked against its size before anything is allocated for it: a truncated, hostile or foreign file is one line of
//! error, see [`FileError`]. Writing makes a primary HDU without data, an image extension with every keyword beside
//! the pixels, and binary tables, each HDU with its checksums.
//!
//! Both are done here, in safe code: a reader of foreign or damaged files has to check every size and offset anyway, and a
//! flight's frames are to cost no more to store than to solve. The tests hold both against cfitsio, which shares nothing with them. The
//! keywords are those of one table, [`keyword`].

mod checksum;
mod compressed;
mod error;
mod file;
mod form;
mod header;
mod info;
pub mod keyword;
mod layout;
mod listing;
mod pack;
mod picture;
mod place;
mod read;
mod rice;
mod structure;
mod table;
mod unit;
mod write;

pub use checksum::Checksums;
pub use error::{FileError, Problem};
pub use file::FitsFile;
pub use header::{Card, Header, Value};
pub use info::{clock_cards, format_time};
pub use listing::{FRAME_ENDINGS, Listing, Unlisted, list_folder, list_tree};
pub use pack::{Compression, Packing};
pub use write::{Column, FRAME_EXTENSION, Table, Values, encode_frame, encode_tables, write_frame};

use crate::frame::{Frame, FrameInfo};
use flate2::read::MultiGzDecoder;
use image::ImageFormat;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// The largest file that is read, bytes, before and after gunzip.
const MAX_BYTES: u64 = 512 << 20;

/// Where the headers of a frame's file are looked for first, bytes.
const START_BYTES: u64 = 1 << 16;

/// The largest image that is read.
const MAX_PIXELS: u64 = 1 << 26;

/// Reads a frame from a FITS, PNG or TIFF file.
///
/// Pixels are 8 bit, or 16 bit (unsigned, or signed with no negative value). The keywords of the image's HDU go over
/// those of the primary one.
///
/// # Errors
/// Anything that keeps the file from being such a frame, in one line that names the file, the field and what was
/// expected there; data that do not match their DATASUM too.
pub fn read_frame(path: &Path) -> Result<Frame, FileError> {
    let read = |bytes: Vec<u8>| match bytes.as_slice() {
        bytes @ [0x89, b'P', b'N', b'G', ..] => picture::read_picture(bytes, ImageFormat::Png),
        bytes @ ([b'I', b'I', 42, 0, ..] | [b'M', b'M', 0, 42, ..]) => {
            picture::read_picture(bytes, ImageFormat::Tiff)
        }
        bytes => {
            let bytes = checked_fits(bytes, "a FITS, PNG or TIFF file")?;
            read::read_fits(bytes, &structure::scan(bytes)?)
        }
    };
    load(path)
        .and_then(read)
        .map_err(|problem| problem.in_file(path))
}

/// Reads the keywords of a frame's FITS file, the image's over the primary HDU's, and none of its pixels.
pub fn read_keywords(path: &Path) -> Result<Header, FileError> {
    FitsFile::open(path)?.keywords()
}

/// How a frame was taken, and the keywords of its FITS file. Where its image's header stands near the beginning, no more is read.
///
/// # Errors
/// A file that cannot be read or is no FITS file with an image.
pub fn read_info(path: &Path) -> Result<(FrameInfo, Header), FileError> {
    let mut start = Vec::new();
    // A pipe would wait for its writer.
    if path.metadata().is_ok_and(|metadata| metadata.is_file()) {
        let read = File::open(path).and_then(|file| file.take(START_BYTES).read_to_end(&mut start));
        read.unwrap_or_default();
    }
    if let Ok(header) = read::read_keywords(&structure::begun(&start)) {
        let info = info::read_info(&header).map_err(|problem| problem.in_file(path))?;
        return Ok((info, header));
    }
    FitsFile::open(path)?.info()
}

/// Checks every checksum of a FITS file; an error where one does not match.
pub fn check_sums(path: &Path) -> Result<Checksums, FileError> {
    FitsFile::open(path)?.checksums()
}

/// Reads the binary table of a name from a FITS file, `None` where it has none; see [`FitsFile::table`].
pub fn read_table(path: &Path, name: &str) -> Result<Option<Table>, FileError> {
    FitsFile::open(path)?.table(name)
}

/// The bytes of a file, gunzipped if need be.
fn load(path: &Path) -> Result<Vec<u8>, Problem> {
    let refused = |cause| Problem::Io {
        action: "read",
        cause,
    };
    // Opening a pipe would wait for its writer, so what the path is comes first.
    let metadata = std::fs::metadata(path).map_err(refused)?;
    if !metadata.is_file() {
        let found = if metadata.is_dir() {
            "a directory"
        } else {
            "a device or pipe"
        };
        return Err(Problem::content("a file", found));
    }
    let bytes = read_bounded(File::open(path).map_err(refused)?).map_err(refused)?;
    let bytes = match bytes.as_slice() {
        [0x1f, 0x8b, ..] => read_bounded(MultiGzDecoder::new(bytes.as_slice()))
            .map_err(|error| Problem::content("a whole gzip file", error.to_string()))?,
        _ => bytes,
    };
    if bytes.len() as u64 > MAX_BYTES {
        return Err(Problem::content(
            format!("a file of at most {MAX_BYTES} bytes"),
            "a larger one",
        ));
    }
    Ok(bytes)
}

/// Reads to the end, or one byte more than may be read.
fn read_bounded(source: impl Read) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    source.take(MAX_BYTES + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The bytes, if they begin as FITS does.
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
