//! Photons put on the Sun: the event list of a telescope, with each photon's helioprojective place by the pointing of a refined flight.
//!
//! Event lists are FITS files as X-ray astronomy keeps them (OGIP): a table EVENTS with a row for each photon, and tables of good time
//! intervals. [`place_photons`] copies such a file. In the copy the photons' table has more columns ([`PHOTON_COLUMNS`]), the good time
//! intervals are those in which the pointing is valid, too, and all else is as it was, byte for byte.
//!
//! A detector measures a photon at (x, y). How it is mounted ([`Detectors`]) makes of that two angles from the boresight, to the telescope's
//! right R and up U in the plane that touches the sky there: the photon came from the direction forward + R right + U up. The pointing at the
//! photon's time turns that into axes about the Sun.

mod detectors;
mod good_times;
mod list;
mod photons;
mod times;

pub use detectors::{Detectors, FromBoresight, PhotonColumns};
pub use photons::{PHOTON_COLUMNS, Photon, Place};

use crate::columns::{self, Widths};
use crate::fits::{AmendedTable, CellForm, DiskHdu, FileError, Problem, StoredColumn, StoredRow};
use crate::instrument::TomlError;
use crate::observe::Watch;
use crate::pointing_history::{POINTING_FILE, PointingHistory, StoreError};
use crate::provenance::LONG_VERSION;
use good_times::{GoodTimes, common};
use list::EventList;
use std::collections::BTreeMap;
use std::fs::{self, Permissions};
use std::io::BufWriter;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// Photons that are read at a time, after which a watch is shown a step.
const STEP: u64 = 1000;

/// The files of a run.
#[derive(Debug, Clone, Copy)]
pub struct Files<'a> {
    /// The folder of a refined flight.
    pub refined: &'a Path,
    /// The event list, plain or gzipped.
    pub events: &'a Path,
    /// DET.toml.
    pub detectors: &'a Path,
    /// The copy; what stood there is replaced.
    pub out: &'a Path,
}

/// What a run did.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Placed {
    pub photons: u64,
    pub valid: u64,
    /// How many are not, by the reason.
    pub invalid: BTreeMap<&'static str, u64>,
    pub exposures: Vec<Exposure>,
}

/// The length of the good time intervals of an extension, without and with a valid pointing.
#[derive(Debug, Clone, PartialEq)]
pub struct Exposure {
    pub extension: String,
    pub before_s: f64,
    pub after_s: f64,
}

