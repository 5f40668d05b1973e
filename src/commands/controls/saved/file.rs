//! Location of saved values: write access to it, and the file's replacement.
//!
//! One program at a time holds the lock beside the file, and it replaces a file only if that begins like a file of saved values.

use super::SavedError;
use crate::archive::MARK;
use crate::archive::disk::{Absent, Disk, LocalDisk, Lock};
use crate::config::{Config, saved};
use crate::files;
use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

/// Location of saved values.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SavedValues {
    path: PathBuf,
    /// Whether the folder is an archive's, and must be recognised as one before anything is written there.
    in_archive: bool,
}

impl SavedValues {
    /// The configured file, else one in the archive; `None` if there is neither.
    pub fn of(config: &Config) -> Option<Self> {
        let configured = config.link.saved_values.clone();
        let in_archive = configured.is_none();
        let archive = config.archive.directory.as_deref();
        let path = configured.or_else(|| Some(archive?.join("values.toml")))?;
        Some(Self { path, in_archive })
    }

    /// The location given by the path of a file.
    pub fn at(path: &Path) -> Self {
        let (path, in_archive) = (path.into(), false);
        Self { path, in_archive }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Claims the file for this program alone before a flight begins; `None` if its folder does not exist yet, or cannot be written.
    ///
    /// # Errors
    /// If another program flies with it, or the configuration names a file of another kind.
    pub fn claim(&self) -> Result<Option<Lock>, SavedError> {
        let lock = match self.lock() {
            Ok(lock) => Some(lock),
            Err(taken @ SavedError::Taken { .. }) => return Err(taken),
            Err(_) => None,
        };
        match self.check_content() {
            // In the archive the name is the program's own: another file there costs the saved values, but not the flight.
            Err(foreign @ SavedError::Foreign { .. }) if !self.in_archive => Err(foreign),
            _ => Ok(lock),
        }
    }

    /// # Errors
    /// If another program holds it, the archive is missing, or the folder cannot be written.
    pub(super) fn lock(&self) -> Result<Lock, SavedError> {
        self.check_archive()?;
        LocalDisk
            .lock(&self.sibling("lock"), Absent::Made)
            .map_err(|cause| match cause.kind() {
                ErrorKind::ResourceBusy => SavedError::Taken {
                    path: self.path.clone(),
                },
                _ => self.failed(cause),
            })
    }

    /// Whether it is still the lock that was taken: a disk may have been mounted again.
    pub(super) fn is_held_by(&self, lock: &Lock) -> bool {
        lock.is_of(&self.sibling("lock"))
    }

    /// Checks that the archive is present: a disk that is not mounted leaves an empty folder, which is not the archive.
    pub(super) fn check_archive(&self) -> Result<(), SavedError> {
        let mark = self.folder().join(MARK);
        match self.in_archive && !mark.exists() {
            true => Err(SavedError::File {
                path: mark,
                cause: ErrorKind::NotFound.into(),
            }),
            false => Ok(()),
        }
    }

    /// # Errors
    /// If the file there is not one of saved values.
    fn check_content(&self) -> Result<(), SavedError> {
        self.bytes().map(drop)
    }

    /// The bytes of the file; `None` if there is no file.
    ///
    /// # Errors
    /// If it cannot be read, or is no file of saved values.
    pub(super) fn bytes(&self) -> Result<Option<Vec<u8>>, SavedError> {
        let foreign = |found| SavedError::Foreign {
            path: self.path.clone(),
            found,
        };
        match files::read_patiently(&self.path, saved::LARGEST) {
            Ok(bytes) if saved::is_values_file(&bytes) => Ok(Some(bytes)),
            Ok(_) => Err(foreign("another file".into())),
            Err(unread) if unread.is_absent() => Ok(None),
            Err(files::Unread::Io(cause)) => Err(self.failed(cause)),
            Err(unread) => Err(foreign(unread.found())),
        }
    }

    /// Replaces the file atomically. An incomplete new file left by a power cut is replaced the next time.
    ///
    /// # Errors
    /// If the folder cannot be written, or the file there is not one of saved values.
    pub(super) fn replace(&self, text: &str) -> Result<(), SavedError> {
        self.check_archive()?;
        self.check_content()?;
        // Not a name that the archive removes as unfinished: it may do so at any time.
        let new = self.sibling("new");
        let written = self.write_new(&new, text);
        if written.is_err() {
            let _ = fs::remove_file(&new);
        }
        written.map_err(|cause| self.failed(cause))
    }

    fn write_new(&self, new: &Path, text: &str) -> io::Result<()> {
        match fs::remove_file(new) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let mut file = File::create_new(new)?;
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(new, &self.path)?;
        // The name, too, must survive a power cut.
        File::open(self.folder())?.sync_all()
    }

    /// A file in the same folder, with a dot before its name and with an ending.
    fn sibling(&self, ending: &str) -> PathBuf {
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        self.folder().join(format!(".{name}.{ending}"))
    }

    fn folder(&self) -> &Path {
        match self.path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        }
    }

    fn failed(&self, cause: io::Error) -> SavedError {
        let path = self.path.clone();
        SavedError::File { path, cause }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::Store;
    use crate::fits::Compression;
    use std::sync::atomic::{AtomicBool, Ordering};

    fn refusal(file: &SavedValues) -> String {
        file.claim().unwrap_err().to_string()
    }

    #[test]
    fn a_named_file_that_is_something_else_is_refused_and_stays_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flight.toml");
        let text = "[camera]\nsource = \"simulated\"\n";
        fs::write(&path, text).unwrap();
        let file = SavedValues::at(&path);
        let refused = refusal(&file);
        let named = path.display().to_string();
        assert!(
            refused.starts_with(&named) && refused.ends_with("found another file"),
            "{refused}"
        );
        assert!(file.replace("").is_err());
        assert_eq!(fs::read_to_string(&path).unwrap(), text);
        for device in ["/dev/null", "/dev/zero"] {
            let refused = refusal(&SavedValues::at(Path::new(device)));
            assert!(
                refused.contains(device) && refused.contains("a device"),
                "{refused}"
            );
        }
        let refused = refusal(&SavedValues::at(folder.path()));
        assert!(refused.ends_with("found a directory"), "{refused}");
    }

    #[test]
    fn one_program_at_a_time_has_the_file_and_one_that_ends_leaves_it() {
        let folder = tempfile::tempdir().unwrap();
        let file = SavedValues::at(&folder.path().join("values.toml"));
        let held = file.claim().unwrap();
        assert!(held.is_some());
        let refused = refusal(&file);
        assert!(refused.contains("another program"), "{refused}");
        drop(held);
        assert!(file.claim().unwrap().is_some());
    }

    #[test]
    fn saving_never_fails_because_the_archive_is_swept() {
        let folder = tempfile::tempdir().unwrap();
        let file = SavedValues::at(&folder.path().join("values.toml"));
        let over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while !over.load(Ordering::Relaxed) {
                    Store::open(folder.path(), "demo", Compression::None).unwrap();
                }
            });
            let saved = (0..100).map(|_| file.replace(saved::HEADER));
            let saved: Vec<_> = saved.collect();
            over.store(true, Ordering::Relaxed);
            assert!(saved.iter().all(Result::is_ok), "{saved:?}");
        });
    }

    #[test]
    fn what_an_archive_sweeps_is_never_a_file_that_is_being_saved() {
        let file = SavedValues::at(Path::new("/flight/values.toml"));
        let new = file.sibling("new");
        assert_eq!(new, Path::new("/flight/.values.toml.new"));
        assert!(!new.to_string_lossy().ends_with(crate::archive::UNFINISHED));
    }
}
