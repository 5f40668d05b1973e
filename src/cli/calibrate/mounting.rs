//! `solaspect calibrate mounting`: boresight, clocking, plate distance, rule of directions and mirror.

use super::edition::{Edition, print_rejected};
use crate::calibrate::mounting::{self, Frames, Mounting, PointingLog, Pointings};
use crate::calibrate::revision::Provenance;
use crate::cli::options;
use crate::cli::output::say;
use crate::geometry::Handedness;
use crate::observe::{Depth, RejectedFrame, Watch, list, sha256};
use crate::sky::Air;
use crate::units::Place;
use anyhow::Context;
use clap::Args;
use jiff::tz::TimeZone;
use std::path::PathBuf;
use std::process::ExitCode;

/// Measure centre, clocking, plate distance, rule of directions and mirror from the Sun on the plate
///
/// Either the pointing is known (--pointing), or the gondola is at rest while the Sun crosses the plate (--drift): the ephemeris
/// is the reference. What the frames do not determine keeps the instrument's value, and the program says so. With --roll-camera it is that
/// camera's place on the body that is measured.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub struct MountingArgs {
    /// Frames, or folders of them
    #[arg(required = true, value_name = "FRAME|DIR")]
    pub(super) frames: Vec<PathBuf>,
    #[command(flatten)]
    pub(super) edition: Edition,
    /// CSV file of where the telescope pointed: UTC, azimuth, elevation in deg, elevation without refraction
    #[arg(
        long,
        value_name = "CSV",
        required_unless_present_any = ["drift", "roll_camera"],
        conflicts_with_all = ["drift", "roll_camera"]
    )]
    pub(super) pointing: Option<PathBuf>,
    /// The elevations of --pointing include refraction, as read from a theodolite
    #[arg(long, requires = "pointing")]
    pub(super) apparent: bool,
    /// The gondola was at rest, its direction unknown, while the Sun crossed the plate
    #[arg(long, conflicts_with = "roll_camera")]
    pub(super) drift: bool,
    /// Measure body_from_camera of the camera that sees the horizon instead, whose file this is: --out is its new file. From a flight in
    /// which the Sun was seen, too (frames of the roll camera are named roll_*), by a telescope whose boresight is the body's forward axis;
    /// or from frames of the horizon alone with --attitude
    #[arg(long, value_name = "CAM.toml", conflicts_with = "report")]
    pub(super) roll_camera: Option<PathBuf>,
    /// CSV file of the body's attitude: UTC, roll (right side low positive) and pitch (forward end high positive) in deg
    // Neither telescope nor Sun takes part.
    #[arg(
        long,
        value_name = "CSV",
        requires = "roll_camera",
        conflicts_with_all = ["instrument", "air"]
    )]
    pub(super) attitude: Option<PathBuf>,
    /// Where the frames were taken, for frames that do not say so
    #[arg(long, value_name = "LAT,LON,HEIGHT_M", allow_hyphen_values = true)]
    pub(super) place: Option<Place>,
    /// Pressure and temperature of the air about the observer; 0,0 for none [default: the standard atmosphere's at the height]
    #[arg(long, value_name = "HPA,DEG_C", allow_hyphen_values = true)]
    pub(super) air: Option<Air>,
    /// The configuration's TOML file
    #[arg(long, value_name = "FILE")]
    pub(super) config: Option<PathBuf>,
}

pub fn run(args: MountingArgs, watch: &dyn Watch) -> anyhow::Result<ExitCode> {
    let (mut revision, stated) = args.edition.open()?;
    let config = options::config(args.config.as_deref())?;
    let log = args
        .pointing
        .as_deref()
        .map(PointingLog::read)
        .transpose()?;
    let files = list(&args.frames, Depth::All)?;
    let frames = Frames {
        instrument: &stated,
        place: args.place.or(config.site.place()),
        log: log.as_ref(),
        apparent: args.apparent,
        air: args.air,
        ephemeris: options::ephemeris(&config)?,
    };
    let (observations, mut rejected, handedness) = mounting::collect(&files, &frames, watch)?;
    let pointings = match log {
        Some(_) => Pointings::Known,
        None => Pointings::Fixed,
    };
    let mut seen = stated.clone();
    seen.mounting.handedness = handedness;
    let mounting = mounting::calibrate(&observations, pointings, &seen)
        .with_context(|| RejectedFrame::count_and_first(&rejected))?;
    rejected.extend(mounting.rejected.iter().cloned());
    let provenance = provenance(&mounting, &files);
    mounting.revise(&mut revision, &provenance);
    let found = (handedness != stated.mounting.handedness).then(|| handedness_name(handedness));
    if let Some(name) = found {
        revision.set("mounting.handedness", name.into(), None, &provenance);
    }
    args.edition.write(&revision)?;
    say(mounting.agreement(&stated))?;
    mounting.quantities.iter().try_for_each(say)?;
    if let Some(name) = found {
        say(format_args!("handedness: determined by the marks: {name}"))?;
    }
    print_rejected(&rejected)?;
    args.edition.write_page("mounting.html", || {
        mounting::page(&mounting, &seen, &provenance.source, &rejected)
    })?;
    Ok(ExitCode::SUCCESS)
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
        date: Some(TimeZone::UTC.to_datetime(last).date()),
        frames: taken,
        frames_sha256: sha256(files),
        // The Sun's path tells how the plate sits, not which camera sees it.
        camera: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        args: MountingArgs,
    }

    fn parse(options: &str) -> Result<Line, clap::Error> {
        let line = "mounting --out new.toml --roll-camera cam.toml flight";
        Line::try_parse_from(line.split(' ').chain(options.split_whitespace()))
    }

    #[test]
    fn what_a_roll_camera_has_no_use_for_is_refused_by_name() {
        assert!(parse("--instrument a.toml --air 0,0").is_ok());
        assert!(parse("--attitude log.csv").is_ok());
        for (options, named) in [
            ("--report page", "--report"),
            ("--attitude log.csv --report page", "--report"),
            ("--attitude log.csv --instrument a.toml", "--instrument"),
            ("--attitude log.csv --air 0,0", "--air"),
        ] {
            let error = parse(options).unwrap_err();
            assert_eq!(error.kind(), clap::error::ErrorKind::ArgumentConflict);
            assert!(error.to_string().contains(named), "{error}");
        }
    }
}
