//! Results of the program: its parts, unmet requirements, the figures.

use super::figures::{self, Sweeps};
use super::horizon::HorizonReport;
use super::marks::{BiasMap, MarkSummary};
use super::mixed::MixedSummary;
use super::moon::MoonReport;
use super::outcome::Summary;
use super::rows::{AccuracyRow, HORIZON, MARKS, MARKS_ROW, MOON, Run, Size};
use super::trial::Outcome;
use crate::columns::{Column, float, integer, text};
use crate::report::plot::PlotError;

/// Result of a row.
#[derive(Debug, Clone)]
pub struct RowReport {
    pub row: AccuracyRow,
    pub outcomes: Vec<Outcome>,
    pub summary: Summary,
    /// Why the row's requirements are not met.
    pub unmet: Vec<String>,
}

/// Result of the marks.
#[derive(Debug, Clone)]
pub struct MarksReport {
    pub summary: Option<MarkSummary>,
    pub bias: BiasMap,
    pub unmet: Vec<String>,
}

/// Result of a run.
#[derive(Debug, Clone)]
pub struct RunReport {
    pub run: Run,
    pub outcomes: Vec<Outcome>,
    pub summary: MixedSummary,
    pub unmet: Option<String>,
}

/// A frame of a row or of a run.
pub type ReportedFrame<'a> = (&'static str, &'a Outcome);

fn plate_error<const AXIS: usize>((_, outcome): &ReportedFrame<'_>) -> Option<f64> {
    Some(outcome.aspect?.plate_mil[AXIS])
}

fn plate_sigma<const AXIS: usize>((_, outcome): &ReportedFrame<'_>) -> Option<f64> {
    Some(outcome.aspect?.covariance_mil2[(AXIS, AXIS)].sqrt())
}

/// Columns of a table of single frames.
pub fn frame_columns<'a>() -> [Column<ReportedFrame<'a>>; 7] {
    let of_axis = |name, meaning, value| float(name, "mil", meaning, value);
    [
        text("part", "row or run", |(part, _)| (*part).into()),
        integer("seed", "draws the frame", |(_, o)| {
            i64::try_from(o.seed).ok()
        }),
        text("quality", "of the solution", |(_, o)| {
            o.quality.name().into()
        }),
        of_axis(
            "x_error",
            "the Sun's centre, found less true",
            plate_error::<0>,
        ),
        of_axis(
            "y_error",
            "the Sun's centre, found less true",
            plate_error::<1>,
        ),
        of_axis(
            "x_sigma",
            "1 sigma as the solution states it",
            plate_sigma::<0>,
        ),
        of_axis(
            "y_sigma",
            "1 sigma as the solution states it",
            plate_sigma::<1>,
        ),
    ]
}

/// All results.
#[derive(Debug, Clone)]
pub struct Report {
    pub size: Size,
    pub rows: Vec<RowReport>,
    /// The rows about other plates, lenses and cameras.
    pub plates: Vec<RowReport>,
    /// The rows about designed plates and the check of plates.
    pub designs: Vec<RowReport>,
    pub marks: Option<MarksReport>,
    pub runs: Vec<RunReport>,
    pub moons: Vec<MoonReport>,
    pub horizons: Vec<HorizonReport>,
    /// Data of the figures in addition to the rows.
    pub sweeps: Option<Sweeps>,
}

impl Report {
    /// All unmet requirements: where, and why.
    pub fn unmet(&self) -> Vec<(&'static str, &str)> {
        let rows = self.rows.iter().chain(&self.plates).chain(&self.designs);
        let rows = rows.map(|r| (r.row.name, &r.unmet));
        let rows = rows.flat_map(|(name, unmet)| unmet.iter().map(move |u| (name, u.as_str())));
        let marks = self.marks.iter().flat_map(|m| &m.unmet);
        let runs = self.runs.iter();
        let runs = runs.filter_map(|r| Some((r.run.name, r.unmet.as_deref()?)));
        let moons = self.moons.iter().flat_map(|moon| &moon.unmet);
        let horizons = self.horizons.iter().flat_map(|horizon| &horizon.unmet);
        rows.chain(marks.map(|u| (MARKS, u.as_str())))
            .chain(runs)
            .chain(moons.map(|u| (MOON, u.as_str())))
            .chain(horizons.map(|u| (HORIZON, u.as_str())))
            .collect()
    }

    /// Every frame of the rows and runs.
    pub fn frames(&self) -> impl Iterator<Item = ReportedFrame<'_>> {
        let rows = self.rows.iter().chain(&self.plates).chain(&self.designs);
        let rows = rows.flat_map(|r| r.outcomes.iter().map(|o| (r.row.name, o)));
        let runs = self.runs.iter();
        rows.chain(runs.flat_map(|r| r.outcomes.iter().map(|o| (r.run.name, o))))
    }

    /// All figures that the measurements allow: file name and SVG.
    pub fn figures(&self) -> Result<Vec<(&'static str, String)>, PlotError> {
        let mut figures = Vec::new();
        if let Some(sweeps) = &self.sweeps {
            figures.push(("error-noise.svg", figures::noise_figure(sweeps)?));
            figures.push(("error-limb.svg", figures::limb_figure(sweeps)?));
        }
        for report in self.rows.iter().filter(|r| r.row.name == MARKS_ROW) {
            let svg = figures::histogram(&report.outcomes, report.row.title)?;
            figures.push(("error-histogram.svg", svg));
        }
        if let Some(marks) = &self.marks {
            figures.push(("mark-bias.svg", figures::bias_figure(&marks.bias)?));
        }
        Ok(figures)
    }
}
