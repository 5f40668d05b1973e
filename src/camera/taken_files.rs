//! Record of the files that were taken from a followed folder: each is taken once, even if a thread or the program restarts.
//!
//! The names are kept in memory as hashes, eight bytes each, for a long flight has millions of them, and in a file, one line each, which a thread of
//! its own writes: a disk that hangs does not delay frames.

use crate::bounded::within;
use crate::log::worth_a_line;
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use std::collections::HashSet;
use std::fs::File;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Time allowed for reading the list of an earlier run: a disk that takes longer hangs.
const READING: Duration = Duration::from_secs(5);
/// Longest time for which a power cut may lose names.
const SYNC_EVERY: Duration = Duration::from_secs(1);
/// Time allowed for writing the last names when the flight ends.
const ENDING: Duration = Duration::from_secs(1);
/// Names that may wait for the list's thread: those of minutes of frames.
const UNWRITTEN: usize = 4096;
/// Most bytes that the thread itself holds while the disk refuses them.
const MOST_HELD: usize = 1 << 20;

/// The files that were taken or skipped, shared by all readers of the folder for one camera.
#[derive(Debug, Clone, Default)]
pub struct TakenFiles(Arc<Mutex<Taken>>);

#[derive(Debug, Default)]
struct Taken {
    /// Whether the initial content of the folder has been noted.
    has_started: bool,
    known: HashSet<u64>,
    /// `None` if the names are kept in memory alone.
    list: Option<List>,
}

impl TakenFiles {
    /// Keeps the names in a file, from one run of the program to the next. The default keeps them in memory.
    pub fn kept_in(file: &Path) -> Self {
        let list = Some(List::new(file));
        Self(Arc::new(Mutex::new(Taken {
            list,
            ..Taken::default()
        })))
    }

    /// Whether the initial content of the folder has been noted.
    pub(super) fn has_started(&self) -> bool {
        self.lock().has_started
    }

    /// Skips these files: the ones that are in the folder when it is first found.
    pub(super) fn skip_existing<'n>(&self, names: impl IntoIterator<Item = &'n str>) {
        let mut taken = self.lock();
        taken.known.extend(names.into_iter().map(hash));
        taken.has_started = true;
    }

    /// Begins with the files that earlier runs have taken.
    ///
    /// # Errors
    /// If the list cannot be read.
    pub(super) fn start_with_list(&self) -> io::Result<()> {
        let mut taken = self.lock();
        if let Some(list) = &taken.list {
            let earlier = list.read()?;
            taken.known.extend(earlier);
        }
        taken.has_started = true;
        Ok(())
    }

    /// Whether a file was taken, or is being read.
    pub(super) fn knows(&self, name: &str) -> bool {
        self.lock().known.contains(&hash(name))
    }

    /// Takes a file before it is read, so that one which makes its reader hang or panic is not tried by the next; `false` if it was taken
    /// before.
    pub(super) fn claim(&self, name: &str) -> bool {
        self.lock().known.insert(hash(name))
    }

    /// Releases a file, to be taken when it is whole.
    pub(super) fn release(&self, name: &str) {
        self.lock().known.remove(&hash(name));
    }

    /// Records for later runs that a file was taken; `fault` is the reason if it gave no frame.
    pub(super) fn record(&self, name: &str, fault: Option<&str>) {
        let mut taken = self.lock();
        taken.known.insert(hash(name));
        if let Some(list) = &mut taken.list {
            list.add(match fault {
                None => format!("{name}\n"),
                Some(fault) => format!("{name}\t{}\n", plain(fault)),
            });
        }
    }

    fn lock(&self) -> MutexGuard<'_, Taken> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The name of a file in the list: its path in the folder, on one line.
pub(super) fn name_in_list(folder: &Path, file: &Path) -> String {
    let path = file.strip_prefix(folder).unwrap_or(file);
    plain(&path.to_string_lossy())
}

fn plain(text: &str) -> String {
    text.replace(char::is_control, "?")
}

fn hash(name: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    name.hash(&mut hasher);
    hasher.finish()
}

/// The list on disk, and the thread that writes it.
#[derive(Debug)]
struct List {
    path: PathBuf,
    writer: Option<Writer>,
    lost: u64,
}

#[derive(Debug)]
struct Writer {
    lines: Sender<String>,
    /// Closed when the thread has ended.
    ended: Receiver<()>,
}

impl List {
    fn new(path: &Path) -> Self {
        Self {
            path: path.into(),
            writer: None,
            lost: 0,
        }
    }

    /// The names of earlier runs; none without a list. An incomplete last line is ignored.
    fn read(&self) -> io::Result<HashSet<u64>> {
        let path = self.path.clone();
        within(READING, move || names_of(&path)).unwrap_or_else(|none| Err(io::Error::other(none)))
    }

    fn add(&mut self, line: String) {
        if self.writer.is_none() {
            self.writer = Writer::start(&self.path).ok();
        }
        let added = self
            .writer
            .as_ref()
            .is_some_and(|writer| writer.lines.try_send(line).is_ok());
        if !added {
            self.lost += 1;
            if worth_a_line(self.lost) {
                let (list, lost) = (self.path.display().to_string(), self.lost);
                tracing::error!(list, lost, "the name of a file that was taken is not kept");
            }
        }
    }
}

