//! A disk that fails on command.

use solaspect::archive::disk::{Absent, Disk, DiskFile, Entry, Lock, Space};
use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex};

/// A fault of a disk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// The disk is full after this many bytes.
    Quota { bytes: usize },
    /// The operation of this name fails.
    Step(&'static str),
    /// The disk reports this percentage of free space, of 100 MB.
    Free(f64),
    /// The disk has ample space but only this many free files (inodes).
    Files(u64),
    /// Writes block, without an error, until the fault ends.
    Stuck,
    /// The disk is absent. Files opened before it disappeared stay unusable when it is back.
    Gone,
}

#[derive(Debug, Default)]
struct State {
    fault: Option<Fault>,
    written: usize,
    /// Number of writes of frames that had to wait.
    stuck: u64,
    /// Number of operations of frames that were refused.
    refused: u64,
    /// Number of times the disk disappeared.
    departures: u64,
}

/// A disk with faults that can be set and cleared.
#[derive(Debug)]
pub struct FaultyDisk {
    disk: Box<dyn Disk>,
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

impl FaultyDisk {
    pub fn new(disk: impl Disk + 'static) -> Arc<Self> {
        Arc::new(Self {
            disk: Box::new(disk),
            shared: Arc::default(),
        })
    }

    pub fn set(&self, fault: Option<Fault>) {
        let mut state = self.shared.state.lock().unwrap();
        state.departures += u64::from(fault == Some(Fault::Gone));
        state.fault = fault;
        drop(state);
        self.shared.changed.notify_all();
    }

    /// Waits until a write of a frame is blocked.
    pub fn wait_until_stuck(&self) {
        let state = self.shared.state.lock().unwrap();
        let stuck = self
            .shared
            .changed
            .wait_while(state, |state| state.stuck == 0);
        drop(stuck.unwrap());
    }

    /// Waits until an operation of a frame has been refused.
    pub fn wait_until_refused(&self) {
        let state = self.shared.state.lock().unwrap();
        let refused = self
            .shared
            .changed
            .wait_while(state, |state| state.refused == 0);
        drop(refused.unwrap());
    }
}

impl FaultyDisk {
    fn file(&self, path: &Path, file: Box<dyn DiskFile>) -> Box<dyn DiskFile> {
        Box::new(FaultyFile {
            file,
            is_frame: path.extension().is_some_and(|end| end == "part"),
            departures: self.shared.state.lock().unwrap().departures,
            shared: Arc::clone(&self.shared),
        })
    }
}

impl Shared {
    fn is_gone(&self) -> bool {
        self.state.lock().unwrap().fault == Some(Fault::Gone)
    }

    fn step(&self, step: &str) -> io::Result<()> {
        match self.state.lock().unwrap().fault {
            Some(Fault::Step(failing)) if failing == step => {
                Err(io::Error::other("a fault of the disk"))
            }
            Some(Fault::Gone) => Err(ErrorKind::NotFound.into()),
            _ => Ok(()),
        }
    }

    fn take(&self, bytes: usize, is_frame: bool) -> io::Result<()> {
        let mut state = self.state.lock().unwrap();
        if state.fault == Some(Fault::Stuck) {
            state.stuck += u64::from(is_frame);
            self.changed.notify_all();
            let stuck = |state: &mut State| state.fault == Some(Fault::Stuck);
            state = self.changed.wait_while(state, stuck).unwrap();
        }
        match state.fault {
            Some(Fault::Quota { bytes: most }) if state.written + bytes > most => {
                Err(ErrorKind::StorageFull.into())
            }
            _ => {
                state.written += bytes;
                Ok(())
            }
        }
    }
}

impl Disk for FaultyDisk {
    fn make_root(&self, folder: &Path) -> io::Result<()> {
        self.shared.step("make_root")?;
        self.disk.make_root(folder)
    }

    fn make_folder(&self, folder: &Path) -> io::Result<()> {
        self.shared.step("make_folder")?;
        self.disk.make_folder(folder)
    }

    fn create(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        self.shared.step("create")?;
        Ok(self.file(file, self.disk.create(file)?))
    }

    fn open(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        self.shared.step("open")?;
        Ok(self.file(file, self.disk.open(file)?))
    }

    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.shared.step("rename_new")?;
        self.disk.rename_new(from, to)
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        self.shared.step("sync_folder")?;
        self.disk.sync_folder(folder)
    }

    fn remove(&self, file: &Path) -> io::Result<()> {
        self.shared.step("remove")?;
        self.disk.remove(file)
    }

    fn remove_tree(&self, folder: &Path) -> io::Result<()> {
        self.shared.step("remove_tree")?;
        self.disk.remove_tree(folder)
    }

    fn link(&self, link: &Path, name: &Path) -> io::Result<()> {
        self.shared.step("link")?;
        self.disk.link(link, name)
    }

    fn exists(&self, path: &Path) -> bool {
        !self.shared.is_gone() && self.disk.exists(path)
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<Entry>> {
        self.shared.step("list")?;
        self.disk.list(folder)
    }

    fn lock(&self, file: &Path, absent: Absent) -> io::Result<Lock> {
        self.shared.step("lock")?;
        self.disk.lock(file, absent)
    }

    fn space(&self, folder: &Path) -> io::Result<Space> {
        match self.shared.state.lock().unwrap().fault {
            Some(Fault::Free(percent)) => Ok(Space {
                free_bytes: (percent * 1e6) as u64,
                total_bytes: 100_000_000,
                free_files: None,
            }),
            Some(Fault::Files(free_files)) => Ok(Space {
                free_bytes: 90_000_000_000,
                total_bytes: 100_000_000_000,
                free_files: Some(free_files),
            }),
            Some(Fault::Gone) => Err(ErrorKind::NotFound.into()),
            _ => self.disk.space(folder),
        }
    }
}

#[derive(Debug)]
struct FaultyFile {
    file: Box<dyn DiskFile>,
    is_frame: bool,
    /// Value of the disk's `departures` when the file was opened.
    departures: u64,
    shared: Arc<Shared>,
}

impl FaultyFile {
    fn step(&self, step: &str) -> io::Result<()> {
        if self.departures != self.shared.state.lock().unwrap().departures {
            return Err(io::Error::other("the file of a disk that has gone"));
        }
        self.shared.step(step).inspect_err(|_| {
            self.shared.state.lock().unwrap().refused += u64::from(self.is_frame);
            self.shared.changed.notify_all();
        })
    }
}

impl Write for FaultyFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.step("write")?;
        self.shared.take(bytes.len(), self.is_frame)?;
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl DiskFile for FaultyFile {
    fn sync(&mut self) -> io::Result<()> {
        self.step("sync")?;
        self.file.sync()
    }

    fn length(&mut self) -> io::Result<u64> {
        self.step("length")?;
        self.file.length()
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.step("cut")?;
        self.file.cut(length)
    }
}
