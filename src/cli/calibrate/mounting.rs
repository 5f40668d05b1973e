//! `solaspect calibrate mounting`: boresight, clocking, plate distance, rule of directions and mirror.

use super::edition::{Edition, print_rejected};
use crate::calibrate::mounting::{self, Frames, PointingLog};
use crate::cli::options;
use crate::cli::output::say;
use crate::observe::Watch;
use crate::sky::Air;
use crate::units::Place;
use clap::Args;
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
    let frames = Frames {
        instrument: &stated,
        place: args.place.or(config.site.place()),
        log: log.as_ref(),
        apparent: args.apparent,
        air: args.air,
        ephemeris: options::ephemeris(&config)?,
    };
    let found = mounting::from_frames(&args.frames, &frames, watch)?;
    found.revise(&mut revision);
    args.edition.write(&revision)?;
    found.lines().iter().try_for_each(say)?;
    print_rejected(&found.rejected)?;
    args.edition.write_page("mounting.html", || found.page())?;
    Ok(ExitCode::SUCCESS)
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
