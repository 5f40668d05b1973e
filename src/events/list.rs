//! An event list on disk: its photons' table, and its time system.

use super::detectors::Detectors;
use super::photons::{Measured, PHOTON_COLUMNS};
use super::times::{Keywords, TimeSystem};
use crate::clock::Scale;
use crate::columns;
use crate::files;
use crate::fits::{DiskFile, DiskHdu, FileError, Problem};
use flate2::read::MultiGzDecoder;
use std::fs::File;
use std::path::Path;
use tempfile::NamedTempFile;

/// An open event list.
pub struct EventList {
    pub file: DiskFile,
    /// Index of the HDU with the photons.
    pub photons: usize,
    pub rows: u64,
    /// Time system of the photons' table.
    pub times: TimeSystem,
    pub measured: Measured,
}

impl EventList {
    /// Opens a list, plain or gzipped, with a column of energies if selected. Unpacked data go to a file in `folder`, because they may
    /// not fit into memory.
    ///
    /// # Errors
    /// If the file cannot be read, or has no photons with times and positions.
    pub fn open(
        path: &Path,
        folder: &Path,
        detectors: &Detectors,
        energy: Option<&str>,
    ) -> Result<Self, FileError> {
        let found = open(path, folder)?;
        Self::of(found, detectors, energy).map_err(|problem| problem.in_file(path))
    }

    fn of(file: DiskFile, detectors: &Detectors, energy: Option<&str>) -> Result<Self, Problem> {
        let photons = photons_hdu(&file, &detectors.columns.time)?;
        let hdu = &file.hdus()[photons];
        let primary = &file.hdus()[0].header;
        let keywords = Keywords {
            own: &hdu.header,
            primary,
        };
        let read = || {
            let times = keywords.time_system(Scale::Utc)?.ok_or_else(|| {
                Problem::field("MJDREF", "a day, here or in MJDREFI and MJDREFF", "none")
            })?;
            refuse_columns(hdu)?;
            let measured = Measured::of(hdu, detectors, energy, times)?;
            Ok((times, hdu.rows()?, measured))
        };
        let (times, rows, measured) =
            read().map_err(|problem: Problem| problem.within(&hdu.name()))?;
        Ok(Self {
            photons,
            rows,
            times,
            measured,
            file,
        })
    }

    pub fn hdu(&self) -> &DiskHdu {
        &self.file.hdus()[self.photons]
    }

    pub fn primary(&self) -> &DiskHdu {
        &self.file.hdus()[0]
    }

    /// TSTART and TSTOP, s since 1970 UTC, if both are stated.
    ///
    /// # Errors
    /// If the values are not numbers.
    pub fn stated_span(&self) -> Result<Option<[f64; 2]>, Problem> {
        let keywords = Keywords {
            own: &self.hdu().header,
            primary: &self.primary().header,
        };
        let [start, stop] = ["TSTART", "TSTOP"].map(|keyword| keywords.number(keyword));
        let unix_s = |time: Option<f64>| self.times.unix_s(time?);
        let span = unix_s(start?).zip(unix_s(stop?));
        Ok(span.map(|(start, stop)| [start, stop]))
    }
}

fn open(path: &Path, folder: &Path) -> Result<DiskFile, FileError> {
    let refused = |problem: Problem| problem.in_file(path);
    let unread = |error| refused(Problem::of_unread(error));
    let packed = files::open_regular(path).map_err(unread)?;
    let magic = files::read_start(path, 2).map_err(unread)?;
    if magic != [0x1f, 0x8b] {
        return DiskFile::open(path, path);
    }
    let plain = NamedTempFile::with_prefix_in(".events-", folder);
    let mut plain = plain.map_err(|cause| columns::refused(folder, cause))?;
    unpack(packed, plain.as_file_mut()).map_err(refused)?;
    // The file is open, so that its name may be removed from the folder.
    DiskFile::open(plain.path(), path)
}

fn unpack(packed: File, plain: &mut File) -> Result<(), Problem> {
    let copied = std::io::copy(&mut MultiGzDecoder::new(packed), plain);
    let whole = |error: std::io::Error| {
        Problem::content("a whole gzip file, and space for it", error.to_string())
    };
    copied.map(drop).map_err(whole)
}

/// The table with the photons: EVENTS, else the only one with times.
fn photons_hdu(file: &DiskFile, time: &str) -> Result<usize, Problem> {
    let tables = || (0..).zip(file.hdus()).filter(|(_, hdu)| hdu.is_table);
    if let Some((n, _)) = tables().find(|(_, hdu)| hdu.says("EXTNAME", "EVENTS")) {
        return Ok(n);
    }
    let has_times = |hdu: &DiskHdu| hdu.columns().is_ok_and(|columns| is_among(time, &columns));
    let timed = tables().filter(|(_, hdu)| has_times(hdu));
    let timed: Vec<usize> = timed.map(|(n, _)| n).collect();
    match timed[..] {
        [n] => Ok(n),
        _ => Err(Problem::content(
            format!("a table EVENTS, or one table with a column {time}"),
            format!("{} with one", timed.len()),
        )),
    }
}

/// Whether a column is among others, ignoring case.
fn is_among(name: &str, columns: &[String]) -> bool {
    let mut columns = columns.iter();
    columns.any(|column| column.eq_ignore_ascii_case(name))
}

/// Refuses a table that already has columns with the names of the added ones.
fn refuse_columns(hdu: &DiskHdu) -> Result<(), Problem> {
    let columns = hdu.columns()?;
    let mut ours = PHOTON_COLUMNS.iter().map(|ours| ours.name);
    match ours.find(|ours| is_among(ours, &columns)) {
        None => Ok(()),
        Some(ours) => Err(Problem::field(
            format!("column {ours}"),
            "none of this name, which is added",
            "one",
        )),
    }
}
