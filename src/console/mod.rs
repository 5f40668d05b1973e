//! The ground console: a flight in a browser, live or stored, for any number of viewers, with commands to it by one
//! authorised person.
//!
//! ```text
//!  line, record ──> receive ──┐                        ┌── a task for each viewer: live, server, commands, frames
//!  archive ───────> follow ───┴─> History <── View <───┤
//!                                 (a mutex)            └── drawings: plots, pictures, solved frames, two at a time
//!  line <── receive <── outbox (16 commands) <── Orders <── commands, from users who have logged in
//! ```
//!
//! | thread | started by | what it does | what it waits for |
//! |---|---|---|---|
//! | `console-source` | [`Running::start`] | reads the line, sends commands; or reads an archive or a recording, and reads on | the line, 20 ms |
//! | `console-web` | [`Running::start`] | answers all requests, as tasks of one runtime | the network |
//! | up to four of the runtime's | a drawing | draws and reads files | nothing |
//!
//! The history is locked only to take in a packet and to copy the data of an answer, never while drawing, sending or
//! reading from a disk. A viewer gets the newest data when it is ready: nothing is queued for a stalled one.
//!
//! The console only uses data received on the ground, so it puts no load on the flight.

mod access;
mod commands;
mod disk;
mod drawings;
mod frames;
mod ground;
mod history;
mod housekeeping;
mod live;
mod orders;
mod origin;
mod pages;
mod pictures;
mod plots;
mod receive;
mod record;
mod relay;
mod request;
pub mod rules;
mod server;
mod shared;
mod source;
mod stored;
mod table;
#[cfg(test)]
mod tests;
pub mod training;
mod view;
mod web;

pub use access::{Secret, TokenError};
pub use ground::Ground;
pub use orders::Refusal;
pub use origin::{NoOrigin, Origin};
pub use source::Source;

use crate::demo::Faults;
use crate::link::{Connection, LocalEnd, PortAddress, UdpPort};
use access::Access;
use anyhow::{Context, ensure};
use history::History;
use orders::Orders;
use receive::{Line, follow, recording};
use record::Record;
use relay::Relay;
use request::{Console, Parts};
use shared::Shared;
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;
use stored::Follower;

/// Maximum number of commands waiting for the line.
const OUTBOX: usize = 16;

/// Settings of a console: its source, its outputs and its access rules.
pub struct ConsoleSettings {
    pub source: Source,
    /// An open line for a source without an address.
    pub line: Option<Connection>,
    /// Destination of commands over UDP, and the key that signs them.
    pub gondola: Option<SocketAddr>,
    pub key: Option<crate::link::Key>,
    /// Rate of a serial line, bit/s.
    pub baud: u32,
    /// Destinations to which all received data are passed on.
    pub relays: Vec<SocketAddr>,
    pub recording: Option<PathBuf>,
    /// The file with the log of commands.
    pub command_log: PathBuf,
    /// How long rows are kept.
    pub keep: Duration,
    pub ground: Ground,
    pub listen: SocketAddr,
    pub token: Option<Secret>,
    /// Public origin of a reverse proxy.
    pub public_origin: Option<Origin>,
    /// The faults of the demo, for training.
    pub training: Option<Faults>,
}

