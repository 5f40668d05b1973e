//! Counts of each thread, and of a whole flight.

use crate::aspect::Quality;
use crate::camera::CameraHealth;
use crate::instrument::Role;
use crate::link::{Counts, LinkState, Rejected};
use crate::navigation::nmea::GpsCounts;
use crate::navigation::{Agreement, PropagatedOffset, Status};
use crate::reasons;
use crate::units::{Reason, counted};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt;
use std::time::Duration;

/// Counts of a camera's thread.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CameraTally {
    /// Frames that did not fit into the solver's queue.
    pub lost: u64,
    /// Frames that the source failed to give.
    pub failed: u64,
    /// Exposures that did not fit into the line's queue.
    pub unannounced: u64,
    /// Times that the camera gave no frames though it should have.
    pub silences: u64,
    /// Total time without frames in these silences, each from the last frame on.
    pub silent: Duration,
    /// Number of steps of UTC.
    pub utc_steps: u64,
    /// State of the camera itself.
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

    fn describe(&self, counts: &Counts, out: &mut fmt::Formatter<'_>) -> fmt::Result {
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

/// Counts of a solver's thread.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SolverTally {
    pub solved: BTreeMap<Quality, u64>,
    /// Number of frames whose processing stopped, by stage and reason; coarse ones too.
    pub reasons: BTreeMap<(&'static str, Reason), u64>,
    /// Frames of the wrong size.
    pub misfits: u64,
    /// Answers that did not fit into the line's queue.
    pub unsent: u64,
    /// Calibrated quantities that fine frames contradict, with stated and measured values.
    pub contradictions: BTreeSet<String>,
    /// Whether frames now contradict any of them.
    pub contradicted: bool,
}

impl SolverTally {
    pub fn of(&self, quality: Quality) -> u64 {
        self.solved.get(&quality).copied().unwrap_or(0)
    }

    /// All frames that were solved, whatever their result.
    pub fn frames(&self) -> u64 {
        self.solved.values().sum()
    }

    /// Frames whose processing stopped for this reason.
    pub fn because(&self, reason: Reason) -> u64 {
        let same = self.reasons.iter().filter(|((_, why), _)| *why == reason);
        same.map(|(_, count)| count).sum()
    }

    /// Frames whose processing stopped at this stage.
    pub fn stopped_at(&self, stage: impl reasons::Stage) -> u64 {
        let here = self
            .reasons
            .iter()
            .filter(|((name, _), _)| *name == stage.name());
        here.map(|(_, count)| count).sum()
    }

    fn add(&mut self, other: &Self) {
        for (quality, count) in &other.solved {
            *self.solved.entry(*quality).or_default() += count;
        }
        for (reason, count) in &other.reasons {
            *self.reasons.entry(*reason).or_default() += count;
        }
        self.misfits += other.misfits;
        self.unsent += other.unsent;
        self.contradictions
            .extend(other.contradictions.iter().cloned());
        self.contradicted |= other.contradicted;
    }

    fn describe(&self, name: &str, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [fine, coarse, none] =
            [Quality::Fine, Quality::Coarse, Quality::None].map(|quality| self.of(quality));
        writeln!(out, "{name:<10} {fine} fine, {coarse} coarse, {none} none")?;
        for ((stage, reason), count) in &self.reasons {
            writeln!(out, "           {count} x {stage}: {reason}")?;
        }
        for contradiction in &self.contradictions {
            writeln!(out, "contradicted by fine frames: {contradiction}")?;
        }
        Ok(())
    }
}

/// Counts of the solver of one camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraSolved {
    pub role: Role,
    pub solver: SolverTally,
}

/// Counts of the archive's threads.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ArchiveTally {
    /// Pictures dropped because the disks were too slow.
    pub overflowed: u64,
    /// Pictures dropped because the disks are nearly full.
    pub disk_full: u64,
    /// Pictures that could not be stored for another reason.
    pub failed: u64,
    /// Frames that had not reached a disk when the flight ended; only in the last tally.
    pub unfinished: u64,
    /// Refusals by any disk; another disk may have stored the frame.
    pub refused: u64,
    /// Refusals of rows by any disk, and rows that did not fit into a log's queue; another log may have the row.
    pub rows_refused: u64,
    /// Rows of frames that are in no log.
    pub rows_lost: u64,
    /// Half-written files of an earlier run that were removed.
    pub swept: u64,
}

