use clap::Args;
use std::process::ExitCode;
/// Fly
#[derive(Debug, Args)]
pub struct FlyArgs {}
pub fn run(_args: FlyArgs) -> anyhow::Result<ExitCode> {
    Ok(ExitCode::SUCCESS)
}
