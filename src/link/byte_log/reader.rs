//! Reads a byte log as found on a disk: cut off by a power cut, filled with zero bytes, copied twice, or still growing.
//!
//! Bad lines are skipped and counted. Of a damaged line the bytes before the damage are kept: packets have checksums, so complete
//! ones are found, and a truncated one is rejected.

use super::Burst;
use crate::link::hex::from_hex;
use crate::units::counted;
use jiff::Timestamp;
use std::collections::HashSet;
use std::fmt;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::mem;

/// Length of the longest line, bytes. The 64 KiB of a datagram take 128 KiB in hexadecimal.
const LONGEST: usize = 1 << 20;
/// Number of digits of the seconds since 1970 in the years 2001 to 2286.
const DIGITS: usize = 10;
/// Number of decimals that are written.
const DECIMALS: usize = 9;

/// Fault of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// It holds zero bytes: content of a file whose end did not reach the disk.
    ZeroBytes,
    NotUtf8,
    /// It is cut off, or has another fault.
    Malformed,
    /// The same bytes at the same nanosecond as a line before.
    Repeated,
    TooLong,
}

impl Kind {
    const ALL: [Self; 5] = [
        Self::ZeroBytes,
        Self::NotUtf8,
        Self::Malformed,
        Self::Repeated,
        Self::TooLong,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::ZeroBytes => "with zero bytes",
            Self::NotUtf8 => "not UTF-8",
            Self::Malformed => "cut or malformed",
            Self::Repeated => "repeated",
            Self::TooLong => "too long",
        }
    }

    fn expected(self) -> &'static str {
        match self {
            Self::Repeated => "each line once",
            Self::TooLong => "at most 1 MiB",
            _ => "UTC seconds with decimals and hexadecimal bytes",
        }
    }
}

/// A line that was skipped.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: expected {}, found {found}", .kind.expected())]
pub struct BadLine {
    /// Line number, from 1.
    pub line: u64,
    pub kind: Kind,
    pub found: String,
}

/// Reason why a file is no byte log: nothing in it could be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LogError {
    #[error("expected a byte log, found an empty file")]
    Empty,
    #[error("expected a byte log, found none of its lines; {0}")]
    NoLines(BadLine),
}

/// The lines that were skipped.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Skipped {
    counts: [u64; Kind::ALL.len()],
    first: Option<BadLine>,
}

impl Skipped {
    pub fn count(&self, kind: Kind) -> u64 {
        self.counts[kind as usize]
    }

    pub fn total(&self) -> u64 {
        self.counts.iter().sum()
    }

    pub fn first(&self) -> Option<&BadLine> {
        self.first.as_ref()
    }

    fn add(&mut self, bad: BadLine) {
        self.counts[bad.kind as usize] += 1;
        self.first.get_or_insert(bad);
    }
}

impl fmt::Display for Skipped {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kinds = Kind::ALL.into_iter().filter(|kind| self.count(*kind) > 0);
        let counts: Vec<String> = kinds
            .map(|kind| format!("{} {}", self.count(kind), kind.name()))
            .collect();
        write!(out, "lines skipped: {}", counts.join(", "))?;
        match &self.first {
            Some(first) => write!(out, "; the first is {first}"),
            None => Ok(()),
        }
    }
}

/// Reads a byte log piece by piece.
#[derive(Debug, Default)]
pub struct Reader {
    /// Bytes of a line whose end has not come, each run of zero bytes as one.
    rest: Vec<u8>,
    zeros: u64,
    is_too_long: bool,
    /// Number of lines whose ends have come.
    lines: u64,
    /// Number of bursts and remarks.
    read: u64,
    /// Largest number of digits of the seconds so far: a line with fewer has lost its first ones.
    digits: usize,
    /// Hashes of the bursts with exact times.
    seen: HashSet<u64>,
    skipped: Skipped,
}

impl Reader {
    /// Takes the next bytes of the log and returns the bursts of the lines that end in them.
    pub fn feed(&mut self, bytes: &[u8]) -> Vec<Burst> {
        let mut bursts = Vec::new();
        for piece in bytes.split_inclusive(|byte| *byte == b'\n') {
            match piece.strip_suffix(b"\n") {
                Some(end) => {
                    self.append(end);
                    self.take_line(&mut bursts);
                }
                None => self.append(piece),
            }
        }
        bursts
    }

