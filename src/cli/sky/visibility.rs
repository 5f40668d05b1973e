//! `solaspect sky visibility`: when the Moon can be seen.

use crate::cli::options;
use crate::sky::visibility::{Sight, Simplified, SunSynchronous, Vantage, sights};
use crate::units::Place;
use anyhow::{Context, ensure};
use clap::Args;
use jiff::{SignedDuration, Timestamp};
use serde::Serialize;
use std::fmt::Write as _;
use std::io::Write as _;
use std::time::Duration;

/// Rows of the table, by the share of the disc that is lit.
const ROWS: usize = 4;
const LEO_HEIGHT_KM: f64 = 550.0;

/// For which share of a month the Moon is above the Earth's limb, clear of the Sun, and how much of it is lit
///
/// The Moon counts by its centre, the Earth is a sphere, and air neither bends light nor hides it.
#[derive(Debug, Args)]
pub struct VisibilityArgs {
    /// leo550 (a sun-synchronous orbit 550 km up), or balloon:LAT,LON,HEIGHT_M
    #[arg(long, value_name = "ORBIT", allow_hyphen_values = true, value_parser = parse_vantage)]
    orbit: Vantage,
    /// Local solar time at which leo550 crosses the equator northwards, h; at 10 the Sun stands some 30 deg off the orbit's plane
    #[arg(long, value_name = "H", default_value_t = 10.0)]
    node_h: f64,
    /// The beginning
    #[arg(long, value_name = "UTC", value_parser = super::parse_utc, default_value = "2026-01-01T00:00:00Z")]
    from: Timestamp,
    /// How long, days: 29.53 from one new Moon to the next
    #[arg(long, value_name = "DAYS", default_value_t = 29.53)]
    days: f64,
    /// How far the Moon must be from the Sun, deg
    #[arg(long, value_name = "DEG", default_value_t = 15.0)]
    clear_of_sun_deg: f64,
    /// Time between two looks
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
            node_h: 10.0,
        })),
        Some(("balloon", place)) => {
            let place: Place = place.parse().map_err(|error| format!("{error}"))?;
            Ok(Vantage::Place(place))
        }
        _ => Err(expected()),
    }
}

/// What was counted over the time.
#[derive(Serialize)]
struct Report {
    looks: usize,
    /// Shares of the time: above the limb, and clear of the Sun, too.
    above_limb: f64,
    seen: f64,
    clear_of_sun_deg: f64,
    by_lit: Vec<LitRow>,
}

/// The time in which the lit share of the disc lies in a range.
#[derive(Serialize)]
struct LitRow {
    lit: [f64; 2],
    /// Of the whole time.
    time: f64,
    /// Of the time in this row.
    above_limb: f64,
    seen: f64,
}

/// A row of the study's table.
#[derive(Serialize)]
struct SimplifiedRow {
    from_new_deg: [f64; 2],
    lit: [f64; 2],
    seen_of_orbit: [f64; 2],
}

#[derive(Serialize)]
struct SimplifiedReport {
    sun_of_orbit: f64,
    rows: Vec<SimplifiedRow>,
}

pub fn run(args: &VisibilityArgs) -> anyhow::Result<()> {
    let in_range = |name: &str, value: f64, range: std::ops::RangeInclusive<f64>| {
        ensure!(
            range.contains(&value),
            "--{name}: expected a number from {} to {}, found {value}",
            range.start(),
            range.end()
        );
        Ok(())
    };
    in_range("days", args.days, 0.01..=400.0)?;
    in_range("clear-of-sun-deg", args.clear_of_sun_deg, 0.0..=180.0)?;
    in_range("node-h", args.node_h, 0.0..=24.0)?;
    let step = SignedDuration::try_from(args.step).context("--step")?;
    ensure!(
        step >= SignedDuration::from_secs(1),
        "--step: expected 1s or more, found {step}"
    );
    let text = match (args.simplified, args.json) {
        (true, true) => serde_json::to_string(&simplified(args)?)?,
        (true, false) => simplified_table(&simplified(args)?),
        (false, true) => serde_json::to_string(&report(args, step)?)?,
        (false, false) => table(&report(args, step)?),
    };
    writeln!(std::io::stdout(), "{text}")?;
    Ok(())
}

