//! A recording, read into the history, and continued while it grows.

use super::history::History;
use super::receive::POLL_EVERY;
use super::shared::Shared;
use crate::link::byte_log::{Burst, LogError, Reader};
use crate::link::{Direction, Parser};
use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

/// Number of bytes per read.
const PIECE: usize = 1 << 16;
/// A line whose end is missing for this time is truncated.
const TIMEOUT: Duration = Duration::from_secs(2);

/// Why a file is not a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    #[error(transparent)]
    File(#[from] io::Error),
    #[error(transparent)]
    Log(#[from] LogError),
}

/// A recording and the position up to which it has been read.
pub struct Record {
    path: PathBuf,
    file: File,
    reader: Reader,
    /// First lines, which were read to check the format.
    bursts: Vec<Burst>,
    parser: Parser,
    /// Number of bad lines already reported in the log.
    warned: u64,
}

impl Record {
    /// Opens a recording and reads its first lines.
    ///
    /// # Errors
    /// If it cannot be read, or if no line of it is valid.
    pub fn open(path: &Path) -> Result<Self, RecordError> {
        let mut record = Self {
            path: path.into(),
            file: File::open(path)?,
            reader: Reader::default(),
            bursts: Vec::new(),
            parser: Parser::new(Direction::ToController),
            warned: 0,
        };
        let mut piece = vec![0; PIECE];
        while record.reader.check().is_err() {
            if record.read_piece(&mut piece)? == 0 {
                record.bursts.extend(record.reader.finish());
                record.reader.check()?;
            }
        }
        Ok(record)
    }

    /// Reads it until the console ends.
    pub fn follow(mut self, shared: &Shared) {
        let mut piece = vec![0; PIECE];
        let (mut grew, mut is_read, mut failed) = (Instant::now(), false, 0_u64);
        while !shared.is_over() {
            self.take_bursts(shared);
            match self.read_piece(&mut piece) {
                Ok(0) => {
                    if grew.elapsed() > TIMEOUT {
                        self.bursts.extend(self.reader.finish());
                    }
                    self.warn();
                    is_read = true;
                    thread::sleep(POLL_EVERY);
                }
                Ok(_) => {
                    grew = Instant::now();
                    // The data at the beginning may be of any age.
                    if is_read {
                        shared.note_growth();
                    }
                }
                Err(error) => {
                    failed += 1;
                    if failed.is_power_of_two() {
                        tracing::error!(%error, failed, "the recording cannot be read");
                    }
                    thread::sleep(POLL_EVERY);
                }
            }
        }
    }

    fn read_piece(&mut self, piece: &mut [u8]) -> io::Result<usize> {
        let count = match self.file.read(piece) {
            Err(error) if error.kind() == ErrorKind::Interrupted => return self.read_piece(piece),
            other => other?,
        };
        self.bursts.extend(self.reader.feed(&piece[..count]));
        Ok(count)
    }

    fn take_bursts(&mut self, shared: &Shared) {
        for Burst { time, bytes } in self.bursts.drain(..) {
            let since_1970 = Duration::try_from(time.as_duration()).unwrap_or_default();
            let packets = self.parser.feed(&bytes, since_1970);
            let rejected = self.parser.rejected().packets;
            shared.change(|history: &mut History| {
                history.line.bytes += bytes.len() as u64;
                history.line.rejected = rejected;
                packets.iter().for_each(|packet| history.take(packet, time));
            });
        }
    }

    /// Warns of bad lines: once of those already present, and for a growing recording whenever their number has doubled.
    fn warn(&mut self) {
        let skipped = self.reader.skipped();
        if skipped.total() > 2 * self.warned {
            self.warned = skipped.total();
            tracing::warn!("{}: {skipped}", self.path.display());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::console::orders::Orders;
    use crate::link::Housekeeping;
    use crate::link::byte_log::HEADER;
    use jiff::Timestamp;
    use std::io::Write;

    /// A line with the housekeeping of one second.
    fn line(second: u32) -> String {
        let time = Timestamp::new(1_379_786_400 + i64::from(second), 1).unwrap();
        let housekeeping = Housekeeping {
            uptime_s: second,
            ..Housekeeping::default()
        };
        let bytes = housekeeping.packet(time).unwrap().encode();
        format!("{}\n", Burst { time, bytes })
    }

    fn shared() -> Shared {
        let keep = Duration::from_secs(86_400);
        Shared::new(History::new(keep), Orders::default())
    }

    fn wait_for(shared: &Shared, packets: u64) {
        let start = Instant::now();
        while shared.history().line.packets < packets {
            assert!(
                start.elapsed() < Duration::from_secs(60),
                "{packets} packets"
            );
            thread::sleep(Duration::from_millis(10));
        }
    }

    #[test]
    fn a_recording_is_read_past_its_damage_and_read_on_while_it_grows() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flight.log");
        let mut file = File::create(&path).unwrap();
        let zeros = "\0".repeat(4096);
        write!(file, "{HEADER}\n{}{zeros}\n{}", line(0), line(1)).unwrap();
        let record = Record::open(&path).unwrap();
        let shared = shared();
        thread::scope(|scope| {
            scope.spawn(|| record.follow(&shared));
            wait_for(&shared, 2);
            write!(file, "{}{}", line(2), line(2)).unwrap();
            wait_for(&shared, 3);
            // A last line without an end is processed if no end arrives.
            write!(file, "{}", line(3).trim_end()).unwrap();
            wait_for(&shared, 4);
            shared.end();
        });
        let history = shared.history();
        assert_eq!(history.line.packets, 4, "the repeated line counts once");
        assert_eq!((history.line.rejected, history.line.doubled), (0, 0));
    }
}
