//! `solaspect fly`: the flight service.

mod live;

use super::options::{self, ConfigurationArgs};
use super::output::say;
use crate::plan::{Plan, Remarks, Replay, Severity};
use crate::provenance;
use crate::service::{Flight, FlightTally, Service};
use clap::Args;
use live::LiveLine;
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Fly: read the camera, solve, send offsets to the controller, archive every frame
#[derive(Debug, Args)]
pub struct FlyArgs {
    #[command(flatten)]
    over: ConfigurationArgs,
    /// Replay a folder this many times faster than it was taken
    #[arg(long, value_name = "FACTOR", default_value = "1", value_parser = options::speed)]
    speed: f64,
    /// End after this time [default: fly until SIGTERM, SIGINT or SIGHUP]
    #[arg(long, value_name = "TIME", value_parser = options::duration)]
    duration: Option<Duration>,
    /// Fly although the plan has errors (see `solaspect config check`): what is wrong is ignored, or stays at its default; without the first camera nothing flies
    #[arg(long)]
    force: bool,
}

/// Time after a request to end within which the program ends, apart from a little time for the line.
const ENDING: Duration = Duration::from_millis(1500);

pub fn run(args: FlyArgs) -> anyhow::Result<ExitCode> {
    let (plan, remarks) = Plan::survey(args.over.config.as_deref(), &args.over.options());
    let is_forced = args.force && plan.has_first_camera();
    if !is_forced {
        remarks.without_errors()?;
    }
    let replay = Replay {
        duration: args.duration,
        speed: args.speed,
    };
    let mut flight = Flight::of_plan(&plan, replay)?;
    log_start(&plan, &flight);
    warn_of_remarks(&remarks);
    flight.claim()?;
    flight.open_cameras()?;
    let interrupted = options::interrupted()?;
    let service = Service::start(flight)?;
    let mut live = LiveLine::new();
    let start = Instant::now();
    let is_stopped = || interrupted.load(Ordering::Relaxed) || service.controls().quit_requested();
    let is_over = || {
        args.duration
            .is_some_and(|duration| start.elapsed() >= duration)
    };
    while !service.is_finished() {
        std::thread::sleep(Duration::from_millis(20));
        live.renew(&service);
        if is_stopped() {
            service.stop_within(ENDING);
        } else if is_over() {
            service.stop();
        }
    }
    let ends_by_request = is_stopped();
    let tally = service.join()?;
    live.end();
    say(&tally)?;
    Ok(exit_code(&tally, ends_by_request))
}

fn exit_code(tally: &FlightTally, ends_by_request: bool) -> ExitCode {
    match tally.lost() {
        // The end was requested; losses in flight are in the log.
        _ if ends_by_request => ExitCode::SUCCESS,
        _ if tally.gave_up => ExitCode::FAILURE,
        0 => ExitCode::SUCCESS,
        _ => ExitCode::FAILURE,
    }
}

/// The head of the log: program, plan, and unusual settings.
fn log_start(plan: &Plan, flight: &Flight) {
    let (version, commit) = (provenance::VERSION, provenance::COMMIT);
    let configuration_sha256 = provenance::sha256(flight.configuration_toml());
    tracing::info!(version, commit, configuration_sha256, "solaspect flies");
    let now = plan.clock.now();
    if let Err(error) = plan.ephemeris().disc(now) {
        tracing::warn!(%error, "frames of today will have no offsets: see sky.earth_orientation");
    }
    if let Some(extrapolated) = plan.orientation.extrapolates(now) {
        tracing::warn!("{extrapolated}: see sky.earth_orientation");
    }
    let first = plan.cameras.first();
    if first.is_some_and(|first| first.source.is_simulated()) {
        tracing::warn!("frames and offsets are simulated");
    }
}

/// Logs errors of a plan that flies by force, and warnings of any plan.
fn warn_of_remarks(remarks: &Remarks) {
    for remark in &remarks.list {
        match remark.severity {
            Severity::Error => tracing::error!("{}", remark.what),
            Severity::Warning => tracing::warn!("{}", remark.what),
        }
    }
    let errors = remarks.errors().count();
    if errors > 0 {
        tracing::error!(errors, "flies by --force: the plan has errors");
    }
}
