//! `truth.csv`: a row for each frame, written as soon as the frame is.

use crate::cli::output::make_folder;
use anyhow::Context;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The file, open for the next row.
pub(super) struct TruthFile {
    path: PathBuf,
    file: File,
}

impl TruthFile {
    /// Makes the folder and the file with its first line.
    pub fn create(folder: &Path, header: &str) -> anyhow::Result<Self> {
        make_folder(folder)?;
        let path = folder.join("truth.csv");
        let file = File::create(&path).with_context(|| cannot_write(&path))?;
        let mut truth = Self { path, file };
        truth.row(header)?;
        Ok(truth)
    }

    /// Writes a row immediately, so that an interrupted program leaves the rows of its frames.
    pub fn row(&mut self, row: &str) -> anyhow::Result<()> {
        let line = format!("{row}\n");
        let written = self.file.write_all(line.as_bytes());
        written.with_context(|| cannot_write(&self.path))
    }
}

fn cannot_write(path: &Path) -> String {
    format!("{}: cannot write", path.display())
}

/// Writes another file of the folder.
pub(super) fn write_file(folder: &Path, name: &str, text: &str) -> anyhow::Result<()> {
    let path = folder.join(name);
    std::fs::write(&path, text).with_context(|| cannot_write(&path))
}
