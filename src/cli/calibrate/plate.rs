//! `solaspect calibrate plate`: the positions of the marks on the actual plate.

use super::edition::Edition;
use crate::calibrate::plate::{self, UsedFrames};
use crate::cli::output::say;
use crate::observe::Watch;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;

/// Measure every mark of the plate, the lens's distortion and the camera's poses from frames
///
/// Takes frames with the Sun all over the plate, in several poses of the camera (shifted, turned), so that errors of the
/// plate and of the lens can be separated. Names and times may repeat across folders. Rejected frames are listed and the
/// rest go on; a set of frames that gives no calibration is refused with what to take instead.
#[derive(Debug, Args)]
pub struct PlateArgs {
    /// Frames, or folders of frames; the poses of the camera are found within each folder
    #[arg(required = true, value_name = "FRAME|DIR")]
    frames: Vec<PathBuf>,
    /// Ignore the measured marks of the file: start from the drawing
    ///
    /// Otherwise they are the prior. No frame counts twice: those that the file rests on are set aside, and where it rests on all of them its
    /// marks begin with the drawing in any case.
    #[arg(long)]
    from_drawing: bool,
    #[command(flatten)]
    edition: Edition,
}

pub fn run(args: &PlateArgs, watch: &dyn Watch) -> anyhow::Result<ExitCode> {
    let (mut revision, mut start) = args.edition.open()?;
    let used_frames = match args.from_drawing {
        true => {
            start.plate = start.plate.as_drawn();
            UsedFrames::default()
        }
        false => UsedFrames::of(&revision),
    };
    let calibration = plate::calibrate(&args.frames, &start, &used_frames, watch)?;
    calibration.revise(&mut revision);
    let file_sha256 = args.edition.write(&revision)?;
    args.edition
        .write_page("index.html", || plate::html(&calibration, &file_sha256))?;
    say(plate::summary(&calibration))?;
    say(format_args!("written to {}", args.edition.out.display()))?;
    Ok(ExitCode::SUCCESS)
}
