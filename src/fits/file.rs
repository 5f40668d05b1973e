//! A FITS file in memory, from which several parts are read.

use super::choice::Size;
use super::structure::{Hdu, scan};
use super::{Checksums, FileError, Header, Problem, Table, checked_fits, gunzipped, read_bytes};
use super::{checksum, read, table};
use crate::frame::{Frame, FrameInfo};
use std::path::{Path, PathBuf};
use std::sync::PoisonError;

/// A FITS file that was read once and whose structure is complete. Each method reports faults of its own part.
#[derive(Debug)]
pub struct FitsFile {
    path: PathBuf,
    bytes: Vec<u8>,
    hdus: Vec<Hdu>,
    wanted: Option<Size>,
}

impl FitsFile {
    /// Reads a file into memory and checks its structure.
    ///
    /// # Errors
    /// A file that cannot be read, is no FITS file, or is shorter than its headers promise.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        let bytes = read_bytes(path).map_err(|problem| problem.in_file(path))?;
        Self::of(path, bytes)
    }

    /// The file of these bytes; messages name it by its path.
    ///
    /// # Errors
    /// Bytes that are no FITS file, or fewer than its headers promise.
    pub fn of(path: &Path, bytes: Vec<u8>) -> Result<Self, FileError> {
        let checked = || {
            let bytes = gunzipped(bytes)?;
            let hdus = scan(checked_fits(&bytes, "a FITS file")?)?;
            Ok((bytes, hdus))
        };
        let (bytes, hdus) = checked().map_err(|problem: Problem| problem.in_file(path))?;
        Ok(Self {
            path: path.into(),
            bytes,
            hdus,
            wanted: None,
        })
    }

    /// Selects, among several pictures, the first of this width and height, px, for the frame.
    pub fn of_size(mut self, wanted: Size) -> Self {
        self.wanted = Some(wanted);
        self
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The frame, as [`read_frame`](super::read_frame) reads it.
    ///
    /// # Errors
    /// As [`read_frame`](super::read_frame).
    pub fn frame(&self) -> Result<Frame, FileError> {
        self.named(read::read_fits(&self.bytes, &self.hdus, self.wanted))
    }

    /// Width and height of the image, px, and the physical values of its pixels, of any type: row by row as FITS stores them, the lowest
    /// first; NaN for a pixel without a value.
    ///
    /// # Errors
    /// As [`read_frame`](super::read_frame).
    pub fn values(&self) -> Result<([usize; 2], Vec<f32>), FileError> {
        self.named(read::read_values(&self.bytes, &self.hdus, self.wanted))
    }

    /// Result of `work` on the frame. A row is decoded when it is first read, if each row is a tile, and DATASUM and SATURATE are stated; else
    /// the whole frame is decoded before. Damage of a row that `work` does not read is not reported.
    ///
    /// # Errors
    /// As [`read_frame`](super::read_frame), and if a row that was read is damaged.
    pub fn with_frame<T>(self, work: impl FnOnce(&Frame) -> T) -> Result<T, FileError> {
        let named = |problem: Problem| problem.in_file(&self.path);
        let (frame, damage) =
            read::read_on_demand(self.bytes, &self.hdus, self.wanted).map_err(named)?;
        let made = work(&frame);
        let damage = damage.lock().unwrap_or_else(PoisonError::into_inner).take();
        damage.map_or(Ok(made), |problem| Err(named(problem)))
    }

    /// The keywords of the frame, the image's over the primary HDU's.
    ///
    /// # Errors
    /// A file without an image.
    pub fn keywords(&self) -> Result<Header, FileError> {
        self.named(read::read_keywords(&self.hdus, self.wanted))
    }

    /// The exposure data of the frame, and its keywords, without reading its pixels.
    ///
    /// # Errors
    /// A file without an image.
    pub fn info(&self) -> Result<(FrameInfo, Header), FileError> {
        self.named(read::read_headers(&self.hdus, self.wanted))
    }

    /// Checks every checksum of the file.
    ///
    /// # Errors
    /// If one does not match, or there are bytes that none covers.
    pub fn checksums(&self) -> Result<Checksums, FileError> {
        self.named(checksum::check_all(&self.bytes, &self.hdus))
    }

    /// The binary table with this name, `None` if the file has none. Its columns hold one number or one text in each row.
    ///
    /// # Errors
    /// If columns are of other kinds or scaled, or rows are missing.
    pub fn table(&self, name: &str) -> Result<Option<Table>, FileError> {
        self.named(table::read_table(&self.bytes, &self.hdus, name))
    }

    fn named<T>(&self, result: Result<T, Problem>) -> Result<T, FileError> {
        result.map_err(|problem| problem.in_file(&self.path))
    }
}
