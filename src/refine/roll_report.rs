//! The roll camera's section of the report.

use super::record::Grade;
use super::report::{Reasons, Report, source};
use super::roll::{RollRecipe, RollRow, kind};
use super::roll_output::RollSummary;
use crate::archive::ArchiveReader;
use crate::horizon;
use crate::report::plot::{self, Labels, Mark, Series};
use image::RgbImage;
use image::imageops::thumbnail;

/// Greatest width of pictures.
const WIDTH_PX: u32 = 480;

/// The report's data of the roll camera's rows.
#[derive(Default)]
pub struct RollRows {
    drawn: Vec<Drawn>,
    flagged: Reasons,
}

/// Roll and pitch at a frame, deg.
struct Drawn {
    unix_s: f64,
    own: Option<[f32; 2]>,
    smoothed: Option<[f32; 2]>,
    roll_in_flight: Option<f32>,
}

impl RollRows {
    /// Takes a row, in the order of time.
    pub fn take(&mut self, row: &RollRow) {
        let smoothed = row.smoothed.map(|s| [s.roll_deg, s.pitch_deg]);
        self.drawn.extend(row.unix_s().map(|unix_s| {
            Drawn {
                unix_s,
                own: row
                    .angles_deg()
                    .map(|angles| angles.map(|a| a.value as f32)),
                smoothed: smoothed.map(|angles| angles.map(|a| a.value as f32)),
                roll_in_flight: row.in_flight_deg().map(|[roll, _]| roll as f32),
            }
        }));
        if row.quality != Grade::Fine && row.copy_of.is_none() {
            self.flagged
                .add(kind(&row.remark()), row.quality, &row.file);
        }
    }
}

impl Report {
    /// Adds the roll camera's section.
    pub fn add_roll(
        &mut self,
        archive: &ArchiveReader,
        rows: &RollRows,
        summary: &RollSummary,
        recipe: &RollRecipe,
    ) {
        self.page.heading("Roll and pitch of the body");
        let sigma = |sigma_deg: Option<f64>| {
            sigma_deg.map_or("not known".into(), |sigma_deg| {
                format!("{sigma_deg:.4} deg")
            })
        };
        let numbers = [
            (
                "frames of the roll camera",
                summary.counts.files.to_string(),
            ),
            ("fine", summary.counts.fine.to_string()),
            ("coarse", summary.counts.coarse.to_string()),
            ("none", summary.counts.none.to_string()),
            (
                "1 sigma of a frame's roll, median",
                sigma(summary.frame_sigma_deg),
            ),
            ("1 sigma, smoothed", sigma(summary.smoothed_sigma_deg)),
        ];
        let mut lines = numbers
            .map(|(name, value)| vec![name.to_owned(), value])
            .to_vec();
        let inputs = summary.inputs.lines().into_iter();
        lines.extend(inputs.map(|line| vec!["input".into(), line]));
        self.page.table(&[], &lines);
        self.figures(archive, &rows.drawn);
        self.flagged_frames(archive, &rows.flagged, recipe);
    }

    fn figures(&mut self, archive: &ArchiveReader, rows: &[Drawn]) {
        let series = |name: &str, mark, value: &dyn Fn(&Drawn) -> Option<f32>| {
            let points = rows
                .iter()
                .filter_map(|row| Some((row.unix_s, value(row)?.into())));
            Series::new(name, mark, points)
        };
        let own = |axis: usize| move |row: &Drawn| Some(row.own?[axis]);
        let smoothed = |axis: usize| move |row: &Drawn| Some(row.smoothed?[axis]);
        let angles = [
            series("roll", Mark::Dots, &own(0)),
            series("pitch", Mark::Dots, &own(1)),
            series("roll, smoothed", Mark::Line, &smoothed(0)).in_hue(0),
            series("pitch, smoothed", Mark::Line, &smoothed(1)).in_hue(1),
        ];
        let in_flight = |row: &Drawn| Some(row.roll_in_flight? - row.smoothed?[0]);
        let by_itself = |row: &Drawn| Some(row.own?[0] - row.smoothed?[0]);
        let differences = [
            series("frame by itself", Mark::Dots, &by_itself),
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

    /// Adds the number of frames that are not fine, by reason, and pictures of some with the horizon that was found.
    fn flagged_frames(&mut self, archive: &ArchiveReader, flagged: &Reasons, recipe: &RollRecipe) {
        if flagged.is_empty() {
            return;
        }
        let count = |counts: [usize; 3]| counts.iter().sum::<usize>().to_string();
        let counts = flagged
            .iter()
            .map(|(name, flagged)| vec![name.to_owned(), count(flagged.counts)]);
        self.page
            .table(&["reason", "frames"], &counts.collect::<Vec<_>>());
        for (file, remark) in flagged.files() {
            if let Some(picture) = overlay(archive, file, recipe) {
                self.page.picture(&picture, &format!("{file}: {remark}"));
            }
        }
    }
}

/// A frame with the horizon that was found, reduced in size. `None` if it cannot be read.
fn overlay(archive: &ArchiveReader, file: &str, recipe: &RollRecipe) -> Option<RgbImage> {
    let frame = archive.open_file(file).ok()?.frame().ok()?;
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
