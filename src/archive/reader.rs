//! Reading of an archive: from a folder of this computer, or, with the feature `object-store`, from objects under a prefix of an object store.

use super::check::TreeError;
use super::flown::{FlownFile, FlownFiles};
use super::storage::{Folder, Listing, Storage, StoredFile};
use crate::fits::{self, FileError, FitsFile, Header, Problem};
use crate::frame::FrameInfo;
use crate::instrument::TomlError;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Number of successive requests, each with its retries, after whose failure an object store is lost.
const MOST_FAILURES: usize = 16;

/// An archive for reading. It records which of its files temporarily could not be read.
#[derive(Debug)]
pub struct ArchiveReader {
    name: PathBuf,
    storage: Box<dyn Storage>,
    unread: Mutex<BTreeMap<String, String>>,
    failures_in_a_row: AtomicUsize,
}

impl ArchiveReader {
    /// An archive by its folder, or by its URL, such as `s3://bucket/flight`. Files of a folder under `results` do not belong to it.
    ///
    /// # Errors
    /// If a URL is of no object store; for any URL, if the program is built without the feature `object-store`.
    pub fn open(archive: &Path, results: &Path) -> Result<Self, TreeError> {
        let storage: Box<dyn Storage> = match url(archive) {
            Some(url) => at_url(archive, url)?,
            None => Box::new(Folder::new(archive, results)),
        };
        Ok(Self {
            name: archive.into(),
            storage,
            unread: Mutex::default(),
            failures_in_a_row: AtomicUsize::new(0),
        })
    }

    /// The folder, or the URL.
    pub fn name(&self) -> &Path {
        &self.name
    }

    /// Whether reading waits for a network.
    pub fn is_remote(&self) -> bool {
        url(&self.name).is_some()
    }

    /// Lists the archive's files. Subfolders that cannot be listed count as files that could not be read.
    ///
    /// # Errors
    /// If the archive cannot be listed or holds no frames.
    pub fn list(&self) -> Result<Listing, TreeError> {
        let mut listing = self.storage.list()?;
        let path = |file: &StoredFile| PathBuf::from(&file.file);
        listing.frames.par_sort_by_cached_key(path);
        listing.flown.sort();
        listing.navigation.sort();
        let unlisted = listing.unlisted.iter().cloned();
        self.unread()
            .extend(unlisted.map(|bad| (bad.file, bad.error)));
        Ok(listing)
    }

    /// Reads a FITS file.
    ///
    /// # Errors
    /// If the file cannot be read, or is no complete FITS file.
    pub fn open_file(&self, file: &str) -> Result<FitsFile, FileError> {
        let path = self.name.join(file);
        let bytes = self.noted(file, || self.storage.read(file));
        FitsFile::of(&path, bytes.map_err(|problem| problem.in_file(&path))?)
    }

    /// Exposure data and keywords of a frame; reads only the start of its file, if that holds its headers.
    ///
    /// # Errors
    /// As [`fits::read_info`].
    pub fn info(&self, file: &StoredFile) -> Result<(FrameInfo, Header), FileError> {
        let path = self.name.join(&file.file);
        let start = self.noted(&file.file, || self.storage.read_start(file));
        let start = start.map_err(|problem| problem.in_file(&path))?;
        fits::info_of_start(&start).map_or_else(|| self.open_file(&file.file)?.info(), Ok)
    }

    /// Reads a text file: its path for messages, and its text.
    ///
    /// # Errors
    /// If the file cannot be read or is no text.
    pub fn text(&self, file: &str) -> Result<(PathBuf, String), TomlError> {
        let path = self.name.join(file);
        let refused = |found: String| TomlError::new(&path, "", "a readable text file", found);
        let bytes = self.noted(file, || self.storage.read(file));
        let bytes = bytes.map_err(|problem| refused(problem.to_string()))?;
        let text = String::from_utf8(bytes).map_err(|error| refused(error.to_string()))?;
        Ok((path, text))
    }

    /// Reads configurations and instruments.
    ///
    /// # Errors
    /// The error of the first file that cannot be read.
    pub fn flown(&self, files: &[String]) -> Result<FlownFiles, TomlError> {
        let file = |file: &String| {
            let (path, text) = self.text(file)?;
            Ok(FlownFile::new(path, text))
        };
        files.iter().map(file).collect()
    }

    /// Files that could not be read, though another attempt may succeed, each with the reason of the last attempt.
    pub fn unread_files(&self) -> BTreeMap<String, String> {
        self.unread().clone()
    }

