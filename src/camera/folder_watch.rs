//! Events in a folder and its subfolders: files that appear, and files that are written to their end.
//!
//! The kernel reports them (inotify). It does not report files that other computers write to a shared file system: such a folder is listed
//! repeatedly. Folders are listed on threads of their own, as that may take long; reports are read only between listings, so that all folders
//! they mention are known.

use super::CameraError;
use crate::fits::{self, Unlisted};
use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, poll};
use nix::sys::inotify::{AddWatchFlags, InitFlags, Inotify, InotifyEvent, WatchDescriptor};
use nix::sys::statfs::statfs;
use std::collections::{HashMap, VecDeque};
use std::fs;
use std::os::fd::AsRawFd;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant, SystemTime};

/// Shortest interval between two listings of a folder for which the kernel reports nothing.
const LIST_EVERY: Duration = Duration::from_millis(250);
/// The same interval, as a multiple of the time that a listing takes.
const LISTING_SHARE: u32 = 10;
/// How often the folder is checked: a disk may be gone, or another one mounted in its place.
const CHECK_EVERY: Duration = Duration::from_secs(1);
/// Blocks of reports that are read at a time, so that frames are read in between.
const MOST_BLOCKS: usize = 64;

/// Events of a folder that the kernel is to report.
const REPORTED: AddWatchFlags = AddWatchFlags::IN_CREATE
    .union(AddWatchFlags::IN_CLOSE_WRITE)
    .union(AddWatchFlags::IN_MOVED_FROM)
    .union(AddWatchFlags::IN_MOVED_TO)
    .union(AddWatchFlags::IN_ONLYDIR);

/// File systems that computers share, by their type numbers in statfs(2).
const SHARED: [u32; 9] = [
    0x0000_6969, // NFS
    0x0000_517b, // SMB
    0xff53_4d42, // CIFS
    0xfe53_4d42, // SMB 2
    0x6573_5546, // FUSE, as sshfs is
    0x0102_1997, // 9P
    0x00c3_6400, // Ceph
    0x0bd0_0bd0, // Lustre
    0x5346_414f, // AFS
];

/// Length and time of the last change of a file.
pub(super) type FileState = (u64, SystemTime);

/// The state of a regular file; `None` if there is none.
pub(super) fn state_of(file: &Path) -> Option<FileState> {
    let found = fs::metadata(file).ok().filter(fs::Metadata::is_file)?;
    Some((found.len(), found.modified().ok()?))
}

/// An event, or the result of a listing.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Change {
    /// Files in a folder, in the order of their names; it is not known whether they are complete.
    Listed(Vec<(PathBuf, FileState)>),
    /// A file that was created, and may still be written.
    Created(PathBuf),
    /// A file that was closed after writing, or renamed into place.
    Complete(PathBuf),
    /// A file that was here has been renamed or moved away.
    Gone(PathBuf),
    /// A file was renamed within the folder.
    Renamed { from: PathBuf, to: PathBuf },
    /// Files whose paths have changed because their folder was renamed.
    Moved(Vec<PathBuf>),
}

/// A requested listing.
#[derive(Debug)]
enum Request {
    /// Listing of the whole folder, because reports may be missing.
    All,
    /// Listing of a new folder.
    New(PathBuf),
    /// Listing of a folder that was renamed.
    Moved(PathBuf),
}

/// A folder that is watched.
pub(super) struct FolderWatch {
    root: PathBuf,
    /// Device and number of the folder.
    identity: (u64, u64),
    checked: Instant,
    /// `None` if the folder is listed repeatedly instead.
    reports: Option<Arc<Reports>>,
    folders: HashMap<WatchDescriptor, PathBuf>,
    /// Last renaming: the cookie that both of its reports have, and the old name.
    leaving: Option<(u32, PathBuf)>,
    queue: VecDeque<Request>,
    listing: Option<Listing>,
    /// Time of the next listing of a folder that is listed repeatedly.
    due: Instant,
}

/// A listing in progress.
struct Listing {
    request: Request,
    begun: Instant,
    answer: Receiver<Result<Tree, Unlisted>>,
}

/// Result of a listing.
struct Tree {
    files: Vec<(PathBuf, FileState)>,
    folders: Vec<(WatchDescriptor, PathBuf)>,
    /// Reason why the kernel stopped reporting on a folder.
    unreported: Option<Errno>,
}

impl FolderWatch {
    /// Begins to watch a folder. The files in it are the first change.
    ///
    /// # Errors
    /// If there is no such folder.
    pub fn start(root: &Path) -> Result<Self, CameraError> {
        let now = Instant::now();
        Ok(Self {
            root: root.into(),
            identity: identity(root)?,
            checked: now,
            reports: match is_shared(root) {
                true => None,
                false => Reports::start().map(Arc::new).ok(),
            },
            folders: HashMap::new(),
            leaving: None,
            queue: VecDeque::from([Request::All]),
            listing: None,
            due: now,
        })
    }

