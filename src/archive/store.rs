//! Writing to the archive's disk: a file is there whole, or it is not there.
//!
//! A frame is encoded in memory, written under a temporary name in its own folder, brought to the disk (fsync),
//! and only then given its name, without replacing what may stand there; then the folder is brought to the disk too.
//! A power cut at any moment leaves whole files and at most a temporary, which begins with a dot, does not end in
//! `.fits`, and is swept away when the store is next opened.

use super::name::{NameTime, name};
use crate::fits::{Card, Compression, FileError, Problem, Table, encode_frame};
use crate::frame::Frame;
use jiff::Timestamp;
use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// What ends the name of a file that is being written.
const UNFINISHED: &str = ".part";

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
#[derive(Debug)]
pub struct Store {
    root: PathBuf,
    instrument: String,
    compression: Compression,
    swept: usize,
}

impl Store {
    /// Opens the archive at `root`, makes the folder if need be, and removes files that an earlier run left
    /// unfinished. One process at a time may write to an archive.
    ///
    /// # Errors
    /// Where the folder cannot be made or listed, or a file in it not removed.
    pub fn open(
        root: &Path,
        instrument: &str,
        compression: Compression,
    ) -> Result<Self, ArchiveError> {
        fs::create_dir_all(root).during("make the archive's folder", root)?;
        Ok(Self {
            root: root.into(),
            instrument: instrument.into(),
            compression,
            swept: sweep(root)?,
        })
    }

    /// How many unfinished files of an earlier run were removed on opening.
    pub fn swept(&self) -> usize {
        self.swept
    }

    pub fn root(&self) -> &Path {
        &self.root
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
        let time = match frame.info.mid_exposure {
            Some(middle) => NameTime::MidExposure(middle),
            None => NameTime::Written(Timestamp::now()),
        };
        let path = self
            .root
            .join(name(&self.instrument, time, frame.info.number));
        let path = free_name(&path)?;
        let mut cards = cards.to_vec();
        let file_name = path.file_name().unwrap_or_default().to_string_lossy();
        cards.push(Card::new("FILENAME", &*file_name));
        let bytes = encode_frame(frame, &cards, tables, self.compression)
            .map_err(|problem: Problem| problem.in_file(&path))?;
        let folder = path.parent().unwrap_or(&self.root);
        self.make_folder(folder)?;
        let unfinished = write_unfinished(folder, &path, &bytes)?;
        unfinished
            .persist_noclobber(&path)
            .map_err(|error| error.error)
            .during("name the file", &path)?;
        sync_folder(folder)?;
        Ok(path)
    }

    fn make_folder(&self, folder: &Path) -> Result<(), ArchiveError> {
        // Not with its parents: where the root is gone, its disk is, and nothing may be written in its place.
        match fs::create_dir(folder) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => Ok(()),
            made => {
                made.during("make a folder", folder)?;
                sync_folder(&self.root)
            }
        }
    }
}

/// Writes the bytes to the disk under a temporary name, which is removed again if anything fails.
fn write_unfinished(
    folder: &Path,
    path: &Path,
    bytes: &[u8],
) -> Result<NamedTempFile, ArchiveError> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".").suffix(UNFINISHED);
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o644));
    let mut file = builder
        .tempfile_in(folder)
        .during("make a temporary file for it", path)?;
    file.write_all(bytes).during("write the file", path)?;
    file.as_file()
        .sync_all()
        .during("bring the file to the disk", path)?;
    Ok(file)
}

/// The name itself, or with the first counter under which no file stands. One process writes to an archive, so the name
/// stays free.
fn free_name(path: &Path) -> Result<PathBuf, ArchiveError> {
    (1..=MOST_NAMESAKES)
        .map(|n| namesake(path, n))
        .find(|candidate| candidate.symlink_metadata().is_err())
        .ok_or_else(|| ArchiveError::Namesakes { path: path.into() })
}

/// The n-th file of a name: `a.fits`, `a_2.fits`, `a_3.fits` ...
fn namesake(path: &Path, n: u32) -> PathBuf {
    if n == 1 {
        return path.into();
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}_{n}.fits"))
}

/// Brings a folder's list of names to the disk.
pub(super) fn sync_folder(folder: &Path) -> Result<(), ArchiveError> {
    File::open(folder)
        .and_then(|folder| folder.sync_all())
        .during("bring the folder to the disk", folder)
}

/// Removes unfinished files from the root and its folders, and counts them.
fn sweep(root: &Path) -> Result<usize, ArchiveError> {
    let mut swept = 0;
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).during("list the folder", &folder)? {
            let entry = entry.during("list the folder", &folder)?;
            let path = entry.path();
            let kind = entry.file_type().during("look at the file", &path)?;
            if kind.is_dir() && folder == root {
                folders.push(path);
            } else if kind.is_file() && is_unfinished(&entry.file_name().to_string_lossy()) {
                fs::remove_file(&path).during("remove the unfinished file", &path)?;
                swept += 1;
            }
        }
    }
    Ok(swept)
}

fn is_unfinished(file_name: &str) -> bool {
    file_name.starts_with('.') && file_name.ends_with(UNFINISHED)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{FrameInfo, Pixels};

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
        let card = [Card::new("NOSUCH", 1.0)];
        let error = store(root.path())
            .write(&frame(Some("2013-09-21T18:00:00Z")), &card, &[])
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("demo_20130921T180000.000_00000007.fits: NOSUCH"),
            "{error}"
        );
        assert_eq!(fs::read_dir(root.path()).unwrap().count(), 0);
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
