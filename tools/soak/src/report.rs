//! Results of the run, as a table and as a verdict.

use crate::camera::Frames;
use crate::faults::Fault;
use crate::files::LogRows;
use crate::judge::{Trial, UNDER_WAY};
use crate::line::Heard;
use crate::machine::{MemoryLog, ProcessorTimes, Sample};
use solaspect::aspect::Quality;
use solaspect::instrument::Role;
use solaspect::service::{FlightTally, quantile};
use std::fmt;
use std::io::{self, Write};
use std::time::Duration;

/// Maximum resident memory of the service, in addition to the frames drawn in advance and the waiting ones.
const MOST_BYTES: f64 = 200e6;
/// Growth of the resident memory that counts as a leak.
const LEAK_MB_PER_H: f64 = 1.0;
/// Minimum run time that reveals a leak.
const LEAK_SHOWS: Duration = Duration::from_secs(1800);
/// One-time allocations are done by then.
const SETTLED: Duration = Duration::from_secs(300);

/// Maximum latency from frame to packet, for 99 % (HORACE 2014, requirements of the flight segment).
const MOST_ROLL_LATENCY: Duration = Duration::from_millis(50);
/// Maximum latency from a sample of the IMU to the offset based on it, for 99.9 %.
const MOST_OFFSET_LATENCY: Duration = Duration::from_millis(1);
/// Rate of offsets by the gyros, and latest time of the first one after the start.
const RATE_HZ: u64 = 20;
const FILTER_BEGINS_S: u64 = 6;

/// One value of a sample, bytes.
type Quantity = fn(&Sample) -> f64;

/// Prints a line; a reader that has gone is not a failure.
pub fn say(line: impl fmt::Display) {
    let _ = writeln!(io::stdout().lock(), "{line}");
}

/// Totals of the faults of a run.
#[derive(Debug, Clone, Copy, Default)]
pub struct Trials {
    pub injected: u64,
    pub failed: u64,
    /// Sums of allowed and actual costs.
    pub not_taken: u64,
    pub roll_not_taken: u64,
    pub solutions_lost: i64,
    /// Number of solutions that may have been in transit when they were counted.
    pub under_way: i64,
}

impl Trials {
    pub fn head(self) {
        say(
            "   s  fault                                          length  taken  not taken  stored  not  sent  received  back    MB   heap  verdict",
        );
    }

    /// Prints a fault's row, and adds it to the totals.
    pub fn add(&mut self, at: Duration, trial: &Trial, rate_hz: f64) {
        let complaints = trial.complaints(rate_hz);
        let back = trial.back.map_or("never".into(), |back| {
            format!("{:.1} s", back.as_secs_f64())
        });
        let verdict = match complaints.is_empty() {
            true => "ok".into(),
            false => format!("WRONG {}", complaints.join("; ")),
        };
        let not_taken = trial.growth(|c| c.frames.not_taken + c.frames.failed);
        let mb = |of: fn(&Sample) -> f64| trial.memory.as_ref().map_or(0.0, of) / 1e6;
        let (resident_mb, heap_mb) = (mb(|s| s.resident), mb(|s| s.heap.live));
        say(format_args!(
            "{:4}  {:45} {:5.1} s  {:5}  {not_taken:9}  {:6}  {:3}  {:4}  {:8}  {back:6}  {resident_mb:3.0}  {heap_mb:4.0}  {verdict}",
            at.as_secs(),
            trial.name,
            trial.length().as_secs_f64(),
            trial.growth(|c| c.frames.given),
            trial.growth(|c| c.tally.counts.stored),
            trial.growth(|c| c.tally.counts.unstored),
            trial.growth(|c| c.tally.counts.solutions),
            trial.growth(|c| c.heard.solutions),
        ));
        self.injected += 1;
        self.failed += u64::from(!complaints.is_empty());
        self.roll_not_taken += trial.growth(|c| c.roll_frames.not_taken);
        self.not_taken += trial.growth(|c| c.frames.not_taken);
        if trial.fault == Fault::LineGarbled {
            self.solutions_lost += trial.growth(|c| c.garbled_solutions) as i64;
        } else if trial.fault.cost(rate_hz).packets {
            self.solutions_lost += trial.solutions_lost();
            self.under_way += UNDER_WAY as i64;
        }
    }
}

