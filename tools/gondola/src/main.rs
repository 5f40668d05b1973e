//! `gondola PORT`: the controller's side of the aspect link. It starts tracking on a serial line, prints the offsets
//! as they come, and ends with a report of all that came.
//!
//! Exit code 0: tracking was answered and every packet was good; 1: not so, or the port failed; 2: wrong usage.

use anyhow::Context;
use clap::Parser;
use jiff::SignedDuration;
use solaspect::link::{Message, SerialPort, port::BAUD};
use solaspect::simulate::controller::{Controller, Report};
use std::fmt::Display;
use std::io::{self, Write};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The controller's side of the aspect link: starts tracking, prints the offsets, checks every packet.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// The serial device, such as /dev/ttyS0.
    port: String,
    /// Speed of the line, bit/s.
    #[arg(long, default_value_t = BAUD)]
    baud: u32,
    /// How long to listen, such as 60s or 10m; Ctrl-C ends it earlier.
    #[arg(long, default_value = "60s", value_parser = duration)]
    duration: Duration,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(report) if report.faults.total() == 0 && report.tracking_on > 0 => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(error) => {
            say(io::stderr(), format_args!("gondola: {error:#}"));
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> anyhow::Result<Report> {
    let interrupted = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, interrupted.clone()).context("signals")?;
    }
    let mut port = SerialPort::open(&arguments.port, arguments.baud)?;
    let mut controller = Controller::new();
    let start = Instant::now();
    let stopped = || interrupted.load(Ordering::Relaxed) || start.elapsed() >= arguments.duration;
    say(
        io::stdout(),
        format_args!(
            "{:<24} {:>12} {:>12} {:>12}",
            "exposure (UTC)", "azimuth deg", "elevation deg", "error deg"
        ),
    );
    let ended = controller.run(&mut port, stopped, print).map(|_| ());
    let report = controller.report().clone();
    say(io::stdout(), &report);
    if report.tracking_on == 0 {
        say(io::stdout(), "no answer to the start of tracking");
    }
    ended?;
    Ok(report)
}

fn print(message: &Message) {
    match message {
        Message::Solution(offset) => say(
            io::stdout(),
            format_args!(
                "{:<24.3} {:>12.6} {:>12.6}  {:>12.6}",
                offset.time, offset.azimuth_deg, offset.elevation_deg, offset.error_deg
            ),
        ),
        Message::Error { code } => say(io::stdout(), format_args!("no solution: error {code}")),
        _ => {}
    }
}

/// Writes a line; the controller goes on when nobody reads it.
fn say(mut out: impl Write, line: impl Display) {
    let _ = writeln!(out, "{line}");
}

fn duration(text: &str) -> Result<Duration, String> {
    let parsed = text.parse::<SignedDuration>().ok();
    parsed
        .and_then(|duration| Duration::try_from(duration).ok())
        .ok_or_else(|| format!("expected a duration such as 60s or 10m, found \"{text}\""))
}
