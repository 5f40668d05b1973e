//! What turns a camera's frames into what they show: a solver for each thing that a camera may see, all behind one trait.

mod horizon;
mod moon;
mod nadir;
mod sun;

use super::flight::stations;
use super::messages::{Found, LatestNadir, Middle, MoonDesk, Solved, Station, UnsolvedFrame};
use super::shared::Shared;
use super::tally::SolverTally;
use crate::aspect::Quality;
use crate::calibrate::check::CalibrationCheck;
use crate::camera::{Brightness, Camera, Exposure};
use crate::commands::controls::Snapshot;
use crate::frame::FrameInfo;
use crate::instrument::{Role, Sees, WrongSize};
use crate::limb;
use crate::reasons::{Stopped, at};
use crate::sky::Ephemeris;
use std::time::{Duration, Instant};

/// Finds in the frames of a camera what it sees.
pub trait Solver: Send {
    /// What a frame shows. The frame is told the place that the answer rests on.
    ///
    /// # Errors
    /// A frame of another camera: nothing can be said of it.
    fn solve(
        &mut self,
        frame: &mut UnsolvedFrame,
        commanded: &Snapshot,
    ) -> Result<Solved, WrongSize>;

    /// Leaves what a frame has shown where others look for it.
    fn leave(&mut self, _frame: &UnsolvedFrame, _solved: &Solved, _tally: &mut SolverTally) {}

    /// What is logged of a frame that stopped at a stage, now and then; `None` where that is nothing unusual.
    fn complaint(&self, _stage: &str) -> Option<&'static str> {
        None
    }
}

/// What solvers share, and leave for the line. Clones share it.
#[derive(Clone, Default)]
pub(super) struct Shelf {
    pub nadir: LatestNadir,
    pub moon: Shared<MoonDesk>,
    /// It outlives a thread that fails, as the counts do.
    pub calibration: Shared<CalibrationCheck>,
}

impl Shelf {
    /// What a camera's solver takes of it. Only the first roll camera tells the roll, and only the first Moon camera answers requests.
    pub fn of(&self, station: &Station) -> Self {
        match station.ordinal {
            1 => Self {
                calibration: Shared::default(),
                ..self.clone()
            },
            _ => Self {
                nadir: match station.camera.role {
                    Role::PitchYaw => self.nadir.clone(),
                    _ => LatestNadir::default(),
                },
                ..Self::default()
            },
        }
    }
}

/// The solver of the frames of a camera that is tried alone.
pub fn solver(camera: &Camera, ephemeris: Ephemeris) -> Box<dyn Solver> {
    let [station] = &stations(&[camera], "")[..] else {
        return Box::new(Levels);
    };
    solver_with(station, ephemeris, Shelf::default())
}

pub(super) fn solver_with(
    station: &Station,
    ephemeris: Ephemeris,
    shelf: Shelf,
) -> Box<dyn Solver> {
    match station.camera.sees.clone() {
        Sees::Plate(instrument) => {
            Box::new(sun::SunSolver::new(station, *instrument, ephemeris, shelf))
        }
        Sees::Horizon(camera) => Box::new(horizon::HorizonSolver::new(camera, shelf.nadir)),
        Sees::Moon(camera) => Box::new(moon::MoonSolver::new(camera, ephemeris, shelf.moon)),
        Sees::Unstated => Box::new(Levels),
    }
}

/// For a camera of which nothing is stated: only the frame's light is measured.
struct Levels;

impl Solver for Levels {
    fn solve(
        &mut self,
        frame: &mut UnsolvedFrame,
        commanded: &Snapshot,
    ) -> Result<Solved, WrongSize> {
        let start = Instant::now();
        let frame = &frame.exposure.frame;
        let levels = limb::levels(frame, &commanded.solver.limb);
        let levels = levels.map_err(|rejected| at(crate::aspect::Stage::Levels)(rejected));
        Ok(Solved {
            found: Found::Nothing,
            quality: Quality::None,
            stopped: levels.as_ref().err().map(Stopped::named),
            brightness: Brightness::of(levels.as_ref().ok(), frame.saturation_dn()),
            levels: levels.ok(),
            roll: None,
            solve_time: start.elapsed(),
        })
    }
}

impl UnsolvedFrame {
    /// A frame that has just come.
    pub fn arrived(exposure: Exposure) -> Self {
        let arrived = Instant::now();
        Self {
            middle: Middle::of(&exposure.frame.info, arrived),
            exposure,
            arrived,
        }
    }

    /// When the exposure began.
    fn began(&self) -> Instant {
        let exposure = self.exposure.frame.info.exposure.unwrap_or_default();
        self.arrived.checked_sub(exposure).unwrap_or(self.arrived)
    }
}

impl Middle {
    /// No frame is delayed by more: the clock has made a step.
    const LONGEST_DELAY_S: f64 = 2.0;

    fn of(info: &FrameInfo, arrived: Instant) -> Self {
        let half = info.exposure.unwrap_or_default() / 2;
        Self {
            utc: info.mid_exposure,
            by_arrival: arrived.checked_sub(half).unwrap_or(arrived),
        }
    }

    /// How long after this one another was, s; negative before.
    fn until(&self, other: &Self) -> f64 {
        let (from, to) = (self.by_arrival, other.by_arrival);
        let by_arrival = match to.checked_duration_since(from) {
            Some(after) => after.as_secs_f64(),
            None => -from.saturating_duration_since(to).as_secs_f64(),
        };
        let by_utc = self.utc.zip(other.utc);
        let by_utc = by_utc.map(|(from, to)| to.duration_since(from).as_secs_f64());
        let agrees = |by_utc: &f64| (by_utc - by_arrival).abs() < Self::LONGEST_DELAY_S;
        by_utc.filter(agrees).unwrap_or(by_arrival)
    }
}

/// The time that some work takes, and what it gives.
fn timed<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let start = Instant::now();
    let given = work();
    (given, start.elapsed())
}
