//! `solaspect calibrate plate`: the plate as it is.

use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;

/// Measure every mark of the plate, the lens's distortion and the camera's poses from frames
#[derive(Debug, Args)]
pub struct PlateArgs {
    /// Frames with the Sun all over the plate; each folder is one pose of the camera
    #[arg(required = true, value_name = "FRAME|DIR")]
    frames: Vec<PathBuf>,
    /// The instrument to start from, a TOML file [default: the built-in instrument "demo"]
    #[arg(long, value_name = "FILE")]
    instrument: Option<PathBuf>,
    /// Where the measured instrument is written
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Write a report, index.html, into this folder
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
}

pub fn run(args: &PlateArgs) -> anyhow::Result<ExitCode> {
    let _ = args;
    anyhow::bail!("not yet")
}
