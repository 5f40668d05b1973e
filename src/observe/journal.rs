//! The journal of the first pass: one record per file, appended when it is complete.
//!
//! A record is its length and its checksum (CRC-32), 4 bytes each, and its bytes. If the program is killed, at most the last record is
//! incomplete: a record that does not match its checksum is cut off when the journal is next opened.

use crate::archive::StoredFile;
use crc::{CRC_32_ISO_HDLC, Crc};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::marker::PhantomData;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);
/// Size of length and checksum, bytes.
const HEAD: usize = 8;
/// Greatest length of a record.
const MOST_BYTES: u32 = 1 << 22;
/// First bytes of a journal.
const MAGIC: &[u8; 8] = b"solasp1\n";

/// Reasons for which a journal cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    #[error("{}: expected to {action}, found \"{cause}\"", .path.display())]
    Io {
        path: PathBuf,
        action: &'static str,
        cause: io::Error,
    },
    #[error("{}: expected to be the only program that refines into this folder, found another", .path.display())]
    Taken { path: PathBuf },
    #[error("{}: expected a journal of refine, found another file", .path.display())]
    Foreign { path: PathBuf },
    #[error("{}: expected the record at byte {at} as it was written, found changed bytes", .path.display())]
    Changed { path: PathBuf, at: u64 },
}

/// Result of a file: a row of the journal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record<T> {
    pub input: StoredFile,
    /// The frame's record, or the error of the file.
    pub outcome: Result<T, String>,
}

/// Position of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// Offset of its first byte after length and checksum.
    start: u64,
    bytes: u32,
    /// Index among several journals of a reader; 32 bit because there are many places.
    pub(super) journal: u32,
}

/// A journal of frames' results, open for reading, and for appending if it is the run's own.
#[derive(Debug)]
pub struct Journal<T> {
    path: PathBuf,
    file: File,
    end: Mutex<u64>,
    of: PhantomData<fn() -> T>,
}

impl<T: Serialize + DeserializeOwned> Journal<T> {
    /// Opens a journal to append to, and creates a missing one; `each` receives every complete record. An incomplete end is cut off.
    ///
    /// # Errors
    /// If the file cannot be read or written, is no journal, or is being written by another program.
    pub fn open(path: &Path, each: impl FnMut(Record<T>, Place)) -> Result<Self, JournalError> {
        let io = |action| move |cause| io_error(path, action, cause);
        let mut options = OpenOptions::new();
        let options = options.read(true).write(true).create(true).truncate(false);
        let mut file = options.open(path).map_err(io("open the journal"))?;
        file.try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => JournalError::Taken { path: path.into() },
            TryLockError::Error(cause) => io_error(path, "lock the journal", cause),
        })?;
        let length = file.metadata().map_err(io("open the journal"))?.len();
        if length < MAGIC.len() as u64 {
            file.set_len(0).map_err(io("begin the journal"))?;
            file.rewind().map_err(io("begin the journal"))?;
            file.write_all(MAGIC).map_err(io("begin the journal"))?;
        }
        let end = read_all(path, &file, each)?;
        file.set_len(end).map_err(io("cut off a torn record"))?;
        Ok(Self {
            path: path.into(),
            file,
            end: Mutex::new(end),
            of: PhantomData,
        })
    }

    /// Opens a journal made by another run.
    ///
    /// # Errors
    /// If the file cannot be read or is no journal.
    pub fn read(path: &Path, each: impl FnMut(Record<T>, Place)) -> Result<Self, JournalError> {
        let file = File::open(path).map_err(|cause| io_error(path, "open the journal", cause))?;
        let end = Mutex::new(read_all(path, &file, each)?);
        Ok(Self {
            path: path.into(),
            file,
            end,
            of: PhantomData,
        })
    }

    /// Unlocks the journal so that others can append to it: nothing more is appended here.
    ///
    /// # Errors
    /// If the file cannot be unlocked.
    pub fn release(&self) -> Result<(), JournalError> {
        let released = self.file.unlock();
        released.map_err(|cause| io_error(&self.path, "unlock the journal", cause))
    }

    /// Appends a record.
    ///
    /// # Errors
    /// If the disk refuses the write; a later record overwrites an incomplete one.
    pub fn append(&self, record: &Record<T>) -> Result<Place, JournalError> {
        let refused = |cause| io_error(&self.path, "add to the journal", cause);
        let body = postcard::to_stdvec(record).map_err(|error| refused(io::Error::other(error)))?;
        let mut bytes = Vec::with_capacity(HEAD + body.len());
        bytes.extend((body.len() as u32).to_le_bytes());
        bytes.extend(CRC.checksum(&body).to_le_bytes());
        bytes.extend(&body);
        let mut end = self.end.lock().unwrap_or_else(PoisonError::into_inner);
        self.file.write_all_at(&bytes, *end).map_err(refused)?;
        let place = Place {
            start: *end + HEAD as u64,
            bytes: body.len() as u32,
            journal: 0,
        };
        *end += bytes.len() as u64;
        Ok(place)
    }

    /// Reads one record again.
    ///
    /// # Errors
    /// If the disk refuses the read, or the bytes have changed.
    pub fn record(&self, place: Place) -> Result<Record<T>, JournalError> {
        let mut body = vec![0; place.bytes as usize];
        let read = self.file.read_exact_at(&mut body, place.start);
        read.map_err(|cause| io_error(&self.path, "read a record", cause))?;
        postcard::from_bytes(&body).map_err(|_| JournalError::Changed {
            path: self.path.clone(),
            at: place.start,
        })
    }
}