/// Counts of the frames of the horizon.
pub struct RollRun {
    /// Number of frames that were due.
    pub due: u64,
    pub frames: Frames,
    /// Number of frames that are or were in a file.
    pub in_files: u64,
}

/// A finished run.
pub struct Run {
    pub roll: Option<RollRun>,
    pub navigates: bool,
    pub realtime: Option<u8>,
    pub seconds: u64,
    /// Number of frames that were due.
    pub due: u64,
    pub frames: Frames,
    pub tally: FlightTally,
    pub heard: Heard,
    pub trials: Trials,
    pub rows: Vec<LogRows>,
    /// Number of frames that are or were in a file.
    pub in_files: u64,
    pub memory: MemoryLog,
    pub drawn_bytes: f64,
    /// Size of the pictures that may wait for a disk.
    pub queue_bytes: f64,
    pub processor: ProcessorTimes,
}

impl Run {
    /// Prints the results of the run, and returns the number of errors.
    pub fn report(&self) -> u64 {
        say(&self.tally);
        let Heard {
            solutions, faults, ..
        } = self.heard;
        let faults = faults.total();
        say(format_args!(
            "received   {solutions} solutions, {faults} faults"
        ));
        if self.navigates {
            let run = self.heard.offsets;
            say(format_args!(
                "gyros      {} offsets received; {} after the first 10 s: {:.3} arcsec rms, {:.2} % beyond 3 sigma, {:.1} sigma at most that no fault excuses",
                run.received,
                run.judged,
                run.rms_arcsec(),
                100.0 * run.share_beyond_3_sigma(),
                run.most_sigmas,
            ));
        }
        let Frames {
            given,
            failed,
            not_taken,
        } = self.frames;
        let due = self.due;
        say(format_args!(
            "camera     {due} frames due: {given} given, {failed} failed, {not_taken} not taken"
        ));
        if let Some(RollRun {
            due,
            frames: Frames { given, .. },
            in_files,
        }) = self.roll
        {
            say(format_args!(
                "horizon    {due} frames due: {given} given, {in_files} in files"
            ));
        }
        self.report_files();
        self.report_processor();
        self.report_memory();
        let wrong: Vec<_> = self.wrong().into_iter().filter(|(_, n)| *n != 0).collect();
        for (what, count) in &wrong {
            say(format_args!("WRONG      {what}: {count}"));
        }
        wrong.len() as u64
    }

    /// The threads of the camera, the controller and the soak test itself (`soak`) are not part of a flight.
    fn report_processor(&self) {
        let share = |name: &str, used: Duration| {
            let ms = 1e3 * used.as_secs_f64() / self.frames.given as f64;
            let percent = 100.0 * used.as_secs_f64() / self.seconds as f64;
            say(format_args!(
                "           {name}: {ms:.3} ms a frame, {percent:.2} % of a core"
            ));
        };
        say("processor");
        share("all threads", self.processor.values().sum());
        for (thread, used) in &self.processor {
            share(thread, *used);
        }
    }

    fn report_files(&self) {
        let rows = |of: fn(&LogRows) -> u64| {
            let counts: Vec<_> = self.rows.iter().map(|rows| of(rows).to_string()).collect();
            counts.join(" + ")
        };
        say(format_args!(
            "read back  {} frames in files; {} rows of solution logs, {} samples of telemetry",
            self.in_files,
            rows(|r| r.solutions),
            rows(|r| r.telemetry)
        ));
    }

    fn settled(&self) -> Duration {
        SETTLED.min(Duration::from_secs(self.seconds / 4))
    }

