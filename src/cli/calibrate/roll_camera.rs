//! `solaspect calibrate mounting --roll-camera`: the orientation of the horizon camera in the body.

use super::edition::print_rejected;
use super::mounting::MountingArgs;
use crate::calibrate::mounting::{AttitudeLog, Frames};
use crate::calibrate::revision::{Revision, write_if};
use crate::calibrate::roll_camera::{self, Horizons, Reference};
use crate::cli::options;
use crate::cli::output::say;
use crate::instrument::{MountedCamera, text_of};
use crate::observe::Watch;
use std::path::Path;
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
    let place = args.place.or(config.site.place());
    let horizons = Horizons {
        camera: &camera.optics,
        settings: config.roll,
        place,
    };
    let (log, telescope, frames);
    let reference = match &args.attitude {
        Some(path) => {
            log = AttitudeLog::read(path)?;
            Reference::Attitude(&log)
        }
        None => {
            (_, telescope) = args.edition.open()?;
            frames = Frames {
                instrument: &telescope,
                place,
                log: None,
                apparent: false,
                air: args.air,
                ephemeris: options::ephemeris(&config)?,
            };
            Reference::Sun(&frames)
        }
    };
    let found = roll_camera::from_frames(&args.frames, &camera, &horizons, reference, watch)?;
    found.revise(&mut revision);
    write_if(&args.edition.out, &revision.text(), |part| {
        MountedCamera::read(part).map(drop)
    })?;
    found.lines().iter().try_for_each(say)?;
    print_rejected(&found.rejected)?;
    Ok(ExitCode::SUCCESS)
}
