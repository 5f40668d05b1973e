//! `solaspect calibrate plate`: the plate as it is.

use super::edition::Edition;
use crate::calibrate::plate;
use crate::cli::output::say;
use crate::observe::Watch;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use toml_edit::Item;

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
    /// Otherwise they are the prior. A file that was made from these very frames starts from the drawing in any case, so that no
    /// frame counts twice.
    #[arg(long)]
    from_drawing: bool,
    #[command(flatten)]
    edition: Edition,
}

pub fn run(args: &PlateArgs, watch: &dyn Watch) -> anyhow::Result<ExitCode> {
    let (mut revision, mut start) = args.edition.open()?;
    let rests_on = revision.get("calibration.plate.frames_sha256");
    let rests_on = rests_on.and_then(Item::as_str).map(str::to_owned);
    let again = rests_on == Some(plate::frames_sha256(&args.frames)?);
    if args.from_drawing || again {
        start.plate = start.plate.as_drawn();
    }
    if again {
        say("the file rests on these very frames: its marks begin with the drawing")?;
    }
    let calibration = plate::calibrate(&args.frames, &start, watch)?;
    calibration.revise(&mut revision, &start);
    let file_sha256 = args.edition.write(&revision)?;
    args.edition.write_page("index.html", || {
        plate::html(&calibration, &start, &file_sha256)
    })?;
    say(plate::summary(&calibration))?;
    say(format_args!("written to {}", args.edition.out.display()))?;
    Ok(ExitCode::SUCCESS)
}
