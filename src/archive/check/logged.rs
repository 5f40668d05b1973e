//! Files that the solution logs name and that do not exist.
//!
//! A log has a row for every frame, with its file and whether that is on the log's own disk. So a missing file is
//! known from its row, whatever its place in the sequence; and if one of two alternating disks is available, the frames of the
//! other are known to exist.

use super::BadFile;
use crate::record::LoggedRow;
use csv::{ReaderBuilder, StringRecord};
use jiff::Timestamp;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};

/// A file that a log names and that does not exist.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct MissingFile {
    /// Its expected path.
    pub file: String,
    /// The log that names it.
    pub log: String,
}

/// A frame whose file is on a disk that is not available.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Elsewhere {
    pub file: PathBuf,
    pub utc: Option<Timestamp>,
    pub number: Option<u64>,
}

/// Missing files according to the logs.
#[derive(Debug, Default)]
pub(super) struct Absent {
    pub missing: Vec<MissingFile>,
    pub elsewhere: Vec<Elsewhere>,
    /// Logs that cannot be read, with the reasons.
    pub bad: Vec<BadFile>,
}

/// The part of a frame's row that locates the frame.
struct LoggedFrame {
    /// Path under the archive's root.
    file: String,
    on_own_disk: bool,
    utc: Option<Timestamp>,
    number: Option<u64>,
}

/// Searches for the files that the logs name. Logs of one start on two disks are combined.
pub(super) fn find_absent(logs: &[PathBuf]) -> Absent {
    let mut absent = Absent::default();
    let mut starts: BTreeMap<String, Vec<(&Path, Vec<LoggedFrame>)>> = BTreeMap::new();
    for log in logs {
        match read(log) {
            Ok(frames) => starts.entry(start(log)).or_default().push((log, frames)),
            Err(cause) => absent.bad.push(BadFile {
                file: log.display().to_string(),
                error: format!("expected a solution log, found \"{cause}\""),
            }),
        }
    }
    for logs in starts.values() {
        find_absent_of_a_start(logs, &mut absent);
    }
    absent
}

fn find_absent_of_a_start(logs: &[(&Path, Vec<LoggedFrame>)], absent: &mut Absent) {
    let root = |(log, frames): &(&Path, Vec<LoggedFrame>)| root_of(log, &frames.first()?.file);
    let roots: BTreeSet<PathBuf> = logs.iter().filter_map(root).collect();
    let mut seen = BTreeSet::new();
    for (log, frames) in logs {
        for frame in frames {
            let is_there = || roots.iter().any(|root| root.join(&frame.file).is_file());
            if !seen.insert(&frame.file) || is_there() {
                continue;
            }
            let own = root_of(log, &frame.file).unwrap_or_default();
            let file = own.join(&frame.file);
            if frame.on_own_disk || roots.len() > 1 {
                absent.missing.push(MissingFile {
                    file: file.display().to_string(),
                    log: log.display().to_string(),
                });
            } else {
                absent.elsewhere.push(Elsewhere {
                    file,
                    utc: frame.utc,
                    number: frame.number,
                });
            }
        }
    }
}

/// The part of a log's name shared by the logs of one start: `solutions_<start>`.
fn start(log: &Path) -> String {
    let stem = log.file_stem().unwrap_or_default().to_string_lossy();
    let parts: Vec<&str> = stem.split('_').take(2).collect();
    parts.join("_")
}

/// The archive's root: each of several cameras has a folder of its own under it, with its log.
fn root_of(log: &Path, file: &str) -> Option<PathBuf> {
    let folder = log.parent()?.canonicalize().ok()?;
    let camera_folders = Path::new(file).components().count().saturating_sub(2);
    folder.ancestors().nth(camera_folders).map(Path::to_owned)
}

/// The rows that name a file. A row left incomplete by a power cut is ignored.
fn read(log: &Path) -> io::Result<Vec<LoggedFrame>> {
    let mut reader = ReaderBuilder::new().flexible(true).from_path(log)?;
    let header = StringRecord::from_byte_record_lossy(reader.byte_headers()?.clone());
    let column = |name: &str| header.iter().position(|column| column == name);
    let [frame, file, utc, disk] = ["frame", "file", "utc", "disk"].map(column);
    let mut frames = Vec::new();
    for row in reader.byte_records() {
        let row = StringRecord::from_byte_record_lossy(row?);
        let text = |column: Option<usize>| column.and_then(|column| row.get(column));
        let on_own_disk = match (disk, text(disk)) {
            // A log of an earlier version without the column.
            (None, _) | (_, Some(LoggedRow::THIS_DISK)) => true,
            (_, Some(LoggedRow::OTHER_DISK)) => false,
            _ => continue,
        };
        let Some(file) = text(file).filter(|file| !file.is_empty()) else {
            continue;
        };
        frames.push(LoggedFrame {
            file: file.into(),
            on_own_disk,
            utc: text(utc).and_then(|utc| utc.parse().ok()),
            number: text(frame).and_then(|number| number.parse().ok()),
        });
    }
    Ok(frames)
}
