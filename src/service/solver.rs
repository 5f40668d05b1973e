//! The solver's thread: frame in, answer out, to the archive and to the line.

use super::archiver::Archive;
use super::control::{Controls, Snapshot, Topic};
use super::line::{LinkEvent, Outcome};
use super::tally::{SolverTally, worth_a_line};
use super::{Sighting, Station};
use crate::archive::{Record, Row};
use crate::aspect::{self, Expected, Solution, Stage, Track};
use crate::camera::Exposure;
use crate::frame::FrameInfo;
use crate::instrument::{Instrument, Mounting};
use crate::link::picture::{Tag, TagValue};
use crate::link::{self, Picture};
use crate::pointing::{self, Offset, Target};
use crate::sky::Ephemeris;
use crossbeam_channel::{Receiver, Sender};
use jiff::{SignedDuration, Timestamp};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A solved frame.
#[derive(Debug, Clone)]
pub struct Answer {
    /// Of the camera that took the frame.
    pub station: Arc<Station>,
    pub exposure: Arc<Exposure>,
    pub solution: Arc<Solution>,
    /// From `target`.
    pub offset: Option<Offset>,
    pub target: Target,
    pub solve_time: Duration,
    /// Whether the picture goes to the archive; the row always does.
    pub to_be_stored: bool,
}

impl Answer {
    /// What the logs tell of it, before its picture is stored.
    pub(super) fn row(&self) -> Row {
        let info = &self.exposure.frame.info;
        let solution = &self.solution;
        let solve_time = Some(self.solve_time);
        let record = Record::new("", info.mid_exposure, solution, self.offset, solve_time);
        Row::new(info.number, solution, record)
    }
}

pub(super) struct Solver {
    pub station: Arc<Station>,
    pub ephemeris: Ephemeris,
    pub controls: Controls,
    pub archive: Archive,
    pub to_line: Sender<LinkEvent>,
    pub watcher: Option<Sender<Answer>>,
}

impl Solver {
    /// Solves until the camera ends.
    pub fn run(mut self, sightings: &Receiver<Sighting>) -> SolverTally {
        let mut tally = SolverTally::default();
        let mut track = None;
        let stated = self.station.instrument.mounting;
        let mut mounting_version = None;
        let mut sun = SunSize::default();
        for sighting in sightings {
            let Sighting { exposure, arrived } = sighting;
            if let Err(error) = self.station.instrument.check_size(&exposure.frame) {
                tally.misfits += 1;
                if worth_a_line(tally.misfits) {
                    tracing::error!(%error, misfits = tally.misfits, "not this camera's frame");
                }
                continue;
            }
            let version = self.controls.version(Topic::Mounting);
            let snapshot = self.controls.snapshot();
            if mounting_version.replace(version) != Some(version) {
                self.remount(&snapshot, &stated, &mut track);
            }
            let answer = self.solve(exposure, &snapshot, &mut track, &mut sun);
            count(&mut tally, &answer.solution);
            tracing::debug!(
                number = answer.exposure.frame.info.number,
                quality = answer.solution.quality.name(),
                solve_us = answer.solve_time.as_micros() as u64,
                "solved"
            );
            self.hand_on(answer, arrived, &mut tally);
        }
        self.archive.close();
        tally
    }

    /// Where the ground has turned camera or plate, what the last frames taught no longer holds.
    fn remount(&mut self, commanded: &Snapshot, stated: &Mounting, track: &mut Option<Track>) {
        let mounting = commanded.mounting(stated);
        if mounting != self.station.instrument.mounting {
            let mut station = (*self.station).clone();
            station.instrument.mounting = mounting;
            self.station = Arc::new(station);
            *track = None;
        }
    }

