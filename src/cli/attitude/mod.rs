//! The attitude of a flight, from measurements to files: what `navigate` and `refine` share.

mod page;
mod table;

pub(super) use page::add_attitude;

use super::output::{say, write_if};
use crate::calibrate::navigation::{Source, calibrated};
use crate::instrument::toml_file::read_text;
use crate::navigation::aem::Stretches;
use crate::navigation::{
    Due, Flight, PropagatedOffset, Row, Settings, Spool, Status, Summary, Verdict, smooth, solve,
    suspected_units,
};
use crate::units::counted;
use anyhow::Context;
use clap::Args;
use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use table::{write_aem, write_csv, write_fits, write_offsets};

/// A flight that refuses more than this share of its measurements is not the one that its IMU tells of.
const MOSTLY: f64 = 0.75;

/// Which rows and files of an attitude are wanted.
#[derive(Debug, Clone, Args)]
pub(super) struct AttitudeArgs {
    /// Rows a second [default: each sample of the IMU]
    #[arg(long, value_name = "HZ", value_parser = parse_rate)]
    pub rate: Option<f64>,
    /// Write attitude.aem, too: an Attitude Ephemeris Message of CCSDS; the epoch must be known
    #[arg(long, requires = "imu")]
    pub aem: bool,
    /// Write NAV.toml anew, with the biases and misalignments that the filter ended with
    #[arg(long, value_name = "OUT.toml", requires = "imu")]
    calibrated: Option<PathBuf>,
}

impl AttitudeArgs {
    /// Which rows are wanted: all, where no rate is stated.
    fn due(&self) -> impl FnMut(&Row) -> bool + use<> {
        let (rate_hz, mut due) = (self.rate, Due::default());
        move |row| rate_hz.is_none_or(|rate_hz| due.takes(row.t_s, rate_hz))
    }
}

/// NAV.toml as it was read.
pub(super) struct NavigationFile {
    pub path: PathBuf,
    pub text: String,
    pub settings: Settings,
}

impl NavigationFile {
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        Self::of((path.into(), read_text(path)?))
    }

    /// The same of a path and its text.
    pub fn of((path, text): (PathBuf, String)) -> anyhow::Result<Self> {
        Ok(Self {
            settings: Settings::parse(&path, &text)?,
            path,
            text,
        })
    }
}

fn parse_rate(text: &str) -> Result<f64, String> {
    let rate: Option<f64> = text.parse().ok();
    rate.filter(|rate| (1e-3..=1e5).contains(rate))
        .ok_or_else(|| format!("expected a number from 0.001 to 100000 Hz, found \"{text}\""))
}

/// By which measurements the attitude is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Basis {
    UpToThen,
    WholeFlight,
}

/// The attitude of a flight; its rows wait on disk.
pub(super) struct Attitude<'a> {
    folder: &'a Path,
    wanted: &'a AttitudeArgs,
    spool: Spool,
    stretches: Stretches,
    pub summary: Summary,
    pub counts: Counts,
    /// Which other units the IMU's numbers may be in.
    suspected: Vec<String>,
    /// Of the last sample.
    end_s: f64,
}

impl<'a> Attitude<'a> {
    /// Solves the runs of a flight, one after the other.
    pub fn solve(
        runs: &[Flight],
        basis: Basis,
        folder: &'a Path,
        wanted: &'a AttitudeArgs,
    ) -> anyhow::Result<Self> {
        let on_disk = || format!("{}: cannot keep the attitude there", folder.display());
        let mut spool = Spool::in_folder(folder).with_context(on_disk)?;
        let mut summary = Summary::default();
        for run in runs {
            summary.append(solve_run(run, &mut spool).with_context(on_disk)?);
            if basis == Basis::WholeFlight {
                let kept = smooth_run(run, &mut spool);
                kept.context("the flight cannot be smoothed: a covariance is not positive")?
                    .with_context(on_disk)?;
            }
        }
        let (counts, stretches) = look_over(&mut spool, wanted).with_context(on_disk)?;
        Ok(Self {
            folder,
            wanted,
            spool,
            stretches,
            summary,
            counts,
            suspected: suspected_units(runs),
            end_s: runs
                .iter()
                .filter_map(|run| run.imu.last())
                .fold(0.0, |_, last| last.t_s),
        })
    }

    /// The rows that are wanted.
    pub fn rows(&mut self) -> anyhow::Result<impl Iterator<Item = std::io::Result<Row>>> {
        let mut is_due = self.wanted.due();
        let rows = self.spool.rows();
        let rows = rows.context("the attitude cannot be read again")?;
        Ok(rows.filter(move |row| row.as_ref().map_or(true, &mut is_due)))
    }

    /// Writes attitude.csv and, where they are wanted, attitude.fits and attitude.aem.
    pub fn write(&mut self, epoch: Option<Timestamp>, with_fits: bool) -> anyhow::Result<()> {
        let file = |name: &str| self.folder.join(name);
        let [csv, fits, aem] = ["attitude.csv", "attitude.fits", "attitude.aem"].map(file);
        write_csv(&csv, self.rows()?)?;
        if with_fits {
            let count = self.counts.written;
            write_fits(&fits, epoch, count, self.rows()?)?;
        }
        if let Some(epoch) = epoch.filter(|_| self.wanted.aem) {
            let stretches = self.stretches.clone();
            write_aem(&aem, epoch, stretches, self.rows()?)?;
        }
        Ok(())
    }

