//! `solaspect demo`: the full pipeline on simulated hardware.

use super::options;
use super::output::say;
use crate::demo::{self, Demo, Progress};
use crate::log;
use anyhow::Context;
use clap::Args;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

/// Run the full pipeline on simulated hardware
///
/// A simulated camera, the real pipeline, a simulated controller on a pseudo-terminal, a real archive. Exit code 0 only if
/// nothing was lost.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// How long
    #[arg(long, value_name = "TIME", default_value = "20s", value_parser = options::duration)]
    duration: Duration,
    /// Frames per second
    #[arg(long, value_name = "HZ", default_value_t = 4.0, value_parser = options::rate_hz)]
    rate: f64,
    /// The archive's folder [default: a new temporary folder, which is kept]
    #[arg(long, value_name = "DIR")]
    archive: Option<PathBuf>,
    /// Seed: the same seed gives the same flight
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
}

pub fn run(args: DemoArgs) -> anyhow::Result<ExitCode> {
    let is_temporary = args.archive.is_none();
    let archive = match args.archive {
        Some(folder) => folder,
        None => tempfile::Builder::new()
            .prefix("solaspect-demo-")
            .tempdir()
            .context("cannot create a temporary folder")?
            .keep(),
    };
    let demo = Demo {
        rate_hz: args.rate,
        ..Demo::lasting(args.duration, &archive, args.seed)
    };
    let interrupted = options::interrupted()?;
    let on_terminal = std::io::stderr().is_terminal();
    let show = |text: String| {
        if on_terminal {
            log::show(text);
        }
    };
    let summary = demo::run(
        &demo,
        &mut None,
        |progress| show(line(progress)),
        || interrupted.load(std::sync::atomic::Ordering::Relaxed),
    )?;
    show(String::new());
    say(&summary)?;
    if is_temporary {
        say("the archive is kept: remove its folder when it is no longer needed")?;
    }
    Ok(match summary.lost() {
        0 => ExitCode::SUCCESS,
        _ => ExitCode::FAILURE,
    })
}

/// The live line: the frame, its solution, and the offset that the controller received.
fn line(progress: &Progress) -> String {
    let frame = &progress.frame;
    let number = frame.exposure.frame.info.number.unwrap_or_default();
    let quality = frame.solved.quality.name();
    let aspect = frame.sun().and_then(|sun| sun.solution.aspect.as_ref());
    let sun = match (aspect, &frame.solved.stopped) {
        (Some(aspect), _) => {
            let (at, sigma) = (aspect.sun_plate.position, aspect.sun_plate.sigma());
            format!("Sun ({:8.2}, {:8.2}) +- {:.2} mil", at.x, at.y, sigma[0])
        }
        (None, Some(stopped)) => stopped.to_string(),
        (None, None) => String::new(),
    };
    let received = progress.received.map_or("no offset yet".into(), |offset| {
        format!(
            "controller: az {:+.5} el {:+.5} deg",
            offset.azimuth_deg, offset.elevation_deg
        )
    });
    format!("frame {number:>5} {quality:<6} {sun}   {received}")
}
