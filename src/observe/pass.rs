//! A pass over frames: each is processed on its own, on all cores, and its record is written to the journal at once.

use super::journal::{Journal, JournalError, Place, Record};
use crate::archive::{ArchiveReader, FlownFiles, StoredFile};
use crate::fits::{FileError, Header, Problem};
use crate::frame::Frame;
use crate::provenance;
use jiff::Timestamp;
use rayon::prelude::*;
use serde::{Serialize, de::DeserializeOwned};
use std::collections::HashMap;
use std::hash::{Hash, Hasher};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Incremented with every change of a record's content or computation.
const JOURNAL_VERSION: u32 = 8;

/// FNV-1a, the same on every machine and in every release of the compiler.
pub fn hash_of(bytes: &[u8]) -> u64 {
    let mix = |hash: u64, byte: &u8| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, mix)
}

/// Receives the progress of a pass, and may cancel it.
pub trait Watch: Sync {
    /// A pass over this many frames begins.
    fn begin(&self, _frames: usize, _what: &str) {}

    /// One more frame is done.
    fn step(&self) {}

    /// All frames are done.
    fn end(&self) {}

    /// Whether the pass must not begin further frames.
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// A pass without a watch.
impl Watch for () {}

/// Reasons for which a pass ended before its last frame, or its results cannot be read again.
#[derive(Debug, thiserror::Error)]
pub enum PassError {
    #[error(transparent)]
    Journal(#[from] JournalError),
    #[error(
        "{}: expected answers, found none to many requests, such as: {why}; run again to go on",
        .archive.display()
    )]
    Silent { archive: PathBuf, why: String },
    #[error("cancelled: what is done is in the journal; run again to go on")]
    Cancelled,
    #[error(
        "{}: expected a journal of the same version, instrument and settings ({name}), found none",
        .folder.display()
    )]
    NoJournal { folder: PathBuf, name: String },
}

/// One of several parts that share the work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Number of the part, from 1.
    pub number: u32,
    pub of: u32,
}

impl Shard {
    /// Every N-th item, from the I-th.
    pub fn part<T>(self, all: Vec<T>) -> Vec<T> {
        let (skip, every) = (self.number as usize - 1, self.of as usize);
        all.into_iter().skip(skip).step_by(every).collect()
    }
}

impl std::str::FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('/');
        let shard = parts.and_then(|(number, of)| {
            let (number, of) = (number.trim().parse().ok()?, of.trim().parse().ok()?);
            (1..=of).contains(&number).then_some(Self { number, of })
        });
        shard.ok_or_else(|| format!("expected I/N with I from 1 to N, found \"{text}\""))
    }
}

/// The first and the last mid-exposure included; frames without a time are included if neither is given.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Span {
    pub since: Option<Timestamp>,
    pub until: Option<Timestamp>,
}

impl Span {
    pub fn holds(&self, utc: Option<Timestamp>) -> bool {
        match utc {
            Some(utc) => {
                self.since.is_none_or(|since| utc >= since)
                    && self.until.is_none_or(|until| utc <= until)
            }
            None => self.since.is_none() && self.until.is_none(),
        }
    }
}

/// Processing of each frame in a pass.
pub trait Observer: Sync {
    /// Record of a frame.
    type Output: Serialize + DeserializeOwned + Clone + Send;

    /// Prefix of the journal's name.
    fn prefix(&self) -> &'static str {
        ""
    }

    /// Text of all settings that a frame's record depends on: the same text gives the same records.
    fn stated(&self) -> String {
        String::new()
    }

    /// Record of a file's frame; none if its time is outside the span.
    ///
    /// # Errors
    /// The reason why there is no frame, in words.
    fn observe(
        &self,
        archive: &ArchiveReader,
        input: &StoredFile,
        span: &Span,
    ) -> Result<Option<Self::Output>, Unsolved>;

    /// A hash of the program's version and the settings.
    fn hash(&self) -> u64 {
        let stated = self.stated();
        hash_of(format!("{} {JOURNAL_VERSION} {stated}", provenance::VERSION).as_bytes())
    }

    /// The journal's name.
    fn journal_name(&self) -> String {
        format!("{}{:016x}.journal", self.prefix(), self.hash())
    }
}

/// A pass over an archive.
#[derive(Clone, Copy)]
pub struct Pass<'a> {
    pub archive: &'a ArchiveReader,
    /// The folder of the journal.
    pub out: &'a Path,
    /// Folders of other runs whose journals are also read.
    pub merge: &'a [PathBuf],
    pub shard: Option<Shard>,
    pub span: Span,
    pub watch: &'a dyn Watch,
}

