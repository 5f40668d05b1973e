//! Artwork as Gerber (RS-274X with attributes), in mm.
//!
//! The format has no letters: words are flashed as rectangles. A comment repeats them for text searches in the file.

use super::{Artwork, Item, Layer, Rectangle, Shape, Tone, letters, on_grid};
use crate::provenance::VERSION;
use gerber_types::{
    Aperture, ApertureDefinition, Circle, Command, CommentContent, CoordinateFormat,
    CoordinateMode, CoordinateNumber, Coordinates, DCode, ExtendedCode, FileAttribute,
    FileFunction, FilePolarity, FunctionCode, GCode, GenerationSoftware, GerberCode, GerberError,
    InterpolationMode, MCode, Operation, Part, Polarity, Rectangular, Unit, ZeroOmission,
};
use nalgebra::Vector2;

/// Coordinates are whole nanometres, below 10 m.
fn format() -> CoordinateFormat {
    CoordinateFormat::new(ZeroOmission::Leading, CoordinateMode::Absolute, 4, 6)
}

/// The lowest number of an aperture.
const FIRST_APERTURE: i32 = 10;

pub(super) fn write(artwork: &Artwork) -> Result<Vec<u8>, GerberError> {
    let apertures = Apertures::of(artwork);
    let mut commands = head(artwork);
    commands.extend(apertures.definitions());
    commands.push(FunctionCode::GCode(GCode::InterpolationMode(InterpolationMode::Linear)).into());
    for items in artwork.items.chunk_by(|a, b| a.layer == b.layer) {
        if let Some(first) = items.first() {
            commands.push(comment(first.layer.name()));
            commands.push(ExtendedCode::LoadPolarity(polarity(first.layer, artwork.tone)).into());
        }
        commands.extend(items.iter().flat_map(|item| apertures.drawn(item)));
    }
    commands.push(FunctionCode::MCode(MCode::EndOfFile).into());
    let mut bytes = Vec::new();
    commands.serialize(&mut bytes)?;
    Ok(bytes)
}

fn head(artwork: &Artwork) -> Vec<Command> {
    let software = GenerationSoftware::new("solaspect", "solaspect", Some(VERSION));
    let attributes = [
        FileAttribute::GenerationSoftware(software),
        FileAttribute::Part(Part::Other("Fiducial plate".into())),
        FileAttribute::FileFunction(FileFunction::Other("Fiducial plate".into())),
        FileAttribute::FilePolarity(FilePolarity::Positive),
    ];
    let title = artwork.title.iter().map(|line| comment(line));
    title
        .chain([
            ExtendedCode::CoordinateFormat(format()).into(),
            ExtendedCode::Unit(Unit::Millimeters).into(),
        ])
        .chain(attributes.map(|attribute| ExtendedCode::FileAttribute(attribute).into()))
        .collect()
}

/// Marks cut from the ground are drawn in the opposite polarity.
fn polarity(layer: Layer, tone: Tone) -> Polarity {
    match (layer, tone) {
        (Layer::Marks, Tone::ClearMarks) => Polarity::Clear,
        _ => Polarity::Dark,
    }
}

/// The apertures of an artwork, each once, in the order of their first use.
struct Apertures(Vec<Aperture>);

impl Apertures {
    fn of(artwork: &Artwork) -> Self {
        let mut apertures = Vec::new();
        for aperture in artwork.items.iter().flat_map(|item| used(&item.shape)) {
            if !apertures.contains(&aperture) {
                apertures.push(aperture);
            }
        }
        Self(apertures)
    }

    fn definitions(&self) -> impl Iterator<Item = Command> {
        let numbered = (FIRST_APERTURE..).zip(&self.0);
        numbered.map(|(code, aperture)| {
            let aperture = aperture.clone();
            ExtendedCode::ApertureDefinition(ApertureDefinition { code, aperture }).into()
        })
    }

    fn select(&self, aperture: &Aperture) -> Option<Command> {
        let mut numbered = (FIRST_APERTURE..).zip(&self.0);
        let (code, _) = numbered.find(|(_, known)| *known == aperture)?;
        Some(FunctionCode::DCode(DCode::SelectAperture(code)).into())
    }

    fn drawn(&self, item: &Item) -> Vec<Command> {
        match &item.shape {
            Shape::Polygon(corners) => region(corners),
            Shape::Circle {
                centre,
                diameter_mm,
            } => (self.select(&round(*diameter_mm)).into_iter())
                .chain([flash(*centre)])
                .collect(),
            Shape::Line { from, to, width_mm } => (self.select(&round(*width_mm)).into_iter())
                .chain([move_to(*from), line_to(*to)])
                .collect(),
            Shape::Text {
                start,
                height_mm,
                text,
            } => {
                let rectangles = letters::rectangles(*start, *height_mm, text);
                let flashes = rectangles.flat_map(|rectangle| {
                    let aperture = self.select(&rectangular(&rectangle));
                    let centre = (rectangle.low + rectangle.high) / 2.0;
                    aperture.into_iter().chain([flash(centre)])
                });
                [comment(text)].into_iter().chain(flashes).collect()
            }
        }
    }
}

/// The apertures of a shape.
fn used(shape: &Shape) -> Vec<Aperture> {
    match shape {
        Shape::Polygon(_) => Vec::new(),
        Shape::Circle { diameter_mm, .. } => vec![round(*diameter_mm)],
        Shape::Line { width_mm, .. } => vec![round(*width_mm)],
        Shape::Text {
            start,
            height_mm,
            text,
        } => letters::rectangles(*start, *height_mm, text)
            .map(|rectangle| rectangular(&rectangle))
            .collect(),
    }
}

fn round(diameter_mm: f64) -> Aperture {
    Aperture::Circle(Circle::new(diameter_mm))
}

fn rectangular(rectangle: &Rectangle) -> Aperture {
    let size = rectangle.size().map(on_grid);
    Aperture::Rectangle(Rectangular::new(size.x, size.y))
}

fn region(corners: &[Vector2<f64>]) -> Vec<Command> {
    let mode = |on| FunctionCode::GCode(GCode::RegionMode(on)).into();
    let Some((first, others)) = corners.split_first() else {
        return Vec::new();
    };
    let lines = others.iter().chain([first]).map(|corner| line_to(*corner));
    ([mode(true), move_to(*first)].into_iter())
        .chain(lines)
        .chain([mode(false)])
        .collect()
}

fn flash(centre: Vector2<f64>) -> Command {
    operation(Operation::Flash(at(centre)))
}

fn move_to(to: Vector2<f64>) -> Command {
    operation(Operation::Move(at(to)))
}

fn line_to(to: Vector2<f64>) -> Command {
    operation(Operation::Interpolate(at(to), None))
}

fn operation(operation: Operation) -> Command {
    FunctionCode::DCode(DCode::Operation(operation)).into()
}

fn at(place: Vector2<f64>) -> Option<Coordinates> {
    let [x, y] = [place.x, place.y].map(|mm| CoordinateNumber::new((mm * 1e6).round() as i64));
    Some(Coordinates::new(x, y, format()))
}

/// A comment on one line; characters that end a command are escaped.
fn comment(text: &str) -> Command {
    let escaped = text.replace('%', "\\u0025").replace('*', "\\u002A");
    FunctionCode::GCode(GCode::Comment(CommentContent::String(escaped))).into()
}
