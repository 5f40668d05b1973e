//! The attitude of a flight, from measurements to files: shared by `navigate` and `refine`.

mod page;
mod table;

pub use page::add_attitude;

use crate::calibrate::navigation::{Source, calibrated};
use crate::calibrate::revision::write_if;
use crate::instrument::toml_file::read_text;
use crate::navigation::aem::Stretches;
use crate::navigation::{
    Due, Flight, NavigationRow, NavigationSettings, PropagatedOffset, Spool, Status, Summary,
    Verdict, smooth, solve, suspected_units,
};
use crate::units::counted;
use anyhow::Context;
use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp};
use std::fmt;
use std::path::{Path, PathBuf};
use table::{write_aem, write_csv, write_fits, write_offsets};

/// If more than this share of the measurements is rejected, the IMU was not on this flight.
const MOSTLY: f64 = 0.75;

/// Selection of the rows and files of an attitude.
#[derive(Debug, Clone, Default)]
pub struct Wanted {
    /// Rows a second; all rows where no rate is stated.
    pub rate_hz: Option<f64>,
    /// Also write an Attitude Ephemeris Message of CCSDS; the epoch must be known.
    pub aem: bool,
    /// Also write NAV.toml with the filter's final biases and misalignments, to this path.
    pub calibrated: Option<PathBuf>,
}

impl Wanted {
    fn due(&self) -> impl FnMut(&NavigationRow) -> bool + use<> {
        let (rate_hz, mut due) = (self.rate_hz, Due::default());
        move |row| rate_hz.is_none_or(|rate_hz| due.takes(row.t_s, rate_hz))
    }
}

/// NAV.toml as read.
pub struct NavigationFile {
    pub path: PathBuf,
    pub text: String,
    pub settings: NavigationSettings,
}

impl NavigationFile {
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        Self::of((path.into(), read_text(path)?))
    }

    /// The same from a path and its text.
    pub fn of((path, text): (PathBuf, String)) -> anyhow::Result<Self> {
        Ok(Self {
            settings: NavigationSettings::parse(&path, &text)?,
            path,
            text,
        })
    }
}

/// The measurements that the attitude at a time is based on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Basis {
    UpToThen,
    WholeFlight,
}

/// The attitude of a flight; its rows are spooled to disk.
pub struct Attitude<'a> {
    folder: &'a Path,
    wanted: &'a Wanted,
    spool: Spool,
    stretches: Stretches,
    pub summary: Summary,
    pub counts: Counts,
    /// Other units in which the IMU's numbers may be.
    suspected: Vec<String>,
    /// Time of the last sample, s.
    end_s: f64,
}

impl<'a> Attitude<'a> {
    /// Solves the runs of a flight, one after the other.
    pub fn solve(
        runs: &[Flight],
        basis: Basis,
        folder: &'a Path,
        wanted: &'a Wanted,
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
        let (counts, stretches) = check_rows(&mut spool, wanted).with_context(on_disk)?;
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

    /// All rows.
    pub fn all_rows(
        &mut self,
    ) -> anyhow::Result<impl Iterator<Item = std::io::Result<NavigationRow>>> {
        self.spool
            .rows()
            .context("the attitude cannot be read again")
    }

    /// The selected rows.
    pub fn rows(&mut self) -> anyhow::Result<impl Iterator<Item = std::io::Result<NavigationRow>>> {
        let mut is_due = self.wanted.due();
        let rows = self.all_rows()?;
        Ok(rows.filter(move |row| row.as_ref().map_or(true, &mut is_due)))
    }

    /// Writes attitude.csv and, where selected, attitude.fits and attitude.aem.
    pub fn write(&mut self, epoch: Option<Timestamp>, with_fits: bool) -> anyhow::Result<()> {
        let file = |name: &str| self.folder.join(name);
        let [csv, fits, aem] = ["attitude.csv", "attitude.fits", "attitude.aem"].map(file);
        write_csv(&csv, self.rows()?)?;
        if with_fits {
            write_fits(&fits, epoch, self.rows()?)?;
        }
        if let Some(epoch) = epoch.filter(|_| self.wanted.aem) {
            let stretches = self.stretches.clone();
            write_aem(&aem, epoch, stretches, self.rows()?)?;
        }
        Ok(())
    }

    /// Writes the telescope's offsets from its target; rows for which `offset` returns none are empty.
    pub fn write_offsets(
        &mut self,
        path: &Path,
        offset: impl FnMut(&NavigationRow) -> Option<PropagatedOffset>,
    ) -> anyhow::Result<()> {
        write_offsets(path, self.rows()?, offset)
    }

    /// Writes NAV.toml with the estimates of this flight, where that is selected; `files` are the input files.
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
        Ok(write_if(path, &text, |part| {
            NavigationSettings::read(part).map(drop)
        })?)
    }

