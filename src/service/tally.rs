//! What each thread counts, and what a flight comes to.

use super::navigation::NavigationTally;
use crate::aspect::Stage;
use crate::camera::CameraHealth;
use crate::horizon;
use crate::link::{Counts, LinkState, Rejected};
use crate::moon;
use crate::units::Reason;
use crate::units::counted;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt;
use std::time::Duration;

/// What a camera's thread counts.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CameraTally {
    /// Frames that the solver had no room for.
    pub lost: u64,
    /// Frames that the source could not give.
    pub failed: u64,
    /// Exposures that the line's queue had no room for.
    pub unannounced: u64,
    /// Times that the camera gave no frames though it should have.
    pub silences: u64,
    /// The time without frames in these, from the last frame on.
    pub silent: Duration,
    /// Times that UTC made a step.
    pub utc_steps: u64,
    /// Of the camera itself.
    pub health: CameraHealth,
}

impl CameraTally {
    pub(super) fn add(&mut self, other: &Self) {
        self.lost += other.lost;
        self.failed += other.failed;
        self.unannounced += other.unannounced;
        self.silences += other.silences;
        self.silent += other.silent;
        self.utc_steps += other.utc_steps;
        let (own, other) = (&mut self.health, &other.health);
        own.incomplete += other.incomplete;
        own.missing += other.missing;
        own.lost_packets += other.lost_packets;
        own.underruns += other.underruns;
        own.refused_settings += other.refused_settings;
        own.reconnects += other.reconnects;
        own.temperature_c = own.temperature_c.or(other.temperature_c);
    }

    fn tell(&self, counts: &Counts, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "frames     {} taken, {} lost, {} failed",
            counts.taken, self.lost, self.failed
        )?;
        if self.silences > 0 {
            let times = if self.silences == 1 { "time" } else { "times" };
            writeln!(
                out,
                "camera     silent {} {times}, {:.1} s without frames",
                self.silences,
                self.silent.as_secs_f64(),
            )?;
        }
        let health = &self.health;
        if *health != CameraHealth::default() {
            writeln!(
                out,
                "camera     {} incomplete, {} missing, {} packets lost, {} settings refused, {} reconnects",
                health.incomplete,
                health.missing,
                health.lost_packets,
                health.refused_settings,
                health.reconnects,
            )?;
        }
        Ok(())
    }
}

/// What the solver's thread counts.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SolverTally {
    /// Why frames went no further, coarse ones too.
    pub reasons: BTreeMap<(Stage, Reason), u64>,
    /// Frames of the wrong size.
    pub misfits: u64,
    /// Answers that the line's queue had no room for.
    pub unsent: u64,
    /// What fine frames have disproved of the instruments, with stated and measured values.
    pub contradictions: BTreeSet<String>,
    /// Whether anything stated is disproved now.
    pub contradicted: bool,
}

impl SolverTally {
    pub(super) fn add(&mut self, other: &Self) {
        for (reason, count) in &other.reasons {
            *self.reasons.entry(*reason).or_default() += count;
        }
        self.misfits += other.misfits;
        self.unsent += other.unsent;
        self.contradictions
            .extend(other.contradictions.iter().cloned());
        self.contradicted |= other.contradicted;
    }

    fn tell(&self, counts: &Counts, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Counts {
            fine, coarse, none, ..
        } = counts;
        writeln!(out, "solved     {fine} fine, {coarse} coarse, {none} none")?;
        for ((stage, reason), count) in &self.reasons {
            writeln!(out, "           {count} x {}: {reason}", stage.name())?;
        }
        for contradiction in &self.contradictions {
            writeln!(out, "contradicted by fine frames: {contradiction}")?;
        }
        Ok(())
    }
}

/// What the roll camera's solver counts.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RollTally {
    /// Why frames show no horizon.
    pub reasons: BTreeMap<(horizon::Stage, Reason), u64>,
}

impl RollTally {
    /// Frames that show no horizon for a reason.
    pub fn because(&self, reason: Reason) -> u64 {
        let same = self.reasons.iter().filter(|((_, why), _)| *why == reason);
        same.map(|(_, count)| count).sum()
    }

    fn tell(&self, counts: &Counts, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [fine, coarse, none] = [counts.roll_fine, counts.roll_coarse, counts.roll_none];
        if fine + coarse + none == 0 {
            return Ok(());
        }
        writeln!(out, "horizon    {fine} fine, {coarse} coarse, {none} none")?;
        for ((stage, reason), count) in &self.reasons {
            writeln!(out, "           {count} x {}: {reason}", stage.name())?;
        }
        Ok(())
    }
}

