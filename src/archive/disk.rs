//! The archive's operations on a disk, step by step, so that a test may substitute a disk that fills, fails or loses power
//! between any two steps.

use std::fmt::Debug;
use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind, Seek, SeekFrom, Write};
use std::os::unix::fs::{MetadataExt, symlink};
use std::path::{Path, PathBuf};
use tempfile::TempPath;

/// A disk, or a test's substitute. Every operation is on whole paths and may fail at any time.
pub trait Disk: Debug + Send + Sync {
    /// Makes a folder and its parent folders.
    fn make_root(&self, folder: &Path) -> io::Result<()>;

    /// Makes a folder in an existing one; [`ErrorKind::AlreadyExists`] if it exists already.
    fn make_folder(&self, folder: &Path) -> io::Result<()>;

    /// Makes a new file.
    fn create(&self, file: &Path) -> io::Result<Box<dyn DiskFile>>;

    /// Opens an existing file for appending; [`ErrorKind::NotFound`] if there is none.
    fn open(&self, file: &Path) -> io::Result<Box<dyn DiskFile>>;

    /// Renames a file atomically, and never replaces another one:
    /// [`ErrorKind::AlreadyExists`] then.
    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Syncs a folder's list of names to the disk.
    fn sync_folder(&self, folder: &Path) -> io::Result<()>;

    /// Removes a file.
    fn remove(&self, file: &Path) -> io::Result<()>;

    /// Removes a folder with its content.
    fn remove_tree(&self, folder: &Path) -> io::Result<()>;

    /// Makes a symbolic link to a name beside it, replacing an existing link atomically.
    fn link(&self, link: &Path, name: &Path) -> io::Result<()>;

    fn exists(&self, path: &Path) -> bool;

    /// Content of a folder.
    fn list(&self, folder: &Path) -> io::Result<Vec<Entry>>;

    /// Locks a file for this program alone; [`ErrorKind::ResourceBusy`] while another holds it.
    fn lock(&self, file: &Path, absent: Absent) -> io::Result<Lock>;

    fn space(&self, folder: &Path) -> io::Result<Space>;
}

/// Handling of a file that is to be locked and does not exist.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Absent {
    /// It is made.
    Made,
    /// It is an error.
    Refused,
}

/// A file that is being written.
pub trait DiskFile: Write + Debug + Send {
    /// Syncs the file's bytes to the disk.
    fn sync(&mut self) -> io::Result<()>;

    /// Length of the file, bytes.
    fn length(&mut self) -> io::Result<u64>;

    /// Truncates the file to `length` bytes; the next write goes there.
    fn cut(&mut self, length: u64) -> io::Result<()>;
}

/// A name in a folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    pub path: PathBuf,
    pub kind: EntryKind,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EntryKind {
    File,
    Folder,
    /// A link, a pipe, a device.
    Other,
}

/// The right to write to an archive, until it is dropped.
#[derive(Debug)]
pub struct Lock {
    /// `None` on a file system without locks.
    held: Option<File>,
}

impl Lock {
    /// A lock on a file system without locks.
    pub fn unguarded() -> Self {
        Self { held: None }
    }

    /// Whether `file` is still the one that was locked. After the disk was mounted again it is another file, which is not locked.
    pub fn is_of(&self, file: &Path) -> bool {
        let Some(held) = &self.held else {
            return true;
        };
        let identity = |found: fs::Metadata| (found.dev(), found.ino());
        let [held, there] = [held.metadata(), file.metadata()].map(|found| found.map(identity));
        matches!((held, there), (Ok(held), Ok(there)) if held == there)
    }
}

/// Capacity and free space of a disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Space {
    pub free_bytes: u64,
    pub total_bytes: u64,
    /// Number of files that can still be made (inodes); `None` if the file system does not count them.
    pub free_files: Option<u64>,
}

