//! `solaspect calibrate compare`: what changed from one instrument to another.

use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;

/// Tell what changed from instrument A to instrument B
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// The instrument before, a TOML file
    a: PathBuf,
    /// The instrument after, a TOML file
    b: PathBuf,
    /// Write one JSON object instead of text
    #[arg(long)]
    json: bool,
}

pub fn run(args: &CompareArgs) -> anyhow::Result<ExitCode> {
    let _ = (&args.a, &args.b, args.json);
    anyhow::bail!("not yet")
}
