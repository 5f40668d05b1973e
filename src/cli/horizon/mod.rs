//! `solaspect horizon`: determines the nadir from frames of the Earth's limb.

mod batch;
mod pair;
mod record;

use super::frames::FramesArgs;
use crate::horizon::{EdgeHeight, HorizonSettings, Refraction, Sphere};
use crate::instrument::{DirectionCamera, MountedCamera};
use crate::units::{Measured, Place};
use anyhow::{Context, ensure};
use batch::{Batch, Mounted, Pair};
use clap::{Args, ValueEnum};
use nalgebra::{UnitVector3, Vector3};
use record::Record;
use std::path::PathBuf;
use std::process::ExitCode;

/// Find the nadir in frames of the Earth's horizon: roll and pitch of the camera
///
/// Reads what `solve` reads. One answer per frame, in the order of the arguments; of a pair, moment by moment. A frame without a horizon is no failure; a
/// file that cannot be read gives an error on its line, the rest go on, and the exit code is 1.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub struct HorizonArgs {
    #[command(flatten)]
    frames: FramesArgs,
    /// The camera's TOML file: size, principal point, focal lengths, distortion, masks
    #[arg(long, value_name = "CAM.toml", required_unless_present = "pair")]
    instrument: Option<PathBuf>,
    /// Two cameras of one vehicle, each with body_from_camera in its file: the nadir of both together. Frames belong to the camera
    /// whose file has the beginning of their name; else the first half of them to A, the others to B. They are matched by time (10 ms),
    /// or by order where one has none
    #[arg(long, num_args = 2, value_names = ["A.toml", "B.toml"], conflicts_with_all = ["instrument", "track"])]
    pair: Option<Vec<PathBuf>>,
    #[command(flatten)]
    edge: EdgeArgs,
    /// How the nadir is found
    #[arg(long, value_enum, default_value_t = Method::Cone)]
    method: Method,
    /// With --method circle, pixels of at least this many DN are bright [default: by the frame's own light]
    #[arg(long, value_name = "DN")]
    threshold_dn: Option<f64>,
    /// Search near the previous frame's horizon first
    #[arg(long, conflicts_with = "jobs")]
    track: bool,
}

/// Options of the edge.
#[derive(Debug, Args)]
struct EdgeArgs {
    /// The camera's height above the sphere of 6371 km
    #[arg(long, value_name = "H", conflicts_with = "place", required_unless_present_any = ["place", "disc_deg"])]
    height_m: Option<f64>,
    /// The camera's place: the horizon is then that of the WGS 84 ellipsoid, and straight down its normal
    #[arg(
        long,
        value_name = "LAT,LON,HEIGHT_M",
        allow_hyphen_values = true,
        requires = "heading_deg"
    )]
    place: Option<Place>,
    /// Azimuth of the optical axis, or with --pair of the body's first axis, from north over east
    #[arg(long, value_name = "DEG", requires = "place")]
    heading_deg: Option<f64>,
    /// 1 sigma of the camera's height
    #[arg(long, value_name = "M", default_value_t = 0.0)]
    height_sigma_m: f64,
    /// The height at which the limb has half of its brightness above the dark sky
    #[arg(long, value_name = "D", default_value_t = 0.0)]
    atmosphere_m: f64,
    /// 1 sigma of the edge's height, common to the whole limb; a twentieth of it is taken to vary along the limb
    #[arg(long, value_name = "M", default_value_t = 1_000.0)]
    edge_sigma_m: f64,
    /// Fit the edge's height, too, starting from --atmosphere-m
    #[arg(long)]
    fit_atmosphere: bool,
    /// Refract rays in the standard atmosphere [default: straight rays]
    #[arg(long)]
    refraction: bool,
    /// A sphere with a sharp edge of this angular radius instead: the Sun (0.2666) or the Moon in a plain camera
    #[arg(long, value_name = "R", conflicts_with_all = ["height_m", "place", "height_sigma_m", "atmosphere_m", "edge_sigma_m", "fit_atmosphere", "refraction"])]
    disc_deg: Option<f64>,
}

/// Sigma beyond which a height counts as unknown.
const MOST_SIGMA_M: f64 = 1e6;

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Method {
    /// Least squares of the cone of rays, by the light across the edge
    Cone,
    /// A circle through the longest border, as HORACE did
    Circle,
}

