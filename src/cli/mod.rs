//! The command table, and the commands: each file reads its arguments, calls the library and prints. There is no other logic here.

pub mod accuracy;
pub mod archive;
mod attitude;
pub mod calibrate;
pub mod config;
#[cfg(feature = "console")]
pub mod console;
pub mod demo;
pub mod events;
pub mod fly;
mod frames;
pub mod horizon;
pub mod link;
pub mod moon;
pub mod navigate;
mod options;
mod output;
pub mod plate;
pub mod preflight;
pub mod refine;
pub mod simulate;
pub mod sky;
pub mod solve;

use crate::provenance;
use clap::{CommandFactory, Parser, Subcommand, ValueEnum};
use std::process::ExitCode;

/// Three-axis aspect of a balloon gondola from its cameras, above all from the Sun on a fiducial plate.
///
/// Exit codes: 0 all went well, 1 something in the input or the run failed, 2 wrong usage.
#[derive(Debug, Parser)]
#[command(name = "solaspect", version, long_version = provenance::LONG_VERSION, max_term_width = 100)]
pub struct Program {
    #[command(subcommand)]
    command: Command,
    /// Log more: -v what happens, -vv every frame, -vvv everything
    #[arg(short, long, action = clap::ArgAction::Count, global = true)]
    pub verbose: u8,
    /// How the log on standard error is written
    #[arg(long, value_enum, default_value_t = LogFormat::Text, global = true)]
    pub log_format: LogFormat,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum LogFormat {
    Text,
    Json,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::DemoArgs),
    Fly(fly::FlyArgs),
    Solve(solve::SolveArgs),
    Horizon(horizon::HorizonArgs),
    Moon(moon::MoonArgs),
    Navigate(navigate::NavigateArgs),
    Refine(refine::RefineArgs),
    Events(events::EventsArgs),
    Simulate(Box<simulate::SimulateArgs>),
    Sky(sky::SkyArgs),
    Config(config::ConfigArgs),
    Plate(plate::PlateArgs),
    Preflight(preflight::PreflightArgs),
    Accuracy(accuracy::AccuracyArgs),
    Archive(archive::ArchiveArgs),
    Calibrate(calibrate::CalibrateArgs),
    Link(link::LinkArgs),
    #[cfg(feature = "console")]
    Console(Box<console::ConsoleArgs>),
}

impl Program {
    /// Executes the command given by the arguments.
    ///
    /// # Errors
    /// The error, for a line on standard error.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        match self.command {
            Command::Demo(args) => demo::run(args),
            Command::Fly(args) => fly::run(args),
            Command::Solve(args) => solve::run(args),
            Command::Horizon(args) => horizon::run(args),
            Command::Moon(args) => moon::run(args),
            Command::Navigate(args) => navigate::run(&args),
            Command::Refine(args) => refine::run(&args),
            Command::Events(args) => events::run(&args),
            Command::Simulate(args) => simulate::run(&args).map(|()| ExitCode::SUCCESS),
            Command::Sky(args) => sky::run(args).map(|()| ExitCode::SUCCESS),
            Command::Config(args) => config::run(&args),
            Command::Plate(args) => plate::run(&args),
            Command::Preflight(args) => preflight::run(args),
            Command::Accuracy(args) => accuracy::run(&args),
            Command::Archive(args) => archive::run(args),
            Command::Calibrate(args) => calibrate::run(args),
            Command::Link(args) => link::run(args),
            #[cfg(feature = "console")]
            Command::Console(args) => console::run(*args),
        }
    }
}

/// The command table, from which man pages and completions are made.
pub fn command() -> clap::Command {
    Program::command()
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_command_table_contradicts_itself_nowhere() {
        super::command().debug_assert();
    }
}
