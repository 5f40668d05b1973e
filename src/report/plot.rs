//! Figures as SVG: curves over logarithmic axes, series over linear ones, histograms, maps of small vectors. Input is numbers
//! and labels.

use plotters::chart::MeshStyle;
use plotters::coord::ranged1d::ValueFormatter;
use plotters::coord::{CoordTranslate, Shift};
use plotters::prelude::*;
use std::ops::Range;

/// Why a figure cannot be drawn.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PlotError {
    #[error("expected values to draw in figure \"{0}\", found none")]
    Empty(String),
    #[error("cannot draw: {0}")]
    Drawing(String),
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// What every figure has.
#[derive(Debug, Clone, PartialEq)]
pub struct Labels {
    pub title: String,
    pub x: String,
    pub y: String,
}

impl Labels {
    pub fn new(title: impl Into<String>, x: impl Into<String>, y: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            x: x.into(),
            y: y.into(),
        }
    }
}

/// How a curve is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stroke {
    /// Points joined by a line: measured.
    Measured,
    /// A line alone: known beforehand.
    Known,
}

/// A named curve of points (x, y), all positive.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    pub name: String,
    pub points: Vec<(f64, f64)>,
    pub stroke: Stroke,
}

const SIZE: (u32, u32) = (720, 480);
const FONT: &str = "sans-serif";

/// Curves over two logarithmic axes.
pub fn curves(labels: &Labels, curves: &[Curve]) -> Result<String, PlotError> {
    let points = curves.iter().flat_map(|curve| &curve.points);
    let [x, y] = ranges(labels, points, |low, high| low / 1.15..high * 1.15)?;
    figure(SIZE, |area| {
        let mut chart = frame(area, labels).build_cartesian_2d(x.log_scale(), y.log_scale())?;
        let decimal = |v: &f64| format!("{}", (v * 1e6).round() / 1e6);
        mesh(&mut chart, labels)
            .x_label_formatter(&decimal)
            .y_label_formatter(&decimal)
            .draw()?;
        for (n, curve) in curves.iter().enumerate() {
            let colour = colour(n);
            let width = match curve.stroke {
                Stroke::Measured => 2,
                Stroke::Known => 1,
            };
            let stroke = colour.stroke_width(width);
            let points = curve.points.iter().copied();
            chart
                .draw_series(LineSeries::new(points.clone(), stroke))?
                .label(curve.name.as_str())
                .legend(piece_of(stroke));
            if curve.stroke == Stroke::Measured {
                chart.draw_series(points.map(|point| Circle::new(point, 3, colour.filled())))?;
            }
        }
        legend(&mut chart, clear_corner(curves))
    })
}

/// How a series over linear axes is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    Dots,
    Line,
}

/// A named series of points (x, y).
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    pub name: String,
    pub points: Vec<(f64, f64)>,
    pub mark: Mark,
}

impl Series {
    pub fn dots(name: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self {
            name: name.into(),
            points: points.into_iter().collect(),
            mark: Mark::Dots,
        }
    }
}

/// Series with their labels, to be drawn by [`series`].
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    pub labels: Labels,
    pub series: Vec<Series>,
}

/// Most points of a series that are drawn: of more, every so many.
const MOST_POINTS: usize = 3000;
const WIDE: (u32, u32) = (1000, 380);

/// Series over linear axes, with a line at y = 0 where it lies among them.
pub fn series(labels: &Labels, series: &[Series]) -> Result<String, PlotError> {
    let points = series.iter().flat_map(|series| &series.points);
    let [x, y] = ranges(labels, points, |low, high| {
        let room = ((high - low) * 0.03).max(high.abs() * 1e-9).max(1e-9);
        low - room..high + room
    })?;
    figure(WIDE, |area| {
        let mut chart = frame(area, labels).build_cartesian_2d(x.clone(), y.clone())?;
        mesh(&mut chart, labels).draw()?;
        if y.contains(&0.0) {
            let zero = [(x.start, 0.0), (x.end, 0.0)];
            chart.draw_series(LineSeries::new(zero, BLACK.mix(0.5).stroke_width(1)))?;
        }
        for (n, series) in series.iter().enumerate() {
            let colour = colour(n);
            let every = series.points.len().div_ceil(MOST_POINTS).max(1);
            let points = series.points.iter().step_by(every).copied();
            match series.mark {
                Mark::Dots => {
                    chart.draw_series(points.map(|p| Circle::new(p, 2, colour.filled())))?
                }
                Mark::Line => chart.draw_series(LineSeries::new(points, colour.stroke_width(1)))?,
            }
            .label(series.name.as_str())
            .legend(piece_of(colour.stroke_width(2)));
        }
        legend(&mut chart, SeriesLabelPosition::UpperRight)
    })
}

