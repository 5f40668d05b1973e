//! `solaspect simulate --moon`: frames of the Moon.

use super::truth::{TruthFile, write_file};
use super::{SimulateArgs, Within};
use crate::cli::output::progress_bar;
use crate::fits::{self, Compression};
use crate::instrument::DirectionCamera;
use crate::moon::Shading;
use crate::simulate::moon::{MoonConditions, MoonScene, Shown};
use anyhow::ensure;
use clap::{Args, ValueEnum};

/// The first line of `truth.csv`. x and y are those of the whole disc's centre, radius is its vertical half axis and rx the horizontal one, px; the
/// position angle of the middle of the bright limb in the picture is chi_deg, from +x towards +y; in_view is 1 if some of the disc is in the picture.
const TRUTH_HEADER: &str = "n,file,in_view,x,y,radius,rx,phase_deg,lit,chi_deg";

#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Moon")]
pub struct MoonArgs {
    /// Frames of the Moon instead; --instrument is then a camera's file [default: 720 x 578 px, 12.4 deg across], and one is written to the folder
    #[arg(long, conflicts_with_all = ["horizon", "drift", "partial", "no_sun", "smear"])]
    pub moon: bool,
    /// Vertical half axis of the disc
    #[arg(long, value_name = "PX", default_value_t = 15.0, requires = "moon", value_parser = Within(4.0, 2000.0, "px"))]
    radius_px: f64,
    /// Lit shares, from which each frame draws its own
    #[arg(long, value_name = "LOW,HIGH", default_value = "0.1,1", requires = "moon", value_parser = parse_lit)]
    lit: Lit,
    /// How the ground scatters light
    #[arg(long, value_enum, default_value_t = Scatters::LommelSeeliger, requires = "moon")]
    shading: Scatters,
    /// Craters (relief of 0.1 % of the radius, rms) and dark and bright ground (25 % either way)
    #[arg(long, requires = "moon")]
    craters: bool,
    /// Seas: large plains half as bright as other ground
    #[arg(long, requires = "moon")]
    seas: bool,
    /// Light of the dark side, in that of the brightest limb
    #[arg(long, value_name = "F", default_value_t = 0.0, requires = "moon", value_parser = Within(0.0, 1.0, ""))]
    earthshine: f64,
    /// Number of stars in the picture
    #[arg(long, value_name = "N", default_value_t = 0, requires = "moon", value_parser = super::count())]
    stars: u16,
    /// Over-exposed by this factor
    #[arg(long, value_name = "F", default_value_t = 1.0, requires = "moon", value_parser = Within(0.1, 100.0, ""))]
    exposure: f64,
    /// The picture's edge cuts the disc
    #[arg(long, requires = "moon")]
    cut: bool,
    /// Number of planets, brighter than any star
    #[arg(long, value_name = "N", default_value_t = 0, requires = "moon", value_parser = super::count())]
    planets: u16,
    /// Light that the lens spreads around the Moon, one radius from its limb, in that of the brightest limb
    #[arg(long, value_name = "F", default_value_t = 0.0, requires = "moon", value_parser = Within(0.0, 1.0, ""))]
    glow: f64,
    /// The Sun shines into the lens from beside the picture
    #[arg(long, requires = "moon")]
    sun_glare: bool,
    /// What the picture shows
    #[arg(long, value_enum, value_name = "WHAT", default_value_t = Shows::Moon, requires = "moon")]
    shows: Shows,
}

/// A range of lit fractions.
#[derive(Debug, Clone, Copy)]
struct Lit(f64, f64);

