//! The solution log: one CSV row per frame, beside the frames, with the same numbers as their files.
//!
//! A log is one file per start of the program, made with the first row; if the disk lost it, another is begun. Every row reaches the operating system
//! before the next frame is handled, and the disk within 1 s; a row that the disk stored incompletely is truncated before
//! the next is written.

use super::disk::Disk;
use super::growing::Growing;
use super::store::{ArchiveError, During};
use crate::record::LoggedRow;
use jiff::Timestamp;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Largest number of logs of the same second in one folder.
const MOST_NAMESAKES: u32 = 1000;

/// Time between syncs: rows of this time may be lost in a power cut.
const SYNC_EVERY: Duration = Duration::from_secs(1);

/// A log of one start in one archive: `<what>_<start>.csv`, a file that is made with its first row.
///
/// After a refusal the file is opened again with the next row, and continues after its last complete row; if it no longer
/// exists, another file is begun.
#[derive(Debug)]
pub struct Log {
    disk: Arc<dyn Disk>,
    root: PathBuf,
    what: &'static str,
    columns: Vec<String>,
    start: Timestamp,
    csv: Option<Csv>,
}

/// The solution log of one start in one archive: `solutions_<start>.csv`.
#[derive(Debug)]
pub struct SolutionLog(Log);

/// A log's file.
#[derive(Debug)]
struct Csv {
    path: PathBuf,
    /// Bytes of complete rows.
    whole: u64,
    /// `None` after a refusal.
    file: Option<Growing>,
    synced: Instant,
}

impl SolutionLog {
    /// A log under an archive's root; its file is made with the first row and never replaces another.
    pub fn new(disk: Arc<dyn Disk>, root: &Path, start: Timestamp) -> Self {
        let columns = LoggedRow::csv_columns().into_iter().map(str::to_owned);
        Self(Log::new(disk, root, "solutions", columns.collect(), start))
    }

    /// Adds a row.
    ///
    /// # Errors
    /// If the disk refuses; the row is then not in the log, and may be tried again.
    pub fn append(&mut self, row: &LoggedRow) -> Result<(), ArchiveError> {
        self.0.append(&row.csv_fields())
    }

    /// Closes the file; the next row opens it again.
    pub fn close(&mut self) {
        self.0.close();
    }
}

impl Log {
    /// A log with these columns under an archive's root; its file never replaces another.
    pub fn new(
        disk: Arc<dyn Disk>,
        root: &Path,
        what: &'static str,
        columns: Vec<String>,
        start: Timestamp,
    ) -> Self {
        Self {
            disk,
            root: root.into(),
            what,
            columns,
            start,
            csv: None,
        }
    }

    /// Adds a row with a field for each column.
    ///
    /// # Errors
    /// If the disk refuses; the row is then not in the log, and may be tried again.
    pub fn append(&mut self, fields: &[String]) -> Result<(), ArchiveError> {
        let outcome = self.try_append(fields);
        if outcome.is_err() {
            self.close();
        }
        outcome
    }

    /// Closes the file; the next row opens it again.
    pub fn close(&mut self) {
        if let Some(csv) = &mut self.csv {
            csv.file = None;
        }
    }

    fn try_append(&mut self, fields: &[String]) -> Result<(), ArchiveError> {
        self.reopen();
        let csv = match &mut self.csv {
            Some(csv) => csv,
            none => {
                let make = |path: &Path| Growing::create(self.disk.as_ref(), path);
                let (path, file) = make_new(&self.root, self.what, self.start, ".csv", make)?;
                none.insert(Csv {
                    path,
                    whole: 0,
                    file: Some(file),
                    synced: Instant::now(),
                })
            }
        };
        if csv.whole == 0 {
            self.disk
                .sync_folder(&self.root)
                .during("flush the folder to the disk", &self.root)?;
        }
        csv.append(&self.columns, fields)
    }

    /// Opens the previous file; drops it if it is no longer complete.
    fn reopen(&mut self) {
        if let Some(csv) = &mut self.csv
            && csv.file.is_none()
        {
            csv.file = Growing::open(self.disk.as_ref(), &csv.path, csv.whole).ok();
        }
        self.csv.take_if(|csv| csv.file.is_none());
    }
}

impl Csv {
    fn append(&mut self, columns: &[String], fields: &[String]) -> Result<(), ArchiveError> {
        let mut lines = csv::Writer::from_writer(Vec::new());
        let written = match self.whole {
            0 => lines.write_record(columns),
            _ => Ok(()),
        };
        let bytes = written
            .and_then(|()| lines.write_record(fields))
            .map_err(io::Error::other)
            .and_then(|()| lines.into_inner().map_err(io::Error::other))
            .during("make a row of the log", &self.path)?;
        let Some(file) = &mut self.file else {
            let closed = Err(ErrorKind::NotConnected.into());
            return closed.during("add to the log", &self.path);
        };
        file.append(&bytes).during("add to the log", &self.path)?;
        self.whole = file.whole();
        if self.synced.elapsed() >= SYNC_EVERY {
            self.synced = Instant::now();
            // The row is in the file: an error here concerns the whole file, and appears again with the next row.
            if file.sync().is_err() {
                self.file = None;
            }
        }
        Ok(())
    }
}

/// Makes `<what>_<start><ending>` in the folder, or, if that exists, `<what>_<start>_2<ending>` and so on. `make`
/// must refuse existing names.
pub(super) fn make_new<T>(
    folder: &Path,
    what: &str,
    start: Timestamp,
    ending: &str,
    make: impl Fn(&Path) -> io::Result<T>,
) -> Result<(PathBuf, T), ArchiveError> {
    let start = start.strftime("%Y%m%dT%H%M%S");
    let first = folder.join(format!("{what}_{start}{ending}"));
    for n in 1..=MOST_NAMESAKES {
        let path = match n {
            1 => first.clone(),
            _ => folder.join(format!("{what}_{start}_{n}{ending}")),
        };
        match make(&path) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            made => return Ok((path.clone(), made.during("make the log", &path)?)),
        }
    }
    Err(ArchiveError::Namesakes { path: first })
}