/// The upper corner that the first curve leaves free.
fn clear_corner(curves: &[Curve]) -> SeriesLabelPosition {
    let ends = |points: &[(f64, f64)]| Some((points.first()?.1, points.last()?.1));
    match curves.first().and_then(|curve| ends(&curve.points)) {
        Some((first, last)) if first > last => SeriesLabelPosition::UpperRight,
        _ => SeriesLabelPosition::UpperLeft,
    }
}

/// A histogram with named upright lines.
pub fn histogram(
    labels: &Labels,
    values: &[f64],
    bins: usize,
    lines: &[(&str, f64)],
) -> Result<String, PlotError> {
    let drawn = values.iter().chain(lines.iter().map(|(_, at)| at));
    let (_, high) = extent(drawn.copied()).ok_or_else(|| PlotError::Empty(labels.title.clone()))?;
    let width = high * 1.05 / bins as f64;
    let mut counts = vec![0_u32; bins];
    for value in values {
        let bin = (value / width) as usize;
        if let Some(count) = counts.get_mut(bin) {
            *count += 1;
        }
    }
    let most = f64::from(counts.iter().copied().max().unwrap_or_default());
    figure(SIZE, |area| {
        let x: Range<f64> = 0.0..high * 1.05;
        let mut chart = frame(area, labels).build_cartesian_2d(x, 0.0..most * 1.1)?;
        mesh(&mut chart, labels)
            .y_label_formatter(&|count: &f64| format!("{count:.0}"))
            .disable_x_mesh()
            .draw()?;
        let bars = counts.iter().enumerate().map(|(bin, count)| {
            let left = bin as f64 * width;
            let corners = [(left, 0.0), (left + width, f64::from(*count))];
            Rectangle::new(corners, colour(0).mix(0.6).filled())
        });
        chart.draw_series(bars)?;
        for (n, (name, at)) in lines.iter().enumerate() {
            let stroke = colour(n + 1).stroke_width(2);
            let upright = [(*at, 0.0), (*at, most * 1.1)];
            chart
                .draw_series(LineSeries::new(upright, stroke))?
                .label(*name)
                .legend(piece_of(stroke));
        }
        legend(&mut chart, SeriesLabelPosition::UpperRight)
    })
}

/// A vector at a place; both in the units of the axes, the vector magnified.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrow {
    pub at: (f64, f64),
    pub vector: (f64, f64),
}

/// A square field of vectors over `range` in both axes: arrows, magnified so many times, in cells shaded by length, full
/// shade at `limit`.
pub fn vector_map(
    labels: &Labels,
    range: Range<f64>,
    cell: f64,
    arrows: &[Arrow],
    magnified: f64,
    limit: f64,
) -> Result<String, PlotError> {
    figure((560, 560), |area| {
        let mut chart = frame(area, labels).build_cartesian_2d(range.clone(), range)?;
        mesh(&mut chart, labels).disable_mesh().draw()?;
        chart.draw_series(arrows.iter().map(|arrow| {
            let (x, y) = arrow.at;
            let half = cell / 2.0;
            let shade = (arrow.vector.0.hypot(arrow.vector.1) / limit).min(1.0);
            let corners = [(x - half, y - half), (x + half, y + half)];
            Rectangle::new(corners, colour(1).mix(0.7 * shade).filled())
        }))?;
        chart.draw_series(arrows.iter().map(|arrow| {
            let (x, y) = arrow.at;
            let tip = (
                x + magnified * arrow.vector.0,
                y + magnified * arrow.vector.1,
            );
            PathElement::new([arrow.at, tip], BLACK.stroke_width(1))
        }))?;
        chart.draw_series(
            arrows
                .iter()
                .map(|arrow| Circle::new(arrow.at, 2, BLACK.filled())),
        )?;
        Ok(())
    })
}

/// Draws on white and gives the SVG.
fn figure(
    size: (u32, u32),
    draw: impl FnOnce(&Area<'_>) -> Result<(), DrawingError>,
) -> Result<String, PlotError> {
    let mut svg = String::new();
    let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
    let drawn = area
        .fill(&WHITE)
        .and_then(|()| draw(&area))
        .and_then(|()| area.present());
    drop(area);
    drawn.map_err(|error| PlotError::Drawing(error.to_string()))?;
    Ok(svg)
}

type DrawingError = DrawingAreaErrorKind<<SVGBackend<'static> as DrawingBackend>::ErrorType>;

/// Space for title and labels.
fn frame<'a, 'b>(area: &'a Area<'b>, labels: &Labels) -> ChartBuilder<'a, 'b, SVGBackend<'b>> {
    let mut builder = ChartBuilder::on(area);
    builder
        .caption(&labels.title, (FONT, 17))
        .margin(14)
        .x_label_area_size(44)
        .y_label_area_size(64);
    builder
}

