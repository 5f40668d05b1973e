//! The frames of a camera in the order of time.

use super::clock::ClockStep;
use super::clock_facts::ClockFacts;
use super::flags::TimeFlag;
use super::times::{Stamp, Times, Timing};
use crate::observe::{
    CameraFrames, FrameFacts, InputNotes, InputSummary, JournalError, Place, Record, Recorded,
    Records, Span,
};
use crate::units::Measured;
use rayon::prelude::*;
use serde::{Serialize, de::DeserializeOwned};

/// Records read at a time.
const TOGETHER: usize = 4096;

/// A frame's result that has a time.
pub trait Dated: Serialize + DeserializeOwned + Clone + Send + Sync {
    fn facts(&self) -> &FrameFacts;

    /// Position of its object, in any unit.
    fn place(&self) -> Option<[f64; 2]>;
}

/// The frames of a camera in the order of time; their results and names stay in the journal.
#[derive(Debug)]
pub struct Timeline<T> {
    records: Records<T>,
    dated: Vec<DatedFrame>,
    /// Frames without a time and files without a frame, by name.
    unused: Vec<Unused>,
    /// Inputs that were not used as they stand.
    pub inputs: InputSummary,
    pub clock: ClockFacts,
}

#[derive(Debug, Clone)]
struct DatedFrame {
    /// Position of its record.
    place: Place,
    utc_ns: i64,
    /// Set if its stamp is not believed as it stands.
    timing: Option<Box<Timing>>,
}

#[derive(Debug, Clone)]
enum Unused {
    Undated {
        file: String,
        place: Place,
        timing: Timing,
    },
    Unread {
        file: String,
        error: String,
    },
    Copy {
        file: String,
        first: String,
    },
}

/// A file of the timeline and its content.
pub struct Entry<T> {
    pub file: String,
    pub data: Content<T>,
}

/// Content of a file.
pub enum Content<T> {
    Frame(Box<T>),
    /// No usable frame, with the reason.
    None {
        error: String,
        copy_of: Option<String>,
    },
}

impl<T: Dated> Timeline<T> {
    /// Takes all frames of a camera within a span.
    ///
    /// # Errors
    /// If a journal cannot be read.
    pub fn new(done: Recorded<T>, camera: CameraFrames, span: &Span) -> Result<Self, JournalError> {
        let mut notes = InputNotes::default();
        let (mut stamps, mut stamped, mut unused) = (Vec::new(), Vec::new(), Vec::new());
        for (some, first) in camera.inputs.chunks(TOGETHER).zip((0..).step_by(TOGETHER)) {
            let records = some.par_iter().map(|input| done.record(input));
            let records: Vec<Option<Record<T>>> = records.collect::<Result<_, _>>()?;
            for (record, input) in records.into_iter().zip(first..) {
                let Some(Record {
                    input: file,
                    outcome,
                }) = record
                else {
                    continue;
                };
                match outcome {
                    Ok(frame) if !span.holds(frame.facts().utc()) => {}
                    Ok(frame) => {
                        notes.read(&file.file, frame.facts());
                        stamps.push(Stamp::of(frame.facts(), frame.place()));
                        stamped.push(input);
                    }
                    Err(error) => {
                        notes.unreadable(&error);
                        let file = file.file;
                        unused.push(Unused::Unread { file, error });
                    }
                }
            }
        }
        unused.extend(notes.copies(&camera.copies, span).map(|copy| Unused::Copy {
            file: copy.input.file.clone(),
            first: copy.first.clone(),
        }));
        let Times { timings, clocks } = Times::of(&stamps);
        let step = |step: &ClockStep<usize>| ClockStep {
            frame: camera.inputs[stamped[step.frame] as usize].file.clone(),
            step_s: step.step_s,
        };
        let clock = ClockFacts {
            drift_ppm: clocks
                .drift
                .map(|drift| Measured::new(drift.value * 1e6, drift.sigma * 1e6)),
            steps: clocks.steps.iter().map(step).collect(),
            corrected: timings.iter().filter(|t| t.correction_s.is_some()).count(),
        };
        let mut dated = Vec::with_capacity(stamps.len());
        for ((input, stamp), timing) in stamped.into_iter().zip(&stamps).zip(timings) {
            let input = &camera.inputs[input as usize];
            let Some(place) = done.place(input) else {
                unused.push(Unused::Unread {
                    file: input.file.clone(),
                    error: "no record".into(),
                });
                continue;
            };
            match timing.utc_ns(stamp.utc_ns) {
                Some(utc_ns) => dated.push(DatedFrame {
                    place,
                    utc_ns,
                    timing: (timing != Timing::default()).then(|| Box::new(timing)),
                }),
                None => unused.push(Unused::Undated {
                    file: input.file.clone(),
                    place,
                    timing,
                }),
            }
        }
        // Frames of equal time keep the order of their paths, which is that of the inputs.
        dated.sort_by_key(|frame| frame.utc_ns);
        unused.sort_by(|a, b| a.file().cmp(b.file()));
        Ok(Self {
            records: done.into_records(),
            dated,
            unused,
            inputs: notes.finish(),
            clock,
        })
    }

