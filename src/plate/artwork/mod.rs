//! Artwork of a plate at true scale: one list of shapes, written as SVG, DXF and Gerber.
//!
//! Lengths are in mm from the plate's centre, +X to the right and +Y up, as seen on the drawn side. Every coordinate is a
//! whole number of nanometres, which all three formats can represent.

mod dxf;
mod gerber;
mod layout;
mod letters;
mod svg;
#[cfg(test)]
mod tests;

use super::{Cross, MarkShape, Plate};
use crate::units::{MIL_MM, PlateMil};
use layout::Layout;
use nalgebra::Vector2;

/// Whether the marks are printed or left clear.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tone {
    /// Dark marks on clear ground.
    DarkMarks,
    /// Clear marks on a dark ground.
    ClearMarks,
}

/// Group of a shape, in the order of drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layer {
    /// Ground from which clear marks are cut.
    Ground,
    Marks,
    Frame,
    ScaleBar,
    /// The corner that reveals a mirrored print.
    Orientation,
    Title,
}

impl Layer {
    pub const ALL: [Self; 6] = [
        Self::Ground,
        Self::Marks,
        Self::Frame,
        Self::ScaleBar,
        Self::Orientation,
        Self::Title,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Ground => "ground",
            Self::Marks => "marks",
            Self::Frame => "frame",
            Self::ScaleBar => "scale",
            Self::Orientation => "orientation",
            Self::Title => "title",
        }
    }
}

/// A shape, in mm.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// Filled; the last corner is joined to the first.
    Polygon(Vec<Vector2<f64>>),
    /// Filled.
    Circle {
        centre: Vector2<f64>,
        diameter_mm: f64,
    },
    Line {
        from: Vector2<f64>,
        to: Vector2<f64>,
        width_mm: f64,
    },
    Text {
        /// Left end of the baseline.
        start: Vector2<f64>,
        /// Height of a capital letter.
        height_mm: f64,
        text: String,
    },
}

/// A shape on its layer.
#[derive(Debug, Clone, PartialEq)]
pub struct Item {
    pub layer: Layer,
    pub shape: Shape,
}

/// A rectangle along the plate's axes, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle {
    pub low: Vector2<f64>,
    pub high: Vector2<f64>,
}

impl Rectangle {
    pub fn size(&self) -> Vector2<f64> {
        self.high - self.low
    }

    /// Its corners, counterclockwise.
    fn corners(&self) -> [Vector2<f64>; 4] {
        let Self { low, high } = self;
        [
            (low.x, low.y),
            (high.x, low.y),
            (high.x, high.y),
            (low.x, high.y),
        ]
        .map(|(x, y)| point(x, y))
    }
}

/// The artwork of a plate.
#[derive(Debug, Clone, PartialEq)]
pub struct Artwork {
    pub tone: Tone,
    /// Title of the artwork, in lines: the instrument, its marks, the hash of the drawing.
    pub title: Vec<String>,
    /// The frame around everything.
    pub frame: Rectangle,
    /// The items, ordered by layer.
    pub items: Vec<Item>,
}

