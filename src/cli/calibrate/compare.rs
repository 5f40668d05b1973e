//! `solaspect calibrate compare`: differences between two instruments.

use crate::calibrate::compare;
use crate::cli::output::say;
use crate::instrument::Instrument;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;

/// Report what changed from instrument A to instrument B
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// The instrument before: a TOML file, or the name of a built-in one
    a: PathBuf,
    /// The instrument after, likewise
    b: PathBuf,
    /// Write one JSON object instead of text
    #[arg(long)]
    json: bool,
}

pub fn run(args: &CompareArgs) -> anyhow::Result<ExitCode> {
    let [a, b] = [&args.a, &args.b].map(|path| Instrument::read(path));
    let comparison = compare::compare(&a?, &b?);
    if args.json {
        say(serde_json::to_string(&comparison)?)?;
    } else {
        say(comparison)?;
    }
    Ok(ExitCode::SUCCESS)
}
