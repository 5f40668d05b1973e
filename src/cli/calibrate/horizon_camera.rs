//! `solaspect calibrate horizon-camera`: the optics of a camera that observes the horizon.

use super::edition::print_rejected;
use crate::calibrate::horizon_camera;
use crate::calibrate::revision::{Revision, write_if};
use crate::calibrate::roll_camera::Horizons;
use crate::cli::options;
use crate::cli::output::say;
use crate::instrument::{DirectionCamera, text_of};
use crate::observe::Watch;
use crate::units::Place;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;

/// Measure focal length, centre and distortion of a camera that sees the horizon, by frames of its own flight
///
/// The limb must cross the picture at many places: tilted up and down, and rolled. What is known of the limb (height, its edge) is what the
/// configuration states in [roll]; the heights of the frames are their own. Where the frames do not determine the optics, the error says what lacks.
#[derive(Debug, Args)]
pub struct HorizonCameraArgs {
    /// Frames of the horizon, or folders of them
    #[arg(required = true, value_name = "FRAME|DIR")]
    frames: Vec<PathBuf>,
    /// The camera as it is known so far: size, and about its focal length, centre and distortion
    #[arg(long, value_name = "CAM.toml")]
    instrument: PathBuf,
    /// The new camera file
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Where the frames were taken, for frames that do not say so
    #[arg(long, value_name = "LAT,LON,HEIGHT_M", allow_hyphen_values = true)]
    place: Option<Place>,
    /// The configuration's TOML file
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

pub fn run(args: &HorizonCameraArgs, watch: &dyn Watch) -> anyhow::Result<ExitCode> {
    let text = text_of(&args.instrument)?;
    let camera = DirectionCamera::parse(&args.instrument, &text)?;
    let mut revision = Revision::of(&args.instrument, &text)?;
    let config = options::config(args.config.as_deref())?;
    let horizons = Horizons {
        camera: &camera,
        settings: config.roll,
        place: args.place.or(config.site.place()),
    };
    let found = horizon_camera::from_frames(&args.frames, &horizons, watch)?;
    found.revise(&mut revision);
    write_if(&args.out, &revision.text(), |part| {
        DirectionCamera::read(part).map(drop)
    })?;
    found.lines().iter().try_for_each(say)?;
    print_rejected(&found.rejected)?;
    Ok(ExitCode::SUCCESS)
}