impl Pass<'_> {
    /// Observes the inputs that are neither in this run's journal nor in a merged one; `what` names them for the watch.
    ///
    /// # Errors
    /// If a journal cannot be used, an object store does not respond, or the watch cancels. Frames that cannot be read are no error, but
    /// a record.
    pub fn run<O: Observer>(
        &self,
        observer: &O,
        what: &str,
        inputs: &[StoredFile],
    ) -> Result<Recorded<O::Output>, PassError> {
        let name = observer.journal_name();
        let others = self.merge.iter().map(|folder| folder.join(&name));
        let others: Vec<PathBuf> = others.filter(|path| path.is_file()).collect();
        let mut done = Recorded::open(&self.out.join(&name), &others)?;
        let remaining = inputs.iter().filter(|input| !done.holds(input)).count();
        self.watch.begin(remaining, what);
        done.add(self, observer, inputs)?;
        self.watch.end();
        self.check()?;
        Ok(done)
    }

    /// Fails after a cancellation, or if the source does not respond.
    ///
    /// # Errors
    /// If an object store does not respond, or the watch cancels.
    pub fn check(&self) -> Result<(), PassError> {
        if self.watch.is_cancelled() {
            return Err(PassError::Cancelled);
        }
        match self.archive.is_lost() {
            true => Err(PassError::Silent {
                archive: self.archive.name().into(),
                why: self
                    .archive
                    .unread_files()
                    .into_values()
                    .next()
                    .unwrap_or_default(),
            }),
            false => Ok(()),
        }
    }

    /// Refuses to merge if no folder contains an observer's journal, and warns of folders that contain none: a run with another
    /// instrument would observe all frames again.
    ///
    /// # Errors
    /// The first folder, if none contains one.
    pub fn expect_journals(&self, observer: &impl Observer) -> Result<(), PassError> {
        let name = observer.journal_name();
        let is_missing = |folder: &&PathBuf| !folder.join(&name).is_file();
        let missing: Vec<PassError> = self
            .merge
            .iter()
            .filter(is_missing)
            .map(|folder| PassError::NoJournal {
                folder: folder.clone(),
                name: name.clone(),
            })
            .collect();
        let all = missing.len() == self.merge.len();
        for error in missing {
            if all {
                return Err(error);
            }
            tracing::warn!("{error}: its frames are solved here");
        }
        Ok(())
    }

    fn continues(&self) -> bool {
        !self.archive.is_lost() && !self.watch.is_cancelled()
    }
}

/// Position of the record of each input.
#[derive(Debug)]
pub struct Recorded<T> {
    records: Records<T>,
    /// Positions by the input's key, sorted.
    places: Vec<(u64, Place)>,
    /// Results of this run that are in no journal: frames that contradict their archive, because another run may be told to use them, and
    /// files that could not be read for now.
    passing: HashMap<u64, Record<T>>,
}

/// The records of a pass, by their positions.
#[derive(Debug)]
pub struct Records<T>(Vec<Journal<T>>);

impl<T: Serialize + DeserializeOwned> Records<T> {
    /// # Errors
    /// If a journal cannot be read.
    pub fn read(&self, place: Place) -> Result<Record<T>, JournalError> {
        self.0[place.journal as usize].record(place)
    }
}

/// An input's key, which its record must match.
pub fn key(input: &StoredFile) -> u64 {
    let mut hasher = Fnv::default();
    input.hash(&mut hasher);
    hasher.0
}

#[derive(Default)]
struct Fnv(u64);

