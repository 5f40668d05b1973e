//! `solaspect sky`: where the Sun and the Moon stand.

use super::options;
use crate::sky::sphere::direction;
use crate::sky::{Air, Ephemeris, Rising, SkyError, crossings, horizon_deg, spells};
use crate::units::Place;
use anyhow::{Context, ensure};
use clap::Args;
use jiff::{SignedDuration, Timestamp, civil::DateTime, tz::Offset};
use serde::Serialize;
use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

/// Where the Sun and the Moon stand for an observer
///
/// Elevations are without refraction unless --refraction asks for it. The bright limb of the Moon and P are position angles
/// from celestial north through east; angles from the zenith count clockwise as seen looking out. With --from and --to: a
/// table for planning a flight, with rise (upper limb on the horizon of the place's height, 34 arcmin of refraction),
/// transit and set.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub struct SkyArgs {
    /// The instant, UTC, ISO 8601: 2013-09-21T18:00:00.25Z
    #[arg(long, value_name = "UTC", value_parser = parse_utc, required_unless_present = "from", conflicts_with = "from")]
    at: Option<Timestamp>,
    /// Geodetic latitude and longitude (deg, east positive) and height (m)
    #[arg(long, value_name = "LAT,LON,HEIGHT_M", allow_hyphen_values = true)]
    place: Place,
    /// Apparent elevations, lifted by the standard atmosphere of the height, or by this pressure (hPa) and temperature (deg C)
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
    /// Also list when the Sun stands between these elevations (deg)
    #[arg(long, value_name = "LOW,HIGH", value_parser = parse_band, allow_hyphen_values = true, requires = "from")]
    band: Option<[f64; 2]>,
    /// The configuration's TOML file, for its table of Earth orientation
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print one JSON object
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

fn parse_band(text: &str) -> Result<[f64; 2], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[low, high]) if -90.0 <= low && low < high && high <= 90.0 => Ok([low, high]),
        _ => Err(format!(
            "expected LOW,HIGH from -90 to 90 deg, found \"{text}\""
        )),
    }
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
    /// For people only.
    #[serde(skip)]
    zenith_to_bright_limb_deg: f64,
}

#[derive(Serialize)]
struct Plan {
    rows: Vec<Report>,
    events: Vec<Event>,
    #[serde(skip_serializing_if = "Option::is_none")]
    band: Option<Band>,
}

#[derive(Serialize)]
struct Event {
    utc: String,
    event: &'static str,
    azimuth_deg: f64,
    elevation_deg: f64,
}

#[derive(Serialize)]
struct Band {
    low_deg: f64,
    high_deg: f64,
    hours: f64,
    spells: Vec<[String; 2]>,
}

