//! The program.

use clap::Parser;
use solaspect::cli::{LogFormat, Program};
use solaspect::{log, memory};
use std::io::ErrorKind;
use std::process::ExitCode;

fn main() -> ExitCode {
    memory::keep_freed();
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
    match program.run() {
        Ok(code) => code,
        Err(error) if is_closed_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            log::say(&format!("solaspect: {error:#}"));
            ExitCode::FAILURE
        }
    }
}

/// The reader of our output may stop reading: `solaspect solve ... | head` is not a failure.
fn is_closed_pipe(error: &anyhow::Error) -> bool {
    let io = error.downcast_ref::<std::io::Error>();
    io.is_some_and(|io| io.kind() == ErrorKind::BrokenPipe)
}
