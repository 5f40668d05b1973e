//! A flight on disk: its logs are read into the history, and followed while they grow. See `docs/archive.md`.

use super::history::{FrameRow, History, MOST_TABLES};
use super::table::nanoseconds;
use super::table::{Column, Table};
use crate::clock::parse_utc;
use crate::link::Housekeeping;
use jiff::Timestamp;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Maximum number of bytes per read of a log, so that no viewer waits long.
const PIECE: u64 = 1 << 20;
/// Cameras have their own folders in the archive's.
const DEPTH: usize = 2;

/// Logs that are read: the first parts of their names.
const HOUSEKEEPING: &str = "housekeeping";
const SOLUTIONS: &str = "solutions";
const OTHERS: [&str; 2] = ["propagated", "gps"];

/// A log and the position up to which it has been read.
struct Log {
    /// The folder of its camera under the archive's; empty for the first camera.
    folder: String,
    what: String,
    /// Whether it is the only source of solutions.
    is_only_source: bool,
    offset: u64,
    header: Vec<String>,
}

/// Reads the logs of an archive.
pub struct Follower {
    root: PathBuf,
    logs: BTreeMap<PathBuf, Log>,
    /// Whether housekeeping and offsets come from here as well, and not over a line.
    is_only_source: bool,
}

impl Follower {
    /// For an archive that is the only source of a flight.
    pub fn of_flight(root: &Path) -> Self {
        Self {
            root: root.into(),
            logs: BTreeMap::new(),
            is_only_source: true,
        }
    }

    /// For the frames only, of a flight that is received over a line.
    pub fn of_frames(root: &Path) -> Self {
        Self {
            is_only_source: false,
            ..Self::of_flight(root)
        }
    }

    /// Reads the next piece of unread data from the logs. Returns whether there was any. `change` is called with the
    /// operation on the history.
    ///
    /// # Errors
    /// If a folder cannot be listed, or a log cannot be read.
    pub fn read_on(
        &mut self,
        mut change: impl FnMut(&mut dyn FnMut(&mut History)),
    ) -> io::Result<bool> {
        self.find_logs(&self.root.clone(), DEPTH)?;
        let mut has_any = false;
        for (path, log) in &mut self.logs {
            let text = log.next_piece(path)?;
            if text.is_empty() {
                continue;
            }
            has_any = true;
            let rows = log.rows(&text);
            change(&mut |history| rows.iter().for_each(|row| log.take(row, history)));
        }
        Ok(has_any)
    }

    fn find_logs(&mut self, folder: &Path, depth: usize) -> io::Result<()> {
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            let name = path
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            if path.extension().is_some_and(|ending| ending == "csv") && path.is_file() {
                self.add_log(&path, &name);
            } else if depth > 1 && !name.starts_with('.') && !is_of_frames(&name) && path.is_dir() {
                self.find_logs(&path, depth - 1)?;
            }
        }
        Ok(())
    }

    fn add_log(&mut self, path: &Path, name: &str) {
        let what = name.split('_').next().unwrap_or_default();
        let is_wanted = what == SOLUTIONS
            || (self.is_only_source && (what == HOUSEKEEPING || OTHERS.contains(&what)));
        if !is_wanted || self.logs.contains_key(path) {
            return;
        }
        let folder = path
            .parent()
            .and_then(|folder| folder.strip_prefix(&self.root).ok());
        let log = Log {
            folder: folder.unwrap_or(Path::new("")).display().to_string(),
            what: what.into(),
            is_only_source: self.is_only_source,
            offset: 0,
            header: Vec::new(),
        };
        self.logs.insert(path.into(), log);
    }
}

/// Whether a folder holds no logs: an hour's frames, `20130921T18`, or telemetry.
fn is_of_frames(name: &str) -> bool {
    let hour = name.split_once('T');
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    hour.is_some_and(|(day, hour)| digits(day) && digits(hour)) || name.starts_with("telemetry")
}

