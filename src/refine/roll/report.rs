//! The roll camera's part of the report.

use super::super::record::Grade;
use super::super::report::{PICTURES, Report, source};
use super::output::kind;
use super::{RollHistory, RollRecipe, RollRow, RollSummary};
use crate::archive::ArchiveReader;
use crate::horizon;
use crate::report::plot::{self, Labels, Mark, Series};
use image::RgbImage;
use image::imageops::thumbnail;
use std::collections::BTreeMap;

/// Pictures are so wide at most.
const WIDTH_PX: u32 = 480;

impl Report {
    /// Adds the roll camera's part.
    pub fn add_roll(
        &mut self,
        archive: &ArchiveReader,
        history: &RollHistory,
        summary: &RollSummary,
        recipe: &RollRecipe,
    ) {
        self.page.heading("Roll and pitch of the body");
        let sigma = |sigma_deg: Option<f64>| {
            sigma_deg.map_or("not known".into(), |sigma_deg| {
                format!("{sigma_deg:.4} deg")
            })
        };
        let rows = [
            ("frames of the roll camera", summary.files.to_string()),
            ("fine", summary.fine.to_string()),
            ("coarse", summary.coarse.to_string()),
            ("none", summary.none.to_string()),
            (
                "1 sigma of a frame's roll, median",
                sigma(summary.frame_sigma_deg),
            ),
            ("1 sigma, smoothed", sigma(summary.smoothed_sigma_deg)),
        ];
        let mut rows = rows
            .map(|(name, value)| vec![name.to_owned(), value])
            .to_vec();
        let inputs = summary.inputs.lines().into_iter();
        rows.extend(inputs.map(|line| vec!["input".into(), line]));
        self.page.table(&[], &rows);
        self.figures(archive, history);
        self.odd_frames(archive, history, recipe);
    }

    fn figures(&mut self, archive: &ArchiveReader, history: &RollHistory) {
        let series = |name: &str, mark, value: &dyn Fn(&RollRow) -> Option<f64>| {
            let rows = history.rows.iter();
            let points = rows.filter_map(|row| Some((row.unix_s()?, value(row)?)));
            Series::new(name, mark, points)
        };
        let own = |axis: usize| move |row: &RollRow| Some(row.angles_deg()?[axis].value);
        let roll = |row: &RollRow| Some(row.smoothed?.roll_deg.value);
        let pitch = |row: &RollRow| Some(row.smoothed?.pitch_deg.value);
        let angles = [
            series("roll", Mark::Dots, &own(0)),
            series("pitch", Mark::Dots, &own(1)),
            series("roll, smoothed", Mark::Line, &roll).in_hue(0),
            series("pitch, smoothed", Mark::Line, &pitch).in_hue(1),
        ];
        let in_flight = |row: &RollRow| Some(row.in_flight_deg?[0] - row.smoothed?.roll_deg.value);
        let alone = |row: &RollRow| Some(row.angles_deg()?[0].value - row.smoothed?.roll_deg.value);
        let differences = [
            series("frame by itself", Mark::Dots, &alone),
            series("in flight", Mark::Dots, &in_flight),
        ];
        let titles = ["Roll and pitch of the body", "Roll minus smoothed roll"];
        for (title, series) in titles.iter().zip([&angles[..], &differences[..]]) {
            match plot::series(&Labels::over_utc(*title, "deg"), series) {
                Ok(svg) => self.page.figure(&svg, &source(archive)),
                Err(error) => self.page.note(&error.to_string()),
            }
        }
    }

    /// How many frames are not fine, by what is odd about them, and pictures of some with what was taken for the horizon.
    fn odd_frames(&mut self, archive: &ArchiveReader, history: &RollHistory, recipe: &RollRecipe) {
        let mut odd: BTreeMap<String, Vec<&RollRow>> = BTreeMap::new();
        let is_odd = |row: &&RollRow| row.quality != Grade::Fine && row.copy_of.is_none();
        for row in history.rows.iter().filter(is_odd) {
            odd.entry(kind(&row.remark())).or_default().push(row);
        }
        if odd.is_empty() {
            return;
        }
        let counts: Vec<Vec<String>> = odd
            .iter()
            .map(|(remark, rows)| vec![remark.clone(), rows.len().to_string()])
            .collect();
        self.page.table(&["what is odd", "frames"], &counts);
        for (remark, rows) in &odd {
            for row in rows.iter().take(PICTURES) {
                if let Some(picture) = overlay(archive, row, recipe) {
                    let caption = format!("{}: {remark}", row.file);
                    self.page.picture(&picture, &caption);
                }
            }
        }
    }
}

/// A frame with what was taken for the horizon, made small. `None` where it cannot be read.
fn overlay(archive: &ArchiveReader, row: &RollRow, recipe: &RollRecipe) -> Option<RgbImage> {
    let frame = archive.open_file(&row.file).ok()?.frame().ok()?;
    let (solution, sphere) = recipe.solve_again(&frame)?;
    let picture = horizon::overlay(&frame, &solution, &recipe.camera.optics, &sphere, "");
    let (width, height) = picture.dimensions();
    let shrunk = WIDTH_PX.min(width);
    Some(thumbnail(
        &picture,
        shrunk,
        (height * shrunk / width).max(1),
    ))
}