    /// Reads a last line that has no end.
    pub fn finish(&mut self) -> Vec<Burst> {
        let mut bursts = Vec::new();
        if !self.rest.is_empty() || self.is_too_long {
            self.take_line(&mut bursts);
        }
        bursts
    }

    pub fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    /// Checks that anything was read.
    ///
    /// # Errors
    /// If nothing was read: the first line, with expected and found content.
    pub fn check(&self) -> Result<(), LogError> {
        match (self.read, self.skipped.first()) {
            (0, Some(first)) => Err(LogError::NoLines(first.clone())),
            (0, None) => Err(LogError::Empty),
            _ => Ok(()),
        }
    }

    fn append(&mut self, bytes: &[u8]) {
        for piece in bytes.split_inclusive(|byte| *byte == 0) {
            self.zeros += u64::from(piece.last() == Some(&0));
            let goes_on = piece == [0] && self.rest.last() == Some(&0);
            if self.rest.len() + piece.len() > LONGEST {
                self.is_too_long = true;
            } else if !goes_on {
                self.rest.extend_from_slice(piece);
            }
        }
    }

    fn take_line(&mut self, bursts: &mut Vec<Burst>) {
        self.lines += 1;
        let line = mem::take(&mut self.rest);
        let line = line.strip_suffix(b"\r").unwrap_or(&line);
        let zeros = mem::take(&mut self.zeros);
        if mem::take(&mut self.is_too_long) {
            self.skip(Kind::TooLong, "more".into());
        } else if zeros > 0 {
            self.skip(Kind::ZeroBytes, counted(zeros, "zero byte"));
            let mut pieces = line.split(|byte| *byte == 0);
            let (first, last) = (pieces.next(), pieces.next_back());
            bursts.extend(self.beginning(first.unwrap_or_default()));
            // If the file was continued after the power cut, a whole line follows the zero bytes.
            bursts.extend(self.salvaged(last.and_then(text).and_then(Line::parse)));
        } else {
            bursts.extend(self.line(line));
        }
    }

    /// The burst of a line without zero bytes, or of its undamaged part.
    fn line(&mut self, line: &[u8]) -> Option<Burst> {
        // Some editors put a byte order mark before the first line.
        let line = line.strip_prefix("\u{feff}".as_bytes()).unwrap_or(line);
        match str::from_utf8(line) {
            Ok("") => None,
            Ok(remark) if remark.starts_with('#') => {
                self.read += 1;
                None
            }
            Ok(text) => match Line::parse(text).filter(|line| line.digits >= self.digits) {
                Some(line) => self.taken(line),
                None => {
                    self.skip(Kind::Malformed, shown(text));
                    self.beginning(line)
                }
            },
            Err(error) => {
                let at = error.valid_up_to();
                let found = format!("byte {:#04x} in column {}", line[at], at + 1);
                self.skip(Kind::NotUtf8, found);
                self.beginning(line)
            }
        }
    }

    fn taken(&mut self, line: Line) -> Option<Burst> {
        self.read += 1;
        self.digits = line.digits;
        // A writer of less exact times may have received the same bytes twice.
        if line.is_exact() && !self.seen.insert(line.hash()) {
            let found = format!("{} again", shown(&line.burst.to_string()));
            self.skip(Kind::Repeated, found);
            return None;
        }
        Some(line.burst)
    }

    /// The bytes of a line before its damage.
    fn beginning(&mut self, line: &[u8]) -> Option<Burst> {
        let good = line.utf8_chunks().next()?.valid();
        let (time, digits) = good.split_once(' ')?;
        let count = digits.bytes().take_while(u8::is_ascii_hexdigit).count();
        let beginning = format!("{time} {}", &digits[..count - count % 2]);
        self.salvaged(Line::parse(&beginning))
    }

    /// A burst of a damaged line; it counts only with a complete time.
    fn salvaged(&mut self, line: Option<Line>) -> Option<Burst> {
        let line = line.filter(Line::is_exact)?;
        self.read += 1;
        self.seen.insert(line.hash()).then_some(line.burst)
    }

