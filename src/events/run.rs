//! A run: the tables of an event list are amended, each in its own file, and copied from there; the photons are counted in the image as
//! they are processed.

use super::detectors::{Detector, Detectors};
use super::good_times::{self, Good, GoodTimes, common, length_s, live_fraction};
use super::imaging::{Grid, ImageRequest, Picture};
use super::list::EventList;
use super::photons::PHOTON_COLUMNS;
use super::times;
use super::{EventsError, Exposure, Files, Placed};
use crate::columns::{self, Widths, folder_of, part_beside};
use crate::fits::{
    AmendedTable, Card, CellForm, DiskHdu, FileError, Header, Problem, StoredColumn, StoredRow,
    keyword,
};
use crate::observe::Watch;
use crate::pointing_history::{POINTING_FILE, PointingHistory};
use crate::provenance::LONG_VERSION;
use std::fs;
use std::io::{BufWriter, Write};
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use tempfile::NamedTempFile;

/// Number of photons read at a time, after which the progress is reported.
const STEP: u64 = 1000;

/// Assigns the photons of an event list to positions on the Sun: writes a copy with each photon's position, an image, or both.
///
/// Memory contains the flight's pointing, the good time intervals and the image; photons are streamed.
///
/// # Errors
/// If a file cannot be read or has wrong contents, a photon is of an unknown detector, or a file cannot be written: no output is then
/// made.
pub fn place_photons(files: Files<'_>, watch: &dyn Watch) -> Result<Placed, EventsError> {
    refuse_overwriting(&files)?;
    let detectors = Detectors::read(files.detectors)?;
    let history = PointingHistory::read(files.refined)?;
    let energies = files.image.and_then(|image| image.energies.as_ref());
    let energy = energies.map(|energies| energies.column.as_str());
    let list = EventList::open(files.events, scratch(&files), &detectors, energy)?;
    let run = Run {
        valid: history.valid_intervals(),
        files,
        list: &list,
        detectors,
        history,
        watch,
        placed: Placed::default(),
        span: None,
    };
    watch.begin(list.rows.div_ceil(STEP) as usize, "thousand photons");
    let placed = run.finish();
    watch.end();
    placed
}

/// Refuses to replace an input file, by whatever name, or to write two outputs to one file.
fn refuse_overwriting(files: &Files<'_>) -> Result<(), EventsError> {
    let identity = |path: &Path| {
        fs::metadata(path)
            .ok()
            .map(|found| (found.dev(), found.ino()))
    };
    let pointing = files.refined.join(POINTING_FILE);
    let inputs = [files.events, files.detectors, &pointing];
    let image = files.image.map(|image| image.path.as_path());
    let refused = |out: &Path, other: &Path| EventsError::Overwrites {
        out: out.into(),
        other: other.into(),
    };
    for out in [files.out, image].into_iter().flatten() {
        let Some(found) = identity(out) else { continue };
        if let Some(input) = inputs.iter().find(|input| identity(input) == Some(found)) {
            return Err(refused(out, input));
        }
    }
    match files.out.zip(image) {
        Some((out, image))
            if out == image
                || identity(out).is_some_and(|found| identity(image) == Some(found)) =>
        {
            Err(refused(image, out))
        }
        _ => Ok(()),
    }
}

/// The folder of unfinished files: on the disk of the results.
fn scratch<'a>(files: &Files<'a>) -> &'a Path {
    let image = files.image.map(|image| image.path.as_path());
    folder_of(files.out.or(image).unwrap_or(files.events))
}

/// Writes a temporary file, which does not have its name yet.
fn written(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<fs::File>) -> Result<(), EventsError>,
) -> Result<NamedTempFile, EventsError> {
    let unwritten = |cause| columns::refused(path, cause);
    let part = part_beside(path).map_err(unwritten)?;
    let file = part.as_file().try_clone().map_err(unwritten)?;
    let mut file = BufWriter::with_capacity(1 << 20, file);
    write(&mut file)?;
    let file = file
        .into_inner()
        .map_err(|error| unwritten(error.into_error()))?;
    file.sync_all().map_err(unwritten)?;
    Ok(part)
}

fn persist(file: NamedTempFile, path: &Path) -> Result<(), FileError> {
    let named = file.persist(path);
    named
        .map(|_| ())
        .map_err(|error| columns::refused(path, error.error))
}

/// A run in progress.
struct Run<'a> {
    files: Files<'a>,
    list: &'a EventList,
    detectors: Detectors,
    history: PointingHistory,
    /// Intervals of valid pointing.
    valid: Vec<[f64; 2]>,
    watch: &'a dyn Watch,
    placed: Placed,
    /// The first and the last time of a photon.
    span: Option<[f64; 2]>,
}

/// An amended table.
struct Amended {
    /// The index of its HDU.
    hdu: usize,
    table: AmendedTable,
}