type Chart<'a, 'b, C> = ChartContext<'a, SVGBackend<'b>, C>;

/// The axes with their names, and of the grid the coarse lines alone.
fn mesh<'a, 'b, 'm, X, Y>(
    chart: &'m mut Chart<'a, 'b, Cartesian2d<X, Y>>,
    labels: &Labels,
) -> MeshStyle<'a, 'm, X, Y, SVGBackend<'b>>
where
    X: Ranged + ValueFormatter<X::ValueType>,
    Y: Ranged + ValueFormatter<Y::ValueType>,
{
    let mut mesh = chart.configure_mesh();
    mesh.x_desc(&labels.x)
        .y_desc(&labels.y)
        .light_line_style(WHITE);
    mesh
}

/// The names of all series that have one.
fn legend<'a>(
    chart: &mut Chart<'a, 'a, impl CoordTranslate>,
    corner: SeriesLabelPosition,
) -> Result<(), DrawingError> {
    chart
        .configure_series_labels()
        .position(corner)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .draw()
}

/// How a line shows in the legend.
fn piece_of(stroke: ShapeStyle) -> impl Fn((i32, i32)) -> PathElement<(i32, i32)> {
    move |(x, y)| PathElement::new([(x, y), (x + 18, y)], stroke)
}

/// What both axes span: from the smallest to the largest of some points, widened.
fn ranges<'a>(
    labels: &Labels,
    points: impl Iterator<Item = &'a (f64, f64)> + Clone,
    widened: fn(f64, f64) -> Range<f64>,
) -> Result<[Range<f64>; 2], PlotError> {
    let range = |axis: fn(&(f64, f64)) -> f64| {
        let (low, high) = extent(points.clone().map(axis))?;
        Some(widened(low, high))
    };
    let both = range(|p| p.0).zip(range(|p| p.1));
    let (x, y) = both.ok_or_else(|| PlotError::Empty(labels.title.clone()))?;
    Ok([x, y])
}

/// The smallest and the largest of some values.
fn extent(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.fold(None, |extent, v| {
        let (low, high) = extent.unwrap_or((v, v));
        Some((low.min(v), high.max(v)))
    })
}

/// Colours that are distinct for the colour-blind (Okabe and Ito 2008).
fn colour(n: usize) -> RGBColor {
    const COLOURS: [RGBColor; 5] = [
        RGBColor(0, 114, 178),
        RGBColor(213, 94, 0),
        RGBColor(0, 158, 115),
        RGBColor(204, 121, 167),
        RGBColor(120, 120, 120),
    ];
    COLOURS[n % COLOURS.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels() -> Labels {
        Labels::new("A title", "noise, DN", "error, arcsec")
    }

    #[test]
    fn a_figure_says_what_it_shows() {
        let curve = Curve {
            name: "median".into(),
            points: vec![(1.0, 0.05), (5.0, 0.15), (15.0, 0.5)],
            stroke: Stroke::Measured,
        };
        let svg = curves(&labels(), &[curve]).unwrap();
        for text in ["<svg", "A title", "noise, DN", "error, arcsec", "median"] {
            assert!(svg.contains(text), "{text}");
        }
    }

    #[test]
    fn every_dot_is_drawn() {
        let dots = Series::dots("residuals", [(-1.0, 0.5), (2.0, -0.5), (3.0, 0.1)]);
        let svg = series(&labels(), &[dots]).unwrap();
        assert_eq!(svg.matches("<circle").count(), 3);
        assert!(svg.contains("residuals"));
    }

    #[test]
    fn every_value_is_in_a_bar() {
        let svg = histogram(&labels(), &[0.1, 0.2, 0.25, 0.9], 4, &[("limit", 0.5)]).unwrap();
        assert!(svg.contains("limit"));
        assert!(histogram(&labels(), &[], 4, &[]).is_err());
    }

    #[test]
    fn a_series_of_one_value_and_a_long_one_are_drawn() {
        let flat = Series::dots("flat", (0..100_000).map(|n| (f64::from(n), 3.0)));
        let svg = series(&labels(), &[flat]).unwrap();
        assert!(svg.contains("flat") && svg.len() < 1_000_000);
        assert!(series(&labels(), &[]).is_err());
    }

    #[test]
    fn figures_of_nothing_are_refused() {
        assert_eq!(
            curves(&labels(), &[]),
            Err(PlotError::Empty("A title".into()))
        );
    }
}
