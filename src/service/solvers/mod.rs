//! Solvers: one for each kind of object that a camera sees, all behind one trait.

mod horizon;
mod moon;
mod nadir;
mod sun;

use super::messages::{Found, LatestNadir, MoonState, Solved, Station, UnsolvedFrame};
use super::shared::Shared;
use super::tally::SolverTally;
use crate::aspect::{Quality, Stage};
use crate::calibrate::check::CalibrationCheck;
use crate::camera::{Brightness, Camera};
use crate::commands::controls::Snapshot;
use crate::instrument::{Role, Sees, WrongSize};
use crate::limb;
use crate::reasons::{Stopped, at};
use crate::sky::Ephemeris;
use std::time::{Duration, Instant};
use tracing::Level;

/// Solves the frames of a camera.
pub trait Solver: Send {
    /// Solves a frame. The frame gets the place on which the answer rests.
    ///
    /// # Errors
    /// If the frame is of another camera: it cannot be solved.
    fn solve(
        &mut self,
        frame: &mut UnsolvedFrame,
        commanded: &Snapshot,
    ) -> Result<Solved, WrongSize>;

    /// Stores the result of a frame where other solvers read it.
    fn share(&mut self, _frame: &UnsolvedFrame, _solved: &Solved) {}

    /// Log entry, now and then, for a frame whose processing stopped; `None` if that is nothing unusual.
    fn log_entry(&self, _solved: &Solved) -> Option<(Level, &'static str)> {
        None
    }
}

/// Results that solvers share with each other and with the line. Clones share it.
#[derive(Clone, Default)]
pub(super) struct Results {
    pub nadir: LatestNadir,
    pub moon: Shared<MoonState>,
}

impl Results {
    /// The part of it that a camera's solver uses. Only the first roll camera gives the roll, and only the first Moon camera answers requests.
    fn of(&self, station: &Station) -> Self {
        match station.camera.role {
            Role::PitchYaw => self.clone(),
            _ if station.ordinal == 1 => self.clone(),
            _ => Self::default(),
        }
    }
}

/// State of a camera's solver from one restart to the next. Clones share it.
#[derive(Clone, Default)]
pub(super) struct State {
    pub calibration: Shared<CalibrationCheck>,
    pub tally: Shared<SolverTally>,
}

/// Makes the solver of a camera's frames, at each start of its thread.
#[derive(Clone)]
pub(super) struct SolverFactory {
    pub station: Station,
    pub ephemeris: Ephemeris,
    pub results: Results,
    pub state: State,
}

impl SolverFactory {
    pub fn new(station: &Station, ephemeris: Ephemeris, results: &Results, state: State) -> Self {
        Self {
            results: results.of(station),
            station: station.clone(),
            ephemeris,
            state,
        }
    }

    pub fn make(&self) -> Box<dyn Solver> {
        let Self {
            ephemeris, results, ..
        } = self.clone();
        match self.station.camera.sees.clone() {
            Sees::Plate(instrument) => Box::new(sun::SunSolver::new(self, *instrument)),
            Sees::Horizon(camera) => Box::new(horizon::HorizonSolver::new(camera, results.nadir)),
            Sees::Moon(camera) => Box::new(moon::MoonSolver::new(camera, ephemeris, results.moon)),
            Sees::Unstated => Box::new(Levels),
        }
    }
}

/// The solver of the frames of a camera that is used alone.
pub fn solver(camera: &Camera, ephemeris: Ephemeris) -> Box<dyn Solver> {
    let station = Station::single(camera);
    SolverFactory::new(&station, ephemeris, &Results::default(), State::default()).make()
}

/// For a camera without a calibration: only the frame's brightness is measured.
struct Levels;

impl Solver for Levels {
    fn solve(
        &mut self,
        frame: &mut UnsolvedFrame,
        commanded: &Snapshot,
    ) -> Result<Solved, WrongSize> {
        let frame = &mut frame.exposure.frame;
        frame.info.place = frame.info.place.or(commanded.place);
        let (levels, solve_time) = timed(|| limb::levels(frame, &commanded.solver.limb));
        let levels = levels.map_err(at(Stage::Levels));
        Ok(Solved {
            found: Found::Nothing,
            quality: Quality::None,
            stopped: levels.as_ref().err().map(Stopped::named),
            brightness: Brightness::of(levels.as_ref().ok(), frame.saturation_dn()),
            levels: levels.ok(),
            roll: None,
            solve_time,
        })
    }
}

/// The result of some work, and the time that it took.
fn timed<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let start = Instant::now();
    let given = work();
    (given, start.elapsed())
}
