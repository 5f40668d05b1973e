//! Shared parts of `navigate` and `refine`: the selection of rows and files of an attitude, and the printed summary.

use super::output::say;
use crate::refine::{AttitudeFound, Wanted};
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;

/// Which rows and files of an attitude are wanted.
#[derive(Debug, Clone, Args)]
pub(super) struct AttitudeArgs {
    /// Rows a second [default: each sample of the IMU]
    #[arg(long, value_name = "HZ", value_parser = parse_rate)]
    pub rate: Option<f64>,
    /// Write attitude.aem, too: an Attitude Ephemeris Message of CCSDS; the epoch must be known
    #[arg(long, requires = "imu")]
    pub aem: bool,
    /// Write a new NAV.toml with the biases and misalignments that the filter ended with
    #[arg(long, value_name = "OUT.toml", requires = "imu")]
    calibrated: Option<PathBuf>,
}

impl AttitudeArgs {
    pub fn wanted(&self) -> Wanted {
        Wanted {
            rate_hz: self.rate,
            aem: self.aem,
            calibrated: self.calibrated.clone(),
        }
    }
}

pub fn parse_rate(text: &str) -> Result<f64, String> {
    let rate: Option<f64> = text.parse().ok();
    rate.filter(|rate| (1e-3..=1e5).contains(rate))
        .ok_or_else(|| format!("expected a number from 0.001 to 100000 Hz, found \"{text}\""))
}

/// Prints the result in one line, and further lines with reasons not to trust it: then it is a failure.
pub(super) fn print(found: &AttitudeFound) -> anyhow::Result<ExitCode> {
    say(found)?;
    for doubt in found.doubts() {
        tracing::error!("{doubt}");
    }
    Ok(match found.is_sound() {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    })
}
