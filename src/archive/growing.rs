//! A file that grows, of which only whole pieces count.
//!
//! A disk that was away has other files under the same names when it is back: the old file handles are useless. So a
//! file is opened again after each refusal, and continues where its whole pieces end.

use super::disk::{Disk, DiskFile};
use std::io::{self, ErrorKind};
use std::path::Path;

/// A file that is open, with the number of its bytes that count.
#[derive(Debug)]
pub(super) struct Growing {
    file: Box<dyn DiskFile>,
    /// Bytes of whole pieces. An attempt that failed may have left more.
    whole: u64,
}

impl Growing {
    /// Makes a new file.
    pub fn create(disk: &dyn Disk, path: &Path) -> io::Result<Self> {
        let file = disk.create(path)?;
        Ok(Self { file, whole: 0 })
    }

    /// Opens a file of which the first `whole` bytes count.
    ///
    /// # Errors
    /// Where it is gone, or has fewer bytes; or where the disk refuses.
    pub fn open(disk: &dyn Disk, path: &Path, whole: u64) -> io::Result<Self> {
        let mut file = disk.open(path)?;
        match file.length()? {
            length if length < whole => Err(ErrorKind::UnexpectedEof.into()),
            _ => Ok(Self { file, whole }),
        }
    }

    pub fn whole(&self) -> u64 {
        self.whole
    }

    /// Writes behind the whole pieces, in place of what an attempt that failed may have left there.
    pub fn append(&mut self, piece: &[u8]) -> io::Result<()> {
        self.file.cut(self.whole)?;
        self.file.write_all(piece)?;
        self.whole += piece.len() as u64;
        Ok(())
    }

    /// Brings the file to the disk.
    pub fn sync(&mut self) -> io::Result<()> {
        self.file.sync()
    }
}
