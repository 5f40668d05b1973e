//! `solaspect sky visibility`: times at which the Moon can be observed.

use crate::cli::options;
use crate::clock::parse_utc;
use crate::sky::visibility::{Observation, Simplified, SunSynchronous, Vantage, observations};
use crate::units::Place;
use anyhow::{Context, bail, ensure};
use clap::Args;
use jiff::{SignedDuration, Timestamp};
use serde::Serialize;
use std::fmt::Write as _;
use std::io::Write as _;
use std::ops::RangeInclusive;
use std::time::Duration;

/// Number of rows of the table, by the lit fraction of the disc.
const ROWS: usize = 4;
const LEO_HEIGHT_KM: f64 = 550.0;
/// At 10 h the Sun is some 30 deg off the orbit's plane, as in the study of 2005.
const NODE_H: f64 = 10.0;
/// Enough for one sample every minute of a year.
const MOST_SAMPLES: f64 = 1e6;

/// For which share of a month the Moon is above the Earth's limb, clear of the Sun, and how much of it is lit
///
/// Seen is the Moon that is above the limb and clear of the Sun. Moon and Sun count by their centres, the Earth is a sphere of
/// mean radius, and air neither bends light nor hides it.
#[derive(Debug, Args)]
pub struct VisibilityArgs {
    /// leo550 (a sun-synchronous orbit 550 km up), or balloon:LAT,LON,HEIGHT_M
    #[arg(long, value_name = "ORBIT", allow_hyphen_values = true, value_parser = parse_vantage)]
    orbit: Vantage,
    /// Local solar time at which leo550 crosses the equator northwards, h [default: 10, the Sun some 30 deg off the orbit's plane]
    #[arg(long, value_name = "H")]
    node_h: Option<f64>,
    /// The beginning
    #[arg(long, value_name = "UTC", value_parser = parse_utc, default_value = "2026-01-01T00:00:00Z")]
    from: Timestamp,
    /// How long, days: 29.53 from one new Moon to the next
    #[arg(long, value_name = "DAYS", default_value_t = 29.53)]
    days: f64,
    /// How far the Moon must be from the Sun, deg
    #[arg(long, value_name = "DEG", default_value_t = 15.0)]
    clear_of_sun_deg: f64,
    /// Time between two samples
    #[arg(long, value_name = "TIME", default_value = "2m", value_parser = options::duration)]
    step: Duration,
    /// What the study of 2005 assumed instead: Moon and Sun far away in one plane, at right angles to the orbit's
    #[arg(long, conflicts_with_all = ["from", "days", "step", "node_h"])]
    simplified: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

fn parse_vantage(text: &str) -> Result<Vantage, String> {
    let expected = || format!("expected leo550 or balloon:LAT,LON,HEIGHT_M, found \"{text}\"");
    match text.split_once(':') {
        None if text == "leo550" => Ok(Vantage::Orbit(SunSynchronous {
            height_km: LEO_HEIGHT_KM,
            node_h: NODE_H,
        })),
        Some(("balloon", place)) => {
            let place: Place = place.parse().map_err(|error| format!("{error}"))?;
            Ok(Vantage::Place(place))
        }
        _ => Err(expected()),
    }
}

/// Counts over the time. Fractions are from 0 to 1.
#[derive(Serialize)]
struct Report {
    from_utc: String,
    days: f64,
    clear_of_sun_deg: f64,
    samples: usize,
    /// Fraction of the time in which the Sun is above the limb.
    sun_above_limb: f64,
    /// Fraction of the time in which the Moon is above the limb.
    above_limb: f64,
    /// Fraction of the time in which it is also clear of the Sun.
    seen: f64,
    /// Mean lit fraction of its disc, and that while it can be observed, if it ever can.
    mean_lit: f64,
    mean_lit_seen: Option<f64>,
    by_lit: Vec<LitRow>,
}

/// The time in which the lit fraction of the disc is within a range.
#[derive(Serialize)]
struct LitRow {
    lit: [f64; 2],
    /// Fraction of the whole time.
    time: f64,
    /// Fraction of the time in this row, if there is any.
    above_limb: Option<f64>,
    seen: Option<f64>,
}

/// A row of the study's table. Lit fractions are those at its two ends; fractions of an orbit are the smallest and the largest in it.
#[derive(Serialize)]
struct SimplifiedRow {
    from_new_deg: [f64; 2],
    lit: [f64; 2],
    seen_of_orbit: [f64; 2],
}

#[derive(Serialize)]
struct SimplifiedReport {
    clear_of_sun_deg: f64,
    hidden_deg: f64,
    sun_of_orbit: f64,
    /// Fraction of the Moon's path on which it can be observed in a part of each orbit.
    seen_of_path: f64,
    /// Fraction on which it can be observed for at least as long as the Sun is above the limb.
    seen_as_long_as_sun_of_path: f64,
    rows: Vec<SimplifiedRow>,
}

pub fn run(args: &VisibilityArgs) -> anyhow::Result<()> {
    in_range("clear-of-sun-deg", args.clear_of_sun_deg, 0.0..=180.0)?;
    let text = match (args.simplified, args.json) {
        (true, true) => serde_json::to_string(&simplified(args)?)?,
        (true, false) => simplified_table(&simplified(args)?),
        (false, true) => serde_json::to_string(&report(args)?)?,
        (false, false) => table(&report(args)?),
    };
    writeln!(std::io::stdout(), "{text}")?;
    Ok(())
}

fn in_range(name: &str, value: f64, range: RangeInclusive<f64>) -> anyhow::Result<()> {
    ensure!(
        range.contains(&value),
        "--{name}: expected a number from {} to {}, found {value}",
        range.start(),
        range.end()
    );
    Ok(())
}

/// `--orbit` with `--node-h`.
fn vantage(args: &VisibilityArgs) -> anyhow::Result<Vantage> {
    match (args.orbit, args.node_h) {
        (vantage, None) => Ok(vantage),
        (Vantage::Orbit(orbit), Some(node_h)) => {
            in_range("node-h", node_h, 0.0..=24.0)?;
            Ok(Vantage::Orbit(SunSynchronous { node_h, ..orbit }))
        }
        (Vantage::Place(_), Some(_)) => {
            bail!("--node-h: expected --orbit leo550; a balloon has no node")
        }
    }
}

fn report(args: &VisibilityArgs) -> anyhow::Result<Report> {
    in_range("days", args.days, 0.01..=400.0)?;
    ensure!(
        args.step.as_secs_f64() * MOST_SAMPLES >= args.days * 86_400.0,
        "--step: expected at most {MOST_SAMPLES} samples in {} days, found a step of {:?}",
        args.days,
        args.step
    );
    let step = SignedDuration::try_from(args.step).context("--step")?;
    let length = SignedDuration::try_from_secs_f64(args.days * 86_400.0).context("--days")?;
    let to = args.from.checked_add(length).context("--days")?;
    let mut ephemeris = options::ephemeris(&options::config(None)?)?;
    let all =
        observations(&mut ephemeris, &vantage(args)?, (args.from, to), step).context("--from")?;
    Ok(statistics(args, &all))
}

fn statistics(args: &VisibilityArgs, all: &[Observation]) -> Report {
    let above = |one: &Observation| one.moon_above_limb_deg > 0.0;
    let seen = |one: &Observation| above(one) && one.moon_from_sun_deg > args.clear_of_sun_deg;
    let row = |number: usize| {
        let place = |one: &Observation| ((one.lit * ROWS as f64) as usize).min(ROWS - 1);
        let inside = |one: &Observation| place(one) == number;
        let within = |keep: &dyn Fn(&Observation) -> bool| {
            mean(
                all.iter()
                    .filter(|one| inside(one))
                    .map(|one| f64::from(keep(one))),
            )
        };
        LitRow {
            lit: [number, number + 1].map(|n| n as f64 / ROWS as f64),
            time: share(all, inside),
            above_limb: within(&above),
            seen: within(&seen),
        }
    };
    Report {
        from_utc: args.from.to_string(),
        days: args.days,
        clear_of_sun_deg: args.clear_of_sun_deg,
        samples: all.len(),
        sun_above_limb: share(all, |one| one.sun_above_limb_deg > 0.0),
        above_limb: share(all, above),
        seen: share(all, seen),
        mean_lit: all.iter().map(|one| one.lit).sum::<f64>() / all.len() as f64,
        mean_lit_seen: mean(all.iter().filter(|one| seen(one)).map(|one| one.lit)),
        by_lit: (0..ROWS).map(row).collect(),
    }
}

/// The mean; `None` if there are no values.
fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u32), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// The fraction of all samples that are kept; there is at least one sample.
fn share(all: &[Observation], keep: impl Fn(&Observation) -> bool) -> f64 {
    all.iter().filter(|one| keep(one)).count() as f64 / all.len() as f64
}

