//! The solver's thread: frame in, answer out, to the archive and to the line.

use super::answer::Answer;
use super::flight::{Middle, Station, UnsolvedFrame};
use super::line::{LinkEvent, Outcome};
use super::outlet::Outlet;
use super::roll::LatestNadir;
use super::shared::Shared;
use super::tally::SolverTally;
use super::worker::Life;
use crate::aspect::{self, Expected, Quality, Solution, Stage, Track};
use crate::calibrate::check::CalibrationCheck;
use crate::camera::{Brightness, Exposure};
use crate::commands::controls::{Seat, Snapshot, Topic};
use crate::instrument::Instrument;
use crate::link::{self, Counters};
use crate::log::worth_a_line;
use crate::pointing;
use crate::sky::Ephemeris;
use crossbeam_channel::Receiver;
use jiff::{SignedDuration, Timestamp};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

#[derive(Clone)]
pub(super) struct Solver {
    pub station: Arc<Station>,
    pub ephemeris: Ephemeris,
    pub outlet: Outlet,
    pub cameras_ended: Arc<AtomicBool>,
    /// What the roll camera's solver has found.
    pub nadir: LatestNadir,
    /// Outlives a thread that fails, as the counts do.
    pub calibration: Shared<CalibrationCheck>,
    pub tally: Shared<SolverTally>,
    pub counters: Arc<Counters>,
}

impl Solver {
    /// Solves until the camera ends, or another thread has taken over.
    pub fn run(mut self, frames: &Receiver<UnsolvedFrame>, life: &Life) {
        let mut track = None;
        let stated = self.station.instrument.clone();
        let mut mounted = stated.clone();
        let mut mounting_version = None;
        let mut sun = SunSize::default();
        while let Some(frame) = UnsolvedFrame::next(frames, &self.cameras_ended, life) {
            let UnsolvedFrame {
                exposure,
                arrived,
                middle,
            } = frame;
            let version = self.outlet.controls.version(Topic::Mounting);
            let snapshot = self.outlet.controls.snapshot();
            // Commands about the mounting are about the first camera's.
            let commanded = self.station.seat == Seat::PitchYaw;
            if commanded && mounting_version.replace(version) != Some(version) {
                mounted.mounting = snapshot.mounting(&stated.mounting);
            }
            if !self.fit(&exposure, &mounted, &mut track) {
                continue;
            }
            let answer = self.solve(exposure, middle, &snapshot, &mut track, &mut sun);
            if life.is_over() {
                return;
            }
            self.count(&answer.solution);
            self.check_calibration(&answer.solution);
            tracing::debug!(
                number = answer.exposure.frame.info.number,
                quality = answer.solution.quality.name(),
                solve_us = answer.solve_time.as_micros() as u64,
                "solved"
            );
            self.hand_on(answer, arrived);
        }
    }

    /// Fits the station's instrument to the frame. Where it changes - the ground has turned camera or plate, or another
    /// part of the sensor is read - what the last frames taught no longer holds. False for a frame of another camera; one
    /// that sees no plate may have any size.
    fn fit(
        &mut self,
        exposure: &Exposure,
        mounted: &Instrument,
        track: &mut Option<Track>,
    ) -> bool {
        if !self.station.sees_plate() {
            return true;
        }
        match mounted.seen_by(&exposure.frame) {
            Ok(seen) if *seen == self.station.instrument => true,
            Ok(seen) => {
                let mut station = (*self.station).clone();
                station.instrument = seen.into_owned();
                self.station = Arc::new(station);
                *track = None;
                true
            }
            Err(error) => {
                let mut tally = self.tally.lock();
                tally.misfits += 1;
                if worth_a_line(tally.misfits) {
                    tracing::error!(%error, misfits = tally.misfits, "not this camera's frame");
                }
                false
            }
        }
    }

