//! A folder of files as a camera: its frames in the order of their names, at a steady rate.

use super::pace::Pace;
use super::{CameraError, Exposure, FrameSource, Settings, Take, settings};
use crate::fits;
use jiff::Timestamp;
use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Endings of the files that are taken for frames.
const ENDINGS: [&str; 8] = [
    ".fits", ".fit", ".fts", ".fits.gz", ".fits.fz", ".png", ".tif", ".tiff",
];

/// Replays the frames of a folder and of the folders in it.
pub struct FolderCamera {
    files: VecDeque<PathBuf>,
    period: Duration,
    pace: Pace,
}

impl FolderCamera {
    /// Lists the folder's frames.
    ///
    /// # Errors
    /// Where the folder cannot be listed, or holds no frame.
    pub fn open(folder: &Path, rate_hz: f64) -> Result<Self, CameraError> {
        let mut files = Vec::new();
        list(folder, &mut files).map_err(|error| CameraError::Folder {
            folder: folder.into(),
            found: format!("\"{error}\""),
        })?;
        if files.is_empty() {
            return Err(CameraError::Folder {
                folder: folder.into(),
                found: "no file that ends like one".into(),
            });
        }
        files.sort();
        Ok(Self {
            files: files.into(),
            period: settings::period(rate_hz),
            pace: Pace::default(),
        })
    }
}

fn list(folder: &Path, files: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .to_lowercase();
        if name.starts_with('.') {
            continue;
        }
        if path.is_dir() {
            list(&path, files)?;
        } else if ENDINGS.iter().any(|ending| name.ends_with(ending)) {
            files.push(path);
        }
    }
    Ok(())
}

impl FrameSource for FolderCamera {
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        if self.files.is_empty() {
            return Ok(Take::End);
        }
        if !self.pace.is_due() {
            return Ok(Take::NotYet);
        }
        let Some(path) = self.files.pop_front() else {
            return Ok(Take::End);
        };
        self.pace.advance(self.period);
        let frame = fits::read_frame(&path)?;
        let announced = frame.info.exposure_start().unwrap_or_else(Timestamp::now);
        starts(announced);
        Ok(Take::Exposure(Box::new(Exposure { frame, announced })))
    }

    /// Takes the rate; the rest was set when the frames were taken.
    fn apply(&mut self, settings: &Settings) -> Result<(), CameraError> {
        self.period = settings.period();
        Ok(())
    }
}
