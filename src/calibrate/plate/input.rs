//! Which files are frames of which pose.

use crate::fits::{self, FRAME_ENDINGS, Listing, Unlisted};
use std::path::{Path, PathBuf};

/// Frames that were taken without moving the camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pose {
    /// The folder they lie in.
    pub folder: PathBuf,
    pub files: Vec<PathBuf>,
}

/// Why no poses come of what was given.
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

/// Sorts frames and folders into poses: each folder is one, and so are all frames given one by one from a folder. A folder
/// that holds no frames itself stands for the folders in it.
pub fn poses(given: &[PathBuf]) -> Result<Vec<Pose>, InputError> {
    let mut poses: Vec<Pose> = Vec::new();
    let mut add = |folder: &Path, files: Vec<PathBuf>| {
        let known = poses.iter().position(|pose| pose.folder == folder);
        let n = known.unwrap_or(poses.len());
        if known.is_none() {
            poses.push(Pose {
                folder: folder.into(),
                files: Vec::new(),
            });
        }
        let pose = &mut poses[n].files;
        let new = files.into_iter().filter(|file| !pose.contains(file));
        let new: Vec<_> = new.collect();
        pose.extend(new);
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
    Ok(poses)
}

fn listing(folder: &Path) -> Result<Listing, InputError> {
    fits::list_folder(folder).map_err(|Unlisted { folder, cause }| InputError::Read {
        path: folder,
        cause,
    })
}
