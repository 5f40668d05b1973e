//! Artwork as SVG: the unit of its coordinates is the mm, y grows downwards.

use super::{Artwork, Item, Layer, Shape, on_grid};
use nalgebra::Vector2;
use svg::Document;
use svg::node::element::{Group, Line, Path, Text, Title};

/// Height of a capital letter of common fonts, relative to the font's size.
const CAPITAL: f64 = 0.72;

pub(super) fn write(artwork: &Artwork) -> Vec<u8> {
    let (frame, size) = (artwork.frame, artwork.frame.size());
    let [left, top] = down(Vector2::new(frame.low.x, frame.high.y));
    let document = Document::new()
        .set("width", format!("{}mm", size.x))
        .set("height", format!("{}mm", size.y))
        .set("viewBox", (left, top, size.x, size.y))
        .add(Title::new(artwork.title.join("; ")));
    // The even-odd rule cuts the marks out of the ground: both are one path.
    let groups = artwork.items.chunk_by(|a, b| group(a) == group(b));
    let document = groups.fold(document, |document, items| match items.first() {
        Some(first) => document.add(drawn(group(first), items)),
        None => document,
    });
    document.to_string().into_bytes()
}

fn group(item: &Item) -> Layer {
    match item.layer {
        Layer::Ground => Layer::Marks,
        layer => layer,
    }
}

fn drawn(layer: Layer, items: &[Item]) -> Group {
    let mut filled = String::new();
    let mut group = Group::new().set("id", layer.name());
    for item in items {
        match &item.shape {
            Shape::Polygon(corners) => filled += &polygon(corners),
            Shape::Circle {
                centre,
                diameter_mm,
            } => filled += &circle(*centre, *diameter_mm),
            Shape::Line { from, to, width_mm } => group = group.add(line(*from, *to, *width_mm)),
            Shape::Text {
                start,
                height_mm,
                text,
            } => group = group.add(words(*start, *height_mm, text)),
        }
    }
    if filled.is_empty() {
        return group;
    }
    let path = Path::new().set("d", filled).set("fill-rule", "evenodd");
    group.add(path.set("fill", "black"))
}

/// A closed part of a path. The crate's own paths have only single precision.
fn polygon(corners: &[Vector2<f64>]) -> String {
    let corners = corners.iter().map(|corner| {
        let [x, y] = down(*corner);
        format!("{x},{y}")
    });
    format!("M{}Z", corners.collect::<Vec<_>>().join("L"))
}

/// A circle as two half circles of a path.
fn circle(centre: Vector2<f64>, diameter_mm: f64) -> String {
    let ([x, y], radius_mm) = (down(centre), diameter_mm / 2.0);
    let half = |along_mm: f64| format!("a{radius_mm},{radius_mm},0,1,0,{along_mm},0");
    let [right, left] = [half(diameter_mm), half(-diameter_mm)];
    format!("M{},{y}{right}{left}Z", on_grid(x - radius_mm))
}

fn line(from: Vector2<f64>, to: Vector2<f64>, width_mm: f64) -> Line {
    let ([x1, y1], [x2, y2]) = (down(from), down(to));
    Line::new()
        .set("x1", x1)
        .set("y1", y1)
        .set("x2", x2)
        .set("y2", y2)
        .set("stroke", "black")
        .set("stroke-width", width_mm)
        .set("stroke-linecap", "square")
}

fn words(start: Vector2<f64>, height_mm: f64, text: &str) -> Text {
    let [x, y] = down(start);
    Text::new(text)
        .set("x", x)
        .set("y", y)
        .set("font-family", "sans-serif")
        .set("font-size", on_grid(height_mm / CAPITAL))
}

/// Coordinates with y downwards, as in SVG.
fn down(at: Vector2<f64>) -> [f64; 2] {
    [at.x, 0.0 - at.y]
}
