//! The sheet a figure is drawn on: title, legend above the panel, axes, and the shapes in it.

use super::axis::{Axis, superscript};
use super::clip;
use super::labels::{Horizontal, Labels};
use std::fmt::Write;

/// Colours that are distinct for colour-blind readers, and in print (Okabe and Ito 2008).
const HUES: [&str; 6] = [
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#555555",
];

/// The n-th colour.
pub(super) fn hue(n: usize) -> &'static str {
    HUES[n % HUES.len()]
}

/// Diameter of a dot, px.
pub(super) const DOT_PX: f64 = 3.6;
/// Space above the panel without a legend, for the title; left of it; right; below.
const TITLE_PX: f64 = 38.0;
const LEFT_PX: f64 = 78.0;
const RIGHT_PX: f64 = 20.0;
const BELOW_PX: f64 = 50.0;
/// Horizontal margins of a panel on its sheet.
pub(super) const MARGINS_PX: f64 = LEFT_PX + RIGHT_PX;
/// Height of a row of the legend.
const ROW_PX: f64 = 19.0;
const SWATCH_PX: f64 = 22.0;
/// Mean width of a letter of the labels.
const LETTER_PX: f64 = 6.6;

/// Symbol of an entry in the legend, as drawn in the panel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Swatch {
    Dots,
    Line,
    Dashes,
    /// A line with dots.
    Joined,
    /// The range from least to greatest value, with the median.
    Envelope,
    Bars,
    /// An arrow of this length, px.
    Arrow(f64),
    Ring,
}

/// An entry of the legend.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Entry {
    pub name: String,
    pub swatch: Swatch,
    pub colour: &'static str,
}

/// Style of a stroke.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stroke<'a> {
    pub colour: &'a str,
    pub width_px: f64,
    pub opacity: f64,
    pub dashed: bool,
}

impl<'a> Stroke<'a> {
    pub(super) fn solid(colour: &'a str, width_px: f64) -> Self {
        Self {
            colour,
            width_px,
            opacity: 1.0,
            dashed: false,
        }
    }

    pub(super) fn pale(self, opacity: f64) -> Self {
        Self { opacity, ..self }
    }

    pub(super) fn dashed(self) -> Self {
        Self {
            dashed: true,
            ..self
        }
    }

    fn attributes(&self) -> String {
        let Self {
            colour,
            width_px,
            opacity,
            dashed,
        } = self;
        let opacity = match opacity {
            1.0 => String::new(),
            opacity => format!(" stroke-opacity=\"{opacity}\""),
        };
        let dashes = if *dashed {
            " stroke-dasharray=\"6 3\""
        } else {
            ""
        };
        format!(
            "fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width_px}\" stroke-linecap=\"round\" stroke-linejoin=\"round\"{opacity}{dashes}"
        )
    }
}

/// The part of a text at its position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// A figure under construction. Positions are in px from the upper left corner.
pub(super) struct Sheet {
    pub x: Axis,
    pub y: Axis,
    left: f64,
    top: f64,
    right: f64,
    bottom: f64,
    size: (f64, f64),
    title: String,
    body: String,
}

/// A length to a tenth of a pixel, in its shortest form.
pub(super) fn px(v: f64) -> String {
    let text = format!("{v:.1}");
    text.strip_suffix(".0").map_or(text.clone(), str::to_owned)
}

/// A text escaped for SVG.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

impl Sheet {
    /// An empty panel with title, legend, axes, ticks and grid; `right_px` more are left free to its right.
    pub(super) fn new(
        (width, height): (f64, f64),
        right_px: f64,
        labels: &Labels,
        axes: (Axis, Axis),
        legend: &[Entry],
    ) -> Self {
        let right = width - RIGHT_PX - right_px;
        let rows = rows(legend, right - LEFT_PX);
        let top = TITLE_PX + ROW_PX * rows.len() as f64;
        // Further rows of the legend increase the height instead of shrinking the panel.
        let height = height + ROW_PX * rows.len().saturating_sub(1) as f64;
        let mut sheet = Self {
            x: axes.0,
            y: axes.1,
            left: LEFT_PX,
            top,
            right,
            bottom: height - BELOW_PX,
            size: (width, height),
            title: labels.title.clone(),
            body: String::new(),
        };
        sheet.draw_title();
        for (n, row) in rows.iter().enumerate() {
            sheet.draw_legend(row, TITLE_PX + ROW_PX * (n as f64 + 0.3));
        }
        sheet.draw_grid(labels);
        sheet
    }

    /// Left, top, right and bottom of the panel.
    pub(super) fn panel(&self) -> [f64; 4] {
        [self.left, self.top, self.right, self.bottom]
    }

    /// Position of a point on the sheet, limited to 5 panels from it.
    pub(super) fn place(&self, point: (f64, f64)) -> (f64, f64) {
        let fraction = self.fraction(point).map(|part| part.clamp(-5.0, 6.0));
        self.at(fraction)
    }

    /// Position of a point on the sheet, without a limit.
    pub(super) fn unclipped(&self, point: (f64, f64)) -> (f64, f64) {
        self.at(self.fraction(point))
    }

