use super::*;
use crate::instrument::builtin;
use crate::plate::{MarkId, MarkPlace, Pattern};
use ::dxf::Drawing;
use ::dxf::entities::EntityType;
use gerber_types::{
    Aperture, Command, Coordinates, DCode, ExtendedCode, FunctionCode, GCode, Operation, Polarity,
};
use quick_xml::Reader;
use quick_xml::events::Event;
use std::collections::HashMap;
use std::io::BufReader;

/// Largest difference between a file and the drawing.
const TOLERANCE_MM: f64 = 1e-3;
const DOT: MarkShape = MarkShape::Dot { diameter_mil: 50.0 };

fn cross(arm_angle_deg: f64) -> MarkShape {
    MarkShape::Cross(Cross {
        arm_angle_deg,
        ..Cross::HEROES
    })
}

/// Marks at positions that are round numbers in no unit; one of them has a measured position.
fn plate(shape: MarkShape) -> Plate {
    let mark = |n: i32| {
        let angle = 2.4 * f64::from(n);
        let at = PlateMil::new(angle.cos(), angle.sin()).vector() * 61.7 * f64::from(n);
        (
            MarkId { i: n, j: 0 },
            MarkPlace::new((at + Vector2::new(500.0, -200.0)).into(), 1.0),
        )
    };
    let mut plate = Plate::new(Pattern::Listed, shape, 1.0, (4..40).map(mark));
    plate.set(MarkId { i: 9, j: 0 }, PlateMil::new(0.0, 0.0), [0.1; 2]);
    plate
}

/// Plates with every kind of mark, and the pattern of 2013.
fn plates() -> Vec<Plate> {
    let mut plates: Vec<Plate> = [cross(0.0), cross(30.0), DOT].map(plate).into();
    plates.push(builtin("demo").unwrap().plate);
    plates
}

fn artwork(plate: &Plate, tone: Tone) -> Artwork {
    Artwork::new("a <name> & more", plate, tone)
}

fn file(artwork: &Artwork, name: &str) -> Vec<u8> {
    let files = artwork.files().unwrap();
    let (_, bytes) = files.into_iter().find(|(known, _)| *known == name).unwrap();
    bytes
}

/// Compares the shapes of a file's marks, and of its ground, with the drawing.
fn check(plate: &Plate, tone: Tone, mut shapes: Vec<Shape>) {
    if tone == Tone::ClearMarks {
        let ground = shapes.remove(0);
        let field = Shape::Polygon(field(plate).corners().into());
        assert_eq!(ground, field, "the ground");
    }
    assert_eq!(shapes.len(), plate.count());
    for ((id, at), shape) in plate.drawn_marks().zip(&shapes) {
        let at = at.vector() * MIL_MM;
        match (plate.shape, shape) {
            (MarkShape::Cross(cross), Shape::Polygon(corners)) => {
                check_cross(&cross, plate.shape.arms(), at, corners);
            }
            (
                MarkShape::Dot { diameter_mil },
                Shape::Circle {
                    centre,
                    diameter_mm: d,
                },
            ) => {
                assert!((centre - at).norm() < TOLERANCE_MM, "{id}");
                assert!((d - diameter_mil * MIL_MM).abs() < TOLERANCE_MM, "{id}");
            }
            (shape, found) => panic!("{id}: {shape:?} is drawn as {found:?}"),
        }
    }
}

fn check_cross(
    cross: &Cross,
    arms: nalgebra::Matrix2<f64>,
    at: Vector2<f64>,
    corners: &[Vector2<f64>],
) {
    assert_eq!(corners.len(), 12);
    let centre = corners.iter().sum::<Vector2<f64>>() / 12.0;
    assert!((centre - at).norm() < TOLERANCE_MM, "{centre} for {at}");
    let [length_mm, width_mm] = [cross.arm_length_mil, cross.arm_width_mil].map(|v| v * MIL_MM);
    for corner in corners {
        let along = (arms.transpose() * (corner - at)).abs();
        let near = |a: f64, b: f64| (a - b / 2.0).abs() < TOLERANCE_MM;
        assert!(near(along.min(), width_mm), "{along}");
        assert!(
            near(along.max(), length_mm) || near(along.max(), width_mm),
            "{along}"
        );
    }
    let next = corners.iter().cycle().skip(1);
    let twice_area: f64 = corners.iter().zip(next).map(|(a, b)| a.perp(b)).sum();
    let area_mm2 = width_mm * (2.0 * length_mm - width_mm);
    // In SVG y grows downwards, so a cross may have the opposite orientation when it is read.
    assert!((twice_area.abs() / 2.0 - area_mm2).abs() < TOLERANCE_MM * 4.0 * length_mm);
}

