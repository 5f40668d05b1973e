//! `solaspect console`: a flight in a browser.

use super::options;
use super::output::say;
use crate::archive::{CONFIGURATION, INSTRUMENT};
use crate::config::Config;
use crate::console::{ConsoleSettings, Ground, Origin, Running, Secret, Source};
use crate::demo::{self, Demo, Faults, Summary};
use crate::link::port::BAUD;
use crate::link::{AnyPort, Connection, Key, SerialPort};
use crate::simulate::FORT_SUMNER;
use crate::units::Place;
use anyhow::Context;
use clap::Args;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

const DEMO_RATE_HZ: f64 = 4.0;

/// Show a flight in a browser, live or stored, and let one trusted person command it
///
/// By default on this machine alone, and for viewing only. With --token-file users who know the token may log in and send commands.
#[derive(Debug, Args)]
pub struct ConsoleArgs {
    /// Where the flight comes from: udp:[ADDR]:PORT or serial:DEV (what the ground receives), archive:DIR (a flight on disk, also
    /// one that is still written), record:FILE (of --record), or demo (a simulated flight until the console ends, to learn on: with
    /// --token-file it takes commands, and has faults on buttons)
    source: Source,
    /// Where browsers find the console; addresses that others reach need --token-file
    #[arg(long, value_name = "ADDR:PORT", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// A file with a secret of 16 characters or more; it allows to log in and to send commands
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// The address under which a proxy with TLS shows the console: its scheme, host and port, without a path
    #[arg(long, value_name = "https://HOST[:PORT]")]
    public_origin: Option<Origin>,
    /// Where the gondola expects commands, for a source udp:
    #[arg(long, value_name = "ADDR:PORT")]
    gondola: Option<SocketAddr>,
    /// Sign commands with the secret in this file, as link.key_file of the flight requires (UDP only)
    #[arg(long, value_name = "FILE", requires = "gondola")]
    key_file: Option<PathBuf>,
    /// Speed of a serial line
    #[arg(long, default_value_t = BAUD)]
    baud: u32,
    /// Pass all that is received on to another console, as datagrams, each once; may be repeated
    #[arg(long, value_name = "ADDR:PORT")]
    relay: Vec<SocketAddr>,
    /// Record all that is received in a new file, which record:FILE replays
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// The file to which every command and its answer are added
    #[arg(long, value_name = "FILE", default_value = "solaspect-commands.csv")]
    command_log: PathBuf,
    /// How much of the flight is kept in memory
    #[arg(long, value_name = "TIME", default_value = "48h", value_parser = options::duration)]
    keep: Duration,
    /// The instrument: a TOML file, or the name of a built-in one [default: the archive's, else demo]
    #[arg(long, value_name = "FILE|NAME")]
    instrument: Option<PathBuf>,
    /// The configuration with the target and the solver's settings [default: the archive's, else the defaults]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Where the gondola is, for the target's place on the plate [default: the configuration's]
    #[arg(long, value_name = "LAT,LON,HEIGHT_M", allow_hyphen_values = true)]
    place: Option<Place>,
}

pub fn run(args: ConsoleArgs) -> anyhow::Result<ExitCode> {
    let interrupted = options::interrupted()?;
    let over = Arc::new(AtomicBool::new(false));
    let mut demo = match args.source {
        Source::Demo => Some(DemoFlight::start(&over)?),
        _ => None,
    };
    let archive = match &demo {
        Some(demo) => Some(demo.archive.path().to_owned()),
        None => args.archive(),
    };
    let console = Running::start(ConsoleSettings {
        ground: args.ground(archive)?,
        line: demo.as_mut().and_then(|demo| demo.line.take()),
        training: demo.as_ref().map(|demo| demo.faults.clone()),
        key: args.key_file.as_deref().map(Key::read).transpose()?,
        token: args.token_file.as_deref().map(Secret::read).transpose()?,
        source: args.source,
        gondola: args.gondola,
        baud: args.baud,
        relays: args.relay,
        recording: args.record,
        command_log: args.command_log,
        keep: args.keep,
        listen: args.listen,
        public_origin: args.public_origin,
    })?;
    say(format!("the console is at http://{}/", console.address()))?;
    while !interrupted.load(Ordering::Relaxed) && console.is_running() {
        thread::sleep(Duration::from_millis(100));
    }
    let is_whole = console.is_running();
    console.end();
    over.store(true, Ordering::Relaxed);
    if let Some(demo) = demo {
        demo.end()?;
    }
    Ok(match is_whole {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    })
}

