//! The records of the first pass, without what the second pass does not hold for all frames at once.

use super::cameras::CameraFrames;
use super::clock::ClockStep;
use super::clock_facts::ClockFacts;
use super::drift::MarkObservation;
use super::first_pass::{Done, Span, key};
use super::inputs::{InputNotes, InputSummary};
use super::journal::JournalError;
use super::record::{FrameFacts, FrameRecord, Grade, MarkRecord, Record, upper};
use super::row::Row;
use super::times::{Stamp, Times};
use crate::archive::StoredFile;
use crate::aspect::Stage;
use crate::instrument::Instrument;
use crate::sky::sun_angular_radius;
use crate::units::{Measured, Place};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;

/// Records that are read together.
const TOGETHER: usize = 4096;
/// Fewer frames that contradict the instrument are misread.
const LEAST_CONTRADICTING: usize = 3;

/// A frame as the second pass begins with it.
pub(super) struct Entry {
    /// Of its record.
    pub key: u64,
    pub row: Row,
    pub facts: FrameFacts,
    pub place: Option<Place>,
    /// The fine frame's own mapping from the ideal sensor (px) to the plate (mil), row by row.
    pub own_mapping: Option<[f64; 9]>,
    /// Which of the flight's marks are the fine frame's.
    pub marks: Range<usize>,
    /// What the fine frame measures otherwise than the instrument's file states it, in words.
    contradiction: Option<String>,
}

/// All that is done of a flight.
pub(super) struct Loaded {
    /// In the order of time; those without a time come last, by name.
    pub entries: Vec<Entry>,
    pub marks: Vec<MarkObservation>,
    /// Files that could not be read, and copies, by name.
    pub unread: Vec<Row>,
    pub inputs: InputSummary,
    pub clock: ClockFacts,
    /// What most fine frames say against the instrument, in words.
    pub contradiction: Option<String>,
}

/// Reads what the span holds.
///
/// # Errors
/// A journal that cannot be read.
pub(super) fn load(
    done: &Done<FrameRecord>,
    camera: &CameraFrames,
    instrument: &Instrument,
    span: &Span,
) -> Result<Loaded, JournalError> {
    let (mut entries, mut marks, mut unread) = (Vec::new(), Vec::new(), Vec::new());
    let mut notes = InputNotes::default();
    for some in camera.inputs.chunks(TOGETHER) {
        let loaded = some.par_iter().map(|input| {
            let record = done.record(input)?;
            Ok(record.and_then(|record| one(record, instrument, span)))
        });
        let loaded: Vec<Option<One>> = loaded.collect::<Result<_, JournalError>>()?;
        for one in loaded.into_iter().flatten() {
            match one {
                Ok((mut entry, own)) => {
                    notes.read(&entry.row.file, &entry.facts);
                    entry.marks = marks.len()..marks.len() + own.len();
                    marks.extend(own);
                    entries.push(entry);
                }
                Err((input, error)) => {
                    notes.unreadable(&error);
                    unread.push(Row::unread(input, error));
                }
            }
        }
    }
    unread.extend(notes.copies(&camera.copies, span).map(Row::copied));
    unread.sort_by(|a, b| a.file.cmp(&b.file));
    let contradiction = contradiction(&entries).or_else(|| unidentified(&entries));
    let clock = correct_times(&mut entries);
    entries.par_iter_mut().for_each(|Entry { row, .. }| {
        let angular = row.utc().and_then(|utc| sun_angular_radius(utc).ok());
        row.expected_radius_mil = angular.map(|angular| instrument.optics.radius_mil(angular));
    });
    entries.sort_by(|a, b| {
        let key = |e: &Entry| (e.row.utc_ns.is_none(), e.row.utc_ns);
        key(a)
            .cmp(&key(b))
            .then_with(|| a.row.file.cmp(&b.row.file))
    });
    Ok(Loaded {
        entries,
        marks,
        unread,
        inputs: notes.finish(),
        clock,
        contradiction,
    })
}

/// What most of the fine frames say against the instrument: it is another camera's, or the camera was moved.
fn contradiction(entries: &[Entry]) -> Option<String> {
    let fine = entries
        .iter()
        .filter(|entry| entry.row.own.quality == Grade::Fine);
    let fine = fine.count();
    let mut contradicting = entries
        .iter()
        .filter_map(|entry| Some((&entry.row.file, entry.contradiction.as_ref()?)));
    let (file, what) = contradicting.next()?;
    let frames = 1 + contradicting.count();
    (2 * frames > fine && frames >= LEAST_CONTRADICTING).then(|| {
        format!(
            "{frames} of {fine} fine frames contradict the instrument; expected its camera's frames, found in {file} {what}. Name the camera's \
             own instrument, or one whose sigmas allow for this"
        )
    })
}

