//! Writing to the archive's disk: a file is complete or absent.
//!
//! A frame is encoded in memory, written under a temporary name in its own folder, synced to the disk (fsync),
//! and only then renamed, without replacing an existing file; then the folder is synced too.
//! A power cut at any moment leaves complete files and at most a temporary one, which begins with a dot, does not end in
//! `.fits`, and is removed when the store is next opened. In a folder that was no archive before, nothing is removed.

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

/// The file at an archive's root that distinguishes an archive's disk from an empty mount point.
pub const MARK: &str = "archive.lock";

/// Largest number of frames with the same instrument, time and number in one folder.
const MOST_NAMESAKES: u32 = 1000;

/// Reason why an operation of the archive failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ArchiveError {
    /// The operating system refused, for example because the disk is full.
    #[error("{}: expected to {action}, found \"{cause}\"", .path.display())]
    Io {
        path: PathBuf,
        action: &'static str,
        cause: io::Error,
    },
    /// The frame or its keywords cannot be written as a FITS file.
    #[error(transparent)]
    File(#[from] FileError),
    /// Far too many frames have the same name.
    #[error("{}: expected fewer than {MOST_NAMESAKES} frames of that name, found more", .path.display())]
    Namesakes { path: PathBuf },
    /// A folder or file whose path is not under the archive's root.
    #[error("{}: expected a path that stays under the archive's folder, found one that leaves it", .path.display())]
    Outside { path: PathBuf },
}

impl ArchiveError {
    /// Whether another program holds the file.
    fn is_busy(&self) -> bool {
        matches!(self, Self::Io { cause, .. } if cause.kind() == ErrorKind::ResourceBusy)
    }
}

/// Adds to the error of a failed operation its name and path.
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
    /// Present while this program writes to the archive.
    claim: Mutex<Option<Claim>>,
    /// Number of times that the disk was taken; readable while the claim waits for the disk.
    visits: AtomicU64,
    swept: AtomicUsize,
    flight_files: Mutex<Vec<FlightFile>>,
}

/// This program's claim on the archive.
#[derive(Debug)]
struct Claim {
    lock: Lock,
    /// Whether the archive was new with this claim: other files there are then not ours.
    is_new: bool,
    /// Whether unfinished files of an earlier run have been removed.
    is_prepared: bool,
}

/// A file that the archive must have while this program writes to it.
#[derive(Debug)]
struct FlightFile {
    file: Encoded,
    /// The disk's visit in which it was put there; `None` if the name may belong to another file.
    visit: Option<u64>,
}

impl Store {
    /// A store on a disk that is not opened yet. The parent folder of the archive's must exist when it is opened:
    /// if a disk is not mounted, its mount point must not be made.
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

