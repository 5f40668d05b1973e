//! Maps of a square field: vectors as arrows with an arrow of known length, numbers as colours with a colour scale.

use super::axis::{Axis, extent, short};
use super::field::{MapField, Scale, Shades};
use super::labels::{Labels, PlotError};
use super::sheet::{Entry, Swatch};
use std::collections::BTreeMap;
use std::ops::Range;

/// A vector at a position, both in the units of the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrow {
    pub at: (f64, f64),
    pub vector: (f64, f64),
}

/// A number at a position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    pub at: (f64, f64),
    pub value: f64,
}

/// Length that 95 % of the arrows do not exceed, and the greatest length.
const PERCENTILE_95_PX: f64 = 36.0;
const LONGEST_PX: f64 = 90.0;
/// Approximate number of cells of a binned field along an axis.
const CELLS: f64 = 50.0;

/// A field of vectors over `range` in both axes, drawn to a scale shown by an arrow of stated length in `unit`.
///
/// # Errors
/// If there is nothing to draw.
pub fn vector_map(
    labels: &Labels,
    range: Range<f64>,
    arrows: &[Arrow],
    unit: &str,
) -> Result<String, PlotError> {
    let length = |arrow: &Arrow| arrow.vector.0.hypot(arrow.vector.1);
    let mut lengths: Vec<f64> = arrows
        .iter()
        .map(length)
        .filter(|l| l.is_finite())
        .collect();
    lengths.sort_by(f64::total_cmp);
    let longest = *lengths.last().ok_or_else(|| labels.empty())?;
    let percentile_95 = lengths[(lengths.len() - 1) * 19 / 20];
    let px_per_unit = match longest > 0.0 {
        true => (LONGEST_PX / longest).min(PERCENTILE_95_PX / percentile_95.max(1e-300)),
        false => 1.0,
    };
    let shown = round_down(percentile_95.max(longest * 1e-3));
    let legend = vec![Entry {
        name: format!("{} {unit}", short(shown, 1)),
        swatch: Swatch::Arrow(shown * px_per_unit),
        colour: ARROW,
    }];
    let mut sheet = MapField::over(range.clone(), range).sheet(labels, legend, None);
    for arrow in arrows {
        let from = sheet.place(arrow.at);
        let (dx, dy) = (arrow.vector.0 * px_per_unit, arrow.vector.1 * px_per_unit);
        if dx.is_finite() && dy.is_finite() {
            sheet.arrow(from, (from.0 + dx, from.1 - dy), ARROW);
        }
    }
    Ok(sheet.finish())
}

const ARROW: &str = "#0072b2";

/// The largest of 1, 2 and 5 times a power of ten that is not above the value.
fn round_down(value: f64) -> f64 {
    if value <= 0.0 {
        return 1.0;
    }
    let decade = 10_f64.powf(value.log10().floor());
    let factors = [5.0, 2.0, 1.0];
    let found = factors
        .iter()
        .find(|factor| *factor * decade <= value * 1.001);
    found.unwrap_or(&1.0) * decade
}

/// Numbers as squares of width `cell` over a field, with a colour scale in `unit`.
///
/// # Errors
/// If there is nothing to draw.
pub fn scalar_map(
    labels: &Labels,
    field: &MapField,
    cells: &[Cell],
    cell: f64,
    unit: &str,
) -> Result<String, PlotError> {
    let shown = cells.iter().filter(|cell| field.contains(cell.at));
    let values = extent(shown.clone().map(|cell| cell.value)).ok_or_else(|| labels.empty())?;
    let scale = Scale {
        axis: match values {
            (low, high) if low < high => Axis::exact(low, high),
            one => Axis::linear(one),
        },
        shades: &SHADES,
        name: unit,
    };
    let mut sheet = field.sheet(labels, Vec::new(), Some(&scale));
    let [left, top, right, bottom] = sheet.panel();
    for one in shown.filter(|one| one.value.is_finite()) {
        let (x, y) = one.at;
        let half = cell / 2.0;
        let corners = [(x - half, y - half), (x + half, y + half)].map(|corner| {
            let (x, y) = sheet.place(corner);
            (x.clamp(left, right), y.clamp(top, bottom))
        });
        sheet.rectangle(corners[0], corners[1], &scale.colour(one.value));
    }
    field.draw_lines(&mut sheet);
    field.draw_target(&mut sheet);
    Ok(sheet.finish())
}