    /// Waits for changes, at most for this time.
    ///
    /// # Errors
    /// If the folder is gone, or another one is in its place: it must be watched again.
    pub fn wait(&mut self, timeout: Duration) -> Result<Vec<Change>, CameraError> {
        self.check()?;
        if self.listing.is_none() {
            self.list_next()?;
        }
        if let Some(listing) = &self.listing {
            return match listing.answer.recv_timeout(timeout) {
                Ok(tree) => self.listed(tree),
                Err(RecvTimeoutError::Timeout) => Ok(Vec::new()),
                Err(RecvTimeoutError::Disconnected) => {
                    Err(self.problem("a listing that failed by itself"))
                }
            };
        }
        let Some(reports) = self.reports.clone() else {
            thread::sleep(
                self.due
                    .saturating_duration_since(Instant::now())
                    .min(timeout),
            );
            return Ok(Vec::new());
        };
        let mut changes = Vec::new();
        for report in reports.read(timeout).map_err(|error| self.problem(error))? {
            self.interpret(report, &mut changes);
        }
        Ok(changes)
    }

    /// The same for a folder on which the kernel reports nothing.
    #[cfg(test)]
    pub fn start_unreported(root: &Path) -> Result<Self, CameraError> {
        let reports = None;
        Ok(Self {
            reports,
            ..Self::start(root)?
        })
    }

    fn problem(&self, found: impl ToString) -> CameraError {
        problem(&self.root, found)
    }

    /// Whether the folder is still the one that was watched.
    fn check(&mut self) -> Result<(), CameraError> {
        if self.checked.elapsed() < CHECK_EVERY {
            return Ok(());
        }
        self.checked = Instant::now();
        match identity(&self.root)? == self.identity {
            true => Ok(()),
            false => Err(self.problem("another one in its place, which is followed now")),
        }
    }

    /// Begins the next requested listing.
    fn list_next(&mut self) -> Result<(), CameraError> {
        if self.reports.is_none() && self.queue.is_empty() && Instant::now() >= self.due {
            self.queue.push_back(Request::All);
        }
        let Some(request) = self.queue.pop_front() else {
            return Ok(());
        };
        let folder = match &request {
            Request::All => self.root.clone(),
            Request::New(folder) | Request::Moved(folder) => folder.clone(),
        };
        let (give, answer) = bounded(1);
        let reports = self.reports.clone();
        let list = move || {
            // The receiver is gone if the folder is no longer watched.
            let _ = give.send(tree(folder, reports.as_deref()));
        };
        let name = "folder-listing".to_string();
        let spawned = thread::Builder::new().name(name).spawn(list);
        spawned.map_err(|error| self.problem(error))?;
        let begun = Instant::now();
        self.listing = Some(Listing {
            request,
            begun,
            answer,
        });
        Ok(())
    }

    /// Changes from the result of a listing.
    fn listed(&mut self, tree: Result<Tree, Unlisted>) -> Result<Vec<Change>, CameraError> {
        let Some(Listing { request, begun, .. }) = self.listing.take() else {
            return Ok(Vec::new());
        };
        self.due = Instant::now() + LIST_EVERY.max(LISTING_SHARE * begun.elapsed());
        let tree = match tree {
            Ok(tree) => tree,
            Err(unlisted) if matches!(request, Request::All) => {
                return Err(self.problem(unlisted.cause));
            }
            // The folder came and went.
            Err(_) => return Ok(Vec::new()),
        };
        if let Some(error) = tree.unreported {
            let folder = self.root.display().to_string();
            tracing::warn!(folder, %error, "the kernel reports no changes of it: it is listed again and again");
            self.reports = None;
            self.folders.clear();
        }
        self.folders.extend(tree.folders);
        let moved = |files: Vec<(PathBuf, FileState)>| files.into_iter().map(|file| file.0);
        Ok(vec![match request {
            Request::All | Request::New(_) => Change::Listed(tree.files),
            Request::Moved(_) => Change::Moved(moved(tree.files).collect()),
        }])
    }

