//! Files that are read completely: regular files, of a limited size, and within a limited time.
//!
//! A path may name anything: a pipe whose opening waits for a writer, a device without an end, a file on a disk that hangs.
//! Here each of these is an error, and never blocks the program or fills the memory.

use crate::bounded::{NoAnswer, within};
use nix::fcntl::OFlag;
use std::fs::{File, Metadata};
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;
use std::str::Utf8Error;
use std::time::Duration;

/// The largest text that is read, bytes: instruments, configurations, tables.
pub const LARGEST_TEXT: u64 = 16 << 20;
/// A file that has not been read within this time is on a disk that hangs.
const TIMEOUT: Duration = Duration::from_secs(5);

/// Why a file was not read.
#[derive(Debug, thiserror::Error)]
#[error("expected {}, found {}", self.expected(), self.found())]
pub enum Unread {
    /// The system's message.
    Io(io::Error),
    /// A folder, a device or a pipe.
    Kind(&'static str),
    /// More bytes than a file of its kind has.
    Large { most: u64 },
    /// Not a text.
    Text(Utf8Error),
    /// The disk hangs.
    Silent(NoAnswer),
}

impl Unread {
    pub fn expected(&self) -> String {
        match self {
            Self::Io(_) => "a readable file".into(),
            Self::Kind(_) => "a regular file".into(),
            Self::Large { most } => format!("a file of at most {most} bytes"),
            Self::Text(_) => "a text in UTF-8".into(),
            Self::Silent(_) => "a file that can be read".into(),
        }
    }

    pub fn found(&self) -> String {
        match self {
            Self::Io(error) => error.to_string(),
            Self::Kind(kind) => (*kind).into(),
            Self::Large { .. } => "a larger one".into(),
            Self::Text(error) => error.to_string(),
            Self::Silent(no_answer) => no_answer.to_string(),
        }
    }

    /// Whether there is no such file.
    pub fn is_absent(&self) -> bool {
        matches!(self, Self::Io(error) if error.kind() == ErrorKind::NotFound)
    }
}

impl From<io::Error> for Unread {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// Opens a regular file; nothing else is even opened.
///
/// # Errors
/// [`Unread::Io`] and [`Unread::Kind`].
pub fn open_regular(path: &Path) -> Result<File, Unread> {
    // Opening a pipe blocks until it has a writer, and opening a device may have side effects. The opened file may differ
    // from the checked one: so it is opened without blocking, and checked again.
    check_regular(&std::fs::metadata(path)?)?;
    let flags = OFlag::O_NONBLOCK.bits();
    let file = File::options().read(true).custom_flags(flags).open(path)?;
    check_regular(&file.metadata()?)?;
    Ok(file)
}

/// Opens a log for sequential reading: a regular file, or a pipe that was named explicitly.
///
/// # Errors
/// [`Unread::Io`] and [`Unread::Kind`].
pub fn open_log(path: &Path) -> Result<File, Unread> {
    let metadata = std::fs::metadata(path)?;
    if !metadata.file_type().is_fifo() {
        check_regular(&metadata)?;
    }
    Ok(File::open(path)?)
}

/// The bytes of a log, opened by [`open_log`].
///
/// # Errors
/// As [`open_log`].
pub fn read_log(path: &Path) -> Result<Vec<u8>, Unread> {
    let mut bytes = Vec::new();
    open_log(path)?.read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn check_regular(metadata: &Metadata) -> Result<(), Unread> {
    match (metadata.is_file(), metadata.is_dir()) {
        (true, _) => Ok(()),
        (_, true) => Err(Unread::Kind("a directory")),
        _ => Err(Unread::Kind("a device or pipe")),
    }
}

/// The bytes of a regular file, at most `most`, without a time limit.
///
/// # Errors
/// All of [`Unread`] except [`Unread::Text`] and [`Unread::Silent`].
pub fn read_patiently(path: &Path, most: u64) -> Result<Vec<u8>, Unread> {
    let mut bytes = read_start(path, most.saturating_add(1))?;
    if bytes.len() as u64 > most {
        return Err(Unread::Large { most });
    }
    bytes.shrink_to_fit();
    Ok(bytes)
}

/// The first bytes of a regular file, at most `most`.
///
/// # Errors
/// [`Unread::Io`] and [`Unread::Kind`].
pub fn read_start(path: &Path, most: u64) -> Result<Vec<u8>, Unread> {
    let file = open_regular(path)?;
    let expected = file.metadata()?.len().min(most);
    let mut bytes = Vec::with_capacity(expected as usize);
    file.take(most).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The bytes of a regular file, at most `most`. If the disk hangs, the read is abandoned on its own thread.
///
/// # Errors
/// All of [`Unread`] except [`Unread::Text`].
pub fn read(path: &Path, most: u64) -> Result<Vec<u8>, Unread> {
    let path = path.to_owned();
    within(TIMEOUT, move || read_patiently(&path, most))
        .unwrap_or_else(|none| Err(Unread::Silent(none)))
}

/// The text of a regular file of at most [`LARGEST_TEXT`] bytes, read as by [`read`].
///
/// # Errors
/// All of [`Unread`].
pub fn read_text(path: &Path) -> Result<String, Unread> {
    let bytes = read(path, LARGEST_TEXT)?;
    String::from_utf8(bytes).map_err(|error| Unread::Text(error.utf8_error()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nix::sys::stat::Mode;

    fn refusal(path: &Path) -> String {
        read(path, 100).unwrap_err().to_string()
    }

    #[test]
    fn only_regular_files_are_read_and_nothing_else_is_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let [pipe, link] = ["pipe", "link"].map(|name| folder.path().join(name));
        nix::unistd::mkfifo(&pipe, Mode::S_IRWXU).unwrap();
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        for (path, kind) in [
            (pipe.as_path(), "a device or pipe"),
            (&link, "a device or pipe"),
            (Path::new("/dev/zero"), "a device or pipe"),
            (folder.path(), "a directory"),
        ] {
            let wanted = format!("expected a regular file, found {kind}");
            assert_eq!(refusal(path), wanted, "{}", path.display());
        }
        let absent = read(&folder.path().join("absent"), 100).unwrap_err();
        assert!(absent.is_absent(), "{absent}");
    }

    #[test]
    fn a_file_is_read_up_to_its_bound_and_no_further() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, [b'x'; 100]).unwrap();
        assert_eq!(read(&path, 100).unwrap().len(), 100);
        std::fs::write(&path, [b'x'; 101]).unwrap();
        let wanted = "expected a file of at most 100 bytes, found a larger one";
        assert_eq!(refusal(&path), wanted);
        // A sparse file, larger than any memory.
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        assert_eq!(refusal(&path), wanted);
    }

    #[test]
    fn a_log_may_be_a_pipe_and_no_device() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        nix::unistd::mkfifo(&pipe, Mode::S_IRWXU).unwrap();
        let writer = std::thread::spawn({
            let pipe = pipe.clone();
            move || std::fs::write(pipe, "log").unwrap()
        });
        let mut text = String::new();
        open_log(&pipe).unwrap().read_to_string(&mut text).unwrap();
        writer.join().unwrap();
        assert_eq!(text, "log");
        let error = open_log(Path::new("/dev/zero")).unwrap_err().to_string();
        assert_eq!(error, "expected a regular file, found a device or pipe");
    }
}
