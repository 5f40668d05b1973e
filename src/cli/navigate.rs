//! `solaspect navigate`: the attitude by gyros between and beyond what cameras see.

mod page;

use super::options;
use super::output::{make_folder, say};
use crate::navigation::files::{Seen, read_gps, read_imu, read_sun, read_vectors};
use crate::navigation::{
    Fix, Flight, Measurement, Row, Settings, Sighting, Sky, Target, Targets, Towards, Verdict,
    smooth, solve,
};
use anyhow::{Context, ensure};
use clap::Args;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const COLUMNS: &str = "t_s,q0,q1,q2,q3,sx_rad,sy_rad,sz_rad,pxy_rad2,pxz_rad2,pyz_rad2,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,status";

/// Find a vehicle's attitude from its gyros, GPS, and the directions that cameras have seen
///
/// Writes attitude.csv (the attitude at each sample of the IMU: v_ecef = R(q) v_body, its errors about the axes of ECEF) and
/// report.html to the folder. docs/navigation.md has the files' columns.
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
}

fn parse_rate(text: &str) -> Result<f64, String> {
    let rate: Option<f64> = text.parse().ok();
    rate.filter(|rate| (1e-3..=1e5).contains(rate))
        .ok_or_else(|| format!("expected a number from 0.001 to 100000 Hz, found \"{text}\""))
}

pub fn run(args: &NavigateArgs) -> anyhow::Result<ExitCode> {
    let flight = args.read()?;
    make_folder(&args.out)?;
    let mut table = AttitudeTable::create(&args.out.join("attitude.csv"), args.rate)?;
    let mut rows = Vec::new();
    let mut written = Ok(());
    let summary = solve(&flight, |row| {
        if args.smooth {
            rows.push(row);
        } else if written.is_ok() {
            written = table.add(&row);
        }
    });
    written?;
    if args.smooth {
        let mut at = rows.len();
        let smoothed = smooth(&flight, |row| {
            at -= 1;
            rows[at] = row;
        });
        smoothed.context("the flight cannot be smoothed: a covariance is not positive")?;
        rows.iter().try_for_each(|row| table.add(row))?;
    }
    let counts = table.finish()?;
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
        let imu = read_imu(&self.imu)?;
        let fixes = read_gps(&self.gps)?;
        let seen = read_vectors(&self.vectors, &settings)?;
        let measurements = self.measurements(&settings, &fixes, &seen)?;
        Ok(Flight {
            settings,
            imu,
            measurements,
        })
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
        let mut targets = Targets::new(sky, fixes);
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

/// attitude.csv while it is written.
struct AttitudeTable {
    path: PathBuf,
    file: BufWriter<File>,
    period_s: Option<f64>,
    /// From when on the next row is due.
    due_s: f64,
    counts: Counts,
}

impl AttitudeTable {
    fn create(path: &Path, rate_hz: Option<f64>) -> anyhow::Result<Self> {
        let file =
            File::create(path).with_context(|| format!("{}: cannot write", path.display()))?;
        let mut table = Self {
            path: path.into(),
            file: BufWriter::with_capacity(1 << 20, file),
            period_s: rate_hz.map(f64::recip),
            due_s: f64::NEG_INFINITY,
            counts: Counts::default(),
        };
        table.write(|file| writeln!(file, "{COLUMNS}"))?;
        Ok(table)
    }

    fn write(
        &mut self,
        write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
    ) -> anyhow::Result<()> {
        let path = &self.path;
        write(&mut self.file).with_context(|| format!("{}: cannot write", path.display()))
    }

    fn add(&mut self, row: &Row) -> anyhow::Result<()> {
        self.counts.count(row);
        if let Some(period_s) = self.period_s {
            // A hundredth of a period early is in time: times are rounded.
            if row.t_s < self.due_s - 0.01 * period_s {
                return Ok(());
            }
            self.due_s = (row.t_s / period_s + 0.01).floor() * period_s + period_s;
        }
        self.write(|file| write_row(file, row))
    }

    fn finish(mut self) -> anyhow::Result<Counts> {
        ensure!(self.counts.rows() > 0, "{}: no rows", self.path.display());
        self.write(BufWriter::flush)?;
        Ok(self.counts)
    }
}

fn write_row(file: &mut impl Write, row: &Row) -> std::io::Result<()> {
    write!(file, "{}", row.t_s)?;
    let Some((motion, covariance)) = &row.attitude else {
        return writeln!(file, ",,,,,,,,,,,,,,,,,{}", row.status.name());
    };
    let q = motion.attitude.quaternion();
    let q = if q.w < 0.0 { -q } else { *q };
    for value in [q.w, q.i, q.j, q.k] {
        write!(file, ",{value:.15}")?;
    }
    for n in 0..3 {
        write!(file, ",{:.14e}", covariance[(n, n)].max(0.0).sqrt())?;
    }
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        write!(file, ",{:.14e}", covariance[(a, b)])?;
    }
    for value in motion.position_m.iter() {
        write!(file, ",{value:.4}")?;
    }
    for value in motion.velocity_m_s.iter() {
        write!(file, ",{value:.6}")?;
    }
    writeln!(file, ",{}", row.status.name())
}