/// Why photons are not put on the Sun.
#[derive(Debug, thiserror::Error)]
pub enum EventsError {
    #[error(transparent)]
    Detectors(#[from] TomlError),
    #[error(transparent)]
    Pointing(#[from] StoreError),
    /// The event list, or the copy.
    #[error(transparent)]
    File(#[from] FileError),
    #[error("{}: expected a file other than those that are read, found {}", .out.display(), .input.display())]
    Overwrites { out: PathBuf, input: PathBuf },
    #[error("cancelled: {} is not written", .out.display())]
    Cancelled { out: PathBuf },
}

/// Copies an event list, with each photon's place on the Sun.
///
/// Memory holds the flight's pointing and the good time intervals; photons pass through.
///
/// # Errors
/// Files that cannot be read or are not what they should be, a photon of an unknown detector, a copy that cannot be written: then there is none.
pub fn place_photons(files: Files<'_>, watch: &dyn Watch) -> Result<Placed, EventsError> {
    refuse_overwriting(&files)?;
    let detectors = Detectors::read(files.detectors)?;
    let history = PointingHistory::read(files.refined)?;
    let list = EventList::open(files.events, folder_of(files.out), &detectors)?;
    let part = part_beside(files.out)?;
    let mut run = Run {
        files,
        list: &list,
        detectors,
        history,
        watch,
        placed: Placed::default(),
        span: None,
    };
    watch.begin(list.rows.div_ceil(STEP) as usize, "thousand photons");
    let written = run.write(&part);
    watch.end();
    written?;
    part.persist(files.out)
        .map_err(|error| columns::refused(files.out, error.error))?;
    Ok(run.placed)
}

/// Refuses to replace a file that is read, by whatever name.
fn refuse_overwriting(files: &Files<'_>) -> Result<(), EventsError> {
    let identity = |path: &Path| {
        fs::metadata(path)
            .ok()
            .map(|found| (found.dev(), found.ino()))
    };
    let pointing = files.refined.join(POINTING_FILE);
    let Some(out) = identity(files.out) else {
        return Ok(());
    };
    let inputs = [files.events, files.detectors, &pointing];
    match inputs
        .into_iter()
        .find(|input| identity(input) == Some(out))
    {
        None => Ok(()),
        Some(input) => Err(EventsError::Overwrites {
            out: files.out.into(),
            input: input.into(),
        }),
    }
}

fn folder_of(path: &Path) -> &Path {
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    folder.unwrap_or(Path::new("."))
}

/// A file beside another, which it becomes when it is whole; until then it goes with the run.
fn part_beside(path: &Path) -> Result<NamedTempFile, FileError> {
    let mut builder = tempfile::Builder::new();
    let builder = builder.prefix(".events-").suffix(".part");
    // As of any new file: the umask takes its share.
    let builder = builder.permissions(Permissions::from_mode(0o666));
    let part = builder.tempfile_in(folder_of(path));
    part.map_err(|cause| columns::refused(path, cause))
}

/// A run in progress.
struct Run<'a> {
    files: Files<'a>,
    list: &'a EventList,
    detectors: Detectors,
    history: PointingHistory,
    watch: &'a dyn Watch,
    placed: Placed,
    /// The first and the last time of a photon.
    span: Option<[f64; 2]>,
}

impl Run<'_> {
    fn write(&mut self, part: &NamedTempFile) -> Result<(), EventsError> {
        let out = self.files.out;
        let unwritten = |cause| columns::refused(out, cause);
        let file = part.as_file().try_clone().map_err(unwritten)?;
        let mut copy = BufWriter::with_capacity(1 << 20, file);
        let from = &self.list.file;
        let history = self.provenance()?;
        let valid = self.history.valid_intervals();
        for (n, hdu) in from.hdus().iter().enumerate() {
            if n != self.list.photons && !good_times::are_in(hdu) {
                from.copy(hdu, &mut copy)?;
                continue;
            }
            let mut table = from.amended(hdu, folder_of(out))?;
            match n == self.list.photons {
                true => self.place(&mut table)?,
                false => self.intersect(&mut table, hdu, &valid)?,
            }
            table.history(&history)?;
            table.finish(&mut copy)?;
        }
        if self.placed.exposures.is_empty() {
            let mut table = self.good_times(&valid)?;
            table.history(&history)?;
            table.finish(&mut copy)?;
        }
        from.copy_rest(&mut copy)?;
        let file = copy
            .into_inner()
            .map_err(|error| unwritten(error.into_error()))?;
        Ok(file.sync_all().map_err(unwritten)?)
    }

    /// Lines of HISTORY: which program, and from what.
    fn provenance(&self) -> Result<Vec<String>, FileError> {
        let pointing = self.files.refined.join(POINTING_FILE);
        Ok(vec![
            format!("solaspect {LONG_VERSION}: photons put on the Sun"),
            format!("SHA-256 of the pointing, {POINTING_FILE}:"),
            columns::sha256(&pointing)?,
            "SHA-256 of what is stated of the detectors:".into(),
            columns::sha256(self.files.detectors)?,
        ])
    }

    /// Adds the photons' places to their table.
    fn place(&mut self, table: &mut AmendedTable) -> Result<(), EventsError> {
        let (measured, rows) = (&self.list.measured, self.list.rows);
        let widths = Widths::new(PHOTON_COLUMNS);
        let behind = table.row_bytes()?;
        table.add_columns(&columns::stored_columns(PHOTON_COLUMNS, &widths))?;
        let mut stored = StoredRow::default();
        for first in (1..=rows).step_by(STEP as usize) {
            let count = STEP.min(rows + 1 - first) as usize;
            for (n, row) in (first..).zip(measured.read(table, first, count)?) {
                let photon = measured.place(&row, &self.detectors, &self.history);
                let photon = photon.map_err(|problem| self.within_row(n, problem))?;
                stored.clear();
                columns::store(PHOTON_COLUMNS, &widths, &photon, &mut stored);
                table.put_bytes(n, behind, stored.bytes())?;
                self.placed.count(&photon);
                self.span = photon.unix_s.map_or(self.span, |time_s| {
                    let [first, last] = self.span.unwrap_or([time_s; 2]);
                    Some([first.min(time_s), last.max(time_s)])
                });
            }
            self.watch.step();
            if self.watch.is_cancelled() {
                let out = self.files.out.into();
                return Err(EventsError::Cancelled { out });
            }
        }
        Ok(())
    }

    /// Names the row that is at fault.
    fn within_row(&self, row: u64, problem: Problem) -> FileError {
        let table = format!("{}, row {row}", self.list.hdu().name());
        problem.within(&table).in_file(self.files.events)
    }

    /// Leaves of good time intervals what has a valid pointing.
    fn intersect(
        &mut self,
        table: &mut AmendedTable,
        hdu: &DiskHdu,
        valid: &[[f64; 2]],
    ) -> Result<(), FileError> {
        let times = GoodTimes::of(hdu, self.list.primary(), self.list.counted);
        let times =
            times.map_err(|problem| problem.within(&hdu.name()).in_file(self.files.events))?;
        let found = times.intersect(table, valid)?;
        self.placed.exposures.push(Exposure {
            extension: hdu.name(),
            before_s: found.before_s,
            after_s: found.after_s,
        });
        Ok(())
    }

    /// Good time intervals of a file that has none: between TSTART and TSTOP, or else the first and the last photon.
    fn good_times(&mut self, valid: &[[f64; 2]]) -> Result<AmendedTable, FileError> {
        const NAME: &str = "GTI";
        let (list, counted) = (self.list, self.list.counted);
        let photons = list.hdu();
        let stated = list.stated_span();
        let stated =
            stated.map_err(|problem| problem.within(&photons.name()).in_file(self.files.events))?;
        let span = stated.or(self.span).unwrap_or([0.0, 0.0]);
        let parts: Vec<[f64; 2]> = common(span, valid).collect();

        let mut table = AmendedTable::create(NAME, self.files.out, folder_of(self.files.out))?;
        let column = |name, meaning| StoredColumn {
            name,
            unit: counted.unit(),
            meaning,
            form: CellForm::Float,
        };
        table.add_columns(&[
            column("START", "begin of a good time interval"),
            column("STOP", "its end"),
        ])?;
        for keyword in times::KEYWORDS {
            let cards = [photons, list.primary()].map(|hdu| hdu.card(keyword));
            if let Some(card) = cards.into_iter().flatten().next() {
                table.card(card)?;
            }
        }
        table.set_rows(parts.len() as u64)?;
        let mut stored = StoredRow::default();
        for (n, part) in (1..).zip(&parts) {
            stored.clear();
            for end in part {
                stored.float(counted.time(*end));
            }
            table.put_bytes(n, 0, stored.bytes())?;
        }
        self.placed.exposures.push(Exposure {
            extension: NAME.into(),
            before_s: span[1] - span[0],
            after_s: parts.iter().map(|[start, stop]| stop - start).sum(),
        });
        Ok(table)
    }
}

impl Placed {
    fn count(&mut self, photon: &Photon) {
        self.photons += 1;
        match photon.invalid {
            None => self.valid += 1,
            Some(why) => *self.invalid.entry(why).or_default() += 1,
        }
    }
}