impl Log {
    /// The next complete lines.
    fn next_piece(&mut self, path: &Path) -> io::Result<String> {
        let mut file = File::open(path)?;
        file.seek(SeekFrom::Start(self.offset))?;
        let mut bytes = Vec::new();
        file.take(PIECE).read_to_end(&mut bytes)?;
        let whole = match bytes.iter().rposition(|byte| *byte == b'\n') {
            Some(end) => end + 1,
            // No valid line is this long: these are zero bytes from a power cut, or another kind of file.
            None if bytes.len() as u64 == PIECE => bytes.len(),
            None => 0,
        };
        bytes.truncate(whole);
        self.offset += whole as u64;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }

    /// The rows of complete lines. The log's first row is its header; lines that are not CSV are skipped.
    fn rows(&mut self, text: &str) -> Vec<csv::StringRecord> {
        let mut reader = csv::ReaderBuilder::new();
        let reader = reader
            .has_headers(false)
            .flexible(true)
            .from_reader(text.as_bytes());
        let mut rows: Vec<csv::StringRecord> =
            reader.into_records().filter_map(Result::ok).collect();
        if self.header.is_empty() && !rows.is_empty() {
            // "taken [unit]": the name precedes the unit.
            let name = |name: &str| name.split(' ').next().unwrap_or_default().to_owned();
            self.header = rows.remove(0).iter().map(name).collect();
        }
        rows
    }

    fn field<'a>(&self, row: &'a csv::StringRecord, name: &str) -> Option<&'a str> {
        let at = self.header.iter().position(|column| column == name)?;
        row.get(at)
    }

    fn time(&self, row: &csv::StringRecord) -> Option<i64> {
        if let Some(utc) = self.field(row, "utc") {
            return parse_utc(utc).ok().map(nanoseconds);
        }
        let seconds: f64 = self.field(row, "t_s")?.parse().ok()?;
        let time = Timestamp::from_nanosecond((seconds * 1e9) as i128).ok()?;
        Some(nanoseconds(time))
    }

    fn take(&self, row: &csv::StringRecord, history: &mut History) {
        let Some(time) = self.time(row) else {
            return;
        };
        if self.what == HOUSEKEEPING {
            if let Some(housekeeping) = Housekeeping::from_csv(|name| self.field(row, name)) {
                history.take_housekeeping(&housekeeping, time, time);
            }
            return;
        }
        let table = self.table_name();
        if history.tables.len() >= MOST_TABLES && !history.tables.contains_key(&table) {
            return;
        }
        let table = history.tables.entry(table.clone());
        let table = table.or_insert_with_key(|name| Table::new(name, self.columns()));
        let numbers: Vec<Option<f64>> = table
            .columns
            .iter()
            .map(|column| self.field(row, &column.name)?.parse().ok())
            .collect();
        table.push(time, time, &numbers);
        match self.what.as_str() {
            SOLUTIONS => {
                // If a line delivers solutions as well, those are newer.
                history.news.solution += u64::from(self.is_only_source);
                history.news.frames += 1;
                history.frame_read = Some(nanoseconds(Timestamp::now()));
                self.take_frame(row, time, history);
            }
            _ => history.news.gyros += 1,
        }
    }

    fn table_name(&self) -> String {
        match self.folder.as_str() {
            "" => self.what.clone(),
            folder => format!("{folder}/{}", self.what),
        }
    }

    /// The log's columns with numbers.
    fn columns(&self) -> Vec<Column> {
        const WORDS: [&str; 8] = [
            "utc", "t_s", "file", "quality", "reason", "mapping", "disk", "status",
        ];
        let numbers = self
            .header
            .iter()
            .filter(|name| !WORDS.contains(&name.as_str()));
        let column = |name: &String| Column::new(name, unit(name), "see the page on the archive");
        numbers.map(column).collect()
    }

    fn take_frame(&self, row: &csv::StringRecord, time: i64, history: &mut History) {
        let text = |name| self.field(row, name).unwrap_or_default();
        let reason = history.reason(text("reason"));
        let quality = match text("quality") {
            "fine" => "fine",
            "coarse" => "coarse",
            _ => "none",
        };
        let frame = FrameRow {
            time,
            file: text("file").into(),
            camera: self.folder.as_str().into(),
            quality,
            reason,
        };
        let earlier = |known: &FrameRow| known.time <= time;
        let at = history.frames.partition_point(earlier);
        history.frames.insert(at, frame);
    }
}

