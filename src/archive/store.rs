//! Writing to the archive's disk: a file is there whole, or it is not there.
//!
//! A frame is encoded in memory, written under a temporary name in its own folder, brought to the disk (fsync),
//! and only then given its name, without replacing what may stand there; then the folder is brought to the disk too.
//! A power cut at any moment leaves whole files and at most a temporary, which begins with a dot, does not end in
//! `.fits`, and is swept away when the store is next opened. In a folder that was no archive before, nothing is swept.

use super::disk::{Absent, Disk, Entry, EntryKind, LocalDisk, Lock, Space};
use super::name::{NameTime, name};
use crate::bounded::within;
use crate::fits::{Card, FileError, Packing, Problem, Table, encode_frame, keyword};
use crate::frame::Frame;
use jiff::Timestamp;
use std::io::{self, ErrorKind};
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Ending of the name of a file that is being written; it begins with a dot.
pub const UNFINISHED: &str = ".part";

/// The file at an archive's root that distinguishes an archive's disk from the empty folder it is mounted on.
pub const MARK: &str = "archive.lock";

/// Frames with the same instrument, time and number that one folder takes.
const MOST_NAMESAKES: u32 = 1000;

/// Why the archive could not do its work.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ArchiveError {
    /// The operating system refused; a full disk, for one.
    #[error("{}: expected to {action}, found \"{cause}\"", .path.display())]
    Io {
        path: PathBuf,
        action: &'static str,
        cause: io::Error,
    },
    /// The frame or its keywords do not make a FITS file.
    #[error(transparent)]
    File(#[from] FileError),
    /// Far too many frames have the same name.
    #[error("{}: expected fewer than {MOST_NAMESAKES} frames of that name, found more", .path.display())]
    Namesakes { path: PathBuf },
    /// A folder or file that would not be under the archive's root.
    #[error("{}: expected a path that stays under the archive's folder, found one that leaves it", .path.display())]
    Outside { path: PathBuf },
}

impl ArchiveError {
    /// Whether another program has what was asked for.
    fn is_busy(&self) -> bool {
        matches!(self, Self::Io { cause, .. } if cause.kind() == ErrorKind::ResourceBusy)
    }
}

/// Says, of a failed operation, what it was and on which path.
pub(super) trait During<T> {
    fn during(self, action: &'static str, path: &Path) -> Result<T, ArchiveError>;
}

impl<T> During<T> for io::Result<T> {
    fn during(self, action: &'static str, path: &Path) -> Result<T, ArchiveError> {
        self.map_err(|cause| ArchiveError::Io {
            path: path.into(),
            action,
            cause,
        })
    }
}

/// An archive of one instrument's frames under one folder.
///
/// A store may be opened when it is made, or with its first frame; it may be unmounted and come back. The file
/// [`MARK`] at its root shows that the disk is there, and keeps other programs from writing to it. When the disk was mounted
/// again, the mark is another file: it is locked again, and partial files are removed.
#[derive(Debug)]
pub struct Store {
    disk: Arc<dyn Disk>,
    root: PathBuf,
    instrument: String,
    packing: Packing,
    /// Held while this program writes to the archive.
    claim: Mutex<Option<Claim>>,
    /// How often the disk was taken, and unfinished files that were removed: read while the claim waits for the disk.
    visits: AtomicU64,
    swept: AtomicUsize,
    flight_files: Mutex<Vec<FlightFile>>,
}

/// The archive is this program's.
#[derive(Debug)]
struct Claim {
    lock: Lock,
    /// Whether it began with this claim: other files there are not ours.
    is_new: bool,
    /// Whether it has been cleaned of what an earlier run left unfinished.
    is_prepared: bool,
}

/// A file that the archive must have while this program writes to it.
#[derive(Debug)]
struct FlightFile {
    file: Encoded,
    /// The disk's visit in which it was put there; none where the name may be another file's.
    visit: Option<u64>,
}

impl Store {
    /// A store on a disk that is not opened yet. The folder that holds the archive's must be there when it is opened:
    /// where a disk is not mounted, its mount point must not be made.
    pub fn new(
        disk: Arc<dyn Disk>,
        root: &Path,
        instrument: &str,
        packing: impl Into<Packing>,
    ) -> Self {
        Self {
            disk,
            root: root.into(),
            instrument: instrument.into(),
            packing: packing.into(),
            claim: Mutex::default(),
            visits: AtomicU64::new(0),
            swept: AtomicUsize::new(0),
            flight_files: Mutex::default(),
        }
    }

