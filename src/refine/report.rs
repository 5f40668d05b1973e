//! The report: one page for people, made from the rows as they are written.

use super::history::History;
use super::output::{Summary, swings_text};
use super::record::Grade;
use super::row::RefinedRow;
use super::solar_path::SolarPath;
use crate::archive::ArchiveReader;
use crate::columns::whole;
use crate::estimation::median;
use crate::fits::FileError;
use crate::report::html::Page;
use crate::report::plot::{self, Labels, PlotError, Series};
use crate::smoothing::PathPoint;
use crate::with_view;
use image::{GrayImage, Luma};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

/// Number of pictures for each reason.
const PICTURES: usize = 3;
/// Pixels of the frame for each pixel of a picture, along an axis.
const SHRUNK: usize = 8;

/// The page of a refinement, with a section for each camera.
#[derive(Default)]
pub struct Report {
    pub(super) page: Page,
    instruments: Vec<String>,
}

/// The report's data of a fine row.
pub(super) struct Drawn {
    pub unix_s: f64,
    pub sun_mil: [f32; 2],
    pub sigma_mil: [f32; 2],
    /// 1 sigma per axis: contributions of the limb's points and of the mapping.
    parts_mil: Option<[f32; 2]>,
    own_sigma_mil: Option<f32>,
    calibration_arcsec: Option<f32>,
    /// Difference of the results, in flight minus refined.
    in_flight_mil: Option<[f32; 2]>,
    radius_ratio: Option<f32>,
    pub centre_px: Option<[f32; 2]>,
    pub temperature_c: Option<f32>,
    /// Number of jumps before it.
    pub jumps: u32,
    /// Offset across and in elevation.
    pub offset_arcsec: Option<[f32; 2]>,
}

impl Drawn {
    /// None if the row is not fine.
    fn of(row: &RefinedRow, jumps: u32) -> Option<Self> {
        let sun = row.sun.filter(|_| row.is_fine())?;
        let per_axis = |trace: f64| (trace.max(0.0) / 2.0).sqrt() as f32;
        let (own, sky) = (row.own.as_ref(), row.sky.as_ref());
        let own_disc = own.and_then(|own| own.disc.as_ref());
        let in_flight = own.and_then(|own| own.in_flight.sun_mil);
        Some(Self {
            unix_s: row.unix_s()?,
            sun_mil: [sun.position.x, sun.position.y].map(|mil| mil as f32),
            sigma_mil: sun.sigma().map(|mil| mil as f32),
            parts_mil: row.disc.map(|disc| {
                let limb = disc.centre.covariance.trace();
                [limb, sun.covariance.trace() - limb].map(per_axis)
            }),
            own_sigma_mil: own_disc.map(|disc| per_axis(disc.on_plate().covariance.trace())),
            calibration_arcsec: sky.and_then(|sky| Some((sky.sigma_deg?[1] * 3600.0) as f32)),
            in_flight_mil: in_flight
                .map(|[x, y]| [x - sun.position.x, y - sun.position.y].map(|mil| mil as f32)),
            radius_ratio: row
                .disc
                .zip(row.expected_radius_mil)
                .map(|(disc, expected)| (disc.radius_mil.value / expected) as f32),
            centre_px: row.mapping.map(|m| m.centre_px.map(|px| px.value as f32)),
            temperature_c: own.and_then(|own| Some(own.facts.temperature_c? as f32)),
            jumps,
            offset_arcsec: sky.and_then(|sky| {
                let [_, elevation, across] = sky.offset_deg?;
                Some([across, elevation].map(|deg| (deg * 3600.0) as f32))
            }),
        })
    }
}

/// The report's data of a camera's rows.
#[derive(Default)]
pub struct Rows {
    pub(super) fine: Vec<Drawn>,
    reasons: Reasons,
    jumps: u32,
}

/// Reasons for which rows are not fine, or flagged.
#[derive(Default)]
pub(super) struct Reasons(BTreeMap<String, Reason>);

#[derive(Default)]
pub(super) struct Reason {
    /// Number of rows by quality: fine, coarse, none.
    pub counts: [usize; 3],
    /// The first of the files.
    pub files: Vec<String>,
}

impl Reasons {
    /// Counts a row's reason, if there is one.
    pub fn add(&mut self, reason: String, quality: Grade, file: &str) {
        if reason.is_empty() {
            return;
        }
        let reason = self.0.entry(reason).or_default();
        let grades = [Grade::Fine, Grade::Coarse, Grade::None];
        let counts = reason.counts.iter_mut().zip(grades);
        counts.for_each(|(count, grade)| *count += usize::from(quality == grade));
        if reason.files.len() < PICTURES {
            reason.files.push(file.into());
        }
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// In alphabetical order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Reason)> {
        self.0.iter().map(|(name, reason)| (name.as_str(), reason))
    }

