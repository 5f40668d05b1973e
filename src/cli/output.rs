//! What several commands write, their answers and beside them.

use crate::instrument::TomlError;
use crate::log;
use anyhow::Context;
use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};
use std::fmt::{self, Display};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Writes a line to standard output. A reader that has left does not want the rest: that is no error.
///
/// # Errors
/// Standard output takes nothing: a full disk, for one.
pub(super) fn say(line: impl Display) -> anyhow::Result<()> {
    match writeln!(io::stdout(), "{line}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(error).context("standard output")
        }
        _ => Ok(()),
    }
}

/// A bar of so many frames or files on standard error; hidden by itself where that is no terminal.
pub(super) fn progress_bar(count: usize, what: &str) -> ProgressBar {
    let template = format!("{{bar:40}} {{pos}}/{{len}} {what}, {{rate}}, {{eta}} left");
    let style = ProgressStyle::with_template(&template);
    let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
    let rate = |state: &ProgressState, out: &mut dyn fmt::Write| {
        let written = write!(out, "{:.1}/s", state.per_sec());
        debug_assert!(written.is_ok(), "a string takes all");
    };
    ProgressBar::new(count as u64).with_style(style.with_key("rate", rate))
}

/// How far a long run has got, on standard error: a bar on a terminal, elsewhere a line a minute.
pub(super) struct Progress {
    command: &'static str,
    what: String,
    bar: ProgressBar,
    next_line: Mutex<Instant>,
}

/// How often a log is told.
const LINE_EVERY: Duration = Duration::from_secs(60);

impl Progress {
    pub fn new(command: &'static str, count: usize, what: &str) -> Self {
        Self {
            command,
            what: what.into(),
            bar: progress_bar(count, what),
            next_line: Mutex::new(Instant::now() + LINE_EVERY),
        }
    }

    /// One more is done.
    pub fn step(&self) {
        self.bar.inc(1);
        if !self.bar.is_hidden() {
            return;
        }
        // Whoever finds it taken leaves the line to the other thread.
        let Ok(mut next_line) = self.next_line.try_lock() else {
            return;
        };
        if Instant::now() >= *next_line {
            *next_line = Instant::now() + LINE_EVERY;
            self.say();
        }
    }

    fn say(&self) {
        let Self {
            command, what, bar, ..
        } = self;
        let (done, all) = (bar.position(), bar.length().unwrap_or_default());
        let (rate, left) = (bar.per_sec(), HumanDuration(bar.eta()));
        log::say(&format!(
            "{command}: {done} of {all} {what}, {rate:.1}/s, {left} left"
        ));
    }

    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}

/// Makes a folder and those above it.
pub(super) fn make_folder(folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("{}: cannot make the folder", folder.display()))
}

/// Writes a file if it is one that everything else can read; else what stood there stays.
pub(super) fn write_if(
    path: &Path,
    text: &str,
    read: impl FnOnce(&Path) -> Result<(), TomlError>,
) -> anyhow::Result<()> {
    let cannot_write = || format!("{}: cannot write", path.display());
    let mut name = path.as_os_str().to_owned();
    name.push(".part");
    let part = PathBuf::from(name);
    std::fs::write(&part, text).with_context(cannot_write)?;
    read(&part)?;
    std::fs::rename(&part, path).with_context(cannot_write)
}
