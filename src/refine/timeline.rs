//! The frames of a camera in the order of time.

use super::clock::ClockStep;
use super::clock_facts::ClockFacts;
use super::oddity::TimeOddity;
use super::times::{Stamp, Times, Timing};
use crate::archive::StoredFile;
use crate::observe::{
    CameraFrames, Done, FrameFacts, InputNotes, InputSummary, JournalError, Record, Span,
};
use crate::units::Measured;
use rayon::prelude::*;
use serde::{Serialize, de::DeserializeOwned};

/// Records that are read together.
const TOGETHER: usize = 4096;

/// What a frame gave, as far as its time is concerned.
pub trait Dated: Serialize + DeserializeOwned + Clone + Send + Sync {
    fn facts(&self) -> &FrameFacts;

    /// Where it shows its object, in any unit.
    fn place(&self) -> Option<[f64; 2]>;
}

/// The frames of a camera in the order of time; what they gave stays in the journal.
#[derive(Debug)]
pub struct Timeline<T> {
    done: Done<T>,
    camera: CameraFrames,
    dated: Vec<DatedFrame>,
    /// Frames without a time and files without a frame, by name.
    rest: Vec<Rest>,
    /// What of the files was not used as it stands.
    pub inputs: InputSummary,
    pub clock: ClockFacts,
}

#[derive(Debug, Clone)]
struct DatedFrame {
    /// Its place among the camera's inputs.
    input: u32,
    utc_ns: i64,
    /// Where its stamp is not believed as it stands.
    timing: Option<Box<Timing>>,
}

#[derive(Debug, Clone)]
enum Rest {
    Undated { input: u32, timing: Timing },
    Unread { file: String, error: String },
    Copy { file: String, first: String },
}

/// What a file of the timeline holds.
pub enum Entry<T> {
    Frame(Box<T>),
    /// No frame that counts: why.
    None {
        error: String,
        copy_of: Option<String>,
    },
}

impl<T: Dated> Timeline<T> {
    /// All frames of a camera that a span holds.
    ///
    /// # Errors
    /// A journal that cannot be read.
    pub fn new(done: Done<T>, camera: CameraFrames, span: &Span) -> Result<Self, JournalError> {
        let mut notes = InputNotes::default();
        let (mut stamps, mut stamped, mut rest) = (Vec::new(), Vec::new(), Vec::new());
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
                        rest.push(Rest::Unread { file, error });
                    }
                }
            }
        }
        rest.extend(notes.copies(&camera.copies, span).map(|copy| Rest::Copy {
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
            match timing.utc_ns(stamp.utc_ns) {
                Some(utc_ns) => dated.push(DatedFrame {
                    input,
                    utc_ns,
                    timing: (timing != Timing::default()).then(|| Box::new(timing)),
                }),
                None => rest.push(Rest::Undated { input, timing }),
            }
        }
        // Inputs are in the order of their paths.
        dated.sort_by_key(|frame| (frame.utc_ns, frame.input));
        let mut timeline = Self {
            done,
            camera,
            dated,
            rest: Vec::new(),
            inputs: notes.finish(),
            clock,
        };
        rest.sort_by(|a, b| timeline.name(a).cmp(timeline.name(b)));
        timeline.rest = rest;
        Ok(timeline)
    }

    /// How many files there are.
    pub fn len(&self) -> usize {
        self.dated.len() + self.rest.len()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// How many of them have a time: the first ones.
    pub fn dated(&self) -> usize {
        self.dated.len()
    }

    /// The file of a place in the timeline.
    pub fn file(&self, n: usize) -> &str {
        match self.dated.get(n) {
            Some(frame) => &self.input(frame.input).file,
            None => self.name(&self.rest[n - self.dated.len()]),
        }
    }

    /// Mid-exposure, ns since 1970.
    pub fn utc_ns(&self, n: usize) -> Option<i64> {
        self.dated.get(n).map(|frame| frame.utc_ns)
    }

    /// Seconds since 1970.
    pub fn unix_s(&self, n: usize) -> Option<f64> {
        Some(self.utc_ns(n)? as f64 / 1e9)
    }

    /// What is made of a frame's stamp.
    pub fn timing(&self, n: usize) -> Timing {
        match self.dated.get(n) {
            Some(frame) => frame.timing.as_deref().copied().unwrap_or_default(),
            None => match &self.rest[n - self.dated.len()] {
                Rest::Undated { timing, .. } => *timing,
                Rest::Unread { .. } | Rest::Copy { .. } => Timing::default(),
            },
        }
    }

    /// Whether a dated frame's time is one of a smoothed path.
    pub fn is_timed(&self, n: usize) -> bool {
        self.timing(n).odd.is_none_or(TimeOddity::is_of_path)
    }

    /// What a file holds.
    ///
    /// # Errors
    /// A journal that cannot be read.
    pub fn entry(&self, n: usize) -> Result<Entry<T>, JournalError> {
        let none = |error: &str, copy_of| Entry::None {
            error: error.into(),
            copy_of,
        };
        let input = match self.dated.get(n) {
            Some(frame) => frame.input,
            None => match &self.rest[n - self.dated.len()] {
                Rest::Undated { input, .. } => *input,
                Rest::Unread { error, .. } => return Ok(none(error, None)),
                Rest::Copy { first, .. } => {
                    let error = format!("the same frame as {first}");
                    return Ok(none(&error, Some(first.clone())));
                }
            },
        };
        let record = self.done.record(self.input(input))?;
        Ok(match record.map(|record| record.outcome) {
            Some(Ok(frame)) => Entry::Frame(Box::new(frame)),
            Some(Err(error)) => none(&error, None),
            None => none("no record", None),
        })
    }

    /// What a frame gave; none of a file without one.
    ///
    /// # Errors
    /// A journal that cannot be read.
    pub fn frame(&self, n: usize) -> Result<Option<T>, JournalError> {
        Ok(match self.entry(n)? {
            Entry::Frame(frame) => Some(*frame),
            Entry::None { .. } => None,
        })
    }

    /// Something of each file, in order: many are read at a time, and few kept.
    ///
    /// # Errors
    /// A journal that cannot be read.
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

    fn input(&self, input: u32) -> &StoredFile {
        &self.camera.inputs[input as usize]
    }

    fn name<'a>(&'a self, rest: &'a Rest) -> &'a str {
        match rest {
            Rest::Undated { input, .. } => &self.input(*input).file,
            Rest::Unread { file, .. } | Rest::Copy { file, .. } => file,
        }
    }
}