    fn growth_mb_per_h(&self, of: impl Fn(&Sample) -> f64) -> Option<f64> {
        let growth = self.memory.growth(self.settled(), of);
        growth.map(|bytes_per_s| bytes_per_s * 3600.0 / 1e6)
    }

    fn report_memory(&self) {
        say(format_args!(
            "memory     {:.1} MB at most, beside the {:.1} MB of drawn frames",
            (self.memory.largest_bytes() - self.drawn_bytes) / 1e6,
            self.drawn_bytes / 1e6
        ));
        let since = self.settled().as_secs();
        let last = self.memory.samples().last();
        let quantities: [(&str, Quantity); 3] = [
            ("resident", |s| s.resident),
            ("heap in use", |s| s.heap.live),
            ("heap kept", |s| s.heap.kept),
        ];
        for (name, of) in quantities {
            let (Some(growth), Some(last)) = (self.growth_mb_per_h(of), last) else {
                continue;
            };
            let mb = of(last) / 1e6;
            say(format_args!(
                "           {name}: {mb:.1} MB at the end, {growth:+.2} MB/h after {since} s"
            ));
        }
    }

    /// Possible errors, each with its count.
    fn wrong(&self) -> Vec<(&'static str, i64)> {
        let tally = &self.tally;
        let difference = |a: u64, b: u64| a as i64 - b as i64;
        let solved = tally.solved();
        let sent_and_lost = difference(tally.counts.solutions, self.heard.solutions);
        let most = MOST_BYTES + self.queue_bytes;
        let largest = self.memory.largest_bytes() - self.drawn_bytes;
        let leak = self.seconds >= LEAK_SHOWS.as_secs()
            && self
                .growth_mb_per_h(|s| s.resident)
                .is_none_or(|growth| growth > LEAK_MB_PER_H);
        let roll = self.roll.as_ref();
        let roll_given = roll.map_or(0, |roll| roll.frames.given);
        let roll_in_files = roll.map_or(0, |roll| roll.in_files);
        let rolls_solved = tally.solver(Role::Roll).frames();
        let mut wrong = vec![
            (
                "faults that cost more than they may",
                self.trials.failed as i64,
            ),
            (
                "frames due, less given, failed and not taken",
                difference(self.due, self.frames.due()),
            ),
            (
                "frames not taken, without a fault",
                difference(self.frames.not_taken, self.trials.not_taken),
            ),
            (
                "frames given, less taken",
                difference(self.frames.given + roll_given, tally.counts.taken),
            ),
            (
                "frames taken, less solved, of another size and lost",
                difference(
                    tally.counts.taken,
                    solved
                        + rolls_solved
                        + tally.solver(Role::PitchYaw).misfits
                        + tally.camera.lost,
                ),
            ),
            ("frames not solved", tally.camera.lost as i64),
            (
                "frames solved, less stored and not stored",
                difference(
                    solved + rolls_solved,
                    tally.counts.stored + tally.counts.unstored,
                ),
            ),
            ("frames not stored", tally.counts.unstored as i64),
            (
                "frames stored, less those in files",
                difference(tally.counts.stored, self.in_files + roll_in_files),
            ),
            (
                "solutions not received, without a fault",
                (sent_and_lost - self.trials.solutions_lost)
                    .abs()
                    .saturating_sub(self.trials.under_way)
                    .max(0),
            ),
            ("no solutions", i64::from(self.heard.solutions == 0)),
            ("too much memory", i64::from(largest > most)),
            ("a leak", i64::from(leak)),
        ];
        wrong.extend(self.wrong_rows(solved));
        wrong.extend(self.wrong_roll());
        wrong.extend(self.wrong_navigation());
        if self.trials.injected == 0 {
            wrong.push(("lost", tally.lost() as i64));
            wrong.push(("faults of the line", self.heard.faults.total() as i64));
        }
        wrong
    }