/// A running console.
pub struct Running {
    address: SocketAddr,
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

impl Running {
    /// Starts a console.
    ///
    /// # Errors
    /// If the address is not allowed or cannot be listened on, if the source cannot be opened or read, or if a log or a
    /// recording cannot be written.
    pub fn start(settings: ConsoleSettings) -> anyhow::Result<Self> {
        ensure!(
            settings.listen.ip().is_loopback() || settings.token.is_some(),
            "--listen {}: expected an address of this machine alone, such as 127.0.0.1:8080, or --token-file",
            settings.listen
        );
        let listener = TcpListener::bind(settings.listen)
            .with_context(|| format!("--listen {}: cannot listen there", settings.listen))?;
        let address = listener.local_addr()?;
        let takes_commands =
            settings.source.takes_commands(settings.gondola) && settings.token.is_some();
        let orders = match takes_commands {
            true => Orders::logged(&settings.command_log)?,
            false => Orders::default(),
        };
        let shared = Arc::new(Shared::new(History::new(settings.keep), orders));
        let (outbox, waiting) = crossbeam_channel::bounded(OUTBOX);
        let console = Console::new(Parts {
            shared: Arc::clone(&shared),
            source: settings.source.clone(),
            access: Access::new(settings.token, address, settings.public_origin.clone()),
            ground: settings.ground.clone(),
            outbox: takes_commands.then_some(outbox),
            recording: settings.recording.clone(),
            training: settings.training.clone(),
        });
        let reader = reader(settings, waiting)?;
        let receives = Arc::clone(&shared);
        let source = thread::Builder::new()
            .name("console-source".into())
            .spawn(move || reader.run(&receives))?;
        let answers = Arc::clone(&shared);
        let web = thread::Builder::new()
            .name("console-web".into())
            .spawn(move || web::serve(listener, server::router(console), &answers))?;
        Ok(Self {
            address,
            shared,
            threads: vec![source, web],
        })
    }

    /// The address on which it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Whether both of its threads still run.
    pub fn is_running(&self) -> bool {
        !self.threads.iter().any(JoinHandle::is_finished)
    }

    /// Stops it; viewers are disconnected.
    pub fn end(self) {
        self.shared.end();
        for thread in self.threads {
            if thread.join().is_err() {
                tracing::error!("a thread of the console has panicked");
            }
        }
    }
}

/// The reader of the source.
enum Reader {
    Line(Box<Line>),
    Archive(Follower),
    Record(Box<Record>),
}

impl Reader {
    fn run(self, shared: &Arc<Shared>) {
        match self {
            Self::Line(line) => line.run(shared),
            Self::Archive(archive) => follow(archive, shared),
            Self::Record(record) => record.follow(shared),
        }
    }
}

/// Opens the source.
fn reader(
    settings: ConsoleSettings,
    outbox: crossbeam_channel::Receiver<receive::Outgoing>,
) -> anyhow::Result<Reader> {
    match &settings.source {
        Source::Archive(folder) => {
            ensure!(
                folder.is_dir(),
                "{}: expected a folder, found none",
                folder.display()
            );
            return Ok(Reader::Archive(Follower::of_flight(folder)));
        }
        Source::Record(file) => {
            let record = Record::open(file).with_context(|| file.display().to_string())?;
            return Ok(Reader::Record(Box::new(record)));
        }
        Source::Udp(_) | Source::Serial(_) | Source::Demo => {}
    }
    let relay = Relay::to(&settings.relays, &settings.source)?;
    let recording = settings.recording.as_ref().map(|path| {
        let file = recording(path);
        file.with_context(|| format!("--record {}: cannot write", path.display()))
    });
    let frames = settings.ground.archive.as_deref().map(Follower::of_frames);
    let recording = recording.transpose()?;
    Ok(Reader::Line(Box::new(Line {
        key: settings.key.clone(),
        connection: connection(settings)?,
        outbox,
        relay,
        recording,
        frames,
    })))
}

/// The line of the source. It waits for a missing serial device; an address that cannot be listened on is an error.
fn connection(settings: ConsoleSettings) -> anyhow::Result<Connection> {
    if let Some(line) = settings.line {
        return Ok(line);
    }
    match settings.source {
        Source::Udp(here) => {
            // Port 9 is unused: nothing is sent.
            let nobody = SocketAddr::from((Ipv4Addr::LOCALHOST, 9));
            let local = LocalEnd {
                address: Some(here.ip()),
                port: here.port(),
            };
            let port = UdpPort::open(settings.gondola.unwrap_or(nobody), local)?;
            Ok(Connection::over(port))
        }
        Source::Serial(name) => Ok(Connection::to(
            PortAddress::Serial { name },
            settings.baud,
            LocalEnd::default(),
        )),
        Source::Demo | Source::Archive(_) | Source::Record(_) => Ok(Connection::none()),
    }
}
