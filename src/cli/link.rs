//! `solaspect link`: manual operation of the controller's line: send a command, decode packets, record a line.

use super::options;
use super::output::say;
use crate::commands::words::{describe, result_in_words};
use crate::commands::{Dictionary, Framing, order};
use crate::files;
use crate::link::byte_log::{self, Burst, Contents};
use crate::link::ground::{ask, ask_for_moon};
use crate::link::hex::from_hex;
use crate::link::port::BAUD;
use crate::link::{AnyPort, Computer, Direction, Key, LocalEnd, Message, PortAddress, UdpPort};
use crate::units::counted;
use anyhow::Context;
use clap::{Args, Subcommand, ValueEnum};
use jiff::Timestamp;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Send a command over the controller's line, decode packets, record a line, describe its packets
#[derive(Debug, Args)]
pub struct LinkArgs {
    #[command(subcommand)]
    command: LinkCommand,
}

#[derive(Debug, Subcommand)]
enum LinkCommand {
    Send(SendArgs),
    Decode(DecodeArgs),
    Log(LogArgs),
    Describe(DescribeArgs),
}

/// Where the line is.
#[derive(Debug, Args)]
struct Line {
    /// A serial port, or udp:HOST:PORT[@LOCALPORT] with an IP address as HOST
    #[arg(long, value_name = "PORT")]
    port: PortAddress,
    /// Speed of a serial port
    #[arg(long, default_value_t = BAUD)]
    baud: u32,
}

impl Line {
    /// Opens the line; packets to a computer are signed if there is a key.
    fn open(&self, key: Option<&Path>, computer: Computer) -> anyhow::Result<AnyPort> {
        // Any free local port if the address names none: the peer's own may be on this computer.
        let local = LocalEnd::default();
        match (&self.port, key) {
            (port, None) => Ok(port.open(self.baud, local)?),
            (PortAddress::Udp { peer, local_port }, Some(key)) => {
                let port = local_port.unwrap_or_default();
                let port = UdpPort::open(*peer, LocalEnd { port, ..local })?;
                Ok(Box::new(port.signing(Key::read(key)?.towards(computer))))
            }
            (PortAddress::Serial { .. }, Some(_)) => {
                anyhow::bail!("--key-file: expected a port udp:HOST:PORT, found a serial port")
            }
        }
    }
}

/// Send a command and wait for its receipt and result
///
/// Exit code 1: refused, not carried out, or not answered.
#[derive(Debug, Args)]
struct SendArgs {
    #[command(flatten)]
    line: Line,
    /// Sign the command with the secret in this file, as link.key_file of the flight requires (UDP only)
    #[arg(long, value_name = "FILE")]
    key_file: Option<PathBuf>,
    /// The computer that is addressed, 1 or 2
    #[arg(long, default_value = "1", value_parser = computer)]
    computer: Computer,
    /// How long to wait for the answer; a request for the Moon is answered when a picture has been taken
    #[arg(long, value_name = "TIME", default_value = "2s", value_parser = options::duration)]
    timeout: Duration,
    /// Name or key of the command table (docs/protocol.md), start_tracking, stop_tracking, gps or moon
    command: String,
    /// Its values in natural units: angles in deg, signed numbers with their sign, 1 or 0 for on or off
    #[arg(allow_negative_numbers = true)]
    values: Vec<String>,
}

/// Decode packets: every message, unknown packets, and why bytes were rejected
///
/// Exit code 1: some bytes are no packets.
#[derive(Debug, Args)]
struct DecodeArgs {
    /// Bytes in hexadecimal, or a file of them, or of a byte log, or of raw bytes
    bytes: String,
    /// Sender of the bytes [default: the more plausible one]
    #[arg(long)]
    from: Option<PacketSender>,
}