/// Where no frame is fine, and most of those that show something bright have marks that are not the plate's as this instrument sees
/// it: a mirrored picture, or another plate.
fn unidentified(entries: &[Entry]) -> Option<String> {
    let own = || entries.iter().map(|entry| &entry.row.own);
    if own().any(|own| own.quality == Grade::Fine) {
        return None;
    }
    let bright = own().filter(|own| own.levels_dn.is_some()).count();
    let stage = format!("{}: ", Stage::Identification.name());
    let mut reasons: BTreeMap<&str, usize> = BTreeMap::new();
    for own in own() {
        if let Some(reason) = own.reason.strip_prefix(&stage) {
            *reasons.entry(reason).or_default() += 1;
        }
    }
    let frames: usize = reasons.values().sum();
    let (reason, _) = reasons.into_iter().max_by_key(|(_, frames)| *frames)?;
    (2 * frames > bright && frames >= LEAST_CONTRADICTING).then(|| {
        format!(
            "the marks of {frames} of {bright} frames cannot be identified, and no frame is fine; expected the plate as the instrument sees it, found, in most, \
             that {reason}. Name the camera's own instrument, and see that the pictures are not mirrored (mounting.handedness)"
        )
    })
}

/// Holds the frames' times against the monotonic clock, their numbers and each other.
fn correct_times(entries: &mut [Entry]) -> ClockFacts {
    let place = |entry: &Entry| entry.row.own.sun_mil;
    let stamps = entries
        .iter()
        .map(|entry| Stamp::of(&entry.facts, place(entry)));
    let Times { timings, clocks } = Times::of(&stamps.collect::<Vec<Stamp>>());
    let step = |step: &ClockStep<usize>| ClockStep {
        frame: entries[step.frame].row.file.clone(),
        step_s: step.step_s,
    };
    let steps = clocks.steps.iter().map(step).collect();
    let corrected = timings
        .iter()
        .filter(|timing| timing.correction_s.is_some());
    let corrected = corrected.count();
    for (Entry { row, .. }, timing) in entries.iter_mut().zip(timings) {
        row.utc_ns = timing.utc_ns(row.utc_ns);
        row.utc_correction_s = timing.correction_s;
        row.time_sigma_s = timing.sigma_s;
        timing.odd.into_iter().for_each(|odd| row.note(odd));
    }
    ClockFacts {
        drift_ppm: clocks
            .drift
            .map(|drift| Measured::new(drift.value * 1e6, drift.sigma * 1e6)),
        steps,
        corrected,
    }
}

/// A frame with its marks, or a file that could not be read, and why.
type One = Result<(Entry, Vec<MarkObservation>), (StoredFile, String)>;

/// What a record gives; none where it lies outside the span.
fn one(record: Record<FrameRecord>, instrument: &Instrument, span: &Span) -> Option<One> {
    let Record { input, outcome } = record;
    match outcome {
        Ok(frame) if !span.holds(frame.facts.utc()) => None,
        Ok(frame) => Some(Ok(entry(input, &frame, instrument))),
        Err(error) => Some(Err((input, error))),
    }
}

fn entry(
    input: StoredFile,
    frame: &FrameRecord,
    instrument: &Instrument,
) -> (Entry, Vec<MarkObservation>) {
    let key = key(&input);
    let row = Row::of(input, frame);
    let fine = frame.quality == Grade::Fine;
    let marks = frame.marks.iter().filter(|_| fine);
    let own = frame.disc.as_ref().filter(|_| fine);
    let entry = Entry {
        key,
        row,
        facts: frame.facts.clone(),
        place: frame.facts.place(),
        own_mapping: own.and_then(|disc| disc.to_plate),
        marks: 0..0,
        contradiction: frame.contradiction.clone(),
    };
    (
        entry,
        marks
            .filter_map(|mark| observation(mark, instrument))
            .collect(),
    )
}

fn observation(mark: &MarkRecord, instrument: &Instrument) -> Option<MarkObservation> {
    let information = mark.covariance().try_inverse()?;
    Some(MarkObservation {
        seen: instrument.camera.distortion.correct(mark.at()).vector(),
        printed: instrument.plate.position(mark.id()),
        information: upper(&information).map(|part| part as f32),
        weight: 1.0,
    })
}
