//! Which files are the frames of which folder.

use crate::fits::{self, FRAME_ENDINGS, Listing, Unlisted};
use std::path::{Path, PathBuf};

/// The frames of a folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Folder {
    pub path: PathBuf,
    pub files: Vec<PathBuf>,
}

/// Why no frames come of what was given.
#[derive(Debug, thiserror::Error)]
pub enum InputError {
    #[error("{path}: cannot read: {cause}", path = .path.display())]
    Read {
        path: PathBuf,
        cause: std::io::Error,
    },
    #[error("{}: expected frames (files that end in {}), found none", .0.display(), FRAME_ENDINGS.join(", "))]
    NoFrames(PathBuf),
}

/// Sorts frames by folder, whether the folder is given or its frames one by one. A folder that holds no frames itself stands
/// for the folders in it.
pub fn folders(given: &[PathBuf]) -> Result<Vec<Folder>, InputError> {
    let mut all: Vec<Folder> = Vec::new();
    let mut add = |path: &Path, files: Vec<PathBuf>| {
        let known = all.iter().position(|folder| folder.path == path);
        let n = known.unwrap_or(all.len());
        if known.is_none() {
            all.push(Folder {
                path: path.into(),
                files: Vec::new(),
            });
        }
        let old = &mut all[n].files;
        let new = files.into_iter().filter(|file| !old.contains(file));
        let new: Vec<_> = new.collect();
        old.extend(new);
    };
    for path in given {
        let kind = std::fs::metadata(path).map_err(|cause| InputError::Read {
            path: path.clone(),
            cause,
        })?;
        if !kind.is_dir() {
            add(path.parent().unwrap_or(Path::new("")), vec![path.clone()]);
            continue;
        }
        let Listing { files, folders } = listing(path)?;
        if !files.is_empty() {
            add(path, files);
            continue;
        }
        let mut found = false;
        for folder in folders {
            let files = listing(&folder)?.files;
            if !files.is_empty() {
                found = true;
                add(&folder, files);
            }
        }
        if !found {
            return Err(InputError::NoFrames(path.clone()));
        }
    }
    Ok(all)
}

fn listing(folder: &Path) -> Result<Listing, InputError> {
    fits::list_folder(folder).map_err(|Unlisted { folder, cause }| InputError::Read {
        path: folder,
        cause,
    })
}
