//! `gondola PORT`: controller emulator for the aspect link. It starts tracking on a serial line, prints the offsets
//! as they come, and ends with a report of all that came.
//!
//! Exit code 0: tracking was answered and every packet was good; 1: not so, or the port failed; 2: wrong usage.

use anyhow::{Context, bail};
use clap::Parser;
use jiff::SignedDuration;
use solaspect::camera::{Source, simulated_course};
use solaspect::config::Config;
use solaspect::instrument::{Instrument, builtin};
use solaspect::link::{
    AnyPort, LocalEnd, Message, NoSolution, PortAddress, SerialPort, port::BAUD,
};
use solaspect::simulate::FORT_SUMNER;
use solaspect::simulate::controller::{Controller, Report};
use solaspect::simulate::navigation::TelescopeFlight;
use solaspect::simulate::sensors::Sensors;
use std::fmt::Display;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Controller emulator for the aspect link: starts tracking, prints the offsets, checks every packet.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// The serial device, such as /dev/ttyS0.
    port: String,
    /// Speed of the line, bit/s.
    #[arg(long, default_value_t = BAUD)]
    baud: u32,
    /// The configuration of a simulated flight with simulation.start_utc: samples of the IMU of that flight's telescope are sent, too
    #[arg(long, value_name = "FLIGHT.toml")]
    config: Option<PathBuf>,
    /// Port of its GPS receiver: a serial device, or udp:HOST:PORT
    #[arg(long, value_name = "PORT", requires = "config")]
    gps: Option<String>,
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
    let mut controller = match &arguments.config {
        Some(path) => Controller::new().with_sensors(sensors(path, arguments.gps.as_deref())?),
        None => Controller::new(),
    };
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
        Message::Propagated(by_gyros) => {
            let offset = &by_gyros.solution;
            say(
                io::stdout(),
                format_args!(
                    "{:<24.3} {:>12.6} {:>12.6}  {:>12.6} by gyros, {} ms after a frame",
                    offset.time,
                    offset.azimuth_deg,
                    offset.elevation_deg,
                    offset.error_deg,
                    by_gyros.age_ms
                ),
            );
        }
        Message::Error(NoSolution { code }) => {
            say(io::stdout(), format_args!("no solution: error {code}"))
        }
        _ => {}
    }
}

/// The sensors of the telescope simulated by a configuration.
fn sensors(path: &Path, gps: Option<&str>) -> anyhow::Result<Sensors> {
    let config = Config::read(path)?;
    let of = |key: &str| format!("{}: {key}", path.display());
    let start = config.simulation.start_utc.with_context(|| {
        let key = of("simulation.start_utc");
        format!("{key}: expected a time, so that camera and IMU fly together; found none")
    })?;
    let Some(Source::Simulated(file)) = &config.cameras.first().source else {
        bail!("{}: expected a simulated camera", of("camera.source"));
    };
    let instrument = match &config.cameras.first().instrument {
        Some(path) => Instrument::read(path)?,
        None => builtin("demo")?,
    };
    let seed = config.simulation.seed;
    let course = simulated_course(file.as_deref(), &instrument, start, seed)?;
    let telescope = TelescopeFlight::new(course, &instrument, FORT_SUMNER, start, seed);
    let gps = gps
        .map(|port| -> anyhow::Result<AnyPort> {
            let address: PortAddress = port.parse().map_err(anyhow::Error::msg)?;
            Ok(address.open(config.navigation.gps_baud, LocalEnd::default())?)
        })
        .transpose()?;
    Ok(Sensors::new(telescope, gps))
}

/// Writes a line; the controller continues without a reader.
fn say(mut out: impl Write, line: impl Display) {
    let _ = writeln!(out, "{line}");
}

fn duration(text: &str) -> Result<Duration, String> {
    let parsed = text.parse::<SignedDuration>().ok();
    parsed
        .and_then(|duration| Duration::try_from(duration).ok())
        .ok_or_else(|| format!("expected a duration such as 60s or 10m, found \"{text}\""))
}