    /// Position of a point in the panel, from 0 at its lower left corner to 1 at its upper right one.
    fn fraction(&self, (x, y): (f64, f64)) -> [f64; 2] {
        [self.x.fraction(x), self.y.fraction(y)]
    }

    fn at(&self, [across, up]: [f64; 2]) -> (f64, f64) {
        let (width, height) = (self.right - self.left, self.bottom - self.top);
        (self.left + across * width, self.bottom - up * height)
    }

    /// The parts of a line that lie in the panel, as positions on the sheet.
    pub(super) fn parts(&self, line: &[(f64, f64)]) -> Vec<Vec<(f64, f64)>> {
        let line: Vec<(f64, f64)> = line.iter().map(|point| self.unclipped(*point)).collect();
        clip::line(&line, self.panel())
    }

    /// Points on the sheet joined by a line; a single one is a dot of the line's width.
    pub(super) fn line(&mut self, points: &[(f64, f64)], stroke: Stroke<'_>) {
        let Some(((x, y), others)) = points.split_first() else {
            return;
        };
        let mut path = format!("M{} {}", px(*x), px(*y));
        if others.is_empty() {
            path += "h0";
        }
        for (x, y) in others {
            let _ = write!(path, "L{} {}", px(*x), px(*y));
        }
        self.path(&path, stroke);
    }

    /// Round dots on the sheet.
    pub(super) fn dots(&mut self, at: &[(f64, f64)], stroke: Stroke<'_>) {
        let dot = |(x, y): &(f64, f64)| format!("M{} {}h0", px(*x), px(*y));
        self.path(&at.iter().map(dot).collect::<String>(), stroke);
    }

    /// A ring around a position on the sheet.
    pub(super) fn ring(&mut self, (x, y): (f64, f64), radius_px: f64, stroke: Stroke<'_>) {
        let (left, r, across) = (px(x - radius_px), px(radius_px), px(2.0 * radius_px));
        let ring = format!(
            "M{left} {}a{r} {r} 0 1 0 {across} 0a{r} {r} 0 1 0 -{across} 0",
            px(y)
        );
        self.path(&ring, stroke);
    }

    /// A path in SVG syntax.
    pub(super) fn path(&mut self, path: &str, stroke: Stroke<'_>) {
        if !path.is_empty() {
            let _ = writeln!(self.body, "<path d=\"{path}\" {}/>", stroke.attributes());
        }
    }

    /// A filled rectangle between two corners on the sheet.
    pub(super) fn rectangle(&mut self, (x0, y0): (f64, f64), (x1, y1): (f64, f64), fill: &str) {
        let (x, y, width, height) = (x0.min(x1), y0.min(y1), (x1 - x0).abs(), (y1 - y0).abs());
        let _ = writeln!(
            self.body,
            "<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" fill=\"{fill}\"/>"
        );
    }

    pub(super) fn text(&mut self, (x, y): (f64, f64), anchor: Anchor, text: &str) {
        self.styled_text((x, y), anchor, text, "");
    }

    fn styled_text(&mut self, (x, y): (f64, f64), anchor: Anchor, text: &str, style: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let _ = writeln!(
            self.body,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"{anchor}\"{style}>{}</text>",
            px(x),
            px(y),
            escaped(text)
        );
    }

    /// An arrow between two positions on the sheet; a very short one is a dot.
    pub(super) fn arrow(&mut self, from: (f64, f64), to: (f64, f64), colour: &'static str) {
        const HEAD_PX: f64 = 5.0;
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let length = dx.hypot(dy);
        let stroke = Stroke::solid(colour, 1.2);
        self.dots(&[from], Stroke::solid(colour, 2.4));
        if length < 1.0 {
            return;
        }
        let head = HEAD_PX.min(length * 0.6) / length;
        let barb = |side: f64| {
            let (x, y) = (
                to.0 - head * (dx - side * dy),
                to.1 - head * (dy + side * dx),
            );
            format!("M{} {}L{} {}", px(to.0), px(to.1), px(x), px(y))
        };
        self.line(&[from, to], stroke);
        self.path(&format!("{}{}", barb(0.45), barb(-0.45)), stroke);
    }

    fn draw_title(&mut self) {
        let title = self.title.clone();
        let style = " font-size=\"16\" font-weight=\"bold\"";
        self.styled_text((LEFT_PX, 24.0), Anchor::Start, &title, style);
    }

    fn draw_legend(&mut self, row: &[Entry], y: f64) {
        let mut x = self.left;
        for entry in row {
            self.draw_swatch(entry, x, y);
            let text = (x + swatch_px(entry) + 6.0, y + 4.0);
            self.text(text, Anchor::Start, &entry.name);
            x += width(entry);
        }
    }