/// The parts of a path, with y upwards.
fn parts(path: &str) -> Vec<Shape> {
    let numbers =
        |text: &str| -> Vec<f64> { text.split(',').map(|n| n.parse().unwrap()).collect() };
    let part = |part: &str| match part.split_once('a') {
        Some((start, arcs)) => {
            let (start, arc) = (numbers(start), numbers(arcs.split('a').next().unwrap()));
            Shape::Circle {
                centre: Vector2::new(start[0] + arc[0], -start[1]),
                diameter_mm: arc[5],
            }
        }
        None => {
            let corners = part.split('L').map(|corner| {
                let corner = numbers(corner);
                Vector2::new(corner[0], -corner[1])
            });
            Shape::Polygon(corners.collect())
        }
    };
    let parts = path.trim_end_matches('Z').split('Z');
    parts
        .map(|text| part(text.strip_prefix('M').unwrap()))
        .collect()
}

/// Attributes of an element.
type Attributes = HashMap<String, String>;

/// The elements of a picture, each with the id of its group.
fn elements(svg: &[u8]) -> Vec<(String, String, Attributes)> {
    let mut reader = Reader::from_reader(svg);
    let (mut buffer, mut group, mut elements) = (Vec::new(), String::new(), Vec::new());
    loop {
        let element = match reader.read_event_into(&mut buffer).unwrap() {
            Event::Start(element) | Event::Empty(element) => element.into_owned(),
            Event::Eof => return elements,
            _ => continue,
        };
        let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
        let attributes = element.attributes().map(|attribute| {
            let attribute = attribute.unwrap();
            (text(attribute.key.as_ref()), text(&attribute.value))
        });
        let attributes: Attributes = attributes.collect();
        if let Some(id) = attributes.get("id") {
            group.clone_from(id);
        }
        elements.push((group.clone(), text(element.name().as_ref()), attributes));
        buffer.clear();
    }
}

#[test]
fn svg_has_every_mark_where_the_drawing_has_it() {
    for (plate, tone) in plates_in_both_tones() {
        let svg = file(&artwork(&plate, tone), "plate.svg");
        let elements = elements(&svg);
        let paths: Vec<&Attributes> = elements
            .iter()
            .filter(|(group, name, _)| group == "marks" && name == "path")
            .map(|(_, _, attributes)| attributes)
            .collect();
        assert_eq!(paths.len(), 1, "ground and marks are one path");
        assert_eq!(paths[0]["fill-rule"], "evenodd");
        check(&plate, tone, parts(&paths[0]["d"]));
    }
}

#[test]
fn svg_is_at_true_scale() {
    let plate = plate(DOT);
    let artwork = artwork(&plate, Tone::DarkMarks);
    let elements = elements(&file(&artwork, "plate.svg"));
    let (_, name, attributes) = &elements[0];
    assert_eq!(name, "svg");
    let view: Vec<f64> = attributes["viewBox"]
        .split_whitespace()
        .map(|n| n.parse().unwrap())
        .collect();
    for (side, key) in [(view[2], "width"), (view[3], "height")] {
        assert_eq!(attributes[key], format!("{side}mm"));
    }
    let frame = artwork.frame;
    assert!((view[0] - frame.low.x).abs() < 1e-6 && (view[1] + frame.high.y).abs() < 1e-6);
}

fn plates_in_both_tones() -> impl Iterator<Item = (Plate, Tone)> {
    let tones = [Tone::DarkMarks, Tone::ClearMarks];
    plates()
        .into_iter()
        .flat_map(move |plate| tones.map(|tone| (plate.clone(), tone)))
}

