//! `solaspect calibrate`: measure the instrument.

mod compare;
mod plate;

use clap::{Args, Subcommand};
use std::process::ExitCode;

/// Measure the instrument: plate, lens and camera poses; tell what changed between two calibrations
#[derive(Debug, Args)]
pub struct CalibrateArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Plate(plate::PlateArgs),
    Compare(compare::CompareArgs),
}

pub fn run(args: CalibrateArgs) -> anyhow::Result<ExitCode> {
    match args.what {
        What::Plate(args) => plate::run(&args),
        What::Compare(args) => compare::run(&args),
    }
}
