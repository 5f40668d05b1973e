//! The frames that a calibration is given: their files, their hash, what is wrong with some of them.

use crate::fits::{self, FRAME_ENDINGS, Unlisted};
use crate::provenance;
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use std::path::PathBuf;

/// A frame that does not take part, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct LeftOut {
    pub name: String,
    /// Without the name, which stands beside.
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
    #[error("{}: expected a folder with frames ({}), found none", .0.display(), FRAME_ENDINGS.join(", "))]
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
        let mut found =
            fits::list_tree(path).map_err(|Unlisted { folder, cause }| ListError::Unreadable {
                path: folder,
                cause: cause.to_string(),
            })?;
        if found.is_empty() {
            return Err(ListError::NoFrames(path.clone()));
        }
        files.append(&mut found);
    }
    Ok(files)
}

/// SHA-256 over the sorted SHA-256 of the files that can be read, hexadecimal: whatever their names and order.
pub fn sha256(files: &[PathBuf]) -> String {
    let one = |file: &PathBuf| Some(sha256_of(&std::fs::read(file).ok()?));
    sha256_of_all(files.par_iter().filter_map(one).collect())
}

/// SHA-256 of a file's bytes.
pub fn sha256_of(bytes: &[u8]) -> [u8; 32] {
    Sha256::digest(bytes).into()
}

/// SHA-256 over those of the files, sorted; hexadecimal.
pub fn sha256_of_all(mut files: Vec<[u8; 32]>) -> String {
    files.sort_unstable();
    provenance::sha256(files.concat())
}
