//! The report: one page for people, made from the rows.

use super::columns::SmoothedRow;
use super::flight::Flight;
use super::output::{OutputError, Summary, SwingSummary, whole};
use super::row::Row;
use crate::archive::ArchiveReader;
use crate::estimation::median;
use crate::instrument::Instrument;
use crate::report::html::Page;
use crate::report::plot::{self, Labels, PlotError, Series};
use crate::with_view;
use image::{GrayImage, Luma};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

/// Pictures of a reason.
pub(super) const PICTURES: usize = 3;
/// Pixels of the frame that make one of a picture.
const SHRUNK: usize = 8;

/// The page of a refinement: a part for each camera.
#[derive(Default)]
pub struct Report {
    pub(super) page: Page,
    instruments: Vec<String>,
}

impl Report {
    /// Adds a camera's part; of several, `label` begins its headings.
    pub fn add(
        &mut self,
        label: Option<&str>,
        archive: &ArchiveReader,
        flight: &Flight,
        summary: &Summary,
        instrument: &Instrument,
    ) {
        self.instruments
            .push(label.unwrap_or(&summary.instrument).into());
        let mut part = Part {
            page: &mut self.page,
            label: label.map_or(String::new(), |label| format!("{label}: ")),
            source: source(archive),
            rows: &flight.rows,
            arcsec_per_mil: instrument.optics.arcsec_per_mil(),
        };
        part.summary(summary);
        part.path(&flight.smoothed_rows());
        part.budget();
        part.in_flight();
        part.radius(summary);
        part.mapping(summary);
        part.refusals(archive);
        part.pointing();
        part.jitter();
    }

    /// What others add to.
    pub fn page(&mut self) -> &mut Page {
        &mut self.page
    }

    /// Says what is not in it.
    pub fn note(&mut self, text: &str) {
        self.page.note(text);
    }

    /// Writes `report.html` to a folder.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn write(self, folder: &Path) -> Result<(), OutputError> {
        let title = format!("Aspect of {}", self.instruments.join(" and "));
        let text = self.page.finish(&title);
        whole(&folder.join("report.html"), |file| {
            file.write_all(text.as_bytes())
        })
    }
}

/// One camera's part of the page.
pub(super) struct Part<'a> {
    pub page: &'a mut Page,
    /// What headings begin with.
    label: String,
    /// What captions of figures begin with.
    source: String,
    pub rows: &'a [Row],
    pub arcsec_per_mil: f64,
}

/// The archive that a figure is of: its folder's name, so that a report does not depend on where the archive lies.
pub(super) fn source(archive: &ArchiveReader) -> String {
    let name = archive
        .name()
        .file_name()
        .map(|name| name.display().to_string());
    name.map_or_else(String::new, |name| format!("Archive {name}."))
}

