//! Standard error redirected into a pipe, whose reader stalls or leaves on command.

use std::fs::File;
use std::io::{self, PipeReader, PipeWriter, Read, Write};
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

/// Minimum size of a pipe: a stalled reader takes effect soon.
const PIPE_BYTES: i32 = 4096;

/// The reader's end, and the original standard error.
pub struct Stderr {
    before: OwnedFd,
    log: Option<Arc<File>>,
    stalled: Arc<AtomicBool>,
}

impl Stderr {
    /// Reads standard error from now on; the text goes to the log file, if there is one.
    pub fn capture(log: Option<&Path>) -> io::Result<Self> {
        let stderr = Self {
            before: io::stderr().as_fd().try_clone_to_owned()?,
            log: log.map(File::create).transpose()?.map(Arc::new),
            stalled: Arc::default(),
        };
        stderr.read()?;
        Ok(stderr)
    }

    /// Stops or resumes reading.
    pub fn stall(&self, stalled: bool) {
        self.stalled.store(stalled, Ordering::Relaxed);
    }

    /// Makes standard error a pipe without a reader.
    pub fn close(&self) -> io::Result<()> {
        let (_, writer) = io::pipe()?;
        put_in_place(&writer)
    }

    /// Makes standard error a pipe with a reader.
    pub fn read(&self) -> io::Result<()> {
        let (reader, writer) = io::pipe()?;
        let bytes = nix::fcntl::FcntlArg::F_SETPIPE_SZ(PIPE_BYTES);
        nix::fcntl::fcntl(writer.as_raw_fd(), bytes)?;
        let (log, stalled) = (self.log.clone(), Arc::clone(&self.stalled));
        thread::spawn(move || drain(reader, log.as_deref(), &stalled));
        put_in_place(&writer)
    }
}

impl Drop for Stderr {
    fn drop(&mut self) {
        self.stall(false);
        let _ = nix::unistd::dup2(self.before.as_raw_fd(), io::stderr().as_raw_fd());
    }
}

fn put_in_place(writer: &PipeWriter) -> io::Result<()> {
    nix::unistd::dup2(writer.as_raw_fd(), io::stderr().as_raw_fd())?;
    Ok(())
}

fn drain(mut reader: PipeReader, mut log: Option<&File>, stalled: &AtomicBool) {
    let mut bytes = [0; 4096];
    loop {
        while stalled.load(Ordering::Relaxed) {
            thread::sleep(Duration::from_millis(10));
        }
        match reader.read(&mut bytes) {
            Ok(0) | Err(_) => return,
            Ok(count) => {
                if let Some(log) = &mut log {
                    let _ = log.write_all(&bytes[..count]);
                }
            }
        }
    }
}
