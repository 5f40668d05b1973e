//! Options shared by several commands.

use crate::camera::Source;
use crate::config::Config;
use crate::instrument::{Instrument, text_or_demo};
use crate::plan::{self, Options};
use crate::pointing::Target;
use crate::sky::Ephemeris;
use clap::Args;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// The configuration of a flight, and what the command line says instead of it.
#[derive(Debug, Args)]
pub(super) struct ConfigurationArgs {
    /// The configuration's TOML file; options override it
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// The instrument: a TOML file, or the name of a built-in one [default: the configuration's, else demo]
    #[arg(long, value_name = "FILE|NAME")]
    instrument: Option<PathBuf>,
    /// Where frames come from: gige:ADDRESS, gige:SERIAL, genicam:ID, folder:DIR, folder:DIR?follow, folder:DIR?follow=all, simulated
    /// or simulated:FILE.toml [default: the configuration's camera.source]
    #[arg(long, value_name = "SOURCE")]
    camera: Option<Source>,
    /// The controller: a serial port, or udp:HOST:PORT[@LOCALPORT] with an IP address as HOST
    #[arg(long, value_name = "PORT")]
    serial: Option<String>,
    /// The archive's folder, or two of them
    #[arg(long, value_name = "DIR[,DIR2]", value_delimiter = ',')]
    archive: Vec<PathBuf>,
}

impl ConfigurationArgs {
    /// Values from the command line.
    pub fn options(&self) -> Options {
        Options {
            instrument: self.instrument.clone(),
            camera: self.camera.clone(),
            serial: self.serial.clone(),
            archive: self.archive.clone(),
        }
    }
}

/// The instrument of `--instrument`, a file or a built-in one's name, else the built-in demo.
pub(super) fn instrument(path: Option<&Path>) -> anyhow::Result<Instrument> {
    Ok(instrument_with_text(path)?.0)
}

/// The same with the text of its file.
pub(super) fn instrument_with_text(path: Option<&Path>) -> anyhow::Result<(Instrument, String)> {
    let (path, text) = text_or_demo(path)?;
    Ok((Instrument::parse(path, &text)?, text))
}

/// The configuration of `--config`, else the defaults.
pub(super) fn config(path: Option<&Path>) -> anyhow::Result<Config> {
    Ok(match path {
        Some(path) => Config::read(path)?,
        None => Config::default(),
    })
}

/// The ephemeris with the configured table of Earth orientation, else the program's own.
pub(super) fn ephemeris(config: &Config) -> anyhow::Result<Ephemeris> {
    Ok(plan::ephemeris(config)?)
}

/// The configured target; with an epoch, the feature that was there at that time.
pub(super) fn target(config: &Config, ephemeris: &mut Ephemeris) -> anyhow::Result<Target> {
    Ok(plan::target(config, ephemeris)?)
}

/// A duration such as 20s, 1.5s, 500ms, 10m or 8h; a bare number is in seconds.
pub(super) fn duration(text: &str) -> Result<std::time::Duration, String> {
    let units = [("ms", 1e-3), ("s", 1.0), ("m", 60.0), ("h", 3600.0)];
    let (number, unit) = units
        .iter()
        .find_map(|(name, unit)| Some((text.strip_suffix(name)?, *unit)))
        .unwrap_or((text, 1.0));
    let expected =
        || format!("expected a length of time such as 20s, 500ms or 8h, found \"{text}\"");
    let seconds: f64 = number.trim().parse().map_err(|_| expected())?;
    std::time::Duration::try_from_secs_f64(seconds * unit).map_err(|_| expected())
}

/// Frames per second.
pub(super) fn rate_hz(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(rate) if (0.01..=100.0).contains(&rate) => Ok(rate),
        _ => Err(format!(
            "expected a number from 0.01 to 100 Hz, found \"{text}\""
        )),
    }
}

/// Factor by which time is accelerated.
pub(super) fn speed(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(speed) if (0.01..=1000.0).contains(&speed) => Ok(speed),
        _ => Err(format!(
            "expected a number from 0.01 to 1000, found \"{text}\""
        )),
    }
}

/// Becomes true when the program is asked to end: by SIGINT, by SIGTERM, or by SIGHUP, which a terminal sends when it is closed. A
/// program that was started with SIGHUP ignored, as by nohup, continues to ignore it.
pub(super) fn interrupted() -> anyhow::Result<Arc<AtomicBool>> {
    let interrupted = Arc::new(AtomicBool::new(false));
    let mut signals = vec![SIGINT, SIGTERM];
    if !is_ignored(SIGHUP) {
        signals.push(SIGHUP);
    }
    // A file that exceeds the size limit (RLIMIT_FSIZE) is an error of its writer, not the end of the flight.
    signal_hook::flag::register(SIGXFSZ, Arc::default())?;
    for signal in signals {
        signal_hook::flag::register(signal, Arc::clone(&interrupted))?;
    }
    Ok(interrupted)
}

/// Whether the program ignores a signal, as reported by Linux: one bit for each signal, from SIGHUP on.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let bits = line.and_then(|hex| u64::from_str_radix(hex.trim(), 16).ok());
    bits.is_some_and(|bits| bits >> (signal - 1) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::duration;
    use std::time::Duration;

    #[test]
    fn lengths_of_time_are_read_with_their_units() {
        assert_eq!(duration("20s"), Ok(Duration::from_secs(20)));
        assert_eq!(duration("1.5"), Ok(Duration::from_millis(1500)));
        assert_eq!(duration("250ms"), Ok(Duration::from_millis(250)));
        assert_eq!(duration("2h"), Ok(Duration::from_secs(7200)));
        assert!(duration("-3s").is_err() && duration("soon").is_err() && duration("NaN").is_err());
    }
}