    /// Number of files.
    pub fn len(&self) -> usize {
        self.dated.len() + self.unused.len()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of files that have a time; these come first.
    pub fn dated(&self) -> usize {
        self.dated.len()
    }

    /// The file at an index of the timeline.
    ///
    /// # Errors
    /// If a journal cannot be read.
    pub fn file(&self, n: usize) -> Result<String, JournalError> {
        Ok(self.entry(n)?.file)
    }

    /// Mid-exposure, ns since 1970.
    pub fn utc_ns(&self, n: usize) -> Option<i64> {
        self.dated.get(n).map(|frame| frame.utc_ns)
    }

    /// Seconds since 1970.
    pub fn unix_s(&self, n: usize) -> Option<f64> {
        Some(self.utc_ns(n)? as f64 / 1e9)
    }

    /// Timing of a frame's stamp.
    pub fn timing(&self, n: usize) -> Timing {
        match self.dated.get(n) {
            Some(frame) => frame.timing.as_deref().copied().unwrap_or_default(),
            None => match &self.unused[n - self.dated.len()] {
                Unused::Undated { timing, .. } => *timing,
                Unused::Unread { .. } | Unused::Copy { .. } => Timing::default(),
            },
        }
    }

    /// Whether a dated frame's time is good enough for a smoothed path.
    pub fn is_timed(&self, n: usize) -> bool {
        self.timing(n).flag.is_none_or(TimeFlag::is_of_path)
    }

    /// A file and its content.
    ///
    /// # Errors
    /// If a journal cannot be read.
    pub fn entry(&self, n: usize) -> Result<Entry<T>, JournalError> {
        let none = |file: &String, error: String, copy_of| Entry {
            file: file.clone(),
            data: Content::None { error, copy_of },
        };
        let place = match self.dated.get(n) {
            Some(frame) => frame.place,
            None => match &self.unused[n - self.dated.len()] {
                Unused::Undated { place, .. } => *place,
                Unused::Unread { file, error } => return Ok(none(file, error.clone(), None)),
                Unused::Copy { file, first } => {
                    let error = format!("the same frame as {first}");
                    return Ok(none(file, error, Some(first.clone())));
                }
            },
        };
        let Record { input, outcome } = self.records.read(place)?;
        Ok(match outcome {
            Ok(frame) => Entry {
                file: input.file,
                data: Content::Frame(Box::new(frame)),
            },
            Err(error) => none(&input.file, error, None),
        })
    }

    /// Record of a frame; none of a file without one.
    ///
    /// # Errors
    /// If a journal cannot be read.
    pub fn frame(&self, n: usize) -> Result<Option<T>, JournalError> {
        Ok(match self.entry(n)?.data {
            Content::Frame(frame) => Some(*frame),
            Content::None { .. } => None,
        })
    }

    /// A value of each file, in order: many files are read at a time, and few are kept.
    ///
    /// # Errors
    /// If a journal cannot be read.
    pub fn each<V: Send>(
        &self,
        count: usize,
        read: impl Fn(usize) -> Result<V, JournalError> + Sync,
        mut take: impl FnMut(V),
    ) -> Result<(), JournalError> {
        for first in (0..count).step_by(TOGETHER) {
            let some = first..count.min(first + TOGETHER);
            let read: Vec<V> = some.into_par_iter().map(&read).collect::<Result<_, _>>()?;
            read.into_iter().for_each(&mut take);
        }
        Ok(())
    }
}

impl Unused {
    fn file(&self) -> &str {
        match self {
            Self::Undated { file, .. } | Self::Unread { file, .. } | Self::Copy { file, .. } => {
                file
            }
        }
    }
}