/// What the Moon camera's solver counts.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct MoonTally {
    pub solved: BTreeMap<moon::Quality, u64>,
    /// Why frames show no Moon.
    pub reasons: BTreeMap<(moon::Stage, Reason), u64>,
}

impl MoonTally {
    pub fn of(&self, quality: moon::Quality) -> u64 {
        self.solved.get(&quality).copied().unwrap_or(0)
    }

    /// Frames that were taken while the Moon could not be seen.
    pub fn hidden(&self) -> u64 {
        self.without(|stage| stage == moon::Stage::Sky)
    }

    /// Frames that should show the Moon and do not.
    pub fn none(&self) -> u64 {
        self.without(|stage| stage != moon::Stage::Sky)
    }

    fn without(&self, counts: impl Fn(moon::Stage) -> bool) -> u64 {
        let reasons = self.reasons.iter().filter(|((stage, _), _)| counts(*stage));
        reasons.map(|(_, count)| count).sum()
    }

    fn tell(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        use moon::Quality;
        if *self == Self::default() {
            return Ok(());
        }
        let [fine, coarse] = [Quality::Fine, Quality::Coarse].map(|quality| self.of(quality));
        let (none, hidden) = (self.none(), self.hidden());
        writeln!(
            out,
            "Moon       {fine} fine, {coarse} coarse, {none} none, {hidden} while it could not be seen"
        )?;
        for ((stage, reason), count) in &self.reasons {
            writeln!(out, "           {count} x {}: {reason}", stage.name())?;
        }
        Ok(())
    }
}

/// What the archive's threads count.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ArchiveTally {
    /// Pictures given up because the disks could not follow.
    pub overflowed: u64,
    /// Pictures given up because the disks are nearly full.
    pub no_room: u64,
    /// Pictures that could not be stored for another reason.
    pub failed: u64,
    /// Frames that were still on their way to a disk when the flight ended; only in the last tally.
    pub unfinished: u64,
    /// Refusals by any disk; the frame may be stored all the same.
    pub refused: u64,
    /// Refusals of rows by any disk, and rows that a log had no room for; the row may be in a log all the same.
    pub rows_refused: u64,
    /// Frames' rows that are in no log.
    pub rows_lost: u64,
    /// Half-written files of an earlier run that were removed.
    pub swept: u64,
}

impl ArchiveTally {
    fn tell(&self, counts: &Counts, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "stored     {}, {} not: {} overflowed, {} no room, {} failed, {} unfinished; {} refusals, {} rows refused, {} rows lost, {} half-written removed",
            counts.stored,
            counts.unstored,
            self.overflowed,
            self.no_room,
            self.failed,
            self.unfinished,
            self.refused,
            self.rows_refused,
            self.rows_lost,
            self.swept,
        )
    }
}

/// What the link's thread counts.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LineTally {
    /// Packets that the port did not take.
    pub failed: u64,
    /// Exposures that were not announced because the line could not follow.
    pub unannounced: u64,
    /// Housekeeping packets and whole pictures that went to the ground.
    pub housekeeping: u64,
    pub pictures: u64,
    /// How often the port was lost, and opened again.
    pub lost: u64,
    pub reopened: u64,
    /// Whether there is a port that could never be opened.
    pub never_open: bool,
    /// What came over the line and was no packet.
    pub rejected: Rejected,
    pub commands: u64,
    pub moon_requests: u64,
    /// What the controller and the ground have set.
    pub conversation: LinkState,
    /// From a frame's arrival to its solution's last byte: the latest ten thousand.
    pub latencies: VecDeque<Duration>,
    /// From the arrival of a sample of the IMU to the last byte of the offset that rests on it: as many.
    pub propagated_latencies: VecDeque<Duration>,
    /// From the arrival of a frame of the horizon to the last byte of the first solution that has its roll: as many.
    pub roll_latencies: VecDeque<Duration>,
}

/// Keeps the latest of them.
pub(super) fn note_latency(latencies: &mut VecDeque<Duration>, latency: Duration) {
    const KEPT: usize = 10_000;
    if latencies.len() == KEPT {
        latencies.pop_front();
    }
    latencies.push_back(latency);
}

impl LineTally {
    /// The counts, with the latencies of the last moment alone: the line waits while they are copied.
    pub(super) fn brief(&self) -> Self {
        const MOMENT: usize = 64;
        let latest = |all: &VecDeque<Duration>| {
            let from = all.len().saturating_sub(MOMENT);
            all.range(from..).copied().collect()
        };
        Self {
            rejected: self.rejected,
            latencies: latest(&self.latencies),
            propagated_latencies: latest(&self.propagated_latencies),
            roll_latencies: latest(&self.roll_latencies),
            ..*self
        }
    }