    fn solve(
        &mut self,
        mut exposure: Exposure,
        commanded: &Snapshot,
        track: &mut Option<Track>,
        sun: &mut SunSize,
    ) -> Answer {
        let utc = exposure.frame.info.mid_exposure;
        let size = utc.and_then(|utc| sun.at(utc));
        let start = Instant::now();
        let frame = &exposure.frame;
        let mut solution = aspect::solve_with(
            &commanded.solver,
            frame,
            &self.station.instrument,
            size,
            track.as_ref(),
        );
        let solve_time = start.elapsed();
        if solution.track.is_some() {
            track.clone_from(&solution.track);
        }
        // The file tells the place that its offset and its coordinates rest on.
        let place = exposure.frame.info.place.or(commanded.place);
        exposure.frame.info.place = place;
        let offset = pointing::offset_of(
            &mut solution,
            utc,
            place,
            &commanded.target,
            &self.station.instrument,
            &mut self.ephemeris,
        );
        Answer {
            station: Arc::clone(&self.station),
            exposure: Arc::new(exposure),
            solution: Arc::new(solution),
            offset,
            target: commanded.target,
            solve_time,
            to_be_stored: self.controls.stores(self.station.role),
        }
    }

    /// What the ground has asked for, from the camera that the controller hears of.
    fn send_picture(&self, answer: &Answer) {
        let info = &answer.exposure.frame.info;
        let tags = picture_tags(&self.station.instrument, info);
        let time = info.mid_exposure.unwrap_or_else(Timestamp::now);
        match Picture::new(
            &answer.exposure.frame,
            self.station.camera_number() as u8,
            tags,
            time,
        ) {
            Ok(Some(picture)) => {
                // A line that is stuck carries no pictures.
                let _ = self.to_line.try_send(LinkEvent::Picture(Box::new(picture)));
            }
            Ok(None) => tracing::warn!("the frame is too large for a picture"),
            Err(error) => tracing::warn!(%error, "no picture"),
        }
    }

    /// The line first: a solution does not wait for a disk.
    fn hand_on(&self, answer: Answer, arrived: Instant, tally: &mut SolverTally) {
        let outcome = Outcome {
            exposure: link::Exposure {
                camera: self.station.camera_number(),
                start: answer.exposure.announced,
            },
            arrived,
            shutter: answer.exposure.frame.info.exposure,
            offset: answer.offset,
            stopped: answer.solution.stopped,
        };
        if self.to_line.try_send(LinkEvent::Outcome(outcome)).is_err() {
            tally.unsent += 1;
            if worth_a_line(tally.unsent) {
                tracing::warn!(
                    unsent = tally.unsent,
                    "the line is stuck: a solution was not sent"
                );
            }
        }
        if self.controls.takes_picture(self.station.role) {
            self.send_picture(&answer);
        }
        self.archive.offer(&answer);
        if let Some(watcher) = &self.watcher {
            // A watcher that has left misses nothing that matters.
            let _ = watcher.send(answer);
        }
    }
}

fn picture_tags(instrument: &Instrument, info: &FrameInfo) -> Vec<Tag> {
    let tag = |name, value, comment| Tag {
        name,
        value,
        comment,
    };
    let mut tags = vec![tag(
        "INSTRUME",
        TagValue::Text(instrument.name.clone()),
        "instrument",
    )];
    if let Some(exposure) = info.exposure {
        let seconds = TagValue::Number(exposure.as_secs_f64());
        tags.push(tag("EXPTIME", seconds, "exposure, s"));
    }
    if let Some(number) = info.number {
        let number = TagValue::Whole(number as i32);
        tags.push(tag("FRAMENUM", number, "number of the frame"));
    }
    tags
}

fn count(tally: &mut SolverTally, solution: &Solution) {
    *tally.solved.entry(solution.quality).or_default() += 1;
    if let Some(stopped) = &solution.stopped {
        let reason = (stopped.stage, stopped.rejected.reason);
        let count = tally.reasons.entry(reason).or_default();
        *count += 1;
        if stopped.stage == Stage::Pointing && worth_a_line(*count) {
            let (measured, limit) = (stopped.rejected.measured, stopped.rejected.limit);
            tracing::warn!(reason = %stopped, measured, limit, frames = *count, "no offset");
        }
    }
}

/// The Sun's size changes by a thousandth in a day: one look at the ephemeris serves for a second and more.
#[derive(Default)]
struct SunSize {
    last: Option<(Timestamp, Option<Expected>)>,
}

impl SunSize {
    fn at(&mut self, utc: Timestamp) -> Option<Expected> {
        const VALID: SignedDuration = SignedDuration::from_secs(60);
        match self.last {
            Some((then, size)) if utc.duration_since(then).abs() < VALID => size,
            _ => {
                let size = Expected::at(utc);
                self.last = Some((utc, size));
                size
            }
        }
    }
}
