//! A file that grows, of which only complete pieces count.
//!
//! When a disk was away and comes back, the same names belong to other files: the old file handles are useless. So a
//! file is opened again after each refusal, and continues where its complete pieces end.

use super::disk::{Disk, DiskFile};
use std::io::{self, ErrorKind};
use std::path::Path;

/// An open file, with the number of its valid bytes.
#[derive(Debug)]
pub(super) struct Growing {
    file: Box<dyn DiskFile>,
    /// Bytes of complete pieces. A failed attempt may have left more.
    whole: u64,
}

impl Growing {
    /// Makes a new file.
    pub fn create(disk: &dyn Disk, path: &Path) -> io::Result<Self> {
        let file = disk.create(path)?;
        Ok(Self { file, whole: 0 })
    }

    /// Opens a file of which the first `whole` bytes are valid.
    ///
    /// # Errors
    /// If it is gone, or has fewer bytes; or if the disk refuses.
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

    /// Writes after the complete pieces, over the remains of a failed attempt.
    pub fn append(&mut self, piece: &[u8]) -> io::Result<()> {
        self.file.cut(self.whole)?;
        self.file.write_all(piece)?;
        self.whole += piece.len() as u64;
        Ok(())
    }

    /// Syncs the file to the disk.
    pub fn sync(&mut self) -> io::Result<()> {
        self.file.sync()
    }
}
