//! The receiving thread: packets from a line into the history, and commands onto the line.

use super::history::History;
use super::relay::Relay;
use super::shared::Shared;
use super::stored::Follower;
use crate::link::byte_log::{self, Burst};
use crate::link::{Computer, Connection, Direction, Key, Packet, Parser};
use crossbeam_channel::Receiver as Outbox;
use jiff::Timestamp;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

/// Time to wait for the line before commands are checked.
const WAIT: Duration = Duration::from_millis(20);
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);
/// Interval at which a growing archive or recording is read.
pub const POLL_EVERY: Duration = Duration::from_millis(500);

/// A command to be sent.
#[derive(Debug, Clone)]
pub struct Outgoing {
    /// Number of its row in the log.
    pub number: u64,
    pub to: Computer,
    pub bytes: Vec<u8>,
}

/// A line from which a flight is received.
pub struct Line {
    pub connection: Connection,
    pub outbox: Outbox<Outgoing>,
    /// Key that signs the commands.
    pub key: Option<Key>,
    /// Passes on all received data.
    pub relay: Relay,
    pub recording: Option<BufWriter<File>>,
    /// The flight's archive, if it is available.
    pub frames: Option<Follower>,
}

impl Line {
    /// Receives until the console ends.
    pub fn run(mut self, shared: &Arc<Shared>) {
        let start = Instant::now();
        let mut parser = Parser::new(Direction::ToController);
        let mut buffer = [0; 65536];
        let mut polled = None;
        while !shared.is_over() {
            let now = start.elapsed();
            self.connection.revive(now);
            let Some(port) = self.connection.port() else {
                self.refuse(shared);
                thread::sleep(WAIT);
                continue;
            };
            match port.read(&mut buffer, WAIT) {
                Ok(0) => {}
                Ok(count) => {
                    let is_datagram = port.sender().is_some();
                    let packets = parser.feed(&buffer[..count], start.elapsed());
                    match is_datagram {
                        true => self.relay.pass_on(&buffer[..count], Instant::now()),
                        // Data from a wire arrive in pieces.
                        false => packets.iter().for_each(|packet| {
                            self.relay.pass_on(&packet.encode(), Instant::now());
                        }),
                    }
                    self.take(
                        &buffer[..count],
                        &packets,
                        parser.rejected().packets,
                        shared,
                    );
                }
                Err(error) => {
                    tracing::error!(%error, "the line is lost");
                    parser.abandon();
                    self.connection.lose(start.elapsed());
                }
            }
            self.send(shared, start.elapsed());
            if polled.is_none_or(|polled: Instant| polled.elapsed() > POLL_EVERY) {
                polled = Some(Instant::now());
                shared.give_up_on_orders();
                self.poll_frames(shared);
            }
        }
    }

    fn take(&mut self, bytes: &[u8], packets: &[Packet], rejected: u64, shared: &Shared) {
        let arrived = Timestamp::now();
        self.record(bytes, arrived);
        shared.change(|history| {
            history.line.bytes += bytes.len() as u64;
            history.line.rejected = rejected;
            packets
                .iter()
                .for_each(|packet| history.take(packet, arrived));
        });
        packets
            .iter()
            .for_each(|packet| shared.hear_answer(packet, arrived));
    }

    fn record(&mut self, bytes: &[u8], time: Timestamp) {
        let Some(recording) = &mut self.recording else {
            return;
        };
        let bytes = bytes.to_vec();
        let written =
            writeln!(recording, "{}", Burst { time, bytes }).and_then(|()| recording.flush());
        if let Err(error) = written {
            tracing::error!(%error, "the recording ends here");
            self.recording = None;
        }
    }

    /// Sends the waiting commands.
    fn send(&mut self, shared: &Shared, now: Duration) {
        while let Ok(Outgoing { number, to, bytes }) = self.outbox.try_recv() {
            let bytes = match &self.key {
                Some(key) => key.towards(to).sign_now(&bytes),
                None => bytes,
            };
            let Some(port) = self.connection.port() else {
                shared.fail_order(number, "not sent: the line is lost");
                continue;
            };
            if let Err(error) = port.write(&bytes, WRITE_TIMEOUT) {
                shared.fail_order(number, &format!("not sent: {error}"));
                self.connection.lose(now);
            }
        }
    }

    fn refuse(&self, shared: &Shared) {
        while let Ok(Outgoing { number, .. }) = self.outbox.try_recv() {
            shared.fail_order(number, "not sent: the line is not open");
        }
    }

    fn poll_frames(&mut self, shared: &Shared) {
        if let Some(frames) = &mut self.frames {
            // Its folder may not exist yet.
            let _ = read_on(frames, shared);
        }
    }
}

/// Creates a recording: a byte log.
///
/// # Errors
/// If the file exists, or cannot be written.
pub fn recording(path: &Path) -> io::Result<BufWriter<File>> {
    let mut file = BufWriter::new(File::create_new(path)?);
    writeln!(file, "{}", byte_log::HEADER)?;
    file.flush()?;
    Ok(file)
}

/// Reads an archive until the console ends.
pub fn follow(mut archive: Follower, shared: &Arc<Shared>) {
    let (mut failed, mut is_read) = (0_u64, false);
    while !shared.is_over() {
        match read_on(&mut archive, shared) {
            // The data at the beginning may be of any age.
            Ok(true) if is_read => shared.note_growth(),
            Ok(true) => {}
            Ok(false) => {
                is_read = true;
                thread::sleep(POLL_EVERY);
            }
            Err(error) => {
                failed += 1;
                if failed.is_power_of_two() {
                    tracing::error!(%error, failed, "the archive cannot be read");
                }
                thread::sleep(POLL_EVERY);
            }
        }
    }
}

fn read_on(archive: &mut Follower, shared: &Shared) -> io::Result<bool> {
    archive.read_on(|change| shared.change(|history: &mut History| change(history)))
}
