//! `solaspect events`: photons put on the Sun.

use super::options::interrupted;
use super::output::{Follower, say};
use crate::events::{Exposure, Files, Placed, place_photons};
use crate::units::counted;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Put the photons of an event list on the Sun, by the pointing of a refined flight
///
/// Copies a FITS file (OGIP: a table EVENTS with TIME, X and Y) and adds the columns HPX, HPY, HP_SIGMA, HP_SYS and HP_VALID. Good time
/// intervals (GTI, STDGTI) are intersected with those in which the pointing is valid. All else stays byte for byte. docs/events.md has the
/// columns and DET.toml.
#[derive(Debug, Args)]
pub struct EventsArgs {
    /// The folder that `solaspect refine` wrote: pointing.fits is read
    #[arg(value_name = "REFINED")]
    refined: PathBuf,
    /// The event list, FITS, plain or gzipped
    #[arg(value_name = "EVENTS.fits")]
    events: PathBuf,
    /// How the detectors are mounted (docs/events.md)
    #[arg(long, value_name = "DET.toml")]
    detectors: PathBuf,
    /// The copy with the photons' places; replaced if it exists
    #[arg(long, value_name = "OUT.fits")]
    out: PathBuf,
}

pub fn run(args: &EventsArgs) -> anyhow::Result<ExitCode> {
    args.run(&interrupted()?)
}

impl EventsArgs {
    /// Puts the photons on the Sun, and prints how many.
    ///
    /// # Errors
    /// Files that are not what they should be; a run that was cancelled.
    pub fn run(&self, cancelled: &Arc<AtomicBool>) -> anyhow::Result<ExitCode> {
        let follower = Follower::new("events", cancelled);
        let files = Files {
            refined: &self.refined,
            events: &self.events,
            detectors: &self.detectors,
            out: &self.out,
        };
        print(&place_photons(files, &follower)?)?;
        Ok(ExitCode::SUCCESS)
    }
}

fn print(placed: &Placed) -> anyhow::Result<()> {
    let Placed {
        photons,
        valid,
        invalid,
        exposures,
    } = placed;
    say(format_args!(
        "{}, {valid} of them valid",
        counted(*photons, "photon")
    ))?;
    for (why, count) in invalid {
        say(format_args!("  {count} not valid: {why}"))?;
    }
    for Exposure {
        extension,
        before_s,
        after_s,
    } in exposures
    {
        say(format_args!(
            "{extension}: {before_s:.3} s, {after_s:.3} s of them with a valid pointing"
        ))?;
    }
    Ok(())
}
