//! `solaspect sky`: where the Sun and the Moon stand.

use crate::sky::{MoonPosition, SunPosition, moon, sun};
use crate::units::Place;
use anyhow::Context;
use clap::Args;
use jiff::{Timestamp, civil::DateTime, tz::Offset};
use serde::Serialize;
use std::io::Write;

/// Where the Sun and the Moon stand for an observer, without refraction.
#[derive(Debug, Args)]
pub struct SkyArgs {
    /// The instant, UTC, ISO 8601: 2013-09-21T18:00:00.25Z
    #[arg(long, value_name = "UTC", value_parser = parse_utc, allow_hyphen_values = true)]
    at: Timestamp,
    /// Geodetic latitude and longitude (deg, east positive) and height (m).
    #[arg(long, value_name = "LAT,LON,HEIGHT_M", allow_hyphen_values = true)]
    place: Place,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// An instant in UTC; the closing Z may be left out.
fn parse_utc(text: &str) -> Result<Timestamp, String> {
    let expected = |_| format!("expected a time such as 2013-09-21T18:00:00Z, found \"{text}\"");
    if let Ok(instant) = text.parse() {
        return Ok(instant);
    }
    let civil: DateTime = text.parse().map_err(expected)?;
    Offset::UTC.to_timestamp(civil).map_err(expected)
}

#[derive(Serialize)]
struct Report {
    utc: String,
    sun: SunReport,
    moon: MoonReport,
}

#[derive(Serialize)]
struct SunReport {
    azimuth_deg: f64,
    elevation_deg: f64,
    radius_arcsec: f64,
    p_deg: f64,
    b0_deg: f64,
    l0_deg: f64,
    zenith_to_north_deg: f64,
}

#[derive(Serialize)]
struct MoonReport {
    azimuth_deg: f64,
    elevation_deg: f64,
    radius_arcsec: f64,
    phase_angle_deg: f64,
    bright_limb_deg: f64,
}

impl From<SunPosition> for SunReport {
    fn from(sun: SunPosition) -> Self {
        Self {
            azimuth_deg: sun.azimuth_deg,
            elevation_deg: sun.elevation_deg,
            radius_arcsec: sun.radius_arcsec,
            p_deg: sun.p_deg,
            b0_deg: sun.b0_deg,
            l0_deg: sun.l0_deg,
            zenith_to_north_deg: sun.zenith_to_north_deg,
        }
    }
}

impl From<MoonPosition> for MoonReport {
    fn from(moon: MoonPosition) -> Self {
        Self {
            azimuth_deg: moon.azimuth_deg,
            elevation_deg: moon.elevation_deg,
            radius_arcsec: moon.radius_arcsec,
            phase_angle_deg: moon.phase_angle_deg,
            bright_limb_deg: moon.bright_limb_deg,
        }
    }
}

pub fn run(args: SkyArgs) -> anyhow::Result<()> {
    let report = Report {
        utc: format!("{:.3}", args.at),
        sun: sun(args.at, args.place).context("--at")?.into(),
        moon: moon(args.at, args.place).context("--at")?.into(),
    };
    let text = if args.json {
        serde_json::to_string(&report)?
    } else {
        table(&report)
    };
    writeln!(std::io::stdout(), "{text}")?;
    Ok(())
}

fn table(report: &Report) -> String {
    let Report { utc, sun, moon } = report;
    [
        format!("{utc}              Sun         Moon"),
        pair("azimuth", sun.azimuth_deg, moon.azimuth_deg, "deg"),
        pair("elevation", sun.elevation_deg, moon.elevation_deg, "deg"),
        pair("radius", sun.radius_arcsec, moon.radius_arcsec, "arcsec"),
        one("zenith to solar north", sun.zenith_to_north_deg),
        one("P", sun.p_deg),
        one("B0", sun.b0_deg),
        one("L0", sun.l0_deg),
        format!("{:24} {:28.5} deg", "phase angle", moon.phase_angle_deg),
        format!("{:24} {:28.5} deg", "bright limb", moon.bright_limb_deg),
    ]
    .join("\n")
}

fn pair(name: &str, sun: f64, moon: f64, unit: &str) -> String {
    format!("{name:24} {sun:15.5} {moon:12.5} {unit}")
}

fn one(name: &str, sun: f64) -> String {
    format!("{name:24} {sun:15.5} {:12} deg", "")
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        sky: SkyArgs,
    }

    #[test]
    fn southern_places_and_times_without_a_zone_are_read() {
        let line = [
            "sky",
            "--at",
            "2016-01-19T02:00:00.5",
            "--place",
            "-77.85,166.67,36500",
        ];
        let args = Cli::try_parse_from(line).unwrap().sky;
        assert_eq!(args.place.latitude_deg, -77.85);
        assert_eq!(args.at, "2016-01-19T02:00:00.5Z".parse().unwrap());
    }

    #[test]
    fn a_time_that_is_none_is_wrong_usage() {
        let line = ["sky", "--at", "yesterday", "--place", "0,0,0"];
        assert!(Cli::try_parse_from(line).is_err());
    }
}