#[test]
fn dxf_has_every_mark_where_the_drawing_has_it() {
    for (plate, tone) in plates_in_both_tones() {
        let bytes = file(&artwork(&plate, tone), "plate.dxf");
        let drawing = Drawing::load(&mut bytes.as_slice()).unwrap();
        let of = |layer: &str| -> Vec<Shape> {
            let entities = drawing.entities().filter(|e| e.common.layer == layer);
            entities.map(|entity| outline(&entity.specific)).collect()
        };
        let shapes = [of("GROUND"), of("MARKS")].concat();
        check(&plate, tone, shapes);
        assert_eq!(drawing.header.default_drawing_units as i16, 4, "mm");
    }
}

fn outline(entity: &EntityType) -> Shape {
    match entity {
        EntityType::LwPolyline(line) => {
            assert!(line.is_closed());
            let corners = line.vertices.iter().map(|v| Vector2::new(v.x, v.y));
            Shape::Polygon(corners.collect())
        }
        EntityType::Circle(circle) => Shape::Circle {
            centre: Vector2::new(circle.center.x, circle.center.y),
            diameter_mm: 2.0 * circle.radius,
        },
        other => panic!("{other:?}"),
    }
}

#[test]
fn dxf_has_the_words_as_text_and_the_same_bytes_each_time() {
    let plate = plate(DOT);
    let artwork = artwork(&plate, Tone::DarkMarks);
    let bytes = file(&artwork, "plate.dxf");
    assert_eq!(bytes, file(&artwork, "plate.dxf"));
    let drawing = Drawing::load(&mut bytes.as_slice()).unwrap();
    let texts = drawing
        .entities()
        .filter_map(|entity| match &entity.specific {
            EntityType::Text(text) => Some(text.value.as_str()),
            _ => None,
        });
    let texts: Vec<&str> = texts.collect();
    let hash = format!("drawing {}", &plate.drawing_sha256()[..16]);
    let expected = [
        "100 mm",
        "+X +Y",
        "a <name> & more",
        "36 dots",
        "diameter 1.27 mm",
        &hash,
    ];
    assert_eq!(texts, expected);
}

/// The shapes of a Gerber file, each with its polarity.
fn flashes_and_regions(bytes: &[u8]) -> Vec<(Polarity, Shape)> {
    let document = gerber_parser::parse(BufReader::new(bytes)).unwrap();
    assert!(document.errors().is_empty(), "{:?}", document.errors());
    let (mut shapes, mut polarity) = (Vec::new(), Polarity::Dark);
    let (mut region, mut apertures, mut selected) = (None, HashMap::new(), 0);
    for command in document.into_commands() {
        match command {
            Command::ExtendedCode(ExtendedCode::LoadPolarity(now)) => polarity = now,
            Command::ExtendedCode(ExtendedCode::ApertureDefinition(definition)) => {
                apertures.insert(definition.code, definition.aperture);
            }
            Command::FunctionCode(FunctionCode::GCode(GCode::RegionMode(true))) => {
                region = Some(Vec::new());
            }
            Command::FunctionCode(FunctionCode::GCode(GCode::RegionMode(false))) => {
                let mut corners: Vec<Vector2<f64>> = region.take().unwrap();
                assert_eq!(
                    corners.pop().as_ref(),
                    corners.first(),
                    "a region is closed"
                );
                shapes.push((polarity, Shape::Polygon(corners)));
            }
            Command::FunctionCode(FunctionCode::DCode(DCode::SelectAperture(code))) => {
                selected = code;
            }
            Command::FunctionCode(FunctionCode::DCode(DCode::Operation(operation))) => {
                match (operation, &mut region) {
                    (Operation::Flash(at), None) => {
                        let shape = flashed(&apertures[&selected], millimetres(at));
                        shapes.push((polarity, shape));
                    }
                    (Operation::Move(at) | Operation::Interpolate(at, None), Some(corners)) => {
                        corners.push(millimetres(at));
                    }
                    _ => {}
                }
            }
            _ => {}
        }
    }
    shapes
}