    /// Result.
    pub fn found(&self) -> AttitudeFound {
        let innovations = self.summary.innovations.iter();
        let refused = innovations.filter(|one| one.verdict == Verdict::Refused);
        AttitudeFound {
            counts: self.counts,
            measurements: self.summary.innovations.len(),
            refused: refused.count(),
            restarts: self.summary.restarts,
            suspected_units: self.suspected.clone(),
        }
    }
}

/// Result of a flight's attitude.
#[derive(Debug, Clone)]
pub struct AttitudeFound {
    pub counts: Counts,
    pub measurements: usize,
    /// Measurements of these that the filter rejected.
    pub refused: usize,
    pub restarts: u32,
    /// Other units in which the IMU's numbers may be.
    pub suspected_units: Vec<String>,
}

impl AttitudeFound {
    fn is_mostly_rejected(&self) -> bool {
        self.refused as f64 > MOSTLY * self.measurements as f64
    }

    /// Whether rows have an attitude, most measurements agree with it, and the IMU's numbers are in the expected units.
    pub fn is_sound(&self) -> bool {
        let is_found = self.counts.of(Status::Waiting) < self.counts.rows();
        is_found && !self.is_mostly_rejected() && self.suspected_units.is_empty()
    }

    /// Reasons not to trust the attitude, in words.
    pub fn doubts(&self) -> impl Iterator<Item = String> {
        let mostly = self.is_mostly_rejected().then(|| {
            format!(
                "{} of {} measurements contradict the gyros and accelerometers: the attitude is unreliable",
                self.refused, self.measurements
            )
        });
        mostly
            .into_iter()
            .chain(self.suspected_units.iter().cloned())
    }
}

/// One line, for people.
impl fmt::Display for AttitudeFound {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counts = &self.counts;
        write!(
            out,
            "{} rows: {} aligned, {} coasting, {} contradicted, {} by an unsound IMU, {} waiting, {} after {}; {} of {} measurements refused",
            counts.rows(),
            counts.of(Status::Aligned),
            counts.of(Status::Coasting),
            counts.of(Status::Contradicted),
            counts.of(Status::Unsound),
            counts.of(Status::Waiting),
            counts.of(Status::Restarted),
            counted(u64::from(self.restarts), "restart"),
            self.refused,
            self.measurements
        )
    }
}

/// Solves a run forward: each row uses the measurements up to its time.
fn solve_run(run: &Flight, spool: &mut Spool) -> std::io::Result<Summary> {
    let mut kept = Ok(());
    let summary = solve(run, |row| {
        if kept.is_ok() {
            kept = spool.push(&row);
        }
    });
    kept.map(|()| summary)
}

/// Smooths the same rows with the measurements of the whole run; `None` where a covariance is not positive.
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

/// Counts all rows, and the stretches of the written ones.
fn check_rows(spool: &mut Spool, wanted: &Wanted) -> std::io::Result<(Counts, Stretches)> {
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
pub struct Counts {
    /// In the order of [`Status::ALL`].
    by_status: [u64; Status::ALL.len()],
    /// Rows written at the selected rate.
    pub written: u64,
}

impl Counts {
    pub fn of(&self, status: Status) -> u64 {
        self.by_status[status as usize]
    }

    pub fn rows(&self) -> u64 {
        self.by_status.iter().sum()
    }

    fn count(&mut self, row: &NavigationRow) {
        self.by_status[row.status as usize] += 1;
    }
}