fn parse_lit(text: &str) -> Result<Lit, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[low, high]) if 0.0 <= low && low <= high && high <= 1.0 => Ok(Lit(low, high)),
        _ => Err(format!("expected LOW,HIGH from 0 to 1, found \"{text}\"")),
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Scatters {
    /// As dark ground does
    LommelSeeliger,
    /// As chalk does
    Lambert,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Shows {
    Moon,
    /// Sky and stars alone
    Nothing,
    /// A street lamp of another size, oval, or saturated with glow
    Lamp,
    /// The unfiltered Sun
    Sun,
    /// Clouds, and the glow or the corona of a Moon behind them
    Clouds,
}

/// Makes the frames, `truth.csv` and the camera's file `cam.toml`.
pub(super) fn run(args: &SimulateArgs) -> anyhow::Result<()> {
    let (conditions, camera_toml) = conditions(args)?;
    let mut truth = TruthFile::create(&args.out, TRUTH_HEADER)?;
    write_file(&args.out, "cam.toml", &camera_toml)?;
    let progress = progress_bar(args.frames as usize, "frames");
    for number in 0..args.frames {
        let scene = conditions.scene(args.seed, number);
        let name = format!("frame_{number:05}.fits");
        let mut frame = scene.frame()?;
        frame.info.mid_exposure = Some(args.utc_at(number as f64)?);
        fits::write_frame(&args.out.join(&name), &frame, &[], &[], Compression::Rice)?;
        truth.row(&truth_line(number, &name, &scene))?;
        progress.inc(1);
    }
    progress.finish_and_clear();
    Ok(())
}

fn truth_line(number: u64, name: &str, scene: &MoonScene) -> String {
    let conditions = &scene.conditions;
    if conditions.shown != Shown::Moon {
        return format!("{number},{name},0,,,,,,,");
    }
    format!(
        "{number},{name},1,{:.6},{:.6},{:.6},{:.6},{:.5},{:.6},{:.5}",
        scene.centre.x,
        scene.centre.y,
        conditions.radius_px,
        conditions.radius_px * conditions.pixel_aspect,
        scene.phase_angle_deg,
        scene.lit(),
        scene.bright_limb_in_picture_deg(),
    )
}

/// The scenes' conditions, and the text of the camera's file.
fn conditions(args: &SimulateArgs) -> anyhow::Result<(MoonConditions, String)> {
    let moon = &args.moon;
    let plain = MoonConditions::clear(moon.radius_px);
    let (width_px, height_px, pixel_aspect, text) = match &args.instrument {
        Some(path) => {
            let text = crate::instrument::text_of(path)?;
            let camera = DirectionCamera::parse(path, &text)?;
            (
                camera.width_px,
                camera.height_px,
                camera.lens.aspect(),
                text,
            )
        }
        None => (plain.width_px, plain.height_px, 1.0, plain_camera(&plain)),
    };
    let least = 2.0 * moon.radius_px * pixel_aspect.max(1.0) + 20.0;
    ensure!(
        moon.cut || least < width_px.min(height_px) as f64,
        "--radius-px: expected a disc that the picture of {width_px} x {height_px} px holds, found {}",
        moon.radius_px
    );
    let conditions = MoonConditions {
        width_px,
        height_px,
        pixel_aspect,
        lit: moon.lit.0..moon.lit.1,
        shading: match moon.shading {
            Scatters::LommelSeeliger => Shading::LommelSeeliger,
            Scatters::Lambert => Shading::Lambert,
        },
        craters: moon.craters,
        seas: moon.seas,
        earthshine: moon.earthshine,
        stars: moon.stars.into(),
        cut: moon.cut,
        planets: moon.planets.into(),
        glow: moon.glow,
        sun_glare: moon.sun_glare,
        shown: match moon.shows {
            Shows::Moon => Shown::Moon,
            Shows::Nothing => Shown::Nothing,
            Shows::Lamp => Shown::Lamp,
            Shows::Sun => Shown::Sun,
            Shows::Clouds => Shown::Clouds,
        },
        peak_dn: plain.peak_dn * moon.exposure,
        background_dn: args.camera.background,
        noise: args.noise(),
        depth: args.depth(),
        blur_px: args.optics.blur.unwrap_or(plain.blur_px),
        ..plain
    };
    Ok((conditions, text))
}

/// The file of a camera with square pixels in which the Moon at its mean size has the disc's radius.
fn plain_camera(plain: &MoonConditions) -> String {
    /// Radius of the Moon at its mean distance.
    const RADIUS_ARCSEC: f64 = 932.4;
    let focal = plain.radius_px / (RADIUS_ARCSEC / crate::units::ARCSEC_PER_RAD).tan();
    format!(
        "[camera]\nwidth_px = {}\nheight_px = {}\ncentre_px = [{:.1}, {:.1}]\nfocal_px = [{focal:.6}, {focal:.6}]\n",
        plain.width_px,
        plain.height_px,
        (plain.width_px as f64 - 1.0) / 2.0,
        (plain.height_px as f64 - 1.0) / 2.0,
    )
}
