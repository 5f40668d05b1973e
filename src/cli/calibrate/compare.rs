//! `solaspect calibrate compare`: what changed from one instrument to another.

use crate::calibrate::compare;
use crate::cli::output::say;
use crate::instrument::{self, Instrument};
use clap::Args;
use std::path::{Path, PathBuf};
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
    let [a, b] = [&args.a, &args.b].map(|path| instrument(path));
    let comparison = compare::compare(&a?, &b?);
    if args.json {
        say(serde_json::to_string(&comparison)?)?;
    } else {
        say(comparison)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The instrument of a file, or the built-in one of that name where there is no such file.
fn instrument(path: &Path) -> anyhow::Result<Instrument> {
    let name = path.to_string_lossy();
    if !path.exists() && instrument::builtin_names().contains(&name.as_ref()) {
        return Ok(instrument::builtin(&name)?);
    }
    Ok(Instrument::read(path)?)
}