    fn tell(&self, counts: &Counts, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            out,
            "sent       {} solutions, {} errors, {} exposures announced, {} commands answered, {} outdated",
            counts.solutions, counts.errors, counts.announced, self.commands, counts.outdated,
        )?;
        if self.never_open {
            write!(out, "\nline       never open: nothing was sent")?;
        }
        if (self.lost, self.unannounced) != (0, 0) {
            write!(
                out,
                "\nline       lost {} times, opened again {} times, {} exposures not announced",
                self.lost, self.reopened, self.unannounced,
            )?;
        }
        if counts.datagrams_refused > 0 {
            let refused = counted(counts.datagrams_refused, "datagram");
            write!(out, "\nrefused    {refused}")?;
        }
        if counts.propagated > 0 {
            let offsets = counted(counts.propagated, "offset");
            write!(out, "\nsent       {offsets} by the gyros")?;
        }
        let all = [
            ("frame", &self.latencies),
            ("horizon", &self.roll_latencies),
            ("sample", &self.propagated_latencies),
        ];
        for (name, latencies) in all {
            let milliseconds = |latency: &Duration| 1e3 * latency.as_secs_f64();
            let mut latencies: Vec<f64> = latencies.iter().map(milliseconds).collect();
            let mut ms = |fraction| quantile(&mut latencies, fraction);
            if let [Some(median), Some(most), Some(nearly_all)] = [0.5, 0.99, 0.999].map(&mut ms) {
                write!(
                    out,
                    "\nlatency    {name} to packet: median {median:.2}, 99 % {most:.2}, 99.9 % {nearly_all:.2} ms"
                )?;
            }
        }
        Ok(())
    }
}

/// What a whole flight comes to.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FlightTally {
    pub counts: Counts,
    /// Of all cameras.
    pub camera: CameraTally,
    pub solver: SolverTally,
    pub roll: RollTally,
    pub moon: MoonTally,
    pub navigation: NavigationTally,
    pub archive: ArchiveTally,
    pub line: LineTally,
    /// Threads that panicked or hung, and were started again.
    pub restarts: u64,
    /// Of them, threads that hung.
    pub takeovers: u64,
    /// Whether the flight ended because its threads hung again and again.
    pub gave_up: bool,
    /// Log lines that standard error did not take.
    pub log_lines_lost: u64,
}

impl FlightTally {
    /// Frames of pitch-yaw cameras that were solved, whatever they show.
    pub fn solved(&self) -> u64 {
        self.counts.fine + self.counts.coarse + self.counts.none
    }

    /// Frames of the horizon that were solved, whatever they show.
    pub fn rolls_solved(&self) -> u64 {
        self.counts.roll_fine + self.counts.roll_coarse + self.counts.roll_none
    }

    /// Frames, stored files, rows and packets that did not get where they should, and silences of cameras. A row that one disk
    /// refused and another has is not lost.
    pub fn lost(&self) -> u64 {
        let camera = self.camera.lost + self.camera.failed + self.camera.silences;
        let frames = camera + self.solver.misfits;
        let files = self.counts.unstored + self.archive.rows_lost;
        let packets = self.camera.unannounced + self.solver.unsent + self.line.failed;
        let line = u64::from(self.line.never_open);
        frames + files + packets + line + self.restarts
    }
}

impl fmt::Display for FlightTally {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.camera.tell(&self.counts, out)?;
        if self.restarts > 0 {
            writeln!(
                out,
                "threads    {} started again, {} of them because they hung",
                self.restarts, self.takeovers
            )?;
        }
        if self.log_lines_lost > 0 {
            writeln!(out, "log        {} lines lost", self.log_lines_lost)?;
        }
        self.solver.tell(&self.counts, out)?;
        self.roll.tell(&self.counts, out)?;
        self.moon.tell(out)?;
        self.navigation.tell(&self.counts, out)?;
        self.archive.tell(&self.counts, out)?;
        self.line.tell(&self.counts, out)
    }
}

/// The value below which a fraction of the values lies; `None` of no values.
pub fn quantile<T: Copy + PartialOrd>(values: &mut [T], fraction: f64) -> Option<T> {
    values.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    let last = values.len().checked_sub(1)?;
    values
        .get((fraction * last as f64).round() as usize)
        .copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_a_row_are_its_members() {
        let mut values: Vec<u32> = (0..=100).rev().collect();
        assert_eq!(quantile(&mut values, 0.5), Some(50));
        assert_eq!(quantile(&mut values, 0.99), Some(99));
        assert_eq!(quantile::<u32>(&mut [], 0.5), None);
    }
}