impl Part<'_> {
    pub(super) fn heading(&mut self, text: &str) {
        self.page.heading(&format!("{}{text}", self.label));
    }

    /// A figure, or a line that says why there is none.
    pub(super) fn figure(&mut self, figure: Result<String, PlotError>) {
        match figure {
            Ok(svg) => self.page.figure(&svg, &self.source),
            Err(error) => self.page.note(&error.to_string()),
        }
    }

    /// A value of the fine rows over time.
    pub(super) fn over_time(&self, value: impl Fn(&Row) -> Option<f64>) -> Vec<(f64, f64)> {
        let fine = self.rows.iter().filter(|row| row.is_fine());
        fine.filter_map(|row| Some((row.unix_s()?, value(row)?)))
            .collect()
    }

    fn dots(&self, name: &str, value: impl Fn(&Row) -> Option<f64>) -> Series {
        Series::dots(name, self.over_time(value))
    }

    /// The same without what is more than so many times the median, which would flatten the rest.
    fn usual(&self, name: &str, value: impl Fn(&Row) -> Option<f64>) -> Series {
        const MOST_MEDIANS: f64 = 5.0;
        let mut series = self.dots(name, value);
        let middle = median(series.points.iter().map(|(_, value)| value));
        let most = middle.unwrap_or(0.0) * MOST_MEDIANS;
        series.points.retain(|(_, value)| *value <= most);
        series
    }

    fn summary(&mut self, summary: &Summary) {
        if !self.label.is_empty() {
            self.heading("summary");
        }
        let mut rows: Vec<Vec<String>> = [
            ("files", summary.files.to_string()),
            (
                "fine",
                format!("{} ({} by themselves)", summary.fine, summary.own_fine),
            ),
            ("coarse", summary.coarse.to_string()),
            ("none", summary.none.to_string()),
            ("from", summary.first_utc.clone().unwrap_or_default()),
            ("to", summary.last_utc.clone().unwrap_or_default()),
            ("program", summary.program.into()),
            (
                "instrument",
                format!("{}, {}", summary.instrument, summary.instrument_hash),
            ),
            ("settings", summary.settings_hash.clone()),
            ("table", summary.table_hash.clone()),
        ]
        .map(|(name, value)| vec![name.to_owned(), value])
        .into();
        for jump in summary.mapping.iter().flat_map(|mapping| &mapping.jumps) {
            rows.push(vec!["jump of the mapping".into(), jump.text()]);
        }
        let inputs = summary.inputs.lines().into_iter();
        rows.extend(inputs.map(|line| vec!["input".into(), line]));
        rows.extend(summary.clock.lines().map(Vec::from));
        for (axis, swings) in ["x", "y"].into_iter().zip(&summary.swings) {
            rows.push(vec![
                format!("swings along {axis}"),
                SwingSummary::text(swings),
            ]);
        }
        self.page.table(&[], &rows);
        self.page.note("All times are UTC at mid-exposure.");
    }

    fn path(&mut self, smoothed: &[SmoothedRow]) {
        self.heading("The Sun on the plate");
        let dots = [("x", 0), ("y", 1)]
            .map(|(name, axis)| self.dots(name, |row| Some(row.sun?.position.vector()[axis])));
        let lines = [("x, smoothed", 0), ("y, smoothed", 1)].map(|(name, axis)| {
            // Where nothing is known there is no number, and the line stops.
            let value = move |row: &SmoothedRow| row.point.map_or(f64::NAN, |p| p[0][axis]);
            Series::line(name, smoothed.iter().map(|row| (row.unix_s, value(row)))).in_hue(axis)
        });
        let labels = Labels::over_utc("The Sun's centre on the plate", "mil");
        self.figure(plot::series(&labels, &[dots, lines].concat()));
    }

    fn budget(&mut self) {
        self.heading("Error budget");
        let scale = self.arcsec_per_mil;
        let per_axis = |trace: f64| (trace.max(0.0) / 2.0).sqrt() * scale;
        let limb = |row: &Row| Some(per_axis(row.disc?.centre.covariance.trace()));
        let all = |row: &Row| Some(per_axis(row.sun?.covariance.trace()));
        let mapping = |row: &Row| {
            let trace = row.sun?.covariance.trace() - row.disc?.centre.covariance.trace();
            Some(per_axis(trace))
        };
        let own = |row: &Row| {
            let [x, y] = row.own.sigma_mil?;
            Some(per_axis(x * x + y * y))
        };
        let calibration = |row: &Row| Some(row.sky?.sigma_deg?[1] * 3600.0);
        let line = |name: &str, points: Vec<(f64, f64)>| {
            let value = median(points.iter().map(|(_, value)| value));
            let value = value.map_or("not known".into(), |value| format!("{value:.4}"));
            vec![name.to_owned(), value]
        };
        let rows = [
            line("limb", self.over_time(limb)),
            line("mapping", self.over_time(mapping)),
            line("both: the refined place", self.over_time(all)),
            line("the frame by itself", self.over_time(own)),
            line(
                "calibration, alike in all frames, not in the above",
                self.over_time(calibration),
            ),
        ];
        self.page
            .table(&["part", "1 sigma per axis, arcsec, median"], &rows);
        let series = [
            self.usual("refined", all),
            self.usual("of the mapping", mapping),
        ];
        let title = "Stated uncertainty, up to five times the median";
        let labels = Labels::over_utc(title, "1 sigma per axis, arcsec");
        self.figure(plot::series(&labels, &series));
    }

    fn in_flight(&mut self) {
        self.heading("In flight against refined");
        let scale = self.arcsec_per_mil;
        let difference = |axis: usize| {
            move |row: &Row| {
                let refined = row.sun?.position.vector()[axis];
                Some((row.in_flight.sun_mil?[axis] - refined) * scale)
            }
        };
        let series = [self.dots("x", difference(0)), self.dots("y", difference(1))];
        if series[0].points.is_empty() {
            return self
                .page
                .note("The headers hold no answers from the flight.");
        }
        let labels = Labels::over_utc("In flight minus refined", "arcsec");
        self.figure(plot::series(&labels, &series));
    }

    fn radius(&mut self, summary: &Summary) {
        self.heading("Radius against ephemeris");
        let ratio = |row: &Row| Some(row.disc?.radius_mil.value / row.expected_radius_mil?);
        let series = [self.dots("seen over expected", ratio)];
        let labels = Labels::over_utc("The disc's radius", "seen / expected");
        self.figure(plot::series(&labels, &series));
        let text = &summary.radius_by_temperature.text;
        self.page
            .note(&format!("With the camera's temperature: {text}."));
    }

    fn refusals(&mut self, archive: &ArchiveReader) {
        self.heading("What is not fine, or odd");
        let mut reasons: BTreeMap<String, Vec<&Row>> = BTreeMap::new();
        for row in self.rows.iter().filter(|row| row.copy_of.is_none()) {
            reasons.entry(row.reason()).or_default().push(row);
        }
        reasons.remove("");
        if reasons.is_empty() {
            return self.page.note("Every frame is fine, and none is odd.");
        }
        let count = |(reason, rows): (&String, &Vec<&Row>)| {
            let qualities = ["fine", "coarse", "none"].map(|quality| {
                rows.iter()
                    .filter(|row| row.quality.name() == quality)
                    .count()
                    .to_string()
            });
            [vec![reason.clone()], qualities.to_vec()].concat()
        };
        let counts: Vec<Vec<String>> = reasons.iter().map(count).collect();
        self.page
            .table(&["reason", "fine", "coarse", "none"], &counts);
        for (reason, rows) in &reasons {
            for row in rows.iter().take(PICTURES) {
                if let Some(picture) = thumbnail(archive, &row.file) {
                    let caption = format!("{}: {reason}", row.file);
                    self.page.picture(&picture, &caption);
                }
            }
        }
    }

    /// Offsets across and in elevation, arcsec, of fine rows.
    pub(super) fn offsets(&self) -> Vec<(f64, [f64; 2])> {
        let fine = self.rows.iter().filter(|row| row.is_fine());
        let offset = |row: &Row| {
            let [_, elevation, across] = row.sky?.offset_deg?;
            Some((row.unix_s()?, [across * 3600.0, elevation * 3600.0]))
        };
        fine.filter_map(offset).collect()
    }

    fn pointing(&mut self) {
        self.heading("Pointing");
        let offsets = self.offsets();
        if offsets.is_empty() {
            return self
                .page
                .note("No place is known, so there are no offsets.");
        }
        let within = |limit: f64, inside: fn(&[f64; 2], f64) -> bool| {
            let count = offsets
                .iter()
                .filter(|(_, offset)| inside(offset, limit))
                .count();
            format!("{:.1} %", 100.0 * count as f64 / offsets.len() as f64)
        };
        let row = |limit: f64| {
            vec![
                format!("{limit} arcsec"),
                within(limit, |offset, limit| offset[1].abs() <= limit),
                within(limit, |offset, limit| offset[0].abs() <= limit),
                within(limit, |offset, limit| offset[0].hypot(offset[1]) <= limit),
            ]
        };
        let heads = ["within", "in elevation", "across", "of the target"];
        self.page.table(&heads, &[10.0, 30.0, 60.0].map(row));
        self.page.note("Part of the fine frames.");
        let series = [("across", 0), ("elevation", 1)].map(|(name, axis)| {
            Series::dots(name, offsets.iter().map(|(t, offset)| (*t, offset[axis])))
        });
        let labels = Labels::over_utc("Offset from the target", "arcsec");
        self.figure(plot::series(&labels, &series));
    }
}

/// A frame, small and stretched to its brightest pixel; none where it cannot be read.
fn thumbnail(archive: &ArchiveReader, file: &str) -> Option<GrayImage> {
    let frame = archive.open_file(file).ok()?.frame().ok()?;
    let (width, height) = (frame.width() / SHRUNK, frame.height() / SHRUNK);
    let mean = |x: usize, y: usize| {
        with_view!(&frame, view => {
            let block = (0..SHRUNK * SHRUNK).map(|n| view.dn(x * SHRUNK + n % SHRUNK, y * SHRUNK + n / SHRUNK));
            block.sum::<f32>() / (SHRUNK * SHRUNK) as f32
        })
    };
    let means: Vec<f32> = (0..width * height)
        .map(|n| mean(n % width, n / width))
        .collect();
    let brightest = means.iter().copied().fold(1.0, f32::max);
    let grey = |x: u32, y: u32| (255.0 * means[y as usize * width + x as usize] / brightest) as u8;
    Some(GrayImage::from_fn(width as u32, height as u32, |x, y| {
        Luma([grey(x, y)])
    }))
}
