//! Series over linear axes or over time.

use super::axis::{Axis, extent};
use super::labels::{Horizontal, Labels, PlotError};
use super::sheet::{DOT_PX, Entry, Sheet, Stroke, Swatch, hue};
use super::thin::{Column, columns, distinct, runs};
use crate::estimation::median;
use std::ops::Range;

/// Style of a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    Dots,
    /// Points joined by a line that is interrupted at gaps.
    Line,
    /// Points joined throughout: a model, a fit, a function.
    Curve,
    /// The same, dashed: a limit.
    Limit,
}

/// A named series of points (x, y). A series without a name is not in the legend.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    pub name: String,
    pub points: Vec<(f64, f64)>,
    pub mark: Mark,
    /// Index of its colour; none: its index among the series.
    pub hue: Option<usize>,
}

impl Series {
    pub fn new(
        name: impl Into<String>,
        mark: Mark,
        points: impl IntoIterator<Item = (f64, f64)>,
    ) -> Self {
        Self {
            name: name.into(),
            points: points.into_iter().collect(),
            mark,
            hue: None,
        }
    }

    pub fn dots(name: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self::new(name, Mark::Dots, points)
    }

    pub fn line(name: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self::new(name, Mark::Line, points)
    }

    pub fn curve(name: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self::new(name, Mark::Curve, points)
    }

    pub fn limit(name: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self::new(name, Mark::Limit, points)
    }

    /// The same in the n-th colour.
    pub fn in_hue(self, n: usize) -> Self {
        Self {
            hue: Some(n),
            ..self
        }
    }

    /// Removes values above five times the median, which would compress the rest.
    pub fn up_to_five_medians(mut self) -> Self {
        let middle = median(self.points.iter().map(|(_, value)| value));
        let most = 5.0 * middle.unwrap_or(0.0);
        self.points.retain(|(_, value)| *value <= most);
        self
    }
}

/// Series with their labels, to be drawn by [`series`].
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    pub labels: Labels,
    pub series: Vec<Series>,
}

const SIZE: (f64, f64) = (1000.0, 380.0);
/// Size of a figure in a stack.
const PANEL: (f64, f64) = (1000.0, 230.0);
/// Size with a square panel and one row of legend.
const SQUARE: (f64, f64) = (620.0, 629.0);
/// More dots than this are drawn as the range in each column of pixels.
const MOST_DOTS: usize = 5000;

/// Series over linear axes or over time, with a line at y = 0 if that is within their range.
///
/// If a series has more points than the panel has columns of pixels (a line) or than can be distinguished (dots), each column shows
/// the least, the greatest and the median of its points: no spike is lost.
///
/// # Errors
/// If there is nothing to draw.
pub fn series(labels: &Labels, series: &[Series]) -> Result<String, PlotError> {
    let finite = |(x, y): &&(f64, f64)| x.is_finite() && y.is_finite();
    let points = || series.iter().flat_map(|s| &s.points).filter(finite);
    let of_x = extent(points().map(|p| p.0)).ok_or_else(|| labels.empty())?;
    let of_y = extent(points().map(|p| p.1)).ok_or_else(|| labels.empty())?;
    let x = match labels.x {
        Horizontal::Number(_) => Axis::linear(of_x),
        Horizontal::Utc => Axis::utc(of_x),
    };
    Ok(sheet(SIZE, labels, (x, Axis::linear(of_y)), series).finish())
}

/// Draws figures one below the other, over exactly one range of times (seconds since 1970-01-01, UTC). A figure without values is an empty
/// panel. The root element states the panels' edges: `data-left` and `data-right`, px.
pub fn stack(figures: &[Figure], (from, to): (f64, f64)) -> String {
    let x = Axis::exact_utc(from, to);
    let (mut body, mut height, mut edges_px) = (String::new(), 0.0, (0.0, 0.0));
    for figure in figures {
        let inside = |(x, y): &&(f64, f64)| (from..=to).contains(x) && y.is_finite();
        let points = figure.series.iter().flat_map(|s| &s.points).filter(inside);
        let of_y = extent(points.map(|p| p.1)).unwrap_or((0.0, 1.0));
        let panel = sheet(
            PANEL,
            &figure.labels,
            (x, Axis::linear(of_y)),
            &figure.series,
        );
        let [left, _, right, _] = panel.panel();
        edges_px = (left, right);
        body += &panel.finish_at(height);
        height += PANEL.1;
    }
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
         data-left=\"{}\" data-right=\"{}\">\n{body}</svg>\n",
        edges_px.0,
        edges_px.1,
        width = PANEL.0,
    )
}

/// Series in a square with the same range in both axes.
pub fn square(labels: &Labels, range: Range<f64>, series: &[Series]) -> String {
    let axis = Axis::exact(range.start, range.end);
    sheet(SQUARE, labels, (axis, axis), series).finish()
}

/// A panel with its series.
fn sheet(size: (f64, f64), labels: &Labels, axes: (Axis, Axis), series: &[Series]) -> Sheet {
    let hues = series
        .iter()
        .enumerate()
        .map(|(n, s)| hue(s.hue.unwrap_or(n)));
    let drawn = series
        .iter()
        .zip(hues)
        .filter(|(s, _)| !s.points.is_empty());
    let legend: Vec<Entry> = drawn.clone().map(|(s, colour)| entry(s, colour)).collect();
    let mut sheet = Sheet::new(size, 0.0, labels, axes, &legend);
    if sheet.y.low < 0.0 && sheet.y.high > 0.0 {
        let ends = [(sheet.x.low, 0.0), (sheet.x.high, 0.0)].map(|p| sheet.place(p));
        sheet.line(&ends, Stroke::solid("#777777", 1.0));
    }
    for (series, colour) in drawn {
        draw(&mut sheet, series, colour);
    }
    sheet
}

