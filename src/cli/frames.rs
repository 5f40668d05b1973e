//! Shared parts of the commands that read frames and give an answer for each: options, formats, pictures, order.

use super::output::{make_folder, progress_bar, say};
use crate::fits::{self, FileError};
use crate::frame::{Frame, Warnings};
use crate::observe;
use crate::units::counted;
use anyhow::{Context, ensure};
use clap::{Args, ValueEnum};
use image::RgbImage;
use indicatif::ProgressBar;
use serde::Serialize;
use std::collections::BTreeSet;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::{Mutex, MutexGuard, PoisonError};

#[derive(Debug, Args)]
pub(super) struct FramesArgs {
    /// Frames to solve, or folders of them: the frames in a folder and in those below it are sorted by name
    #[arg(required = true, value_name = "FRAME|DIR")]
    pub frames: Vec<PathBuf>,
    /// Solve N frames at a time
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub jobs: u16,
    /// How answers are written [default: table on a terminal, else jsonl]
    #[arg(long, value_enum)]
    pub format: Option<Format>,
    /// Write a picture of every solved frame to this folder
    #[arg(long, value_name = "DIR")]
    pub overlay: Option<PathBuf>,
    #[arg(skip)]
    warnings: Mutex<Warnings>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Format {
    Jsonl,
    Csv,
    Table,
}

impl FramesArgs {
    /// Replaces each folder by its frames, and makes the overlays' folder.
    ///
    /// # Errors
    /// If a folder cannot be listed, the overlays' folder cannot be made, or the overlays of two frames would have the same name.
    pub fn prepare(&mut self) -> anyhow::Result<()> {
        self.frames = observe::named(&self.frames)?;
        let Some(folder) = &self.overlay else {
            return Ok(());
        };
        make_folder(folder)?;
        let names: BTreeSet<_> = self.frames.iter().map(|f| picture_name(f)).collect();
        ensure!(
            names.len() == self.frames.len(),
            "--overlay: expected frames whose pictures have different names, found two alike"
        );
        Ok(())
    }

    /// Reads a frame; if its file has several pictures, the first of a camera's width and height, px. Parts of the file that were not used
    /// unchanged are logged, once per run and kind.
    pub fn read(&self, path: &Path, size_px: Option<[usize; 2]>) -> Result<Frame, FileError> {
        let frame = match size_px {
            Some(size_px) => fits::read_frame_of_size(path, size_px),
            None => fits::read_frame(path),
        }?;
        self.warnings()
            .note(&path.display().to_string(), &frame.info.warnings);
        Ok(frame)
    }

    fn warnings(&self) -> MutexGuard<'_, Warnings> {
        self.warnings.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes a frame's overlay, if overlays are wanted.
    pub fn draw(&self, path: &Path, picture: impl FnOnce(&str) -> RgbImage) -> anyhow::Result<()> {
        let Some(folder) = &self.overlay else {
            return Ok(());
        };
        let title = path.file_name().unwrap_or_default().to_string_lossy();
        let file = folder.join(picture_name(path));
        let written = picture(&title).save(&file);
        written.with_context(|| format!("{}: cannot write the overlay", file.display()))
    }

    /// Passes on the result for each item, in the order of the items, with `jobs` of them processed at a time.
    pub fn in_order<I: Sync, O: Send>(
        &self,
        items: &[I],
        solve: impl Fn(&I) -> O + Sync,
        take: impl FnMut(O) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        observe::in_order(items, self.jobs.into(), solve, take)
    }

    /// Prints the answer for each frame from `solve`, in order, and the number of frames with warnings of each kind.
    ///
    /// # Errors
    /// If standard output cannot be written. A file that could not be read gets a line of its own, and makes the run a failure.
    pub fn print<R: OutputRow>(
        &self,
        solve: impl FnOnce(&mut dyn FnMut(Outcome<R>) -> anyhow::Result<()>) -> anyhow::Result<()>,
    ) -> anyhow::Result<ExitCode> {
        let mut printer = Printer::new::<R>(self.format)?;
        let progress = self.progress();
        let mut code = ExitCode::SUCCESS;
        solve(&mut |result| {
            if result.is_err() {
                code = ExitCode::FAILURE;
            }
            progress.suspend(|| printer.print(&result))?;
            progress.inc(1);
            Ok(())
        })?;
        progress.finish_and_clear();
        for (kind, frames) in self.warnings().counts() {
            tracing::warn!("in {}: {kind}", counted(frames, "frame"));
        }
        Ok(code)
    }

    /// None beside a table on the same terminal, where a bar would only flicker.
    fn progress(&self) -> ProgressBar {
        if self.frames.len() < 2 || std::io::stdout().is_terminal() {
            return ProgressBar::hidden();
        }
        progress_bar(self.frames.len(), "frames")
    }
}

/// The frame's folder and name, so that frames of several folders have different names.
fn picture_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let folder = path.parent().and_then(Path::file_name);
    match folder {
        Some(folder) => format!("{}_{name}.png", folder.to_string_lossy()),
        None => format!("{name}.png"),
    }
}

