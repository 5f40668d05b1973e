//! What several commands write beside their answers.

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use std::path::Path;

/// A bar of so many frames or files on standard error; hidden by itself where that is no terminal.
pub(super) fn progress_bar(count: usize, what: &str) -> ProgressBar {
    let template = format!("{{bar:40}} {{pos}}/{{len}} {what}, {{per_sec}}, {{eta}} left");
    let style = ProgressStyle::with_template(&template);
    ProgressBar::new(count as u64)
        .with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// Makes a folder and those above it.
pub(super) fn make_folder(folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("{}: cannot make the folder", folder.display()))
}
