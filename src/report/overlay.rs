//! A picture of a solved frame that shows the pipeline's results.

use super::{Canvas, Colour};
use crate::aspect::{Mark, Solution};
use crate::fiducial::Lighting;
use crate::frame::{Frame, Region};
use crate::geometry::Mapping;
use crate::instrument::Instrument;
use crate::plate::{MarkId, MarkShape, Plate};
use crate::units::{PlateMil, SensorPx};
use image::RgbImage;
use nalgebra::Vector2;

/// Length of the drawn plate axes, in radii of the disc.
const AXIS_RADII: f64 = 0.64;
/// Greatest distance of a mark's fitted position from its detection.
const SAME_MARK_PX: f64 = 2.0;
/// Radius of the circle around a mark.
const MARK_RADIUS_PX: f64 = 11.0;
/// Lines of captions; lines of the strip, with two of legend and the scale.
const CAPTION_LINES: u32 = 4;
const STRIP_LINES: u32 = CAPTION_LINES + 3;
/// The scale bar is the longest of these that is not longer than a quarter of the picture's width.
const SCALES_ARCSEC: [f64; 7] = [3000.0, 1000.0, 500.0, 200.0, 100.0, 50.0, 20.0];
const LEGEND: [(&str, Colour); 6] = [
    ("limb points", Colour::YELLOW),
    ("fitted disc", Colour::GREEN),
    ("marks", Colour::BLUE),
    ("cut by the limb", Colour::ORANGE),
    ("not identified", Colour::RED),
    ("plate's axes", Colour::MAGENTA),
];

/// The disc magnified, with points of the limb (yellow), the fitted disc (green), marks with their ids (blue; orange if cut by the limb),
/// rejected detections (red) and the plate's axes (magenta); below it the legend and a scale in arcsec. A frame without a disc is shown
/// whole, with the reason.
pub fn overlay(
    frame: &Frame,
    solution: &Solution,
    instrument: &Instrument,
    title: &str,
) -> RgbImage {
    let levels = solution.levels;
    let stretch = levels.map_or((0.0, f64::from(frame.saturation_dn())), |levels| {
        (levels.background_dn, 1.5 * levels.disc_dn)
    });
    let about_sun = solution.aspect.and_then(|aspect| {
        let reach = 1.15 * aspect.sun_radius_px.value;
        Region::around(aspect.sun_px.position, reach, frame.width(), frame.height())
    });
    let (region, zoom) = match about_sun {
        Some(region) => (region, 4),
        None => (frame.region(), 1),
    };
    let mut canvas = Canvas::of_frame(frame, region, zoom, stretch, STRIP_LINES);
    for point in &solution.limb {
        canvas.dot(point.at, Colour::YELLOW);
    }
    if let (Some(aspect), Some(adopted)) = (&solution.aspect, &solution.mapping) {
        draw_disc(
            &mut canvas,
            adopted.mapping(),
            aspect.sun_plate.position,
            aspect.sun_radius_px.value,
        );
        let length_mil =
            AXIS_RADII * aspect.sun_radius_px.value * aspect.mapping.scale_mil_per_px.value;
        let sun = aspect.sun_plate.position;
        draw_axes(&mut canvas, adopted.mapping(), sun, length_mil);
    }
    draw_marks(&mut canvas, solution, &instrument.plate);
    for (line, text) in captions(solution, title).iter().enumerate() {
        canvas.caption(line as u32, text, Colour::WHITE);
    }
    let free = canvas.legend(CAPTION_LINES, &LEGEND);
    draw_scale(
        &mut canvas,
        free,
        region.width() as f64,
        solution,
        instrument,
    );
    canvas.into_image()
}

/// Uses the frame's own scale if determined, else the stated one.
fn draw_scale(
    canvas: &mut Canvas,
    line: u32,
    width_px: f64,
    solution: &Solution,
    instrument: &Instrument,
) {
    let own = solution.aspect.zip(solution.mapping.as_ref());
    let own = own.map(|(aspect, adopted)| {
        let seen = adopted.mapping().to_sensor(aspect.sun_plate.position);
        adopted.mapping().scale_mil_per_px(seen)
    });
    let mil_per_px = own.unwrap_or(instrument.mounting.scale_mil_per_px.value);
    let arcsec_per_px = mil_per_px * instrument.optics.arcsec_per_mil();
    let fits = |arcsec: &&f64| **arcsec <= width_px / 4.0 * arcsec_per_px;
    if let Some(arcsec) = SCALES_ARCSEC.iter().find(fits) {
        canvas.scale_bar(line, arcsec / arcsec_per_px, &format!("{arcsec} arcsec"));
    }
}