    /// Whether the object store no longer answers: no more requests are sent to it.
    pub fn is_lost(&self) -> bool {
        self.is_remote() && self.failures_in_a_row.load(Ordering::Relaxed) >= MOST_FAILURES
    }

    /// Passes on the result of an attempt to read a file; records errors after which another attempt may succeed.
    fn noted<T>(
        &self,
        file: &str,
        read: impl FnOnce() -> Result<T, Problem>,
    ) -> Result<T, Problem> {
        if self.is_lost() {
            return Err(Problem::Io {
                action: "read",
                cause: io::Error::other("the object store does not answer"),
            });
        }
        let read = read();
        match &read {
            Err(Problem::Io { cause, .. }) => {
                if cause.kind() != ErrorKind::NotFound {
                    self.failures_in_a_row.fetch_add(1, Ordering::Relaxed);
                }
                self.unread().insert(file.into(), cause.to_string());
            }
            _ => {
                self.failures_in_a_row.store(0, Ordering::Relaxed);
                self.unread().remove(file);
            }
        }
        read
    }

    fn unread(&self) -> MutexGuard<'_, BTreeMap<String, String>> {
        self.unread.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The text of a URL; `None` for a path.
fn url(archive: &Path) -> Option<&str> {
    archive.to_str().filter(|text| text.contains("://"))
}

#[cfg(feature = "object-store")]
fn at_url(_: &Path, url: &str) -> Result<Box<dyn Storage>, TreeError> {
    Ok(Box::new(super::objects::Objects::open(url)?))
}

#[cfg(not(feature = "object-store"))]
fn at_url(archive: &Path, _: &str) -> Result<Box<dyn Storage>, TreeError> {
    let found = "a URL, which needs a program built with `--features object-store`";
    Err(TreeError::new(archive, "a folder", found))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails as often as specified, and then answers.
    #[derive(Debug)]
    struct Unsteady {
        failures: AtomicUsize,
        kind: ErrorKind,
    }

    impl Storage for Unsteady {
        fn list(&self) -> Result<Listing, TreeError> {
            Ok(Listing::default())
        }

        fn read(&self, _: &str) -> Result<Vec<u8>, Problem> {
            let count = |left: usize| left.checked_sub(1);
            let (set, get) = (Ordering::Relaxed, Ordering::Relaxed);
            match self.failures.fetch_update(set, get, count) {
                Ok(_) => Err(Problem::Io {
                    action: "read",
                    cause: self.kind.into(),
                }),
                Err(_) => Ok(b"text".into()),
            }
        }

        fn read_start(&self, file: &StoredFile) -> Result<Vec<u8>, Problem> {
            self.read(&file.file)
        }
    }

    fn reader(name: &str, failures: usize, kind: ErrorKind) -> ArchiveReader {
        let failures = AtomicUsize::new(failures);
        ArchiveReader {
            name: name.into(),
            storage: Box::new(Unsteady { failures, kind }),
            unread: Mutex::default(),
            failures_in_a_row: AtomicUsize::new(0),
        }
    }

    #[test]
    fn a_file_that_was_read_at_last_is_no_longer_counted_as_unread() {
        let reader = reader("s3://bucket/flight", 2, ErrorKind::TimedOut);
        assert!(reader.text("a.toml").is_err());
        assert!(reader.text("b.toml").is_err());
        assert_eq!(reader.unread_files().len(), 2);
        let (path, text) = reader.text("a.toml").unwrap();
        assert_eq!(path.to_str(), Some("s3://bucket/flight/a.toml"));
        assert_eq!(text, "text");
        assert_eq!(
            reader.unread_files().into_keys().collect::<Vec<_>>(),
            ["b.toml"]
        );
    }

    #[test]
    fn an_object_store_that_does_not_answer_is_asked_no_more() {
        let url = "s3://bucket/flight";
        let lost = |name, failures, kind| {
            let reader = reader(name, failures, kind);
            for _ in 0..40 {
                let _ = reader.text("a.toml");
            }
            reader.is_lost()
        };
        assert!(lost(url, 16, ErrorKind::TimedOut));
        assert!(!lost(url, 15, ErrorKind::TimedOut), "it answers again");
        assert!(!lost(url, 40, ErrorKind::NotFound), "it does answer");
        assert!(
            !lost("folder", 40, ErrorKind::TimedOut),
            "a disk may be damaged in part"
        );
    }
}