    fn draw_swatch(&mut self, entry: &Entry, x: f64, y: f64) {
        let colour = entry.colour;
        let ends = [(x, y), (x + SWATCH_PX, y)];
        let dots = [
            (x + 4.0, y),
            (x + SWATCH_PX / 2.0, y),
            (x + SWATCH_PX - 4.0, y),
        ];
        let dot = Stroke::solid(colour, DOT_PX);
        match entry.swatch {
            Swatch::Dots => self.dots(&dots, dot),
            Swatch::Line => self.line(&ends, Stroke::solid(colour, 1.6)),
            Swatch::Dashes => self.line(&ends, Stroke::solid(colour, 1.4).dashed()),
            Swatch::Joined => {
                self.line(&ends, Stroke::solid(colour, 1.6));
                self.dots(&dots[1..2], dot);
            }
            Swatch::Envelope => {
                self.line(&ends, Stroke::solid(colour, 9.0).pale(0.3));
                self.line(&ends, Stroke::solid(colour, 1.2));
            }
            Swatch::Ring => {
                self.ring((x + SWATCH_PX / 2.0, y), 5.0, Stroke::solid(colour, 1.6));
            }
            Swatch::Arrow(length) => self.arrow((x, y), (x + length, y), colour),
            Swatch::Bars => self.rectangle((x, y - 6.0), (x + SWATCH_PX, y + 6.0), "#9ec5de"),
        }
    }

    fn draw_grid(&mut self, labels: &Labels) {
        let grid = Stroke::solid("#dddddd", 0.8);
        let frame = Stroke::solid("#888888", 1.0);
        let (left, right, top, bottom) = (self.left, self.right, self.top, self.bottom);
        let label_px = match labels.x {
            Horizontal::Number(_) => 90.0,
            Horizontal::Utc => 100.0,
        };
        let across = ((right - left) / label_px) as usize;
        let mut dates = Vec::new();
        for tick in self.x.ticks(across) {
            let (x, _) = self.place((tick.at, self.y.low));
            self.line(&[(x, top), (x, bottom)], grid);
            // Shift a label at the panel's end so that it is not cut.
            let half_px = LETTER_PX * tick.label.chars().count() as f64 / 2.0;
            let x = x.min(self.size.0 - half_px);
            self.text((x, bottom + 16.0), Anchor::Middle, &tick.label);
            if let Some(date) = tick.date {
                self.text((x, bottom + 31.0), Anchor::Middle, &date);
                dates.push(date);
            }
        }
        for tick in self.y.ticks(((bottom - top) / 38.0) as usize) {
            let (_, y) = self.place((self.x.low, tick.at));
            self.line(&[(left, y), (right, y)], grid);
            self.text((left - 7.0, y + 4.0), Anchor::End, &tick.label);
        }
        let corners = [
            (left, top),
            (right, top),
            (right, bottom),
            (left, bottom),
            (left, top),
        ];
        self.line(&corners, frame);
        self.draw_names(labels);
    }

    fn draw_names(&mut self, labels: &Labels) {
        let power = |axis: Axis| match axis.exponent() {
            0 => String::new(),
            power => format!(" \u{d7} 10{}", superscript(power)),
        };
        let below = (f64::midpoint(self.left, self.right), self.bottom + 36.0);
        match &labels.x {
            Horizontal::Number(name) => {
                let name = format!("{name}{}", power(self.x));
                self.text(below, Anchor::Middle, &name);
            }
            Horizontal::Utc => {
                let at = (self.right, self.bottom + 45.0);
                self.text(at, Anchor::End, "UTC");
            }
        }
        let name = format!("{}{}", labels.y, power(self.y));
        let y = f64::midpoint(self.top, self.bottom);
        let style = format!(" transform=\"rotate(-90 18 {})\"", px(y));
        self.styled_text((18.0, y), Anchor::Middle, &name, &style);
    }

    /// The SVG.
    pub(super) fn finish(self) -> String {
        self.finish_at(0.0)
    }

    /// The SVG, placed `y` px below the top of an enclosing one.
    pub(super) fn finish_at(self, y: f64) -> String {
        let (width, height) = (px(self.size.0), px(self.size.1));
        let title = escaped(&self.title);
        let y = match y {
            0.0 => String::new(),
            y => format!(" y=\"{}\"", px(y)),
        };
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\"{y} width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
             role=\"img\" aria-label=\"{title}\" font-family=\"sans-serif\" font-size=\"12\" fill=\"#222222\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n{}</svg>\n",
            self.body
        )
    }
}

fn swatch_px(entry: &Entry) -> f64 {
    match entry.swatch {
        Swatch::Arrow(length) => length,
        _ => SWATCH_PX,
    }
}

/// Width of an entry with the space behind it, px.
fn width(entry: &Entry) -> f64 {
    swatch_px(entry) + 6.0 + LETTER_PX * entry.name.chars().count() as f64 + 22.0
}

/// Arranges the entries in rows of a width.
fn rows(legend: &[Entry], width_px: f64) -> Vec<Vec<Entry>> {
    let mut rows: Vec<Vec<Entry>> = Vec::new();
    let mut free_px = 0.0;
    for entry in legend.iter().filter(|entry| !entry.name.is_empty()) {
        let width_of = width(entry);
        match rows.last_mut() {
            Some(row) if width_of <= free_px => row.push(entry.clone()),
            _ => {
                rows.push(vec![entry.clone()]);
                free_px = width_px;
            }
        }
        free_px -= width_of;
    }
    rows
}
