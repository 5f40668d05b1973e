//! `solaspect fly`: the flight service.

mod cameras;
mod live;

use super::options::{self, ConfigurationArgs};
use super::output::say;
use crate::archive::Store;
use crate::archive::disk::LocalDisk;
use crate::camera::Source;
use crate::config::{self, Config};
use crate::instrument::Instrument;
use crate::instrument::toml_file::read_text;
use crate::link::{Connection, LocalEnd, PortAddress};
use crate::navigation;
use crate::provenance;
use crate::service::{Flight, Navigation, Service};
use clap::Args;
use jiff::Timestamp;
use live::LiveLine;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
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
}

/// A program that is told to end has ended after this, and a little for the line.
const ENDING: Duration = Duration::from_millis(1500);

pub fn run(args: FlyArgs) -> anyhow::Result<ExitCode> {
    let mut config = options::config(args.over.config.as_deref())?;
    args.over.options().over(&mut config);
    if let Some(fault) = config.faults().into_iter().next() {
        let file = args.over.config.as_deref();
        let place = file.map_or("the command line".into(), |file| file.display().to_string());
        anyhow::bail!("{place}: {fault}");
    }
    let (camera, other_cameras) = cameras::of(&config, args.duration, args.speed)?;
    let mut flight = Flight {
        config,
        other_cameras,
        ..Flight::of(camera)
    };
    say_who_flies(&flight);
    let mut ephemeris = options::ephemeris(&flight.config)?;
    if let Err(error) = ephemeris.disc(Timestamp::now()) {
        tracing::warn!(%error, "frames of today will have no offsets: see sky.earth_orientation");
    }
    if let Some(extrapolated) = ephemeris.extrapolates(Timestamp::now()) {
        tracing::warn!("{extrapolated}: see sky.earth_orientation");
    }
    flight.target = options::target(&flight.config, &mut ephemeris)?;
    flight.ephemeris = ephemeris;
    flight.line = line(&flight.config.link)?;
    flight.navigation = navigation(&flight.config)?;
    flight.stores = stores(&flight.config, &flight.camera.instrument);
    flight.claim()?;
    flight.open_cameras()?;
    let interrupted = options::interrupted()?;
    if matches!(flight.config.camera.source, Some(Source::Simulated(_))) {
        tracing::warn!("the frames are the simulator's, and so is what is sent of them");
    }
    let service = Service::start(flight)?;
    let mut live = LiveLine::new();
    let start = Instant::now();
    let told_to_end = || interrupted.load(Ordering::Relaxed) || service.controls().quits();
    while !service.is_finished() {
        std::thread::sleep(Duration::from_millis(20));
        live.renew(&service);
        if told_to_end() {
            service.stop_within(ENDING);
        } else if args
            .duration
            .is_some_and(|duration| start.elapsed() >= duration)
        {
            service.stop();
        }
    }
    let told_to_end = told_to_end();
    let tally = service.join()?;
    live.end();
    say(&tally)?;
    Ok(match tally.lost() {
        // It did as it was told; what was lost in flight is in the log.
        _ if told_to_end => ExitCode::SUCCESS,
        _ if tally.gave_up => ExitCode::FAILURE,
        0 => ExitCode::SUCCESS,
        _ => ExitCode::FAILURE,
    })
}

/// The first line of the log: which program flies what.
fn say_who_flies(flight: &Flight) {
    let (version, commit) = (provenance::VERSION, provenance::COMMIT);
    let configuration_sha256 = provenance::sha256(flight.configuration_toml());
    tracing::info!(version, commit, configuration_sha256, "solaspect flies");
}

/// A port that is not there is looked for in flight.
fn line(link: &config::Link) -> anyhow::Result<Connection> {
    let Some(address) = link.address()? else {
        return Ok(Connection::none());
    };
    Ok(Connection::to(address, link.baud, link.local_end()?).guarded(link.guard()?))
}

/// The navigation that the configuration enables, with its sensors' lines.
fn navigation(config: &Config) -> anyhow::Result<Option<Navigation>> {
    let own = &config.navigation;
    // A port that cannot be is an error as in `config check`, also where the filter is off.
    let (imu, gps) = (own.imu_address()?, own.gps_address()?);
    let Some(path) = own.settings.as_deref().filter(|_| own.is_enabled()) else {
        return Ok(None);
    };
    let settings_toml = read_text(path)?;
    let settings = navigation::Settings::parse(path, &settings_toml)?;
    let connection = |address: Option<PortAddress>, baud| {
        address.map(|address| Connection::to(address, baud, LocalEnd::default()))
    };
    Ok(Some(Navigation {
        imu: connection(imu, config.link.baud),
        gps: connection(gps, own.gps_baud),
        settings: settings.for_flight(path)?,
        settings_toml,
        clock: config.clock(),
    }))
}

/// The archives on the configured disks. They are opened in flight: a disk that hangs keeps nothing from starting.
fn stores(config: &Config, instrument: &Instrument) -> Vec<Store> {
    let archive = &config.archive;
    let folders = [&archive.directory, &archive.second_directory];
    let store = |folder: &PathBuf| {
        let disk = Arc::new(LocalDisk);
        Store::new(disk, folder, &instrument.name, archive.packing())
    };
    folders.into_iter().flatten().map(store).collect()
}
