//! A disk that fails on command: for the soak test, and for training operators.

use super::disk::{Absent, Disk, DiskFile, Entry, LocalDisk, Lock, Space};
use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Duration of the failure of each operation when they fail in turn.
pub const EACH: Duration = Duration::from_millis(500);

/// An operation of the disk.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Step {
    MakeFolder,
    Create,
    Open,
    Write,
    Cut,
    Sync,
    Rename,
    SyncFolder,
    Remove,
    Exists,
    List,
    Lock,
    Space,
}

const STEPS: [Step; 13] = [
    Step::MakeFolder,
    Step::Create,
    Step::Open,
    Step::Write,
    Step::Cut,
    Step::Sync,
    Step::Rename,
    Step::SyncFolder,
    Step::Remove,
    Step::Exists,
    Step::List,
    Step::Lock,
    Step::Space,
];

/// Time until every operation has failed once.
pub const ALL_IN_TURN: Duration = Duration::from_millis(500 * STEPS.len() as u64);

/// Fault of a disk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DiskFault {
    /// It accepts no byte, and reports that none is free.
    Full,
    /// It can make no further file, and reports that.
    NoInodes,
    /// It refuses to make or write any file.
    Refusing,
    /// From this time on one operation after the other fails, each for [`EACH`].
    Failing(Instant),
    /// No call returns until the fault is removed.
    Stuck,
}

/// A folder of this computer as a disk with faults. Clones share the faults.
#[derive(Debug, Clone, Default)]
pub struct FaultyDisk {
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    fault: Option<DiskFault>,
    /// Number of times that the disk has dropped: files that were open then are invalid.
    dropped: u64,
}

impl FaultyDisk {
    pub fn set(&self, fault: Option<DiskFault>) {
        self.shared.state().fault = fault;
        self.shared.changed.notify_all();
    }

    fn file(&self, file: Box<dyn DiskFile>) -> Box<dyn DiskFile> {
        Box::new(FaultyFile {
            file,
            shared: Arc::clone(&self.shared),
            dropped: self.shared.state().dropped,
        })
    }

    /// Makes every open file invalid, as after an unmount.
    pub fn drop_files(&self) {
        self.shared.state().dropped += 1;
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn pass(&self, step: Step) -> io::Result<()> {
        let stuck = |state: &mut State| state.fault == Some(DiskFault::Stuck);
        let state = self
            .changed
            .wait_while(self.state(), stuck)
            .unwrap_or_else(PoisonError::into_inner);
        let fault = || Err(io::Error::other("a fault of the disk"));
        match state.fault {
            Some(DiskFault::Full) if step == Step::Write => Err(ErrorKind::StorageFull.into()),
            Some(DiskFault::NoInodes) if matches!(step, Step::Create | Step::MakeFolder) => {
                Err(ErrorKind::StorageFull.into())
            }
            Some(DiskFault::Refusing) if matches!(step, Step::Create | Step::Write) => fault(),
            Some(DiskFault::Failing(since)) => {
                let turn = since.elapsed().as_millis() / EACH.as_millis();
                match STEPS.get(turn as usize) {
                    Some(failing) if *failing == step => fault(),
                    _ => Ok(()),
                }
            }
            _ => Ok(()),
        }
    }
}

impl Disk for FaultyDisk {
    fn make_root(&self, folder: &Path) -> io::Result<()> {
        self.shared.pass(Step::MakeFolder)?;
        LocalDisk.make_root(folder)
    }

    fn make_folder(&self, folder: &Path) -> io::Result<()> {
        self.shared.pass(Step::MakeFolder)?;
        LocalDisk.make_folder(folder)
    }

    fn create(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        self.shared.pass(Step::Create)?;
        Ok(self.file(LocalDisk.create(file)?))
    }

    fn open(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        self.shared.pass(Step::Open)?;
        Ok(self.file(LocalDisk.open(file)?))
    }

    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.shared.pass(Step::Rename)?;
        LocalDisk.rename_new(from, to)
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        self.shared.pass(Step::SyncFolder)?;
        LocalDisk.sync_folder(folder)
    }

    fn remove(&self, file: &Path) -> io::Result<()> {
        self.shared.pass(Step::Remove)?;
        LocalDisk.remove(file)
    }

    fn remove_tree(&self, folder: &Path) -> io::Result<()> {
        self.shared.pass(Step::Remove)?;
        LocalDisk.remove_tree(folder)
    }

    fn link(&self, link: &Path, name: &Path) -> io::Result<()> {
        self.shared.pass(Step::Rename)?;
        LocalDisk.link(link, name)
    }

    fn exists(&self, path: &Path) -> bool {
        self.shared.pass(Step::Exists).is_ok() && LocalDisk.exists(path)
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<Entry>> {
        self.shared.pass(Step::List)?;
        LocalDisk.list(folder)
    }

    fn lock(&self, file: &Path, absent: Absent) -> io::Result<Lock> {
        self.shared.pass(Step::Lock)?;
        LocalDisk.lock(file, absent)
    }

    fn space(&self, folder: &Path) -> io::Result<Space> {
        self.shared.pass(Step::Space)?;
        let mut space = LocalDisk.space(folder)?;
        match self.shared.state().fault {
            Some(DiskFault::Full) => space.free_bytes = 0,
            Some(DiskFault::NoInodes) => space.free_files = Some(0),
            _ => {}
        }
        Ok(space)
    }
}

#[derive(Debug)]
struct FaultyFile {
    file: Box<dyn DiskFile>,
    shared: Arc<Shared>,
    /// Number of drops of the disk when the file was opened.
    dropped: u64,
}

impl FaultyFile {
    fn pass(&self, step: Step) -> io::Result<()> {
        self.shared.pass(step)?;
        match self.shared.state().dropped == self.dropped {
            true => Ok(()),
            false => Err(io::Error::other("the disk has dropped")),
        }
    }
}

impl Write for FaultyFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.pass(Step::Write)?;
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl DiskFile for FaultyFile {
    fn sync(&mut self) -> io::Result<()> {
        self.pass(Step::Sync)?;
        self.file.sync()
    }

    fn length(&mut self) -> io::Result<u64> {
        self.pass(Step::Open)?;
        self.file.length()
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.pass(Step::Cut)?;
        self.file.cut(length)
    }
}