pub fn run(args: SkyArgs) -> anyhow::Result<()> {
    let config = options::config(args.config.as_deref())?;
    let mut sky = View {
        ephemeris: options::ephemeris(&config)?,
        place: args.place,
        air: args
            .refraction
            .map(|air| air.unwrap_or_else(|| Air::standard(args.place.height_m))),
    };
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

/// The sky from one place.
struct View {
    ephemeris: Ephemeris,
    place: Place,
    air: Option<Air>,
}

impl View {
    fn lifted(&self, elevation_deg: f64) -> f64 {
        elevation_deg + self.air.map_or(0.0, |air| air.lift_deg(elevation_deg))
    }

    fn report(&mut self, utc: Timestamp) -> Result<Report, SkyError> {
        let sun = self.ephemeris.sun(utc, self.place)?;
        let moon = self.ephemeris.moon(utc, self.place)?;
        Ok(Report {
            utc: format!("{utc:.3}"),
            sun: SunReport {
                azimuth_deg: sun.azimuth_deg,
                elevation_deg: self.lifted(sun.elevation_deg),
                radius_arcsec: sun.radius_arcsec,
                p_deg: sun.p_deg,
                b0_deg: sun.b0_deg,
                l0_deg: sun.l0_deg,
                zenith_to_north_deg: sun.zenith_to_north_deg,
            },
            moon: MoonReport {
                azimuth_deg: moon.azimuth_deg,
                elevation_deg: self.lifted(moon.elevation_deg),
                radius_arcsec: moon.radius_arcsec,
                phase_angle_deg: moon.phase_angle_deg,
                bright_limb_deg: moon.bright_limb_deg,
                zenith_to_bright_limb_deg: moon.zenith_to_bright_limb_deg,
            },
        })
    }

    fn plan(
        &mut self,
        from: Timestamp,
        to: Timestamp,
        step: Duration,
        band: Option<[f64; 2]>,
    ) -> anyhow::Result<Plan> {
        /// Enough for a row every minute of two months.
        const MOST_ROWS: f64 = 1e5;
        let length_s = to.duration_since(from).as_secs_f64();
        ensure!(
            length_s >= 0.0,
            "--to: expected a time after --from, found {to}"
        );
        ensure!(
            step.as_secs_f64() * MOST_ROWS > length_s.max(1.0),
            "--step: expected at most {MOST_ROWS} rows from --from to --to, found a step of {step:?}"
        );
        let step = SignedDuration::try_from(step)?;
        let mut rows = Vec::new();
        let mut utc = from;
        while utc <= to {
            rows.push(self.report(utc)?);
            utc = utc.checked_add(step)?;
        }
        Ok(Plan {
            rows,
            events: self.events(from, to)?,
            band: band.map(|band| self.band(from, to, band)).transpose()?,
        })
    }

    fn events(&mut self, from: Timestamp, to: Timestamp) -> Result<Vec<Event>, SkyError> {
        let (place, horizon) = (self.place, horizon_deg(self.place));
        let above = crossings(from, to, |utc| {
            Ok(self.ephemeris.sun(utc, place)?.elevation_deg - horizon)
        })?;
        let east = crossings(from, to, |utc| {
            let sun = self.ephemeris.sun(utc, place)?;
            Ok(direction(sun.azimuth_deg, sun.elevation_deg).y)
        })?;
        let rises = above.iter().map(|crossing| match crossing.rising {
            Rising::Up => (crossing.utc, "rise"),
            Rising::Down => (crossing.utc, "set"),
        });
        // The Sun goes from east to west above the pole; below it, by night, it comes back.
        let noons = east
            .iter()
            .filter(|crossing| crossing.rising == Rising::Down)
            .map(|crossing| (crossing.utc, "transit"));
        let mut found: Vec<_> = rises.chain(noons).collect();
        found.sort();
        let event = |(utc, event)| {
            let sun = self.ephemeris.sun(utc, place)?;
            Ok(Event {
                utc: format!("{utc:.0}"),
                event,
                azimuth_deg: sun.azimuth_deg,
                elevation_deg: self.lifted(sun.elevation_deg),
            })
        };
        found.into_iter().map(event).collect()
    }

    fn band(
        &mut self,
        from: Timestamp,
        to: Timestamp,
        [low_deg, high_deg]: [f64; 2],
    ) -> Result<Band, SkyError> {
        let found = spells(from, to, [low_deg, high_deg], |utc| {
            let sun = self.ephemeris.sun(utc, self.place)?;
            Ok(self.lifted(sun.elevation_deg))
        })?;
        let length = |spell: &[Timestamp; 2]| spell[1].duration_since(spell[0]).as_secs_f64();
        Ok(Band {
            low_deg,
            high_deg,
            hours: found.iter().map(length).sum::<f64>() / 3600.0,
            spells: found
                .iter()
                .map(|spell| spell.map(|utc| format!("{utc:.0}")))
                .collect(),
        })
    }
}

fn card(report: &Report) -> String {
    let Report { utc, sun, moon } = report;
    let pair = |name, sun, moon, unit| format!("{name:24} {sun:15.5} {moon:12.5} {unit}");
    let of_sun = |name, value| format!("{name:24} {value:15.5} {:12} deg", "");
    let of_moon = |name, value| format!("{name:24} {value:28.5} deg");
    [
        format!("{utc:24} {:>15} {:>12}", "Sun", "Moon"),
        pair("azimuth", sun.azimuth_deg, moon.azimuth_deg, "deg"),
        pair("elevation", sun.elevation_deg, moon.elevation_deg, "deg"),
        pair("radius", sun.radius_arcsec, moon.radius_arcsec, "arcsec"),
        of_sun("zenith to solar north", sun.zenith_to_north_deg),
        of_sun("P", sun.p_deg),
        of_sun("B0", sun.b0_deg),
        of_sun("L0", sun.l0_deg),
        of_moon("phase angle", moon.phase_angle_deg),
        of_moon("bright limb from north", moon.bright_limb_deg),
        of_moon("bright limb from zenith", moon.zenith_to_bright_limb_deg),
    ]
    .join("\n")
}

fn table(plan: &Plan) -> String {
    let mut lines = vec![format!(
        "{:24} {:>10} {:>10} {:>10} {:>10} {:>10}",
        "UTC; angles in deg", "Sun az", "el", "to north", "Moon az", "el"
    )];
    lines.extend(plan.rows.iter().map(|Report { utc, sun, moon }| {
        format!(
            "{utc:24} {:10.4} {:10.4} {:10.3} {:10.4} {:10.4}",
            sun.azimuth_deg,
            sun.elevation_deg,
            sun.zenith_to_north_deg,
            moon.azimuth_deg,
            moon.elevation_deg
        )
    }));
    lines.extend(plan.events.iter().map(|event| {
        let name = event.event;
        let (utc, azimuth, elevation) = (&event.utc, event.azimuth_deg, event.elevation_deg);
        format!("{utc:24} {azimuth:10.4} {elevation:10.4} {name:>10}")
    }));
    if let Some(band) = &plan.band {
        let (low, high, hours) = (band.low_deg, band.high_deg, band.hours);
        lines.push(format!("{hours:.2} h between {low} and {high} deg:"));
        lines.extend(
            band.spells
                .iter()
                .map(|[from, to]| format!("{from} to {to}")),
        );
    }
    lines.join("\n")
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
        assert_eq!(args.place.latitude_deg, -77.85);
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
