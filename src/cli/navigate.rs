//! `solaspect navigate`: the attitude by gyros between and after observations of cameras.

use super::attitude::{self, AttitudeArgs};
use super::options;
use super::output::make_folder;
use crate::navigation::files::{CameraVector, read_gps, read_imu, read_sun, read_vectors};
use crate::navigation::{
    DirectionObservation, Fix, Flight, Measurement, NavigationSettings, Sky, Targets,
};
use crate::refine::{Attitude, Basis, NavigationFile, add_attitude};
use crate::report::html::Page;
use crate::tables::LeftOut;
use anyhow::{Context, ensure};
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;

/// Estimate a vehicle's attitude from gyros, GPS, and directions measured by cameras
///
/// Writes attitude.csv (the attitude at each sample of the IMU: v_ecef = R(q) v_body, its errors about the axes of ECEF) and
/// report.html to the folder, and other forms of it on request. docs/navigation.md has the files' columns.
#[derive(Debug, Args)]
pub struct NavigateArgs {
    /// The sensors: NAV.toml (docs/navigation.md)
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
    /// Directions to the Sun in ECEF, for data without an epoch_utc, where the ephemeris cannot give them
    #[arg(long, value_name = "CSV")]
    sun: Option<PathBuf>,
    /// The folder for attitude.csv and report.html
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Smooth: use all measurements of the flight, not only those up to each time
    #[arg(long)]
    smooth: bool,
    /// Write attitude.fits, too: the table ATTITUDE
    #[arg(long)]
    fits: bool,
    #[command(flatten)]
    wanted: AttitudeArgs,
}

pub fn run(args: &NavigateArgs) -> anyhow::Result<ExitCode> {
    let given = NavigationFile::read(&args.config)?;
    let epoch = given.settings.epoch_utc;
    ensure!(
        !args.wanted.aem || epoch.is_some(),
        "{}: epoch_utc: expected a time, for --aem, found none",
        args.config.display()
    );
    let runs = args.read(&given.settings)?;
    make_folder(&args.out)?;
    let basis = match args.smooth {
        true => Basis::WholeFlight,
        false => Basis::UpToThen,
    };
    let wanted = args.wanted.wanted();
    let mut attitude = Attitude::solve(&runs, basis, &args.out, &wanted)?;
    attitude.write(epoch, args.fits)?;
    attitude.write_calibrated(&given, epoch, args.files())?;
    let (summary, counts) = (&attitude.summary, &attitude.counts);
    let mut page = Page::default();
    add_attitude(&mut page, &given.settings, summary, counts)?;
    let path = args.out.join("report.html");
    std::fs::write(&path, page.finish("Navigation"))
        .with_context(|| format!("{}: cannot write", path.display()))?;
    attitude::print(&attitude.found())
}

impl NavigateArgs {
    fn files(&self) -> Vec<String> {
        let files = [&self.imu, &self.gps, &self.vectors].into_iter();
        let files = files.chain(&self.sun);
        files.map(|path| path.display().to_string()).collect()
    }

    /// The runs of the flight.
    fn read(&self, settings: &NavigationSettings) -> anyhow::Result<Vec<Flight>> {
        let one = std::slice::from_ref::<PathBuf>;
        let imu = read_imu(one(&self.imu), settings)?;
        let fixes = read_gps(one(&self.gps), settings)?;
        let seen = read_vectors(&self.vectors, settings)?;
        let measurements = self.measurements(settings, &fixes, &seen)?;
        Ok(Flight::of_runs(settings, imu, measurements))
    }

    /// All measurements in the order of time.
    fn measurements(
        &self,
        settings: &NavigationSettings,
        fixes: &[Fix],
        seen: &[CameraVector],
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
        let mut observations: Vec<DirectionObservation> = Vec::with_capacity(seen.len());
        let mut unknown = Vec::new();
        for one in seen {
            match targets.towards(one.target, one.t_s) {
                Ok(towards) => observations.push(DirectionObservation {
                    t_s: one.t_s,
                    camera: one.camera,
                    target: one.target,
                    unit: one.unit,
                    sigma_rad: one.sigma_rad,
                    towards,
                }),
                Err(why) => unknown.push((one, why)),
            }
        }
        let mut left_out = LeftOut::of(&self.vectors);
        for (one, why) in unknown {
            let bad = one.without(why);
            // One row may have a wrong time; but if a target is never known, all of its rows are unusable.
            if !observations.iter().any(|other| other.target == one.target) {
                return Err(bad.at(&self.vectors, one.line).into());
            }
            left_out.note(one.line, bad);
        }
        left_out.warn();
        Ok(Measurement::in_order(observations, fixes))
    }
}
