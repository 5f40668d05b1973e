//! Curves over two logarithmic axes.

use super::axis::{Axis, extent};
use super::labels::{Labels, PlotError};
use super::sheet::{self, DOT_PX, Entry, Sheet, Swatch, hue};

/// Style of a curve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stroke {
    /// Points joined by a line: measured values.
    Measured,
    /// A line only: very many points, or values known a priori.
    Known,
    /// Dashed: a limit.
    Limit,
}

/// A named curve of points (x, y). Only positive values can be drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    pub name: String,
    pub points: Vec<(f64, f64)>,
    pub stroke: Stroke,
    /// Index of its colour; none: its index among the curves.
    pub hue: Option<usize>,
}

impl Curve {
    pub fn new(
        name: impl Into<String>,
        stroke: Stroke,
        points: impl IntoIterator<Item = (f64, f64)>,
    ) -> Self {
        Self {
            name: name.into(),
            points: points.into_iter().collect(),
            stroke,
            hue: None,
        }
    }

    /// The same in the n-th colour.
    pub fn in_hue(self, n: usize) -> Self {
        Self {
            hue: Some(n),
            ..self
        }
    }

    fn positive(&self) -> impl Iterator<Item = (f64, f64)> {
        let positive = |v: f64| v > 0.0 && v.is_finite();
        let points = self.points.iter().copied();
        points.filter(move |(x, y)| positive(*x) && positive(*y))
    }
}

const SIZE: (f64, f64) = (1000.0, 460.0);

/// Curves over two logarithmic axes.
///
/// # Errors
/// If there is nothing to draw.
pub fn curves(labels: &Labels, curves: &[Curve]) -> Result<String, PlotError> {
    let points = || curves.iter().flat_map(Curve::positive);
    let x = extent(points().map(|p| p.0)).ok_or_else(|| labels.empty())?;
    let y = extent(points().map(|p| p.1)).ok_or_else(|| labels.empty())?;
    let drawn = curves.iter().enumerate();
    let drawn = drawn.filter(|(_, curve)| curve.positive().next().is_some());
    let drawn: Vec<_> = drawn
        .map(|(n, curve)| (curve, hue(curve.hue.unwrap_or(n))))
        .collect();
    let entry = |(curve, colour): &(&Curve, &'static str)| Entry {
        name: curve.name.clone(),
        swatch: match curve.stroke {
            Stroke::Measured => Swatch::Joined,
            Stroke::Known => Swatch::Line,
            Stroke::Limit => Swatch::Dashes,
        },
        colour,
    };
    let legend: Vec<Entry> = drawn.iter().map(entry).collect();
    let axes = (Axis::logarithmic(x), Axis::logarithmic(y));
    let mut sheet = Sheet::new(SIZE, 0.0, labels, axes, &legend);
    for (curve, colour) in drawn {
        let points: Vec<(f64, f64)> = curve.positive().map(|p| sheet.place(p)).collect();
        match curve.stroke {
            Stroke::Measured => {
                sheet.line(&points, sheet::Stroke::solid(colour, 1.8));
                sheet.dots(&points, sheet::Stroke::solid(colour, DOT_PX));
            }
            Stroke::Known => sheet.line(&points, sheet::Stroke::solid(colour, 1.2)),
            Stroke::Limit => sheet.line(&points, sheet::Stroke::solid(colour, 1.4).dashed()),
        }
    }
    Ok(sheet.finish())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_says_what_it_shows() {
        let labels = Labels::new("A title", "noise, DN", "error, arcsec");
        let points = [(1.0, 0.05), (5.0, 0.15), (15.0, 0.5), (20.0, 0.0)];
        let curve = Curve::new("median", Stroke::Measured, points);
        let svg = curves(&labels, &[curve]).unwrap();
        for text in ["<svg", "A title", "noise, DN", "error, arcsec", "median"] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        assert_eq!(
            curves(&labels, &[]),
            Err(PlotError::Empty("A title".into()))
        );
    }
}
