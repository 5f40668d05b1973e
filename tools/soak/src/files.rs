//! The files of the archives: removed during the run, counted, and read back at its end.

use std::collections::HashMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Number of files that stay on each disk unless all are kept.
const KEPT_FILES: usize = 500;

/// Frames that have been found in files.
pub struct Files {
    roots: Vec<PathBuf>,
    keep: bool,
    /// Indexed by frame number; allocated at once, so that it does not grow.
    found: Vec<bool>,
}

/// Sizes of a disk's logs, bytes.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LogBytes {
    pub solutions: u64,
    pub telemetry: u64,
    pub housekeeping: u64,
}

/// Content of a disk's logs at the end.
#[derive(Debug, Clone, Default)]
pub struct LogRows {
    /// Rows of the solution logs, and samples of the telemetry.
    pub solutions: u64,
    pub telemetry: u64,
    /// Number of occurrences of each frame number in the solution logs.
    pub frames: HashMap<u64, u64>,
}

impl Files {
    pub fn new(roots: Vec<PathBuf>, keep: bool, frames: u64) -> Self {
        Self {
            roots,
            keep,
            found: vec![false; frames as usize],
        }
    }

    /// Records and removes all but the newest files of every archive, unless all are kept.
    pub fn clear(&mut self) -> io::Result<()> {
        match self.keep {
            true => Ok(()),
            false => self.note_all_but(KEPT_FILES),
        }
    }

    /// Number of frames that are or were in a file.
    pub fn count(&mut self) -> io::Result<u64> {
        for root in self.roots.clone() {
            for file in fits_files(&root)? {
                self.note(&file);
            }
        }
        Ok(self.found.iter().filter(|found| **found).count() as u64)
    }

    /// Size of each disk's logs; 0 for a disk that is gone.
    pub fn logs(&self) -> Vec<LogBytes> {
        self.roots.iter().map(|root| log_bytes(root)).collect()
    }

    /// Reads the logs of every disk.
    pub fn rows(&self) -> io::Result<Vec<LogRows>> {
        self.roots.iter().map(|root| log_rows(root)).collect()
    }

    fn note_all_but(&mut self, kept: usize) -> io::Result<()> {
        for root in self.roots.clone() {
            let files = fits_files(&root)?;
            for file in &files[..files.len().saturating_sub(kept)] {
                self.note(file);
                match fs::remove_file(file) {
                    // The disk has just gone: it is counted next time.
                    Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                    done => done?,
                }
            }
        }
        Ok(())
    }

    fn note(&mut self, file: &Path) {
        let number = file_number(file).and_then(|n| self.found.get_mut(n));
        if let Some(found) = number {
            *found = true;
        }
    }
}

/// The frame's number in a file's name, `demo_20130921T180000.250_00000007.fits` or `..._00000007_2.fits`.
fn file_number(file: &Path) -> Option<usize> {
    file.file_stem()?.to_str()?.split('_').nth(2)?.parse().ok()
}

/// The frames' files under a root, the oldest first; none if the disk is gone.
fn fits_files(root: &Path) -> io::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for folder in list(root)? {
        let is_hour = folder.is_dir() && !folder.join("format").exists();
        if is_hour {
            let is_frame = |file: &PathBuf| file.extension().is_some_and(|e| e == "fits");
            files.extend(list(&folder)?.into_iter().filter(is_frame));
        }
    }
    files.sort();
    Ok(files)
}

fn list(folder: &Path) -> io::Result<Vec<PathBuf>> {
    match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        entries => entries?.map(|entry| Ok(entry?.path())).collect(),
    }
}

fn begins_with(path: &Path, beginning: &str) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with(beginning)
}

/// Whether a path is a folder of telemetry; the link to the newest one is excluded.
fn is_telemetry(path: &Path) -> bool {
    begins_with(path, "telemetry_")
}

fn log_bytes(root: &Path) -> LogBytes {
    let mut bytes = LogBytes::default();
    let length = |path: &Path| fs::metadata(path).map_or(0, |file| file.len());
    for path in list(root).unwrap_or_default() {
        if begins_with(&path, "solutions_") {
            bytes.solutions += length(&path);
        } else if begins_with(&path, "housekeeping_") {
            bytes.housekeeping += length(&path);
        } else if is_telemetry(&path) {
            bytes.telemetry += length(&path.join("TIME"));
        }
    }
    bytes
}

fn log_rows(root: &Path) -> io::Result<LogRows> {
    let mut rows = LogRows::default();
    for path in list(root)? {
        if begins_with(&path, "solutions_") {
            for line in fs::read_to_string(&path)?.lines() {
                // The heading has no number.
                let first = line.split(',').next().and_then(|field| field.parse().ok());
                if let Some(number) = first {
                    rows.solutions += 1;
                    *rows.frames.entry(number).or_default() += 1;
                }
            }
        } else if is_telemetry(&path) {
            rows.telemetry += fs::metadata(path.join("TIME"))?.len() / 8;
        }
    }
    Ok(rows)
}
