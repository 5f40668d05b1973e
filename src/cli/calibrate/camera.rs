//! `solaspect calibrate camera`: noise, gain, hot pixels, vignetting, blur.

use super::edition::{Edition, print_rejected};
use crate::calibrate::camera::{self, Inputs};
use crate::calibrate::revision::Provenance;
use crate::cli::output::say;
use crate::observe::{Depth, InputError, RejectedFrame, Watch, list, sha256};
use anyhow::Context;
use clap::Args;
use jiff::tz::TimeZone;
use std::path::PathBuf;
use std::process::ExitCode;

/// Measure dark level, noise, gain, hot pixels, vignetting and blur, and the temperature coefficients of blur and scale
///
/// Best from dark frames, evenly lit frames (two at each of several exposures) and frames with the Sun all over the plate; each may be
/// missing. What the frames do not determine keeps the instrument's value, and the program says so.
#[derive(Debug, Args)]
pub struct CameraArgs {
    /// Frames of the Sun on the plate, or folders of them
    #[arg(required_unless_present_any = ["dark", "flat"], value_name = "FRAME|DIR")]
    frames: Vec<PathBuf>,
    #[command(flatten)]
    edition: Edition,
    /// Frames without light, at equal exposure
    #[arg(long, value_name = "DIR")]
    dark: Option<PathBuf>,
    /// Evenly lit frames, two at each of several exposures
    #[arg(long, value_name = "DIR")]
    flat: Option<PathBuf>,
}

pub fn run(args: CameraArgs, watch: &dyn Watch) -> anyhow::Result<ExitCode> {
    let (mut revision, stated) = args.edition.open()?;
    let frames = |given: &[PathBuf]| -> Result<_, InputError> { list(given, Depth::All) };
    let dark = frames(args.dark.as_slice())?;
    let flat = frames(args.flat.as_slice())?;
    let sun = frames(&args.frames)?;
    let (dark_shots, dark_rejected) = camera::load(&dark, &stated, watch)?;
    let (flat_shots, flat_rejected) = camera::load(&flat, &stated, watch)?;
    let (sun_shots, suns, sun_rejected) = camera::solve(&sun, &stated, watch)?;
    let rejected = [dark_rejected, flat_rejected, sun_rejected].concat();
    let inputs = Inputs {
        dark: dark_shots,
        flat: flat_shots,
        sun: sun_shots,
        suns,
    };
    let calibration = camera::calibrate(&inputs, &stated)
        .with_context(|| RejectedFrame::count_and_first(&rejected))?;
    let given = args.frames.iter().chain(&args.dark).chain(&args.flat);
    let given: Vec<String> = given.map(|path| path.display().to_string()).collect();
    let given = given.join(", ");
    let provenance = provenance(&inputs, &[dark, flat, sun].concat());
    calibration.revise(&mut revision, &provenance);
    args.edition.write(&revision)?;
    say(calibration.summary())?;
    print_rejected(&rejected)?;
    args.edition.write_page("camera.html", || {
        let source = format!("{} ({given})", provenance.source);
        camera::page(&calibration, &stated.name, &source, &rejected)
    })?;
    Ok(ExitCode::SUCCESS)
}

fn provenance(inputs: &Inputs, files: &[PathBuf]) -> Provenance {
    let shots = || {
        let all = [&inputs.dark, &inputs.flat, &inputs.sun].into_iter();
        all.flat_map(|s| &s.frames)
    };
    let last = shots().filter_map(|s| s.frame.info.mid_exposure).max();
    Provenance {
        name: "camera",
        source: format!(
            "camera calibration, {} dark, {} evenly lit and {} frames of the Sun",
            inputs.dark.frames.len(),
            inputs.flat.frames.len(),
            inputs.suns.len()
        ),
        date: last.map(|last| TimeZone::UTC.to_datetime(last).date()),
        frames: files.len(),
        frames_sha256: sha256(files),
        camera: shots().find_map(|s| s.frame.info.camera.clone()),
    }
}