impl Run<'_> {
    fn finish(mut self) -> Result<Placed, EventsError> {
        let lines = self.provenance()?;
        let (mut tables, good) = self.cut_good_times()?;
        let picture = self.files.image.map(|request| self.picture(request, &good));
        let mut picture = picture.transpose()?;
        tables.push(self.place(picture.as_mut())?);
        let new = match good.is_empty() {
            true => Some(self.good_times()?),
            false => None,
        };
        let new_good = new.as_ref().map(|(_, good)| good);
        let image = picture.map(|picture| self.image(picture, new_good, &lines));
        let image = image.transpose()?;
        if let Some(out) = self.files.out {
            let copy = self.copy(out, tables, new.map(|(table, _)| table), &lines)?;
            persist(copy, out)?;
        }
        if let Some((image, request)) = image.zip(self.files.image) {
            persist(image, &request.path)?;
        }
        Ok(self.placed)
    }

    /// Lines of HISTORY: program and inputs.
    fn provenance(&self) -> Result<Vec<String>, FileError> {
        let pointing = self.files.refined.join(POINTING_FILE);
        Ok(vec![
            format!("solaspect {LONG_VERSION}: positions of photons on the Sun"),
            format!("SHA-256 of the pointing, {POINTING_FILE}:"),
            columns::sha256(&pointing)?,
            "SHA-256 of the description of the detectors:".into(),
            columns::sha256(self.files.detectors)?,
        ])
    }

    /// Adds the HDU and the file to a problem.
    fn within(&self, hdu: &DiskHdu, problem: Problem) -> FileError {
        problem.within(&hdu.name()).in_file(self.files.events)
    }

    /// The live fraction of a detector, needed only for an image.
    fn live_fraction(&self, headers: &[&Header]) -> Result<f64, Problem> {
        match self.files.image {
            Some(_) => live_fraction(headers),
            None => Ok(1.0),
        }
    }

    /// The tables of good time intervals, restricted to valid pointing.
    fn cut_good_times(&mut self) -> Result<(Vec<Amended>, Vec<Good>), FileError> {
        let (mut tables, mut all) = (Vec::new(), Vec::new());
        let list = self.list;
        for (n, hdu) in list.file.hdus().iter().enumerate() {
            if n == list.photons || !good_times::are_in(hdu) {
                continue;
            }
            let mut table = list.file.amended(hdu, scratch(&self.files))?;
            let headers = [&hdu.header, &list.hdu().header, &list.primary().header];
            let read = || {
                let times = GoodTimes::of(hdu, list.primary(), list.times)?;
                Ok((times, self.live_fraction(&headers)?))
            };
            let (times, part) = read().map_err(|problem| self.within(hdu, problem))?;
            let cut = times.intersect(&mut table, &self.valid)?;
            let after_s = length_s(&cut.left_s);
            self.placed.exposures.push(Exposure {
                extension: hdu.name(),
                before_s: cut.before_s,
                after_s,
            });
            all.push(Good::new(hdu.name(), cut.left_s, part));
            tables.push(Amended { hdu: n, table });
        }
        Ok((tables, all))
    }

    /// The image, still without photons.
    fn picture<'b>(
        &self,
        request: &'b ImageRequest,
        good: &'b [Good],
    ) -> Result<Picture<'b>, FileError> {
        let of_detectors = |problem: Problem| problem.in_file(self.files.detectors);
        let photons = self.list.hdu();
        let stated = || self.list.measured.stated_field(photons);
        let is_needed = self
            .detectors
            .iter()
            .any(|detector| detector.field.is_none());
        let stated = is_needed.then(stated).transpose();
        let stated = stated
            .map_err(|problem| self.within(photons, problem))?
            .flatten();
        let field = |(n, detector): (usize, &Detector)| {
            detector.field.or(stated).ok_or_else(|| {
                let expected = "[[low, high] of x, [low, high] of y], or TLMINn and TLMAXn of the columns x and y of the photons' table";
                Problem::field(format!("detector.{n}.field"), expected, "none")
            })
        };
        let fields = self.detectors.iter().enumerate().map(field);
        let fields: Vec<_> = fields.collect::<Result<_, _>>().map_err(of_detectors)?;
        let grid = Grid::new(request.pixel_arcsec, &request.field);
        let grid = grid.map_err(|problem| problem.in_file(&request.path))?;
        Picture::new(request, grid, &self.detectors, &fields, good).map_err(of_detectors)
    }

    /// Adds the photons' positions to their table, and counts them.
    fn place(&mut self, mut picture: Option<&mut Picture<'_>>) -> Result<Amended, EventsError> {
        let list = self.list;
        let (measured, rows) = (&list.measured, list.rows);
        let mut table = list.file.amended(list.hdu(), scratch(&self.files))?;
        let widths = Widths::new(PHOTON_COLUMNS);
        let behind = table.row_bytes()?;
        let is_copied = self.files.out.is_some();
        if is_copied {
            table.add_columns(&columns::stored_columns(PHOTON_COLUMNS, &widths))?;
        }
        let mut stored = StoredRow::default();
        for first in (1..=rows).step_by(STEP as usize) {
            let count = STEP.min(rows + 1 - first) as usize;
            for (n, row) in (first..).zip(measured.read(&mut table, first, count)?) {
                let placed = measured.place(&row, &self.detectors, &self.history);
                let (photon, detector) = placed.map_err(|problem| self.within_row(n, problem))?;
                if is_copied {
                    stored.clear();
                    columns::store(PHOTON_COLUMNS, &widths, &photon, &mut stored);
                    table.put_bytes(n, behind, stored.bytes())?;
                }
                if let Some(picture) = &mut picture {
                    picture.count(&row, &photon, detector);
                }
                self.placed.count(&photon);
                self.span = photon.unix_s.map_or(self.span, |time_s| {
                    let [first, last] = self.span.unwrap_or([time_s; 2]);
                    Some([first.min(time_s), last.max(time_s)])
                });
            }
            self.watch.step();
            if self.watch.is_cancelled() {
                let image = self.files.image.map(|image| image.path.as_path());
                let out = self.files.out.or(image).unwrap_or(self.files.events).into();
                return Err(EventsError::Cancelled { out });
            }
        }
        Ok(Amended {
            hdu: list.photons,
            table,
        })
    }

    /// Adds the row to a problem.
    fn within_row(&self, row: u64, problem: Problem) -> FileError {
        let table = format!("{}, row {row}", self.list.hdu().name());
        problem.within(&table).in_file(self.files.events)
    }

    /// Good time intervals of a file without any: between TSTART and TSTOP, or else the first and the last photon.
    fn good_times(&mut self) -> Result<(AmendedTable, Good), FileError> {
        const NAME: &str = "GTI";
        let (list, times) = (self.list, self.list.times);
        let photons = list.hdu();
        let headers = [&photons.header, &list.primary().header];
        let read = || Ok((list.stated_span()?, self.live_fraction(&headers)?));
        let (stated, part) = read().map_err(|problem| self.within(photons, problem))?;
        let span = stated.or(self.span).unwrap_or([0.0, 0.0]);
        let parts: Vec<[f64; 2]> = common(span, &self.valid).collect();

        let mut table = AmendedTable::create(NAME, self.files.events, scratch(&self.files))?;
        let column = |name, meaning| StoredColumn {
            name,
            unit: times.unit(),
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
                stored.float(times.time(*end));
            }
            table.put_bytes(n, 0, stored.bytes())?;
        }
        self.placed.exposures.push(Exposure {
            extension: NAME.into(),
            before_s: span[1] - span[0],
            after_s: length_s(&parts),
        });
        Ok((table, Good::new(NAME.into(), parts, part)))
    }

    /// Writes the copy under a temporary name; a new table of good times is appended.
    fn copy(
        &self,
        out: &Path,
        amended: Vec<Amended>,
        new: Option<AmendedTable>,
        lines: &[String],
    ) -> Result<NamedTempFile, EventsError> {
        let from = &self.list.file;
        let mut amended: Vec<Option<Amended>> = amended.into_iter().map(Some).collect();
        written(out, |copy| {
            for (n, hdu) in from.hdus().iter().enumerate() {
                let own = amended
                    .iter_mut()
                    .find(|one| one.as_ref().is_some_and(|one| one.hdu == n));
                match own.and_then(Option::take) {
                    None => from.copy(hdu, copy)?,
                    Some(Amended { mut table, .. }) => {
                        table.history(lines)?;
                        table.finish(copy)?;
                    }
                }
            }
            if let Some(mut table) = new {
                table.history(lines)?;
                table.finish(copy)?;
            }
            Ok(from.copy_rest(copy)?)
        })
    }

    /// Writes the image under a temporary name.
    fn image(
        &mut self,
        picture: Picture<'_>,
        otherwise: Option<&Good>,
        lines: &[String],
    ) -> Result<NamedTempFile, EventsError> {
        let request = picture.request();
        let path = &request.path;
        let lines = lines.iter().cloned();
        let lines = lines.chain(request.energies.iter().map(ToString::to_string));
        let lines: Vec<String> = lines.collect();
        let finished = picture.finish(&self.history, otherwise, self.observed_cards(), &lines);
        let (bytes, imaged) = finished.map_err(|problem| problem.in_file(path))?;
        self.placed.image = Some(imaged);
        written(path, |file| {
            let put = file.write_all(&bytes);
            Ok(put.map_err(|cause| columns::refused(path, cause))?)
        })
    }

    /// Cards of the list with observer and instrument.
    fn observed_cards(&self) -> Vec<Card> {
        let headers = [&self.list.hdu().header, &self.list.primary().header];
        let keywords = [&keyword::TELESCOP, &keyword::INSTRUME, &keyword::OBJECT];
        let card = |keyword: &'static keyword::Keyword| {
            let texts = headers
                .iter()
                .filter_map(|header| header.text(keyword.name).ok()?);
            texts.map(|text| Card::new(keyword, text)).next()
        };
        keywords.into_iter().filter_map(card).collect()
    }
}