impl ConsoleArgs {
    fn archive(&self) -> Option<PathBuf> {
        match &self.source {
            Source::Archive(folder) => Some(folder.clone()),
            _ => None,
        }
    }

    fn ground(&self, archive: Option<PathBuf>) -> anyhow::Result<Ground> {
        let of_archive = |kind| archive.as_deref().and_then(|folder| newest(folder, kind));
        let flown = of_archive(CONFIGURATION.name).filter(|_| self.config.is_none());
        let config = match flown {
            // An archive of another version may have another configuration: its frames are shown all the same.
            Some(path) => Config::read(&path).unwrap_or_else(|error| {
                tracing::warn!(%error, "the archive's configuration is not used");
                Config::default()
            }),
            None => options::config(self.config.as_deref())?,
        };
        let instrument = self
            .instrument
            .clone()
            .or_else(|| of_archive(INSTRUMENT.name));
        let mut ephemeris = options::ephemeris(&config)?;
        let is_demo = self.source == Source::Demo;
        Ok(Ground {
            instrument: options::instrument(instrument.as_deref())?,
            settings: config.solver(),
            target: options::target(&config, &mut ephemeris)?,
            place: self
                .place
                .or(config.site.place())
                .or(is_demo.then_some(FORT_SUMNER)),
            ephemeris,
            archive,
        })
    }
}

/// The newest file of a kind in an archive.
fn newest(folder: &Path, kind: &str) -> Option<PathBuf> {
    let entries = std::fs::read_dir(folder).ok()?.flatten();
    let is_of_kind = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with(&format!("{kind}_")) && name.ends_with(".toml")
    };
    entries.map(|entry| entry.path()).filter(is_of_kind).max()
}

/// A simulated flight, with its archive in a temporary folder that is removed when the console ends.
struct DemoFlight {
    /// The ground's end of the line, until the console takes it.
    line: Option<Connection>,
    archive: tempfile::TempDir,
    faults: Faults,
    /// It returns the far end of the line: the console closes its end first.
    thread: thread::JoinHandle<(anyhow::Result<Summary>, Option<AnyPort>)>,
}

impl DemoFlight {
    fn start(over: &Arc<AtomicBool>) -> anyhow::Result<Self> {
        let archive = tempfile::Builder::new()
            .prefix("solaspect-console-")
            .tempdir()
            .context("cannot create a temporary folder")?;
        let faults = Faults::default();
        let demo = Demo {
            duration: None,
            rate_hz: DEMO_RATE_HZ,
            archive: archive.path().into(),
            seed: 1,
            faults: Some(faults.clone()),
        };
        let (near, far) = SerialPort::pair()?;
        let over = Arc::clone(over);
        let thread = thread::Builder::new().name("demo".into()).spawn(move || {
            let over = || over.load(Ordering::Relaxed);
            let mut ground = Some(Box::new(far) as AnyPort);
            let flown = demo::run(&demo, &mut ground, |_| {}, over);
            if let Err(error) = &flown {
                tracing::error!("the demonstration has failed: {error:#}");
            }
            (flown, ground)
        })?;
        Ok(Self {
            line: Some(Connection::over(near)),
            archive,
            faults,
            thread,
        })
    }

    /// Waits for its end, and returns its result.
    fn end(self) -> anyhow::Result<()> {
        match self.thread.join() {
            Ok((Ok(summary), _ground)) => say(&summary),
            // The error is in the log.
            Ok((Err(_), _)) | Err(_) => Ok(()),
        }
    }
}
