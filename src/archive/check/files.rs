//! The files of an archive.

use super::BadFile;
use crate::archive::{CONFIGURATION, INSTRUMENT, UNFINISHED};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Error: a folder is no archive.
#[derive(Debug, thiserror::Error)]
#[error("{}: expected {expected}, found {found}", .path.display())]
pub struct TreeError {
    path: PathBuf,
    expected: &'static str,
    found: String,
}

impl TreeError {
    pub(in crate::archive) fn new(
        path: &Path,
        expected: &'static str,
        found: impl Into<String>,
    ) -> Self {
        Self {
            path: path.into(),
            expected,
            found: found.into(),
        }
    }
}

/// The files under a folder and its folders, except folders whose names begin with a dot.
#[derive(Debug, Default)]
pub struct Tree {
    /// Files whose names end in `.fits`, by path.
    pub files: Vec<PathBuf>,
    /// Solution logs, by path.
    pub logs: Vec<PathBuf>,
    /// Configurations and instruments, by path.
    pub flown: Vec<PathBuf>,
    /// Settings of the navigation, by path.
    pub navigation: Vec<PathBuf>,
    /// Number of unfinished files, by their names.
    pub unfinished: usize,
    /// Subfolders that could not be listed, with the reasons.
    pub unlisted: Vec<BadFile>,
}

impl Tree {
    /// Checks a folder.
    ///
    /// # Errors
    /// If the folder is missing, cannot be listed or has no `.fits` file.
    pub fn of(root: &Path) -> Result<Self, TreeError> {
        Self::of_all(&[root])
    }

    /// Checks several folders, such as those of an archive on two disks.
    ///
    /// # Errors
    /// If one is missing or cannot be listed, or none has a `.fits` file.
    pub fn of_all(roots: &[impl AsRef<Path>]) -> Result<Self, TreeError> {
        let mut tree = Self::default();
        let mut folders = Vec::new();
        for root in roots.iter().map(AsRef::as_ref) {
            tree.list(root, &mut folders).map_err(|cause| {
                TreeError::new(root, "a folder of frames", format!("\"{cause}\""))
            })?;
        }
        while let Some(folder) = folders.pop() {
            if let Err(cause) = tree.list(&folder, &mut folders) {
                tree.unlisted.push(BadFile {
                    file: folder.display().to_string(),
                    error: format!("expected to list the folder, found \"{cause}\""),
                });
            }
        }
        if tree.files.is_empty() && tree.unlisted.is_empty() {
            let found = format!("none, and {} unfinished", tree.unfinished);
            let first = roots.first().map_or(Path::new(""), AsRef::as_ref);
            let expected = "files whose names end in .fits";
            return Err(TreeError::new(first, expected, found));
        }
        for paths in [
            &mut tree.files,
            &mut tree.logs,
            &mut tree.flown,
            &mut tree.navigation,
        ] {
            paths.sort();
            paths.dedup();
        }
        Ok(tree)
    }

    fn list(&mut self, folder: &Path, folders: &mut Vec<PathBuf>) -> io::Result<()> {
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            let path = entry.path();
            let hidden = entry.file_name().as_encoded_bytes().starts_with(b".");
            // The type of the link itself: a link to a folder may lead back here.
            match (entry.file_type()?.is_dir(), hidden) {
                (true, true) => {}
                (true, false) => folders.push(path),
                (false, true) => self.unfinished += usize::from(is_unfinished(&path)),
                (false, false) if is_fits(&path) => self.files.push(path),
                (false, false) if is_log(&path) => self.logs.push(path),
                (false, false) if is_flown(&path) => self.flown.push(path),
                (false, false) if is_navigation(&path) => self.navigation.push(path),
                (false, false) => {}
            }
        }
        Ok(())
    }
}

/// Whether a name that begins with a dot is that of an unfinished file.
fn is_unfinished(path: &Path) -> bool {
    path.as_os_str()
        .as_encoded_bytes()
        .ends_with(UNFINISHED.as_bytes())
}

/// Whether the file holds settings of the navigation.
pub(in crate::archive) fn is_navigation(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with("navigation_") && name.ends_with(".toml")
}

fn is_log(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with("solutions_") && name.ends_with(".csv")
}

pub(in crate::archive) fn is_flown(path: &Path) -> bool {
    CONFIGURATION.names(path) || INSTRUMENT.names(path)
}

pub(in crate::archive) fn is_fits(path: &Path) -> bool {
    path.extension()
        .is_some_and(|end| end.eq_ignore_ascii_case("fits"))
}

/// The named files, and for each named folder the files in it.
///
/// # Errors
/// If [`Tree::of`] refuses a folder, or a subfolder cannot be listed.
pub fn frames_of(paths: &[PathBuf]) -> Result<Vec<PathBuf>, TreeError> {
    let mut files = Vec::new();
    for path in paths {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let tree = Tree::of(path)?;
        if let Some(folder) = tree.unlisted.first() {
            let expected = "a folder that can be listed";
            return Err(TreeError::new(
                Path::new(&folder.file),
                expected,
                &folder.error,
            ));
        }
        files.extend(tree.files);
    }
    Ok(files)
}
