//! A disk that fails as it is told to.

use solaspect::archive::disk::{Disk, DiskFile, Entry, Lock, Space};
use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex};

/// What is wrong with a disk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// It takes no more than so many bytes.
    Quota { bytes: usize },
    /// An operation fails.
    Step(&'static str),
    /// It says that so much is free.
    Free(f64),
    /// It takes no byte and says nothing, until the fault is gone.
    Stuck,
}

#[derive(Debug, Default)]
struct State {
    fault: Option<Fault>,
    written: usize,
    stuck: u64,
}

/// A disk with a fault that comes and goes.
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
        self.shared.state.lock().unwrap().fault = fault;
        self.shared.changed.notify_all();
    }

    /// Waits until somebody waits for the disk.
    pub fn wait_until_stuck(&self) {
        let state = self.shared.state.lock().unwrap();
        let stuck = self
            .shared
            .changed
            .wait_while(state, |state| state.stuck == 0);
        drop(stuck.unwrap());
    }
}

impl Shared {
    fn step(&self, step: &str) -> io::Result<()> {
        match self.state.lock().unwrap().fault {
            Some(Fault::Step(failing)) if failing == step => {
                Err(io::Error::other("a fault of the disk"))
            }
            _ => Ok(()),
        }
    }

    fn take(&self, bytes: usize) -> io::Result<()> {
        let mut state = self.state.lock().unwrap();
        if state.fault == Some(Fault::Stuck) {
            state.stuck += 1;
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
        self.disk.make_root(folder)
    }

    fn make_folder(&self, folder: &Path) -> io::Result<()> {
        self.shared.step("make_folder")?;
        self.disk.make_folder(folder)
    }

    fn create(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        self.shared.step("create")?;
        Ok(Box::new(FaultyFile {
            file: self.disk.create(file)?,
            shared: Arc::clone(&self.shared),
        }))
    }

    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.shared.step("rename_new")?;
        self.disk.rename_new(from, to)
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        self.disk.sync_folder(folder)
    }

    fn remove(&self, file: &Path) -> io::Result<()> {
        self.disk.remove(file)
    }

    fn exists(&self, path: &Path) -> bool {
        self.disk.exists(path)
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<Entry>> {
        self.disk.list(folder)
    }

    fn lock(&self, file: &Path) -> io::Result<Lock> {
        self.disk.lock(file)
    }

    fn space(&self, folder: &Path) -> io::Result<Space> {
        match self.shared.state.lock().unwrap().fault {
            Some(Fault::Free(percent)) => Ok(Space {
                free_bytes: (percent * 1e6) as u64,
                total_bytes: 100_000_000,
            }),
            _ => self.disk.space(folder),
        }
    }
}

struct FaultyFile {
    file: Box<dyn DiskFile>,
    shared: Arc<Shared>,
}

impl Write for FaultyFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.shared.step("write")?;
        self.shared.take(bytes.len())?;
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl DiskFile for FaultyFile {
    fn sync(&mut self) -> io::Result<()> {
        self.shared.step("sync")?;
        self.file.sync()
    }
}