    /// Opens the archive at `root`, makes the folder and its parents if need be, and removes unfinished files of an earlier
    /// run.
    ///
    /// # Errors
    /// If the folder cannot be made or listed, a file in it cannot be removed, or another program writes to it.
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
            .during("create the archive's folder", root)?;
        store.prepare()?;
        Ok(store)
    }

    /// Adds files that the archive stores before any frame, and again if the disk has lost them. If another file
    /// has the name already, they get `_2` and so on.
    pub fn add_flight_files(&self, files: impl IntoIterator<Item = Encoded>) {
        let file = |file| FlightFile { file, visit: None };
        self.flight_files().extend(files.into_iter().map(file));
    }

    /// Writes those of the added files that the disk lacks.
    ///
    /// # Errors
    /// If the disk refuses.
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

    /// Prepares for writing, as [`open`](Self::open) does except for the parent folders, if that has not been done; else checks
    /// that the disk is still present, and locks it again if it was mounted again.
    ///
    /// # Errors
    /// As `open`; if the parent folder does not exist; and if the disk has gone, or an empty folder is in its place.
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

    /// Handling of a missing mark at the first visit: a disk that was present may go before it is locked; then no mark is made in its place.
    fn first_visit(&self) -> Absent {
        match self.visits() {
            0 => Absent::Made,
            _ => Absent::Refused,
        }
    }

    /// Claims the archive for this program alone before a flight begins, and leaves all else to [`prepare`](Self::prepare). A disk that is
    /// missing, refuses, or does not answer within `limit` is no error: it may come later.
    ///
    /// # Errors
    /// If another program writes to the archive.
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

    /// Number of times that the disk was taken. Files opened before the last time are useless.
    pub fn visits(&self) -> u64 {
        self.visits.load(Ordering::Acquire)
    }

    /// The disk of the archive.
    pub fn disk(&self) -> Arc<dyn Disk> {
        Arc::clone(&self.disk)
    }

    /// Checks that the disk is present: if it is not, nothing may be written in its place.
    ///
    /// # Errors
    /// If it has gone.
    pub fn present(&self) -> Result<(), ArchiveError> {
        let mark = self.root.join(MARK);
        match self.disk.exists(&mark) {
            true => Ok(()),
            false => {
                Err(io::Error::from(ErrorKind::NotFound)).during("find the disk's lock file", &mark)
            }
        }
    }

    /// Number of unfinished files of an earlier run that were removed.
    pub fn swept(&self) -> usize {
        self.swept.load(Ordering::Relaxed)
    }

    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Free space of the disk.
    ///
    /// # Errors
    /// If the disk does not report it.
    pub fn space(&self) -> Result<Space, ArchiveError> {
        self.disk
            .space(&self.root)
            .during("read the disk's free space", &self.root)
    }

    /// Archives a frame with further keywords and tables, and returns its file. When this returns, the
    /// file is on the disk.
    ///
    /// # Errors
    /// If the frame cannot be encoded (see [`write_frame`](crate::fits::write_frame)) or the disk refuses; then
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
    /// If the disk has gone, or the frame cannot be encoded.
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

    /// The second half of [`write`](Self::write): writes the file to the disk. A frame encoded by another store may be
    /// used, unless its name exists here ([`has`](Self::has)).
    ///
    /// # Errors
    /// If the disk refuses; then no file is left.
    pub fn put(&self, encoded: &Encoded) -> Result<PathBuf, ArchiveError> {
        self.prepare()?;
        self.put_flight_files()?;
        self.place(encoded)
    }

    /// As [`put`](Self::put), on a disk that has been taken.
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
            // If it cannot be removed now, the next start removes it.
            let _ = self.disk.remove(&unfinished);
        }
        named?;
        self.sync_folder(folder)?;
        Ok(path)
    }

    /// Whether a file of that name exists.
    pub fn has(&self, name: &Path) -> bool {
        self.disk.exists(&self.root.join(name))
    }

    /// Makes a folder under the root if need be, if the disk is present.
    ///
    /// # Errors
    /// As [`prepare`](Self::prepare); if the folder cannot be made, or is not under the root.
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
        file.sync().during("flush the file to the disk", path)
    }

    fn sync_folder(&self, folder: &Path) -> Result<(), ArchiveError> {
        sync_folder(self.disk.as_ref(), folder)
    }

    /// The name itself, or the name with the first counter that is free. Only one program writes to an archive, so
    /// the name stays free.
    fn free_name(&self, name: &Path) -> Result<PathBuf, ArchiveError> {
        (1..=MOST_NAMESAKES)
            .map(|n| namesake(name, n))
            .find(|candidate| !self.has(candidate))
            .ok_or_else(|| ArchiveError::Namesakes {
                path: self.root.join(name),
            })
    }

    /// Removes unfinished files from the root and all its subfolders, and counts them.
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

/// Locks the mark of the archive at `root`; if `absent` allows it, makes the folder and its mark.
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
                _ => "create the disk's lock file",
            };
            Err(ArchiveError::Io {
                path: mark,
                action,
                cause,
            })
        }
    }
}

/// Makes the archive's folder if need be, in an existing one.
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
        .during("create the archive's folder", root)?;
    sync_folder(disk, parent)
}

fn sync_folder(disk: &dyn Disk, folder: &Path) -> Result<(), ArchiveError> {
    disk.sync_folder(folder)
        .during("flush the folder to the disk", folder)
}

/// A file's bytes, and its path under the root.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Encoded {
    pub name: PathBuf,
    pub bytes: Vec<u8>,
}

/// The n-th file with the same name: `a.fits`, `a_2.fits`, `a_3.fits` ...
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
        assert!(error.contains("occupied: expected to create"), "{error}");
    }
}