    /// The first files of each reason, each with the reason.
    pub fn files(&self) -> impl Iterator<Item = (&str, &str)> {
        self.iter()
            .flat_map(|(name, reason)| reason.files.iter().map(move |file| (file.as_str(), name)))
    }
}

impl Rows {
    /// Takes a row, in the order of time.
    pub fn take(&mut self, row: &RefinedRow) {
        self.jumps += u32::from(row.jump_px.is_some());
        self.fine.extend(Drawn::of(row, self.jumps));
        if row.copy_of.is_none() {
            self.reasons.add(row.reason(), row.quality, &row.file);
        }
    }
}

impl Report {
    /// Adds a camera's section; if there are several, `label` begins its headings.
    pub fn add(
        &mut self,
        label: Option<&str>,
        archive: &ArchiveReader,
        history: &History,
        summary: &Summary,
        rows: &Rows,
        solar_path: &SolarPath,
    ) {
        self.instruments
            .push(label.unwrap_or(&summary.instrument).into());
        let mut part = Part {
            page: &mut self.page,
            label: label.map_or(String::new(), |label| format!("{label}: ")),
            source: source(archive),
            rows: &rows.fine,
            arcsec_per_mil: history.instrument().optics.arcsec_per_mil(),
        };
        part.summary(summary);
        part.pointing(summary, solar_path);
        part.path(history);
        part.budget();
        part.in_flight();
        part.radius(summary);
        part.mapping(summary);
        part.refusals(archive, &rows.reasons);
        part.cameras_against_gyros(summary);
        part.jitter();
    }

    /// Appends another page.
    pub fn append(&mut self, page: Page) {
        self.page.append(page);
    }

    /// Adds a note, for example on what is missing.
    pub fn note(&mut self, text: &str) {
        self.page.note(text);
    }

    /// Writes `report.html` to a folder.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(self, folder: &Path) -> Result<(), FileError> {
        let title = format!("Aspect of {}", self.instruments.join(" and "));
        let text = self.page.finish(&title);
        whole(&folder.join("report.html"), |file| {
            file.write_all(text.as_bytes())
        })
    }
}

/// One camera's section of the page.
pub(super) struct Part<'a> {
    pub page: &'a mut Page,
    /// Beginning of headings.
    label: String,
    /// Beginning of figures' captions.
    source: String,
    /// The fine rows.
    pub rows: &'a [Drawn],
    pub arcsec_per_mil: f64,
}

