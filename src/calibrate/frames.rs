//! The frames that a calibration is given: their files, their hash, what is wrong with some of them.

use crc::{CRC_64_XZ, Crc};
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

/// Why the frames cannot be listed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ListError {
    #[error("{}: cannot list the folder: {cause}", .folder.display())]
    Folder { folder: PathBuf, cause: String },
    #[error("{}: expected a folder with frames ({}), found none", .0.display(), ENDINGS.join(", "))]
    NoFrames(PathBuf),
}

/// The files of frames and of folders of them, folders in the order of their names and with the folders in them.
pub fn list(paths: &[PathBuf]) -> Result<Vec<PathBuf>, ListError> {
    let mut files = Vec::new();
    for path in paths {
        if !path.is_dir() {
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
    let failed = |error: std::io::Error| ListError::Folder {
        folder: folder.into(),
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

/// CRC-64/XZ of the files' contents one after the other: it tells which frames a calibration rests on.
pub fn hash(files: &[PathBuf]) -> String {
    let crc = Crc::<u64>::new(&CRC_64_XZ);
    let mut digest = crc.digest();
    for bytes in files.iter().filter_map(|file| std::fs::read(file).ok()) {
        digest.update(&bytes);
    }
    format!("{:016x}", digest.finalize())
}