    /// Opens the archive at `root`, makes the folder and those above it if need be, and removes files that an earlier run
    /// left unfinished.
    ///
    /// # Errors
    /// Where the folder cannot be made or listed, a file in it not removed, or where another program writes to it.
    pub fn open(
        root: &Path,
        instrument: &str,
        packing: impl Into<Packing>,
    ) -> Result<Self, ArchiveError> {
        Self::open_on(Arc::new(LocalDisk), root, instrument, packing)
    }

    /// The same on another disk.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_on(
        disk: Arc<dyn Disk>,
        root: &Path,
        instrument: &str,
        packing: impl Into<Packing>,
    ) -> Result<Self, ArchiveError> {
        let store = Self::new(disk, root, instrument, packing);
        store
            .disk
            .make_root(root)
            .during("make the archive's folder", root)?;
        store.prepare()?;
        Ok(store)
    }

    /// Gives the archive files that stand in it before any frame does, again where the disk has lost them. Where another file
    /// bears the name already, they get `_2` and so on.
    pub fn add_flight_files(&self, files: impl IntoIterator<Item = Encoded>) {
        let file = |file| FlightFile { file, visit: None };
        self.flight_files().extend(files.into_iter().map(file));
    }

    /// Brings to the disk what it lacks of the files that were added.
    ///
    /// # Errors
    /// Where the disk refuses.
    pub fn put_flight_files(&self) -> Result<(), ArchiveError> {
        let visit = Some(self.visits());
        let mut files = self.flight_files();
        for own in files.iter_mut().filter(|own| own.visit != visit) {
            if own.visit.is_none() {
                own.file.name = self.free_name(&own.file.name)?;
            }
            if own.visit.is_none() || !self.has(&own.file.name) {
                self.place(&own.file)?;
            }
            own.visit = visit;
        }
        Ok(())
    }

    fn flight_files(&self) -> MutexGuard<'_, Vec<FlightFile>> {
        let files = self.flight_files.lock();
        files.unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes ready for writing, as [`open`](Self::open) does except for the folders above, if that has not been done; else checks
    /// whether the disk is still there, and locks it again where it was mounted again.
    ///
    /// # Errors
    /// As `open`; where the folder above is not there; and where the disk has gone, or an empty folder stands in its place.
    pub fn prepare(&self) -> Result<(), ArchiveError> {
        let mut claim = self.claim();
        let mark = self.root.join(MARK);
        match claim.as_ref() {
            None if self.visits() == 0 => {}
            _ => self.present()?,
        }
        let is_ours = |claim: &&mut Claim| claim.lock.is_of(&mark);
        let held = match claim.as_mut().filter(is_ours) {
            Some(held) if held.is_prepared => return Ok(()),
            Some(held) => held,
            None => {
                *claim = None;
                claim.insert(take(self.disk.as_ref(), &self.root, self.first_visit())?)
            }
        };
        if !held.is_new {
            self.swept.fetch_add(self.sweep()?, Ordering::Relaxed);
        }
        held.is_prepared = true;
        self.visits.fetch_add(1, Ordering::Release);
        Ok(())
    }

    fn claim(&self) -> MutexGuard<'_, Option<Claim>> {
        self.claim.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A disk that was there may go until it is locked; then no mark is made in its place.
    fn first_visit(&self) -> Absent {
        match self.visits() {
            0 => Absent::Made,
            _ => Absent::Refused,
        }
    }

