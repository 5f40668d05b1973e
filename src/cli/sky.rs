//! `solaspect sky`: positions of the Sun and the Moon.

mod report;
mod visibility;

use super::options;
use crate::clock::parse_utc;
use crate::sky::Air;
use crate::units::Place;
use anyhow::Context;
use clap::{Args, Subcommand};
use jiff::Timestamp;
use report::{View, card, table};
use serde::Serialize;
use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

/// Compute the positions of the Sun and the Moon for an observer
///
/// Elevations are without refraction unless --refraction asks for it. The bright limb of the Moon and P are position angles
/// from celestial north through east; angles from the zenith count clockwise as seen looking out. With --from and --to: a
/// table for planning a flight, with rise (upper limb on the horizon of the place's height, 34 arcmin of refraction),
/// transit and set.
#[derive(Debug, Args)]
#[command(
    allow_negative_numbers = true,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true
)]
pub struct SkyArgs {
    #[command(subcommand)]
    command: Option<SkyCommand>,
    /// The instant, UTC, ISO 8601: 2013-09-21T18:00:00.25Z
    #[arg(long, value_name = "UTC", value_parser = parse_utc, required_unless_present = "from", conflicts_with = "from")]
    at: Option<Timestamp>,
    /// Geodetic latitude and longitude (deg, east positive) and height (m)
    #[arg(
        long,
        value_name = "LAT,LON,HEIGHT_M",
        allow_hyphen_values = true,
        required = true
    )]
    place: Option<Place>,
    /// Apparent elevations, refracted by the standard atmosphere of the height, or by this pressure (hPa) and temperature (deg C)
    #[arg(long, value_name = "HPA,DEG_C", num_args = 0..=1)]
    refraction: Option<Option<Air>>,
    /// The beginning of a table
    #[arg(long, value_name = "UTC", value_parser = parse_utc, requires = "to")]
    from: Option<Timestamp>,
    /// The end of a table
    #[arg(long, value_name = "UTC", value_parser = parse_utc, requires = "from")]
    to: Option<Timestamp>,
    /// Time between the rows of a table, such as 10m or 1h
    #[arg(long, value_name = "TIME", default_value = "30m", value_parser = options::duration, requires = "from")]
    step: Duration,
    /// Also list when the Sun is between these elevations (deg)
    #[arg(long, value_name = "LOW,HIGH", value_parser = parse_band, allow_hyphen_values = true, requires = "from")]
    band: Option<[f64; 2]>,
    /// The configuration's TOML file, for its table of Earth orientation
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

fn parse_band(text: &str) -> Result<[f64; 2], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[low, high]) if -90.0 <= low && low < high && high <= 90.0 => Ok([low, high]),
        _ => Err(format!(
            "expected LOW,HIGH from -90 to 90 deg, found \"{text}\""
        )),
    }
}

#[derive(Debug, Subcommand)]
enum SkyCommand {
    Visibility(visibility::VisibilityArgs),
}

pub fn run(args: SkyArgs) -> anyhow::Result<()> {
    if let Some(SkyCommand::Visibility(args)) = &args.command {
        return visibility::run(args);
    }
    let place = args.place.context("expected --place")?;
    let config = options::config(args.config.as_deref())?;
    let mut sky = View {
        ephemeris: options::ephemeris(&config)?,
        place,
        air: args
            .refraction
            .map(|air| air.unwrap_or_else(|| Air::standard(place.height_m))),
    };
    let latest = args.at.or(args.to);
    if let Some(extrapolated) = latest.and_then(|utc| sky.ephemeris.extrapolates(utc)) {
        tracing::warn!("{extrapolated}: see sky.earth_orientation");
    }
    let text = match (args.at, args.from.zip(args.to)) {
        (Some(utc), _) => {
            let report = sky.report(utc).context("--at")?;
            written(&report, args.json, card)?
        }
        (None, Some((from, to))) => {
            let plan = sky.plan(from, to, args.step, args.band)?;
            written(&plan, args.json, table)?
        }
        (None, None) => anyhow::bail!("expected --at, or --from and --to"),
    };
    writeln!(std::io::stdout(), "{text}")?;
    Ok(())
}

fn written<T: Serialize>(
    report: &T,
    json: bool,
    people: fn(&T) -> String,
) -> serde_json::Result<String> {
    if json {
        serde_json::to_string(report)
    } else {
        Ok(people(report))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        sky: SkyArgs,
    }

    fn parse(options: &str) -> Result<SkyArgs, clap::Error> {
        let words = ["sky"].into_iter().chain(options.split_whitespace());
        Cli::try_parse_from(words).map(|cli| cli.sky)
    }

    #[test]
    fn southern_places_and_times_without_a_zone_are_read() {
        let args = parse("--at 2016-01-19T02:00:00.5 --place -77.85,166.67,36500").unwrap();
        assert_eq!(args.place.map(|place| place.latitude_deg), Some(-77.85));
        assert_eq!(args.at, "2016-01-19T02:00:00.5Z".parse().ok());
    }

    #[test]
    fn wrong_usage_is_refused() {
        for options in [
            "--at yesterday --place 0,0,0",
            "--place 0,0,0",
            "--from 2013-09-21T00:00:00Z --place 0,0,0",
            "--at 2013-09-21T00:00:00Z --band 10,20 --place 0,0,0",
            "--from 2013-09-21T00:00:00Z --to 2013-09-22T00:00:00Z --band 20,10 --place 0,0,0",
            "--at 2013-09-21T00:00:00Z --place 0,0,0 --refraction 1013",
        ] {
            assert!(parse(options).is_err(), "{options}");
        }
    }

    #[test]
    fn refraction_is_off_standard_or_given() {
        let at = "--at 2013-09-21T18:00:00Z --place 34.49,-104.2218,38405";
        assert!(parse(at).unwrap().refraction.is_none());
        let standard = parse(&format!("{at} --refraction --json")).unwrap();
        assert_eq!(standard.refraction, Some(None));
        assert!(standard.json);
        let given = parse(&format!("{at} --refraction 3.5,-30")).unwrap();
        assert!(
            given
                .refraction
                .flatten()
                .is_some_and(|air| air.pressure_hpa == 3.5)
        );
    }
}
