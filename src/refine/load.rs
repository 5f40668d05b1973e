//! The records of the first pass, without what the second pass does not hold for all frames at once.

use super::drift::MarkObservation;
use super::first_pass::{Done, Span, key};
use super::journal::JournalError;
use super::record::{FrameRecord, Grade, Input, MarkRecord, Record, upper};
use super::row::Row;
use crate::instrument::Instrument;
use crate::sky::sun_angular_radius;
use crate::units::Place;
use rayon::prelude::*;
use std::ops::Range;

/// Records that are read together.
const TOGETHER: usize = 4096;

/// A frame as the second pass begins with it.
pub(super) struct Entry {
    /// Of its record.
    pub key: u64,
    pub row: Row,
    pub place: Option<Place>,
    /// The fine frame's own mapping from the ideal sensor (px) to the plate (mil), row by row.
    pub own_mapping: Option<[f64; 9]>,
    /// Which of the flight's marks are the fine frame's.
    pub marks: Range<usize>,
}

/// All that is done of a flight.
pub(super) struct Loaded {
    /// In the order of time; those without a time come last, by name.
    pub entries: Vec<Entry>,
    pub marks: Vec<MarkObservation>,
    /// Files that could not be read.
    pub unread: Vec<Row>,
}

/// Reads what the span holds.
///
/// # Errors
/// A journal that cannot be read.
pub(super) fn load(
    done: &Done,
    inputs: &[Input],
    instrument: &Instrument,
    span: &Span,
) -> Result<Loaded, JournalError> {
    let (mut entries, mut marks, mut unread) = (Vec::new(), Vec::new(), Vec::new());
    for some in inputs.chunks(TOGETHER) {
        let loaded = some.par_iter().map(|input| {
            let record = done.record(input)?;
            Ok(record.and_then(|record| one(record, instrument, span)))
        });
        let loaded: Vec<Option<One>> = loaded.collect::<Result<_, JournalError>>()?;
        for one in loaded.into_iter().flatten() {
            match one {
                Ok((mut entry, own)) => {
                    entry.marks = marks.len()..marks.len() + own.len();
                    marks.extend(own);
                    entries.push(entry);
                }
                Err(row) => unread.push(row),
            }
        }
    }
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
    })
}

/// A frame with its marks, or the row of a file that could not be read.
type One = Result<(Entry, Vec<MarkObservation>), Row>;

/// What a record gives; none where it lies outside the span.
fn one(record: Record, instrument: &Instrument, span: &Span) -> Option<One> {
    let Record { input, outcome } = record;
    match outcome {
        Ok(frame) if !span.holds(frame.utc()) => None,
        Ok(frame) => Some(Ok(entry(input, &frame, instrument))),
        Err(error) => Some(Err(Row::unread(input, error))),
    }
}

fn entry(
    input: Input,
    frame: &FrameRecord,
    instrument: &Instrument,
) -> (Entry, Vec<MarkObservation>) {
    let key = key(&input);
    let mut row = Row::of(input, frame);
    let angular = row.utc().and_then(|utc| sun_angular_radius(utc).ok());
    row.expected_radius_mil = angular.map(|angular| instrument.optics.radius_mil(angular));
    let fine = frame.quality == Grade::Fine;
    let marks = frame.marks.iter().filter(|_| fine);
    let own = frame.disc.as_ref().filter(|_| fine);
    let entry = Entry {
        key,
        row,
        place: frame.place(),
        own_mapping: own.and_then(|disc| disc.to_plate),
        marks: 0..0,
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