    fn solve(
        &mut self,
        mut exposure: Exposure,
        middle: Middle,
        commanded: &Snapshot,
        track: &mut Option<Track>,
        sun: &mut SunSize,
    ) -> Answer {
        let utc = exposure.frame.info.mid_exposure;
        let size = utc.and_then(|utc| sun.at(utc));
        let start = Instant::now();
        let frame = &exposure.frame;
        let prior = track.as_ref();
        // Without a mapping of an earlier frame the calibration's is borrowed, but not what frames have disproved.
        let stated = &self.station.instrument;
        let corrected = match prior.is_some_and(|prior| prior.registration.is_some()) {
            true => None,
            false => self.calibration.lock().corrected(stated),
        };
        let instrument = corrected.as_ref().unwrap_or(stated);
        let mut solution = match self.station.sees_plate() {
            true => aspect::solve_with(&commanded.solver, frame, instrument, size, prior),
            false => aspect::levels_only(&commanded.solver, frame, instrument),
        };
        let solve_time = start.elapsed();
        if solution.track.is_some() {
            track.clone_from(&solution.track);
        }
        // The file tells the place that its offset and its coordinates rest on.
        let place = exposure.frame.info.place.or(commanded.place);
        exposure.frame.info.place = place;
        let max_age = commanded.roll.max_age();
        let seen = self.nadir.copy();
        let nadir = seen.and_then(|seen| seen.at(&middle, max_age));
        let offset = pointing::offset_of(
            &mut solution,
            utc,
            place,
            &commanded.target,
            nadir.as_ref(),
            &self.station.instrument,
            &mut self.ephemeris,
        );
        Answer {
            station: Arc::clone(&self.station),
            exposure: Arc::new(exposure),
            solution: Arc::new(solution),
            offset,
            horizon: None,
            moon: None,
            roll_deg: nadir.as_ref().map(pointing::body_roll_deg),
            roll_arrived: nadir.and(seen).map(|seen| seen.arrived),
            target: commanded.target,
            solve_time,
            to_be_stored: self.outlet.stores(&self.station),
        }
    }

    /// Says once what fine frames have disproved of the calibration.
    fn check_calibration(&self, solution: &Solution) {
        let instrument = &self.station.instrument;
        let mut calibration = self.calibration.lock();
        let proven = calibration.note(solution, instrument);
        let mut tally = self.tally.lock();
        tally.contradicted = calibration.proven().next().is_some();
        for contradiction in proven {
            let (camera, name) = (self.station.camera_number(), &instrument.name);
            tracing::error!(camera, instrument = name, %contradiction, "fine frames contradict the calibration");
            tally
                .contradictions
                .insert(format!("{name}: {contradiction}"));
        }
    }

    /// The line first: a solution does not wait for a disk.
    fn hand_on(&self, answer: Answer, arrived: Instant) {
        if self.station.sees_plate() {
            self.tell_line(&answer, arrived);
        }
        let saturation_dn = answer.exposure.frame.saturation_dn();
        let seen = Brightness::of(answer.solution.levels.as_ref(), saturation_dn);
        self.outlet.hand_on(answer, seen);
    }

    fn tell_line(&self, answer: &Answer, arrived: Instant) {
        let outcome = Outcome {
            exposure: link::Exposure {
                camera: self.station.camera_number(),
                start: answer.exposure.announced,
            },
            arrived,
            shutter: answer.exposure.frame.info.exposure,
            offset: answer.offset,
            roll_deg: answer.roll_deg,
            roll_arrived: answer.roll_arrived,
            stopped: answer.solution.stopped,
        };
        if self
            .outlet
            .to_line
            .try_send(LinkEvent::Outcome(Box::new(outcome)))
            .is_err()
        {
            let mut tally = self.tally.lock();
            tally.unsent += 1;
            if worth_a_line(tally.unsent) {
                tracing::warn!(
                    unsent = tally.unsent,
                    "the line is stuck: a solution was not sent"
                );
            }
        }
    }

    fn count(&self, solution: &Solution) {
        match solution.quality {
            Quality::Fine => self.counters.fine.count(),
            Quality::Coarse => self.counters.coarse.count(),
            Quality::None => self.counters.none.count(),
        };
        if let Some(stopped) = &solution.stopped {
            let reason = (stopped.stage, stopped.rejected.reason);
            let mut tally = self.tally.lock();
            let count = tally.reasons.entry(reason).or_default();
            *count += 1;
            if stopped.stage == Stage::Pointing && worth_a_line(*count) {
                let (measured, limit) = (stopped.rejected.measured, stopped.rejected.limit);
                tracing::warn!(reason = %stopped, measured, limit, frames = *count, "no offset");
            }
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