    fn skip(&mut self, kind: Kind, found: String) {
        let line = self.lines;
        self.skipped.add(BadLine { line, kind, found });
    }
}

/// A line's burst, and the numbers of digits that its time has before and after the decimal point.
struct Line {
    burst: Burst,
    digits: usize,
    decimals: usize,
}

impl Line {
    fn parse(text: &str) -> Option<Self> {
        let (time, bytes) = text.split_once(' ')?;
        let (seconds, decimals) = time.split_once('.')?;
        let is_number = |text: &str, most| {
            (1..=most).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_digit())
        };
        if !(is_number(seconds, DIGITS) && is_number(decimals, DECIMALS)) {
            return None;
        }
        let nanoseconds = format!("{decimals:0<DECIMALS$}");
        let time = Timestamp::new(seconds.parse().ok()?, nanoseconds.parse().ok()?).ok()?;
        let bytes = from_hex(bytes).filter(|bytes| !bytes.is_empty())?;
        Some(Self {
            burst: Burst { time, bytes },
            digits: seconds.len(),
            decimals: decimals.len(),
        })
    }

    /// Whether its time has the form that this program writes.
    fn is_exact(&self) -> bool {
        (self.digits, self.decimals) == (DIGITS, DECIMALS)
    }

    fn hash(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        (self.burst.time, &self.burst.bytes).hash(&mut hasher);
        hasher.finish()
    }
}

fn text(bytes: &[u8]) -> Option<&str> {
    str::from_utf8(bytes).ok()
}

