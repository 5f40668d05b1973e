//! A picture of a frame that shows the detected horizon.

use super::circle::Circle;
use super::nadir::is_part;
use super::sphere::Cone;
use super::{Solution, Sphere, Stopped, pitch_deg, roll_deg};
use crate::frame::Frame;
use crate::geometry::unit;
use crate::instrument::DirectionCamera;
use crate::report::{Canvas, Colour};
use crate::units::{Measured, SensorPx};
use image::RgbImage;
use nalgebra::UnitVector3;
use std::f64::consts::TAU;

/// The caption is followed by two lines of legend.
const CAPTION_LINES: u32 = 4;
const STRIP_LINES: u32 = CAPTION_LINES + 2;
const LEGEND: [(&str, Colour); 5] = [
    ("edge as seen", Colour::YELLOW),
    ("does not agree", Colour::RED),
    ("edge of the sphere", Colour::GREEN),
    ("down", Colour::MAGENTA),
    ("own parts", Colour::BLUE),
];
const ARROW_PX: f64 = 120.0;

/// The whole frame with the observed edge (yellow; red where it does not agree), the edge of the fitted sphere (green), the
/// direction down (magenta) and the vehicle's own parts (blue).
pub fn overlay(
    frame: &Frame,
    solution: &Solution,
    camera: &DirectionCamera,
    sphere: &Sphere,
    title: &str,
) -> RgbImage {
    let levels = solution
        .levels
        .map(|levels| (levels.dark_dn, levels.bright_dn));
    let mut canvas = canvas(frame, camera, levels);
    if let Ok(nadir) = &solution.nadir {
        let sphere = Sphere {
            half_angle_rad: nadir.half_angle_rad,
            ..*sphere
        };
        draw_sphere(&mut canvas, frame, &nadir.direction.unit, camera, &sphere);
    }
    let weights = solution.nadir.iter().flat_map(|nadir| &nadir.weights);
    let weights = weights.copied().chain(std::iter::repeat(0.0));
    for (point, weight) in solution.edge.rays.iter().zip(weights) {
        let colour = if is_part(&weight) {
            Colour::YELLOW
        } else {
            Colour::RED
        };
        canvas.dot(point.at, colour);
    }
    captioned(canvas, &captions(solution, title))
}

/// The same for a circle: the edge of its sphere, and the direction down.
pub fn overlay_of_circle(
    frame: &Frame,
    circle: Result<&Circle, &Stopped>,
    camera: &DirectionCamera,
    title: &str,
) -> RgbImage {
    let mut canvas = canvas(frame, camera, None);
    let text = match circle {
        Ok(circle) => {
            let sphere = Sphere::disc(Measured::new(circle.half_angle_rad, 0.0));
            draw_sphere(&mut canvas, frame, &circle.nadir, camera, &sphere);
            let (roll, pitch) = (roll_deg(&circle.nadir), pitch_deg(&circle.nadir));
            format!("circle   roll {roll:.4}   pitch {pitch:.4} deg")
        }
        Err(stopped) => stopped.in_full(),
    };
    captioned(canvas, &[title.to_owned(), text])
}

/// The frame with the vehicle's own parts marked, its contrast stretched between two levels or to its limits.
fn canvas(frame: &Frame, camera: &DirectionCamera, levels_dn: Option<(f64, f64)>) -> Canvas {
    let limits_dn = (0.0, f64::from(frame.saturation_dn()));
    let stretch = levels_dn.unwrap_or(limits_dn);
    let mut canvas = Canvas::of_frame(frame, frame.region(), 1, stretch, STRIP_LINES);
    for region in &camera.mask {
        let [x0, x1, y0, y1] = [region.x0, region.x1, region.y0, region.y1].map(|v| v as f64);
        let corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)];
        for pair in corners.map(|(x, y)| SensorPx::new(x, y)).windows(2) {
            canvas.line(pair[0], pair[1], Colour::BLUE);
        }
    }
    canvas
}

fn captioned(mut canvas: Canvas, captions: &[String]) -> RgbImage {
    for (line, text) in captions.iter().enumerate() {
        canvas.caption(line as u32, text, Colour::WHITE);
    }
    canvas.legend(CAPTION_LINES, &LEGEND);
    canvas.into_image()
}

fn draw_sphere(
    canvas: &mut Canvas,
    frame: &Frame,
    nadir: &UnitVector3<f64>,
    camera: &DirectionCamera,
    sphere: &Sphere,
) {
    const STEPS: u32 = 720;
    let cone = Cone::new(sphere, nadir);
    let (width, height) = (frame.width() as f64, frame.height() as f64);
    let at = |n: u32| {
        let seen = camera.lens.pixel(
            &cone
                .edge(&unit(f64::from(n) / f64::from(STEPS) * TAU))
                .ray(),
        )?;
        let near =
            (-width..2.0 * width).contains(&seen.x) && (-height..2.0 * height).contains(&seen.y);
        near.then_some(seen)
    };
    for n in 0..STEPS {
        if let (Some(from), Some(to)) = (at(n), at(n + 1)) {
            canvas.line(from, to, Colour::GREEN);
        }
    }
    let middle = SensorPx::new(width / 2.0, height / 2.0);
    if let Some(down) = nadir.xy().try_normalize(0.0) {
        let tip = middle.vector() + down * ARROW_PX;
        canvas.arrow(middle, tip.into(), Colour::MAGENTA);
        canvas.label(tip.into(), "down", Colour::MAGENTA);
    }
}

fn captions(solution: &Solution, title: &str) -> Vec<String> {
    let quality = solution.quality().name();
    let mut lines = vec![title.to_owned()];
    if let Ok(nadir) = &solution.nadir {
        lines.push(format!(
            "{quality}   roll {:.4}   pitch {:.4}   sigma {:.4} deg   {}",
            nadir.roll_deg(),
            nadir.pitch_deg(),
            nadir.sigma_deg(),
            nadir.conic.name(),
        ));
        lines.push(format!(
            "{} of {} points of the edge agree, {} places in view",
            solution.agreeing(),
            solution.edge.rays.len(),
            solution.places,
        ));
    }
    lines.extend(solution.reason().map(Stopped::in_full));
    lines
}
