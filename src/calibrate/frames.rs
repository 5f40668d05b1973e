//! The frames that a calibration is given: their files, their hash, what is wrong with some of them.

use rayon::prelude::*;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// Endings of the files that are taken for frames.
const ENDINGS: [&str; 8] = [
    ".fits", ".fit", ".fts", ".fits.gz", ".fits.fz", ".png", ".tif", ".tiff",
];

/// A frame that does not take part, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct LeftOut {
    pub name: String,
    pub reason: String,
}

/// How many frames are left out and why the first is, for an error that may come of it.
pub fn first_of(left_out: &[LeftOut]) -> String {
    match left_out.first() {
        Some(first) => format!(
            "{} frames left out, the first {}: {}",
            left_out.len(),
            first.name,
            first.reason
        ),
        None => "no calibration".into(),
    }
}

/// Why the frames cannot be listed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ListError {
    #[error("{}: cannot read: {cause}", .path.display())]
    Unreadable { path: PathBuf, cause: String },
    #[error("{}: expected a folder with frames ({}), found none", .0.display(), ENDINGS.join(", "))]
    NoFrames(PathBuf),
}

/// The files of frames and of folders of them, folders in the order of their names and with the folders in them.
pub fn list(paths: &[PathBuf]) -> Result<Vec<PathBuf>, ListError> {
    let mut files = Vec::new();
    for path in paths {
        if !path.is_dir() {
            let exists = path.try_exists().map_err(|error| error.to_string());
            if exists != Ok(true) {
                let cause = exists
                    .err()
                    .unwrap_or_else(|| "there is no such file".into());
                return Err(ListError::Unreadable {
                    path: path.clone(),
                    cause,
                });
            }
            files.push(path.clone());
            continue;
        }
        let mut found = Vec::new();
        list_folder(path, &mut found)?;
        if found.is_empty() {
            return Err(ListError::NoFrames(path.clone()));
        }
        found.sort();
        files.append(&mut found);
    }
    Ok(files)
}

fn list_folder(folder: &Path, files: &mut Vec<PathBuf>) -> Result<(), ListError> {
    let failed = |error: std::io::Error| ListError::Unreadable {
        path: folder.into(),
        cause: error.to_string(),
    };
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let name = path.file_name().unwrap_or_default();
        let name = name.to_string_lossy().to_lowercase();
        if name.starts_with('.') {
            continue;
        }
        if path.is_dir() {
            list_folder(&path, files)?;
        } else if ENDINGS.iter().any(|ending| name.ends_with(ending)) {
            files.push(path);
        }
    }
    Ok(())
}

/// SHA-256 over the sorted SHA-256 of the files that can be read, hexadecimal: whatever their names and order.
pub fn sha256(files: &[PathBuf]) -> String {
    let one = |file: &PathBuf| Some(Sha256::digest(std::fs::read(file).ok()?));
    let mut digests: Vec<_> = files.par_iter().filter_map(one).collect();
    digests.sort();
    let mut all = Sha256::new();
    for digest in digests {
        all.update(digest);
    }
    let bytes = all.finalize();
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
