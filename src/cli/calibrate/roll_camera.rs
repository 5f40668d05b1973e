//! `solaspect calibrate mounting --roll-camera`: how the camera that sees the horizon sits in the body.

use super::edition::print_rejected;
use super::mounting::MountingArgs;
use crate::archive::is_of_roll_camera;
use crate::calibrate::mounting::{self, AttitudeLog, Frames, SunObservation};
use crate::calibrate::revision::{Provenance, Revision, write_if};
use crate::calibrate::roll_camera::{self, Horizon, Horizons, NAME, Sighting, Turn};
use crate::cli::options;
use crate::cli::output::say;
use crate::config::Config;
use crate::instrument::{Directions, MountedCamera, text_of};
use crate::observe::{Depth, RejectedFrame, Watch, list, sha256};
use anyhow::{Context, ensure};
use jiff::tz::TimeZone;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

pub(super) fn run(
    args: &MountingArgs,
    camera_file: &Path,
    watch: &dyn Watch,
) -> anyhow::Result<ExitCode> {
    let text = text_of(camera_file)?;
    let camera = MountedCamera::parse(camera_file, &text)?;
    let mut revision = Revision::of(camera_file, &text)?;
    let config = options::config(args.config.as_deref())?;
    let files = list(&args.frames, Depth::All)?;
    let (sightings, rejected) = sightings(args, &files, &camera, &config, watch)?;
    let turn = roll_camera::fit(&sightings, &camera.body_from_camera)
        .with_context(|| RejectedFrame::count_and_first(&rejected))?;
    turn.revise(&mut revision, &provenance(args, &turn, &sightings, &files));
    write_if(&args.edition.out, &revision.text(), |part| {
        MountedCamera::read(part).map(drop)
    })?;
    say(&turn)?;
    let more = turn.from_stated_deg(&camera.body_from_camera);
    for ((axis, deg), sigma) in ["forward", "right", "down"]
        .iter()
        .zip(more)
        .zip(turn.sigmas_deg())
    {
        say(format_args!(
            "turn from the stated one about the body's {axis} axis: {deg:+.4} +- {sigma:.4} deg"
        ))?;
    }
    print_rejected(&rejected)?;
    Ok(ExitCode::SUCCESS)
}

/// The frames of the horizon at moments of which something is known, and those that are of no use.
fn sightings(
    args: &MountingArgs,
    files: &[PathBuf],
    camera: &MountedCamera,
    config: &Config,
    watch: &dyn Watch,
) -> anyhow::Result<(Vec<Sighting>, Vec<RejectedFrame>)> {
    let place = args.place.or(config.site.place());
    let horizons = Horizons {
        camera: &camera.optics,
        settings: config.roll,
        place,
    };
    let (horizon_files, sun_files): (Vec<PathBuf>, Vec<PathBuf>) = match &args.attitude {
        Some(_) => (files.to_vec(), Vec::new()),
        None => files
            .iter()
            .cloned()
            .partition(|file| is_of_roll_camera(file)),
    };
    ensure!(
        !horizon_files.is_empty(),
        "expected frames of the roll camera (named roll_*), found none; with --attitude any name will do"
    );
    let (seen, mut rejected) = roll_camera::collect(&horizon_files, &horizons, watch)?;
    let (sightings, more) = match &args.attitude {
        Some(log) => roll_camera::with_attitude(seen, &AttitudeLog::read(log)?),
        None => by_sun(args, &sun_files, seen, config, watch)?,
    };
    rejected.extend(more);
    Ok((sightings, rejected))
}

fn by_sun(
    args: &MountingArgs,
    files: &[PathBuf],
    seen: Vec<Horizon>,
    config: &Config,
    watch: &dyn Watch,
) -> anyhow::Result<(Vec<Sighting>, Vec<RejectedFrame>)> {
    let (_, telescope) = args.edition.open()?;
    ensure!(
        telescope.mounting.directions == Directions::Telescope,
        "mounting.directions: expected \"telescope\" to know the Sun's direction in the telescope's axes, found \"{}\"",
        telescope.mounting.directions.name()
    );
    ensure!(
        !files.is_empty(),
        "expected frames of the Sun beside those of the roll camera, found none; --attitude tells the body's attitude without them"
    );
    let frames = Frames {
        instrument: &telescope,
        place: args.place.or(config.site.place()),
        log: None,
        apparent: false,
        air: args.air,
        ephemeris: options::ephemeris(config)?,
    };
    let (mut suns, mut rejected, _) = mounting::collect(files, &frames, watch)?;
    suns.sort_by_key(|sun: &SunObservation| sun.utc);
    let (sightings, more) = roll_camera::with_sun(seen, &suns, &telescope);
    rejected.extend(more);
    Ok((sightings, rejected))
}

fn provenance(
    args: &MountingArgs,
    turn: &Turn,
    sightings: &[Sighting],
    files: &[PathBuf],
) -> Provenance {
    let way = match args.attitude {
        Some(_) => "known attitude",
        None => "Sun and horizon together",
    };
    let times = || sightings.iter().map(|sighting| sighting.horizon.utc);
    let (first, last) = (
        times().min().unwrap_or_default(),
        times().max().unwrap_or_default(),
    );
    let frames = turn.taken;
    Provenance {
        name: NAME,
        source: format!("body_from_camera, {way}, {frames} frames from {first:.0} to {last:.0}"),
        date: Some(TimeZone::UTC.to_datetime(last).date()),
        frames,
        frames_sha256: sha256(files),
        camera: None,
    }
}