fn simplified(args: &VisibilityArgs) -> anyhow::Result<SimplifiedReport> {
    ensure!(
        matches!(args.orbit, Vantage::Orbit(_)),
        "--simplified: expected --orbit leo550; the study has no balloon"
    );
    let study = Simplified {
        clear_of_sun_deg: args.clear_of_sun_deg,
        ..Simplified::STUDY_OF_2005
    };
    let sun_of_orbit = study.share(0.0);
    let row = |ends: &[f64]| SimplifiedRow {
        from_new_deg: [ends[0], ends[1]],
        // Eq. 3.3.
        lit: [0, 1].map(|n| (1.0 - ends[n].to_radians().cos()) / 2.0),
        seen_of_orbit: study.moon_share_range(ends[0]..ends[1]),
    };
    Ok(SimplifiedReport {
        clear_of_sun_deg: args.clear_of_sun_deg,
        hidden_deg: 2.0 * study.hidden_deg(),
        sun_of_orbit,
        seen_of_path: 1.0 - args.clear_of_sun_deg / 180.0,
        seen_as_long_as_sun_of_path: study.path_with(sun_of_orbit),
        rows: study.edges_deg().windows(2).map(row).collect(),
    })
}

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

fn percent_if_any(share: Option<f64>) -> String {
    share.map_or("-".to_owned(), percent)
}

