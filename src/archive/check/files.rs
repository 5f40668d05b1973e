//! The files of an archive.

use super::BadFile;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// A folder that is no archive.
#[derive(Debug, thiserror::Error)]
#[error("{}: expected {expected}, found {found}", .path.display())]
pub struct TreeError {
    path: PathBuf,
    expected: &'static str,
    found: String,
}

/// The files under a folder and its folders, except folders whose names begin with a dot.
#[derive(Debug, Default)]
pub struct Tree {
    /// Those whose names end in `.fits`, by path.
    pub files: Vec<PathBuf>,
    /// How many names begin with a dot.
    pub unfinished: usize,
    /// Folders within that could not be listed, and why.
    pub unlisted: Vec<BadFile>,
}

impl Tree {
    /// Looks through a folder.
    ///
    /// # Errors
    /// A folder that is missing, cannot be listed or has no `.fits` file.
    pub fn of(root: &Path) -> Result<Self, TreeError> {
        let error = |expected, found| TreeError {
            path: root.into(),
            expected,
            found,
        };
        let mut tree = Self::default();
        let mut folders = Vec::new();
        tree.list(root, &mut folders)
            .map_err(|cause| error("a folder of frames", format!("\"{cause}\"")))?;
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
            return Err(error("files whose names end in .fits", found));
        }
        tree.files.sort();
        Ok(tree)
    }

    fn list(&mut self, folder: &Path, folders: &mut Vec<PathBuf>) -> io::Result<()> {
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            let path = entry.path();
            let hidden = entry.file_name().as_encoded_bytes().starts_with(b".");
            // Of the link itself: a link to a folder may lead back here.
            match (entry.file_type()?.is_dir(), hidden) {
                (true, true) => {}
                (true, false) => folders.push(path),
                (false, true) => self.unfinished += 1,
                (false, false) if is_fits(&path) => self.files.push(path),
                (false, false) => {}
            }
        }
        Ok(())
    }
}

fn is_fits(path: &Path) -> bool {
    path.extension()
        .is_some_and(|end| end.eq_ignore_ascii_case("fits"))
}

/// Files as they are named, and for each folder the files in it.
///
/// # Errors
/// A folder that [`Tree::of`] refuses, or one within that cannot be listed.
pub fn frames_of(paths: &[PathBuf]) -> Result<Vec<PathBuf>, TreeError> {
    let mut files = Vec::new();
    for path in paths {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let tree = Tree::of(path)?;
        if let Some(folder) = tree.unlisted.first() {
            return Err(TreeError {
                path: PathBuf::from(&folder.file),
                expected: "a folder that can be listed",
                found: folder.error.clone(),
            });
        }
        files.extend(tree.files);
    }
    Ok(files)
}
