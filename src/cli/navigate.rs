//! `solaspect navigate`: the attitude by gyros between and beyond what cameras see.

mod page;
mod table;

use super::options;
use super::output::{make_folder, say};
use crate::navigation::aem::Stretches;
use crate::navigation::files::{Seen, read_gps, read_imu, read_sun, read_vectors};
use crate::navigation::{
    Fix, Flight, Measurement, Row, Settings, Sighting, Sky, Spool, Target, Targets, Towards,
    Verdict, smooth, solve,
};
use anyhow::{Context, ensure};
use clap::Args;
use jiff::Timestamp;
use std::path::PathBuf;
use std::process::ExitCode;
use table::{write_aem, write_csv, write_fits};

/// Find a vehicle's attitude from its gyros, GPS, and the directions that cameras have seen
///
/// Writes attitude.csv (the attitude at each sample of the IMU: v_ecef = R(q) v_body, its errors about the axes of ECEF) and
/// report.html to the folder, and other forms of it on request. docs/navigation.md has the files' columns.
#[derive(Debug, Args)]
pub struct NavigateArgs {
    /// What the sensors are: NAV.toml (docs/navigation.md)
    #[arg(long, value_name = "NAV.toml")]
    config: PathBuf,
    /// Specific force and rate, means over the interval that ends at t_s
    #[arg(long, value_name = "CSV")]
    imu: PathBuf,
    /// Position and velocity in ECEF
    #[arg(long, value_name = "CSV")]
    gps: PathBuf,
    /// Directions to Sun, nadir and Moon in the axes of the cameras
    #[arg(long, value_name = "CSV")]
    vectors: PathBuf,
    /// Directions to the Sun in ECEF, where no epoch_utc lets the ephemeris tell them
    #[arg(long, value_name = "CSV")]
    sun: Option<PathBuf>,
    /// The folder for attitude.csv and report.html
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// By all measurements of the flight, not only those up to each time
    #[arg(long)]
    smooth: bool,
    /// Rows a second [default: each sample of the IMU]
    #[arg(long, value_name = "HZ", value_parser = parse_rate)]
    rate: Option<f64>,
    /// Write attitude.fits, too: the table ATTITUDE
    #[arg(long)]
    fits: bool,
    /// Write attitude.aem, too: an Attitude Ephemeris Message of CCSDS; epoch_utc must be known
    #[arg(long)]
    aem: bool,
}

fn parse_rate(text: &str) -> Result<f64, String> {
    let rate: Option<f64> = text.parse().ok();
    rate.filter(|rate| (1e-3..=1e5).contains(rate))
        .ok_or_else(|| format!("expected a number from 0.001 to 100000 Hz, found \"{text}\""))
}

pub fn run(args: &NavigateArgs) -> anyhow::Result<ExitCode> {
    let flight = args.read()?;
    let epoch = flight.settings.epoch_utc;
    ensure!(
        !args.aem || epoch.is_some(),
        "{}: epoch_utc: expected a time, for --aem, found none",
        args.config.display()
    );
    make_folder(&args.out)?;
    let on_disk = || format!("{}: cannot keep the attitude there", args.out.display());
    let mut spool = Spool::in_folder(&args.out).with_context(on_disk)?;
    let mut kept = Ok(());
    let summary = solve(&flight, |row| {
        if kept.is_ok() {
            kept = spool.push(&row);
        }
    });
    kept.with_context(on_disk)?;
    ensure!(!spool.is_empty(), "{}: no rows", args.imu.display());
    if args.smooth {
        let (mut at, mut kept) = (spool.len(), Ok(()));
        let smoothed = smooth(&flight, |row| {
            at -= 1;
            if kept.is_ok() {
                kept = spool.replace(at, &row);
            }
        });
        smoothed.context("the flight cannot be smoothed: a covariance is not positive")?;
        kept.with_context(on_disk)?;
    }
    let (counts, stretches) = args.look_over(&mut spool).with_context(on_disk)?;
    args.write(&mut spool, &counts, stretches, epoch)?;
    let page = page::page(&flight.settings, &summary, &counts)?;
    let path = args.out.join("report.html");
    std::fs::write(&path, page).with_context(|| format!("{}: cannot write", path.display()))?;
    let refused = summary.innovations.iter();
    let refused = refused
        .filter(|one| one.verdict == Verdict::Refused)
        .count();
    say(format_args!(
        "{} rows: {} aligned, {} coasting, {} waiting, {} after {} restarts; {refused} of {} measurements refused",
        counts.rows(),
        counts.aligned,
        counts.coasting,
        counts.waiting,
        counts.restarted,
        summary.restarts,
        summary.innovations.len()
    ))?;
    Ok(match counts.waiting < counts.rows() {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    })
}

