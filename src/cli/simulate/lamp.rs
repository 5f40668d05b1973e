//! `solaspect simulate --dark` and `--flat`: frames without light and evenly lit ones, for `calibrate camera`.

use super::SimulateArgs;
use super::truth::{TruthFile, write_file};
use crate::calibrate::revision::{Provenance, Revision};
use crate::cli::options;
use crate::cli::output::progress_bar;
use crate::fits::{self, Compression};
use crate::instrument::Sensor;
use crate::simulate::{RandomScenes, SUN_RADIUS_ARCSEC, Scene};
use clap::Args;
use std::path::Path;
use toml_edit::{Array, Value};

/// The first line of `truth.csv`: exposure, s; light in the middle of the picture above the dark level, DN of the camera.
const TRUTH_HEADER: &str = "n,exposure_s,light_dn";

/// Options of other scenes, and options that need the Sun.
const NOT_OF_A_LAMP: [&str; 7] = [
    "horizon",
    "moon",
    "navigation",
    "drift",
    "partial",
    "no_sun",
    "smear",
];

#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "For calibrate camera")]
pub struct LampArgs {
    /// Frames under a covered lens instead; the camera in truth goes to truth.toml. The same seed and options make the same camera
    #[arg(long, conflicts_with = "flat", conflicts_with_all = NOT_OF_A_LAMP)]
    pub dark: bool,
    /// Evenly lit frames instead, two at each exposure, as many exposures as there are pairs, the longest with the light of --peak; the
    /// camera in truth goes to truth.toml
    #[arg(long, conflicts_with_all = NOT_OF_A_LAMP)]
    pub flat: bool,
}

/// Makes the frames, `truth.csv` and `truth.toml`.
pub(super) fn run(args: &SimulateArgs) -> anyhow::Result<()> {
    let (instrument, text) = options::instrument_with_text(args.instrument.as_deref())?;
    // There is no Sun in these frames, so its size does not matter.
    let conditions = args.conditions(&instrument, SUN_RADIUS_ARCSEC);
    let scenes = RandomScenes::new(&instrument, &conditions, args.seed)?;
    let mut truth = TruthFile::create(&args.out, TRUTH_HEADER)?;
    let sensor = scenes.covered(0).sensor();
    write_file(&args.out, "truth.toml", &truth_toml(&text, &sensor)?)?;
    let progress = progress_bar(args.frames as usize, "frames");
    for number in 0..args.frames {
        let mut scene = args.lamp.scene(&scenes, number, args.frames);
        scene.info.mid_exposure = Some(args.utc_at(number as f64)?);
        let file = args.out.join(format!("frame_{number:05}.fits"));
        fits::write_frame(&file, &scene.frame()?, &[], &[], Compression::Rice)?;
        truth.row(&truth_line(number, &scene))?;
        progress.inc(1);
    }
    progress.finish_and_clear();
    Ok(())
}

impl LampArgs {
    fn scene(&self, scenes: &RandomScenes, number: u64, frames: u64) -> Scene {
        if self.dark {
            return scenes.covered(number);
        }
        let exposures = frames.div_ceil(2);
        scenes.evenly_lit(number, (number / 2 + 1) as f64 / exposures as f64)
    }
}

fn truth_line(number: u64, scene: &Scene) -> String {
    let light = scene.sun.as_ref().map_or(0.0, |sun| sun.peak_dn);
    let exposure_s = scene.info.exposure.unwrap_or_default().as_secs_f64();
    let steps = f64::from(scene.depth.steps_per_dn());
    format!("{number},{exposure_s:.9},{:.6}", light * steps)
}

/// The instrument with the true values of its camera, under the keys that `calibrate camera` writes.
fn truth_toml(text: &str, sensor: &Sensor) -> anyhow::Result<String> {
    let provenance = Provenance {
        name: "camera",
        source: "truth of the simulation".into(),
        date: None,
        frames: 0,
        frames_sha256: String::new(),
        camera: None,
    };
    let mut revision = Revision::of(Path::new("truth.toml"), text)?;
    let mut set = |key: &str, value: Value| {
        revision.set(key, value, Some(0.0), &provenance);
    };
    if let Some(noise) = &sensor.noise {
        set(
            "camera.noise.saturation_dn",
            i64::from(noise.saturation_dn).into(),
        );
        set("camera.noise.dark_dn", noise.dark_dn.value.into());
        set(
            "camera.noise.read_noise_dn",
            noise.read_noise_dn.value.into(),
        );
        if let Some(gain) = noise.gain_dn_per_electron {
            set("camera.noise.gain_dn_per_electron", gain.value.into());
        }
    }
    if let Some(vignetting) = &sensor.vignetting {
        let centre = [vignetting.centre.x, vignetting.centre.y];
        set(
            "camera.vignetting.centre_px",
            Value::Array(centre.into_iter().collect()),
        );
        set(
            "camera.vignetting.radial_per_px2",
            vignetting.radial[0].value.into(),
        );
    }
    let pixel =
        |(x, y): &(usize, usize)| Value::Array([*x as i64, *y as i64].into_iter().collect());
    let hot: Array = sensor.hot_pixels.iter().map(pixel).collect();
    set("camera.hot_pixels_px", Value::Array(hot));
    Ok(revision.finish()?.0)
}
