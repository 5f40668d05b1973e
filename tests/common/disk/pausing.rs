//! A disk that stops before a step, so that the writing process can be killed there.

use solaspect::archive::disk::{Absent, Disk, DiskFile, Entry, LocalDisk, Lock, Space};
use std::io::{self, Write};
use std::path::Path;
use std::sync::{Arc, Mutex};

/// A disk on which the operation with a given number calls `say` and then blocks forever.
#[derive(Debug)]
pub struct PausingDisk {
    disk: LocalDisk,
    steps: Arc<Steps>,
}

#[derive(Debug)]
struct Steps {
    left: Mutex<Option<u64>>,
    say: fn(),
}

impl Steps {
    /// Counts an operation; with `None` none blocks.
    fn step(&self) {
        let mut left = self.left.lock().unwrap();
        match &mut *left {
            Some(0) => {
                (self.say)();
                loop {
                    std::thread::park();
                }
            }
            Some(left) => *left -= 1,
            None => {}
        }
    }
}

impl PausingDisk {
    pub fn new(disk: LocalDisk, steps: Option<u64>, say: fn()) -> Self {
        let left = Mutex::new(steps);
        Self {
            disk,
            steps: Arc::new(Steps { left, say }),
        }
    }
}

impl Disk for PausingDisk {
    fn make_root(&self, folder: &Path) -> io::Result<()> {
        self.disk.make_root(folder)
    }

    fn make_folder(&self, folder: &Path) -> io::Result<()> {
        self.steps.step();
        self.disk.make_folder(folder)
    }

    fn create(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        self.steps.step();
        let file = self.disk.create(file)?;
        let steps = Arc::clone(&self.steps);
        Ok(Box::new(PausingFile { file, steps }))
    }

    fn open(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        self.disk.open(file)
    }

    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.steps.step();
        self.disk.rename_new(from, to)
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        self.steps.step();
        self.disk.sync_folder(folder)
    }

    fn remove(&self, file: &Path) -> io::Result<()> {
        self.disk.remove(file)
    }

    fn remove_tree(&self, folder: &Path) -> io::Result<()> {
        self.disk.remove_tree(folder)
    }

    fn link(&self, link: &Path, name: &Path) -> io::Result<()> {
        self.disk.link(link, name)
    }

    fn exists(&self, path: &Path) -> bool {
        self.disk.exists(path)
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<Entry>> {
        self.disk.list(folder)
    }

    fn lock(&self, file: &Path, absent: Absent) -> io::Result<Lock> {
        self.disk.lock(file, absent)
    }

    fn space(&self, folder: &Path) -> io::Result<Space> {
        self.disk.space(folder)
    }
}

#[derive(Debug)]
struct PausingFile {
    file: Box<dyn DiskFile>,
    steps: Arc<Steps>,
}

impl Write for PausingFile {
    /// Writes two halves, so that a file may be left half written.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let (half, rest) = bytes.split_at(bytes.len() / 2);
        self.steps.step();
        self.file.write_all(half)?;
        self.steps.step();
        self.file.write_all(rest)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl DiskFile for PausingFile {
    fn sync(&mut self) -> io::Result<()> {
        self.steps.step();
        self.file.sync()
    }

    fn length(&mut self) -> io::Result<u64> {
        self.file.length()
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.file.cut(length)
    }
}
