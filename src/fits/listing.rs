//! Which files are taken for frames.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Endings of the files that are taken for frames.
pub const FRAME_ENDINGS: [&str; 10] = [
    ".fits", ".fit", ".fts", ".fits.gz", ".fits.fz", ".png", ".tif", ".tiff", ".jpg", ".jpeg",
];

/// What a folder holds that concerns frames, each sorted; what begins with a dot does not.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Listing {
    /// Files whose names end as a frame's do.
    pub files: Vec<PathBuf>,
    pub folders: Vec<PathBuf>,
}

/// A folder that cannot be listed.
#[derive(Debug, thiserror::Error)]
#[error("{}: cannot read: {cause}", .folder.display())]
pub struct Unlisted {
    pub folder: PathBuf,
    pub cause: io::Error,
}

/// The frames and the folders in a folder.
///
/// # Errors
/// A folder that cannot be listed.
pub fn list_folder(folder: &Path) -> Result<Listing, Unlisted> {
    let unlisted = |cause| Unlisted {
        folder: folder.into(),
        cause,
    };
    let mut listing = Listing::default();
    for entry in fs::read_dir(folder).map_err(unlisted)? {
        let path = entry.map_err(unlisted)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let name = name.to_lowercase();
        if name.starts_with('.') {
            continue;
        }
        if path.is_dir() {
            listing.folders.push(path);
        } else if FRAME_ENDINGS.iter().any(|ending| name.ends_with(ending)) {
            listing.files.push(path);
        }
    }
    listing.files.sort();
    listing.folders.sort();
    Ok(listing)
}

/// The frames in a folder and in the folders in it, in the order of their names.
///
/// # Errors
/// A folder that cannot be listed.
pub fn list_tree(root: &Path) -> Result<Vec<PathBuf>, Unlisted> {
    let mut files = Vec::new();
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        let mut listing = list_folder(&folder)?;
        files.append(&mut listing.files);
        folders.append(&mut listing.folders);
    }
    files.sort();
    Ok(files)
}