/// Source of a figure: the archive's folder name, so that a report does not depend on the archive's location.
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

    /// Adds a figure, or a line with the reason why there is none.
    pub(super) fn figure(&mut self, figure: Result<String, PlotError>) {
        self.figure_with(figure, "");
    }

    /// The same with explanatory text.
    pub(super) fn figure_with(&mut self, figure: Result<String, PlotError>, text: &str) {
        match figure {
            Ok(svg) => {
                let caption = format!("{text} {}", self.source);
                self.page.figure(&svg, caption.trim_start());
            }
            Err(error) => self.page.note(&error.to_string()),
        }
    }

    /// A value of the fine rows over time.
    pub(super) fn over_time<V: Into<f64>>(
        &self,
        value: impl Fn(&Drawn) -> Option<V>,
    ) -> Vec<(f64, f64)> {
        let rows = self.rows.iter();
        rows.filter_map(|row| Some((row.unix_s, value(row)?.into())))
            .collect()
    }

    fn dots<V: Into<f64>>(&self, name: &str, value: impl Fn(&Drawn) -> Option<V>) -> Series {
        Series::dots(name, self.over_time(value))
    }

    fn summary(&mut self, summary: &Summary) {
        if !self.label.is_empty() {
            self.heading("summary");
        }
        let counts = &summary.counts;
        let mut rows: Vec<[String; 2]> = [
            ("files", counts.files.to_string()),
            (
                "fine",
                format!("{} ({} when solved alone)", counts.fine, summary.own_fine),
            ),
            ("coarse", counts.coarse.to_string()),
            ("none", counts.none.to_string()),
            ("from", counts.first_utc.clone().unwrap_or_default()),
            ("to", counts.last_utc.clone().unwrap_or_default()),
            ("program", summary.program.into()),
            (
                "instrument",
                format!("{}, {}", summary.instrument, summary.instrument_hash),
            ),
            ("settings", summary.settings_hash.clone()),
            ("table", summary.table_sha256.clone()),
        ]
        .map(|(name, value)| [name.to_owned(), value])
        .into();
        let jumps = summary.mapping.iter().flat_map(|mapping| &mapping.jumps);
        rows.extend(jumps.map(|jump| ["jump of the mapping".into(), jump.text()]));
        let inputs = summary.inputs.lines().into_iter();
        rows.extend(inputs.map(|line| ["input".into(), line]));
        rows.extend(summary.clock.lines());
        let swings = ["x", "y"].into_iter().zip(&summary.swings_mil);
        rows.extend(
            swings.map(|(axis, swings)| [format!("swings along {axis}"), swings_text(swings)]),
        );
        let rows: Vec<Vec<String>> = rows.into_iter().map(Vec::from).collect();
        self.page.table(&[], &rows);
        self.page.note("All times are UTC at mid-exposure.");
    }

    fn path(&mut self, history: &History) {
        self.heading("The Sun on the plate");
        let dots = |name, axis: usize| self.dots(name, |row| Some(row.sun_mil[axis]));
        let line = |name, axis: usize| {
            // The line has a gap where nothing is known.
            let value = |(unix_s, point): (f64, Option<&PathPoint>)| {
                (unix_s, point.map_or(f64::NAN, |point| point.place[axis]))
            };
            Series::line(name, history.smoothed().map(value)).in_hue(axis)
        };
        let series = [
            dots("x", 0),
            dots("y", 1),
            line("x, smoothed", 0),
            line("y, smoothed", 1),
        ];
        let labels = Labels::over_utc("The Sun's centre on the plate", "mil");
        self.figure(plot::series(&labels, &series));
    }

    fn budget(&mut self) {
        self.heading("Error budget");
        let scale = self.arcsec_per_mil;
        let arcsec = |mil: f32| f64::from(mil) * scale;
        let all = |row: &Drawn| {
            let [x, y] = row.sigma_mil;
            Some(arcsec(x.hypot(y)) / 2_f64.sqrt())
        };
        let part = |n: usize| move |row: &Drawn| Some(arcsec(row.parts_mil?[n]));
        let own = |row: &Drawn| row.own_sigma_mil.map(arcsec);
        let line = |name: &str, points: Vec<(f64, f64)>| {
            let value = median(points.iter().map(|(_, value)| value));
            let value = value.map_or("not known".into(), |value| format!("{value:.4}"));
            vec![name.to_owned(), value]
        };
        let calibration = "calibration, common to all frames, not included above";
        let rows = [
            line("limb", self.over_time(part(0))),
            line("mapping", self.over_time(part(1))),
            line("both: the refined place", self.over_time(all)),
            line("the frame by itself", self.over_time(own)),
            line(calibration, self.over_time(|row| row.calibration_arcsec)),
        ];
        self.page
            .table(&["part", "1 sigma per axis, arcsec, median"], &rows);
        let series = [
            self.dots("refined", all).up_to_five_medians(),
            self.dots("of the mapping", part(1)).up_to_five_medians(),
        ];
        let title = "Stated uncertainty, up to five times the median";
        let labels = Labels::over_utc(title, "1 sigma per axis, arcsec");
        self.figure(plot::series(&labels, &series));
    }

    fn in_flight(&mut self) {
        self.heading("In flight against refined");
        let scale = self.arcsec_per_mil;
        let difference =
            |axis: usize| move |row: &Drawn| Some(f64::from(row.in_flight_mil?[axis]) * scale);
        let series = [self.dots("x", difference(0)), self.dots("y", difference(1))];
        if series[0].points.is_empty() {
            return self.page.note("The headers hold no in-flight solutions.");
        }
        let labels = Labels::over_utc("In flight minus refined", "arcsec");
        self.figure(plot::series(&labels, &series));
    }

    fn radius(&mut self, summary: &Summary) {
        self.heading("Radius against ephemeris");
        let series = [self.dots("seen over expected", |row| row.radius_ratio)];
        let labels = Labels::over_utc("The disc's radius", "seen / expected");
        self.figure(plot::series(&labels, &series));
        let text = summary.radius_by_temperature.text();
        self.page
            .note(&format!("With the camera's temperature: {text}."));
    }

    fn refusals(&mut self, archive: &ArchiveReader, reasons: &Reasons) {
        self.heading("Frames not fine, or flagged");
        if reasons.is_empty() {
            return self.page.note("Every frame is fine, and none is flagged.");
        }
        let count = |(name, reason): (&str, &Reason)| {
            let counts = reason.counts.iter().map(usize::to_string);
            [name.to_owned()].into_iter().chain(counts).collect()
        };
        let counts: Vec<Vec<String>> = reasons.iter().map(count).collect();
        self.page
            .table(&["reason", "fine", "coarse", "none"], &counts);
        for (file, name) in reasons.files() {
            if let Some(picture) = thumbnail(archive, file) {
                self.page.picture(&picture, &format!("{file}: {name}"));
            }
        }
    }

    fn cameras_against_gyros(&mut self, summary: &Summary) {
        if let Some(compared) = &summary.pointing.cameras_against_gyros {
            self.heading("Gyros against Sun and horizon");
            let (heads, rows) = compared.table();
            self.page.table(&heads, &rows);
            let findings = compared.findings.iter();
            findings.for_each(|finding| self.page.note(&finding.to_string()));
            self.figure(compared.figure());
        }
    }
}

/// A frame, reduced and scaled to its brightest pixel; none if it cannot be read.
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