fn table(report: &Report) -> String {
    let mut text = format!(
        "{} days from {} on, {} samples; seen: more than {} deg from the Sun\n\n",
        report.days, report.from_utc, report.samples, report.clear_of_sun_deg
    );
    let whole = [
        ("Sun above the limb", percent(report.sun_above_limb)),
        ("Moon above the limb", percent(report.above_limb)),
        ("Moon seen", percent(report.seen)),
        ("mean lit share", percent(report.mean_lit)),
        ("the same while seen", percent_if_any(report.mean_lit_seen)),
    ];
    for (name, value) in whole {
        let _ = writeln!(text, "{name:24} {value:>10}");
    }
    let names = ["of all", "above the limb", "seen"];
    let line = |lit: &str, [time, above, seen]: [String; 3]| {
        format!("\n{lit:24} {time:>10} {above:>15} {seen:>10}")
    };
    text.push_str(&line("lit share", names.map(str::to_owned)));
    for row in &report.by_lit {
        let lit = row.lit.map(|share| format!("{:.0}", 100.0 * share));
        let [above, seen] = [row.above_limb, row.seen].map(percent_if_any);
        let lit = format!("{} %", lit.join(" to "));
        text.push_str(&line(&lit, [percent(row.time), above, seen]));
    }
    text
}

fn simplified_table(report: &SimplifiedReport) -> String {
    let mut text = String::new();
    let whole = [
        ("Sun above the limb, of each orbit", report.sun_of_orbit),
        ("Moon seen, of its path", report.seen_of_path),
        (
            "as long as the Sun, of its path",
            report.seen_as_long_as_sun_of_path,
        ),
    ];
    for (name, share) in whole {
        let _ = writeln!(text, "{name:34} {:>10}", percent(share));
    }
    let names = ["from new Moon, deg", "lit", "seen of each orbit"];
    let line = |[from_new, lit, seen]: [&str; 3]| format!("\n{from_new:24} {lit:>20} {seen:>20}");
    text.push_str(&line(names));
    for row in &report.rows {
        let from_new = row.from_new_deg.map(|deg| format!("{deg:.1}")).join(" to ");
        let [lit, seen] = [row.lit, row.seen_of_orbit].map(|ends| ends.map(percent).join(" to "));
        text.push_str(&line([&from_new, &lit, &seen]));
    }
    text
}
