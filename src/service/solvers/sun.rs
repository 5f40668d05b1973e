//! The solver of a pitch-yaw camera: it takes a frame of the plate and gives the Sun's place and the offset from the target.

use super::{Solver, SolverFactory, State, timed};
use crate::aspect::{self, Expected, Stage, Track};
use crate::camera::Brightness;
use crate::commands::controls::Snapshot;
use crate::instrument::{Instrument, WrongSize};
use crate::pointing;
use crate::reasons::Stopped;
use crate::service::messages::{BodyRoll, Found, LatestNadir, Solved, SolvedSun, UnsolvedFrame};
use crate::sky::Ephemeris;
use jiff::{SignedDuration, Timestamp};
use std::sync::Arc;
use tracing::Level;

pub(super) struct SunSolver {
    camera: u8,
    stated: Instrument,
    /// The instrument with commanded settings.
    mounted: Instrument,
    /// The same for the part of the sensor that was read in the last frame.
    instrument: Arc<Instrument>,
    /// Whether commands of the mounting apply to this camera: they apply to the first one.
    is_commanded: bool,
    ephemeris: Ephemeris,
    /// Latest result of the first roll camera.
    nadir: LatestNadir,
    state: State,
    /// Tracking prior from the last frame.
    track: Option<Track>,
    sun: SunSize,
}

impl SunSolver {
    pub fn new(factory: &SolverFactory, instrument: Instrument) -> Self {
        Self {
            camera: factory.station.number,
            instrument: Arc::new(instrument.clone()),
            mounted: instrument.clone(),
            stated: instrument,
            is_commanded: factory.station.ordinal == 1,
            ephemeris: factory.ephemeris.clone(),
            nadir: factory.results.nadir.clone(),
            state: factory.state.clone(),
            track: None,
            sun: SunSize::default(),
        }
    }

    /// Adapts the instrument to the frame. If it changes - the ground has turned camera or plate, or another part of the sensor is read - the
    /// results of the last frames no longer hold.
    fn fit(&mut self, frame: &UnsolvedFrame, commanded: &Snapshot) -> Result<(), WrongSize> {
        if self.is_commanded {
            self.mounted.mounting = commanded.mounting(&self.stated.mounting);
        }
        let seen = self.mounted.seen_by(&frame.exposure.frame)?;
        if *seen != *self.instrument {
            self.instrument = Arc::new(seen.into_owned());
            self.track = None;
        }
        Ok(())
    }
}

impl Solver for SunSolver {
    fn solve(
        &mut self,
        frame: &mut UnsolvedFrame,
        commanded: &Snapshot,
    ) -> Result<Solved, WrongSize> {
        self.fit(frame, commanded)?;
        let middle = frame.middle;
        let frame = &mut frame.exposure.frame;
        let utc = frame.info.mid_exposure;
        let size = utc.and_then(|utc| self.sun.at(utc));
        let prior = self.track.as_ref();
        let (mut solution, solve_time) = timed(|| {
            // Without a mapping of an earlier frame the calibration's is used, except for quantities that frames have contradicted.
            let corrected = match prior.is_some_and(|prior| prior.registration.is_some()) {
                true => None,
                false => self.state.calibration.lock().corrected(&self.instrument),
            };
            let instrument = corrected.as_ref().unwrap_or(&self.instrument);
            aspect::solve_with(&commanded.solver, frame, instrument, size, prior)
        });
        if solution.track.is_some() {
            self.track.clone_from(&solution.track);
        }
        // The file states the place on which its offset and its coordinates rest.
        frame.info.place = frame.info.place.or(commanded.place);
        let latest = self.nadir.copy();
        let nadir = latest.and_then(|latest| latest.at(&middle, commanded.roll.max_age()));
        let offset = pointing::offset_of(
            &mut solution,
            utc,
            frame.info.place,
            &commanded.target,
            nadir.as_ref(),
            &self.instrument,
            &mut self.ephemeris,
        );
        let roll = nadir.zip(latest).map(|(nadir, latest)| BodyRoll {
            deg: pointing::body_roll_deg(&nadir),
            arrived: latest.arrived,
        });
        Ok(Solved {
            quality: solution.quality,
            stopped: solution.stopped.as_ref().map(Stopped::named),
            levels: solution.levels,
            brightness: Brightness::of(solution.levels.as_ref(), frame.saturation_dn()),
            roll,
            solve_time,
            found: Found::Sun(Box::new(SolvedSun {
                solution,
                offset,
                instrument: Arc::clone(&self.instrument),
            })),
        })
    }

    /// Logs once the calibrated quantities that fine frames contradict.
    fn share(&mut self, _: &UnsolvedFrame, solved: &Solved) {
        let Found::Sun(sun) = &solved.found else {
            return;
        };
        let mut calibration = self.state.calibration.lock();
        let proven = calibration.note(&sun.solution, &self.instrument);
        let mut tally = self.state.tally.lock();
        tally.contradicted = calibration.proven().next().is_some();
        for contradiction in proven {
            let (camera, name) = (self.camera, &self.instrument.name);
            tracing::error!(camera, instrument = name, %contradiction, "fine frames contradict the calibration");
            tally
                .contradictions
                .insert(format!("{name}: {contradiction}"));
        }
    }

    fn log_entry(&self, solved: &Solved) -> Option<(Level, &'static str)> {
        let stage = solved.stopped?.stage;
        (stage == Stage::Pointing.name()).then_some((Level::WARN, "no offset"))
    }
}

/// The Sun's size changes by 0.1 % in a day: one evaluation of the ephemeris serves for a second and more.
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