    /// Errors with the frames of the horizon: each must be taken and show a horizon, and its roll must be sent in time.
    fn wrong_roll(&self) -> Vec<(&'static str, i64)> {
        let Some(roll) = &self.roll else {
            return Vec::new();
        };
        let tally = &self.tally;
        let mut latencies: Vec<Duration> = tally.line.roll_latencies.iter().copied().collect();
        let late = quantile(&mut latencies, 0.99).is_none_or(|most| most > MOST_ROLL_LATENCY);
        // A roll waits for the Sun's next frame, which may wait for the end of a fault.
        let late = late && self.trials.injected == 0;
        vec![
            (
                "frames of the horizon due, less given",
                roll.due as i64 - roll.frames.given as i64 - self.trials.roll_not_taken as i64,
            ),
            (
                "frames of the horizon that are not fine",
                roll.frames.given as i64 - tally.solver(Role::Roll).of(Quality::Fine) as i64,
            ),
            ("roll that went out late", i64::from(late)),
        ]
    }

    /// Errors with the offsets by the gyros: none may be lost or late, and their sigmas must be right.
    fn wrong_navigation(&self) -> Vec<(&'static str, i64)> {
        if !self.navigates {
            return Vec::new();
        }
        let run = self.heard.offsets;
        let (tally, line) = (&self.tally.navigation, &self.tally.line);
        let mut latencies: Vec<Duration> = line.propagated_latencies.iter().copied().collect();
        let late = quantile(&mut latencies, 0.999).is_none_or(|most| most > MOST_OFFSET_LATENCY);
        // With other programs' threads on the machine, a millisecond cannot be guaranteed.
        let late = late && self.realtime.is_some();
        let expected = RATE_HZ * self.seconds.saturating_sub(FILTER_BEGINS_S);
        let mut wrong = vec![
            ("offsets by the gyros beyond 6 sigma", run.wrong as i64),
            ("no offsets by the gyros", i64::from(run.judged == 0)),
            ("rows of the navigation lost", tally.rows_lost as i64),
        ];
        // Further costs of a fault of the line or the IMU are counted with that fault.
        if self.trials.injected > 0 {
            return wrong;
        }
        wrong.extend([
            ("samples of the IMU lost", tally.lost_samples as i64),
            (
                "inputs that the filter lost",
                self.tally.counts.navigation_lost as i64,
            ),
            (
                "offsets by the gyros sent, less received",
                self.tally.counts.propagated as i64 - run.received as i64,
            ),
            (
                "offsets by the gyros too few",
                i64::from(run.received < expected),
            ),
            (
                "offsets by the gyros beyond 3 sigma",
                i64::from(run.share_beyond_3_sigma() > 0.01),
            ),
            ("offsets by the gyros that went out late", i64::from(late)),
        ]);
        wrong
    }

    /// Errors in the logs: every frame must be in one of them, no frame twice in the same one, and no more rows may be
    /// missing than were refused.
    fn wrong_rows(&self, solved: u64) -> Vec<(&'static str, i64)> {
        let archive = &self.tally.archive;
        let expected = 2 * solved * self.rows.len() as u64;
        let found: u64 = self.rows.iter().map(|r| r.solutions + r.telemetry).sum();
        let excused = archive.rows_refused + 2 * archive.rows_lost;
        let mut frames: Vec<u64> = self
            .rows
            .iter()
            .flat_map(|r| r.frames.keys().copied())
            .collect();
        frames.sort_unstable();
        frames.dedup();
        let twice = self.rows.iter().flat_map(|r| r.frames.values());
        let twice = twice.filter(|count| **count > 1).count();
        vec![
            (
                "frames solved, less those in any log",
                solved as i64 - frames.len() as i64,
            ),
            ("frames twice in the same log", twice as i64),
            (
                "rows missing that were not refused",
                (expected as i64 - found as i64 - excused as i64).max(0),
            ),
        ]
    }
}
