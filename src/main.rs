//! The program: one command per file of `cli`.

use clap::{Parser, Subcommand, ValueEnum};
use solaspect::{cli, log, provenance};
use std::io::ErrorKind;
use std::process::ExitCode;

/// Three-axis aspect of a balloon gondola from its cameras, above all from the Sun on a fiducial plate.
///
/// Exit codes: 0 all went well, 1 something in the input or the run failed, 2 wrong usage.
#[derive(Parser)]
#[command(name = "solaspect", version, long_version = provenance::LONG_VERSION, max_term_width = 100)]
struct Program {
    #[command(subcommand)]
    command: Command,
    /// Log more: -v what happens, -vv every frame, -vvv everything
    #[arg(short, long, action = clap::ArgAction::Count, global = true)]
    verbose: u8,
    /// How the log on standard error is written
    #[arg(long, value_enum, default_value_t = LogFormat::Text, global = true)]
    log_format: LogFormat,
}

#[derive(Clone, Copy, ValueEnum)]
enum LogFormat {
    Text,
    Json,
}

#[derive(Subcommand)]
enum Command {
    Demo(cli::demo::DemoArgs),
    Fly(cli::fly::FlyArgs),
    Solve(cli::solve::SolveArgs),
    Horizon(cli::horizon::HorizonArgs),
    Moon(cli::moon::MoonArgs),
    Navigate(cli::navigate::NavigateArgs),
    Refine(cli::refine::RefineArgs),
    Simulate(Box<cli::simulate::SimulateArgs>),
    Sky(cli::sky::SkyArgs),
    Config(cli::config::ConfigArgs),
    Preflight(cli::preflight::PreflightArgs),
    Accuracy(cli::accuracy::AccuracyArgs),
    Archive(cli::archive::ArchiveArgs),
    Calibrate(cli::calibrate::CalibrateArgs),
    Link(cli::link::LinkArgs),
}

fn main() -> ExitCode {
    let program = Program::parse();
    let format = match program.log_format {
        LogFormat::Text => log::Format::Text,
        LogFormat::Json => log::Format::Json,
    };
    let _log = match log::start(program.verbose, format) {
        Ok(log) => log,
        Err(error) => {
            log::say(&format!("solaspect: no thread for the log: {error}"));
            return ExitCode::FAILURE;
        }
    };
    let outcome = match program.command {
        Command::Demo(args) => cli::demo::run(args),
        Command::Fly(args) => cli::fly::run(args),
        Command::Solve(args) => cli::solve::run(args),
        Command::Horizon(args) => cli::horizon::run(args),
        Command::Moon(args) => cli::moon::run(args),
        Command::Navigate(args) => cli::navigate::run(&args),
        Command::Refine(args) => cli::refine::run(&args),
        Command::Simulate(args) => cli::simulate::run(&args).map(|()| ExitCode::SUCCESS),
        Command::Sky(args) => cli::sky::run(args).map(|()| ExitCode::SUCCESS),
        Command::Config(args) => cli::config::run(&args),
        Command::Preflight(args) => cli::preflight::run(args),
        Command::Accuracy(args) => cli::accuracy::run(&args),
        Command::Archive(args) => cli::archive::run(args),
        Command::Calibrate(args) => cli::calibrate::run(args),
        Command::Link(args) => cli::link::run(args),
    };
    match outcome {
        Ok(code) => code,
        Err(error) if is_closed_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            log::say(&format!("solaspect: {error:#}"));
            ExitCode::FAILURE
        }
    }
}

/// Whoever reads our output may stop reading: `solaspect solve ... | head` is no failure.
fn is_closed_pipe(error: &anyhow::Error) -> bool {
    let io = error.downcast_ref::<std::io::Error>();
    io.is_some_and(|io| io.kind() == ErrorKind::BrokenPipe)
}
