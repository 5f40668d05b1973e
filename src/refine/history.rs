//! The flight as a whole: combines the results of the frames into the history.

use super::clock_facts::ClockFacts;
use super::flags::{FrameFlag, FrameFlags};
use super::frames::Frames;
use super::mapping::{FlightMapping, MappingFacts};
use super::outliers::outliers;
use super::path::SunPath;
use super::radius::RadiusDependence;
use super::recipe::Recipe;
use super::record::{FrameRecord, Grade};
use super::roll::RollHistory;
use super::row::RefinedRow;
use super::second_pass::solve_again;
use super::sky::Sky;
use super::suns::{Flight, Suns};
use super::timeline::{Content, Entry, Timeline};
use crate::geometry::attitude::Direction;
use crate::instrument::Instrument;
use crate::observe::{CameraFrames, InputSummary, JournalError, Pass, PassError, Recorded};
use crate::sky::Ephemeris;
use crate::smoothing::{Path, PathPoint};
use crate::units::{Measured, Place};
use jiff::Timestamp;
use rayon::prelude::*;

/// Rows assembled at a time, and those of them that share an ephemeris, whose costly part is done once a second.
const TOGETHER: usize = 4096;
const SAME_EPHEMERIS: usize = 256;

/// The history of one camera's frames. Rows are assembled on request: the results of the frames stay in the journal.
pub struct History {
    flight: Flight,
    suns: Suns,
    path: SunPath,
    /// The sky, and the nadir in the body's axes at each dated frame where the roll camera saw the horizon.
    sky: Sky,
    nadirs: Vec<Option<Direction>>,
    pub radius_by_temperature: RadiusDependence,
}

/// Reasons for which there is no history.
#[derive(Debug, thiserror::Error)]
pub enum HistoryError {
    #[error(transparent)]
    Pass(#[from] PassError),
    /// Most fine frames contradict the instrument: they are from another camera.
    #[error("{0}")]
    Contradiction(String),
    #[error("expected frames from --since to --until, found none")]
    Empty,
}

impl From<JournalError> for HistoryError {
    fn from(error: JournalError) -> Self {
        Self::Pass(error.into())
    }
}

impl History {
    /// Makes the history of a camera's frames, after a pass has observed each of them: the clock, the mapping, the Suns, the flags,
    /// the path, and a second pass over frames that had failed.
    ///
    /// # Errors
    /// If a journal cannot be read, the frames are not of the instrument's camera, or the pass is cancelled.
    pub fn new(
        done: Recorded<FrameRecord>,
        camera: CameraFrames,
        recipe: Recipe,
        sky: Sky,
        pass: &Pass<'_>,
    ) -> Result<Self, HistoryError> {
        let timeline = Timeline::new(done, camera, &pass.span)?;
        if timeline.is_empty() {
            return Err(HistoryError::Empty);
        }
        let mut frames = Frames::read(&timeline, &recipe.instrument)?;
        if let Some(contradiction) = frames.contradiction {
            return Err(HistoryError::Contradiction(contradiction));
        }
        let times_s = since_first(&timeline);
        let mapping = FlightMapping::estimate(&times_s, &mut frames, &recipe.instrument);
        if mapping.is_none() {
            tracing::warn!(
                "the marks determine no mapping of the flight: each frame stands by itself"
            );
        }
        let flight = Flight {
            recipe,
            timeline,
            frames: frames.frames,
            mapping,
        };
        let mut suns = Suns::find(&flight)?;
        let all: Vec<usize> = (0..flight.frames.len()).collect();
        suns.flags = outliers(&flight, &suns, &all);
        let path = follow_path(&flight, &mut suns);
        let again = solve_again(&flight, &suns, &path, pass);
        pass.check()?;
        let path = match again.is_empty() {
            true => path,
            false => {
                drop(path);
                let numbers: Vec<usize> = again.iter().map(|(n, _)| *n).collect();
                for (n, mapped) in again {
                    suns.discs[n] = Some(mapped);
                }
                for (n, mut flags) in numbers.iter().zip(outliers(&flight, &suns, &numbers)) {
                    if flight.frames[*n].disc.is_none() {
                        flags.insert(FrameFlag::SecondPass);
                    }
                    suns.flags[*n] = flags;
                }
                follow_path(&flight, &mut suns)
            }
        };
        Ok(Self {
            radius_by_temperature: RadiusDependence::of(&flight, &suns),
            nadirs: Vec::new(),
            flight,
            suns,
            path,
            sky,
        })
    }

    /// Adds the nadir in the body's axes at each dated frame.
    pub fn with_roll(self, roll: &RollHistory) -> Self {
        let times_s: Vec<f64> = self.frame_times_s().collect();
        Self {
            nadirs: roll.body_nadirs(&times_s),
            ..self
        }
    }

    /// The times of the dated frames, s since 1970.
    pub(super) fn frame_times_s(&self) -> impl Iterator<Item = f64> {
        let timeline = &self.flight.timeline;
        (0..timeline.dated()).filter_map(|n| timeline.unix_s(n))
    }

    pub fn recipe(&self) -> &Recipe {
        &self.flight.recipe
    }

    pub fn instrument(&self) -> &Instrument {
        &self.flight.recipe.instrument
    }

    pub fn sky(&self) -> &Sky {
        &self.sky
    }

    /// Inputs that were not used as they stand.
    pub fn inputs(&self) -> &InputSummary {
        &self.flight.timeline.inputs
    }

    pub fn clock(&self) -> &ClockFacts {
        &self.flight.timeline.clock
    }

    pub fn mapping(&self) -> Option<&MappingFacts> {
        self.flight.mapping.as_ref().map(|mapping| &mapping.facts)
    }