    fn interpret(&mut self, report: InotifyEvent, changes: &mut Vec<Change>) {
        let is = |what| report.mask.contains(what);
        if is(AddWatchFlags::IN_Q_OVERFLOW) {
            tracing::warn!(folder = %self.root.display(), "more happened than the kernel could report: it is listed again");
            self.queue = VecDeque::from([Request::All]);
        }
        if is(AddWatchFlags::IN_IGNORED) {
            self.folders.remove(&report.wd);
        }
        let Some((folder, name)) = self.folders.get(&report.wd).zip(report.name.as_ref()) else {
            return;
        };
        let path = folder.join(name);
        if is(AddWatchFlags::IN_MOVED_FROM) {
            self.leaving = Some((report.cookie, path.clone()));
        }
        let moved_from = self.leaving.as_ref();
        let moved_from = moved_from.filter(|(cookie, _)| *cookie == report.cookie);
        let moved_from = moved_from.map(|(_, from)| from.clone());
        let has_come = is(AddWatchFlags::IN_MOVED_TO);
        if is(AddWatchFlags::IN_ISDIR) {
            match moved_from.filter(|_| has_come) {
                _ if fits::is_hidden(&path) => {}
                Some(from) if !fits::is_hidden(&from) => self.queue.push_back(Request::Moved(path)),
                _ if has_come || is(AddWatchFlags::IN_CREATE) => {
                    self.queue.push_back(Request::New(path));
                }
                _ => {}
            }
            return;
        }
        changes.push(match moved_from {
            Some(from) if has_come => Change::Renamed { from, to: path },
            _ if has_come || is(AddWatchFlags::IN_CLOSE_WRITE) => Change::Complete(path),
            _ if is(AddWatchFlags::IN_MOVED_FROM) => Change::Gone(path),
            _ if is(AddWatchFlags::IN_CREATE) => Change::Created(path),
            _ => return,
        });
    }
}

fn problem(folder: &Path, found: impl ToString) -> CameraError {
    CameraError::Folder {
        folder: folder.into(),
        found: found.to_string(),
    }
}

/// Device and number of a folder.
fn identity(folder: &Path) -> Result<(u64, u64), CameraError> {
    match fs::metadata(folder) {
        Ok(found) if found.is_dir() => Ok((found.dev(), found.ino())),
        Ok(_) => Err(problem(folder, "a file")),
        Err(error) => Err(problem(folder, format!("\"{error}\""))),
    }
}

/// Whether other computers may write to the file system of a folder.
fn is_shared(folder: &Path) -> bool {
    // The numbers have 32 bits, in a type that is wider on some machines.
    statfs(folder).is_ok_and(|found| SHARED.contains(&(found.filesystem_type().0 as u32)))
}

/// The frames in a folder and its subfolders. Reports on each folder are switched on before it is listed, so that a file that comes meanwhile is
/// found twice rather than missed.
fn tree(folder: PathBuf, reports: Option<&Reports>) -> Result<Tree, Unlisted> {
    let mut tree = Tree {
        files: Vec::new(),
        folders: Vec::new(),
        unreported: None,
    };
    let root = folder.clone();
    let mut folders = vec![folder];
    while let Some(folder) = folders.pop() {
        match reports.map(|reports| reports.0.add_watch(&folder, REPORTED)) {
            Some(Ok(number)) => tree.folders.push((number, folder.clone())),
            // A folder that is gone cannot be listed either.
            None | Some(Err(Errno::ENOENT | Errno::ENOTDIR | Errno::EACCES)) => {}
            Some(Err(error)) => tree.unreported = Some(error),
        }
        match fits::list_folder(&folder) {
            Ok(listing) => {
                let with_state = |file: PathBuf| state_of(&file).map(|state| (file, state));
                tree.files
                    .extend(listing.files.into_iter().filter_map(with_state));
                folders.extend(listing.folders);
            }
            Err(unlisted) if folder == root => return Err(unlisted),
            // A subfolder that is gone again, or that belongs to another user, such as lost+found.
            Err(unlisted) => tracing::warn!("{unlisted}: ignored"),
        }
    }
    tree.files.sort();
    Ok(tree)
}

/// The kernel's reports.
#[derive(Debug)]
struct Reports(Inotify);

impl Reports {
    fn start() -> Result<Self, Errno> {
        Inotify::init(InitFlags::IN_CLOEXEC | InitFlags::IN_NONBLOCK).map(Self)
    }

    /// Waits for reports, at most for this time.
    fn read(&self, timeout: Duration) -> Result<Vec<InotifyEvent>, Errno> {
        let mut waiting = [PollFd::new(self.0.as_raw_fd(), PollFlags::POLLIN)];
        let timeout_ms = i32::try_from(timeout.as_millis()).unwrap_or(i32::MAX);
        match poll(&mut waiting, timeout_ms) {
            Ok(_) | Err(Errno::EINTR) => {}
            Err(error) => return Err(error),
        }
        let mut reports = Vec::new();
        for _ in 0..MOST_BLOCKS {
            match self.0.read_events() {
                Ok(more) => reports.extend(more),
                Err(Errno::EAGAIN | Errno::EINTR) => break,
                Err(error) => return Err(error),
            }
        }
        Ok(reports)
    }
}

impl Drop for Reports {
    fn drop(&mut self) {
        // A plain file descriptor: no other owner closes it.
        let _ = nix::unistd::close(self.0.as_raw_fd());
    }
}