fn flashed(aperture: &Aperture, centre: Vector2<f64>) -> Shape {
    match aperture {
        Aperture::Circle(circle) => Shape::Circle {
            centre,
            diameter_mm: circle.diameter,
        },
        Aperture::Rectangle(sides) => Shape::Polygon(
            around(centre, Vector2::new(sides.x, sides.y))
                .corners()
                .into(),
        ),
        other => panic!("{other:?}"),
    }
}

fn around(centre: Vector2<f64>, size: Vector2<f64>) -> Rectangle {
    Rectangle {
        low: centre - size / 2.0,
        high: centre + size / 2.0,
    }
}

fn millimetres(at: Option<Coordinates>) -> Vector2<f64> {
    let at = at.unwrap();
    Vector2::new(at.x.unwrap().into(), at.y.unwrap().into())
}

#[test]
fn gerber_has_every_mark_where_the_drawing_has_it() {
    for (plate, tone) in plates_in_both_tones() {
        let artwork = artwork(&plate, tone);
        let mut shapes = flashes_and_regions(&file(&artwork, "plate.gbr"));
        let ground = usize::from(tone == Tone::ClearMarks);
        // After the marks: scale bar, orientation corner and words.
        let last = shapes.split_off(ground + plate.count());
        let clear = |(polarity, _): &(Polarity, Shape)| *polarity == Polarity::Clear;
        let marks = &shapes[ground..];
        assert!(
            marks
                .iter()
                .all(|mark| clear(mark) == (tone == Tone::ClearMarks))
        );
        assert!(!shapes[..ground].iter().chain(&last).any(clear));
        check(
            &plate,
            tone,
            shapes.into_iter().map(|(_, shape)| shape).collect(),
        );
    }
}

#[test]
fn gerber_draws_the_words_where_the_artwork_has_them() {
    for (plate, tone) in plates_in_both_tones() {
        let artwork = artwork(&plate, tone);
        let shapes = flashes_and_regions(&file(&artwork, "plate.gbr"));
        let drawn: Vec<[Vector2<f64>; 2]> = shapes
            .iter()
            .filter(|(polarity, _)| *polarity == Polarity::Dark)
            .map(|(_, shape)| extent(shape))
            .collect();
        for Rectangle { low, high } in words(&artwork) {
            let same = |[a, b]: &[Vector2<f64>; 2]| (a - low).amax().max((b - high).amax());
            assert!(drawn.iter().any(|drawn| same(drawn) < 2e-6), "{low}");
            assert!(low >= artwork.frame.low && high <= artwork.frame.high);
            assert!(low.y > field(&plate).high.y || high.y < field(&plate).low.y);
        }
    }
}

/// The rectangles of all letters.
fn words(artwork: &Artwork) -> impl Iterator<Item = Rectangle> {
    let texts = artwork.items.iter().filter_map(|item| match &item.shape {
        Shape::Text {
            start,
            height_mm,
            text,
        } => Some(letters::rectangles(*start, *height_mm, text)),
        _ => None,
    });
    texts.flatten()
}

#[test]
fn letters_are_as_high_as_stated_upright_and_in_order() {
    let start = Vector2::new(3.0, -7.0);
    let letters = |text| letters::rectangles(start, 2.0, text).collect::<Vec<_>>();
    let capital = letters("E");
    let low = capital.iter().map(|run| run.low).reduce(|a, b| a.inf(&b));
    let high = capital.iter().map(|run| run.high).reduce(|a, b| a.sup(&b));
    let (low, high) = (low.unwrap(), high.unwrap());
    assert!((low.y - start.y).abs() < 1e-6 && (high.y - start.y - 2.0).abs() < 1e-6);
    assert!(low.x >= start.x && high.x <= start.x + 2.0);
    // The foot of an L is its longest run, and its stem is on the left.
    let letter = letters("L");
    let foot = letter.iter().find(|run| run.low.y == low.y).unwrap();
    for run in &letter {
        assert!(run.size().x <= foot.size().x && run.low.x == foot.low.x);
    }
    let shifted = letters(" E");
    assert!(shifted.iter().all(|run| run.low.x > low.x + 1.0));
}

