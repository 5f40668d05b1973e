//! `solaspect calibrate`: the instrument as it is.

pub mod camera;
pub mod mounting;

use clap::{Args, Subcommand};
use std::process::ExitCode;

/// Measure the instrument from frames and write its new TOML file
#[derive(Debug, Args)]
pub struct CalibrateArgs {
    #[command(subcommand)]
    part: Part,
}

#[derive(Debug, Subcommand)]
enum Part {
    Camera(camera::CameraArgs),
    Mounting(mounting::MountingArgs),
}

pub fn run(args: CalibrateArgs) -> anyhow::Result<ExitCode> {
    match args.part {
        Part::Camera(args) => camera::run(args),
        Part::Mounting(args) => mounting::run(args),
    }
}