/// A round width of cells for a field.
pub fn cell_of(field: &MapField) -> f64 {
    let wanted = (field.x.end - field.x.start) / CELLS;
    round_down(2.0 * wanted)
}

/// Total in each cell of width `cell`, where each point counts as `each`.
pub fn binned(points: impl Iterator<Item = (f64, f64)>, cell: f64, each: f64) -> Vec<Cell> {
    let mut counts: BTreeMap<(i64, i64), u32> = BTreeMap::new();
    for (x, y) in points.filter(|(x, y)| x.is_finite() && y.is_finite()) {
        let at = [x, y].map(|v| (v / cell).floor() as i64);
        *counts.entry(at.into()).or_default() += 1;
    }
    let middle = |n: i64| (n as f64 + 0.5) * cell;
    let counts = counts.into_iter();
    let binned = counts.map(|((x, y), count)| Cell {
        at: (middle(x), middle(y)),
        value: f64::from(count) * each,
    });
    binned.collect()
}

/// From light green to dark blue, uniform in lightness (ColorBrewer's YlGnBu without its yellow, which is too light on white): distinct
/// for colour-blind readers and in greyscale.
const SHADES: Shades = Shades(&[
    [199, 233, 180],
    [127, 205, 187],
    [65, 182, 196],
    [29, 145, 192],
    [34, 94, 168],
    [37, 52, 148],
]);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_of_vectors_states_the_length_of_an_arrow() {
        let labels = Labels::new("Residuals", "X, mil", "Y, mil");
        let arrow = |n: u32| Arrow {
            at: (f64::from(n), 0.0),
            vector: (0.03, 0.0),
        };
        let arrows: Vec<Arrow> = (0..5).map(arrow).collect();
        let svg = vector_map(&labels, -10.0..10.0, &arrows, "mil").unwrap();
        assert!(svg.contains(">0.02 mil<"));
        assert!(vector_map(&labels, -1.0..1.0, &[], "mil").is_err());
        let still = Arrow {
            vector: (0.0, 0.0),
            ..arrow(0)
        };
        assert!(
            !vector_map(&labels, -1.0..1.0, &[still], "mil")
                .unwrap()
                .contains("NaN")
        );
    }

    #[test]
    fn a_map_of_numbers_has_a_scale() {
        let labels = Labels::new("Observations", "X, mil", "Y, mil");
        let cell = |n: u32| Cell {
            at: (f64::from(n), 0.0),
            value: f64::from(n),
        };
        let cells: Vec<Cell> = (0..=10).map(cell).collect();
        let svg = scalar_map(&labels, &MapField::about_zero(20.0), &cells, 1.0, "frames").unwrap();
        assert!(svg.contains("#c7e9b4") && svg.contains("#253494") && svg.contains(">frames<"));
        assert!(scalar_map(&labels, &MapField::about_zero(1.0), &cells[..1], 1.0, "").is_ok());
    }

    #[test]
    fn every_point_counts_in_the_cell_it_lies_in() {
        let points = [
            (0.1, 0.1),
            (1.9, 0.2),
            (-0.1, 0.1),
            (0.5, 1.5),
            (f64::NAN, 0.0),
        ];
        let cells = binned(points.into_iter(), 2.0, 0.1);
        let found: Vec<_> = cells.iter().map(|cell| (cell.at, cell.value)).collect();
        assert_eq!(found.len(), 2);
        assert_eq!(found[0], ((-1.0, 1.0), 0.1));
        assert_eq!(found[1].0, (1.0, 1.0));
        assert!((found[1].1 - 0.3).abs() < 1e-12);
        assert_eq!(cell_of(&MapField::about_zero(50.0)), 2.0);
    }
}
