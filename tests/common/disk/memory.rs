//! A model of a disk that loses power.

use solaspect::archive::disk::{Absent, Disk, DiskFile, Entry, EntryKind, Lock, Space};
use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// A model of a disk that loses unsynced data when the power is cut.
///
/// A file's bytes are durable once the file is synced, a name once its folder is. A name may also become durable
/// without a sync; it then refers to the durable bytes of its file.
#[derive(Debug, Default)]
pub struct Memory {
    model: Arc<Mutex<Model>>,
}

/// What remains of names that were not synced before a power cut.
#[derive(Debug, Clone, Copy)]
pub enum Persisted {
    OnlyWhatWasSynced,
    AllNames,
}

#[derive(Debug, Default)]
struct Model {
    steps_left: u64,
    /// The bytes of each file: current, and durable.
    files: Vec<(Vec<u8>, Vec<u8>)>,
    names: BTreeMap<PathBuf, Node>,
    lasting_names: BTreeMap<PathBuf, Node>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Node {
    Folder,
    File(usize),
}

impl Memory {
    /// A disk mounted at `/disk`, whose power is cut after `steps` operations.
    pub fn cut_after(steps: u64) -> Self {
        let mounts = BTreeMap::from([(PathBuf::from("/disk"), Node::Folder)]);
        let model = Model {
            steps_left: steps,
            names: mounts.clone(),
            lasting_names: mounts,
            ..Model::default()
        };
        Self {
            model: Arc::new(Mutex::new(model)),
        }
    }

    /// The files found after the power cut.
    pub fn files_after_the_cut(&self, persisted: Persisted) -> Vec<(PathBuf, Vec<u8>)> {
        let model = self.model.lock().unwrap();
        let names = match persisted {
            Persisted::OnlyWhatWasSynced => &model.lasting_names,
            Persisted::AllNames => &model.names,
        };
        let file = |(path, node): (&PathBuf, &Node)| match node {
            Node::File(n) => Some((path.clone(), model.files[*n].1.clone())),
            Node::Folder => None,
        };
        names.iter().filter_map(file).collect()
    }

    fn step(&self) -> io::Result<std::sync::MutexGuard<'_, Model>> {
        let mut model = self.model.lock().unwrap();
        model.step()?;
        Ok(model)
    }
}

impl Model {
    fn step(&mut self) -> io::Result<()> {
        match self.steps_left.checked_sub(1) {
            Some(left) => self.steps_left = left,
            None => return Err(io::Error::other("no power")),
        }
        Ok(())
    }

    fn add(&mut self, path: &Path, node: Node) -> io::Result<()> {
        if self.names.contains_key(path) {
            return Err(ErrorKind::AlreadyExists.into());
        }
        if !self.names.contains_key(path.parent().unwrap()) {
            return Err(ErrorKind::NotFound.into());
        }
        self.names.insert(path.into(), node);
        Ok(())
    }
}

impl Disk for Memory {
    fn make_root(&self, folder: &Path) -> io::Result<()> {
        let mut model = self.step()?;
        for folder in folder.ancestors() {
            model.names.insert(folder.into(), Node::Folder);
            model.lasting_names.insert(folder.into(), Node::Folder);
        }
        Ok(())
    }

    fn make_folder(&self, folder: &Path) -> io::Result<()> {
        self.step()?.add(folder, Node::Folder)
    }

    fn create(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        let mut model = self.step()?;
        let number = model.files.len();
        model.add(file, Node::File(number))?;
        model.files.push((Vec::new(), Vec::new()));
        let model = Arc::clone(&self.model);
        Ok(Box::new(MemoryFile { model, number }))
    }

    fn open(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        let number = match self.step()?.names.get(file) {
            Some(&Node::File(number)) => number,
            _ => return Err(ErrorKind::NotFound.into()),
        };
        let model = Arc::clone(&self.model);
        Ok(Box::new(MemoryFile { model, number }))
    }

    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut model = self.step()?;
        let node = *model.names.get(from).ok_or(ErrorKind::NotFound)?;
        model.add(to, node)?;
        model.names.remove(from);
        Ok(())
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        let mut model = self.step()?;
        let within = |path: &PathBuf| path.parent() == Some(folder);
        model.lasting_names.retain(|path, _| !within(path));
        let names: Vec<_> = model
            .names
            .iter()
            .map(|(path, node)| (path.clone(), *node))
            .collect();
        let names = names.into_iter().filter(|(path, _)| within(path));
        model.lasting_names.extend(names);
        Ok(())
    }

    fn remove(&self, file: &Path) -> io::Result<()> {
        self.step()?
            .names
            .remove(file)
            .map(drop)
            .ok_or(ErrorKind::NotFound.into())
    }

    fn remove_tree(&self, folder: &Path) -> io::Result<()> {
        let mut model = self.step()?;
        model.names.retain(|path, _| !path.starts_with(folder));
        Ok(())
    }

    fn link(&self, _: &Path, _: &Path) -> io::Result<()> {
        Err(ErrorKind::Unsupported.into())
    }

    fn exists(&self, path: &Path) -> bool {
        self.model.lock().unwrap().names.contains_key(path)
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<Entry>> {
        let model = self.step()?;
        let within = model
            .names
            .iter()
            .filter(|(path, _)| path.parent() == Some(folder));
        let entry = |(path, node): (&PathBuf, &Node)| Entry {
            path: path.clone(),
            kind: match node {
                Node::Folder => EntryKind::Folder,
                Node::File(_) => EntryKind::File,
            },
        };
        Ok(within.map(entry).collect())
    }

    fn lock(&self, file: &Path, absent: Absent) -> io::Result<Lock> {
        if absent == Absent::Refused && !self.exists(file) {
            return Err(ErrorKind::NotFound.into());
        }
        drop(self.create(file)?);
        Ok(Lock::unguarded())
    }

    fn space(&self, _: &Path) -> io::Result<Space> {
        Err(ErrorKind::Unsupported.into())
    }
}

#[derive(Debug)]
struct MemoryFile {
    model: Arc<Mutex<Model>>,
    number: usize,
}

impl Write for MemoryFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut model = self.model.lock().unwrap();
        model.step()?;
        let file = &mut model.files[self.number];
        file.0.extend_from_slice(bytes);
        // The system also writes without a sync, at most what it was given: assume half of it.
        file.1 = file.0[..file.0.len() / 2].into();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl DiskFile for MemoryFile {
    fn sync(&mut self) -> io::Result<()> {
        let mut model = self.model.lock().unwrap();
        model.step()?;
        let file = &mut model.files[self.number];
        file.1.clone_from(&file.0);
        Ok(())
    }

    fn length(&mut self) -> io::Result<u64> {
        Ok(self.model.lock().unwrap().files[self.number].0.len() as u64)
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        let mut model = self.model.lock().unwrap();
        model.files[self.number].0.truncate(length as usize);
        Ok(())
    }
}