#[test]
fn a_character_without_a_glyph_is_a_blank() {
    let letters = |text| letters::rectangles(Vector2::zeros(), 2.0, text).collect::<Vec<_>>();
    assert_eq!(letters("a\u{2609}b\nc"), letters("a b c"));
    assert_eq!(letters(" \t\u{2609}"), []);
    assert_ne!(letters("\u{e4}"), letters("a"));
}

#[test]
fn what_surrounds_the_marks_is_outside_of_their_field_and_inside_the_frame() {
    for plate in plates() {
        let artwork = artwork(&plate, Tone::ClearMarks);
        let field = field(&plate);
        for layer in [Layer::ScaleBar, Layer::Orientation, Layer::Title] {
            for shape in artwork.layer(layer) {
                let [low, high] = extent(shape);
                assert!(low.y > field.high.y || high.y < field.low.y, "{shape:?}");
                let frame = artwork.frame;
                assert!(low >= frame.low && high <= frame.high, "{shape:?}");
            }
        }
        for shape in artwork.layer(Layer::Marks) {
            let [low, high] = extent(shape);
            // The tip of a rotated arm extends slightly farther than half the mark's size.
            let margin_mm = 1.9 * plate.shape.size_mil() * MIL_MM;
            assert!((low - field.low).min() > margin_mm, "{shape:?}");
            assert!((field.high - high).min() > margin_mm, "{shape:?}");
        }
    }
}

/// The corners of the bounding rectangle of a shape; letters count as wide as high.
fn extent(shape: &Shape) -> [Vector2<f64>; 2] {
    match shape {
        Shape::Polygon(corners) => [
            corners.iter().copied().reduce(|a, b| a.inf(&b)).unwrap(),
            corners.iter().copied().reduce(|a, b| a.sup(&b)).unwrap(),
        ],
        Shape::Circle {
            centre,
            diameter_mm,
        } => [-0.5, 0.5].map(|side| centre.add_scalar(side * diameter_mm)),
        Shape::Line { from, to, .. } => [from.inf(to), from.sup(to)],
        Shape::Text {
            start,
            height_mm,
            text,
        } => [
            *start,
            start + Vector2::new(text.chars().count() as f64, 1.0) * *height_mm,
        ],
    }
}

#[test]
fn the_scale_bar_is_as_long_as_its_label_says() {
    let narrow = Plate::new(
        Pattern::Listed,
        DOT,
        1.0,
        [(0.0, 0.0), (200.0, 0.0), (0.0, 300.0)]
            .into_iter()
            .zip(0..)
            .map(|((x, y), i)| (MarkId { i, j: 0 }, MarkPlace::new(PlateMil::new(x, y), 1.0))),
    );
    for (plate, length_mm) in [(narrow, 10.0), (builtin("demo").unwrap().plate, 100.0)] {
        let artwork = artwork(&plate, Tone::DarkMarks);
        let bar: Vec<&Shape> = artwork.layer(Layer::ScaleBar).collect();
        let [low, high] = extent(bar[0]);
        assert!((high.x - low.x - length_mm).abs() < 1e-6);
        let Shape::Text { text, .. } = bar[1] else {
            panic!("{bar:?}");
        };
        assert_eq!(*text, format!("{length_mm} mm"));
    }
}

#[test]
fn the_orientation_corner_is_at_plus_x_plus_y() {
    let artwork = artwork(&plate(cross(30.0)), Tone::DarkMarks);
    let [low, high] = extent(artwork.layer(Layer::Orientation).next().unwrap());
    let Rectangle { high: corner, .. } = artwork.frame;
    assert!((corner - high).max() < 5.0 && (corner - low).max() < 15.0);
}

#[test]
fn gerber_keeps_what_ends_a_command_out_of_its_comments() {
    let artwork = Artwork::new("50% *bright*", &plate(DOT), Tone::DarkMarks);
    let text = String::from_utf8(file(&artwork, "plate.gbr")).unwrap();
    assert!(
        text.starts_with("G04 50\\u0025 \\u002Abright\\u002A*\n"),
        "{text:.60}"
    );
    assert!(text.ends_with("M02*\n"));
}
