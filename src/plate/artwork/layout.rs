//! Surroundings of the marks: frame, scale bar, orientation corner and title, all outside of the marks' field.

use super::{Rectangle, Shape, point};
use nalgebra::Vector2;

/// Gap between neighbours, mm.
const GAP_MM: f64 = 3.0;
/// Height of a capital letter, mm.
const TEXT_MM: f64 = 2.0;
/// Distance between baselines, mm.
const LINE_MM: f64 = 3.5;
const FRAME_WIDTH_MM: f64 = 0.2;
const BAR_HEIGHT_MM: f64 = 1.0;
/// Length of the legs of the orientation corner, mm.
const CORNER_MM: f64 = 8.0;
/// A field narrower than this has the short scale bar.
const WIDE_MM: f64 = 110.0;

pub(super) const CORNER_WORDS: &str = "+X +Y";

/// Positions of all parts of the artwork.
pub(super) struct Layout {
    /// Field of the marks.
    pub field: Rectangle,
    /// Frame around everything.
    pub frame: Rectangle,
    bar_length_mm: f64,
}

impl Layout {
    pub fn new(field: Rectangle, title: &[String]) -> Self {
        let width_mm = field.size().x;
        let bar_length_mm = if width_mm < WIDE_MM { 10.0 } else { 100.0 };
        let texts = title.iter().map(|line| text_width_mm(line));
        let width_mm = texts.fold(width_mm.max(bar_length_mm), f64::max) + 2.0 * GAP_MM;
        let left = (field.low.x + field.high.x - width_mm) / 2.0;
        // The label of the bar has a line of its own.
        let lines_mm = LINE_MM * (1 + title.len()) as f64;
        let below_mm = GAP_MM + BAR_HEIGHT_MM + lines_mm + GAP_MM;
        let above_mm = GAP_MM + CORNER_MM + GAP_MM;
        Self {
            field,
            frame: Rectangle {
                low: point(left, field.low.y - below_mm),
                high: point(left + width_mm, field.high.y + above_mm),
            },
            bar_length_mm,
        }
    }

    /// Lines whose outer edges are the frame.
    pub fn frame_lines(&self) -> impl Iterator<Item = Shape> + use<> {
        let middles = Rectangle {
            low: self.frame.low.add_scalar(FRAME_WIDTH_MM / 2.0),
            high: self.frame.high.add_scalar(-FRAME_WIDTH_MM / 2.0),
        };
        let corners = middles.corners();
        let next = corners.into_iter().cycle().skip(1);
        corners.into_iter().zip(next).map(|(from, to)| Shape::Line {
            from,
            to,
            width_mm: FRAME_WIDTH_MM,
        })
    }

    /// Upper left corner of the scale bar.
    fn bar_corner(&self) -> Vector2<f64> {
        point(self.frame.low.x + GAP_MM, self.field.low.y - GAP_MM)
    }

    pub fn scale_bar(&self) -> impl Iterator<Item = Shape> + use<> {
        let corner = self.bar_corner();
        let bar = Rectangle {
            low: point(corner.x, corner.y - BAR_HEIGHT_MM),
            high: point(corner.x + self.bar_length_mm, corner.y),
        };
        let label = format!("{} mm", self.bar_length_mm);
        [Shape::Polygon(bar.corners().into()), self.line(0, label)].into_iter()
    }

    /// A triangle in the corner at +X and +Y, and words beside it.
    pub fn orientation(&self) -> impl Iterator<Item = Shape> + use<> {
        let tip = point(self.frame.high.x - GAP_MM, self.frame.high.y - GAP_MM);
        let legs = [
            tip,
            point(tip.x - CORNER_MM, tip.y),
            point(tip.x, tip.y - CORNER_MM),
        ];
        let words_end = tip.x - CORNER_MM - GAP_MM;
        let start = point(words_end - text_width_mm(CORNER_WORDS), tip.y - TEXT_MM);
        [
            Shape::Polygon(legs.into()),
            text(start, CORNER_WORDS.into()),
        ]
        .into_iter()
    }

    pub fn title(&self, title: &[String]) -> impl Iterator<Item = Shape> {
        let lines = title.iter().enumerate();
        lines.map(|(number, line)| self.line(1 + number, line.clone()))
    }

    /// The n-th line of text below the scale bar.
    fn line(&self, number: usize, line: String) -> Shape {
        let corner = self.bar_corner();
        let down_mm = BAR_HEIGHT_MM + LINE_MM * (1 + number) as f64;
        text(point(corner.x, corner.y - down_mm), line)
    }
}

/// Upper bound of a text's width: letters are about as wide as high, and narrower in most fonts.
fn text_width_mm(text: &str) -> f64 {
    TEXT_MM * text.chars().count() as f64
}

fn text(start: Vector2<f64>, text: String) -> Shape {
    Shape::Text {
        start,
        height_mm: TEXT_MM,
        text,
    }
}
