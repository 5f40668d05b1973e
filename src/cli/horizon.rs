//! `solaspect horizon`: frames of the Earth's limb in, the nadir out.

use super::frames::{Answer, FramesArgs, Printer, Row, bad_file};
use crate::fits;
use crate::horizon::{self, Refraction, Settings, Solution, Sphere};
use crate::instrument::DirectionCamera;
use crate::units::Measured;
use anyhow::Context;
use clap::Args;
use nalgebra::UnitVector3;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Find the nadir in frames of the Earth's horizon: roll and pitch of the camera
///
/// Reads what `solve` reads. One answer per frame, in the order of the arguments. A frame without a horizon is no failure; a
/// file that cannot be read gives an error on its line, the rest go on, and the exit code is 1.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub struct HorizonArgs {
    #[command(flatten)]
    frames: FramesArgs,
    /// The camera's TOML file: size, principal point, focal lengths, distortion, masks
    #[arg(long, value_name = "CAM.toml")]
    instrument: PathBuf,
    /// The camera's height above the sphere of 6371 km
    #[arg(long, value_name = "H")]
    height_m: f64,
    /// 1 sigma of that height
    #[arg(long, value_name = "M", default_value_t = 0.0)]
    height_sigma_m: f64,
    /// The height at which the limb has half of its brightness above the dark sky
    #[arg(long, value_name = "D", default_value_t = 0.0)]
    atmosphere_m: f64,
    /// 1 sigma of the edge's height, all along the limb alike
    #[arg(long, value_name = "M", default_value_t = 0.0)]
    edge_sigma_m: f64,
    /// Bend rays by the air's refraction (standard atmosphere) [default: straight rays]
    #[arg(long)]
    refraction: bool,
    /// Pixels of at least this many DN are bright [default: by the frame's own light]
    #[arg(long, value_name = "DN")]
    threshold_dn: Option<f64>,
    /// Look near the last frame's horizon first
    #[arg(long, conflicts_with = "jobs")]
    track: bool,
}

pub fn run(args: HorizonArgs) -> anyhow::Result<ExitCode> {
    let batch = Batch {
        camera: DirectionCamera::read(&args.instrument)?,
        sphere: args.sphere()?,
        settings: Settings {
            threshold_dn: args.threshold_dn,
            ..Settings::default()
        },
        args: &args.frames,
    };
    batch.args.prepare()?;
    let mut printer = Printer::new::<Record>(args.frames.format)?;
    let progress = args.frames.progress();
    let mut failed = false;
    let mut take = |answer: Answer<Record>| -> anyhow::Result<()> {
        failed |= answer.is_err();
        progress.suspend(|| printer.print(&answer))?;
        progress.inc(1);
        Ok(())
    };
    if args.track {
        let mut last = None;
        for path in &args.frames.frames {
            let (answer, nadir) = batch.solve_file(path, last.as_ref());
            last = nadir.or(last);
            take(answer)?;
        }
    } else {
        let solve = |path: &PathBuf| batch.solve_file(path, None).0;
        args.frames.in_order(&args.frames.frames, solve, take)?;
    }
    progress.finish_and_clear();
    Ok(match failed {
        true => ExitCode::FAILURE,
        false => ExitCode::SUCCESS,
    })
}

impl HorizonArgs {
    fn sphere(&self) -> anyhow::Result<Sphere> {
        let height = Measured::new(self.height_m, self.height_sigma_m);
        let edge = Measured::new(self.atmosphere_m, self.edge_sigma_m);
        for (name, sigma) in [("height", height.sigma), ("edge", edge.sigma)] {
            anyhow::ensure!(
                sigma.is_finite() && sigma >= 0.0,
                "--{name}-sigma-m: expected 0 or more, found {sigma}"
            );
        }
        let refraction = match self.refraction {
            true => Refraction::StandardAir,
            false => Refraction::None,
        };
        Sphere::earth(height, edge, refraction).with_context(|| {
            format!(
                "--height-m: expected a camera above the edge of the limb at {} m, found {} m",
                edge.value, height.value
            )
        })
    }
}

/// What all frames of a batch share.
struct Batch<'a> {
    camera: DirectionCamera,
    sphere: Sphere,
    settings: Settings,
    args: &'a FramesArgs,
}

