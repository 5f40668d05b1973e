//! Artwork as DXF of AutoCAD 2000, in mm. Ground and marks are closed outlines on separate layers.

use super::{Artwork, Layer, Shape};
use dxf::entities::{Circle, Entity, EntityType, LwPolyline, Text};
use dxf::enums::{AcadVersion, DrawingUnits, Units};
use dxf::{Drawing, DxfResult, Header, LwPolylineVertex, Point, tables};
use nalgebra::Vector2;
use std::time::Duration;

const FROM_1900_TO_1970: Duration = Duration::from_secs(25_567 * 86_400);

pub(super) fn write(artwork: &Artwork) -> DxfResult<Vec<u8>> {
    let mut drawing = Drawing::new();
    set_header(&mut drawing, artwork);
    for layer in Layer::ALL {
        drawing.add_layer(tables::Layer {
            name: name(layer),
            ..tables::Layer::default()
        });
    }
    for item in &artwork.items {
        let mut entity = Entity::new(entity(&item.shape));
        entity.common.layer = name(item.layer);
        drawing.add_entity(entity);
    }
    let mut bytes = Vec::new();
    drawing.save(&mut bytes)?;
    Ok(bytes)
}

fn name(layer: Layer) -> String {
    layer.name().to_uppercase()
}

fn set_header(drawing: &mut Drawing, artwork: &Artwork) {
    let header = &mut drawing.header;
    // The first version that states its unit.
    header.version = AcadVersion::R2000;
    header.default_drawing_units = Units::Millimeters;
    header.drawing_units = DrawingUnits::Metric;
    header.minimum_drawing_extents = flat(artwork.frame.low);
    header.maximum_drawing_extents = flat(artwork.frame.high);
    // One drawing gives identical files, independent of place and time.
    header.fingerprint_guid = Default::default();
    header.version_guid = Default::default();
    set_dates(header);
}

/// The format requires dates, also in local time. All are set to the crate's epoch, the only one that no time zone shifts.
fn set_dates(header: &mut Header) {
    header.creation_date_universal = Default::default();
    let first = header.creation_date_universal.naive_utc() - FROM_1900_TO_1970;
    header.creation_date_universal = first.and_utc();
    header.update_date_universal = first.and_utc();
    let zone = header.creation_date.timezone();
    if let Some(first) = first.and_local_timezone(zone).earliest() {
        header.creation_date = first;
        header.update_date = first;
    }
}

fn entity(shape: &Shape) -> EntityType {
    match shape {
        Shape::Polygon(corners) => EntityType::LwPolyline(polyline(corners, true)),
        Shape::Circle {
            centre,
            diameter_mm,
        } => EntityType::Circle(Circle::new(flat(*centre), diameter_mm / 2.0)),
        Shape::Line { from, to, width_mm } => EntityType::LwPolyline(LwPolyline {
            constant_width: *width_mm,
            ..polyline(&[*from, *to], false)
        }),
        Shape::Text {
            start,
            height_mm,
            text,
        } => EntityType::Text(Text {
            location: flat(*start),
            text_height: *height_mm,
            value: text.clone(),
            ..Text::default()
        }),
    }
}

fn polyline(corners: &[Vector2<f64>], is_closed: bool) -> LwPolyline {
    let vertex = |corner: &Vector2<f64>| LwPolylineVertex {
        x: corner.x,
        y: corner.y,
        ..LwPolylineVertex::default()
    };
    let mut line = LwPolyline {
        vertices: corners.iter().map(vertex).collect(),
        ..LwPolyline::default()
    };
    line.set_is_closed(is_closed);
    line
}

fn flat(at: Vector2<f64>) -> Point {
    Point::new(at.x, at.y, 0.0)
}
