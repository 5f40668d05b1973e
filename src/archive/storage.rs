//! Storage of an archive's files, and their list; a folder tree of this computer.

use super::check::{BadFile, Tree, TreeError};
use crate::fits::{self, Problem};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fmt::Debug;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// A frame's file as listed by its storage. A file whose size or time has changed is another file.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct StoredFile {
    /// Path relative to the archive, with `/` between folders.
    pub file: String,
    pub bytes: u64,
    /// Time of the last change of the file, ns since 1970.
    pub written_ns: i64,
}

/// The files of an archive, relative to it and sorted by path.
#[derive(Debug, Default)]
pub struct Listing {
    pub frames: Vec<StoredFile>,
    /// Configurations and instruments.
    pub flown: Vec<String>,
    /// Settings of the navigation, `navigation_*.toml`, in the archive's root.
    pub navigation: Vec<String>,
    /// Folders that could not be listed, with the reasons.
    pub unlisted: Vec<BadFile>,
}

/// Storage of an archive's files. All names are relative to it.
pub(super) trait Storage: Debug + Send + Sync {
    /// Lists the files, in any order.
    ///
    /// # Errors
    /// If the storage cannot be listed or holds no frames.
    fn list(&self) -> Result<Listing, TreeError>;

    /// The bytes of a file.
    ///
    /// # Errors
    /// [`Problem::Io`] if another attempt may succeed.
    fn read(&self, file: &str) -> Result<Vec<u8>, Problem>;

    /// The first [`fits::START_BYTES`] of a file.
    ///
    /// # Errors
    /// As [`Storage::read`].
    fn read_start(&self, file: &StoredFile) -> Result<Vec<u8>, Problem>;
}

/// A folder tree of this machine.
#[derive(Debug)]
pub(super) struct Folder {
    root: PathBuf,
    /// A subfolder whose files do not belong to the archive.
    results: Option<PathBuf>,
}

impl Folder {
    /// Files under `results` do not belong to the archive.
    pub fn new(root: &Path, results: &Path) -> Self {
        let full = |path: &Path| path.canonicalize().ok();
        let nested = full(root).zip(full(results));
        let nested = nested.filter(|(root, results)| results.starts_with(root));
        Self {
            root: root.into(),
            results: nested.map(|(_, results)| results),
        }
    }

    fn is_own(&self, path: &Path) -> bool {
        let Some(results) = &self.results else {
            return true;
        };
        let full = path.canonicalize();
        full.map_or(true, |path| !path.starts_with(results))
    }

    fn relative(&self, path: &Path) -> String {
        let relative = path.strip_prefix(&self.root).unwrap_or(path);
        let parts = relative.components();
        let parts: Vec<_> = parts
            .map(|part| part.as_os_str().to_string_lossy())
            .collect();
        parts.join("/")
    }

    fn stored(&self, path: &Path) -> StoredFile {
        let metadata = path.metadata().ok();
        let written = metadata.as_ref().and_then(|m| m.modified().ok());
        let since = written.and_then(|time| time.duration_since(UNIX_EPOCH).ok());
        StoredFile {
            file: self.relative(path),
            bytes: metadata.map_or(0, |m| m.len()),
            written_ns: since.map_or(0, |since| since.as_nanos() as i64),
        }
    }
}

impl Storage for Folder {
    fn list(&self) -> Result<Listing, TreeError> {
        let tree = Tree::of(&self.root)?;
        let files = tree.files.par_iter().filter(|path| self.is_own(path));
        let in_root = tree.navigation.iter();
        let in_root = in_root.filter(|path| path.parent() == Some(&self.root));
        Ok(Listing {
            frames: files.map(|path| self.stored(path)).collect(),
            flown: tree.flown.iter().map(|path| self.relative(path)).collect(),
            navigation: in_root.map(|path| self.relative(path)).collect(),
            unlisted: tree.unlisted,
        })
    }

    fn read(&self, file: &str) -> Result<Vec<u8>, Problem> {
        fits::read_bytes(&self.root.join(file))
    }

    fn read_start(&self, file: &StoredFile) -> Result<Vec<u8>, Problem> {
        fits::read_start(&self.root.join(&file.file))
    }
}