impl Batch<'_> {
    fn solve_file(
        &self,
        path: &Path,
        last: Option<&UnitVector3<f64>>,
    ) -> (Answer<Record>, Option<UnitVector3<f64>>) {
        match self.try_solve(path, last) {
            Ok((record, nadir)) => (Ok(record), nadir),
            Err(error) => (bad_file(path, &error), None),
        }
    }

    fn try_solve(
        &self,
        path: &Path,
        last: Option<&UnitVector3<f64>>,
    ) -> anyhow::Result<(Record, Option<UnitVector3<f64>>)> {
        let frame = fits::read_frame(path)?;
        let size = self.camera.check(&frame);
        size.with_context(|| path.display().to_string())?;
        let start = Instant::now();
        let solution = horizon::solve(&self.settings, &frame, &self.camera, &self.sphere, last);
        let time = start.elapsed();
        self.args.draw(path, |title| {
            horizon::overlay(&frame, &solution, &self.camera, &self.sphere, title)
        })?;
        let nadir = solution.nadir.as_ref().ok();
        let unit = nadir.map(|nadir| nadir.direction.unit);
        Ok((
            Record::new(&path.display().to_string(), &solution, time),
            unit,
        ))
    }
}

/// What is said of a frame.
#[derive(Serialize)]
struct Record {
    file: String,
    quality: &'static str,
    reason: Option<Reason>,
    nadir: Option<[f64; 3]>,
    sigma_deg: Option<f64>,
    covariance: Option<[[f64; 3]; 3]>,
    roll_deg: Option<f64>,
    pitch_deg: Option<f64>,
    conic: Option<&'static str>,
    /// Points of the edge, and those of them that agree with the nadir.
    edge_points: usize,
    agreeing_points: usize,
    solve_us: u64,
}

#[derive(Serialize)]
struct Reason {
    stage: &'static str,
    reason: &'static str,
    measured: f64,
    limit: f64,
}

impl Record {
    fn new(file: &str, solution: &Solution, time: Duration) -> Self {
        let nadir = solution.nadir.as_ref().ok();
        let stopped = solution.nadir.as_ref().err();
        Self {
            file: file.into(),
            quality: solution.quality().name(),
            reason: stopped.map(|(stage, rejected)| Reason {
                stage: stage.name(),
                reason: rejected.reason,
                measured: rejected.measured,
                limit: rejected.limit,
            }),
            nadir: nadir.map(|nadir| nadir.direction.unit.into_inner().into()),
            sigma_deg: nadir.map(horizon::Nadir::sigma_deg),
            covariance: nadir.map(|nadir| nadir.direction.covariance_rad2.transpose().into()),
            roll_deg: nadir.map(horizon::Nadir::roll_deg),
            pitch_deg: nadir.map(horizon::Nadir::pitch_deg),
            conic: nadir.map(|nadir| nadir.conic.name()),
            edge_points: solution.edge.len(),
            agreeing_points: solution.agreeing(),
            solve_us: time.as_micros() as u64,
        }
    }

    fn reason_text(&self) -> String {
        let reason = self.reason.as_ref();
        reason.map_or(String::new(), |r| format!("{}: {}", r.stage, r.reason))
    }
}

impl Row for Record {
    fn csv_columns() -> Vec<&'static str> {
        vec![
            "file",
            "quality",
            "reason",
            "nadir_x",
            "nadir_y",
            "nadir_z",
            "sigma_deg",
            "covariance_xx_rad2",
            "covariance_xy_rad2",
            "covariance_xz_rad2",
            "covariance_yy_rad2",
            "covariance_yz_rad2",
            "covariance_zz_rad2",
            "roll_deg",
            "pitch_deg",
            "conic",
            "edge_points",
            "agreeing_points",
            "solve_us",
        ]
    }

    fn csv_row(&self) -> Vec<String> {
        let number = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.9}"));
        let small = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.6e}"));
        let mut row = vec![self.file.clone(), self.quality.into(), self.reason_text()];
        row.extend((0..3).map(|n| number(self.nadir.map(|nadir| nadir[n]))));
        row.push(number(self.sigma_deg));
        let upper = (0..3).flat_map(|i| (i..3).map(move |j| (i, j)));
        row.extend(upper.map(|(i, j)| small(self.covariance.map(|c| c[i][j]))));
        row.extend([self.roll_deg, self.pitch_deg].map(number));
        row.push(self.conic.unwrap_or_default().into());
        let counts = [
            self.edge_points as u64,
            self.agreeing_points as u64,
            self.solve_us,
        ];
        row.extend(counts.map(|count| count.to_string()));
        row
    }

    fn table_columns() -> &'static [(&'static str, usize)] {
        &[
            ("", 6),
            ("roll, deg", 11),
            ("pitch, deg", 11),
            ("sigma, deg", 10),
            ("nadir x, y, z", 31),
            ("points", 6),
            (" reason", 0),
        ]
    }

    fn table_row(&self) -> (&str, Vec<String>) {
        let number = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.4}"));
        let nadir = self
            .nadir
            .map_or(String::new(), |[x, y, z]| format!("{x:.6}, {y:.6}, {z:.6}"));
        let fields = vec![
            self.quality.into(),
            number(self.roll_deg),
            number(self.pitch_deg),
            number(self.sigma_deg),
            nadir,
            self.agreeing_points.to_string(),
            format!(" {}", self.reason_text()),
        ];
        (&self.file, fields)
    }
}