fn report(args: &VisibilityArgs, step: SignedDuration) -> anyhow::Result<Report> {
    let length = SignedDuration::try_from_secs_f64(args.days * 86_400.0)?;
    let to = args.from.checked_add(length).context("--days")?;
    let vantage = match args.orbit {
        Vantage::Orbit(orbit) => Vantage::Orbit(SunSynchronous {
            node_h: args.node_h,
            ..orbit
        }),
        place => place,
    };
    let mut ephemeris = options::ephemeris(&options::config(None)?)?;
    let sights = sights(&mut ephemeris, &vantage, (args.from, to), step)?;
    let all: Vec<&Sight> = sights.iter().collect();
    let (above_limb, seen) = shares(&all, args.clear_of_sun_deg);
    let row = |n: usize| {
        let lit = [n, n + 1].map(|n| n as f64 / ROWS as f64);
        let place = |sight: &Sight| ((sight.lit * ROWS as f64) as usize).min(ROWS - 1);
        let inside = sights.iter().filter(|sight| place(sight) == n);
        let inside: Vec<&Sight> = inside.collect();
        let (above_limb, seen) = shares(&inside, args.clear_of_sun_deg);
        LitRow {
            lit,
            time: inside.len() as f64 / sights.len().max(1) as f64,
            above_limb,
            seen,
        }
    };
    Ok(Report {
        looks: sights.len(),
        above_limb,
        seen,
        clear_of_sun_deg: args.clear_of_sun_deg,
        by_lit: (0..ROWS).map(row).collect(),
    })
}

/// Shares of some looks: above the limb, and clear of the Sun, too.
fn shares(sights: &[&Sight], clear_of_sun_deg: f64) -> (f64, f64) {
    let above = sights.iter().filter(|sight| sight.above_limb_deg > 0.0);
    let seen = above
        .clone()
        .filter(|sight| sight.from_sun_deg > clear_of_sun_deg);
    let share = |count: usize| count as f64 / sights.len().max(1) as f64;
    (share(above.count()), share(seen.count()))
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
    let edges = study.edges_deg();
    let row = |ends: &[f64]| {
        let inside = |n: u32| ends[0] + (ends[1] - ends[0]) * (f64::from(n) + 0.5) / 200.0;
        let shares = (0..200).map(|n| study.moon_share(inside(n)));
        let low = shares.clone().fold(1.0, f64::min);
        SimplifiedRow {
            from_new_deg: [ends[0], ends[1]],
            lit: [0, 1].map(|n| (1.0 - ends[n].to_radians().cos()) / 2.0),
            seen_of_orbit: [low, shares.fold(0.0, f64::max)],
        }
    };
    Ok(SimplifiedReport {
        sun_of_orbit: study.share(0.0),
        rows: edges.windows(2).map(row).collect(),
    })
}

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

fn table(report: &Report) -> String {
    let mut text = format!(
        "The Moon is above the limb for {} of the time, and more than {} deg from the Sun, too, for {}\n\n{:<14}{:>10}{:>16}{:>10}",
        percent(report.above_limb),
        report.clear_of_sun_deg,
        percent(report.seen),
        "lit",
        "of all",
        "above the limb",
        "seen",
    );
    for row in &report.by_lit {
        let lit = format!("{:.2} to {:.2}", row.lit[0], row.lit[1]);
        let shares = [row.time, row.above_limb, row.seen].map(percent);
        let [time, above, seen] = shares;
        let _ = write!(text, "\n{lit:<14}{time:>10}{above:>16}{seen:>10}");
    }
    text
}

fn simplified_table(report: &SimplifiedReport) -> String {
    let mut text = format!(
        "The Sun is above the limb for {} of each orbit\n\n{:<20}{:>18}{:>22}",
        percent(report.sun_of_orbit),
        "from new Moon, deg",
        "lit",
        "seen of each orbit",
    );
    for row in &report.rows {
        let from_new = row.from_new_deg.map(|deg| format!("{deg:.1}")).join(" to ");
        let [lit, seen] = [row.lit, row.seen_of_orbit].map(|ends| ends.map(percent).join(" to "));
        let _ = write!(text, "\n{from_new:<20}{lit:>18}{seen:>22}");
    }
    text
}
