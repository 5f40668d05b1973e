//! The tallies of all threads, where every thread may see them.

use super::archiver::Gauges;
use super::flight::UnsolvedFrame;
use super::navigation::NavigationTally;
use super::shared::Shared;
use super::silence::Silence;
use super::tally::{CameraTally, FlightTally, LineTally, MoonTally, RollTally, SolverTally};
use crate::link::Counters;
use crossbeam_channel::Receiver;
use std::sync::Arc;
use std::time::Instant;

/// The tallies of all threads, and the counters that they share.
#[derive(Clone, Default)]
pub(super) struct Tallies {
    pub counters: Arc<Counters>,
    pub cameras: Vec<Shared<CameraTally>>,
    pub silences: Vec<Shared<Silence>>,
    pub solvers: Vec<Shared<SolverTally>>,
    /// Frames that wait for each solver: only their number is of interest here.
    pub unsolved: Vec<Receiver<UnsolvedFrame>>,
    pub archive: Gauges,
    pub line: Shared<LineTally>,
    pub roll: Shared<RollTally>,
    pub moon: Shared<MoonTally>,
    pub navigation: Shared<NavigationTally>,
}

impl Tallies {
    /// All that has happened.
    pub fn tally(&self) -> FlightTally {
        FlightTally {
            line: self.line.copy(),
            ..self.brief()
        }
    }

    /// The same, with the latencies of the last moment alone.
    pub fn brief(&self) -> FlightTally {
        let (counts, line) = {
            // Together: latencies are those of the solutions counted. The line waits meanwhile, and for no more than that.
            let line = self.line.lock();
            (self.counters.now(), line.brief())
        };
        let mut tally = FlightTally {
            counts,
            archive: self.archive.tally(),
            line,
            roll: self.roll.copy(),
            moon: self.moon.copy(),
            navigation: self.navigation.copy(),
            log_lines_lost: crate::log::lost_lines(),
            ..FlightTally::default()
        };
        for camera in &self.cameras {
            tally.camera.add(&camera.lock());
        }
        for silence in &self.silences {
            let (silences, silent) = silence.lock().total(Instant::now());
            tally.camera.silences += silences;
            tally.camera.silent += silent;
        }
        for solver in &self.solvers {
            tally.solver.add(&solver.lock());
        }
        tally
    }
}
