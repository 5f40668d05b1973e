//! `solaspect calibrate camera`: noise, gain, hot pixels, vignetting, blur.

use super::edition::{Edition, print_rejected};
use crate::calibrate::camera::{self, InputFiles};
use crate::cli::output::say;
use crate::observe::Watch;
use clap::Args;
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
    let given = InputFiles {
        dark: args.dark.as_slice(),
        flat: args.flat.as_slice(),
        sun: &args.frames,
    };
    let found = camera::from_frames(given, &stated, watch)?;
    found.revise(&mut revision);
    args.edition.write(&revision)?;
    say(found.calibration.summary())?;
    print_rejected(&found.rejected)?;
    args.edition.write_page("camera.html", || found.page())?;
    Ok(ExitCode::SUCCESS)
}