impl ArchiveTally {
    fn describe(&self, counts: &Counts, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "stored     {}, {} not: queue overflow {}, disk full {}, failed {}, unfinished {}; {} refusals, {} rows refused, {} rows lost, {} partial files removed",
            counts.stored,
            counts.unstored,
            self.overflowed,
            self.disk_full,
            self.failed,
            self.unfinished,
            self.refused,
            self.rows_refused,
            self.rows_lost,
            self.swept,
        )
    }
}

/// Counts of the link's thread.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LineTally {
    /// Packets that the port did not take.
    pub failed: u64,
    /// Exposures that were not announced because the line could not follow.
    pub unannounced: u64,
    /// Housekeeping packets and whole pictures that went to the ground.
    pub housekeeping: u64,
    pub pictures: u64,
    /// Number of times that the port was lost, and opened again.
    pub lost: u64,
    pub reopened: u64,
    /// Whether the configured port could never be opened.
    pub never_open: bool,
    /// Bytes of the line that belonged to no packet.
    pub rejected: Rejected,
    pub commands: u64,
    pub moon_requests: u64,
    /// Settings by controller and ground.
    pub conversation: LinkState,
    /// Latencies from a frame's arrival to its solution's last byte: the latest ten thousand.
    pub latencies: VecDeque<Duration>,
    /// Latencies from the arrival of an IMU sample to the last byte of the offset that rests on it: the same number.
    pub propagated_latencies: VecDeque<Duration>,
    /// Latencies from the arrival of a horizon frame to the last byte of the first solution that has its roll: the same number.
    pub roll_latencies: VecDeque<Duration>,
}

/// Adds a latency and keeps the latest ten thousand.
pub(super) fn note_latency(latencies: &mut VecDeque<Duration>, latency: Duration) {
    const KEPT: usize = 10_000;
    if latencies.len() == KEPT {
        latencies.pop_front();
    }
    latencies.push_back(latency);
}

impl LineTally {
    /// The counts, with only the latest latencies: the line waits while they are copied.
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

    fn describe(&self, counts: &Counts, out: &mut fmt::Formatter<'_>) -> fmt::Result {
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

/// Counts of the navigation's threads.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NavigationTally {
    /// Samples that are missing by their counter.
    pub lost_samples: u64,
    /// Packets of the IMU and datagrams that cannot be read.
    pub unreadable: u64,
    /// Counts of the GPS receiver.
    pub gps: GpsCounts,
    /// Directions observed by cameras.
    pub directions: u64,
    /// Measurements that contradict the filter, and measurements that came too late or too early.
    pub refused: u64,
    pub out_of_time: u64,
    /// Restarts of the filter.
    pub restarts: u64,
    /// Times that the IMU data were unsound, or directions contradicted them.
    pub doubted: u64,
    /// Times that directions contradicted the gyros by more than 5 sigma for 10 s.
    pub contradicted: u64,
    /// Offsets computed, and the number of them that are too uncertain to be sent.
    pub offsets: u64,
    pub uncertain: u64,
    /// Rows that did not fit into the archive's queue.
    pub rows_lost: u64,
    /// `None` before the first sample.
    pub status: Option<Status>,
    pub latest: Option<PropagatedOffset>,
    /// The latest differences of cameras from the gyros, in sigmas: right, up and roll of the telescope.
    pub differences: [Option<f64>; 3],
    /// `None` if nothing is compared.
    pub agreement: Option<Agreement>,
}

impl NavigationTally {
    fn describe(&self, counts: &Counts, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if *self == Self::default() && counts.imu_samples + counts.navigation_lost == 0 {
            return Ok(());
        }
        writeln!(
            out,
            "navigation {} samples ({} lost, {} unreadable), {} fixes ({}), {} directions, \
             {} refused, {} out of time, {} overflowed",
            counts.imu_samples,
            self.lost_samples,
            self.unreadable,
            self.gps.fixes,
            self.gps,
            self.directions,
            self.refused,
            self.out_of_time,
            counts.navigation_lost,
        )?;
        writeln!(
            out,
            "           {} offsets, {} of them too uncertain to be sent, {} times of doubt, {} contradictions of 10 s, {} restarts, {} rows and {} sentences unreadable or lost, at last {}",
            self.offsets,
            self.uncertain,
            self.doubted,
            self.contradicted,
            self.restarts,
            self.rows_lost,
            self.gps.unreadable,
            self.status.map_or("without samples", Status::name),
        )
    }
}

/// Counts of an output for other programs.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct OutputTally {
    /// Destination as in the configuration.
    pub to: String,
    pub format: &'static str,
    /// Messages sent, one for each reader.
    pub sent: u64,
    /// Messages that a reader did not take, that had no reader, or that did not fit into a queue.
    pub dropped: u64,
}

