//! Common elements of maps: a square field with lines and a target in it, and a colour scale beside it.

use super::axis::{Axis, superscript};
use super::labels::Labels;
use super::sheet::{Anchor, Entry, MARGINS_PX, Sheet, Stroke, Swatch};
use std::ops::Range;

/// A polyline.
pub type Line = Vec<(f64, f64)>;

/// The field of a map: the range of both axes, equally long, and the lines below and above its contents.
#[derive(Debug, Clone, PartialEq)]
pub struct MapField {
    pub x: Range<f64>,
    pub y: Range<f64>,
    pub outline: Line,
    pub grid: Vec<Line>,
    /// Position of a target, or the path of a moving one; empty without a target.
    pub target: Line,
}

/// Width of a map without the colour scale, and its height without a legend: the panel is square.
const SIDE_PX: f64 = 620.0;
const HEIGHT_PX: f64 = 610.0;
/// Height of a row of the legend.
const ROW_PX: f64 = 19.0;
/// Width of the colour scale.
const SCALE_PX: f64 = 90.0;
const GRID: &str = "#d9b77c";
const OUTLINE: &str = "#b5761c";
const TARGET: &str = "#000000";
const TARGET_PX: f64 = 7.0;

impl MapField {
    /// An empty field.
    pub fn over(x: Range<f64>, y: Range<f64>) -> Self {
        Self {
            x,
            y,
            outline: Line::new(),
            grid: Vec::new(),
            target: Line::new(),
        }
    }

    /// A field from minus to plus a number in both axes.
    pub fn about_zero(reach: f64) -> Self {
        Self::over(-reach..reach, -reach..reach)
    }

    /// Scale of both axes.
    pub(super) fn px_per_unit(&self) -> f64 {
        (SIDE_PX - MARGINS_PX) / (self.x.end - self.x.start)
    }

    pub(super) fn contains(&self, (x, y): (f64, f64)) -> bool {
        self.x.contains(&x) && self.y.contains(&y)
    }

    /// The parts of the target's path within the field.
    fn target_within(&self) -> Line {
        let within = |at: &(f64, f64)| self.contains(*at);
        self.target.iter().copied().filter(within).collect()
    }

    /// An empty panel, with a colour scale beside it if there is one.
    pub(super) fn sheet(
        &self,
        labels: &Labels,
        mut legend: Vec<Entry>,
        scale: Option<&Scale>,
    ) -> Sheet {
        if !self.target_within().is_empty() {
            legend.push(Entry {
                name: "target".into(),
                swatch: Swatch::Ring,
                colour: TARGET,
            });
        }
        let height = HEIGHT_PX + if legend.is_empty() { 0.0 } else { ROW_PX };
        let beside = if scale.is_some() { SCALE_PX } else { 0.0 };
        let axes = [&self.x, &self.y].map(|span| Axis::exact(span.start, span.end));
        let size = (SIDE_PX + beside, height);
        let mut sheet = Sheet::new(size, beside, labels, axes.into(), &legend);
        if let Some(scale) = scale {
            scale.draw(&mut sheet);
        }
        sheet
    }

    pub(super) fn draw_lines(&self, sheet: &mut Sheet) {
        let grid = self.grid.iter().map(|line| (line, GRID, 0.8));
        for (line, colour, width_px) in grid.chain([(&self.outline, OUTLINE, 1.6)]) {
            for part in sheet.parts(line) {
                sheet.line(&part, Stroke::solid(colour, width_px));
            }
        }
    }

    /// Marks the target above the contents, at both ends of its path.
    pub(super) fn draw_target(&self, sheet: &mut Sheet) {
        let way = self.target_within();
        let ends = way.first().into_iter().chain(way.last());
        let ends: Vec<(f64, f64)> = ends.map(|at| sheet.place(*at)).collect();
        let way: Vec<(f64, f64)> = way.iter().map(|at| sheet.place(*at)).collect();
        // A white outline makes the black visible against dark paths.
        for stroke in [
            Stroke::solid("#ffffff", 4.0).pale(0.8),
            Stroke::solid(TARGET, 1.6),
        ] {
            if way.len() > 1 {
                sheet.line(&way, stroke);
            }
            ends.iter()
                .for_each(|at| sheet.ring(*at, TARGET_PX, stroke));
        }
    }
}

/// A colour map that interpolates these colours at equal steps.
pub(super) struct Shades(pub &'static [[u8; 3]]);

impl Shades {
    /// The colour at a fraction from 0 to 1.
    pub fn at(&self, fraction: f64) -> String {
        let stops = self.0;
        let place = fraction.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
        let stop = (place as usize).min(stops.len() - 2);
        let part = place - stop as f64;
        let mix = |n: usize| {
            let [from, to] = [stops[stop][n], stops[stop + 1][n]].map(f64::from);
            (from * (1.0 - part) + to * part).round() as u8
        };
        format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
    }
}

/// A colour scale.
pub(super) struct Scale<'a> {
    pub axis: Axis,
    pub shades: &'a Shades,
    /// Name of the values.
    pub name: &'a str,
}

impl Scale<'_> {
    pub fn colour(&self, value: f64) -> String {
        self.shades.at(self.axis.fraction(value))
    }

    /// Draws the colours with their values, right of the panel.
    fn draw(&self, sheet: &mut Sheet) {
        const STEPS: u32 = 100;
        let [_, top, right, bottom] = sheet.panel();
        let (left, right) = (right + 18.0, right + 34.0);
        let top = top + 26.0;
        let at = |fraction: f64| bottom - fraction * (bottom - top);
        for n in 0..STEPS {
            let [from, to] = [n, n + 1].map(|n| f64::from(n) / f64::from(STEPS));
            // The next one covers it, so that there is no gap between two.
            let overlap = if n + 1 < STEPS { 1.5 } else { 0.0 };
            let colour = self.shades.at(from);
            sheet.rectangle((left, at(from)), (right, at(to) - overlap), &colour);
        }
        let corners = [
            (left, top),
            (right, top),
            (right, bottom),
            (left, bottom),
            (left, top),
        ];
        let frame = Stroke::solid("#888888", 1.0);
        sheet.line(&corners, frame);
        for tick in self.axis.ticks(6) {
            let y = at(self.axis.fraction(tick.at));
            sheet.line(&[(right, y), (right + 4.0, y)], frame);
            sheet.text((right + 8.0, y + 4.0), Anchor::Start, &tick.label);
            if let Some(date) = tick.date {
                sheet.text((right + 8.0, y + 18.0), Anchor::Start, &date);
            }
        }
        let power = match self.axis.exponent() {
            0 => String::new(),
            power => format!(" \u{d7} 10{}", superscript(power)),
        };
        let name = format!("{}{power}", self.name);
        sheet.text((left - 6.0, top - 14.0), Anchor::Start, &name);
    }
}