fn io_error(path: &Path, action: &'static str, cause: io::Error) -> JournalError {
    JournalError::Io {
        path: path.into(),
        action,
        cause,
    }
}

/// Reads every complete record; returns the end of the last one.
fn read_all<T: DeserializeOwned>(
    path: &Path,
    mut file: &File,
    mut each: impl FnMut(Record<T>, Place),
) -> Result<u64, JournalError> {
    let refused = |cause| io_error(path, "read the journal", cause);
    file.seek(SeekFrom::Start(0)).map_err(refused)?;
    let mut file = BufReader::with_capacity(1 << 20, file);
    let mut magic = [0; MAGIC.len()];
    let begun = file.read_exact(&mut magic);
    if begun.is_err() || magic != *MAGIC {
        return Err(JournalError::Foreign { path: path.into() });
    }
    let mut end = MAGIC.len() as u64;
    while let Some((record, bytes)) = next(&mut file) {
        let start = end + HEAD as u64;
        let journal = 0;
        each(
            record,
            Place {
                start,
                bytes,
                journal,
            },
        );
        end = start + u64::from(bytes);
    }
    Ok(end)
}

/// The next record with the length of its body; none at the end, or if it is incomplete.
fn next<T: DeserializeOwned>(file: &mut impl Read) -> Option<(Record<T>, u32)> {
    let mut word = || {
        let mut bytes = [0; 4];
        file.read_exact(&mut bytes).ok()?;
        Some(u32::from_le_bytes(bytes))
    };
    let (length, sum) = (word()?, word()?);
    if length > MOST_BYTES {
        return None;
    }
    let mut body = vec![0; length as usize];
    file.read_exact(&mut body).ok()?;
    if CRC.checksum(&body) != sum {
        return None;
    }
    Some((postcard::from_bytes(&body).ok()?, length))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(n: u64) -> Record<u32> {
        let input = StoredFile {
            file: format!("frame_{n}.fits"),
            bytes: n,
            written_ns: -5,
        };
        let outcome = Err("no frame".into());
        Record { input, outcome }
    }

    fn names(path: &Path) -> Vec<String> {
        let mut names = Vec::new();
        Journal::read(path, |record: Record<u32>, _| names.push(record.input.file)).unwrap();
        names
    }

    #[test]
    fn a_torn_last_record_is_dropped_and_written_anew() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("j");
        let journal = Journal::<u32>::open(&path, |_, _| {}).unwrap();
        let place = journal.append(&record(1)).unwrap();
        journal.append(&record(2)).unwrap();
        assert_eq!(journal.record(place).unwrap(), record(1));
        drop(journal);
        let whole = std::fs::read(&path).unwrap();
        for cut in 1..20 {
            std::fs::write(&path, &whole[..whole.len() - cut]).unwrap();
            let mut seen = 0;
            let journal = Journal::<u32>::open(&path, |_, _| seen += 1).unwrap();
            assert_eq!(seen, 1);
            journal.append(&record(2)).unwrap();
            drop(journal);
            assert_eq!(std::fs::read(&path).unwrap(), whole);
        }
        let mut changed = whole.clone();
        *changed.last_mut().unwrap() ^= 1;
        std::fs::write(&path, changed).unwrap();
        assert_eq!(names(&path), ["frame_1.fits"]);
    }

    #[test]
    fn two_programs_do_not_write_to_one_journal_and_other_files_are_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("j");
        let _first = Journal::<u32>::open(&path, |_, _| {}).unwrap();
        let second = Journal::<u32>::open(&path, |_, _| {});
        assert!(matches!(second, Err(JournalError::Taken { .. })));
        let other = folder.path().join("notes");
        std::fs::write(&other, "a file of somebody else").unwrap();
        let opened = Journal::<u32>::open(&other, |_, _| {});
        assert!(matches!(opened, Err(JournalError::Foreign { .. })));
        let text = std::fs::read_to_string(&other).unwrap();
        assert_eq!(text, "a file of somebody else");
    }
}