impl OutputTally {
    fn describe(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            to,
            format,
            sent,
            dropped,
        } = self;
        write!(
            out,
            "\noutput     {format} to {to}: {sent} sent, {dropped} dropped"
        )
    }
}

/// Counts of a whole flight.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FlightTally {
    pub counts: Counts,
    /// Counts of all cameras together.
    pub camera: CameraTally,
    /// Counts of each camera's solver, in the order of the flight's cameras.
    pub solvers: Vec<CameraSolved>,
    pub navigation: NavigationTally,
    pub archive: ArchiveTally,
    pub line: LineTally,
    /// In the order of the configuration. Messages dropped there do not count as lost: outputs do not wait for readers.
    pub outputs: Vec<OutputTally>,
    /// Threads that panicked or hung, and were started again.
    pub restarts: u64,
    /// Restarts of threads that hung.
    pub takeovers: u64,
    /// Whether the flight ended because its threads hung again and again.
    pub gave_up: bool,
    /// Log lines that standard error did not take.
    pub log_lines_lost: u64,
}

impl FlightTally {
    /// Counts of all cameras of a role together.
    pub fn solver(&self, role: Role) -> SolverTally {
        let mut all = SolverTally::default();
        let of_role = self.solvers.iter().filter(|camera| camera.role == role);
        of_role.for_each(|camera| all.add(&camera.solver));
        all
    }

    /// Frames of pitch-yaw cameras that were solved, whatever their result.
    pub fn solved(&self) -> u64 {
        self.solver(Role::PitchYaw).frames()
    }

    /// Frames, stored files, rows and packets that did not reach their destination, and silences of cameras. A row that one disk
    /// refused and another has is not lost.
    pub fn lost(&self) -> u64 {
        let camera = self.camera.lost + self.camera.failed + self.camera.silences;
        let solvers = || self.solvers.iter().map(|camera| &camera.solver);
        let frames = camera + solvers().map(|solver| solver.misfits).sum::<u64>();
        let files = self.counts.unstored + self.archive.rows_lost;
        let packets = self.camera.unannounced
            + solvers().map(|solver| solver.unsent).sum::<u64>()
            + self.line.failed;
        let line = u64::from(self.line.never_open);
        frames + files + packets + line + self.restarts
    }
}

impl fmt::Display for FlightTally {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.camera.describe(&self.counts, out)?;
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
        for role in Role::KINDS {
            let solver = self.solver(role);
            if role == Role::PitchYaw || solver != SolverTally::default() {
                let name = match role {
                    Role::PitchYaw => "solved",
                    other => other.name(),
                };
                solver.describe(name, out)?;
            }
        }
        self.navigation.describe(&self.counts, out)?;
        self.archive.describe(&self.counts, out)?;
        self.line.describe(&self.counts, out)?;
        self.outputs
            .iter()
            .try_for_each(|output| output.describe(out))
    }
}

/// The value below which a fraction of the values lies; `None` if there are no values.
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
