//! `solaspect calibrate mounting`: boresight, clocking, plate distance and mirror.

use super::edition::{Edition, write_page};
use crate::calibrate::frames::{self, LeftOut};
use crate::calibrate::mounting::{self, Frames, Mounting, PointingLog, Pointings, Verdict};
use crate::calibrate::numbers::sigma_text;
use crate::calibrate::revision::Provenance;
use crate::cli::options;
use crate::cli::output::say;
use crate::geometry::Handedness;
use crate::instrument::Instrument;
use crate::sky::Air;
use crate::units::Place;
use anyhow::Context;
use clap::Args;
use jiff::tz::TimeZone;
use std::path::PathBuf;
use std::process::ExitCode;

/// Measure centre, clocking, plate distance and mirror from the Sun on the plate
///
/// Either the pointing is known (--pointing), or the gondola stands still while the Sun crosses the plate (--drift): the ephemeris
/// is the truth. What the frames do not determine keeps the instrument's value, and the program says so.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub struct MountingArgs {
    /// Frames, or folders of them
    #[arg(required = true, value_name = "FRAME|DIR")]
    frames: Vec<PathBuf>,
    #[command(flatten)]
    edition: Edition,
    /// Write a page with residuals to this folder, mounting.html
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// CSV file of where the telescope pointed: UTC, azimuth, elevation in deg, elevation without refraction
    #[arg(
        long,
        value_name = "CSV",
        required_unless_present = "drift",
        conflicts_with = "drift"
    )]
    pointing: Option<PathBuf>,
    /// The elevations of --pointing hold refraction, as a theodolite reads them
    #[arg(long, requires = "pointing")]
    apparent: bool,
    /// The gondola stood still, its direction unknown, while the Sun crossed
    #[arg(long)]
    drift: bool,
    /// Where the frames were taken, for frames that do not say so
    #[arg(long, value_name = "LAT,LON,HEIGHT_M", allow_hyphen_values = true)]
    place: Option<Place>,
    /// Pressure and temperature of the air about the observer; 0,0 for none [default: the standard atmosphere's at the height]
    #[arg(long, value_name = "HPA,DEG_C", allow_hyphen_values = true)]
    air: Option<Air>,
    /// The configuration's TOML file
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

pub fn run(args: MountingArgs) -> anyhow::Result<ExitCode> {
    let (mut revision, stated) = args.edition.open()?;
    let config = options::config(args.config.as_deref())?;
    let log = args
        .pointing
        .as_deref()
        .map(PointingLog::read)
        .transpose()?;
    let files = frames::list(&args.frames)?;
    let looked = Frames {
        instrument: &stated,
        place: args.place.or(config.site.place()),
        log: log.as_ref(),
        apparent: args.apparent,
        air: args.air,
        ephemeris: options::ephemeris(&config)?,
    };
    let (sights, mut left_out, handedness) = mounting::collect(&files, &looked)?;
    let pointings = match log {
        Some(_) => Pointings::Known,
        None => Pointings::Fixed,
    };
    let seen = with_handedness(&stated, handedness);
    let mounting = mounting::calibrate(&sights, pointings, &seen)
        .with_context(|| frames::first_of(&left_out))?;
    left_out.extend(mounting.left_out.iter().cloned());
    let provenance = provenance(&mounting, &files);
    mounting.revise(&mut revision, &provenance);
    if handedness != stated.mounting.handedness {
        let name = handedness_name(handedness);
        revision.set("mounting.handedness", name.into(), None, &provenance);
    }
    args.edition.write(&revision)?;
    print(&mounting, &stated, &left_out)?;
    if let Some(folder) = &args.report {
        write_page(
            folder,
            "mounting.html",
            &mounting::page(&mounting, &seen, &provenance.source, &left_out)?,
        )?;
    }
    Ok(ExitCode::SUCCESS)
}

fn with_handedness(stated: &Instrument, handedness: Handedness) -> Instrument {
    let mut seen = stated.clone();
    seen.mounting.handedness = handedness;
    seen
}

fn handedness_name(handedness: Handedness) -> &'static str {
    match handedness {
        Handedness::Mirrored => "mirrored",
        Handedness::Direct => "direct",
    }
}

fn provenance(mounting: &Mounting, files: &[PathBuf]) -> Provenance {
    let way = match mounting.fit.pointings {
        Pointings::Known => "known pointing",
        Pointings::Fixed => "drift scan",
    };
    let times = || mounting.fit.residuals.iter().map(|r| r.utc);
    let (first, last) = (
        times().min().unwrap_or_default(),
        times().max().unwrap_or_default(),
    );
    let taken = mounting.fit.accepted();
    Provenance {
        name: "mounting",
        source: format!("mounting calibration, {way}, {taken} frames from {first:.0} to {last:.0}"),
        date: TimeZone::UTC.to_datetime(last).date(),
        frames: taken,
        frames_sha256: frames::sha256(files),
    }
}

fn print(mounting: &Mounting, stated: &Instrument, left_out: &[LeftOut]) -> anyhow::Result<()> {
    let fit = &mounting.fit;
    say(format_args!(
        "{} of {} sights agree, scattering by {:.3} mil ({:.2} arcsec) rms per axis",
        fit.accepted(),
        fit.residuals.len(),
        fit.scatter_mil,
        fit.scatter_mil * stated.optics.arcsec_per_mil(),
    ))?;
    for finding in &mounting.findings {
        let numbers = |values: &[f64]| {
            let texts: Vec<String> = values.iter().map(|v| format!("{v:.4}")).collect();
            texts.join(", ")
        };
        let change = match (&finding.found[..], finding.verdict) {
            ([], _) => String::new(),
            (found, Verdict::Determined) => format!(
                "{} -> {} {} +- {}; ",
                numbers(&finding.stated),
                numbers(found),
                finding.unit,
                sigma_text(finding.sigma)
            ),
            (found, Verdict::Kept) if finding.stated.is_empty() => {
                format!("{} {}; ", numbers(found), finding.unit)
            }
            (_, Verdict::Kept) => format!("{} {}; ", numbers(&finding.stated), finding.unit),
        };
        say(format_args!("{}: {change}{}", finding.name, finding.remark))?;
    }
    if mounting.handedness != stated.mounting.handedness {
        let name = handedness_name(mounting.handedness);
        say(format_args!("handedness: determined by the marks: {name}"))?;
    }
    for LeftOut { name, reason } in left_out {
        say(format_args!("left out: {name}: {reason}"))?;
    }
    Ok(())
}
