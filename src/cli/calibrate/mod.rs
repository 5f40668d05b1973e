//! `solaspect calibrate`: the instrument as it is.

mod camera;
mod compare;
mod edition;
mod mounting;
mod plate;
mod roll_camera;

use clap::{Args, Subcommand};
use std::process::ExitCode;

/// Measure the instrument from frames and write its new TOML file; report what changed between two calibrations
#[derive(Debug, Args)]
pub struct CalibrateArgs {
    #[command(subcommand)]
    part: Part,
}

#[derive(Debug, Subcommand)]
enum Part {
    Camera(camera::CameraArgs),
    Compare(compare::CompareArgs),
    Mounting(mounting::MountingArgs),
    Plate(plate::PlateArgs),
}

pub fn run(args: CalibrateArgs) -> anyhow::Result<ExitCode> {
    match args.part {
        Part::Camera(args) => camera::run(args),
        Part::Compare(args) => compare::run(&args),
        Part::Mounting(args) => match &args.roll_camera {
            Some(camera) => roll_camera::run(&args, camera),
            None => mounting::run(args),
        },
        Part::Plate(args) => plate::run(&args),
    }
}