/// The width of the table's last column: as wide as necessary.
pub(super) const REMARKS: usize = 0;

/// Answer for a frame.
pub(super) trait OutputRow: Serialize {
    /// Names of the columns in CSV; the first is the file's.
    fn csv_columns() -> Vec<&'static str>;

    fn csv_row(&self) -> Vec<String>;

    /// Titles and widths of the table's columns after the file's; the last one has the width [`REMARKS`] and no title.
    fn table_columns() -> &'static [(&'static str, usize)];

    /// The file, and the content of the other columns.
    fn table_row(&self) -> (&str, Vec<String>);
}

/// Answer for a frame, or the file and its error.
pub(super) type Outcome<R> = Result<R, (String, String)>;

/// The answer for a file that could not be solved. The line already names the file, so the error does not repeat it.
pub(super) fn bad_file<R>(path: &Path, error: &anyhow::Error) -> Outcome<R> {
    let name = path.display().to_string();
    let text = format!("{error:#}");
    let text = text.strip_prefix(&format!("{name}: ")).unwrap_or(&text);
    Err((name, text.into()))
}

/// The line of a file that could not be read.
#[derive(Serialize)]
struct BadFile<'a> {
    file: &'a str,
    error: &'a str,
}

/// Writes answers to standard output in one format.
struct Printer {
    format: Format,
    csv: csv::Writer<std::io::Stdout>,
}

/// Width of the table's first column.
const FILE_WIDTH: usize = 21;

/// Width of the whole table.
const TABLE_WIDTH: usize = 100;

impl Printer {
    pub fn new<R: OutputRow>(format: Option<Format>) -> anyhow::Result<Self> {
        let on_terminal = std::io::stdout().is_terminal();
        let format = format.unwrap_or(if on_terminal {
            Format::Table
        } else {
            Format::Jsonl
        });
        let mut csv = csv::Writer::from_writer(std::io::stdout());
        match format {
            Format::Jsonl => {}
            Format::Csv => {
                csv.write_record(R::csv_columns().iter().chain(&["error"]))?;
                csv.flush()?;
            }
            Format::Table => {
                let titles = R::table_columns()
                    .iter()
                    .map(|(title, _)| title.to_string());
                say(table_line::<R>("file", titles))?;
            }
        }
        Ok(Self { format, csv })
    }

    pub fn print<R: OutputRow>(&mut self, result: &Outcome<R>) -> anyhow::Result<()> {
        let mut out = std::io::stdout().lock();
        match (self.format, result) {
            (Format::Jsonl, Ok(row)) => writeln!(out, "{}", serde_json::to_string(row)?)?,
            (Format::Jsonl, Err((file, error))) => {
                writeln!(out, "{}", serde_json::to_string(&BadFile { file, error })?)?;
            }
            (Format::Csv, _) => {
                drop(out);
                self.print_csv(result)?;
            }
            (Format::Table, Ok(row)) => {
                let (file, fields) = row.table_row();
                writeln!(out, "{}", table_line::<R>(file, fields.into_iter()))?;
            }
            (Format::Table, Err((file, error))) => {
                writeln!(out, "{:<FILE_WIDTH$} error: {error}", tail(file))?;
            }
        }
        Ok(())
    }

    fn print_csv<R: OutputRow>(&mut self, result: &Outcome<R>) -> anyhow::Result<()> {
        let (row, error) = match result {
            Ok(row) => (row.csv_row(), ""),
            Err((file, error)) => {
                let mut row = vec![String::new(); R::csv_columns().len()];
                row[0].clone_from(file);
                (row, error.as_str())
            }
        };
        self.csv
            .write_record(row.iter().map(String::as_str).chain([error]))?;
        self.csv.flush()?;
        Ok(())
    }
}

/// The file, the quality left-aligned, numbers right-aligned, and the remarks last: on a line of their own if the line would become
/// too wide.
fn table_line<R: OutputRow>(file: &str, fields: impl Iterator<Item = String>) -> String {
    let mut line = format!("{:<FILE_WIDTH$}", tail(file));
    for (n, (field, (_, width))) in fields.zip(R::table_columns()).enumerate() {
        line += &match (n, *width) {
            (0, width) => format!(" {field:<width$}"),
            (_, REMARKS) => {
                add_remarks(&mut line, &field);
                continue;
            }
            (_, width) => format!(" {field:>width$}"),
        };
    }
    line.truncate(line.trim_end().len());
    line
}

/// Appends the remarks after the last column, else after the last that is not empty, else on a line of their own.
fn add_remarks(line: &mut String, remarks: &str) {
    if line.len() + 2 + remarks.len() > TABLE_WIDTH {
        line.truncate(line.trim_end().len());
    }
    let fits = line.len() + 2 + remarks.len() <= TABLE_WIDTH;
    *line += if fits { "  " } else { "\n  " };
    *line += remarks;
}

/// The end of a path, in which frames differ.
fn tail(file: &str) -> String {
    let count = file.chars().count();
    if count <= FILE_WIDTH {
        return file.into();
    }
    let end: String = file.chars().skip(count - FILE_WIDTH + 2).collect();
    format!("..{end}")
}