/// The unit at the end of a column's name.
fn unit(name: &str) -> &'static str {
    const UNITS: [(&str, &str); 10] = [
        ("_mil_per_px", "mil/px"),
        ("_px", "px"),
        ("_mil", "mil"),
        ("_deg", "deg"),
        ("_arcsec", "arcsec"),
        ("_us", "us"),
        ("_dn", "DN"),
        ("_s", "s"),
        ("_m", "m"),
        ("_c", "deg C"),
    ];
    let found = UNITS.iter().find(|(ending, _)| name.ends_with(ending));
    found.map_or("", |(_, unit)| unit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::time::Duration;

    fn read(follower: &mut Follower, history: &mut History) -> bool {
        follower.read_on(|change| change(history)).unwrap()
    }

    #[test]
    fn a_log_is_read_on_while_it_grows_and_a_half_line_waits_for_its_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("solutions_20130921T180000.csv");
        let mut log = File::create(path).unwrap();
        let header = "frame,file,utc,quality,reason,sun_x_px\n";
        let first = "1,20130921T18/a.fits,2013-09-21T18:00:00.250Z,fine,,640.5\n2,,2013-09-2";
        write!(log, "{header}{first}").unwrap();
        let mut history = History::new(Duration::from_secs(86_400));
        let mut follower = Follower::of_flight(folder.path());
        assert!(read(&mut follower, &mut history));
        assert_eq!(
            history.tables["solutions"].value(0, "sun_x_px"),
            Some(640.5)
        );
        assert_eq!(history.tables["solutions"].times().len(), 1);
        assert!(!read(&mut follower, &mut history));
        writeln!(log, "1T18:00:00.500Z,none,limb: no disc,").unwrap();
        assert!(read(&mut follower, &mut history));
        let frames: Vec<_> = history
            .frames
            .iter()
            .map(|f| (&*f.file, f.quality, f.reason))
            .collect();
        assert_eq!(
            frames,
            [("20130921T18/a.fits", "fine", None), ("", "none", Some(0))]
        );
        assert_eq!(history.reasons, ["limb: no disc"]);
        assert_eq!(history.tables["solutions"].value(1, "sun_x_px"), None);
    }

    #[test]
    fn a_log_is_read_past_the_zero_bytes_of_a_power_cut() {
        let folder = tempfile::tempdir().unwrap();
        let mut log = File::create(folder.path().join("solutions_20130921T180000.csv")).unwrap();
        writeln!(log, "frame,file,utc,quality,reason,sun_x_px").unwrap();
        writeln!(log, "1,,2013-09-21T18:00:00.250Z,fine,,640.5").unwrap();
        log.write_all(&vec![0; 3 * PIECE as usize]).unwrap();
        writeln!(log, "\n2,,2013-09-21T18:00:00.500Z,fine,,641.5").unwrap();
        let mut history = History::new(Duration::from_secs(86_400));
        let mut follower = Follower::of_flight(folder.path());
        while read(&mut follower, &mut history) {}
        let solutions = &history.tables["solutions"];
        let read = [0, 1].map(|row| solutions.value(row, "sun_x_px"));
        assert_eq!(
            (read, solutions.times().len()),
            ([Some(640.5), Some(641.5)], 2)
        );
    }

    #[test]
    fn units_are_those_that_names_end_with() {
        assert_eq!(unit("scale_mil_per_px"), "mil/px");
        assert_eq!(unit("sun_plate_sigma_x_mil"), "mil");
        assert_eq!(unit("marks"), "");
    }
}