    /// Takes the archive for this program alone before a flight begins, and leaves all else to [`prepare`](Self::prepare). A disk that is
    /// not there, refuses, or does not answer within `limit` is no error: it may come later.
    ///
    /// # Errors
    /// Another program writes to the archive.
    pub fn claim_within(&self, limit: Duration) -> Result<(), ArchiveError> {
        let (disk, root, absent) = (self.disk(), self.root.clone(), self.first_visit());
        match within(limit, move || take(disk.as_ref(), &root, absent)) {
            Ok(Ok(claim)) => {
                *self.claim() = Some(claim);
                Ok(())
            }
            Ok(Err(error)) if error.is_busy() => Err(error),
            Ok(Err(_)) | Err(_) => Ok(()),
        }
    }

    /// How often the disk was taken. Files that were opened before the last time are of no use.
    pub fn visits(&self) -> u64 {
        self.visits.load(Ordering::Acquire)
    }

    /// The disk of the archive.
    pub fn disk(&self) -> Arc<dyn Disk> {
        Arc::clone(&self.disk)
    }

    /// Whether the disk is there: where it is not, nothing may be written in its place.
    ///
    /// # Errors
    /// Where it has gone.
    pub fn present(&self) -> Result<(), ArchiveError> {
        let mark = self.root.join(MARK);
        match self.disk.exists(&mark) {
            true => Ok(()),
            false => {
                Err(io::Error::from(ErrorKind::NotFound)).during("find the disk's mark", &mark)
            }
        }
    }

    /// How many unfinished files of an earlier run were removed.
    pub fn swept(&self) -> usize {
        self.swept.load(Ordering::Relaxed)
    }

    pub fn root(&self) -> &Path {
        &self.root
    }

    /// How much the disk may yet take.
    ///
    /// # Errors
    /// Where the disk does not say.
    pub fn space(&self) -> Result<Space, ArchiveError> {
        self.disk
            .space(&self.root)
            .during("read the disk's free space", &self.root)
    }

    /// Archives a frame with further keywords and tables, and returns the file it is in. When this returns, the
    /// file is on the disk.
    ///
    /// # Errors
    /// Where the frame cannot be encoded (see [`write_frame`](crate::fits::write_frame)) or the disk refuses; then
    /// no file is left.
    pub fn write(
        &self,
        frame: &Frame,
        cards: &[Card],
        tables: &[Table],
    ) -> Result<PathBuf, ArchiveError> {
        self.put(&self.encode(Path::new(""), &self.instrument, frame, cards, tables)?)
    }

    /// The first half of [`write`](Self::write): chooses a name and makes the bytes of the file. `folder` is below
    /// the root, for one camera of several; empty for the root itself.
    ///
    /// # Errors
    /// Where the disk has gone, or the frame cannot be encoded.
    pub fn encode(
        &self,
        folder: &Path,
        instrument: &str,
        frame: &Frame,
        cards: &[Card],
        tables: &[Table],
    ) -> Result<Encoded, ArchiveError> {
        self.within(folder)?;
        self.prepare()?;
        let time = match frame.info.mid_exposure {
            Some(middle) => NameTime::MidExposure(middle),
            None => NameTime::Written(Timestamp::now()),
        };
        let name = folder.join(name(instrument, time, frame.info.number));
        let name = self.free_name(&name)?;
        let mut cards = cards.to_vec();
        let file_name = name.file_name().unwrap_or_default().to_string_lossy();
        cards.push(Card::new(&keyword::FILENAME, &*file_name));
        let bytes = encode_frame(frame, &cards, tables, self.packing)
            .map_err(|problem: Problem| problem.in_file(&self.root.join(&name)))?;
        Ok(Encoded { name, bytes })
    }

    /// The second half of [`write`](Self::write): brings the file to the disk. Another store's encoded frame will
    /// do, unless its name is taken here ([`has`](Self::has)).
    ///
    /// # Errors
    /// Where the disk refuses; then no file is left.
    pub fn put(&self, encoded: &Encoded) -> Result<PathBuf, ArchiveError> {
        self.prepare()?;
        self.put_flight_files()?;
        self.place(encoded)
    }

