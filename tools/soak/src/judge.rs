//! Comparison of a fault's cost with its allowed cost.

use crate::faults::Fault;
use crate::machine::Sample;
use crate::rig::{Counts, Rig};
use solaspect::instrument::Role;
use solaspect::service::FlightTally;
use std::time::{Duration, Instant};

/// Time limit for full recovery.
pub const BACK_WITHIN: Duration = Duration::from_secs(5);
/// Minimum share of the frames due in the last second before the next fault that must be solved and sent.
const STEADY: f64 = 0.8;
/// More waiting pictures than this show that the disks have not caught up.
const FEW: usize = 4;

/// Number of solutions that may be in transit when the counts are taken; the sums at the end of the run are exact.
pub const UNDER_WAY: u64 = 1;

/// A fault, with the counts around it.
pub struct Trial {
    pub fault: Fault,
    pub name: String,
    pub before: Counts,
    /// Counts at the end of the fault.
    pub end: Counts,
    /// Time from then to full recovery; `None` if there was none.
    pub back: Option<Duration>,
    /// Counts one second before the end of the recovery time.
    pub last_second: Counts,
    /// Counts at the end of the recovery time.
    pub after: Counts,
    /// Memory in the last second.
    pub memory: Option<Sample>,
}

/// A quantity that must grow continuously: its name and present value.
type Flow = (String, u64);

impl Counts {
    fn flows(&self, fault: Fault) -> Vec<Flow> {
        let mut flows = vec![
            ("frames".into(), self.frames.given),
            ("solutions".into(), self.tally.solved()),
            ("solutions received".into(), self.heard.solutions),
            ("housekeeping received".into(), self.heard.housekeeping),
        ];
        if self.heard.offsets.received > 0 {
            flows.push(("offsets by the gyros".into(), self.heard.offsets.received));
        }
        for (n, stored) in (1..).zip(&self.stored_on) {
            flows.push((format!("frames on disk {n}"), *stored));
        }
        for (n, logs) in (1..).zip(&self.logs) {
            flows.push((format!("solution log {n}"), logs.solutions));
            flows.push((format!("telemetry {n}"), logs.telemetry));
            flows.push((format!("housekeeping log {n}"), logs.housekeeping));
        }
        if fault == Fault::ValuesGone {
            let saved = self
                .values_saved
                .and_then(|t| t.duration_since(std::time::UNIX_EPOCH).ok());
            flows.push((
                "saved values".into(),
                saved.map_or(0, |t| t.as_millis() as u64),
            ));
        }
        flows
    }

    /// The quantities that have not grown since.
    fn still(&self, since: &Self, fault: Fault) -> Vec<String> {
        let both = self.flows(fault).into_iter().zip(since.flows(fault));
        both.filter(|((_, now), (_, then))| now <= then)
            .map(|((name, _), _)| name)
            .collect()
    }

    /// Whether all quantities have grown since the end of a fault, and the backlog is done.
    pub fn is_back(&self, end: &Self, fault: Fault) -> bool {
        self.waiting <= FEW && self.still(end, fault).is_empty()
    }
}

impl Trial {
    /// Injects a fault, and waits for full recovery or until `rest` has passed.
    pub fn run(rig: &Rig, fault: Fault, rest: Duration) -> anyhow::Result<Self> {
        let before = rig.counts_between_packets();
        let begin = Instant::now();
        fault.begin(rig)?;
        rig.wait_until(begin + fault.length())?;
        fault.end(rig)?;
        let end = rig.counts();
        let over = begin + fault.length() + rest;
        let mut back = None;
        while back.is_none() && Instant::now() < over && !rig.service.is_finished() {
            rig.check(false)?;
            let now = rig.counts();
            back = now.is_back(&end, fault).then(|| now.time - end.time);
        }
        rig.wait_until(over - Duration::from_secs(1))?;
        let last_second = rig.counts();
        rig.wait_until(over)?;
        rig.memory.borrow_mut().note(true)?;
        Ok(Self {
            fault,
            name: rig.name_of(fault),
            before,
            end,
            back,
            last_second,
            after: rig.counts_between_packets(),
            memory: rig.memory.borrow().samples().last().copied(),
        })
    }

    /// The length of the fault.
    pub fn length(&self) -> Duration {
        self.end.time - self.before.time
    }

    /// A count's growth over fault and recovery.
    pub fn growth(&self, of: impl Fn(&Counts) -> u64) -> u64 {
        of(&self.after).saturating_sub(of(&self.before))
    }

    /// Number of solutions that were sent and never arrived.
    pub fn solutions_lost(&self) -> i64 {
        self.after.missing() as i64 - self.before.missing() as i64
    }

    /// All errors; empty if the fault has cost no more than allowed.
    pub fn complaints(&self, rate_hz: f64) -> Vec<String> {
        let mut wrong = self.slow_recovery(rate_hz);
        wrong.extend(self.frames_lost(rate_hz));
        wrong.extend(self.packets_lost(rate_hz));
        wrong
    }