impl Hasher for Fnv {
    fn write(&mut self, bytes: &[u8]) {
        self.0 = hash_of(&[&self.0.to_le_bytes(), bytes].concat());
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

impl<T: Serialize + DeserializeOwned + Clone + Send> Recorded<T> {
    /// Opens the run's own journal and reads those of other runs.
    ///
    /// # Errors
    /// If a journal cannot be used.
    pub fn open(own: &Path, others: &[PathBuf]) -> Result<Self, JournalError> {
        let mut places = Vec::new();
        let mut journals = Vec::new();
        for other in others {
            let number = journals.len() as u32 + 1;
            journals.push(Journal::read(other, |record, mut place| {
                place.journal = number;
                places.push((key(&record.input), place));
            })?);
        }
        let own = Journal::open(own, |record, place| {
            places.push((key(&record.input), place));
        })?;
        journals.insert(0, own);
        Ok(Self {
            records: Records(journals),
            places: by_key(places),
            passing: HashMap::new(),
        })
    }

    pub fn holds(&self, input: &StoredFile) -> bool {
        self.place(input).is_some()
    }

    /// Position of the record of an input, if it is in a journal.
    pub fn place(&self, input: &StoredFile) -> Option<Place> {
        place(&self.places, key(input))
    }

    /// The records alone, for callers that keep the positions.
    pub fn into_records(self) -> Records<T> {
        self.records
    }

    /// The record of an input, if it is done.
    ///
    /// # Errors
    /// If a journal cannot be read.
    pub fn record(&self, input: &StoredFile) -> Result<Option<Record<T>>, JournalError> {
        self.record_of(key(input))
    }

    /// The same by the input's key.
    ///
    /// # Errors
    /// If a journal cannot be read.
    pub fn record_of(&self, key: u64) -> Result<Option<Record<T>>, JournalError> {
        match place(&self.places, key) {
            Some(place) => self.records.read(place).map(Some),
            None => Ok(self.passing.get(&key).cloned()),
        }
    }

    /// Number of inputs without a frame, for whatever reason.
    ///
    /// # Errors
    /// If a journal cannot be read.
    pub fn unreadable(&self, inputs: &[StoredFile]) -> Result<usize, JournalError> {
        let mut unreadable = 0;
        for input in inputs {
            let record = self.record(input)?;
            unreadable += usize::from(record.is_some_and(|record| record.outcome.is_err()));
        }
        Ok(unreadable)
    }

    /// Observes the inputs that are not done, several at a time, and records each in the run's own journal.
    fn add(
        &mut self,
        pass: &Pass<'_>,
        observer: &impl Observer<Output = T>,
        inputs: &[StoredFile],
    ) -> Result<(), JournalError> {
        let journal = &self.records.0[0];
        let passing = Mutex::new(HashMap::new());
        let new: Vec<(u64, Place)> = inputs
            .par_iter()
            .filter(|input| place(&self.places, key(input)).is_none() && pass.continues())
            .filter_map(|input| {
                let outcome = observer
                    .observe(pass.archive, input, &pass.span)
                    .transpose()?;
                pass.watch.step();
                let (outcome, is_lasting) = match outcome {
                    Ok(frame) => (Ok(frame), true),
                    Err(Unsolved::Unreadable(error)) => (Err(error), true),
                    Err(Unsolved::Unread(error) | Unsolved::Contradicting(error)) => {
                        (Err(error), false)
                    }
                };
                let input_key = key(input);
                let record = Record {
                    input: input.clone(),
                    outcome,
                };
                if !is_lasting {
                    let mut passing = passing.lock().unwrap_or_else(PoisonError::into_inner);
                    passing.insert(input_key, record);
                    return None;
                }
                let place = journal.append(&record);
                Some(place.map(|place| (input_key, place)))
            })
            .collect::<Result<_, JournalError>>()?;
        self.places.extend(new);
        self.places = by_key(std::mem::take(&mut self.places));
        let passing = passing.into_inner();
        self.passing = passing.unwrap_or_else(PoisonError::into_inner);
        // Another camera of the same instrument has the same journal.
        self.records.0[0].release()
    }
}

/// Sorts by key and keeps the last position of each.
fn by_key(mut places: Vec<(u64, Place)>) -> Vec<(u64, Place)> {
    places.reverse();
    places.sort_by_key(|(key, _)| *key);
    places.dedup_by_key(|(key, _)| *key);
    places
}

fn place(by_key: &[(u64, Place)], key: u64) -> Option<Place> {
    let found = by_key.binary_search_by_key(&key, |(key, _)| *key);
    Some(by_key[found.ok()?].1)
}

/// Reasons for which a frame has no record of its own, in words.
pub enum Unsolved {
    /// The content of the file cannot be read.
    Unreadable(String),
    /// The file could not be opened or fetched: another attempt may succeed.
    Unread(String),
    /// The frame names another instrument or configuration than its archive's.
    Contradicting(String),
}

/// Record of a file's frame (of several images the one of this size); `None` if its time is outside the span. A frame that names another
/// instrument or configuration than its archive's is refused.
///
/// # Errors
/// The reason why there is no frame, in words.
pub fn with_frame<T>(
    archive: &ArchiveReader,
    input: &StoredFile,
    span: &Span,
    size_px: [usize; 2],
    archived: &FlownFiles,
    make: impl FnOnce(&Frame, &Header) -> Result<T, String>,
) -> Result<Option<T>, Unsolved> {
    let file = archive.open_file(&input.file)?.of_size(size_px);
    let (info, header) = file.info()?;
    if !span.holds(info.mid_exposure) {
        return Ok(None);
    }
    let named = archived.check(&header);
    named.map_err(|problem| Unsolved::Contradicting(problem.to_string()))?;
    let made = file.with_frame(|frame| make(frame, &header))?;
    made.map(Some).map_err(Unsolved::Unreadable)
}

/// The text omits the file, which the row names already.
impl From<FileError> for Unsolved {
    fn from(error: FileError) -> Self {
        let text = error.problem.to_string();
        match error.problem {
            Problem::Io { .. } => Self::Unread(text),
            _ => Self::Unreadable(text),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Every frame is unread, unreadable or a number.
    struct Numbers(Option<fn(String) -> Unsolved>);

    impl Observer for Numbers {
        type Output = u32;

        fn observe(
            &self,
            _: &ArchiveReader,
            _: &StoredFile,
            _: &Span,
        ) -> Result<Option<u32>, Unsolved> {
            self.0.map_or(Ok(Some(7)), |error| Err(error("why".into())))
        }
    }

    fn input(file: &str) -> StoredFile {
        StoredFile {
            file: file.into(),
            bytes: 1,
            written_ns: 2,
        }
    }

    fn pass<'a>(archive: &'a ArchiveReader, out: &'a Path, watch: &'a dyn Watch) -> Pass<'a> {
        Pass {
            archive,
            out,
            merge: &[],
            shard: None,
            span: Span::default(),
            watch,
        }
    }

    #[test]
    fn what_another_attempt_may_read_is_in_no_journal() {
        let folder = tempfile::tempdir().unwrap();
        let archive = ArchiveReader::open(folder.path(), folder.path()).unwrap();
        let input = input("a.fits");
        let second_try = |name: &str, error: fn(String) -> Unsolved| {
            let out = folder.path().join(name);
            std::fs::create_dir(&out).unwrap();
            let outcomes = [Some(error), None].map(|error| {
                let inputs = std::slice::from_ref(&input);
                let done = pass(&archive, &out, &()).run(&Numbers(error), "frames", inputs);
                done.unwrap().record(&input).unwrap().unwrap().outcome
            });
            assert_eq!(outcomes[0], Err("why".into()));
            outcomes[1].clone()
        };
        assert_eq!(second_try("unread", Unsolved::Unread), Ok(7));
        assert_eq!(second_try("contradicting", Unsolved::Contradicting), Ok(7));
        let lasting = second_try("unreadable", Unsolved::Unreadable);
        assert_eq!(lasting, Err("why".into()));
    }

    /// Cancels after this many frames.
    struct Impatient {
        left: AtomicUsize,
    }

    impl Watch for Impatient {
        fn step(&self) {
            self.left.fetch_sub(1, Ordering::Relaxed);
        }

        fn is_cancelled(&self) -> bool {
            self.left.load(Ordering::Relaxed) == 0
        }
    }

    #[test]
    fn a_pass_that_is_cancelled_ends_at_the_next_frame_and_goes_on_from_its_journal() {
        let folder = tempfile::tempdir().unwrap();
        let archive = ArchiveReader::open(folder.path(), folder.path()).unwrap();
        let inputs: Vec<StoredFile> = (0..50).map(|n| input(&format!("{n}.fits"))).collect();
        let run = |frames: usize| {
            let left = AtomicUsize::new(frames);
            let watch = Impatient { left };
            let one_core = rayon::ThreadPoolBuilder::new().num_threads(1).build();
            let outcome = one_core
                .unwrap()
                .install(|| pass(&archive, folder.path(), &watch).run(&Numbers(None), "", &inputs));
            (outcome, frames - watch.left.load(Ordering::Relaxed))
        };
        let (outcome, observed) = run(20);
        assert!(matches!(outcome, Err(PassError::Cancelled)));
        assert_eq!(observed, 20);
        let (outcome, observed) = run(1000);
        assert_eq!(observed, 30);
        assert_eq!(outcome.unwrap().unreadable(&inputs).unwrap(), 0);
    }

    #[test]
    fn a_shard_is_one_of_n() {
        assert_eq!("2/4".parse(), Ok(Shard { number: 2, of: 4 }));
        for text in ["0/4", "5/4", "1", "a/b", "1/0", ""] {
            assert!(text.parse::<Shard>().is_err(), "{text}");
        }
    }
}