    /// As [`put`](Self::put), on a disk that is taken.
    fn place(&self, encoded: &Encoded) -> Result<PathBuf, ArchiveError> {
        let path = self.root.join(&encoded.name);
        let folder = path.parent().unwrap_or(&self.root);
        self.make_folders(encoded.name.parent().unwrap_or(Path::new("")))?;
        let unfinished = unfinished(&path);
        let named = self
            .write_unfinished(&unfinished, &encoded.bytes)
            .and_then(|()| {
                self.disk
                    .rename_new(&unfinished, &path)
                    .during("name the file", &path)
            });
        if named.is_err() {
            // What cannot be removed now is swept away at the next start.
            let _ = self.disk.remove(&unfinished);
        }
        named?;
        self.sync_folder(folder)?;
        Ok(path)
    }

    /// Whether a file of that name is here.
    pub fn has(&self, name: &Path) -> bool {
        self.disk.exists(&self.root.join(name))
    }

    /// Makes a folder under the root if need be, when the disk is there.
    ///
    /// # Errors
    /// As [`prepare`](Self::prepare), where the folder cannot be made, or is not under the root.
    pub fn enter(&self, folder: &Path) -> Result<(), ArchiveError> {
        self.prepare()?;
        self.make_folders(folder)
    }

    fn make_folders(&self, folder: &Path) -> Result<(), ArchiveError> {
        self.within(folder)?;
        let mut above = self.root.clone();
        for name in folder {
            let folder = above.join(name);
            match self.disk.make_folder(&folder) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                made => {
                    made.during("make a folder", &folder)?;
                    self.sync_folder(&above)?;
                }
            }
            above = folder;
        }
        Ok(())
    }

    /// Whether a folder is under the root, by its path alone.
    fn within(&self, folder: &Path) -> Result<(), ArchiveError> {
        let is_name = |part: Component| matches!(part, Component::Normal(_));
        match folder.components().all(is_name) {
            true => Ok(()),
            false => Err(ArchiveError::Outside {
                path: self.root.join(folder),
            }),
        }
    }

    fn write_unfinished(&self, path: &Path, bytes: &[u8]) -> Result<(), ArchiveError> {
        let mut file = self.disk.create(path).during("make the file", path)?;
        file.write_all(bytes).during("write the file", path)?;
        file.sync().during("bring the file to the disk", path)
    }

    fn sync_folder(&self, folder: &Path) -> Result<(), ArchiveError> {
        sync_folder(self.disk.as_ref(), folder)
    }

    /// The name itself, or with the first counter under which no file stands. One program writes to an archive, so
    /// the name stays free.
    fn free_name(&self, name: &Path) -> Result<PathBuf, ArchiveError> {
        (1..=MOST_NAMESAKES)
            .map(|n| namesake(name, n))
            .find(|candidate| !self.has(candidate))
            .ok_or_else(|| ArchiveError::Namesakes {
                path: self.root.join(name),
            })
    }

    /// Removes unfinished files from the root and all folders under it, and counts them.
    fn sweep(&self) -> Result<usize, ArchiveError> {
        let mut swept = 0;
        let mut folders = vec![self.root.clone()];
        while let Some(folder) = folders.pop() {
            let entries = self.disk.list(&folder).during("list the folder", &folder)?;
            for Entry { path, kind } in entries {
                match kind {
                    EntryKind::Folder => folders.push(path),
                    EntryKind::File if is_unfinished(&path) => {
                        self.disk
                            .remove(&path)
                            .during("remove the unfinished file", &path)?;
                        swept += 1;
                    }
                    EntryKind::File | EntryKind::Other => {}
                }
            }
        }
        Ok(swept)
    }
}