impl NavigateArgs {
    fn read(&self) -> anyhow::Result<Flight> {
        let settings = Settings::read(&self.config)?;
        let imu = read_imu(&self.imu, &settings)?;
        let fixes = read_gps(&self.gps, &settings)?;
        let seen = read_vectors(&self.vectors, &settings)?;
        let measurements = self.measurements(&settings, &fixes, &seen)?;
        Ok(Flight {
            settings,
            imu,
            measurements,
        })
    }

    /// Counts all rows, and the stretches of those that are written.
    fn look_over(&self, spool: &mut Spool) -> std::io::Result<(Counts, Stretches)> {
        let (mut counts, mut stretches) = (Counts::default(), Stretches::default());
        let mut due = Due::every(self.rate);
        for row in spool.rows()? {
            let row = row?;
            counts.count(&row);
            if due.takes(&row) {
                counts.written += 1;
                stretches.note(&row);
            }
        }
        Ok((counts, stretches))
    }

    /// The rows that are written.
    fn due<'a>(
        &self,
        spool: &'a mut Spool,
    ) -> anyhow::Result<impl Iterator<Item = std::io::Result<Row>> + use<'a>> {
        let mut due = Due::every(self.rate);
        let rows = spool.rows().context("the attitude cannot be read again")?;
        Ok(rows.filter(move |row| row.as_ref().map_or(true, |row| due.takes(row))))
    }

    fn write(
        &self,
        spool: &mut Spool,
        counts: &Counts,
        stretches: Stretches,
        epoch: Option<Timestamp>,
    ) -> anyhow::Result<()> {
        write_csv(&self.out.join("attitude.csv"), self.due(spool)?)?;
        if self.fits {
            let path = self.out.join("attitude.fits");
            write_fits(&path, epoch, counts.written, self.due(spool)?)?;
        }
        match epoch.filter(|_| self.aem) {
            Some(epoch) => write_aem(
                &self.out.join("attitude.aem"),
                epoch,
                stretches,
                self.due(spool)?,
            ),
            None => Ok(()),
        }
    }

    /// All measurements in the order of time; of the same time the directions first.
    fn measurements(
        &self,
        settings: &Settings,
        fixes: &[Fix],
        seen: &[Seen],
    ) -> anyhow::Result<Vec<Measurement>> {
        let sky = match (settings.epoch_utc, &self.sun) {
            (Some(epoch), _) => Sky::Ephemeris {
                ephemeris: Box::new(options::ephemeris(&options::config(None)?)?),
                epoch,
            },
            (None, Some(path)) => Sky::Sun(read_sun(path)?),
            (None, None) => Sky::Unknown,
        };
        let mut targets = Targets::new(sky, fixes.to_vec());
        let mut measurements = Vec::with_capacity(fixes.len() + seen.len());
        for one in seen {
            let towards = match one.target {
                Target::Nadir => Towards::Down,
                target => Towards::Known(targets.direction(target, one.t_s).map_err(|why| {
                    one.without(&self.vectors, "a target whose direction is known", why)
                })?),
            };
            measurements.push(Measurement::Sighting(Sighting {
                t_s: one.t_s,
                camera: one.camera,
                target: one.target,
                unit: one.unit,
                sigma_rad: one.sigma_rad,
                towards,
            }));
        }
        measurements.extend(fixes.iter().map(|fix| Measurement::Fix(*fix)));
        measurements.sort_by(|a, b| a.t_s().total_cmp(&b.t_s()));
        Ok(measurements)
    }
}

/// Rows by their status.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Counts {
    pub aligned: u64,
    pub coasting: u64,
    pub waiting: u64,
    pub restarted: u64,
    /// At the rate that is wanted.
    pub written: u64,
}

impl Counts {
    pub fn rows(&self) -> u64 {
        self.aligned + self.coasting + self.waiting + self.restarted
    }

    fn count(&mut self, row: &Row) {
        use crate::navigation::Status::{Aligned, Coasting, Restarted, Waiting};
        match row.status {
            Aligned => self.aligned += 1,
            Coasting => self.coasting += 1,
            Waiting => self.waiting += 1,
            Restarted => self.restarted += 1,
        }
    }
}

/// Which rows are due at a rate.
struct Due {
    period_s: Option<f64>,
    /// From when on the next row is due.
    from_s: f64,
}

impl Due {
    /// All rows, where no rate is stated.
    fn every(rate_hz: Option<f64>) -> Self {
        Self {
            period_s: rate_hz.map(f64::recip),
            from_s: f64::NEG_INFINITY,
        }
    }

    fn takes(&mut self, row: &Row) -> bool {
        let Some(period_s) = self.period_s else {
            return true;
        };
        // A hundredth of a period early is in time: times are rounded.
        let is_due = row.t_s >= self.from_s - 0.01 * period_s;
        if is_due {
            self.from_s = (row.t_s / period_s + 0.01).floor() * period_s + period_s;
        }
        is_due
    }
}
