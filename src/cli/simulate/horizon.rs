//! `solaspect simulate --horizon`: frames of the Earth's limb.

use super::truth::{TruthFile, write_file};
use super::{SimulateArgs, Within};
use crate::cli::output::progress_bar;
use crate::fits::{self, Compression};
use crate::instrument::DirectionCamera;
use crate::simulate::earth::{Aim, Air, Clouds, EarthConditions, EarthScene, Glow, Haze, Shape};
use anyhow::ensure;
use clap::{Args, ValueEnum};
use nalgebra::{Matrix3, Rotation3};

/// The first line of `truth.csv`. The nadir is in the camera frame (x right, y down, z forward); `in_view` is 1 if some of the
/// limb's edge is in the picture; `edge_m` is the height of that edge; bx, by, bz is the nadir in the body's axes, for a pair; `lit` is the fraction
/// of the edge in the picture on which the Sun shines.
const TRUTH_HEADER: &str = "n,file,nx,ny,nz,roll_deg,pitch_deg,height_m,heading_deg,in_view,edge_m,latitude_deg,bx,by,bz,lit";

/// The mountings of a pair: rows of the rotation from the camera to a body whose axes point forward, right and down.
const PAIR: [(&str, [[f64; 3]; 3]); 2] = [
    ("camA", [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    ("camB", [[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]),
];

#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Horizon")]
pub struct HorizonArgs {
    /// Frames of the Earth's limb instead; --instrument is then a camera's file [default: 1920 x 1080 px, 94.4 deg across], and one
    /// is written to the folder
    #[arg(long, conflicts_with_all = ["drift", "partial", "no_sun", "smear"])]
    pub horizon: bool,
    /// Height of the camera
    #[arg(long, value_name = "H", default_value_t = 38_000.0, requires = "horizon", value_parser = Within(1_000.0, 1e8, "m"))]
    height_m: f64,
    /// Where the camera points
    #[arg(long, value_enum, default_value_t = AimAt::Horizon, requires = "horizon")]
    aim: AimAt,
    /// Largest roll either way; with --aim down, the largest tilt
    #[arg(long, value_name = "DEG", default_value_t = 30.0, requires = "horizon", value_parser = Within(0.0, 180.0, "deg"))]
    most_roll: f64,
    /// Share of the ground under clouds
    #[arg(long, value_name = "F", requires = "horizon", value_parser = Within(0.0, 1.0, ""))]
    clouds: Option<f64>,
    /// How the limb's brightness varies along it, relative, 1 sigma
    #[arg(long, value_name = "F", default_value_t = 0.0, requires = "horizon", value_parser = Within(0.0, 0.5, ""))]
    limb_brightness: f64,
    /// How the limb's height varies along it, 1 sigma
    #[arg(long, value_name = "M", default_value_t = 0.0, requires = "horizon", value_parser = Within(0.0, 10_000.0, "m"))]
    limb_height_m: f64,
    /// Night on a part of the Earth
    #[arg(long, requires = "horizon")]
    terminator: bool,
    /// What else is in the picture; several with commas
    #[arg(
        long,
        value_enum,
        value_name = "WHAT",
        value_delimiter = ',',
        requires = "horizon"
    )]
    in_view: Vec<InView>,
    /// Height over which the air's density falls to 1/e
    #[arg(long, value_name = "M", default_value_t = Air::CLEAR.scale_m, requires = "horizon", value_parser = Within(3_000.0, 15_000.0, "m"))]
    air_scale_m: f64,
    /// A layer of haze at this height
    #[arg(long, value_name = "M", requires = "horizon", value_parser = Within(1_000.0, 60_000.0, "m"))]
    haze_m: Option<f64>,
    /// Brightness of the airglow
    #[arg(long, value_name = "DN", default_value_t = 0.0, requires = "horizon", value_parser = Within(0.0, 100.0, "DN"))]
    airglow: f64,
    /// The Sun in the picture, with flares
    #[arg(long, requires = "horizon")]
    flares: bool,
    /// Turn of the camera during the exposure
    #[arg(long, value_name = "DEG", default_value_t = 0.0, requires = "horizon", value_parser = Within(-20.0, 20.0, "deg"))]
    spin: f64,
    /// Two cameras of one vehicle, the axis of the second to the right of the first one's
    #[arg(long, requires = "horizon")]
    pair: bool,
    /// The ground is the WGS 84 ellipsoid, and straight down is its normal
    #[arg(long, requires = "horizon")]
    ellipsoid: bool,
}

/// Things beside the Earth, or before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum InView {
    /// Struts and banners of the vehicle
    Structure,
    /// A full Moon
    Moon,
    /// Stray light that grows across the picture
    Gradient,
    /// Light above the limb that falls off over degrees
    Glow,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum AimAt {
    /// At the horizon
    Horizon,
    /// Down: from high enough, the whole Earth is in view
    Down,
    /// Away from the Earth
    Space,
}

/// A camera of the vehicle, with the beginning of its files' names.
struct VehicleCamera {
    frames: &'static str,
    file: String,
    toml: String,
    body_from_camera: Option<Rotation3<f64>>,
}

/// The one camera, or those of a pair.
fn cameras(args: &SimulateArgs, toml: &str) -> anyhow::Result<Vec<VehicleCamera>> {
    if !args.horizon.pair {
        return Ok(vec![VehicleCamera {
            frames: "frame",
            file: "cam.toml".into(),
            toml: toml.into(),
            body_from_camera: None,
        }]);
    }
    ensure!(
        !toml.contains("body_from_camera"),
        "--pair: expected a camera's file without body_from_camera, which differs between the two"
    );
    let mounted = |(name, rows): (&'static str, [[f64; 3]; 3])| {
        let matrix = Matrix3::from_fn(|row, column| rows[row][column]);
        VehicleCamera {
            frames: name,
            file: format!("{name}.toml"),
            toml: format!("{}\nbody_from_camera = {rows:?}\n", toml.trim_end()),
            body_from_camera: Some(Rotation3::from_matrix_unchecked(matrix)),
        }
    };
    Ok(PAIR.into_iter().map(mounted).collect())
}

/// Makes the frames, `truth.csv` and the camera's file `cam.toml`, or those of both cameras of a pair.
pub(super) fn run(args: &SimulateArgs) -> anyhow::Result<()> {
    let (conditions, camera_toml) = conditions(args)?;
    let cameras = cameras(args, &camera_toml)?;
    let mut truth = TruthFile::create(&args.out, TRUTH_HEADER)?;
    for camera in &cameras {
        write_file(&args.out, &camera.file, &camera.toml)?;
    }
    let progress = progress_bar(args.frames as usize, "frames");
    for number in 0..args.frames {
        let first = conditions.scene(args.seed, number);
        for camera in &cameras {
            let scene = match (cameras[0].body_from_camera, camera.body_from_camera) {
                (Some(of_first), Some(own)) if own != of_first => {
                    first.seen_by(&(of_first.inverse() * own))
                }
                _ => first.clone(),
            };
            let name = format!("{}_{number:05}.fits", camera.frames);
            let mut frame = scene.frame()?;
            frame.info.mid_exposure = Some(args.utc_at(number as f64)?);
            fits::write_frame(&args.out.join(&name), &frame, &[], &[], Compression::Rice)?;
            let line = truth_line(number, &name, &scene, camera.body_from_camera.as_ref());
            truth.row(&line)?;
        }
        progress.inc(1);
    }
    progress.finish_and_clear();
    Ok(())
}

fn truth_line(
    number: u64,
    name: &str,
    scene: &EarthScene,
    body_from_camera: Option<&Rotation3<f64>>,
) -> String {
    let truth = scene.truth();
    let [x, y, z]: [f64; 3] = truth.nadir.into_inner().into();
    let body = body_from_camera.map_or(",,".into(), |turn| {
        let down = turn * truth.nadir;
        format!("{:.9},{:.9},{:.9}", down.x, down.y, down.z)
    });
    format!(
        "{number},{name},{x:.9},{y:.9},{z:.9},{:.7},{:.7},{:.3},{:.4},{},{:.1},{:.6},{body},{:.3}",
        scene.roll_deg,
        scene.pitch_deg,
        scene.conditions.height_m,
        scene.heading_deg,
        u8::from(truth.arc_px > 0.0),
        truth.edge_m,
        scene.latitude_deg,
        truth.lit,
    )
}

/// The scenes' conditions, and the text of the camera's file.
fn conditions(args: &SimulateArgs) -> anyhow::Result<(EarthConditions, String)> {
    let horizon = &args.horizon;
    let plain = EarthConditions::clear(horizon.height_m);
    let (camera, text) = match &args.instrument {
        Some(path) => {
            let text = crate::instrument::text_of(path)?;
            (DirectionCamera::parse(path, &text)?, text)
        }
        None => plain_camera(&plain),
    };
    let has = |what: InView| horizon.in_view.contains(&what);
    let conditions = EarthConditions {
        camera: camera.lens,
        width_px: camera.width_px,
        height_px: camera.height_px,
        shape: match horizon.ellipsoid {
            true => Shape::WGS84,
            false => Shape::SPHERE,
        },
        aim: match horizon.aim {
            AimAt::Horizon => Aim::Horizon {
                most_roll_deg: horizon.most_roll,
            },
            AimAt::Down => Aim::Down {
                most_tilt_deg: horizon.most_roll,
            },
            AimAt::Space => Aim::Space,
        },
        air: Air {
            varies_by: horizon.limb_brightness,
            varies_by_m: horizon.limb_height_m,
            scale_m: horizon.air_scale_m,
            haze: horizon.haze_m.map(|height_m| Haze {
                height_m,
                ..Haze::THIN
            }),
            airglow_dn: horizon.airglow,
            ..Air::CLEAR
        },
        clouds: horizon.clouds.map(|cover| Clouds {
            cover,
            ..Clouds::BRIGHT
        }),
        terminator: horizon.terminator,
        sun: horizon.flares,
        glow: has(InView::Glow).then_some(Glow::BRIGHT),
        structure: has(InView::Structure),
        moon: has(InView::Moon),
        gradient: has(InView::Gradient),
        spin_deg: horizon.spin,
        blur_px: args.optics.blur.unwrap_or(plain.blur_px),
        background_dn: args.camera.background,
        noise: args.noise(),
        depth: args.depth(),
        ..plain
    };
    Ok((conditions, text))
}

/// The camera of the clear conditions with its file.
fn plain_camera(plain: &EarthConditions) -> (DirectionCamera, String) {
    let camera = DirectionCamera {
        width_px: plain.width_px,
        height_px: plain.height_px,
        lens: plain.camera,
        body_from_camera: None,
        mask: Vec::new(),
    };
    let text = format!(
        "[camera]\nwidth_px = {}\nheight_px = {}\ncentre_px = [{:.1}, {:.1}]\nfocal_px = [{f}, {f}]\n",
        plain.width_px,
        plain.height_px,
        (plain.width_px as f64 - 1.0) / 2.0,
        (plain.height_px as f64 - 1.0) / 2.0,
        f = plain.camera.mean_focal_px(),
    );
    (camera, text)
}