/// Locks the mark of the archive at `root`; where none was ever seen, the folder and its mark are made.
fn take(disk: &dyn Disk, root: &Path, absent: Absent) -> Result<Claim, ArchiveError> {
    if absent == Absent::Made {
        make_folder_in_place(disk, root)?;
    }
    let mark = root.join(MARK);
    let is_new = absent == Absent::Made && !disk.exists(&mark);
    match disk.lock(&mark, absent) {
        Ok(lock) => Ok(Claim {
            lock,
            is_new,
            is_prepared: false,
        }),
        Err(cause) => {
            let action = match cause.kind() {
                ErrorKind::ResourceBusy => "be the only program that writes to this archive",
                _ => "make the disk's mark",
            };
            Err(ArchiveError::Io {
                path: mark,
                action,
                cause,
            })
        }
    }
}

/// Makes the archive's folder if need be, in one that is there.
fn make_folder_in_place(disk: &dyn Disk, root: &Path) -> Result<(), ArchiveError> {
    if disk.exists(root) {
        return Ok(());
    }
    let parent = match root.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    if !disk.exists(parent) {
        let absent = Err(io::Error::from(ErrorKind::NotFound));
        return absent.during("find the folder that holds the archive's", parent);
    }
    disk.make_folder(root)
        .during("make the archive's folder", root)?;
    sync_folder(disk, parent)
}

fn sync_folder(disk: &dyn Disk, folder: &Path) -> Result<(), ArchiveError> {
    disk.sync_folder(folder)
        .during("bring the folder to the disk", folder)
}

/// A file's bytes, and its place under the root.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Encoded {
    pub name: PathBuf,
    pub bytes: Vec<u8>,
}

/// The n-th file of a name: `a.fits`, `a_2.fits`, `a_3.fits` ...
fn namesake(path: &Path, n: u32) -> PathBuf {
    if n == 1 {
        return path.into();
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}_{n}.{ending}"))
}

/// The name of a file while it is being written.
fn unfinished(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!(".{name}{UNFINISHED}"))
}

