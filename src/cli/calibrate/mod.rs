//! `solaspect calibrate`: the instrument as it is.

mod camera;
mod compare;
mod mounting;
mod plate;

use crate::instrument::Instrument;
use anyhow::Context;
use clap::{Args, Subcommand};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Measure the instrument from frames and write its new TOML file; tell what changed between two calibrations
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
        Part::Mounting(args) => mounting::run(args),
        Part::Plate(args) => plate::run(&args),
    }
}

/// Writes the instrument if it is one that everything else can read; else what stood there stays.
fn write_instrument(out: &Path, text: &str) -> anyhow::Result<()> {
    let cannot_write = || format!("{}: cannot write the instrument", out.display());
    let mut name = out.as_os_str().to_owned();
    name.push(".part");
    let part = PathBuf::from(name);
    std::fs::write(&part, text).with_context(cannot_write)?;
    Instrument::read(&part)?;
    std::fs::rename(&part, out).with_context(cannot_write)
}

fn write_page(folder: &Path, name: &str, html: &str) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("{}: cannot make the folder", folder.display()))?;
    let file = folder.join(name);
    std::fs::write(&file, html).with_context(|| format!("{}: cannot write", file.display()))
}