/// A line as an error shows it: its beginning and its end.
fn shown(text: &str) -> String {
    const BEGIN: usize = 30;
    const END: usize = 10;
    let count = text.chars().count();
    if count <= BEGIN + END + 3 {
        return format!("{text:?}");
    }
    let begin: String = text.chars().take(BEGIN).collect();
    let end: String = text.chars().skip(count - END).collect();
    format!("{:?}", format!("{begin}...{end}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Recorded lines, and the numbers of the lines that hold each.
    const RECORD: [&str; 4] = [
        "# solaspect byte log: UTC seconds since 1970, bytes in hexadecimal",
        "1379786400.000000001 9ac30102007e310011",
        "1379786400.250000001 0102030405060708",
        "1379786400.500000001 090a0b0c",
    ];

    fn read(log: &[u8]) -> (Vec<Burst>, Skipped) {
        let mut reader = Reader::default();
        // In small pieces, as a growing file is read.
        let mut bursts: Vec<Burst> = log.chunks(7).flat_map(|piece| reader.feed(piece)).collect();
        bursts.extend(reader.finish());
        (bursts, reader.skipped().clone())
    }

    fn whole() -> Vec<Burst> {
        let (bursts, skipped) = read(RECORD.join("\n").as_bytes());
        assert_eq!((bursts.len(), skipped.total()), (3, 0));
        bursts
    }

    fn hex(burst: &Burst) -> String {
        burst.to_string().split(' ').next_back().unwrap().into()
    }

    #[test]
    fn what_is_good_of_a_damaged_log_is_read_and_the_rest_counted_by_kind() {
        let [head, first, second, third] = RECORD;
        let zeros = "\0".repeat(4096);
        let (cut, lost) = (&second[..28], &second[5..]);
        for (log, kinds, line) in [
            (
                format!("{head}\n{first}\n{second}\n{third}\n{zeros}"),
                &[Kind::ZeroBytes][..],
                5,
            ),
            (
                format!("{zeros}\n{first}\n{second}\n{third}"),
                &[Kind::ZeroBytes],
                1,
            ),
            // Continued after the power cut, and a truncated line before the zeros.
            (
                format!("{first}\n{second}{zeros}{third}\n"),
                &[Kind::ZeroBytes],
                2,
            ),
            (
                format!("{first}\n{second}x\n{third}\n"),
                &[Kind::Malformed],
                2,
            ),
            (
                format!("{first}\n{second}\n{third}\n{second}\n"),
                &[Kind::Repeated],
                4,
            ),
            (
                format!("{first}\n{second}\n{third}\n{lost}\n"),
                &[Kind::Malformed],
                4,
            ),
            (
                format!("{first}\n{second}\n{third}\n{cut}"),
                &[Kind::Malformed],
                4,
            ),
        ] {
            let (bursts, skipped) = read(log.as_bytes());
            let mut good = bursts.clone();
            good.truncate(3);
            assert_eq!(good, whole(), "{log:?}");
            let counts = Kind::ALL.map(|kind| skipped.count(kind));
            let expected = Kind::ALL.map(|kind| u64::from(kinds.contains(&kind)));
            assert_eq!(
                (counts, skipped.first().unwrap().line),
                (expected, line),
                "{log:?}"
            );
        }
    }

    #[test]
    fn of_a_damaged_line_the_bytes_before_the_damage_are_kept() {
        for (line, kept) in [
            (&b"1379786400.250000001 01020304050"[..], "0102030405"),
            (b"1379786400.250000001 0102\xff304", "0102"),
            (b"1379786400.250000001 0102\x00\x00304", "0102"),
            (
                b"1379786400.250000001 01021379786400.500000001 03",
                "01021379786400",
            ),
        ] {
            let (bursts, skipped) = read(line);
            assert_eq!(bursts.iter().map(hex).collect::<Vec<_>>(), [kept]);
            assert_eq!(skipped.total(), 1);
        }
        for line in [
            "1379786400.25 0102x",
            "79786400.250000001 0102x",
            "1379786400.25000000",
        ] {
            let (bursts, skipped) = read(line.as_bytes());
            assert_eq!(
                (bursts.len(), skipped.count(Kind::Malformed)),
                (0, 1),
                "{line}"
            );
        }
    }

    #[test]
    fn a_long_run_of_zeros_and_an_endless_line_take_no_memory() {
        let mut reader = Reader::default();
        for byte in [0, b'x'] {
            for _ in 0..64 {
                reader.feed(&vec![byte; 1 << 16]);
            }
            assert!(reader.rest.len() <= LONGEST);
            reader.feed(b"\n");
        }
        let skipped = reader.skipped();
        assert_eq!(
            (skipped.count(Kind::ZeroBytes), skipped.count(Kind::TooLong)),
            (1, 1)
        );
        assert_eq!(reader.feed(format!("{}\n", RECORD[1]).as_bytes()).len(), 1);
    }

    #[test]
    fn other_line_ends_coarse_times_and_empty_lines_are_no_damage() {
        let (bursts, skipped) = read("\u{feff}# a\r\n1.5 00\r\n\r\n1.5 00\n10.25 9A c3".as_bytes());
        assert_eq!(
            bursts.iter().map(hex).collect::<Vec<_>>(),
            ["00", "00", "9ac3"]
        );
        assert_eq!(skipped.total(), 0);
    }

    #[test]
    fn a_file_of_which_nothing_can_be_read_says_what_was_expected() {
        let refusal = |log: &[u8]| {
            let mut reader = Reader::default();
            reader.feed(log);
            reader.finish();
            reader.check().map_err(|error| error.to_string())
        };
        assert_eq!(refusal(b"# only a remark\n"), Ok(()));
        assert!(refusal(b"").unwrap_err().ends_with("found an empty file"));
        for (log, found) in [
            (&b"frame,utc\n1,2\n"[..], "found \"frame,utc\""),
            (&[0; 4096], "found 4096 zero bytes"),
            (b"\x89PNG\r\n", "found byte 0x89 in column 1"),
        ] {
            let error = refusal(log).unwrap_err();
            assert!(
                error.contains("line 1: expected UTC seconds") && error.ends_with(found),
                "{error}"
            );
        }
    }

    #[test]
    fn the_warning_has_the_counts_and_the_first_line() {
        let (_, skipped) = read(b"1.0 00\n1.5\n\0\n1.0 0\n");
        assert_eq!(
            skipped.to_string(),
            "lines skipped: 1 with zero bytes, 2 cut or malformed; the first is line 2: expected UTC seconds with decimals \
             and hexadecimal bytes, found \"1.5\""
        );
    }
}