impl Drop for List {
    fn drop(&mut self) {
        if let Some(Writer { lines, ended }) = self.writer.take() {
            drop(lines);
            // The thread ends by closing its side; a disk that hangs is not waited for.
            let _ = ended.recv_timeout(ENDING);
        }
    }
}

fn names_of(path: &Path) -> io::Result<HashSet<u64>> {
    let mut lines = match File::open(path) {
        Ok(file) => BufReader::new(file),
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(HashSet::new()),
        Err(error) => return Err(error),
    };
    let (mut names, mut line) = (HashSet::new(), Vec::new());
    while lines.read_until(b'\n', &mut line)? > 0 {
        if line.pop() == Some(b'\n') {
            let text = String::from_utf8_lossy(&line);
            let name = text.split_once('\t').map_or(&*text, |(name, _)| name);
            names.insert(hash(name));
        }
        line.clear();
    }
    Ok(names)
}

impl Writer {
    fn start(path: &Path) -> io::Result<Self> {
        let (lines, to_write) = bounded(UNWRITTEN);
        let (alive, ended) = bounded(0);
        let path = path.to_owned();
        let name = "taken-files".to_string();
        thread::Builder::new().name(name).spawn(move || {
            write(&path, &to_write);
            drop::<Sender<()>>(alive);
        })?;
        Ok(Self { lines, ended })
    }
}

/// Writes lines as they come, until all senders are gone.
fn write(path: &Path, lines: &Receiver<String>) {
    let (mut held, mut file) = (String::new(), None);
    let (mut synced, mut refusals) = (Instant::now(), 0);
    let mut goes_on = true;
    while goes_on {
        if held.len() > MOST_HELD {
            thread::sleep(SYNC_EVERY);
        } else {
            match lines.recv_timeout(SYNC_EVERY) {
                Ok(line) => held.push_str(&line),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => goes_on = false,
            }
        }
        let is_due = !goes_on || synced.elapsed() >= SYNC_EVERY;
        match append(path, &mut file, &mut held, is_due) {
            Ok(()) if is_due => synced = Instant::now(),
            Ok(()) => {}
            Err(error) => {
                file = None;
                refusals += 1;
                if worth_a_line(refusals) {
                    let list = path.display().to_string();
                    tracing::error!(list, %error, refusals, "the names of taken files cannot be written");
                }
                if goes_on {
                    thread::sleep(SYNC_EVERY);
                }
            }
        }
    }
}

fn append(path: &Path, file: &mut Option<File>, held: &mut String, sync: bool) -> io::Result<()> {
    if file.is_none() && held.is_empty() {
        return Ok(());
    }
    let open = match file {
        Some(open) => open,
        None => file.insert(open_list(path)?),
    };
    open.write_all(held.as_bytes())?;
    held.clear();
    if sync { open.sync_data() } else { Ok(()) }
}

/// Opens a list for appending; an incomplete last line is ended.
fn open_list(path: &Path) -> io::Result<File> {
    let mut file = File::options()
        .create(true)
        .append(true)
        .read(true)
        .open(path)?;
    let mut last = [b'\n'];
    if file.seek(SeekFrom::End(0))? > 0 {
        file.seek(SeekFrom::End(-1))?;
        file.read_exact(&mut last)?;
    }
    if last != *b"\n" {
        file.write_all(b"\n")?;
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn again(list: &Path) -> TakenFiles {
        let taken = TakenFiles::kept_in(list);
        taken.start_with_list().unwrap();
        taken
    }

    #[test]
    fn names_outlive_the_program_and_a_line_that_was_cut_costs_its_own_name_alone() {
        let folder = tempfile::tempdir().unwrap();
        let list = folder.path().join("taken.txt");
        let taken = again(&list);
        assert!(taken.claim("a.fits") && !taken.claim("a.fits"));
        taken.record("a.fits", None);
        taken.record("b.fits", Some("expected a whole file,\nfound half of one"));
        assert!(taken.claim("not whole yet.fits"));
        taken.release("not whole yet.fits");
        drop(taken);
        let cut = std::fs::read_to_string(&list).unwrap() + "c.fi";
        assert!(
            cut.contains("b.fits\texpected a whole file,?found"),
            "{cut}"
        );
        std::fs::write(&list, cut).unwrap();
        let taken = again(&list);
        let is_known = |name| taken.knows(name);
        assert_eq!(
            ["a.fits", "b.fits", "c.fi", "not whole yet.fits"].map(is_known),
            [true, true, false, false]
        );
        taken.record("d.fits", None);
        drop(taken);
        let taken = again(&list);
        assert!(taken.knows("a.fits") && taken.knows("d.fits") && !taken.knows("c.fits"));
    }

    #[test]
    fn a_list_that_cannot_be_written_holds_nothing_up_and_is_written_when_it_can() {
        let folder = tempfile::tempdir().unwrap();
        let disk = folder.path().join("disk");
        let list = disk.join("taken.txt");
        let taken = again(&list);
        (0..10).for_each(|n| taken.record(&format!("{n}.fits"), None));
        std::fs::create_dir(&disk).unwrap();
        let begun = Instant::now();
        while names_of(&list).unwrap().len() < 10 {
            assert!(begun.elapsed() < Duration::from_secs(60), "never written");
            thread::sleep(Duration::from_millis(10));
        }
    }

    #[test]
    fn a_list_that_cannot_be_read_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        assert!(
            TakenFiles::kept_in(folder.path())
                .start_with_list()
                .is_err()
        );
    }
}