    /// The flight's radius, relative to the expected one.
    pub fn radius_ratio(&self) -> Option<Measured> {
        self.suns.radius_ratio
    }

    /// The smoothed path of the Sun over the plate.
    pub fn path(&self) -> Option<&Path> {
        self.path.path.as_ref()
    }

    /// The origin of the path's times, and the times of the first and the last dated frame, s since 1970.
    pub(super) fn path_times_s(&self) -> Option<(f64, [f64; 2])> {
        Some((self.path.first_s, self.path.ends_s()?))
    }

    /// The points of the smoothed path, each with its time, s since 1970; none where the path is too uncertain.
    pub fn smoothed(&self) -> impl Iterator<Item = (f64, Option<&PathPoint>)> {
        self.path.points()
    }

    /// Number of files.
    pub fn len(&self) -> usize {
        self.flight.timeline.len()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of files that have a time; these come first.
    pub fn dated(&self) -> usize {
        self.flight.timeline.dated()
    }

    /// The file at an index of the history.
    ///
    /// # Errors
    /// If a journal cannot be read.
    pub fn file(&self, n: usize) -> Result<String, JournalError> {
        self.flight.timeline.file(n)
    }

    pub fn utc(&self, n: usize) -> Option<Timestamp> {
        Timestamp::from_nanosecond(self.flight.timeline.utc_ns(n)?.into()).ok()
    }

    /// A row for each file, in the order of time; frames without a time and files that could not be read come last, by name.
    pub fn rows(&self) -> impl Iterator<Item = Result<RefinedRow, JournalError>> {
        (0..self.len()).step_by(TOGETHER).flat_map(|first| {
            let some = first..self.len().min(first + TOGETHER);
            let parts = some.into_par_iter().chunks(SAME_EPHEMERIS);
            let rows = parts.flat_map_iter(|part| {
                let mut ephemeris = self.sky.ephemeris.clone();
                let rows = part.into_iter().map(|n| self.row(n, &mut ephemeris));
                rows.collect::<Vec<_>>()
            });
            rows.collect::<Vec<_>>()
        })
    }

    /// Positions stated by the dated frames, with the time, s since 1970.
    ///
    /// # Errors
    /// If a journal cannot be read.
    pub fn places(&self) -> Result<Vec<(f64, Place)>, JournalError> {
        let timeline = &self.flight.timeline;
        let mut places = Vec::new();
        let read = |n: usize| {
            let frame = timeline.frame(n)?;
            let place = frame.and_then(|frame| frame.facts.place());
            Ok(timeline.unix_s(n).zip(place))
        };
        timeline.each(timeline.dated(), read, |place| places.extend(place))?;
        Ok(places)
    }

    fn row(&self, n: usize, ephemeris: &mut Ephemeris) -> Result<RefinedRow, JournalError> {
        let Flight {
            timeline,
            frames,
            mapping,
            recipe,
        } = &self.flight;
        let Entry { file, data } = timeline.entry(n)?;
        let (own, copy_of, error) = match data {
            Content::Frame(frame) => (Some(*frame), None, None),
            Content::None { error, copy_of } => (None, copy_of, Some(format!("file: {error}"))),
        };
        let own_reason = own
            .as_ref()
            .map(|own| own.facts.reason(own.reason.as_deref()));
        let timing = timeline.timing(n);
        let mut row = RefinedRow {
            file,
            copy_of,
            utc_ns: timeline.utc_ns(n),
            timing,
            speed_mil_per_s: None,
            quality: own.as_ref().map_or(Grade::None, |own| own.quality),
            own_reason: own_reason.or(error).unwrap_or_default(),
            flags: FrameFlags::default(),
            sun: own
                .as_ref()
                .and_then(|own| Some(own.disc.as_ref()?.on_plate())),
            disc: None,
            limb_part: own
                .as_ref()
                .and_then(|own| Some(own.disc.as_ref()?.limb_fraction)),
            expected_radius_mil: None,
            mapping: None,
            jump_px: None,
            sky: None,
            body_nadir: None,
            own,
        };
        let Some(frame) = frames.get(n) else {
            return Ok(row);
        };
        row.flags = self.suns.flags[n];
        row.expected_radius_mil = frame.expected_radius_mil;
        row.quality = self.suns.quality(frame, n);
        row.sun = self.suns.sun(&self.flight, n);
        row.limb_part = self.suns.limb_part(frame, n);
        row.speed_mil_per_s = timing.sigma_s.and_then(|_| self.path.speed(n));
        row.body_nadir = self.nadirs.get(n).copied().flatten();
        if let Some(mapped) = &self.suns.discs[n] {
            row.disc = Some(mapped.disc);
            row.mapping = mapping.as_ref().and_then(|mapping| mapping.numbers(n));
            row.jump_px = mapping.as_ref().and_then(|mapping| mapping.own_jump(n));
            if mapped.quality == Grade::Fine && frame.disc.is_some() {
                row.own_reason.clear();
            }
        }
        row.sky = self.sky.row(&row, &recipe.instrument, ephemeris);
        Ok(row)
    }
}

/// The path of the fine frames; also flags the frames that lie off it.
fn follow_path(flight: &Flight, suns: &mut Suns) -> SunPath {
    let (path, off) = SunPath::follow(flight, suns);
    for n in off {
        suns.flags[n].insert(FrameFlag::Path);
    }
    path
}

/// The times of the dated frames from the first one, s.
fn since_first(timeline: &Timeline<FrameRecord>) -> Vec<f64> {
    let times = (0..timeline.dated()).filter_map(|n| timeline.utc_ns(n));
    let first = timeline.utc_ns(0).unwrap_or_default();
    times.map(|utc_ns| (utc_ns - first) as f64 / 1e9).collect()
}
