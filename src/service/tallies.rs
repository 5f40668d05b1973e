//! The tallies of all threads, accessible to every thread.

use super::archiver::Gauges;
use super::messages::{Recent, Station, UnsolvedFrame};
use super::outputs;
use super::shared::Shared;
use super::silence::Silence;
use super::tally::{
    CameraSolved, CameraTally, FlightTally, LineTally, NavigationTally, SolverTally,
};
use crate::link::Counters;
use crossbeam_channel::Receiver;
use std::sync::Arc;
use std::time::Instant;

/// The tallies of all threads, and the counters that they share.
#[derive(Clone, Default)]
pub(super) struct Tallies {
    pub counters: Arc<Counters>,
    pub cameras: Vec<CameraTallies>,
    pub archive: Gauges,
    pub line: Shared<LineTally>,
    pub navigation: Shared<NavigationTally>,
    pub outputs: outputs::Gauges,
}

/// Tallies of a camera's threads.
#[derive(Clone)]
pub(super) struct CameraTallies {
    pub station: Arc<Station>,
    pub camera: Shared<CameraTally>,
    pub silence: Shared<Silence>,
    pub solver: Shared<SolverTally>,
    /// Frames that wait for its solver; only their number is used here.
    pub unsolved: Receiver<UnsolvedFrame>,
    pub recent: Shared<Recent>,
}

impl Tallies {
    /// All counts so far.
    pub fn tally(&self) -> FlightTally {
        FlightTally {
            line: self.line.copy(),
            ..self.brief()
        }
    }

    /// The same, with only the latest latencies.
    pub fn brief(&self) -> FlightTally {
        let (counts, line) = {
            // Under one lock: latencies are those of the solutions counted. The line waits meanwhile, and only for this.
            let line = self.line.lock();
            (self.counters.now(), line.brief())
        };
        let mut tally = FlightTally {
            counts,
            archive: self.archive.tally(),
            line,
            navigation: self.navigation.copy(),
            outputs: self.outputs.tally(),
            log_lines_lost: crate::log::lost_lines(),
            ..FlightTally::default()
        };
        for own in &self.cameras {
            tally.camera.add(&own.camera.lock());
            let (silences, silent) = own.silence.lock().total(Instant::now());
            tally.camera.silences += silences;
            tally.camera.silent += silent;
            tally.solvers.push(CameraSolved {
                role: own.station.camera.role,
                solver: own.solver.copy(),
            });
        }
        tally
    }
}