fn is_unfinished(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with('.') && name.ends_with(UNFINISHED)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fits::Compression;
    use crate::frame::{FrameInfo, Pixels};
    use std::fs;

    fn frame(mid_exposure: Option<&str>) -> Frame {
        let info = FrameInfo {
            number: Some(7),
            mid_exposure: mid_exposure.map(|utc| utc.parse().unwrap()),
            ..FrameInfo::default()
        };
        Frame::new(3, 2, Pixels::U8(vec![0, 1, 2, 3, 4, 255]), 255, info).unwrap()
    }

    fn store(root: &Path) -> Store {
        Store::open(root, "demo", Compression::Rice).unwrap()
    }

    #[test]
    fn a_folder_that_becomes_an_archive_keeps_what_others_have_in_it() {
        let root = tempfile::tempdir().unwrap();
        let theirs = root.path().join(".download.part");
        fs::write(&theirs, "half").unwrap();
        let store = store(root.path());
        assert_eq!((store.swept(), theirs.exists()), (0, true));
    }

    #[test]
    fn a_frame_is_never_written_over_another() {
        let root = tempfile::tempdir().unwrap();
        let store = store(root.path());
        let frame = frame(Some("2013-09-21T18:00:00.250Z"));
        let names: Vec<String> = (0..3)
            .map(|_| store.write(&frame, &[], &[]).unwrap())
            .map(|path| {
                path.strip_prefix(root.path())
                    .unwrap()
                    .display()
                    .to_string()
            })
            .collect();
        assert_eq!(
            names,
            [
                "20130921T18/demo_20130921T180000.250_00000007.fits",
                "20130921T18/demo_20130921T180000.250_00000007_2.fits",
                "20130921T18/demo_20130921T180000.250_00000007_3.fits",
            ]
        );
        for name in names {
            assert_eq!(
                crate::fits::read_frame(&root.path().join(name)).unwrap(),
                frame
            );
        }
    }

    #[test]
    fn a_frame_without_a_time_goes_to_the_undated_ones() {
        let root = tempfile::tempdir().unwrap();
        let path = store(root.path()).write(&frame(None), &[], &[]).unwrap();
        assert_eq!(path.parent(), Some(root.path().join("undated").as_path()));
        assert_eq!(crate::fits::read_frame(&path).unwrap(), frame(None));
    }

    #[test]
    fn what_a_power_cut_left_is_swept_and_counted_and_nothing_else() {
        let root = tempfile::tempdir().unwrap();
        let kept = store(root.path())
            .write(&frame(Some("2013-09-21T18:00:00Z")), &[], &[])
            .unwrap();
        let folder = kept.parent().unwrap();
        fs::write(folder.join(".Xy12.part"), "half").unwrap();
        fs::write(root.path().join(".zz.part"), "half").unwrap();
        fs::write(folder.join(".notes"), "mine").unwrap();
        assert_eq!(store(root.path()).swept(), 2);
        assert_eq!(store(root.path()).swept(), 0);
        let mut left: Vec<_> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect();
        left.sort();
        assert_eq!(left, [folder.join(".notes"), kept]);
    }

    #[test]
    fn a_refused_frame_leaves_no_file_and_names_the_path() {
        let root = tempfile::tempdir().unwrap();
        let card = [Card::new(&keyword::EXTNAME, "TWICE")];
        let error = store(root.path())
            .write(&frame(Some("2013-09-21T18:00:00Z")), &card, &[])
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("demo_20130921T180000.000_00000007.fits: EXTNAME"),
            "{error}"
        );
        let left: Vec<_> = fs::read_dir(root.path()).unwrap().flatten().collect();
        assert_eq!(left.len(), 1, "the mark: {left:?}");
    }

    #[test]
    fn nothing_is_written_outside_the_archives_folder() {
        let parent = tempfile::tempdir().unwrap();
        let store = store(&parent.path().join("archive"));
        for folder in ["../escaped", "/escaped", "a/../../escaped"] {
            let folder = Path::new(folder);
            let frame = frame(Some("2013-09-21T18:00:00Z"));
            let encoded = store.encode(folder, "demo", &frame, &[], &[]);
            for error in [encoded.unwrap_err(), store.enter(folder).unwrap_err()] {
                assert!(matches!(error, ArchiveError::Outside { .. }), "{error}");
            }
        }
        let left = fs::read_dir(parent.path()).unwrap();
        assert_eq!(left.count(), 1, "the archive");
    }

    #[test]
    fn the_folder_that_holds_the_archives_is_not_made_for_a_flight() {
        let parent = tempfile::tempdir().unwrap();
        let mount = parent.path().join("mount");
        let new = |root: &Path| Store::new(Arc::new(LocalDisk), root, "demo", Compression::Rice);
        let store = new(&mount.join("archive"));
        let error = store.prepare().unwrap_err().to_string();
        assert!(
            error.contains("mount: expected to find the folder"),
            "{error}"
        );
        assert!(!mount.exists());
        fs::create_dir(&mount).unwrap();
        store.prepare().unwrap();
        assert!(mount.join("archive").join(MARK).is_file());
    }

    #[test]
    fn a_disk_that_was_mounted_anew_is_locked_and_swept_again() {
        let parent = tempfile::tempdir().unwrap();
        let (root, away) = (parent.path().join("disk"), parent.path().join("away"));
        let store = store(&root);
        assert_eq!(store.visits(), 1);
        fs::rename(&root, &away).unwrap();
        fs::create_dir(&root).unwrap();
        assert!(store.prepare().is_err());
        fs::write(root.join(MARK), "").unwrap();
        fs::write(root.join(".half.part"), "half").unwrap();
        store.prepare().unwrap();
        assert_eq!((store.visits(), store.swept()), (2, 1));
        let second = Store::open(&root, "demo", Compression::Rice);
        assert!(second.unwrap_err().to_string().contains("the only program"));
    }

    #[test]
    fn an_archive_under_a_file_is_an_error_that_names_it() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("occupied");
        fs::write(&path, "").unwrap();
        let error = Store::open(&path, "demo", Compression::Rice)
            .unwrap_err()
            .to_string();
        assert!(error.contains("occupied: expected to make"), "{error}");
    }
}
