//! The log on standard error: bounded and lossy, so that no thread ever waits for its reader.
//!
//! A line is formatted by the thread that logs it and put into a queue; one thread writes the queue to standard error. A
//! line is lost and counted if the queue is full, or if standard error refuses it. A terminal may also show a live line
//! below the log, which is replaced as the run proceeds.
//!
//! `tracing-appender` offers such a queue, but does not count lines that the writer refuses, and prints to standard output
//! if its queue is full at the end.

use crossbeam_channel::{Receiver, Sender, bounded};
use std::any::Any;
use std::io::{self, IsTerminal, Write};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Duration;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;

/// Maximum number of lines waiting for standard error: some seconds of a flight at the level of single frames.
const QUEUE_LINES: usize = 1024;
/// Time that the program waits at its end for standard error to take the last lines.
const LAST_LINES: Duration = Duration::from_secs(1);

/// Format of the lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    Text,
    Json,
}

static QUEUE: OnceLock<Queue> = OnceLock::new();
static LOST: AtomicU64 = AtomicU64::new(0);

/// Number of log lines since the start of the program that standard error did not take in time, or at all.
pub fn lost_lines() -> u64 {
    LOST.load(Ordering::Relaxed)
}

/// Starts the log of this program, once; panics are logged as well. `verbose` counts from 0 (warnings) to 3 (everything),
/// unless the environment variable `RUST_LOG` overrides it.
///
/// The log ends when the guard is dropped, after the waiting lines.
///
/// # Errors
/// If the writing thread cannot be started.
pub fn start(verbose: u8, format: Format) -> io::Result<Guard> {
    let level = ["warn", "info", "debug"].get(usize::from(verbose));
    let level = level.copied().unwrap_or("trace");
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(level));
    let (queue, entries) = bounded(QUEUE_LINES);
    thread::Builder::new()
        .name("log".into())
        .spawn(move || write_all(&entries, &mut io::stderr()))?;
    let queue = QUEUE.get_or_init(|| Queue(queue)).clone();
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(io::stderr().is_terminal())
        .with_writer(queue.clone());
    // A second log is the same as the first one: there is one standard error.
    let _ = match format {
        Format::Text => log.try_init(),
        Format::Json => log.json().try_init(),
    };
    std::panic::set_hook(Box::new(|panic| {
        let place = panic.location().map(ToString::to_string);
        let said = panic_message(panic.payload());
        tracing::error!(place, said, "panic");
    }));
    Ok(Guard(queue))
}

/// Message of a panic.
pub(crate) fn panic_message(payload: &(dyn Any + Send)) -> String {
    let text = payload
        .downcast_ref::<&str>()
        .map(|text| (*text).to_owned());
    let text = text.or_else(|| payload.downcast_ref::<String>().cloned());
    text.unwrap_or_else(|| "not a text".into())
}

/// Writes a message to standard error, in order with the log, at any log level.
pub fn say(text: &str) {
    match QUEUE.get() {
        Some(queue) => queue.offer(Entry::Line(format!("{text}\n").into_bytes())),
        None => {
            let _ = writeln!(io::stderr(), "{text}");
        }
    }
}

/// Shows the present state on a terminal, replacing the previous one. Nothing is shown before the log has started.
pub fn show(text: String) {
    if let Some(queue) = QUEUE.get() {
        queue.offer(Entry::Live(text));
    }
}

/// Ends the log when it is dropped.
#[must_use]
pub struct Guard(Queue);

impl Drop for Guard {
    fn drop(&mut self) {
        let (written, wait) = bounded(1);
        if self
            .0
            .0
            .send_timeout(Entry::Flush(written), LAST_LINES)
            .is_ok()
        {
            // A blocked standard error does not keep the program from ending.
            let _ = wait.recv_timeout(LAST_LINES);
        }
    }
}

enum Entry {
    Line(Vec<u8>),
    Live(String),
    /// Answered when all earlier entries are written.
    Flush(Sender<()>),
}

/// The sending end for threads: it never waits.
#[derive(Clone)]
struct Queue(Sender<Entry>);

impl Queue {
    fn offer(&self, entry: Entry) {
        let is_line = matches!(entry, Entry::Line(_));
        if self.0.try_send(entry).is_err() && is_line {
            LOST.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Write for Queue {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        self.offer(Entry::Line(line.to_vec()));
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl<'a> MakeWriter<'a> for Queue {
    type Writer = Self;

    fn make_writer(&'a self) -> Self {
        self.clone()
    }
}

/// Writes entries until the queue is closed.
fn write_all(entries: &Receiver<Entry>, out: &mut impl Write) {
    /// Returns to the beginning of the line and clears it.
    const CLEAR: &str = "\r\x1b[2K";
    let mut live = String::new();
    for entry in entries {
        let written = match entry {
            Entry::Line(line) if live.is_empty() => out.write_all(&line),
            Entry::Line(line) => out
                .write_all(CLEAR.as_bytes())
                .and_then(|()| out.write_all(&line))
                .and_then(|()| out.write_all(live.as_bytes())),
            Entry::Live(text) => {
                live = text;
                // Output of the live line that the terminal does not take is dropped.
                let _ = out.write_all(format!("{CLEAR}{live}").as_bytes());
                Ok(())
            }
            Entry::Flush(written) => {
                let _ = written.send(());
                Ok(())
            }
        };
        if written.is_err() {
            LOST.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Whether a fault that has occurred `count` times gets a line in the log: the 1st, 2nd, 4th, 8th ... A dead disk or line
/// must not fill the log.
pub fn worth_a_line(count: u64) -> bool {
    count.is_power_of_two()
}

/// Counts a fault that may occur with every frame, to log only some of the occurrences.
pub struct Seldom(AtomicU64);

impl Seldom {
    pub const fn new() -> Self {
        Self(AtomicU64::new(0))
    }

    /// Counts an occurrence; returns the count if it should be logged.
    pub fn counted(&self) -> Option<u64> {
        let times = self.0.fetch_add(1, Ordering::Relaxed) + 1;
        worth_a_line(times).then_some(times)
    }
}

impl Default for Seldom {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Takes a number of bytes and refuses the rest.
    struct Refusing(usize);

    impl Write for Refusing {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0 = self
                .0
                .checked_sub(bytes.len())
                .ok_or_else(|| io::Error::other("full"))?;
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn line(text: &str) -> Entry {
        Entry::Line(text.as_bytes().to_vec())
    }

    #[test]
    fn lines_that_are_not_taken_are_lost_and_counted() {
        let (queue, entries) = bounded(3);
        let queue = Queue(queue);
        let before = lost_lines();
        (0..5).for_each(|_| queue.offer(line("12345\n")));
        assert_eq!(lost_lines() - before, 2, "two found the queue full");
        drop(queue);
        write_all(&entries, &mut Refusing(7));
        assert_eq!(lost_lines() - before, 4, "two more were refused");
    }

    #[test]
    fn the_live_line_stands_below_the_log() {
        let (queue, entries) = bounded(9);
        let queue = Queue(queue);
        for entry in [
            line("one\n"),
            Entry::Live("3 frames".into()),
            line("two\n"),
            Entry::Live(String::new()),
        ] {
            queue.offer(entry);
        }
        drop(queue);
        let mut written = Vec::new();
        write_all(&entries, &mut written);
        let text = String::from_utf8(written).unwrap();
        let expected = "one\n\r\x1b[2K3 frames\r\x1b[2Ktwo\n3 frames\r\x1b[2K";
        assert_eq!(text, expected);
    }
}
