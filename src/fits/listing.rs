//! Selection of the files that count as frames.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Endings of the files that count as frames.
pub const FRAME_ENDINGS: [&str; 10] = [
    ".fits", ".fit", ".fts", ".fits.gz", ".fits.fz", ".png", ".tif", ".tiff", ".jpg", ".jpeg",
];

/// Whether a file of this name counts as a frame: its ending is one of [`FRAME_ENDINGS`], ignoring case, and it does not begin with a
/// dot, as the names of unfinished files do.
pub fn is_frame_name(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let name = name.to_lowercase();
    !is_hidden(path) && FRAME_ENDINGS.iter().any(|ending| name.ends_with(ending))
}

/// Whether a name begins with a dot: such files and folders are not read.
pub fn is_hidden(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default();
    name.as_encoded_bytes().starts_with(b".")
}

/// Frames and subfolders of a folder, each sorted; hidden ones are omitted.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Listing {
    /// Files whose names have a frame's ending.
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
        if is_hidden(&path) {
            continue;
        }
        if path.is_dir() {
            listing.folders.push(path);
        } else if is_frame_name(&path) {
            listing.files.push(path);
        }
    }
    listing.files.sort();
    listing.folders.sort();
    Ok(listing)
}

/// The frames in a folder and its subfolders, in the order of their names.
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