    fn slow_recovery(&self, rate_hz: f64) -> Vec<String> {
        let mut wrong = Vec::new();
        match self.back {
            None => {
                let still = self.after.still(&self.end, self.fault);
                let waiting = self.after.waiting;
                wrong.push(format!("not back: {} ({waiting} wait)", still.join(", ")));
            }
            Some(back) if back > BACK_WITHIN => wrong.push("back too late".into()),
            Some(_) => {}
        }
        let seconds = (self.after.time - self.last_second.time).as_secs_f64();
        let least = (STEADY * seconds * rate_hz) as u64;
        let solved = |c: &Counts| c.tally.solved();
        let received = |c: &Counts| c.heard.solutions;
        for (name, of) in [
            ("solved", solved as fn(&Counts) -> u64),
            ("received", received),
        ] {
            let grown = of(&self.after).saturating_sub(of(&self.last_second));
            if grown < least {
                wrong.push(format!("at the end only {grown} {name} in {seconds:.1} s"));
            }
        }
        wrong
    }

    fn frames_lost(&self, rate_hz: f64) -> Vec<String> {
        let cost = self.fault.cost(rate_hz);
        let mut wrong = Vec::new();
        let not_taken = self.growth(|c| c.frames.not_taken);
        let [least, most] = cost.not_taken;
        if !(least..=most).contains(&not_taken) {
            wrong.push(format!("{not_taken} not taken, expected {least} to {most}"));
        }
        let most = if self.fault == Fault::Stopped {
            most
        } else {
            0
        };
        let of_horizon = self.growth(|c| c.roll_frames.not_taken);
        if of_horizon > most {
            wrong.push(format!("{of_horizon} of the horizon not taken"));
        }
        let of = |count: fn(&FlightTally) -> u64| self.growth(|c| count(&c.tally));
        let exact = [
            ("failed", of(|t| t.camera.failed), cost.failed),
            (
                "of another size",
                of(|t| t.solver(Role::PitchYaw).misfits),
                cost.misfits,
            ),
            ("not solved", of(|t| t.camera.lost), 0),
            ("not stored", of(|t| t.counts.unstored), 0),
            ("rows lost", of(|t| t.archive.rows_lost), 0),
            ("threads restarted", of(|t| t.restarts), cost.restarts),
        ];
        wrong.extend(differences(&exact));
        wrong
    }

    fn packets_lost(&self, rate_hz: f64) -> Vec<String> {
        let cost = self.fault.cost(rate_hz);
        let of = |count: fn(&FlightTally) -> u64| self.growth(|c| count(&c.tally));
        let mut exact = vec![("times reopened", of(|t| t.line.reopened), cost.reopened)];
        let commands = self.growth(|c| c.heard.commands);
        let checksums = self.growth(|c| c.heard.wrong_checksums);
        match self.fault {
            Fault::LineCommands | Fault::GpsJumps => {
                exact.push(("commands answered", of(|t| t.line.commands), commands));
            }
            Fault::LineChecksums => {
                exact.push((
                    "packets rejected",
                    of(|t| t.line.rejected.packets),
                    checksums,
                ));
            }
            _ => {}
        }
        let lost = self.solutions_lost().max(0) as u64;
        let garbled = self.growth(|c| c.garbled_solutions);
        if self.fault == Fault::LineGarbled {
            let under_way = lost.abs_diff(garbled) <= UNDER_WAY;
            exact.push((
                "solutions lost",
                if under_way { garbled } else { lost },
                garbled,
            ));
        }
        if !cost.packets {
            exact.push(("solutions lost", lost.saturating_sub(UNDER_WAY), 0));
            exact.push(("packets not sent", of(|t| t.line.failed), 0));
            exact.push((
                "solutions unsent",
                of(|t| t.solver(Role::PitchYaw).unsent),
                0,
            ));
            exact.push(("exposures unannounced", of(|t| t.camera.unannounced), 0));
            exact.push(("faults heard", self.growth(|c| c.heard.faults.total()), 0));
        }
        let offsets = self.growth(|c| c.heard.offsets.wrong);
        exact.push(("offsets beyond 6 sigma", offsets, 0));
        let mut wrong = differences(&exact);
        // A stopped process reports nothing for that time.
        let stopped = match self.fault {
            Fault::Stopped => self.fault.length(),
            _ => Duration::ZERO,
        };
        let at_work = (self.after.time - self.before.time).saturating_sub(stopped);
        let sent = self.growth(|c| c.heard.housekeeping);
        if sent as f64 > at_work.as_secs_f64() + 2.0 {
            let seconds = at_work.as_secs_f64();
            wrong.push(format!(
                "{sent} housekeeping packets in {seconds:.1} s of work"
            ));
        }
        wrong
    }
}

fn differences(exact: &[(&str, u64, u64)]) -> Vec<String> {
    let differ = exact
        .iter()
        .filter(|(_, found, expected)| found != expected);
    differ
        .map(|(what, found, expected)| format!("{found} {what}, expected {expected}"))
        .collect()
}