fn is_envelope(series: &Series) -> bool {
    let most = match series.mark {
        Mark::Dots => MOST_DOTS,
        Mark::Line => SIZE.0 as usize,
        Mark::Curve | Mark::Limit => usize::MAX,
    };
    series.points.len() > most
}

fn entry(series: &Series, colour: &'static str) -> Entry {
    let (swatch, name) = match series.mark {
        _ if series.name.is_empty() => (Swatch::Line, String::new()),
        _ if is_envelope(series) => {
            let name = format!("{} (least to most; median)", series.name);
            (Swatch::Envelope, name)
        }
        Mark::Dots => (Swatch::Dots, series.name.clone()),
        Mark::Line | Mark::Curve => (Swatch::Line, series.name.clone()),
        Mark::Limit => (Swatch::Dashes, series.name.clone()),
    };
    Entry {
        name,
        swatch,
        colour,
    }
}

fn draw(sheet: &mut Sheet, series: &Series, colour: &'static str) {
    let placed = |sheet: &Sheet, points: &[(f64, f64)]| -> Vec<(f64, f64)> {
        points.iter().map(|point| sheet.place(*point)).collect()
    };
    if is_envelope(series) {
        return envelope(sheet, series, colour);
    }
    match series.mark {
        Mark::Dots => {
            let finite = series
                .points
                .iter()
                .filter(|p| p.0.is_finite() && p.1.is_finite());
            let at = distinct(finite.map(|point| sheet.place(*point)));
            sheet.dots(&at, Stroke::solid(colour, DOT_PX).pale(0.6));
        }
        Mark::Line => {
            for run in runs(&series.points) {
                let run = placed(sheet, &run);
                sheet.line(&run, Stroke::solid(colour, 1.2));
            }
        }
        Mark::Curve => {
            let points = placed(sheet, &series.points);
            // A white outline separates the curve from the dots below it.
            sheet.line(&points, Stroke::solid("#ffffff", 4.0).pale(0.8));
            sheet.line(&points, Stroke::solid(colour, 1.8));
        }
        Mark::Limit => {
            let points = placed(sheet, &series.points);
            sheet.line(&points, Stroke::solid(colour, 1.2).dashed());
        }
    }
}

fn envelope(sheet: &mut Sheet, series: &Series, colour: &'static str) {
    let runs = match series.mark {
        Mark::Dots => vec![series.points.clone()],
        _ => runs(&series.points),
    };
    for run in runs {
        let finite = run.iter().filter(|p| p.0.is_finite() && p.1.is_finite());
        let columns = columns(finite.map(|point| sheet.place(*point)));
        sheet.path(&verticals(&columns), Stroke::solid(colour, 1.0).pale(0.4));
        let medians: Vec<(f64, f64)> = columns.iter().map(|c| (c.x, c.median)).collect();
        for piece in super::thin::runs(&medians) {
            sheet.line(&piece, Stroke::solid(colour, 1.0));
        }
    }
}

/// Vertical lines from the least to the greatest value in each column.
fn verticals(columns: &[Column]) -> String {
    use super::sheet::px;
    let one = |c: &Column| format!("M{} {}V{}", px(c.x), px(c.least), px(c.most));
    columns.iter().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels() -> Labels {
        Labels::new("A title", "noise, DN", "error, arcsec")
    }

    #[test]
    fn every_dot_is_drawn_as_large_as_in_the_legend() {
        let dots = Series::dots("residuals", [(-1.0, 0.5), (2.0, -0.5), (3.0, 0.1)]);
        let svg = series(&labels(), &[dots]).unwrap();
        assert_eq!(
            svg.matches("h0").count(),
            6,
            "three, and three in the legend"
        );
        assert_eq!(svg.matches("stroke-width=\"3.6\"").count(), 2);
        assert!(svg.contains("residuals"));
    }

    #[test]
    fn a_spike_of_one_frame_among_a_hundred_thousand_shows() {
        let value = |n: i32| if n == 54_321 { 100.0 } else { f64::from(n % 7) };
        let points = || (0..100_000).map(move |n| (f64::from(n), value(n)));
        for drawn in [
            Series::dots("dots", points()),
            Series::line("line", points()),
        ] {
            let svg = series(&labels(), &[drawn]).unwrap();
            assert!(svg.len() < 200_000, "{}", svg.len());
            let frame = Sheet::new(
                SIZE,
                0.0,
                &labels(),
                (Axis::linear((0.0, 99_999.0)), Axis::linear((0.0, 100.0))),
                &[entry(&Series::dots("x", []), "")],
            );
            let (x, top) = frame.place((54_321.0, 100.0));
            let column = format!(
                "M{} {}V",
                super::super::sheet::px(x.floor() + 0.5),
                super::super::sheet::px(top)
            );
            assert!(svg.contains(&column), "{column}");
        }
    }

    #[test]
    fn a_line_stops_at_a_night() {
        let night = (0..20).chain(500..520);
        let line = Series::line("seen", night.map(|n| (f64::from(n), 1.0)));
        let svg = series(&labels(), &[line]).unwrap();
        let lines = svg.matches("stroke-width=\"1.2\"").count();
        assert_eq!(lines, 2);
    }

    #[test]
    fn figures_of_nothing_are_refused() {
        assert_eq!(
            series(&labels(), &[]),
            Err(PlotError::Empty("A title".into()))
        );
        let nan = Series::dots("none", [(f64::NAN, 1.0)]);
        assert!(series(&labels(), &[nan]).is_err());
    }
}