    /// Writes the telescope's offsets from its target; those that `offset` does not know are empty.
    pub fn write_offsets(
        &mut self,
        path: &Path,
        offset: impl FnMut(&Row) -> Option<PropagatedOffset>,
    ) -> anyhow::Result<()> {
        write_offsets(path, self.rows()?, offset)
    }

    /// Writes NAV.toml as this flight has taught it, where that is wanted; `files` are those that it was read from.
    pub fn write_calibrated(
        &self,
        given: &NavigationFile,
        epoch: Option<Timestamp>,
        files: Vec<String>,
    ) -> anyhow::Result<()> {
        let Some(path) = &self.wanted.calibrated else {
            return Ok(());
        };
        let constants = self.summary.constants.as_ref();
        let constants =
            constants.context("--calibrated: expected an attitude, found a filter that waits")?;
        let flown = epoch.zip(SignedDuration::try_from_secs_f64(self.end_s).ok());
        let flown = flown.and_then(|(epoch, since)| epoch.checked_add(since).ok());
        let measurements = self.summary.innovations.len();
        let source = Source {
            date: flown.map(|flown| TimeZone::UTC.to_datetime(flown).date()),
            text: format!(
                "navigation filter, {} samples of the IMU and {measurements} measurements",
                self.counts.rows()
            ),
            files,
        };
        let (text, settings) = (&given.text, &given.settings);
        let text = calibrated(&given.path, text, settings, constants, &source)?;
        write_if(path, &text, |part| Settings::read(part).map(drop))
    }

    /// Says in a line what came out. It is a failure where no row has an attitude, where most measurements were refused, and where the IMU's
    /// numbers look like those of other units: a line says of which.
    pub fn print(&self) -> anyhow::Result<ExitCode> {
        let (counts, summary) = (&self.counts, &self.summary);
        let innovations = summary.innovations.iter();
        let refused = innovations.filter(|one| one.verdict == Verdict::Refused);
        let refused = refused.count();
        say(format_args!(
            "{} rows: {} aligned, {} coasting, {} contradicted, {} by an unsound IMU, {} waiting, {} after {}; {} of {} measurements refused",
            counts.rows(),
            counts.of(Status::Aligned),
            counts.of(Status::Coasting),
            counts.of(Status::Contradicted),
            counts.of(Status::Unsound),
            counts.of(Status::Waiting),
            counts.of(Status::Restarted),
            counted(u64::from(summary.restarts), "restart"),
            refused,
            summary.innovations.len()
        ))?;
        let mostly_refused = refused as f64 > MOSTLY * summary.innovations.len() as f64;
        let is_found = counts.of(Status::Waiting) < counts.rows();
        if is_found && !mostly_refused && self.suspected.is_empty() {
            return Ok(ExitCode::SUCCESS);
        }
        if mostly_refused {
            tracing::error!(
                "{refused} of {} measurements contradict the gyros and accelerometers: the attitude is not to be trusted",
                summary.innovations.len()
            );
        }
        for suspected in &self.suspected {
            tracing::error!("{suspected}");
        }
        Ok(ExitCode::FAILURE)
    }
}

/// The rows by the measurements up to each time.
fn solve_run(run: &Flight, spool: &mut Spool) -> std::io::Result<Summary> {
    let mut kept = Ok(());
    let summary = solve(run, |row| {
        if kept.is_ok() {
            kept = spool.push(&row);
        }
    });
    kept.map(|()| summary)
}

/// The same rows by those of the whole run; `None` where a covariance is not positive.
fn smooth_run(run: &Flight, spool: &mut Spool) -> Option<std::io::Result<()>> {
    let (mut at, mut kept) = (spool.len(), Ok(()));
    smooth(run, |row| {
        at -= 1;
        if kept.is_ok() {
            kept = spool.replace(at, &row);
        }
    })?;
    Some(kept)
}

/// Counts all rows, and the stretches of those that are written.
fn look_over(spool: &mut Spool, wanted: &AttitudeArgs) -> std::io::Result<(Counts, Stretches)> {
    let (mut counts, mut stretches) = (Counts::default(), Stretches::default());
    let mut is_due = wanted.due();
    for row in spool.rows()? {
        let row = row?;
        counts.count(&row);
        if is_due(&row) {
            counts.written += 1;
            stretches.note(&row);
        }
    }
    Ok((counts, stretches))
}

/// Rows by their status.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Counts {
    /// In the order of [`Status::ALL`].
    by_status: [u64; Status::ALL.len()],
    /// At the rate that is wanted.
    pub written: u64,
}

impl Counts {
    pub fn of(&self, status: Status) -> u64 {
        self.by_status[status as usize]
    }

    pub fn rows(&self) -> u64 {
        self.by_status.iter().sum()
    }

    fn count(&mut self, row: &Row) {
        self.by_status[row.status as usize] += 1;
    }
}