/// The limb by the mapping: a circle on the plate, not always one on the sensor.
fn draw_disc(canvas: &mut Canvas, mapping: &Mapping, centre: PlateMil, radius_px: f64) {
    let seen = mapping.to_sensor(centre);
    let radius_mil = radius_px * mapping.scale_mil_per_px(seen);
    let limb = |n: i32| {
        let (sin, cos) = (f64::from(n) * 3.0).to_radians().sin_cos();
        mapping.to_sensor(PlateMil::new(
            centre.x + radius_mil * cos,
            centre.y + radius_mil * sin,
        ))
    };
    for n in 0..120 {
        canvas.line(limb(n), limb(n + 1), Colour::GREEN);
    }
    for (dx, dy) in [(4.0, 0.0), (0.0, 4.0)] {
        let offset = nalgebra::Vector2::new(dx, dy);
        let (from, to) = (seen.vector() - offset, seen.vector() + offset);
        canvas.line(from.into(), to.into(), Colour::GREEN);
    }
}

fn draw_axes(canvas: &mut Canvas, mapping: &Mapping, sun: PlateMil, length_mil: f64) {
    let origin = mapping.to_sensor(sun);
    for (name, dx, dy) in [("X", length_mil, 0.0), ("Y", 0.0, length_mil)] {
        let tip = mapping.to_sensor(PlateMil::new(sun.x + dx, sun.y + dy));
        canvas.arrow(origin, tip, Colour::MAGENTA);
        canvas.label(tip, name, Colour::MAGENTA);
    }
}

fn draw_marks(canvas: &mut Canvas, solution: &Solution, plate: &Plate) {
    for mark in &solution.marks {
        let colour = match mark.lighting {
            Lighting::Full => Colour::BLUE,
            Lighting::Cut => Colour::ORANGE,
        };
        canvas.circle(mark.at, MARK_RADIUS_PX, colour);
        let beside = SensorPx::new(mark.at.x + 8.0, mark.at.y - 8.0);
        canvas.label(beside, &mark.id.to_string(), colour);
        if let Some(adopted) = &solution.mapping {
            draw_mark(canvas, adopted.mapping(), plate, mark.id, colour);
        }
    }
    for detection in &solution.detections.marks {
        let same = |mark: &Mark| mark.at.distance(detection.at) < SAME_MARK_PX;
        if !solution.marks.iter().any(same) {
            canvas.circle(detection.at, MARK_RADIUS_PX, Colour::RED);
        }
    }
}

/// The printed mark at its position by the mapping: a cross's arms, a dot's edge.
fn draw_mark(canvas: &mut Canvas, mapping: &Mapping, plate: &Plate, id: MarkId, colour: Colour) {
    let Some(centre) = plate.position(id) else {
        return;
    };
    let arms = plate.shape.arms() * (plate.shape.size_mil() / 2.0);
    let end = |offset: Vector2<f64>| mapping.to_sensor((centre.vector() + offset).into());
    match plate.shape {
        MarkShape::Cross(_) => {
            for arm in arms.column_iter() {
                canvas.line(end(-arm), end(arm.into_owned()), colour);
            }
        }
        MarkShape::Dot { .. } => {
            let radius = end(arms.column(0).into_owned()).distance(end(Vector2::zeros()));
            canvas.circle(end(Vector2::zeros()), radius, colour);
        }
    }
}

fn captions(solution: &Solution, title: &str) -> Vec<String> {
    let mut lines = vec![title.to_string()];
    if let (Some(aspect), Some(adopted)) = (&solution.aspect, &solution.mapping) {
        let (px, mil) = (aspect.sun_px.position, aspect.sun_plate.position);
        let sigma = aspect.sun_plate.sigma();
        lines.push(format!(
            "{}   Sun ({:.2}, {:.2}) px   ({:.2}, {:.2}) mil   sigma ({:.2}, {:.2}) mil",
            solution.quality.name(),
            px.x,
            px.y,
            mil.x,
            mil.y,
            sigma[0],
            sigma[1],
        ));
        lines.push(format!(
            "radius {:.2} px   {} limb points   {}   mapping: {}",
            aspect.sun_radius_px.value,
            solution.limb.len(),
            marks_line(solution),
            adopted.name(),
        ));
    }
    if let Some(stopped) = &solution.stopped {
        lines.push(format!(
            "{stopped} ({:.2}, limit {:.2})",
            stopped.rejected.measured, stopped.rejected.limit
        ));
    }
    lines
}

fn marks_line(solution: &Solution) -> String {
    let marks = solution.marks.len();
    match solution.track.as_ref().map(|track| track.predicted) {
        Some(1..) => format!("{marks} marks as predicted"),
        _ => format!("{marks} of {} marks read", solution.detections.marks.len()),
    }
}