impl Space {
    /// 0 to 100; 0 for a disk without capacity.
    pub fn free_percent(self) -> f64 {
        if self.total_bytes == 0 {
            return 0.0;
        }
        100.0 * self.free_bytes as f64 / self.total_bytes as f64
    }
}

/// A folder tree of this computer.
#[derive(Debug, Clone, Copy, Default)]
pub struct LocalDisk;

impl Disk for LocalDisk {
    fn make_root(&self, folder: &Path) -> io::Result<()> {
        fs::create_dir_all(folder)
    }

    fn make_folder(&self, folder: &Path) -> io::Result<()> {
        fs::create_dir(folder)
    }

    fn create(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        Ok(Box::new(File::create_new(file)?))
    }

    fn open(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        Ok(Box::new(File::options().write(true).open(file)?))
    }

    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        let from = TempPath::try_from_path(from)?;
        from.persist_noclobber(to).map_err(|refused| refused.error)
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        File::open(folder)?.sync_all()
    }

    fn remove(&self, file: &Path) -> io::Result<()> {
        fs::remove_file(file)
    }

    fn remove_tree(&self, folder: &Path) -> io::Result<()> {
        fs::remove_dir_all(folder)
    }

    fn link(&self, link: &Path, name: &Path) -> io::Result<()> {
        let plain = link.file_name().unwrap_or_default().to_string_lossy();
        let new = link.with_file_name(format!(".{plain}.part"));
        let _ = fs::remove_file(&new);
        symlink(name, &new)?;
        fs::rename(&new, link)
    }

    fn exists(&self, path: &Path) -> bool {
        path.symlink_metadata().is_ok()
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<Entry>> {
        let entry = |entry: io::Result<fs::DirEntry>| {
            let entry = entry?;
            let kind = entry.file_type()?;
            Ok(Entry {
                path: entry.path(),
                kind: match (kind.is_file(), kind.is_dir()) {
                    (true, _) => EntryKind::File,
                    (_, true) => EntryKind::Folder,
                    _ => EntryKind::Other,
                },
            })
        };
        fs::read_dir(folder)?.map(entry).collect()
    }

    fn lock(&self, file: &Path, absent: Absent) -> io::Result<Lock> {
        let file = File::options()
            .create(absent == Absent::Made)
            .truncate(false)
            .write(true)
            .open(file)?;
        match file.try_lock() {
            Ok(()) => Ok(Lock { held: Some(file) }),
            Err(TryLockError::WouldBlock) => Err(ErrorKind::ResourceBusy.into()),
            // Some file systems have no locks; the archive is more important than its lock.
            Err(TryLockError::Error(_)) => Ok(Lock { held: Some(file) }),
        }
    }

    fn space(&self, folder: &Path) -> io::Result<Space> {
        let found = nix::sys::statvfs::statvfs(folder)?;
        let block = found.fragment_size();
        Ok(Space {
            free_bytes: found.blocks_available().saturating_mul(block),
            total_bytes: found.blocks().saturating_mul(block),
            free_files: (found.files() > 0).then(|| found.files_available()),
        })
    }
}

impl DiskFile for File {
    fn sync(&mut self) -> io::Result<()> {
        self.sync_all()
    }

    fn length(&mut self) -> io::Result<u64> {
        Ok(self.metadata()?.len())
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        if self.metadata()?.len() > length {
            self.set_len(length)?;
        }
        self.seek(SeekFrom::Start(length)).map(drop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disk_that_goes_before_its_mark_is_locked_gets_none_in_its_place() {
        let folder = tempfile::tempdir().unwrap();
        let mark = folder.path().join("mark");
        let gone = LocalDisk.lock(&mark, Absent::Refused).unwrap_err();
        assert_eq!(gone.kind(), ErrorKind::NotFound);
        assert!(!mark.exists());
        drop(LocalDisk.lock(&mark, Absent::Made).unwrap());
        assert!(LocalDisk.lock(&mark, Absent::Refused).is_ok());
    }
}
