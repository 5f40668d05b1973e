//! The first pass: every frame on its own, on all cores, each record to the journal as soon as it is made.

use super::journal::{Journal, JournalError, Place};
use super::record::{FrameRecord, Record};
use crate::archive::{ArchiveReader, Flown, FlownFiles, StoredFile};
use crate::aspect::{self, Expected};
use crate::fits::{FileError, FitsFile, Header, Problem};
use crate::frame::{Frame, FrameInfo};
use crate::instrument::{Instrument, WrongSize};
use crate::provenance;
use jiff::Timestamp;
use rayon::prelude::*;
use serde::{Serialize, de::DeserializeOwned};
use std::collections::HashMap;
use std::hash::{Hash, Hasher};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// What a run works with; everything that a frame's own record depends on.
#[derive(Debug, Clone)]
pub struct Recipe {
    pub instrument: Instrument,
    pub settings: aspect::Settings,
    /// The effective configuration and the instrument's file.
    pub flown: Flown,
    /// What frames may name, where instrument and configuration are the archive's.
    pub archived: FlownFiles,
}

impl FirstPass for Recipe {
    type Frame = FrameRecord;

    fn hash(&self) -> u64 {
        let text = format!(
            "{} {JOURNAL_VERSION} {:?} {:?}",
            provenance::VERSION,
            self.instrument,
            self.settings
        );
        hash_of(text.as_bytes())
    }

    fn solve(
        &self,
        archive: &ArchiveReader,
        input: &StoredFile,
        span: &Span,
    ) -> Result<Option<FrameRecord>, Unsolved> {
        let size_px = self.instrument.camera.size_px();
        let Some(taken) = Taken::open(archive, input, span, size_px)? else {
            return Ok(None);
        };
        taken.check(&self.archived)?;
        let expected = taken.info.mid_exposure.and_then(Expected::at);
        taken.with_frame(|frame, header| {
            let (instrument, settings) = (&self.instrument, &self.settings);
            let unreadable = |error: WrongSize| Unsolved::Unreadable(error.to_string());
            instrument.check_size(frame).map_err(unreadable)?;
            let solution = aspect::solve_with(settings, frame, instrument, expected, None);
            Ok(FrameRecord::new(&frame.info, header, &solution, instrument))
        })
    }
}

/// Counts with every change of what a record holds or how it is made.
pub(super) const JOURNAL_VERSION: u32 = 5;

/// FNV-1a, the same on every machine and in every release of the compiler.
pub(super) fn hash_of(bytes: &[u8]) -> u64 {
    let mix = |hash: u64, byte: &u8| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, mix)
}

/// One part of several that share the work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// From 1.
    pub number: u32,
    pub of: u32,
}

impl Shard {
    /// Every Nth of all, from the Ith on.
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

/// The first and the last mid-exposure that count; frames without a time count where neither is given.
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

/// How frames of one kind of camera are solved, each on its own.
pub trait FirstPass: Sync {
    /// What a frame gives.
    type Frame: Serialize + DeserializeOwned + Clone + Send;

    /// A number that changes with the program's version, the camera and the settings.
    fn hash(&self) -> u64;

    /// What the journal's name begins with, before that number.
    fn prefix(&self) -> &'static str {
        ""
    }

    /// What a file's frame gives; none where its time lies outside the span.
    ///
    /// # Errors
    /// Why there is no frame, in words.
    fn solve(
        &self,
        archive: &ArchiveReader,
        input: &StoredFile,
        span: &Span,
    ) -> Result<Option<Self::Frame>, Unsolved>;
}

/// Where the record of each input stands.
#[derive(Debug)]
pub struct Done<T> {
    journals: Vec<Journal<T>>,
    /// The journal's number and the place in it.
    places: HashMap<u64, (usize, Place)>,
    /// What holds for this run alone, and is in no journal: frames that contradict their archive, for another run may be told to use them,
    /// and files that could not be read for now.
    passing: HashMap<u64, Record<T>>,
}