/// A format cannot represent the artwork.
#[derive(Debug, thiserror::Error)]
pub enum ArtworkError {
    #[error("DXF: {0}")]
    Dxf(#[from] ::dxf::DxfError),
    #[error("Gerber: {0}")]
    Gerber(#[from] gerber_types::GerberError),
}

impl Artwork {
    /// The artwork of an instrument's plate: every mark at its drawn position; measured positions are ignored.
    pub fn new(instrument: &str, plate: &Plate, tone: Tone) -> Self {
        let title = title(instrument, plate);
        let layout = Layout::new(field(plate), &title);
        let item = |layer| move |shape| Item { layer, shape };
        let ground = match tone {
            Tone::DarkMarks => None,
            Tone::ClearMarks => Some(Shape::Polygon(layout.field.corners().into())),
        };
        let marks = plate.drawn_marks().map(|(_, at)| mark(plate.shape, at));
        let items = (ground.into_iter().map(item(Layer::Ground)))
            .chain(marks.map(item(Layer::Marks)))
            .chain(layout.frame_lines().map(item(Layer::Frame)))
            .chain(layout.scale_bar().map(item(Layer::ScaleBar)))
            .chain(layout.orientation().map(item(Layer::Orientation)))
            .chain(layout.title(&title).map(item(Layer::Title)));
        Self {
            tone,
            frame: layout.frame,
            items: items.collect(),
            title,
        }
    }

    /// The artwork's files: names and contents.
    ///
    /// # Errors
    /// If a format cannot represent the artwork.
    pub fn files(&self) -> Result<[(&'static str, Vec<u8>); 3], ArtworkError> {
        Ok([
            ("plate.svg", svg::write(self)),
            ("plate.dxf", dxf::write(self)?),
            ("plate.gbr", gerber::write(self)?),
        ])
    }

    /// The shapes of a layer.
    pub fn layer(&self, layer: Layer) -> impl Iterator<Item = &Shape> {
        let items = self.items.iter().filter(move |item| item.layer == layer);
        items.map(|item| &item.shape)
    }
}

/// A point rounded to the grid of all coordinates.
fn point(x_mm: f64, y_mm: f64) -> Vector2<f64> {
    Vector2::new(on_grid(x_mm), on_grid(y_mm))
}

/// The nearest whole number of nanometres, in mm.
fn on_grid(mm: f64) -> f64 {
    (mm * 1e6).round() / 1e6
}

fn mark(shape: MarkShape, at: PlateMil) -> Shape {
    match shape {
        MarkShape::Cross(cross) => {
            let corner = |offset: Vector2<f64>| {
                let corner = (at.vector() + shape.arms() * offset) * MIL_MM;
                point(corner.x, corner.y)
            };
            Shape::Polygon(cross_corners_mil(&cross).map(corner).into())
        }
        MarkShape::Dot { diameter_mil } => Shape::Circle {
            centre: point(at.x * MIL_MM, at.y * MIL_MM),
            diameter_mm: on_grid(diameter_mil * MIL_MM),
        },
    }
}

/// Corners of a cross along its arms, counterclockwise, relative to its centre.
fn cross_corners_mil(cross: &Cross) -> [Vector2<f64>; 12] {
    let (tip, side) = (cross.arm_length_mil / 2.0, cross.arm_width_mil / 2.0);
    [
        (tip, -side),
        (tip, side),
        (side, side),
        (side, tip),
        (-side, tip),
        (-side, side),
        (-tip, side),
        (-tip, -side),
        (-side, -side),
        (-side, -tip),
        (side, -tip),
        (side, -side),
    ]
    .map(|(u, v)| Vector2::new(u, v))
}

/// The bounding rectangle of all marks, with a margin of twice their size.
fn field(plate: &Plate) -> Rectangle {
    // From the centre of a mark to its end, plus the margin.
    let margin_mil = 2.5 * plate.shape.size_mil();
    let places = || plate.drawn_marks().map(|(_, at)| at.vector());
    let low = places().reduce(|a, b| a.inf(&b)).unwrap_or_default();
    let high = places().reduce(|a, b| a.sup(&b)).unwrap_or_default();
    let [low, high] = [low.add_scalar(-margin_mil), high.add_scalar(margin_mil)];
    let [low, high] = [low, high].map(|corner| point(corner.x * MIL_MM, corner.y * MIL_MM));
    Rectangle { low, high }
}

fn title(instrument: &str, plate: &Plate) -> Vec<String> {
    // Rounded to 0.1 um.
    let mm = |mil: f64| (mil * MIL_MM * 1e4).round() / 1e4;
    let count = plate.count();
    let marks = match plate.shape {
        MarkShape::Cross(Cross {
            arm_length_mil,
            arm_width_mil,
            arm_angle_deg,
        }) => {
            let [length_mm, width_mm] = [arm_length_mil, arm_width_mil].map(mm);
            [
                format!("{count} crosses, arms at {arm_angle_deg} deg from +X towards +Y"),
                format!("arms {length_mm} mm long, {width_mm} mm wide"),
            ]
        }
        MarkShape::Dot { diameter_mil } => [
            format!("{count} dots"),
            format!("diameter {} mm", mm(diameter_mil)),
        ],
    };
    let hash: String = plate.drawing_sha256().chars().take(16).collect();
    let [number, size] = marks;
    vec![instrument.into(), number, size, format!("drawing {hash}")]
}
