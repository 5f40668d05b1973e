//! Maps of a square field: vectors as arrows beside an arrow of known length, numbers as colours beside a scale.

use super::axis::{Axis, extent, short};
use super::labels::{Labels, PlotError};
use super::sheet::{Anchor, Entry, Sheet, Stroke, Swatch};
use std::ops::Range;

/// A vector at a place, both in the units of the map's own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrow {
    pub at: (f64, f64),
    pub vector: (f64, f64),
}

/// A number at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    pub at: (f64, f64),
    pub value: f64,
}

/// Width and height without what stands beside a map, so that a map is square.
const SIDE_PX: f64 = 620.0;
const HEIGHT_PX: f64 = 629.0;
/// All but a twentieth of the arrows are no longer than this, and none longer than that.
const USUAL_PX: f64 = 36.0;
const LONGEST_PX: f64 = 90.0;
/// Space for the scale of colours.
const SCALE_PX: f64 = 90.0;

/// A field of vectors over `range` in both axes, drawn to a scale of its own that an arrow of stated length in `unit` shows.
///
/// # Errors
/// Nothing to draw.
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
    let usual = lengths[(lengths.len() - 1) * 19 / 20];
    let px_per_unit = match longest > 0.0 {
        true => (LONGEST_PX / longest).min(USUAL_PX / usual.max(1e-300)),
        false => 1.0,
    };
    let shown = round_down(usual.max(longest * 1e-3));
    let legend = [Entry {
        name: format!("{} {unit}", short(shown, 1)),
        swatch: Swatch::Arrow(shown * px_per_unit),
        colour: ARROW,
    }];
    let axis = Axis::exact(range.start, range.end);
    let mut sheet = Sheet::new((SIDE_PX, HEIGHT_PX), 0.0, labels, (axis, axis), &legend);
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

/// 1, 2 or 5 times a power of ten that is no larger.
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

/// Numbers as squares of `cell` in width over `range` in both axes, with the scale of their colours in `unit`.
///
/// # Errors
/// Nothing to draw.
pub fn scalar_map(
    labels: &Labels,
    range: Range<f64>,
    cells: &[Cell],
    cell: f64,
    unit: &str,
) -> Result<String, PlotError> {
    let values = extent(cells.iter().map(|cell| cell.value)).ok_or_else(|| labels.empty())?;
    let of_value = match values {
        (low, high) if low < high => Axis::exact(low, high),
        one => Axis::linear(one),
    };
    let axis = Axis::exact(range.start, range.end);
    let size = (SIDE_PX + SCALE_PX, HEIGHT_PX - 19.0);
    let mut sheet = Sheet::new(size, SCALE_PX, labels, (axis, axis), &[]);
    for one in cells.iter().filter(|one| one.value.is_finite()) {
        let (x, y) = one.at;
        let half = cell / 2.0;
        let corners = [(x - half, y - half), (x + half, y + half)].map(|p| sheet.place(p));
        let colour = colour(of_value.fraction(one.value));
        sheet.rectangle(corners[0], corners[1], &colour);
    }
    scale(&mut sheet, of_value, unit);
    Ok(sheet.finish())
}

/// The colours beside their values, right of the panel.
fn scale(sheet: &mut Sheet, of_value: Axis, unit: &str) {
    const STEPS: u32 = 100;
    let [_, top, right, bottom] = sheet.panel();
    let (left, right) = (right + 18.0, right + 34.0);
    let top = top + 26.0;
    let at = |fraction: f64| bottom - fraction * (bottom - top);
    for n in 0..STEPS {
        let [from, to] = [n, n + 1].map(|n| f64::from(n) / f64::from(STEPS));
        // The next covers it, so that no gap shows between two.
        let overlap = if n + 1 < STEPS { 1.5 } else { 0.0 };
        sheet.rectangle((left, at(from)), (right, at(to) - overlap), &colour(from));
    }
    let corners = [
        (left, top),
        (right, top),
        (right, bottom),
        (left, bottom),
        (left, top),
    ];
    sheet.line(&corners, Stroke::solid("#888888", 1.0));
    for tick in of_value.ticks(6) {
        let y = at(of_value.fraction(tick.at));
        sheet.line(
            &[(right, y), (right + 4.0, y)],
            Stroke::solid("#888888", 1.0),
        );
        sheet.text((right + 8.0, y + 4.0), Anchor::Start, &tick.label);
    }
    let power = match of_value.left_out() {
        0 => String::new(),
        power => format!(" \u{d7} 10{}", super::axis::superscript(power)),
    };
    sheet.text(
        (left - 6.0, top - 14.0),
        Anchor::Start,
        &format!("{unit}{power}"),
    );
}

/// From light yellow to dark blue, even in lightness (ColorBrewer's YlGnBu): distinct for the colour-blind and in grey.
fn colour(fraction: f64) -> String {
    const STOPS: [[f64; 3]; 5] = [
        [255.0, 255.0, 204.0],
        [161.0, 218.0, 180.0],
        [65.0, 182.0, 196.0],
        [44.0, 127.0, 184.0],
        [37.0, 52.0, 148.0],
    ];
    let place = fraction.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let stop = (place as usize).min(STOPS.len() - 2);
    let part = place - stop as f64;
    let mix = |n: usize| (STOPS[stop][n] * (1.0 - part) + STOPS[stop + 1][n] * part).round() as u8;
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}

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
        let svg = scalar_map(&labels, -10.0..10.0, &cells, 1.0, "frames").unwrap();
        assert!(svg.contains("#ffffcc") && svg.contains("#253494") && svg.contains(">frames<"));
        assert!(scalar_map(&labels, -1.0..1.0, &cells[..1], 1.0, "").is_ok());
    }
}