/// An input's key: what the record must match.
pub(super) fn key(input: &StoredFile) -> u64 {
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

impl<T: Serialize + DeserializeOwned + Clone + Send> Done<T> {
    /// Opens the run's own journal and reads those of other runs.
    ///
    /// # Errors
    /// A journal that cannot be used.
    pub fn open(own: &Path, others: &[PathBuf]) -> Result<Self, JournalError> {
        let mut places = HashMap::new();
        let mut journals = Vec::new();
        for other in others {
            let number = journals.len() + 1;
            journals.push(Journal::read(other, |record, place| {
                places.insert(key(&record.input), (number, place));
            })?);
        }
        let own = Journal::open(own, |record, place| {
            places.insert(key(&record.input), (0, place));
        })?;
        journals.insert(0, own);
        Ok(Self {
            journals,
            places,
            passing: HashMap::new(),
        })
    }

    pub fn holds(&self, input: &StoredFile) -> bool {
        self.places.contains_key(&key(input))
    }

    /// The record of an input, where it is done.
    ///
    /// # Errors
    /// A journal that cannot be read.
    pub fn record(&self, input: &StoredFile) -> Result<Option<Record<T>>, JournalError> {
        self.record_of(key(input))
    }

    /// The same by the input's key.
    pub(super) fn record_of(&self, key: u64) -> Result<Option<Record<T>>, JournalError> {
        let Some((journal, place)) = self.places.get(&key) else {
            return Ok(self.passing.get(&key).cloned());
        };
        self.journals[*journal].record(*place).map(Some)
    }

    /// How many inputs have no frame, for whatever reason.
    ///
    /// # Errors
    /// A journal that cannot be read.
    pub fn unreadable(&self, inputs: &[StoredFile]) -> Result<usize, JournalError> {
        let mut unreadable = 0;
        for input in inputs {
            let record = self.record(input)?;
            unreadable += usize::from(record.is_some_and(|record| record.outcome.is_err()));
        }
        Ok(unreadable)
    }

    /// Solves the inputs that are not done, several at a time, and notes each in the run's own journal; `each` is called after
    /// each.
    ///
    /// # Errors
    /// A journal that cannot be written; frames that cannot be read are no error, but a record. Where the archive is
    /// [lost](ArchiveReader::is_lost), the rest is not tried.
    pub fn work(
        &mut self,
        archive: &ArchiveReader,
        inputs: &[StoredFile],
        recipe: &impl FirstPass<Frame = T>,
        span: &Span,
        each: &(dyn Fn() + Sync),
    ) -> Result<(), JournalError> {
        let journal = &self.journals[0];
        let passing = Mutex::new(HashMap::new());
        let new: Vec<(u64, (usize, Place))> = inputs
            .par_iter()
            .filter(|input| !self.places.contains_key(&key(input)) && !archive.is_lost())
            .filter_map(|input| {
                let outcome = recipe.solve(archive, input, span).transpose()?;
                each();
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
                Some(place.map(|place| (input_key, (0, place))))
            })
            .collect::<Result<_, JournalError>>()?;
        self.places.extend(new);
        let passing = passing.into_inner();
        self.passing = passing.unwrap_or_else(PoisonError::into_inner);
        Ok(())
    }
}

/// Why a frame has no record of its own, in words.
pub enum Unsolved {
    /// What the file holds cannot be read.
    Unreadable(String),
    /// The file could not be opened or fetched: another attempt may succeed.
    Unread(String),
    /// It names another instrument or configuration than its archive's.
    Contradicting(String),
}

/// A file whose headers are read.
pub(super) struct Taken {
    file: FitsFile,
    pub info: FrameInfo,
    pub header: Header,
}

impl Taken {
    /// Of a file of several images, the one of this size. `None` where the frame's time lies outside the span.
    pub fn open(
        archive: &ArchiveReader,
        input: &StoredFile,
        span: &Span,
        size_px: [usize; 2],
    ) -> Result<Option<Self>, Unsolved> {
        let read = || -> Result<_, FileError> {
            let file = archive.open_file(&input.file)?.of_size(size_px);
            let (info, header) = file.info()?;
            Ok(Self { file, info, header })
        };
        let taken = read()?;
        Ok(span.holds(taken.info.mid_exposure).then_some(taken))
    }

    /// Refuses a frame that contradicts its archive.
    pub fn check(&self, archived: &FlownFiles) -> Result<(), Unsolved> {
        let named = archived.check(&self.header);
        named.map_err(|problem| Unsolved::Contradicting(problem.to_string()))
    }

    /// What is made of the frame.
    pub fn with_frame<T>(
        self,
        make: impl FnOnce(&Frame, &Header) -> Result<T, Unsolved>,
    ) -> Result<Option<T>, Unsolved> {
        let header = &self.header;
        let made = self.file.with_frame(|frame| make(frame, header));
        made?.map(Some)
    }
}

/// The row names the file already.
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

    /// Every frame is unread, unreadable or a number.
    struct Numbers(Option<fn(String) -> Unsolved>);

    impl FirstPass for Numbers {
        type Frame = u32;

        fn hash(&self) -> u64 {
            0
        }

        fn solve(
            &self,
            _: &ArchiveReader,
            _: &StoredFile,
            _: &Span,
        ) -> Result<Option<u32>, Unsolved> {
            self.0.map_or(Ok(Some(7)), |error| Err(error("why".into())))
        }
    }

    #[test]
    fn what_another_attempt_may_read_is_in_no_journal() {
        let folder = tempfile::tempdir().unwrap();
        let archive = ArchiveReader::open(folder.path(), folder.path()).unwrap();
        let input = StoredFile {
            file: "a.fits".into(),
            bytes: 1,
            written_ns: 2,
        };
        let second_try = |name: &str, error: fn(String) -> Unsolved| {
            let journal = folder.path().join(name);
            let outcomes = [Some(error), None].map(|error| {
                let mut done = Done::open(&journal, &[]).unwrap();
                let inputs = std::slice::from_ref(&input);
                let work = done.work(&archive, inputs, &Numbers(error), &Span::default(), &|| {});
                work.unwrap();
                done.record(&input).unwrap().unwrap().outcome
            });
            assert_eq!(outcomes[0], Err("why".into()));
            outcomes[1].clone()
        };
        assert_eq!(second_try("unread", Unsolved::Unread), Ok(7));
        assert_eq!(second_try("contradicting", Unsolved::Contradicting), Ok(7));
        let lasting = second_try("unreadable", Unsolved::Unreadable);
        assert_eq!(lasting, Err("why".into()));
    }

    #[test]
    fn a_shard_is_one_of_n() {
        assert_eq!("2/4".parse(), Ok(Shard { number: 2, of: 4 }));
        for text in ["0/4", "5/4", "1", "a/b", "1/0", ""] {
            assert!(text.parse::<Shard>().is_err(), "{text}");
        }
    }
}
