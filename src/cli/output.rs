//! Output shared by several commands: their answers, and messages beside them.

use crate::log;
use crate::observe::Watch;
use anyhow::Context;
use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};
use std::fmt::{self, Display};
use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Writes a line to standard output. If the reader has closed it, that is no error.
///
/// # Errors
/// If standard output cannot be written, for example because the disk is full.
pub(super) fn say(line: impl Display) -> anyhow::Result<()> {
    match writeln!(io::stdout(), "{line}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(error).context("standard output")
        }
        _ => Ok(()),
    }
}

/// A progress bar for this many frames or files on standard error; it is hidden if that is no terminal.
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

/// Progress of a long run, on standard error: a bar on a terminal, otherwise one line per minute.
struct Progress {
    command: &'static str,
    what: String,
    bar: ProgressBar,
    next_line: Mutex<Instant>,
}

/// Interval of the lines in a log.
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

    /// Counts one more item as done.
    pub fn step(&self) {
        self.bar.inc(1);
        if !self.bar.is_hidden() {
            return;
        }
        // If the lock is taken, the other thread writes the line.
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

/// Shows the progress of a run, and ends it when the program is asked to end.
pub(super) struct Follower {
    command: &'static str,
    progress: Mutex<Option<Progress>>,
    cancelled: Arc<AtomicBool>,
}

impl Follower {
    pub fn new(command: &'static str, cancelled: &Arc<AtomicBool>) -> Self {
        Self {
            command,
            progress: Mutex::default(),
            cancelled: Arc::clone(cancelled),
        }
    }

    fn show(&self, progress: Option<Progress>) {
        let mut shown = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(before) = std::mem::replace(&mut *shown, progress) {
            before.finish();
        }
    }
}

impl Watch for Follower {
    fn begin(&self, frames: usize, what: &str) {
        self.show(Some(Progress::new(self.command, frames, what)));
    }

    fn step(&self) {
        let shown = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        shown.iter().for_each(Progress::step);
    }

    fn end(&self) {
        self.show(None);
    }

    fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }
}

/// Makes a folder and its parents.
pub(super) fn make_folder(folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("{}: cannot create the folder", folder.display()))
}