/// Record the bytes of a line, or decode a record
///
/// Bad lines of a record are skipped, with one warning. Exit code 1: nothing of it could be read.
#[derive(Debug, Args)]
struct LogArgs {
    /// A record to read
    #[arg(required_unless_present = "port", conflicts_with = "port")]
    file: Option<PathBuf>,
    /// Record from a serial port, or udp:HOST:PORT[@LOCALPORT] with an IP address as HOST
    #[arg(long, value_name = "PORT")]
    port: Option<PortAddress>,
    /// Speed of a serial port
    #[arg(long, default_value_t = BAUD)]
    baud: u32,
    /// Where the record goes, a new file [default: standard output]
    #[arg(long, value_name = "FILE", requires = "port")]
    out: Option<PathBuf>,
    /// How long to record [default: until SIGINT]
    #[arg(long, value_name = "TIME", requires = "port", value_parser = options::duration)]
    duration: Option<Duration>,
    /// Sender of the bytes [default: the more plausible one]
    #[arg(long)]
    from: Option<PacketSender>,
}

/// Print packets and commands as a description that other programs read (docs/protocol.md)
#[derive(Debug, Args)]
struct DescribeArgs {
    /// Language of the description
    #[arg(long)]
    format: Format,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Format {
    /// A dictionary for the ground system of NASA's F Prime
    Json,
    /// Kaitai Struct: packets both ways
    Ksy,
    /// XTCE 1.2: telemetry, and commands to the aspect system
    Xtce,
    /// XTCE 1.2: telemetry in CCSDS space packets, as outputs have it (docs/outputs.md)
    XtceCcsds,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum PacketSender {
    Aspect,
    /// The controller, or the ground
    Controller,
}

impl PacketSender {
    fn direction(self) -> Direction {
        match self {
            Self::Aspect => Direction::ToController,
            Self::Controller => Direction::ToAspect,
        }
    }
}

fn computer(text: &str) -> Result<Computer, String> {
    let number = text.parse().ok().and_then(Computer::numbered);
    number.ok_or_else(|| format!("expected 1 or 2, found \"{text}\""))
}

pub fn run(args: LinkArgs) -> anyhow::Result<ExitCode> {
    match args.command {
        LinkCommand::Send(args) => send(&args),
        LinkCommand::Decode(args) => decode(&args),
        LinkCommand::Log(args) => log(&args),
        LinkCommand::Describe(args) => {
            let dictionary = Dictionary::default();
            let description = match args.format {
                Format::Json => serde_json::to_string_pretty(&dictionary.json())?,
                Format::Ksy => dictionary.kaitai(),
                Format::Xtce => dictionary.xtce(Framing::Line),
                Format::XtceCcsds => dictionary.xtce(Framing::Ccsds),
            };
            say(description.trim_end())?;
            Ok(ExitCode::SUCCESS)
        }
    }
}

fn send(args: &SendArgs) -> anyhow::Result<ExitCode> {
    let message = order(&args.command, &args.values, args.computer)?;
    let mut port = args.line.open(args.key_file.as_deref(), args.computer)?;
    // Over UDP a sender's numbers must increase until it has been silent for 30 s. Those of two commands from one port,
    // less than 32.7 s apart, do: the numbers restart after 65.5 s.
    let sequence = Timestamp::now().as_millisecond() as u16;
    let answer = match message {
        Message::MoonRequest(request) => {
            match ask_for_moon(port.as_mut(), request, sequence, args.timeout)? {
                Ok(answer) => {
                    say(Message::from(answer).words())?;
                    return Ok(ExitCode::SUCCESS);
                }
                Err(refused) => refused,
            }
        }
        _ => ask(port.as_mut(), &message, sequence, args.timeout)?,
    };
    say(result_in_words(answer.key, answer.value))?;
    Ok(match answer.is_done() {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    })
}

fn decode(args: &DecodeArgs) -> anyhow::Result<ExitCode> {
    if let Some(bytes) = from_hex(&args.bytes) {
        return Ok(all(&print(&[at_once(bytes)], args.from, false)?));
    }
    let path = Path::new(&args.bytes);
    let bytes = files::read_log(path).with_context(|| {
        format!(
            "expected hexadecimal bytes or a file, found \"{}\"",
            args.bytes
        )
    })?;
    let text = str::from_utf8(&bytes);
    if let Some(bytes) = text.ok().and_then(from_hex) {
        return Ok(all(&print(&[at_once(bytes)], args.from, false)?));
    }
    let found = match (read_log(path, &bytes), text) {
        (Ok(bursts), Ok(_)) => print(&bursts, args.from, true)?,
        (Ok(bursts), Err(_)) if !bursts.is_empty() => print(&bursts, args.from, true)?,
        (_, Err(_)) => print(&[at_once(bytes)], args.from, false)?,
        (Err(error), Ok(_)) => return Err(error),
    };
    Ok(all(&found))
}

/// Exit code 1 if some bytes are no packets.
fn all(found: &Contents) -> ExitCode {
    ExitCode::from(u8::from(found.rejected.bytes > 0))
}

fn at_once(bytes: Vec<u8>) -> Burst {
    let time = Timestamp::UNIX_EPOCH;
    Burst { time, bytes }
}

/// Readable lines of a log, with one warning of the others.
fn read_log(path: &Path, bytes: &[u8]) -> anyhow::Result<Vec<Burst>> {
    let (bursts, reader) = byte_log::read(bytes);
    reader.check().with_context(|| path.display().to_string())?;
    let skipped = reader.skipped();
    if skipped.total() > 0 {
        tracing::warn!("{}: {skipped}", path.display());
    }
    Ok(bursts)
}

fn log(args: &LogArgs) -> anyhow::Result<ExitCode> {
    if let Some(path) = &args.file {
        let bytes = files::read_log(path).with_context(|| path.display().to_string())?;
        let found = print(&read_log(path, &bytes)?, args.from, true)?;
        let has_none = found.packets.is_empty() && found.rejected.bytes > 0;
        return Ok(ExitCode::from(u8::from(has_none)));
    }
    let Some(address) = &args.port else {
        anyhow::bail!("expected a FILE or --port");
    };
    let mut port = address.open(args.baud, LocalEnd::default())?;
    match &args.out {
        Some(path) => {
            let file = File::create_new(path).with_context(|| path.display().to_string())?;
            record(&mut port, file, args.duration)?;
        }
        None => record(&mut port, io::stdout(), args.duration)?,
    }
    Ok(ExitCode::SUCCESS)
}

fn record(
    port: &mut AnyPort,
    mut out: impl Write,
    duration: Option<Duration>,
) -> anyhow::Result<()> {
    let interrupted = options::interrupted()?;
    let start = Instant::now();
    let mut buffer = [0; 2048];
    writeln!(out, "{}", byte_log::HEADER)?;
    while !interrupted.load(Ordering::Relaxed)
        && duration.is_none_or(|duration| start.elapsed() < duration)
    {
        let count = port.read(&mut buffer, Duration::from_millis(50))?;
        if count > 0 {
            let (time, bytes) = (Timestamp::now(), buffer[..count].to_vec());
            writeln!(out, "{}", Burst { time, bytes })?;
            out.flush()?;
        }
    }
    Ok(())
}

/// Prints the packets in the bytes.
fn print(bursts: &[Burst], from: Option<PacketSender>, timed: bool) -> anyhow::Result<Contents> {
    let likely = || byte_log::likely_direction(bursts);
    let direction = from.map_or_else(likely, PacketSender::direction);
    let found = byte_log::packets(bursts, direction);
    let mut out = io::stdout().lock();
    for (time, packet) in &found.packets {
        match timed {
            true => writeln!(out, "{time:.6} {}", describe(packet))?,
            false => writeln!(out, "{}", describe(packet))?,
        }
    }
    for reason in &found.reasons {
        writeln!(out, "rejected: {reason}")?;
    }
    let rejected = found.rejected;
    writeln!(
        out,
        "{}; rejected: {}, {}",
        counted(found.packets.len() as u64, "packet"),
        counted(rejected.packets, "packet"),
        counted(rejected.bytes, "byte"),
    )?;
    Ok(found)
}