pub fn run(mut args: HorizonArgs) -> anyhow::Result<ExitCode> {
    ensure!(
        args.method == Method::Cone || !(args.track || args.edge.fit_atmosphere),
        "--method circle: expected neither --track nor --fit-atmosphere"
    );
    ensure!(
        args.method == Method::Circle || args.threshold_dn.is_none(),
        "--threshold-dn: expected with --method circle, which follows a border"
    );
    let cameras = args.cameras()?;
    args.frames.prepare()?;
    let pair = match &args.pair {
        Some(files) => Some(Pair {
            frames: pair::by_camera(&args.frames.frames, files)?,
            sphere: args.edge.sphere(Vector3::x_axis())?,
        }),
        None => None,
    };
    let batch = Batch {
        cameras,
        pair,
        method: args.method,
        settings: HorizonSettings {
            threshold_dn: args.threshold_dn,
            height: match args.edge.fit_atmosphere {
                true => EdgeHeight::Fitted,
                false => EdgeHeight::Given,
            },
            departure: None,
        },
        edge_m: args.edge.atmosphere_m,
        args: &args.frames,
    };
    args.frames
        .print::<Record>(|take| batch.solve(args.track, take))
}

impl HorizonArgs {
    /// The one camera, or the two of a pair, each with its sphere.
    fn cameras(&self) -> anyhow::Result<Vec<Mounted>> {
        let Some(files) = &self.pair else {
            let file = self.instrument.as_ref().context("expected --instrument")?;
            let camera = DirectionCamera::read(file)?;
            return Ok(vec![Mounted {
                body_from_camera: camera.body_from_camera,
                sphere: self.edge.sphere(Vector3::z_axis())?,
                camera,
            }]);
        };
        let mounted = |file: &PathBuf| {
            let MountedCamera {
                optics,
                body_from_camera,
            } = MountedCamera::read(file)?;
            let forward = body_from_camera.inverse() * Vector3::x_axis();
            Ok(Mounted {
                body_from_camera: Some(body_from_camera),
                sphere: self.edge.sphere(forward)?,
                camera: optics,
            })
        };
        files.iter().map(mounted).collect()
    }
}

impl EdgeArgs {
    /// The sphere in the frame in which `forward` has the stated heading.
    fn sphere(&self, forward: UnitVector3<f64>) -> anyhow::Result<Sphere> {
        if let Some(radius_deg) = self.disc_deg {
            ensure!(
                radius_deg > 0.0 && radius_deg < 90.0,
                "--disc-deg: expected more than 0 and less than 90, found {radius_deg}"
            );
            return Ok(Sphere::disc(Measured::new(radius_deg.to_radians(), 0.0)));
        }
        let edge = Measured::new(self.atmosphere_m, self.edge_sigma_m);
        for (name, sigma) in [("height", self.height_sigma_m), ("edge", edge.sigma)] {
            ensure!(
                (0.0..=MOST_SIGMA_M).contains(&sigma),
                "--{name}-sigma-m: expected 0 to {MOST_SIGMA_M} m, found {sigma}"
            );
        }
        let refraction = match self.refraction {
            true => Refraction::StandardAir,
            false => Refraction::None,
        };
        let (option, height_m, sphere) = match (self.place, self.height_m) {
            (Some(place), _) => {
                let heading_deg = self.heading_deg.context("expected --heading-deg")?;
                ensure!(
                    heading_deg.is_finite(),
                    "--heading-deg: expected a number of degrees, found {heading_deg}"
                );
                let sigma_m = self.height_sigma_m;
                let sphere =
                    Sphere::earth_at(&place, sigma_m, edge, refraction, heading_deg, forward);
                ("--place", place.height_m, sphere)
            }
            (None, Some(height_m)) => {
                let height = Measured::new(height_m, self.height_sigma_m);
                (
                    "--height-m",
                    height_m,
                    Sphere::earth(height, edge, refraction),
                )
            }
            (None, None) => anyhow::bail!("expected --height-m or --place"),
        };
        sphere.with_context(|| {
            format!(
                "{option}: expected a camera above the edge of the limb at {} m, found {height_m} m",
                edge.value
            )
        })
    }
}
