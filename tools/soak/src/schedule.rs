//! Times at which the faults are injected.

use crate::faults::Fault;
use std::time::Duration;

/// Time before the first fault.
const LEAD: Duration = Duration::from_secs(5);
/// Time after the last fault's recovery.
const TAIL: Duration = Duration::from_secs(2);
/// Time after each fault: for recovery, plus a second of normal operation.
pub const REST: Duration = Duration::from_millis(6300);
/// Additional time for taking the counts.
const COUNTS: Duration = Duration::from_millis(300);

/// Faults in order, each at a fixed phase of a cycle that repeats for the duration of the run.
pub struct Schedule {
    faults: Vec<Fault>,
    duration: Duration,
}

impl Schedule {
    /// # Errors
    /// If the run is too short for all of them.
    pub fn new(faults: Vec<Fault>, duration: Duration) -> anyhow::Result<Self> {
        let schedule = Self { faults, duration };
        let needed = (LEAD + schedule.cycle() + TAIL).as_secs() + 1;
        anyhow::ensure!(
            schedule.faults.is_empty() || duration.as_secs() >= needed,
            "--seconds: expected {needed} or more for these faults, found {}",
            duration.as_secs()
        );
        Ok(schedule)
    }

    fn cycle(&self) -> Duration {
        self.faults
            .iter()
            .map(|fault| fault.length() + REST + COUNTS)
            .sum()
    }

    /// The faults with the time of each from the start of the run, as many as fit.
    pub fn times(&self) -> impl Iterator<Item = (Duration, Fault)> {
        let mut at = LEAD;
        let timed = self.faults.iter().cycle().map(move |fault| {
            let begin = at;
            at += fault.length() + REST + COUNTS;
            (begin, *fault)
        });
        timed.take_while(|(begin, fault)| {
            *begin + fault.length() + REST + COUNTS + TAIL <= self.duration
        })
    }
}
