use clap::Args;
use std::process::ExitCode;
/// Demo
#[derive(Debug, Args)]
pub struct DemoArgs {}
pub fn run(_args: DemoArgs) -> anyhow::Result<ExitCode> {
    Ok(ExitCode::SUCCESS)
}
